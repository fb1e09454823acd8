"""``cell doctor``: checks of this machine and the station's devices before the first start."""

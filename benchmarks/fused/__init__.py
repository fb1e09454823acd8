"""Several views of one scene fused: how far the fused cloud lies from the true shapes, and what a correction mends."""

import drivers.sim  # noqa: F401  sets how MuJoCo renders, before MuJoCo is first imported

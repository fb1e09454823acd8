"""Picks of the whole simulated cell, judged by what physics did and not by the cell's own verdict."""

import drivers.sim  # noqa: F401  sets how MuJoCo renders, before MuJoCo is first imported

"""toppra without its plots: for those it imports matplotlib, which is a third of the start of every program here."""

from __future__ import annotations

import sys
from types import ModuleType

_PLOTS = [name for name in ("matplotlib", "matplotlib.pyplot") if name not in sys.modules]
sys.modules |= {name: ModuleType(name) for name in _PLOTS}

import toppra  # noqa: E402
from toppra.constraint import DiscretizationType, JointAccelerationConstraint, LinearConstraint  # noqa: E402

for _name in _PLOTS:  # whoever wants the real one, gets it
    del sys.modules[_name]

__all__ = ["DiscretizationType", "JointAccelerationConstraint", "LinearConstraint", "toppra"]

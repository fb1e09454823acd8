"""Imports toppra without its plots, because matplotlib would take a third of every program's start."""

from __future__ import annotations

import sys
import warnings
from types import ModuleType

_PLOTS = [name for name in ("matplotlib", "matplotlib.pyplot") if name not in sys.modules]
sys.modules |= {name: ModuleType(name) for name in _PLOTS}

with warnings.catch_warnings():  # toppra's docstrings warn once, when they are compiled
    for _kind in (SyntaxWarning, DeprecationWarning):
        warnings.filterwarnings("ignore", ".*invalid escape sequence", _kind)
    import toppra
    from toppra.constraint import DiscretizationType, JointAccelerationConstraint, LinearConstraint

for _name in _PLOTS:  # a later import gets the real matplotlib
    del sys.modules[_name]

__all__ = ["DiscretizationType", "JointAccelerationConstraint", "LinearConstraint", "toppra"]

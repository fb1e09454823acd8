"""Says in one line why this Python cannot import the program: another package hides one of ours, or one is not there.

It imports nothing but Python's own, because everything else may be what is missing.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

OWN = ("bus", "cell", "config", "drivers", "logs", "perception", "planning", "vlad_cell")
"""The packages of this program. Their names are common."""
_ROOT = Path(__file__).resolve().parent.parent


def hidden() -> str:
    """Name the first file that is imported instead of a package of this program, and what to do; empty: none is."""
    for name in OWN:
        spec = importlib.util.find_spec(name)
        origin = spec.origin if spec is not None else None
        if origin is None or Path(origin).resolve() != _ROOT / name / "__init__.py":
            return f"{origin or 'Nothing'} is imported instead of this program's package {name!r}. {_way_out(origin)}"
    return ""


def _way_out(origin: str | None) -> str:
    """Return the advice for a file that hides a package: leave its folder out, or take an environment without it."""
    folders = {Path(origin).parent, Path(origin).parent.parent} if origin is not None else set()
    path = os.environ.get("PYTHONPATH", "")
    if path and folders & {Path(entry).absolute() for entry in path.split(os.pathsep)}:
        return _WITHOUT_PATH
    if Path.cwd() in folders:
        return "Start the command in another folder."
    return "Give the cell an environment of its own (docs/install.md)."


_WITHOUT_PATH = "PYTHONPATH names that folder: unset PYTHONPATH, or write `PYTHONPATH=` before the command."


def not_installed(error: ImportError) -> str:
    """Name the package of somebody else that ``error`` could not import, and what to do; empty for one of ours."""
    name = (error.name or "").partition(".")[0]
    if not name or name in OWN:
        return ""
    if os.environ.get("PYTHONHOME"):
        return f"The package {name!r} cannot be imported: PYTHONHOME leads to another Python. Unset it."
    if not isinstance(error, ModuleNotFoundError):
        path = " PYTHONPATH is set: try without it (`PYTHONPATH=` before the command)." * ("PYTHONPATH" in os.environ)
        return f"The package {name!r} cannot be imported: {error}.{path}"
    return f"The package {name!r} is not installed in {sys.prefix}. {_how_to_install()}"


def _how_to_install() -> str:
    ours = _ROOT / ".venv"
    if ours.exists() and Path(sys.prefix).resolve() != ours.resolve():
        return f"`deactivate` that environment first, or start {ours / 'bin' / 'cell'}."
    if (_ROOT / "setup.sh").exists():
        return f"Run {_ROOT / 'setup.sh'}."
    return "Install vlad-cell with all that it needs (docs/install.md)."

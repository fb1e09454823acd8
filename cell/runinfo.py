"""What a recording must name so that its cycle can be run again: versions, commit, seed, hashes."""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path

from config.load import station_hash
from config.schema import Station

_PACKAGES = ("vlad-cell", "mujoco", "numpy", "opencv-python-headless", "pin", "coal", "toppra", "eclipse-zenoh", "mcap")
SCHEMA_VERSION = "1"
"""Raised when a recorded message changes its meaning."""


def run_info(station: Station, cycle_id: str) -> dict[str, str]:
    """The metadata of one cycle's recording."""
    return {
        "schema": SCHEMA_VERSION,
        "cycle_id": cycle_id,
        "cell_id": station.cell_id,
        "station_hash": station_hash(station),
        "seed": str(station.sim.seed),
        "commit": _commit(),
        "python": sys.version.split()[0],
        **{package: version(package) for package in _PACKAGES},
    }


@cache
def _commit() -> str:
    """The checkout's commit, with ``+`` when it has changes; "unknown" outside a checkout or without git."""
    root = Path(__file__).parent.parent
    try:
        commit = _git(root, "rev-parse", "--short=12", "HEAD")
        return commit + ("+" if _git(root, "status", "--porcelain") else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _git(root: Path, *arguments: str) -> str:
    return subprocess.run(
        ["git", "-C", str(root), *arguments], check=True, capture_output=True, text=True, timeout=10
    ).stdout.strip()

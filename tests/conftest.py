"""Fixtures of every test: a free loopback endpoint, random frames."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from xdist.scheduler import LoadGroupScheduling

from bus.free_port import free_endpoint
from bus.messages import CameraModel, Frame

settings.register_profile("deterministic", derandomize=True, deadline=None, print_blob=True)
settings.load_profile("deterministic")

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # whoever runs the tests under nohup does not mean what they test
os.environ.setdefault("MUJOCO_GL", "egl")  # for files that import MuJoCo before `drivers.sim` does


class FilesOrGroups(LoadGroupScheduling):  # type: ignore[misc]  # xdist ships no types
    """One process runs a file's tests, which share its fixtures, or those of an ``xdist_group``."""

    def _split_scope(self, nodeid: str) -> str:
        scope = super()._split_scope(nodeid)
        return nodeid.split("::")[0] if scope == nodeid else scope


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> FilesOrGroups | None:
    """Define what ``--dist loadgroup`` means here."""
    return FilesOrGroups(config, log) if config.getvalue("dist") == "loadgroup" else None


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Where only the tests at 1 kHz are wanted, a file that marks none, nor its folder's conftest, is not imported."""
    if not str(config.getoption("markexpr")).startswith("realtime") or not collection_path.match("test_*.py"):
        return None
    beside = collection_path.with_name("conftest.py")
    marks = any(path.exists() and "mark.realtime" in path.read_text() for path in (collection_path, beside))
    return None if marks else True


@pytest.fixture(scope="session")
def new_endpoint() -> Callable[[], str]:
    """Gives loopback endpoints nobody listens on."""

    return free_endpoint


@pytest.fixture
def endpoint(new_endpoint: Callable[[], str]) -> str:
    """A loopback endpoint nobody listens on."""
    return new_endpoint()


@pytest.fixture
def public_objects(tmp_path: Path) -> Callable[..., Path]:
    """Makes a folder of some objects of the public set object_sim, which has others too large for a table."""
    data = os.environ.get("VLAD_CELL_DATA")
    if not data:
        pytest.skip("VLAD_CELL_DATA names no folder with the object_sim meshes")
    whole = Path(data) / "meshes" / "object_sim"

    def folder_of(*names: str) -> Path:
        folder = tmp_path / "objects"
        folder.mkdir()
        for name in (*names, "common.xml"):
            (folder / name).symlink_to((whole / name).resolve())
        return folder

    return folder_of


@pytest.fixture
def frame() -> Frame:
    """A small frame with structure, holes and a non-trivial pose between its cameras."""
    rng = np.random.default_rng(1)
    ramp = np.linspace(0, 255, 160, dtype=np.uint8)
    color = np.stack([np.tile(ramp, (90, 1))] * 3, axis=-1)
    depth_m = np.round(rng.uniform(0.5, 1.5, (72, 80)), 3).astype(np.float32)
    depth_m[::7] = np.nan
    color_from_depth = np.eye(4)
    angle = np.deg2rad(6.0)
    color_from_depth[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    color_from_depth[:3, 3] = 0.032, 0.002, -0.004
    distortion = (0.08, -0.1, 0.0, 0.0, 0.04, 0.0, 0.0, 0.0)
    return Frame(
        stamp_ns=1_700_000_000_123_456_789,
        color=color,
        depth_m=depth_m,
        color_camera=CameraModel(width=160, height=90, fx=93.0, fy=93.0, cx=80.0, cy=45.0, distortion=distortion),
        depth_camera=CameraModel(width=80, height=72, fx=93.0, fy=93.0, cx=40.0, cy=36.0, distortion=distortion),
        color_from_depth=color_from_depth,
    )

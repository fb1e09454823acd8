"""The information in a recording that is needed to rerun its cycle: versions, commit, seed, hashes, settings."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import time
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from bus.distribution import OURS
from bus.errors import RecordingError
from config.load import station_hash
from config.plug_ins import Group
from config.schema import Station
from drivers.node import registry as drivers
from logs.mcap.index import BEGAN
from logs.mcap.migrate import SCHEMA_VERSION
from logs.mcap.reader import PLUG_INS
from logs.mcap.recorder import Recorder, Under
from perception.detectors import registry as detectors
from perception.models import registry as models
from planning.description import ASSETS, describe

_GIT_TIMEOUT_S = 1.0
"""Longest wait for git; it delays the first cycle."""
_PACKAGES = (OURS, "mujoco", "numpy", "opencv-python-headless", "pin", "coal", "toppra", "eclipse-zenoh", "mcap")


def run_info(configured: Station, cycle_id: str) -> dict[str, str]:
    """Return the metadata of one cycle's recording: ids, versions, commit, seed and hashes.

    Args:
        configured: the station without the job's target and place: its hash is that of the configuration.
    """
    return {
        "schema": str(SCHEMA_VERSION),
        "cycle_id": cycle_id,
        BEGAN: f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}"[:-3],
        "cell_id": configured.cell_id,
        "station_hash": station_hash(configured),
        "seed": str(configured.sim.seed),
        "robot_model_sha256": _robot_model(robot_description(configured)),
        **_commit(),
        PLUG_INS: json.dumps(_plug_ins(configured)),
        "python": sys.version.split()[0],
        **{package: _version(package) for package in _PACKAGES},
    }


def attachments(station: Station) -> dict[str, str]:
    """Return the JSON documents attached to a recording: the station, and the camera's calibration."""
    return {"station.json": station.model_dump_json(), "calibration.json": station.camera.model_dump_json()}


def open_recorder(path: Path, station: Station, configured: Station, cycle_id: str, under: Under) -> Recorder:
    """Open a cycle's recording with its metadata and attachments, flushed to the disk.

    Args:
        station: with what the job asks for. ``configured``: without.

    Raises: RecordingError.
    """
    recorder = Recorder(path, metadata=run_info(configured, cycle_id), clock=time.time_ns, under=under)
    try:
        for name, text in attachments(station).items():
            recorder.attach(name, "application/json", text.encode())
        recorder.attach(_model_name(station), "application/xml", robot_description(station))
        recorder.flush()
    except RecordingError:
        recorder.abandon()
        raise
    return recorder


def _version(package: str) -> str:
    """The version of an installed package; "unknown" for modules of another package (opencv has four names)."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _plug_ins(station: Station) -> dict[str, str]:
    """The packages of other makers that the station uses, by the setting that names what they bring."""
    used = {
        "perception.detector": (detectors.GROUP, station.perception.detector),
        "perception.model": (models.GROUP, station.perception.model),
        **{f"nodes.{node}.driver": (drivers.GROUP, one.driver) for node, one in station.nodes.items()},
    }
    return {key: package for key, (group, name) in used.items() if (package := _package(group, name))}


@cache
def _package(group: Group, name: str) -> str:
    return group.package_of(name)


def _model_name(station: Station) -> str:
    return "model/fr3.urdf" if station.robot is None else "model/robot.urdf"


def robot_description(station: Station) -> bytes:
    """Return the robot's URDF: its links are the frames of `topics.TF`, its meshes (80 MB) in the franky-sim package.

    Raises: ConfigError when the arm's own URDF cannot be used.
    """
    return describe(station).urdf.encode()


@cache
def _robot_model(urdf: bytes) -> str:
    """Hash of the robot's description and its collision meshes, which the plan depends on."""
    digest = hashlib.sha256(urdf)
    for mesh in sorted((ASSETS / "meshes").glob("*_coll.stl")):
        digest.update(mesh.read_bytes())
    return digest.hexdigest()


@cache
def _commit() -> dict[str, str]:
    """The checkout's commit, and whether it has changes; "unknown" when git does not answer in time."""
    root = Path(__file__).parents[2]
    try:
        commit = _git(root, "rev-parse", "--short=12", "HEAD")
        return {"commit": commit, "dirty": "yes" if _git(root, "status", "--porcelain") else "no"}
    except (OSError, subprocess.SubprocessError):
        return {"commit": "unknown", "dirty": "unknown"}


def _git(root: Path, *arguments: str) -> str:
    return subprocess.run(
        ["git", "-C", str(root), *arguments], check=True, capture_output=True, text=True, timeout=_GIT_TIMEOUT_S
    ).stdout.strip()

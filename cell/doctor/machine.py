"""Checks of the machine itself: packages, drivers, graphics, disk, clock."""

from __future__ import annotations

import ctypes
import importlib.util
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, requires, version

from bus.distribution import OURS
from bus.errors import ConfigError, RecordingError
from cell.doctor.finding import Finding, fix, not_needed, ok
from config.schema import Station
from drivers import egl
from drivers.node import registry
from logs.mcap.retention import in_words
from logs.prune import Pruner

_NAMED = ("mujoco", "eclipse-zenoh", "pin", "numpy")
_DRAW_S = 8.0
_STA_UNSYNC = 0x40

SDKS: dict[str, tuple[str, str, tuple[int, int] | None]] = {
    "fr3": ("pylibfranka", "fr3", (3, 13)),
    "panda_hand": ("franky", "fr3", None),
    "femto_mega": ("pyorbbecsdk", "femto", (3, 14)),
}
"""Driver -> the vendor's module, our extra that installs it, and the first Python version without a wheel for it."""


# --- packages ---------------------------------------------------------------------------------------------------------


def packages(_station: Station, distribution: str = OURS) -> Finding:
    """Check that all required packages are installed."""
    name, missing, versions = "packages", [], {}
    try:
        wanted = [one for one in requires(distribution) or [] if "extra ==" not in one]
    except PackageNotFoundError:
        return fix(
            name, f"{distribution} is not installed for {sys.executable}.", "Run ./setup.sh, then `uv run cell`."
        )
    for package in (re.split(r"[^A-Za-z0-9._-]", one)[0] for one in wanted):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            missing.append(package)
    if missing:
        return fix(name, f"Missing: {', '.join(missing)}.", "Run ./setup.sh.")
    named = ", ".join(f"{one} {versions[one]}" for one in _NAMED if one in versions)
    return ok(name, f"Python {platform.python_version()}, all {len(versions)} packages there: {named}, ...")


def drivers(
    station: Station,
    sdks: dict[str, tuple[str, str, tuple[int, int] | None]] = SDKS,
    python: tuple[int, int] | None = None,
) -> Finding:
    """Check that each node's driver and its vendor module are installed; nothing is imported.

    Args:
        python: major and minor version; None = this one's.
    """
    name, used = "drivers", sorted({node.driver for node in station.nodes.values()})
    unknown = [one for one in used if one not in registry.GROUP.names()]
    if unknown:
        known = ", ".join(registry.GROUP.names())
        return fix(
            name, f"No such driver: {', '.join(unknown)}.", f"Correct [nodes] in the station file; there are: {known}."
        )
    needed = [sdks[one] for one in used if one in sdks]
    missing = [one for one in needed if importlib.util.find_spec(one[0]) is None]
    if missing:
        return fix(name, f"Not installed: {', '.join(one[0] for one in missing)}.", _install(missing, python))
    behind = f" (with {', '.join(one[0] for one in needed)})" if needed else ""
    return ok(name, f"All installed: {', '.join(used)}{behind}")


def _install(missing: list[tuple[str, str, tuple[int, int] | None]], python: tuple[int, int] | None) -> str:
    here = python or sys.version_info[:2]
    ends = [(module, end) for module, _, end in missing if end is not None and here >= end]
    if ends:
        module, end = min(ends, key=lambda one: one[1])
        newest = f"{end[0]}.{end[1] - 1}"
        return f"{module} needs Python {newest} or older: rm -rf .venv && uv venv --python {newest} .venv && ./setup.sh"
    extras = ",".join(sorted({extra for _, extra, _ in missing}))
    return f"uv pip install '{OURS}[{extras}]'"


# --- graphics, disk, clock --------------------------------------------------------------------------------------------


def rendering(station: Station) -> Finding:
    """Check that MuJoCo can draw, in a separate process, because graphics drivers crash."""
    name = "rendering"
    if not station.simulated:
        return not_needed(name, "Only a simulated camera draws.")
    egl.choose()
    try:
        drawn = subprocess.run(
            [sys.executable, "-m", "cell.doctor.draw"],
            capture_output=True, text=True, timeout=_DRAW_S, check=False,
        )  # fmt: skip
        why = (drawn.stderr.strip().splitlines() or [f"exit code {drawn.returncode}"])[-1]
    except subprocess.TimeoutExpired:
        return fix(name, f"Drawing a small picture takes longer than {_DRAW_S:.0f} s.", "Check the graphics driver.")
    if drawn.returncode != 0:
        return fix(name, f"MuJoCo cannot draw without a screen: {why}", egl.advice())
    return ok(name, drawn.stdout.strip())


def disk(station: Station) -> Finding:
    """Check that recordings can be written, and report what retention would delete."""
    name, folder, needed_mb = "disk", station.recording.folder.absolute(), station.recording.min_free_mb
    there = next(one for one in (folder, *folder.parents) if one.exists())
    try:
        with tempfile.TemporaryFile(dir=there) as file:
            file.write(b"\0" * 4096)
    except OSError as error:
        advice = "Give yourself the right to write there, or set recording.folder."
        return fix(name, f"Recordings cannot be written to {folder}: {error.strerror or error}.", advice)
    free_mb = shutil.disk_usage(there).free / 1e6
    if free_mb < needed_mb:
        found = f"{free_mb:.0f} MB are free for {folder}; recording.min_free_mb asks for {needed_mb:.0f} MB."
        advice = "Delete or move old recordings, set recording.keep_gb, or set recording.folder."
        return fix(name, found, advice)
    found = f"{free_mb / 1e3:.1f} GB free for {folder}, and it can be written"
    try:
        return ok(name, f"{found}; {_what_goes(station)}")
    except (RecordingError, ConfigError) as error:
        return fix(name, error.text, error.advice)


def _what_goes(station: Station) -> str:
    """The recordings that retention would delete next, in words. Raises: RecordingError, ConfigError."""
    settings = station.recording
    if not settings.rules:
        return "recordings are never deleted (recording.keep_gb = 0)"
    plan = Pruner(settings).plan()
    dues = {"now": plan.delete, "within a day": plan.soon, "only trimmed": plan.thin}
    parts = [f"{in_words([one.file for one in due])} {when}" for when, due in dues.items() if due]
    rules = ", ".join(f"recording.{name}" for name in settings.rules)
    return f"{rules} would delete: {', '.join(parts) or 'nothing within a day'}"


class _Timex(ctypes.Structure):
    """The head of the kernel's ``struct timex``."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 256),
    )


def _kernel_clock() -> tuple[bool, float]:
    """True when a time server keeps the kernel's clock, and the clock's largest error [s]."""
    clock = _Timex()
    if ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(clock)) < 0:
        return False, float("inf")
    return not clock.status & _STA_UNSYNC, clock.maxerror / 1e6


def clock(station: Station, ask: Callable[[], tuple[bool, float]] = _kernel_clock) -> Finding:
    """Check that a time server keeps this machine's clock; ``ask`` gives that, and the clock's largest error [s]."""
    name = "clock"
    in_step, error_s = ask()
    if in_step:
        return ok(name, f"Kept by a time server, wrong by {error_s * 1e3:.0f} ms at most")
    if station.simulated:
        return ok(name, "No time server keeps it; only real devices need that")
    advice = "sudo timedatectl set-ntp true   (or install chrony); the times in recordings and of frames come from it."
    return fix(name, "No time server keeps this machine's clock.", advice)

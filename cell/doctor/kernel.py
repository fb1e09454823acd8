"""Checks of the kernel's real-time features that the arm's 1 kHz loop needs."""

from __future__ import annotations

import os
import platform
import resource
from collections.abc import Callable
from pathlib import Path

from cell.doctor.finding import Finding, fix, not_needed, ok, skip, uses
from config.schema import Station

_MEMLOCK_BYTES = 102_400 * 1024
"""Lockable memory that Franka requires."""
_LIMITS_ADVICE = (
    "Add '@realtime - rtprio 99' and '@realtime - memlock unlimited' to /etc/security/limits.conf, then"
    " `sudo groupadd -f realtime && sudo usermod -aG realtime $USER`, and log in again."
)


def _no_loop(station: Station) -> str:
    """Return why this station needs no real-time kernel, or ""."""
    if not uses(station, "fr3"):
        return "Only the driver fr3 needs it."
    return "" if station.fr3.realtime == "enforce" else 'Not needed with fr3.realtime = "ignore".'


def realtime(station: Station, flag: Path = Path("/sys/kernel/realtime")) -> Finding:
    """Check for a PREEMPT_RT kernel."""
    name = "real-time kernel"
    if why := _no_loop(station):
        return not_needed(name, why)
    if flag.exists() and flag.read_text().strip() == "1":
        return ok(name, f"{platform.release()}, fully preemptible")
    advice = (
        "Debian: sudo apt-get install linux-image-rt-amd64; Ubuntu: sudo pro enable realtime-kernel; then start that"
        ' kernel. To try things out against a simulator: fr3.realtime = "ignore".'
    )
    return fix(name, f"{platform.release()} is not a PREEMPT_RT kernel; the arm would refuse to move.", advice)


def _can_be_fifo() -> bool:
    """True when the kernel grants this thread the highest real-time priority; it is given back immediately."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(os.sched_get_priority_max(os.SCHED_FIFO)))
    except PermissionError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


def priority(station: Station, allowed: Callable[[], bool] = _can_be_fifo) -> Finding:
    """Check that this user may use real-time priorities."""
    name = "real-time priority"
    if why := _no_loop(station):
        return not_needed(name, why)
    if allowed():
        return ok(name, "This user may use SCHED_FIFO up to the highest priority")
    return fix(name, "This user may not use real-time priorities (SCHED_FIFO).", _LIMITS_ADVICE)


def _lockable_bytes() -> float:
    """Memory that this user may lock."""
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return float("inf") if soft == resource.RLIM_INFINITY or os.geteuid() == 0 else float(soft)


def memory(station: Station, lockable: Callable[[], float] = _lockable_bytes) -> Finding:
    """Check that this user may lock enough memory; ``lockable`` gives it in bytes."""
    name = "locked memory"
    if why := _no_loop(station):
        return not_needed(name, why)
    if (most := lockable()) >= _MEMLOCK_BYTES:
        return ok(name, "Without limit" if most == float("inf") else f"Up to {most / 1e6:.0f} MB")
    found = f"This user may lock {most / 1e6:.0f} MB; the control loop wants {_MEMLOCK_BYTES / 1e6:.0f} MB."
    return fix(name, found, _LIMITS_ADVICE)


def governor(station: Station, cpus: Path = Path("/sys/devices/system/cpu")) -> Finding:
    """Check that all cores run at full speed."""
    name = "CPU frequency"
    if why := _no_loop(station):
        return not_needed(name, why)
    governors = {file.read_text().strip() for file in cpus.glob("cpu[0-9]*/cpufreq/scaling_governor")}
    if not governors:
        return skip(name, "Not known: this machine keeps it to itself, as a virtual one does.")
    if governors == {"performance"}:
        return ok(name, "All cores run at full speed (performance)")
    found = f"Cores may slow down to save power (governor {', '.join(sorted(governors))})."
    return fix(name, found, "sudo cpupower frequency-set --governor performance   (package linux-cpupower)")

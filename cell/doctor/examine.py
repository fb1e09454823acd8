"""The table of checks, in the order in which they are shown, and their display."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cell.doctor import arm, catalogue, judging, kernel, machine, reach
from cell.doctor.finding import Check, Finding, Verdict
from cell.terminal.printing import Printer
from config.schema import Station

CHECKS: tuple[Check, ...] = (
    machine.packages,
    machine.drivers,
    machine.disk,
    catalogue.catalogue,
    machine.clock,
    reach.bus,
    reach.nodes,
    machine.rendering,
    reach.model_key,
    reach.model_server,
    reach.camera,
    judging.double_picks,
    arm.network,
    arm.control,
    arm.latency,
    arm.hand,
    kernel.realtime,
    kernel.priority,
    kernel.memory,
    kernel.governor,
)
_STYLE = {Verdict.OK: "green", Verdict.FIX: "bold red", Verdict.SKIP: "dim"}


def examine(station: Station, file: Path) -> Iterator[Finding]:
    """Run the checks; yield each finding as soon as it is known, at most a second or two apart.

    Args:
        file: the station's.
    """
    for check in CHECKS:
        yield check(station)
    yield judging.values(station, file)


def report(station: Station, file: Path, out: Printer, *, as_json: bool) -> bool:
    """Print the findings, as JSON one object a line; return True when there is nothing to fix."""
    to_fix, unneeded = 0, []
    for finding in examine(station, file):
        to_fix += finding.verdict is Verdict.FIX
        if as_json:
            out.json(finding.to_json())
        elif finding.is_needed:
            _show(finding, out)
        else:
            unneeded.append(finding.name)
    if unneeded:
        out.line((f"not needed by this station: {', '.join(unneeded)}", "dim"))
    if not as_json:
        out.line((f"{to_fix} to fix", "bold red") if to_fix else ("nothing to fix", "bold green"))
    return to_fix == 0


def _show(finding: Finding, out: Printer) -> None:
    style = _STYLE[finding.verdict]
    out.line((f"{finding.verdict:<5}", style), f" {finding.name:<18}  {finding.found}")
    if finding.advice:
        out.line(" " * 26, (f"-> {finding.advice}", "bold"))

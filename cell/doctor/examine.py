"""The table of checks, in the order in which they are shown, and how an operator sees them."""

from __future__ import annotations

import json
from collections.abc import Iterator

from rich.console import Console
from rich.markup import escape

from cell.doctor import arm, kernel, machine, reach
from cell.doctor.finding import Check, Finding, Verdict
from config.schema import Station

CHECKS: tuple[Check, ...] = (
    machine.packages,
    machine.drivers,
    machine.disk,
    machine.clock,
    reach.bus,
    reach.nodes,
    machine.rendering,
    reach.model_key,
    reach.model_server,
    reach.camera,
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


def examine(station: Station) -> Iterator[Finding]:
    """One finding after the other, each as soon as it is known; at most a second or two apart."""
    for check in CHECKS:
        yield check(station)


def report(station: Station, out: Console, *, as_json: bool) -> bool:
    """Print the findings, as JSON one object a line; whether nothing is to fix."""
    to_fix = 0
    for finding in examine(station):
        to_fix += finding.verdict is Verdict.FIX
        if as_json:
            out.out(json.dumps(finding.to_json()), highlight=False)
        else:
            _show(finding, out)
    if not as_json:
        out.print(f"[bold red]{to_fix} to fix[/]" if to_fix else "[bold green]nothing to fix[/]")
    return to_fix == 0


def _show(finding: Finding, out: Console) -> None:
    style = _STYLE[finding.verdict]
    out.print(f"[{style}]{finding.verdict:<5}[/] {finding.name:<18}  {escape(finding.found)}")
    if finding.advice:
        out.print(f"{'':<26}[bold]-> {escape(finding.advice)}[/]")

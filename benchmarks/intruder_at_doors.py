"""An intruder at the doors of a cell that picks meanwhile: what was let in, and whether the picks went on."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, closing
from importlib import import_module
from typing import Any

import numpy as np

from benchmarks.attacked import AS_BENCH, Attacked, wait_until
from benchmarks.guarded import Guarded, opened
from bus import topics
from bus.codec import decode
from bus.commands import MAX_CYCLES
from bus.messages import CycleResult
from cell.machine.owner import refuse

DOOR_SHARES = {
    "http_no_token": 0.06, "http_wrong_token": 0.06, "http_foreign": 0.05, "http_oversized": 0.01,
    "http_half_open": 0.002, "http_path": 0.05, "http_viewer": 0.05, "http_job": 0.05,
    "opcua_no_certificate": 0.002, "opcua_wrong_certificate": 0.002, "opcua_wrong_user": 0.003, "opcua_token": 0.003,
    "opcua_write": 0.04, "opcua_call": 0.06,
}  # fmt: skip
"""Of the tries, beside those on the bus; what opens a session takes half a second of encryption, and is rarer."""
_PICK_S = 120.0
_PICKING = {"Idle", "Starting", "Execute", "Completing", "Complete", "Resetting"}


def attack_doors(
    cell: Attacked, guarded: Guarded, kinds: list[str], rng: np.random.Generator, tell: Callable[[str], None]
) -> None:
    """Try each of ``kinds`` while the cell picks on; into its tally."""
    names = sorted({kind.partition("_")[0] for kind in kinds})
    tally = cell.tally
    with ExitStack() as stack:
        where = stack.enter_context(opened(cell.station, names))
        attempts: dict[str, Any] = {}
        for name in names:
            intruder = _intruder(name, where[name], cell, guarded, rng)
            stack.enter_context(closing(intruder))
            attempts |= dict.fromkeys(intruder.kinds, intruder)
        list(cell.victim.heard())
        _pick_on(cell)
        for number, kind in enumerate(kinds, start=1):
            tally.by_kind[kind] += 1
            attempts[kind].attempt(kind)
            if cell.state not in _PICKING:
                tally.crash(f"{kind}: the picks do not go on: {cell.state}, {cell.daemon.publisher.state.reason}")
                _pick_on(cell)
            if number % 100 == 0:
                _count_picks(cell)
            if number % 500 == 0 or number == len(kinds):
                accepted = sum(tally.accepted.values())
                tell(f"doors {number}/{len(kinds)}: accepted {accepted}, crashes {tally.crashes}, {dict(tally.picks)}")
        _end_picks(cell)


def _intruder(name: str, where: str, cell: Attacked, guarded: Guarded, rng: np.random.Generator) -> Any:
    module = import_module(f"benchmarks.{name}_intruder")  # asyncua takes two seconds to import
    if name == "http":
        return module.HttpIntruder(where, cell.tally, rng)
    return module.OpcuaIntruder(where, guarded, cell.tally, rng)


def _pick_on(cell: Attacked) -> None:
    cell.make_idle()
    refuse(cell.daemon.command("start", AS_BENCH.model_copy(update={"cycles": MAX_CYCLES})))


def _end_picks(cell: Attacked) -> None:
    """Stop them, once one has ended after the last try."""
    before = cell.tally.picks.total()
    if not wait_until(lambda: _count_picks(cell) > before, _PICK_S):
        cell.tally.crash("no pick has ended after the last try")
    cell.daemon.command("stop", AS_BENCH)
    cell.settle()
    cell.make_idle()


def _count_picks(cell: Attacked) -> int:
    """Count the picks that have ended; one that was aborted was disturbed."""
    for sample in cell.victim.heard():
        if sample.key != topics.RESULT.key:
            continue
        result = decode(CycleResult, sample.payload)
        cell.tally.picks[result.result] += 1
        if result.result == "ABORTED":
            cell.tally.crash(f"a pick was aborted: {result.code} {result.reason}")
    return cell.tally.picks.total()

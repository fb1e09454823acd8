"""The capabilities of an unauthorised program on the bus: it speaks plain Zenoh, and holds no lease; and at the doors.

Each try sends a query (`benchmarks.questions`), forges samples (`benchmarks.forging`), impersonates a participant
(`benchmarks.rogues`), or is an unauthorised or frozen process (`benchmarks.peers`). It is accepted when a command was
executed or a forged sample was believed. Afterwards, while the cell picks, tries at its doors
(`benchmarks.intruder_at_doors`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import zenoh

from benchmarks.attacked import Attacked, plain_session, wait_until
from benchmarks.forging import NODE, Forging
from benchmarks.guarded import Guarded
from benchmarks.intruder_at_doors import DOOR_SHARES, attack_doors
from benchmarks.peers import Peers
from benchmarks.questions import Questions
from benchmarks.rogues import Rogues
from benchmarks.tally import Tally
from bus import topics
from bus.codec import encode
from bus.commands import CellState, CommandReply, CommandRequest, Nothing
from bus.errors import CellError
from bus.session import Bus
from cell import client
from cell.build import running_cell
from config.load import load_station

_PATIENCE_S = 60.0
BUS_SHARES = {
    "malformed": 0.1, "unauthorised": 0.1, "stale": 0.1, "out_of_limits": 0.1, "replayed": 0.1,
    "wildcard": 0.13, "stranger": 0.06, "stranger_named": 0.06, "source_copied": 0.02,
    "forged": 0.17, "forged_copied": 0.03, "rogue_answer": 0.02, "token": 0.003, "same_id": 0.001,
    "rogue_device": 0.002, "twin": 0.0005, "spoiled_recording": 0.0002, "spoiled_copied": 0.0002,
    "twin_process": 0.0002, "frozen_client": 0.0002, "frozen_client_kept_alive": 0.0002, "frozen_asker": 0.0003,
    "frozen_listener": 0.0003,
}  # fmt: skip
"""Of the tries; what takes a cell's time is rarer. Where there are enough tries, each kind has one at least."""
SHARES = {**BUS_SHARES, **DOOR_SHARES}


def run(
    tries: int, seed: int, endpoint: str, tell: Callable[[str], None], only: tuple[str, ...] = ()
) -> dict[str, Any]:
    """``tries`` against a simulated cell of its own, at real-time pace; ``only``: of these kinds.

    Returns:
        tries; accepted: acts that were carried out, sessions that opened, lies that were believed; picks: how those
        meanwhile ended; moved: how often arm or hand were elsewhere afterwards; crashes: nodes started again, threads
        that ended, questions without an answer, a cell that is no longer Idle, or no longer picks; by_kind,
        accepted_kinds, crash_cases in words; by_code of the refusals, one a reply.
    """
    rng, tally = np.random.default_rng(seed), Tally()
    kinds = series(tries, rng, only)
    at_doors = [kind for kind in kinds if kind in DOOR_SHARES]
    kinds = [kind for kind in kinds if kind in BUS_SHARES]
    with TemporaryDirectory() as folder:
        guarded = Guarded.in_folder(Path(folder))
        own = (f"bus.endpoint={endpoint}", f"recording.folder={folder}/recordings", "sim.pace=1")
        station = load_station(None, [*own, *guarded.settings])
        with (
            running_cell(station, lambda topic, message: None) as daemon,
            Bus.join(station.cell_id, endpoint) as bus,
            client.connect(station, client_id="victim") as victim,
        ):
            heard = _accepted_reset(station.cell_id, endpoint)
            cell, session = Attacked(daemon, station, bus, victim, tally), plain_session(endpoint)
            cell.sources |= _sources(session, cell.root)
            attempts = _attempts(cell, session, heard, rng)
            for number, kind in enumerate(kinds, start=1):
                tally.by_kind[kind] += 1
                try:
                    attempts[kind](kind)
                except CellError as error:  # of who looks at the cell, and not of the intruder
                    tally.crash(f"{kind}: {error}")
                    cell.make_idle()
                if number % 100 == 0 and cell.look():
                    tally.crash(f"something has moved by itself within the last tries before {kind}")
                if number % 500 == 0 or number == len(kinds):
                    tell(f"{number}/{len(kinds)}: accepted {sum(tally.accepted.values())}, crashes {tally.crashes}")
            session.close()  # type: ignore[no-untyped-call]
            cell.look()
            if at_doors:
                attack_doors(cell, guarded, at_doors, rng, tell)
            tally.crashes += cell.restarts() + len(daemon.health().defects)
    return tally.figures()


def series(tries: int, rng: np.random.Generator, only: tuple[str, ...] = ()) -> list[str]:
    """The kind of every try: drawn by `SHARES`; the first of each kind, if there are enough, is not left to chance."""
    names = [name for name in SHARES if not only or name in only]
    shares = np.array([SHARES[name] for name in names])
    drawn = [str(name) for name in rng.choice(names, size=tries, p=shares / shares.sum())]
    if tries >= len(names):
        drawn[: len(names)] = names
    return [str(name) for name in rng.permutation(drawn)]


def _attempts(
    cell: Attacked, session: zenoh.Session, heard: bytes, rng: np.random.Generator
) -> dict[str, Callable[[str], None]]:
    """Return the function that makes a try of each kind."""
    forging = Forging(cell, session, rng)
    groups: tuple[Any, ...] = (
        Questions(cell, session, heard, rng),
        forging,
        Rogues(cell, session, forging, rng),
        Peers(cell, session, rng),
    )
    attempts = {kind: group.attempt for group in groups for kind in group.kinds}
    assert set(attempts) == set(BUS_SHARES)
    return attempts


def _sources(session: zenoh.Session, root: str) -> dict[str, zenoh.EntityGlobalId]:
    """Whom the intruder hears speak: the cell, and its node."""
    whose = {f"{root}/{topics.HEARTBEAT.key}": "cell", f"{root}/{topics.NODE_HEALTH.key.format(name=NODE)}": "node"}
    found: dict[str, zenoh.EntityGlobalId] = {}

    def hear(sample: zenoh.Sample) -> None:
        name = whose.get(str(sample.key_expr))
        if name is not None and sample.source_info is not None:
            found.setdefault(name, sample.source_info.source_id)

    subscriber = session.declare_subscriber(f"{root}/**", hear)
    assert wait_until(lambda: len(found) == len(whose), _PATIENCE_S), "the cell and its node do not speak"
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    return found


def _accepted_reset(cell_id: str, endpoint: str) -> bytes:
    """The payload of a reset as its client sent it; the client is gone when this returns."""
    request = CommandRequest(command_id="heard", client_id="operator")
    with Bus.join(cell_id, endpoint) as bus:
        bus.announce(topics.LEASE, name="operator")
        reply = bus.request(topics.COMMAND, request, CommandReply, timeout_s=5.0, verb="reset")
        assert reply.ok, reply.reason
        give_up_s = time.monotonic() + _PATIENCE_S
        while bus.request(topics.STATE_NOW, Nothing(), CellState, timeout_s=5.0).state == "Resetting":
            bus.put(f"{topics.ROOT}/{cell_id}/lease/operator", b"{}", "application/json")
            assert time.monotonic() < give_up_s
            time.sleep(0.05)
    return encode(request)

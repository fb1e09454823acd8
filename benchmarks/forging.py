"""Forged samples on every published key: without a source, from the intruder, or with the source of the real publisher.

A forged sample is believed when `cell.client.Client` returns it (as a state, a health, or a message), or when a
recording holds it other than as a stranger's.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from mcap.reader import make_reader

from benchmarks.attacked import AS_BENCH, Attacked, wait_until
from benchmarks.openness import trouble
from bus import topics
from bus.codec import encode
from bus.commands import CellHealth, CellState, Event, Health, Heartbeat
from bus.errors import BadPayload, CellError
from bus.messages import ArmMode, ArmState, CycleResult, HandState
from bus.sensor_codec import arm_q_rad, arm_state_to_wire, transforms_to_wire
from bus.topics import Topic, encoding_of
from logs.mcap.reader import read_cycle

FORGED = "forged by a stranger"
NODE = "sim"
_NOBODYS, _OWN, _COPIED = "nobody's", "its own", "the speaker's"
_PUBLISHED = tuple(topic for topic in topics.TOPICS if topic.kind == "publish")
_ZERO = np.zeros(7)
_PERIOD_S = 0.02
_RECOVERY_S = 3.0
"""A node's own word about itself comes once a second."""


class Forging:
    """Forges, and counts what is believed."""

    def __init__(self, cell: Attacked, session: zenoh.Session, rng: np.random.Generator) -> None:
        self._cell, self._session, self._rng = cell, session, rng
        self.kinds: dict[str, Callable[[str], None]] = {
            "forged": lambda kind: self._forge(kind, (_NOBODYS, _OWN)),
            "forged_copied": lambda kind: self._forge(kind, (_COPIED,)),
            "spoiled_recording": lambda kind: self._spoil(kind, (_NOBODYS, _OWN)),
            "spoiled_copied": lambda kind: self._spoil(kind, (_COPIED,)),
        }

    def attempt(self, kind: str) -> None:
        """One sample; or many, while a pick is recorded."""
        self.kinds[kind](kind)

    def _forge(self, kind: str, whose: tuple[str, ...]) -> None:
        """Put a forged sample on a key that a client hears, and count it when it is believed."""
        cell, topic = self._cell, self._one_of(_PUBLISHED)
        key, payload = self.put(topic, str(self._one_of(whose)))
        await_arrival(cell, self._session)
        is_told = cell.victim.state().state == cell.state
        was_said = any(heard.payload == payload for heard in cell.victim.heard())
        if was_said or not is_told or not self._is_health_true():
            cell.tally.accept(kind, key)
            wait_until(self._is_health_true, _RECOVERY_S)  # the next lie is not to be taken for this one
        else:
            cell.tally.by_code["IGNORED"] += 1
        cell.require_idle(f"{kind} {key}")

    def _is_health_true(self) -> bool:
        said = self._cell.victim.health().model_dump_json()
        return FORGED not in said and "cannot be read" not in said

    def put(self, topic: Topic, whose: str = _OWN) -> tuple[str, bytes]:
        """One sample on ``topic``, readable or not: its key below the cell's root, and what it says."""
        key = topic.key.format(name=NODE if topic.speaker == "node" else "operator")
        payload = self._one_of((forged(topic), self._rng.bytes(40), forged(topic)[:-3], b""))
        encoding = self._one_of((encoding_of(topic.says), encoding_of(topic.says), "text/plain", ""))
        options: dict[str, Any] = {"encoding": encoding} if encoding else {}
        source = {_NOBODYS: None, _OWN: self._session.id}.get(whose, self._speaker_of(topic))
        if source is not None:
            options["source_info"] = zenoh.SourceInfo(source, int(self._rng.integers(2**32)))
        self._session.put(f"{self._cell.root}/{key}", payload, **options)
        return key, payload

    def _speaker_of(self, topic: Topic) -> zenoh.EntityGlobalId:
        return self._cell.sources["node" if topic.speaker == "node" else "cell"]

    def _spoil(self, kind: str, whose: tuple[str, ...]) -> None:
        """Every key, again and again, while a pick runs."""
        cell = self._cell
        reply = cell.daemon.command("pick", AS_BENCH)
        while cell.state in ("Idle", "Starting", "Execute", "Completing"):
            for topic in _PUBLISHED:
                self.put(topic, str(self._one_of(whose)))
            time.sleep(_PERIOD_S)
        try:
            why = _falseness(cell.victim.wait_for_result(reply.cycle_id, 60.0))
        except CellError as error:
            why = error.code
        if why:
            cell.tally.accept(kind, why)
        else:
            cell.tally.by_code["RECORDED_APART"] += 1
        list(cell.victim.heard())
        cell.make_idle()

    def _one_of(self, some: tuple[Any, ...]) -> Any:
        return some[int(self._rng.integers(len(some)))]


def await_arrival(cell: Attacked, session: zenoh.Session) -> None:
    """Wait until the cell has heard what ``session`` said before."""
    list(session.get(f"{cell.root}/schema", timeout=0.3))


def forged(topic: Topic) -> bytes:
    """Return a false message of ``topic``; for what is not built here, an object without content."""
    lies: dict[Any, Callable[[], bytes]] = {
        CellState: lambda: encode(CellState(state="Aborted", stage="", cycle_id="", since_ns=time.time_ns(),
                                            available=("clear",), reason=FORGED)),
        CellHealth: lambda: encode(CellHealth(is_healthy=True, nodes={}, defects=(FORGED,))),
        CycleResult: lambda: encode(CycleResult(cycle_id=FORGED, object=FORGED, result="SUCCESS", code=None,
                                                reason=FORGED, stages={}, wall_s=0.1, recording="/dev/null")),
        Event: lambda: encode(Event(code="FORGED", severity="error", text=FORGED)),
        Health: lambda: encode(Health(name=NODE, pid=1, uptime_s=1.0, answered=0, failed=1, last_fault=FORGED)),
        HandState: lambda: encode(HandState(stamp_ns=time.time_ns(), width_m=0.033, is_moving=False, is_homed=True)),
        ArmState: lambda: encode(_arm()),
        topics.ARM_STATE.says: lambda: arm_state_to_wire(_arm()),
        topics.TF.says: lambda: transforms_to_wire({("base", "tcp"): np.eye(4)}, time.time_ns()).SerializeToString(),
        Heartbeat: lambda: encode(Heartbeat()),
    }  # fmt: skip
    return lies.get(topic.says, lambda: b"{}")()


def _arm() -> ArmState:
    return ArmState(stamp_ns=time.time_ns(), mode=ArmMode.IDLE, q_rad=_ZERO, dq_rad_s=_ZERO, tau_ext_nm=_ZERO)


def _falseness(result: CycleResult) -> str:
    """Return what is wrong with the recording of a result, or ""."""
    path = Path(result.recording)
    try:
        recorded = read_cycle(path).result
    except CellError as error:
        return f"the recording cannot be read: {error.code}"
    if recorded is None or encode(recorded) != encode(result):
        return "the recording's result is another"
    if trouble(path):
        return "the recording is no whole file"
    with path.open("rb") as file:
        held = {channel.topic for _, channel, message in make_reader(file).iter_messages()
                if not channel.topic.endswith("stranger") and _is_forged(channel.topic, message.data)}  # fmt: skip
    return f"recorded as its own: {', '.join(sorted(held))}" if held else ""


def _is_forged(topic: str, payload: bytes) -> bool:
    if not topic.endswith(topics.ARM_STATE.key):
        return FORGED.encode() in payload
    try:
        return not arm_q_rad(payload).any()
    except BadPayload:  # the node says none of these
        return True

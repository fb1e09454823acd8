"""What a program on the bus can do that should not be there: it speaks plain Zenoh, and holds no lease.

Each try is one question to the cell or to a node: malformed, unauthorised, stale, out of limits, or replayed. It is
accepted when the answer is no refusal, or when the arm is elsewhere afterwards.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import zenoh

from bus import topics
from bus.arrays import Joints
from bus.codec import decode, encode
from bus.commands import CellState, CommandReply, CommandRequest, ErrorReply, HandGrasp, Nothing
from bus.errors import BadPayload
from bus.session import Bus
from bus.trajectory import Trajectory
from cell.build import running_cell
from cell.states import COMMANDS
from config.load import load_station
from drivers.remote import RemoteArm

_MOVING = ("reset", "start", "pick", "unhold", "unsuspend")
_NODE_KEYS = tuple(topic.key for topic in (topics.ARM_EXECUTE, topics.HAND_MOVE, topics.HAND_GRASP))
_REST_RAD = 1e-3
_PATIENCE_S = 60.0

Question = tuple[str, bytes]
"""Key below the cell's root, and payload."""


class Intruder:
    """Asks, and counts what comes back.

    Args:
        q_rad: where the arm rests. ``heard``: the payload of a reset that was accepted once.
    """

    def __init__(self, endpoint: str, cell_id: str, q_rad: Joints, heard: bytes, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._root = f"{topics.ROOT}/{cell_id}"
        self._q_rad, self._heard = q_rad, heard
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["{endpoint}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        self._session = zenoh.open(config)
        self.accepted = self.unanswered = 0
        self.by_code: Counter[str] = Counter()
        self.by_kind: Counter[str] = Counter()
        self.accepted_kinds: Counter[str] = Counter()
        self._kinds: dict[str, Callable[[], Question]] = {
            "malformed": self._malformed,
            "unauthorised": self._unauthorised,
            "stale": self._stale,
            "out_of_limits": self._out_of_limits,
            "replayed": lambda: ("command/reset", self._heard),
        }

    def attempt(self) -> None:
        """One question of a kind drawn at random."""
        kind = str(self._rng.choice(list(self._kinds)))
        key, payload = self._kinds[kind]()
        self.by_kind[kind] += 1
        replies = list(self._session.get(f"{self._root}/{key}", payload=payload, timeout=5.0))
        if not replies:
            self.unanswered += 1
        for reply in replies:
            code = self._code(reply)
            self.by_code[code] += 1
            if not code:
                self.accepted += 1
                self.accepted_kinds[kind] += 1

    def close(self) -> None:
        self._session.close()  # type: ignore[no-untyped-call]

    def _code(self, reply: zenoh.Reply) -> str:
        """The refusal's code; "" when it is none."""
        if reply.err is not None:
            try:
                return decode(ErrorReply, reply.err.payload.to_bytes()).code
            except BadPayload:
                return "TIMEOUT"
        assert reply.ok is not None
        try:
            return decode(CommandReply, reply.ok.payload.to_bytes()).code
        except BadPayload:
            return ""  # a device did what it was asked

    # --- the kinds ----------------------------------------------------------------------------------------------------

    def _malformed(self) -> Question:
        """Bytes, torn JSON, wrong types, unknown keys, numbers that are none."""
        good = encode(CommandRequest(command_id="1", client_id="intruder"))
        payloads = (
            self._rng.bytes(int(self._rng.integers(1, 200))),
            good[: int(self._rng.integers(1, len(good)))],
            b'{"client_id": ["intruder"]}',
            b'{"client_id": "../*", "cycles": 1}',
            b'{"force": true}',
            b'{"width_m": NaN, "speed_m_s": 1e999, "force_n": "NaN"}',
            b'{"cycles": -1}',
            b"[" * 5000,
            b'{"raw_q_rad": "AAAA", "window": 1}',
        )
        keys = (*(f"command/{verb}" for verb in COMMANDS), *_NODE_KEYS)
        return str(self._rng.choice(keys)), payloads[int(self._rng.integers(len(payloads)))]

    def _unauthorised(self) -> Question:
        """A well-formed motion command without a lease, or one that does not exist."""
        verb = str(self._rng.choice([*_MOVING, "dance"]))
        request = CommandRequest(command_id=str(self._rng.integers(10**6)), client_id="intruder")
        return f"command/{verb}", encode(request)

    def _stale(self) -> Question:
        """A motion that begins where the arm was, not where it is."""
        elsewhere = self._q_rad + self._rng.uniform(0.03, 0.5, 7) * self._rng.choice([-1, 1], 7)
        return topics.ARM_EXECUTE.key, encode(_line(elsewhere, elsewhere))

    def _out_of_limits(self) -> Question:
        """A motion no arm can make, or a grasp no hand can give."""
        if self._rng.random() < 0.3:
            force_n = float(self._rng.uniform(200, 900))
            return topics.HAND_GRASP.key, encode(HandGrasp(force_n=force_n, speed_m_s=0.05))
        target = self._q_rad + self._rng.uniform(0.3, 3.0, 7) * self._rng.choice([-1, 1], 7)
        return topics.ARM_EXECUTE.key, encode(_line(self._q_rad, target))


def _line(start: Joints, end: Joints) -> Trajectory:
    """From ``start`` to ``end`` in 50 ms."""
    share = np.linspace(0.0, 1.0, 50)[:, None]
    return Trajectory(raw_q_rad=start + share * (end - start), window=16)


def run(tries: int, seed: int, endpoint: str, tell: Callable[[str], None]) -> dict[str, Any]:
    """``tries`` questions to a simulated cell of its own that is Idle.

    Returns:
        accepted; crashes: nodes started again, questions without an answer, or a cell that is no longer Idle; by_code
        of the refusals; by_kind.
    """
    with TemporaryDirectory() as folder:
        station = load_station(None, [f"bus.endpoint={endpoint}", f"recording.folder={folder}"])
        with running_cell(station, lambda topic, message: None) as daemon, Bus.join(station.cell_id, endpoint) as bus:
            arm = RemoteArm(bus, station.bus.ask_timeout_s)
            arm.connect()
            heard = _accepted_reset(station.cell_id, endpoint)
            rest_q_rad = arm.state().q_rad
            intruder = Intruder(endpoint, station.cell_id, rest_q_rad, heard, seed)
            for number in range(1, tries + 1):
                intruder.attempt()
                if number % 500 == 0:
                    tell(f"{number}/{tries}: accepted {intruder.accepted}, unanswered {intruder.unanswered}")
            intruder.close()
            moved = not np.allclose(arm.state().q_rad, rest_q_rad, atol=_REST_RAD)
            restarts = sum(node.restarts for node in daemon.health().nodes.values())
            is_idle = daemon.machine.state == "Idle"
    return {
        "tries": tries,
        "accepted": intruder.accepted + moved,
        "crashes": restarts + intruder.unanswered + (not is_idle),
        "by_code": dict(intruder.by_code),
        "by_kind": dict(intruder.by_kind),
        "accepted_kinds": dict(intruder.accepted_kinds),
    }


def _accepted_reset(cell_id: str, endpoint: str) -> bytes:
    """The payload of a reset as its client sent it; the client is gone when this returns."""
    request = CommandRequest(command_id="heard", client_id="operator")
    with Bus.join(cell_id, endpoint) as bus:
        bus.announce(topics.LEASE, name="operator")
        reply = bus.request(topics.COMMAND, request, CommandReply, timeout_s=5.0, verb="reset")
        assert reply.ok, reply.reason
        _wait(lambda: bus.request(topics.STATE_NOW, Nothing(), CellState, timeout_s=5.0).state == "Idle")
    return encode(request)


def _wait(condition: Callable[[], bool]) -> None:
    give_up_s = time.monotonic() + _PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.05)

"""Queries that must not move anything: malformed, unauthorised, stale, out of limits, replayed, patterns, foreign."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import zenoh

from benchmarks.attacked import Attacked
from bus import topics
from bus.arrays import Joints
from bus.codec import decode, encode
from bus.commands import CommandRequest, ErrorReply, HandGrasp, HandMove, Nothing, PresentRequest
from bus.errors import BadPayload
from bus.frozen import Message
from bus.topics import encoding_of
from bus.trajectory import Trajectory
from cell.machine.states import COMMANDS

_MOVING = ("reset", "start", "pick", "unhold", "unsuspend")
_NODE_KEYS = tuple(topic.key for topic in (topics.ARM_EXECUTE, topics.HAND_MOVE, topics.HAND_GRASP))
_WITHOUT_CONTENT = (topics.ARM_STOP, topics.ARM_HOLD, topics.ARM_RESUME, topics.ARM_RECOVER, topics.HAND_HOME,
                    topics.HAND_STOP, topics.CAMERA_CAPTURE)  # fmt: skip
PATTERNS = ("**", "cell/**", "cell/{cell}/**", "cell/*/*", "cell/*/*/*", "*/*/hand/*", "cell/*/hand/*", "cell/*/arm/*",
             "cell/*/camera/*", "cell/*/sim/*", "cell/*/command/*", "cell/**/reset", "**/stop", "**/home", "**/execute",
             "**/recover", "cell/*/han$*/**", "cell/*/$*m/sto$*", "cell/*/hand/ho$*", "cell/s$*/**",
             "cell/*/comm$*/rese$*", "cell/*/arm/exec$*", "cell/{cell}/arm/**", "cell/*/hand/$*e")  # fmt: skip
_ACTING = {topic.key for topic in topics.TOPICS if topic.acts == "cell"} | {part.key for part in topics.FRAME_PARTS}
_STRANGERS = ("stranger", "stranger_named", "source_copied")
_TIMEOUT_S = 5.0


class Question(NamedTuple):
    """A whole Zenoh key, and what is sent with it."""

    key: str
    payload: bytes | None
    encoding: str | None = None
    source: zenoh.SourceInfo | None = None


class Questions:
    """Makes questions, asks them, and counts what comes back.

    Args:
        heard: the payload of a reset that was accepted once.
    """

    def __init__(self, cell: Attacked, session: zenoh.Session, heard: bytes, rng: np.random.Generator) -> None:
        self._cell, self._session, self._heard, self._rng = cell, session, heard, rng
        self.kinds: dict[str, Callable[[], Question]] = {
            "malformed": self._malformed,
            "unauthorised": self._unauthorised,
            "stale": self._stale,
            "out_of_limits": self._out_of_limits,
            "replayed": lambda: self._to("command/reset", self._heard),
            "wildcard": self._wildcard,
            "stranger": lambda: self._device(None),
            "stranger_named": lambda: self._device(self._session.id),
            "source_copied": lambda: self._device(self._cell.sources["cell"]),
        }

    def attempt(self, kind: str) -> None:
        """One question."""
        question, tally = self.kinds[kind](), self._cell.tally
        replies = self.ask(question)
        codes = [self._code(reply) for reply in replies]
        if not replies and kind in _STRANGERS:
            codes = ["DENIED"]  # the question did not get there; that is said at once
        elif not replies or "TIMEOUT" in codes:
            tally.crash(f"{kind} {question.key}: no answer")
        tally.by_code.update(code for code in codes if code)
        if "" in codes:
            tally.accept(kind, question.key.removeprefix(f"{self._cell.root}/"))
            self._cell.look()
        self._cell.require_idle(f"{kind} {question.key}")

    def ask(self, question: Question) -> list[zenoh.Reply]:
        """Everybody's replies."""
        options: dict[str, Any] = {}
        if question.encoding is not None:
            options["encoding"] = question.encoding
        if question.source is not None:
            options["source_info"] = question.source
        replies = self._session.get(
            question.key,
            payload=question.payload,
            timeout=_TIMEOUT_S,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            accept_replies=zenoh.ReplyKeyExpr.ANY,
            **options,
        )
        return list(replies)

    def _code(self, reply: zenoh.Reply) -> str:
        """The refusal's code, READ where nothing is done; "" when something was."""
        if reply.err is not None:
            try:
                return decode(ErrorReply, reply.err.payload.to_bytes()).code
            except BadPayload:
                return "TIMEOUT"
        assert reply.ok is not None
        key = str(reply.ok.key_expr).removeprefix(f"{self._cell.root}/")
        return "" if key in _ACTING or key.startswith("command/") else "READ"

    def _to(self, key: str, payload: bytes, encoding: str | None = None) -> Question:
        return Question(f"{self._cell.root}/{key}", payload, encoding)

    # --- what asks for something impossible ---------------------------------------------------------------------------

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
        return self._to(str(self._rng.choice(keys)), payloads[int(self._rng.integers(len(payloads)))])

    def _unauthorised(self) -> Question:
        """A well-formed motion command without a lease, as the cell itself, or one that does not exist."""
        verb = str(self._rng.choice([*_MOVING, "dance"]))
        client_id = str(self._rng.choice(["intruder", "cell", ""]))
        request = CommandRequest(command_id=str(self._rng.integers(10**6)), client_id=client_id)
        return self._to(f"command/{verb}", encode(request))

    def _stale(self) -> Question:
        """A motion that begins where the arm was, not where it is."""
        q_rad = self._cell.q_rad()
        elsewhere = q_rad + self._rng.uniform(0.03, 0.5, 7) * self._rng.choice([-1, 1], 7)
        return self._to(topics.ARM_EXECUTE.key, encode(_line(elsewhere, elsewhere, 50)))

    def _out_of_limits(self) -> Question:
        """A motion no arm can make, or a grasp no hand can give."""
        if self._rng.random() < 0.3:
            force_n = float(self._rng.uniform(200, 900))
            return self._to(topics.HAND_GRASP.key, encode(HandGrasp(force_n=force_n, speed_m_s=0.05)))
        q_rad = self._cell.q_rad()
        target = q_rad + self._rng.uniform(0.3, 3.0, 7) * self._rng.choice([-1, 1], 7)
        return self._to(topics.ARM_EXECUTE.key, encode(_line(q_rad, target, 50)))

    # --- what asks for something possible, and is not to ask ----------------------------------------------------------

    def _wildcard(self) -> Question:
        """A pattern that meets what acts, with or without a payload, of any source."""
        key = str(self._rng.choice(PATTERNS)).format(cell=self._cell.station.cell_id)
        ask = self._act()[1] if self._rng.random() < 0.3 else Nothing()
        payload, encoding = (encode(ask), encoding_of(type(ask))) if self._rng.random() < 0.6 else (None, None)
        sources = [None, self._session.id, self._cell.sources["cell"]]
        return Question(key, payload, encoding, self._numbered(sources[int(self._rng.integers(3))]))

    def _device(self, source: zenoh.EntityGlobalId | None) -> Question:
        """Return a question that makes a node act for its cell: the exact key, its payload and its encoding."""
        key, ask = self._act()
        return Question(f"{self._cell.root}/{key}", encode(ask), encoding_of(type(ask)), self._numbered(source))

    def _act(self) -> tuple[str, Message]:
        q_rad, rng = self._cell.q_rad(), self._rng
        acts: tuple[tuple[str, Message], ...] = (
            *((topic.key, Nothing()) for topic in _WITHOUT_CONTENT),
            (topics.ARM_EXECUTE.key, _line(q_rad, q_rad + np.array([0, 0, 0, 0, 0, 0, 0.03]), 1000)),
            (topics.HAND_MOVE.key, HandMove(width_m=float(rng.uniform(0.01, 0.07)), speed_m_s=0.1)),
            (topics.HAND_GRASP.key, HandGrasp(force_n=20.0, speed_m_s=0.1)),
            (topics.SIM_PRESENT.key, PresentRequest(object=None, cycle=0, seed=0)),
        )
        return acts[int(rng.integers(len(acts)))]

    def _numbered(self, source: zenoh.EntityGlobalId | None) -> zenoh.SourceInfo | None:
        return None if source is None else zenoh.SourceInfo(source, int(self._rng.integers(2**32)))


def _line(start: Joints, end: Joints, samples: int) -> Trajectory:
    """From ``start`` to ``end`` without a jump at either, in so many milliseconds."""
    t = np.linspace(0.0, 1.0, samples)[:, None]
    share = 10 * t**3 - 15 * t**4 + 6 * t**5
    return Trajectory(raw_q_rad=start + share * (end - start), window=16)

"""Intruders that answer beside the cell and its nodes, hold their tokens, or connect with their ids.

A false answer is believed when `cell.client.Client` returns it, or when the cell asked for it and went on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import zenoh

from benchmarks.attacked import Attacked, plain_session, wait_until
from benchmarks.forging import FORGED, NODE, Forging, await_arrival, forged
from bus import topics
from bus.codec import encode
from bus.commands import ErrorReply, Nothing
from bus.errors import CellError
from bus.frozen import Message
from bus.topics import encoding_of

_NOTICED_S = 2.0
_RESULT_S = 2.0
_ASKED = (topics.STATE_NOW, topics.HEALTH_NOW, topics.RESULT_NOW)
_WAYS = ("lie", "error", "silence")
_DEVICES = (*(topic for topic in topics.TOPICS if topic.acts == "cell"), topics.ARM_NOW, topics.HAND_NOW)
_NOT_BELIEVED_ANYWAY = {topics.ARM_STOP.key, topics.ARM_HOLD.key, topics.HAND_STOP.key}
"""A stop or hold is confirmed by the measured velocity, never by an answer."""
_TOKENS = ("lease/cell", f"node/{NODE}", "node/other", "lease/bench", "lease/operator")


class Rogues:
    """Pretends, and counts what is believed."""

    def __init__(self, cell: Attacked, session: zenoh.Session, forging: Forging, rng: np.random.Generator) -> None:
        self._cell, self._session, self._forging, self._rng = cell, session, forging, rng
        self.kinds: dict[str, Callable[[str], None]] = {
            "rogue_answer": self._answer,
            "rogue_device": self._serve_device,
            "token": self._token,
            "twin": self._twin,
            "same_id": self._same_id,
        }

    def attempt(self, kind: str) -> None:
        """One of them."""
        self.kinds[kind](kind)

    def _answer(self, kind: str) -> None:
        """Beside the cell, to its client."""
        cell, topic, way = self._cell, self._one_of(_ASKED), str(self._one_of(_WAYS))
        ask: dict[str, Callable[[], Message]] = {
            topics.STATE_NOW.key: cell.victim.state,
            topics.HEALTH_NOW.key: cell.victim.health,
            topics.RESULT_NOW.key: lambda: cell.victim.wait_for_result(cell.result.cycle_id, _RESULT_S),
        }
        key = self._one_of((topic.key, topic.key, "**"))
        with self._serving(key, forged(topic), way):
            try:
                told = ask[topic.key]()
            except CellError as error:
                self._code(error.code)
            else:
                if FORGED in told.model_dump_json():
                    cell.tally.accept(kind, f"{topic.key} ({way} on {key})")
                else:
                    self._code("TRUTH")
        cell.require_idle(f"{kind} {topic.key} ({way} on {key})")

    def _serve_device(self, kind: str) -> None:
        """Beside a node, to the cell: through a reset and, if it does not ask before, a pick."""
        cell, topic, way = self._cell, self._one_of(_DEVICES), str(self._one_of(_WAYS))
        cell.command("stop")
        cell.settle()
        with self._serving(topic.key, forged(topic), way) as asked:
            cell.command("reset")
            outcome = cell.settle()
            if outcome == "Idle" and not asked:
                outcome = self._pick()
            has_failed = cell.state == "Aborted" or outcome == "FAILED"
            reason = cell.daemon.publisher.state.reason
        if not asked:
            self._code("NOT_ASKED")
        elif has_failed or topic.key in _NOT_BELIEVED_ANYWAY:
            self._code("TWO_ANSWERS" if "None of them is believed" in reason else f"{topic.key} {outcome}")
        else:
            cell.tally.accept(kind, f"{topic.key} ({way}): {outcome}")
        cell.make_idle()

    def _pick(self) -> str:
        try:
            return self._cell.pick().result
        except CellError as error:
            return error.code
        finally:
            self._cell.settle()

    @contextmanager
    def _serving(self, key: str, lie: bytes, way: str) -> Iterator[list[str]]:
        """Answer on ``key`` below the cell's root; what is asked there."""
        asked: list[str] = []
        kept: list[zenoh.Query] = []

        def receive(query: zenoh.Query) -> None:
            asked.append(str(query.key_expr))
            if way == "silence":
                kept.append(query)
                return
            with query:
                if way == "error":
                    query.reply_err(encode(ErrorReply(code="HAND_FAULT", reason=FORGED)))
                else:
                    query.reply(query.key_expr, lie)

        is_complete = bool(self._rng.random() < 0.7)
        queryable = self._session.declare_queryable(f"{self._cell.root}/{key}", receive, complete=is_complete)
        await_arrival(self._cell, self._session)
        asked.clear()
        try:
            yield asked
        finally:
            queryable.undeclare()  # type: ignore[no-untyped-call]
            for query in kept:
                query.drop()  # type: ignore[no-untyped-call]

    def _token(self, kind: str) -> None:
        """A token of the cell, of its node, or of another client comes and goes."""
        cell, key = self._cell, str(self._one_of(_TOKENS))
        token = self._session.liveliness().declare_token(f"{cell.root}/{key}")
        await_arrival(cell, self._session)
        time.sleep(float(self._rng.uniform(0.0, 0.3)))
        token.undeclare()  # type: ignore[no-untyped-call]
        await_arrival(cell, self._session)
        time.sleep(0.2)
        nodes = cell.daemon.health().nodes
        if cell.victim.is_gone or not nodes[NODE].is_alive or len(nodes) != 1:
            cell.tally.accept(kind, key)
        else:
            self._code("IGNORED")
        cell.require_idle(f"{kind} {key}")

    def _twin(self, kind: str) -> None:
        """A second node of the name: its token, its answer, and what it says all the time."""
        cell, key = self._cell, topics.NODE_NOW.key.format(name=NODE)

        def is_noticed() -> bool:
            self._forging.put(topics.ARM_STATE)
            return cell.state == "Aborted"

        with self._serving(key, forged(topics.NODE_HEALTH), "lie"):
            token = self._session.liveliness().declare_token(f"{cell.root}/node/{NODE}")
            if wait_until(is_noticed, _NOTICED_S):
                self._code("NODE_LOST")
            else:
                cell.tally.accept(kind, "not noticed")
            token.undeclare()  # type: ignore[no-untyped-call]
        cell.make_idle()

    def _same_id(self, kind: str) -> None:
        """A session that opens with the id of the cell's, or of its node's."""
        cell, whose = self._cell, str(self._one_of(("cell", "node")))
        try:
            session = plain_session(cell.endpoint, str(cell.sources[whose].zid))
        except zenoh.ZError:
            self._code("NOT_CONNECTED")
        else:
            source = zenoh.SourceInfo(session.id, 1)
            replies = list(session.get(f"{cell.root}/{topics.HAND_STOP.key}", payload=encode(Nothing()), timeout=2.0,
                                       encoding=encoding_of(Nothing), source_info=source))  # fmt: skip
            if any(reply.ok is not None for reply in replies):
                cell.tally.accept(kind, f"as the {whose}")
            else:
                self._code("NOT_BELIEVED")
            session.close()  # type: ignore[no-untyped-call]
        time.sleep(_NOTICED_S)
        cell.require_idle(f"{kind} as the {whose}")

    def _code(self, code: str) -> None:
        self._cell.tally.by_code[code] += 1

    def _one_of(self, some: tuple[Any, ...]) -> Any:
        return some[int(self._rng.integers(len(some)))]

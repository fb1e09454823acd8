"""What the OPC UA door shows keeps the order in which the cell said it."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Any

import pytest

pytest.importorskip("asyncua")  # the extra `opcua`

from bus import topics
from bus.codec import encode
from bus.commands import CellState
from bus.frozen import Message
from bus.messages import CycleResult
from bus.messages.job import Job
from bus.sample import Sample
from bus.topics import Topic, encoding_of
from cell.machine.states import State
from cell.opcua.mirror import Mirror

RESULT = CycleResult(cycle_id="c1", object="cup", result="SUCCESS", code=None, reason="", stages={}, wall_s=2.0,
                     recording="c1.mcap", job=Job(job_id="j1"))  # fmt: skip


def _state(state: State) -> CellState:
    return CellState(state=state, stage="", cycle_id="c1", since_ns=1, available=(), reason="")


class Overtaken:
    """A viewer whose cell is silent, and ends its pick while it is asked: the answer comes before the messages."""

    is_gone = False

    def __init__(self) -> None:
        self.heard: deque[Sample] = deque()

    def next_heard(self, timeout_s: float) -> Sample | None:
        return self.heard.popleft() if self.heard else None

    def state(self) -> CellState:
        self._say(topics.RESULT, RESULT)
        self._say(topics.STATE, _state(State.COMPLETE))
        return _state(State.COMPLETE)

    def _say(self, topic: Topic, message: Message) -> None:
        self.heard.append(Sample(topic.key, encoding_of(topic.says), encode(message)))


class Written:
    """An address space that notes what is written, in order."""

    def __init__(self) -> None:
        self.values: list[tuple[str, Any]] = []

    async def write(self, values: dict[str, Any]) -> None:
        self.values += values.items()
        if ("Status.StateName", State.COMPLETE) in self.values:
            raise asyncio.CancelledError

    async def write_current_states(self, states: dict[str, str]) -> None: ...

    async def tell(self, *_event: Any) -> None: ...


def test_who_sees_a_pick_complete_sees_its_result_though_an_answer_overtook_it() -> None:
    written = Written()
    mirror = Mirror(written, Overtaken())  # type: ignore[arg-type]
    try:
        with pytest.raises(asyncio.CancelledError):
            asyncio.run(mirror.run())
    finally:
        mirror.close()
    shown = dict(written.values)  # until the state was
    assert shown.get("Result.JobId") == "j1"

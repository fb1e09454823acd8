"""Ctrl-C while a program waits for motion: the lease goes back, as nobody attends the motion any more."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import cast

import pytest

from bus import topics
from bus.codec import encode
from bus.commands import CellState
from bus.errors import CellUnreachable, ReplyTimeout
from bus.messages import CycleResult
from bus.sample import Sample
from cell.client import Client
from vlad_cell import Pick

STATE = CellState(state="Execute", stage="execute", cycle_id="c", since_ns=0, available=(), reason="")
RESULT = CycleResult(
    cycle_id="c", object="cup", result="SUCCESS", code=None, reason="Held.", stages={}, wall_s=1.0, recording=""
)


@dataclass
class Heard:
    """A client that hears this, one after the other; an error is raised. ``known``: what the cell says when asked."""

    said: list[CellState | CycleResult | BaseException | None] = field(default_factory=list)
    known: dict[str, CycleResult] = field(default_factory=dict)
    is_gone: bool = False
    is_released: bool = False

    def next_heard(self, timeout_s: float) -> Sample | None:
        if not self.said:
            return None
        said = self.said.pop(0)
        if isinstance(said, BaseException):
            raise said
        if said is None:
            return None
        topic = topics.STATE if isinstance(said, CellState) else topics.RESULT
        return Sample(topic.key, "", encode(said))

    def result(self, cycle_id: str) -> CycleResult | None:
        return self.known.get(cycle_id)

    def release(self) -> None:
        self.is_released = True

    def pick(self) -> Pick:
        return Pick(cast(Client, self), "c", "mine", 0)


def test_ctrl_c_gives_the_lease_back() -> None:
    heard = Heard([STATE, KeyboardInterrupt()])
    with pytest.raises(KeyboardInterrupt):
        heard.pick().wait()
    assert heard.is_released


def test_a_retry_is_followed_to_its_result_and_each_line_is_told_once() -> None:
    tried = RESULT.model_copy(update={"result": "FAILED", "retried_as": "d"})
    last = RESULT.model_copy(update={"cycle_id": "d"})
    lines: list[str] = []
    heard = Heard([STATE, STATE, tried, last])
    assert heard.pick().wait(progress=lines.append) == last
    assert lines == ["Execute execute", "FAILED cup: Held.", "SUCCESS cup: Held."] and not heard.is_released


def test_a_result_that_was_not_heard_is_asked_for() -> None:
    assert Heard([STATE, None], {"c": RESULT}).pick().wait() == RESULT


def test_a_wait_that_is_over_keeps_the_lease() -> None:
    heard = Heard([STATE])
    with pytest.raises(ReplyTimeout, match="Cycle c"):
        heard.pick().wait(timeout_s=0.0)
    assert not heard.is_released


def test_a_cell_that_is_gone_ends_the_wait() -> None:
    with pytest.raises(CellUnreachable):
        Heard([STATE], is_gone=True).pick().wait()

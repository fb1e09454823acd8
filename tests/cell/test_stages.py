"""What a stage gave may be published while the next one computes; the records stay in the order of the stages."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bus import topics
from bus.codes import Code
from bus.errors import CycleFailure
from bus.frozen import Message
from bus.messages import ArmMode, ArmState, StageName, View
from bus.topics import Topic
from cell.machine.gate import Gate
from cell.pick.stages import Stages

ARM = ArmState(stamp_ns=1, mode=ArmMode.IDLE, q_rad=np.zeros(7), dq_rad_s=np.zeros(7), tau_ext_nm=np.zeros(7))
VIEW = View(stamp_ns=1, arm=ARM, base_from_color=np.eye(4))


class Slow:
    """Publishes a capture only when the test lets it."""

    def __init__(self) -> None:
        self.may_publish = threading.Event()
        self.published: list[StageName] = []
        self.stages = Stages("c", self._publish, lambda _: None, cast(Any, SimpleNamespace(check=lambda: None)), Gate())

    def _publish(self, _topic: Topic, record: Message | bytes) -> None:
        stage = cast(Any, record).stage
        assert stage != "capture" or self.may_publish.wait(60)
        self.published.append(stage)


@pytest.fixture
def slow() -> Slow:
    slow = Slow()
    slow.stages.run("capture", topics.CAPTURE, lambda: VIEW, meanwhile=True)
    return slow


def test_the_next_stage_computes_before_the_record_is_out_and_its_own_follows(slow: Slow) -> None:
    def work() -> Any:
        assert slow.published == []
        slow.may_publish.set()
        raise CycleFailure(Code.NO_GRASP, "None.")

    with pytest.raises(CycleFailure, match="None"):
        slow.stages.run("plan", topics.PLAN, work)
    assert slow.published == ["capture", "plan"]


def test_the_end_of_a_cycle_waits_for_the_record(slow: Slow) -> None:
    threading.Timer(0.05, slow.may_publish.set).start()
    slow.stages.settle()
    assert slow.published == ["capture"]

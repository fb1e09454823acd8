"""What the daemon says of itself: who asked for the pick stands in every state of it."""

from __future__ import annotations

from typing import cast

from bus.commands import CellState
from bus.session import Bus
from cell.daemon.publisher import Publisher
from cell.machine.states import State
from logs.live_views import Views


class NoBus:
    def publish(self, *_: object) -> None: ...


def test_a_state_names_the_client_that_asked_also_when_only_the_queue_has_changed() -> None:
    said: list[object] = []
    asked_by = ["line-3"]
    publisher = Publisher(
        cast(Bus, NoBus()),
        Views(lambda q_rad: q_rad),
        lambda _topic, message: said.append(message),
        lambda: "c1",
        asked_by=lambda: asked_by[0],
    )
    publisher.publish_state(State.EXECUTE, "")
    publisher.publish_stage("capture")
    asked_by[0] = "line-4"
    publisher.publish_jobs()
    names = [one.asked_by for one in said if isinstance(one, CellState)]
    assert names == ["line-3", "line-3", "line-4"]

"""What the daemon says of itself: who asked for the pick stands in every state of it, and why it is held."""

from __future__ import annotations

from typing import cast

import pytest

from bus.commands import CellState
from bus.session import Bus
from cell.daemon.publisher import Publisher
from cell.machine.states import State
from logs.live_views import Views


class NoBus:
    def publish(self, *_: object) -> None: ...


def _publisher(said: list[object], asked_by: list[str]) -> Publisher:
    return Publisher(
        cast(Bus, NoBus()),
        Views(lambda q_rad: q_rad),
        lambda _topic, message: said.append(message),
        lambda: "c1",
        asked_by=lambda: asked_by[0],
    )


@pytest.mark.parametrize("state", [State.HOLDING, State.HELD, State.SUSPENDED, State.STOPPING, State.ABORTING])
def test_why_it_is_held_or_ends_is_said_also_when_a_stage_begins_meanwhile(state: State) -> None:
    """As the detection, which moves nothing."""
    publisher = _publisher([], ["line-3"])
    publisher.publish_state(State.EXECUTE, "")
    publisher.publish_state(state, "The lease of 'line-3' was lost.")
    publisher.publish_stage("detect")
    assert (publisher.state.stage, publisher.state.reason) == ("detect", "The lease of 'line-3' was lost.")


def test_a_motion_by_hand_ends_the_reason_of_the_rest() -> None:
    publisher = _publisher([], [""])
    publisher.publish_state(State.STOPPED, "The last pick was cut off.")
    publisher.publish_stage("jog")
    assert publisher.state.reason == ""


def test_a_state_names_the_client_that_asked_also_when_only_the_queue_has_changed() -> None:
    said: list[object] = []
    asked_by = ["line-3"]
    publisher = _publisher(said, asked_by)
    publisher.publish_state(State.EXECUTE, "")
    publisher.publish_stage("capture")
    asked_by[0] = "line-4"
    publisher.publish_jobs()
    names = [one.asked_by for one in said if isinstance(one, CellState)]
    assert names == ["line-3", "line-3", "line-4"]

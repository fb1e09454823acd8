"""A cell that has stopped says that something may be in its hand, for as long as that is so."""

from __future__ import annotations

import math
from typing import cast

import pytest

from bus import topics
from bus.codec import encode
from bus.commands import CellState, Event
from bus.messages import HandState
from bus.sample import Sample
from bus.session import Bus
from bus.topics import encoding_of
from cell.daemon.grip import Grip
from cell.daemon.in_hand import InHand
from cell.daemon.publisher import Publisher
from cell.machine.states import State, told
from config.load import load_station
from logs.live_views import Views
from logs.mcap.recover import Recovered
from logs.mcap.torn_reader import Losses

STATION = load_station()
ADVICE = "over a place, or while you hold the thing"


class NoBus:
    def publish(self, *_: object) -> None: ...


class Cell:
    """The publisher, and a hand that says its width; `turn` is what the machine's owner thread does all the time."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.states: list[CellState] = []
        self.grip = Grip(STATION.hand, STATION.verify.min_width_m)
        views = Views(lambda q_rad: q_rad)
        self.publisher = Publisher(
            cast(Bus, NoBus()), views, self._hear, lambda: "", in_hand=lambda: self._in_hand.tell()
        )
        self._in_hand = InHand(self.grip, self.publisher)

    def _hear(self, _topic: object, said: object) -> None:
        if isinstance(said, Event):
            self.events.append(said)
        elif isinstance(said, CellState):
            self.states.append(said)

    def hand_says(self, width_m: float, *, is_moving: bool = False) -> None:
        state = _hand(width_m).model_copy(update={"is_moving": is_moving})
        self._in_hand.hear(Sample(topics.HAND_STATE.key, encoding_of(HandState), encode(state)))

    def enter(self, state: State, reason: str = "") -> None:
        self.publisher.publish_state(state, reason)
        self.turn()

    def turn(self) -> None:
        self._in_hand.look(State(self.publisher.state.state))

    @property
    def reason(self) -> str:
        return self.publisher.state.reason


def _hand(width_m: float) -> HandState:
    return HandState(stamp_ns=0, width_m=width_m, is_moving=False, is_homed=True)


@pytest.fixture
def cell() -> Cell:
    return Cell()


def test_while_it_picks_nothing_is_said_and_once_it_stopped_its_state_and_one_event_say_it(cell: Cell) -> None:
    cell.grip.closes()
    cell.hand_says(0.066)
    cell.enter(State.EXECUTE)
    cell.enter(State.STOPPING, "command 'stop' from ann")
    assert cell.events == [] and "hand" not in cell.reason
    cell.enter(State.STOPPED)
    cell.turn()
    assert cell.reason.startswith("Something may be in the hand: its fingers are 66 mm apart.")
    assert ADVICE in cell.reason
    (event,) = cell.events
    assert (event.code, event.severity) == ("HAND_NOT_EMPTY", "warning")
    assert "66 mm" in event.text and ADVICE in event.advice


def test_fingers_that_close_by_hand_say_nothing_before_they_rest(cell: Cell) -> None:
    cell.enter(State.STOPPED)
    cell.grip.closes()
    cell.hand_says(0.077, is_moving=True)
    cell.turn()
    assert cell.events == [] and cell.reason == ""
    cell.hand_says(0.0)
    cell.turn()
    assert cell.events == [], "they closed on nothing"
    cell.hand_says(0.03)
    cell.turn()
    assert cell.reason.startswith("Something may be in the hand: its fingers are 30 mm apart.")


def test_an_abort_keeps_its_cause_before_it(cell: Cell) -> None:
    cell.grip.closes()
    cell.hand_says(0.066)
    cell.enter(State.ABORTED, "ARM_REFLEX: The arm stopped itself.")
    assert cell.reason.startswith("ARM_REFLEX: The arm stopped itself. Something may be in the hand")


def test_who_aborted_it_is_still_told_beside_it() -> None:
    by = "command 'abort' from ann-4711"
    assert told("Aborted", by) == "Aborted by ann-4711"
    assert told("Aborted", f"{by} Something may be.") == "Aborted by ann-4711. Something may be."
    assert told("Aborted", "command 'abort' from a client") == "Aborted by a client"


def test_it_goes_when_the_thing_does_and_the_state_says_so_by_itself(cell: Cell) -> None:
    cell.grip.closes()
    cell.hand_says(0.066)
    cell.enter(State.STOPPED)
    said = len(cell.states)
    cell.hand_says(0.067)
    cell.turn()
    assert len(cell.states) == said, "a millimetre is no news"
    cell.grip.moved(_hand(0.08), 0.08)
    cell.hand_says(0.08)
    cell.turn()
    assert cell.reason == "" and len(cell.states) == said + 1


def test_a_cell_that_was_killed_in_a_pick_says_it_when_it_starts(cell: Cell) -> None:
    cell.enter(State.STOPPED)
    assert cell.reason == "", "the hand has not said yet how it stands"
    cell.hand_says(0.066)
    cell.turn()
    assert "66 mm" in cell.reason and len(cell.events) == 1


def test_a_start_after_a_kill_names_the_pick_that_was_cut_off_until_somebody_commands(cell: Cell) -> None:
    cell.enter(State.STOPPED)
    names = ("20261130T101112000", "20261129T101112000")
    cell.publisher.publish_recovered(
        [Recovered(f"{one}.mcap.part", f"r/{one}.mcap", 9, Losses(), "torn") for one in names]
    )
    last = cell.events[-1]
    assert (last.code, last.severity) == ("PICK_CUT_OFF", "warning") and names[0] in last.text
    assert [event.code for event in cell.events].count("PICK_CUT_OFF") == 1
    cell.hand_says(0.066)
    cell.turn()
    assert cell.reason.startswith(last.text) and "66 mm" in cell.reason
    cell.enter(State.RESETTING)
    assert cell.reason == ""


def test_a_recording_that_had_only_to_be_renamed_was_of_a_whole_pick(cell: Cell) -> None:
    cell.enter(State.STOPPED)
    cell.publisher.publish_recovered([Recovered("a.mcap.part", "a.mcap", 9, Losses(), "finished")])
    assert [event.code for event in cell.events] == ["RECOVERED"] and cell.reason == ""


@pytest.mark.parametrize("width_m", [0.0, 0.002, 0.079, 0.08, math.nan])
def test_a_hand_that_is_closed_on_nothing_or_open_holds_nothing(cell: Cell, width_m: float) -> None:
    cell.hand_says(width_m)
    cell.enter(State.STOPPED)
    assert cell.reason == "" and cell.events == []


def test_fingers_that_opened_for_a_grasp_and_did_not_close_hold_nothing(cell: Cell) -> None:
    cell.grip.moved(_hand(0.05), 0.05)
    cell.hand_says(0.05)
    cell.enter(State.STOPPED)
    assert cell.reason == "" and cell.grip.let_go_m(0.05) is None

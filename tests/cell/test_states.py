"""The PackML table, checked against the standard's rules rather than against itself."""

from __future__ import annotations

import pytest

from bus.errors import Refused
from cell.machine.states import ANSWERS, COMMANDS, MANUAL_MOTIONS, NEXT, State, after_command, available
from docs.states_page import PAGE, page

ACTING = {"Resetting", "Starting", "Execute", "Completing", "Holding", "Unholding", "Suspending", "Unsuspending",
          "Stopping", "Aborting", "Clearing"}  # fmt: skip
WAITING = {"Stopped", "Idle", "Held", "Suspended", "Aborted", "Complete"}


def test_it_has_the_standards_17_states_and_9_commands_and_pick() -> None:
    assert {str(state) for state in State} == ACTING | WAITING and len(State) == 17
    assert set(COMMANDS) - {"pick"} == {"reset", "start", "stop", "hold", "unhold", "suspend", "unsuspend", "abort",
                                        "clear"}  # fmt: skip


def test_acting_states_end_by_themselves_and_only_they() -> None:
    assert {str(state) for state in NEXT} == ACTING


def test_stop_is_possible_wherever_something_may_move_but_not_while_aborting() -> None:
    for state in State:
        refused = state in {"Stopping", "Stopped", "Clearing", "Aborting", "Aborted"}
        assert ("stop" in available(state)) != refused


def test_abort_is_possible_everywhere_but_when_aborted() -> None:
    assert {state for state in State if "abort" not in available(state)} == {State.ABORTING, State.ABORTED}


def test_a_hold_is_possible_where_a_cycle_moves_and_ends_only_by_unhold_stop_or_abort() -> None:
    assert {state for state in State if "hold" in available(state)} == {State.EXECUTE, State.COMPLETING}
    assert {state for state in State if "unhold" in available(state)} == {State.HELD}
    assert available(State.HELD) == ("stop", "abort", "unhold")
    assert State.HELD not in NEXT


def test_a_suspension_is_possible_in_execute_and_ends_only_by_unsuspend_stop_or_abort() -> None:
    assert {state for state in State if "suspend" in available(state)} == {State.EXECUTE}
    assert available(State.SUSPENDED) == ("stop", "abort", "unsuspend")


def test_from_aborted_three_deliberate_acts_lead_to_motion() -> None:
    state = State.ABORTED
    acts = 0
    for command in ("clear", "reset", "start"):
        assert all(after_command(state, other) for other in available(state))
        assert available(state)[0] == command or command in available(state)
        state = after_command(state, command)
        acts += 1
        while state in NEXT and state is not State.STARTING:
            state = NEXT[state]
    assert (acts, state) == (3, State.STARTING)


def test_every_state_can_be_reached_from_stopped() -> None:
    reached, todo = {State.STOPPED}, [State.STOPPED]
    while todo:
        state = todo.pop()
        arrows = [after_command(state, command) for command in available(state)]
        for following in [*arrows, *([NEXT[state]] if state in NEXT else [])]:
            if following not in reached:
                reached.add(following)
                todo.append(following)
    assert reached == set(State)


@pytest.mark.parametrize("state", list(State))
@pytest.mark.parametrize("command", list(COMMANDS))
def test_a_command_is_accepted_or_refused_with_reason_and_alternatives(state: State, command: str) -> None:
    if command in available(state):
        assert after_command(state, command) is not state
        return
    with pytest.raises(Refused) as refusal:
        after_command(state, command)
    assert refusal.value.code == "WRONG_STATE" and refusal.value.available == available(state)
    assert str(state) in refusal.value.text and refusal.value.advice


@pytest.mark.parametrize("state", [State.EXECUTE, State.RESETTING, State.STARTING])
def test_a_pick_that_comes_while_the_cell_works_is_told_of_the_queue(state: State) -> None:
    with pytest.raises(Refused, match=r"send .* job with queue"):
        after_command(state, "pick")


def test_an_unknown_command_lists_the_known_ones() -> None:
    with pytest.raises(Refused) as refusal:
        after_command(State.IDLE, "dance")
    assert refusal.value.code == "UNKNOWN_COMMAND"
    listed = refusal.value.advice.removeprefix("Commands: ").removesuffix(".").split(", ")
    assert set(listed) == {*COMMANDS, "cancel", *ANSWERS, "mode", *MANUAL_MOTIONS}


def test_the_page_of_the_states_is_written_from_the_table() -> None:
    assert PAGE.read_text() == page(), "run: just docs"

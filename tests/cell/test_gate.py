"""The gate every motion passes: held it waits, halted it turns away, whoever comes first."""

from __future__ import annotations

import threading

from cell.machine.gate import Gate


class Comer:
    """Somebody who wants to move, in a thread of its own."""

    def __init__(self, gate: Gate) -> None:
        self._gate = gate
        self.answered = threading.Event()
        self.may_begin: bool | None = None
        self._thread = threading.Thread(target=self._move, daemon=True)
        self._thread.start()

    def _move(self) -> None:
        with self._gate.motion() as self.may_begin:
            self.answered.set()

    def answer(self) -> bool | None:
        assert self.answered.wait(60)
        self._thread.join(60)
        return self.may_begin


def test_open_it_lets_through_and_counts_what_moves() -> None:
    gate = Gate()
    with gate.motion() as may_begin:
        assert may_begin and gate.is_moving and not gate.wait_still(0.001)
    assert not gate.is_moving and gate.wait_still(0.0)


def test_held_it_waits_until_let_go() -> None:
    gate = Gate()
    gate.hold()
    comer = Comer(gate)
    assert not comer.answered.wait(0.05) and not gate.is_moving
    gate.release()
    assert comer.answer() is True


def test_a_halt_turns_away_whoever_waits_and_whoever_comes() -> None:
    gate = Gate()
    gate.hold()
    waiting = Comer(gate)
    gate.halt()
    assert waiting.answer() is False and Comer(gate).answer() is False
    gate.release()
    assert gate.halted and Comer(gate).answer() is False


def test_cleared_it_is_open_after_a_hold_and_a_halt() -> None:
    gate = Gate()
    gate.hold()
    gate.halt()
    gate.clear()
    assert not gate.halted and Comer(gate).answer() is True


def test_a_motion_that_fails_is_over() -> None:
    gate = Gate()
    try:
        with gate.motion():
            raise ValueError
    except ValueError:
        pass
    assert not gate.is_moving

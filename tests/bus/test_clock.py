"""Deadlines of real devices are wall time; those of a simulation wait for the machine, and run out all the same."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.clock import StarvedClock, WallClock
from bus.starvation import Starvation

IDLE, STARVED = Starvation(1.0, 1.0, 2), Starvation(10.0, 14.0, 2)


class Machine:
    """Its wall clock, and how busy it is."""

    def __init__(self) -> None:
        self.wall_s = 100.0
        self.starvation = IDLE
        self.clock = StarvedClock(lambda: self.wall_s, lambda: self.starvation)

    def passes(self, wall_s: float) -> float:
        """How much of its clock's time passes meanwhile; it is looked at and measured all along."""
        began_s = self.clock.now_s()
        for _ in range(round(wall_s / 0.2)):
            for _ in range(4):
                self.wall_s += 0.05
                self.clock.now_s()
            self.clock.tick()
        return self.clock.now_s() - began_s


@pytest.fixture
def machine() -> Machine:
    return Machine()


@pytest.mark.parametrize("slowdown", [1.0, 1.9])
def test_where_the_load_is_a_cells_own_its_time_is_wall_time(machine: Machine, slowdown: float) -> None:
    machine.starvation = Starvation(slowdown, 3.0, 2)
    assert machine.passes(3.0) == pytest.approx(3.0)


def test_where_a_second_of_work_takes_ten_so_does_a_second_of_patience(machine: Machine) -> None:
    machine.starvation = STARVED
    machine.clock.tick()
    assert machine.passes(50.0) == pytest.approx(5.0)


def test_a_machine_that_becomes_busy_or_idle_is_noticed_at_the_next_measurement(machine: Machine) -> None:
    machine.passes(3.0)
    machine.starvation = STARVED
    assert machine.passes(3.0) < 0.2 + 0.3
    machine.starvation = IDLE
    assert machine.passes(3.0) > 3.0 - 0.2


def test_time_in_which_nothing_is_measured_does_not_count(machine: Machine) -> None:
    """The process stood still, or waited for its turn: it has not heard yet what was said meanwhile."""
    began_s = machine.clock.now_s()
    machine.wall_s += 60.0
    machine.clock.tick()
    assert machine.clock.now_s() - began_s < 0.5


@given(st.lists(st.tuples(st.floats(0.0, 5.0), st.floats(1.0, 200.0), st.booleans()), max_size=40))
def test_its_time_never_goes_back_and_never_overtakes_the_wall_clock(
    steps: list[tuple[float, float, bool]],
) -> None:
    machine = Machine()
    began_s, began_wall_s = machine.clock.now_s(), machine.wall_s
    for wall_s, slowdown, is_measured in steps:
        before_s = machine.clock.now_s()
        machine.wall_s += wall_s
        machine.starvation = Starvation(slowdown, 1.0, 2)
        if is_measured:
            machine.clock.tick()
        assert machine.clock.now_s() >= before_s
        assert machine.clock.now_s() - began_s <= machine.wall_s - began_wall_s + 1e-9


def test_a_wait_ends_with_what_it_waits_for(machine: Machine) -> None:
    looks = iter([False, False, True])
    assert machine.clock.wait_for(lambda _seconds: next(looks), 1.0)


def test_a_wait_for_what_never_comes_ends_and_later_where_the_machine_is_busy(machine: Machine) -> None:
    def never(seconds: float) -> bool:
        machine.wall_s += seconds
        machine.clock.tick()
        return False

    began_s = machine.wall_s
    assert not machine.clock.wait_for(never, 2.0)
    idle_s, began_s = machine.wall_s - began_s, machine.wall_s
    machine.starvation = STARVED
    assert not machine.clock.wait_for(never, 2.0)
    assert idle_s == pytest.approx(2.0, abs=0.11)
    assert machine.wall_s - began_s == pytest.approx(20.0, abs=0.11)


def test_a_real_devices_deadline_is_waited_for_in_one_piece_whatever_the_load(machine: Machine) -> None:
    clock = WallClock(lambda: machine.wall_s, lambda: STARVED)
    asked: list[float] = []
    assert not clock.wait_for(asked.append, 2.0)
    assert asked == [2.0]
    began_s = clock.now_s()
    machine.wall_s += 3.0
    assert clock.now_s() - began_s == pytest.approx(3.0)


def test_both_excuse_who_is_late_on_a_busy_machine_and_nobody_on_an_idle_one(machine: Machine) -> None:
    assert (machine.clock.busy_note(), WallClock(load=lambda: IDLE).busy_note()) == ("", "")
    machine.starvation = STARVED
    machine.clock.tick()
    assert "a second of work takes 10 s" in machine.clock.busy_note()
    assert WallClock(load=lambda: Starvation(1.0, 14.0, 2)).busy_note() == (
        " This machine is too busy: load 14.0 on 2 cores."
    )

"""A node's loops: they keep their rate, leave rounds out rather than pile them up, and tell the truth about it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from bus.errors import BusError, CellError, DeviceLost
from drivers.node.loops import Loop


def _until(condition: Callable[[], bool]) -> None:
    give_up_s = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.01)


def test_a_loop_runs_at_about_its_rate_and_says_so() -> None:
    loop = Loop("state", 0.02, lambda: None, lambda error: None)
    _until(lambda: loop.health().rate_hz > 30)
    assert loop.health().rate_hz <= 51 and loop.health().target_hz == 50
    loop.close()


def test_a_loop_that_hangs_shows_it_by_its_rate_and_counts_what_it_left_out() -> None:
    hang, hangs = threading.Event(), threading.Event()

    def act() -> None:
        hangs.set()
        hang.wait(60)

    loop = Loop("state", 0.02, act, lambda error: None)
    assert hangs.wait(60)
    assert loop.health().rate_hz == 0
    time.sleep(0.2)  # nine rounds and more that cannot begin
    hang.set()
    _until(lambda: loop.health().rate_hz > 0)
    assert loop.health().missed >= 8
    loop.close()


def test_errors_are_told_and_the_next_round_tries_again() -> None:
    errors: list[CellError] = []

    def act() -> None:
        raise DeviceLost("Gone.")

    loop = Loop("state", 0.01, act, errors.append)
    _until(lambda: len(errors) >= 3)
    assert loop.health().rate_hz == 0
    loop.close()


def test_a_closed_bus_ends_a_loop() -> None:
    rounds: list[None] = []

    def act() -> None:
        rounds.append(None)
        raise BusError("Closed.")

    loop = Loop("state", 0.001, act, lambda error: None)
    loop.close(10)
    assert len(rounds) <= 1

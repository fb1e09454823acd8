"""Who should be heard and is not, is missed; time in which we stood still ourselves does not count."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.silence import Silence

LIMIT_S, LOOK_S = 0.5, 0.05


class Clock:
    """Time as the test wants it."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_silence_is_broken_after_its_limit_and_not_before(clock: Clock) -> None:
    silence = Silence(LIMIT_S, LOOK_S, clock)
    looks = []
    for _ in range(14):
        clock.now_s += LOOK_S
        looks.append(silence.is_broken())
    assert looks.index(True) in (9, 10) and all(looks[10:])
    silence.hear()
    assert not silence.is_broken()


@given(st.lists(st.floats(0.01, 0.45), min_size=1, max_size=40))
def test_who_is_heard_often_enough_is_never_missed(pauses_s: list[float]) -> None:
    clock = Clock()
    silence = Silence(LIMIT_S, LOOK_S, clock)
    for pause_s in pauses_s:
        until_s = clock.now_s + pause_s
        while clock.now_s < until_s:
            clock.now_s = min(until_s, clock.now_s + LOOK_S)
            assert not silence.is_broken()
        silence.hear()


@given(st.floats(0.2, 1e4))
def test_a_look_that_comes_late_forgives_its_own_lateness(frozen_s: float) -> None:
    clock = Clock()
    silence = Silence(LIMIT_S, LOOK_S, clock)
    clock.now_s += frozen_s
    assert not silence.is_broken()

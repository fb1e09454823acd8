"""How a program that serves is asked to end."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from cell.terminal.signals import ENDING, ending, on_end


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    """Whatever a test does to them, they are as before."""
    before = {number: signal.getsignal(number) for number in ENDING}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", ENDING)
def test_each_of_them_asks_for_the_end(number: signal.Signals) -> None:
    asked: list[None] = []
    on_end(lambda: asked.append(None))
    signal.raise_signal(number)
    assert len(asked) == 1


def test_a_closed_terminal_sends_several_and_none_of_them_ends_at_once() -> None:
    asked: list[None] = []
    on_end(lambda: asked.append(None), insists=True)
    for _ in range(3):
        signal.raise_signal(signal.SIGHUP)
    assert len(asked) == 3 and signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_who_insists_ends_it_at_once(number: signal.Signals) -> None:
    on_end(lambda: None, insists=True)
    signal.raise_signal(number)
    assert signal.getsignal(number) is signal.SIG_DFL


def test_nohup_is_kept() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    on_end(lambda: None)
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


def test_what_held_before_holds_after() -> None:
    before = signal.getsignal(signal.SIGINT)
    with ending(lambda: None):
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before

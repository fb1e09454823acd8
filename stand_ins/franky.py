"""The package ``franky`` as far as the hand's driver uses it: a hand whose every answer a test can set."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any


class FrankyError(Exception):
    """As ``franky.Exception``."""


class NetworkError(FrankyError):
    """As ``franky.NetworkException``."""


@dataclass
class FakeHand:
    """The hand behind every connection.

    Attributes:
        answers: how it says its state; raises what a test wants.
        during: called in the middle of each command. ``done``: what commands are answered with.
        connections, refusing: how often it was connected to, and why it is not any more.
        deaf_stops: so many stops are lost on it. ``asked``: the commands it was given.
    """

    width_m: float = 0.04
    answers: Callable[[FakeHand], Any] = lambda hand: SimpleNamespace(width=hand.width_m, max_width=0.08)
    during: Callable[[], object] = lambda: None
    done: bool = True
    deaf_stops: int = 0
    connections: int = 0
    refusing: Exception | None = None
    asked: list[str] = field(default_factory=list)
    stopped: threading.Event = field(default_factory=threading.Event)

    def package(self) -> Any:
        """Return what ``import franky`` would give."""

        def connect(_address: str) -> _Gripper:
            if self.refusing is not None:
                raise self.refusing
            self.connections += 1
            return _Gripper(self)

        return SimpleNamespace(Exception=FrankyError, NetworkException=NetworkError, Gripper=connect)


class _Gripper:
    def __init__(self, hand: FakeHand) -> None:
        self._hand = hand

    @property
    def state(self) -> Any:
        return self._hand.answers(self._hand)

    def _do(self, name: str, width_m: float) -> bool:
        self._hand.asked.append(name)
        self._hand.during()
        if self._hand.done:
            self._hand.width_m = width_m
        return self._hand.done

    def homing(self) -> bool:
        return self._do("homing", 0.08)

    def move(self, width_m: float, _speed_m_s: float) -> bool:
        return self._do("move", width_m)

    def grasp(self, width_m: float, *_: float) -> bool:
        return self._do("grasp", width_m)

    def stop(self) -> None:
        self._hand.asked.append("stop")
        if self._hand.deaf_stops > 0:
            self._hand.deaf_stops -= 1
        else:
            self._hand.stopped.set()

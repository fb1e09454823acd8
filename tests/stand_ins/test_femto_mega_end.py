"""The camera's stand-in ends with all that it began: nothing draws any more while Python shuts down."""

from __future__ import annotations

import io
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from stand_ins.femto_mega import __main__ as stand_in
from stand_ins.femto_mega.device import Exposure


def test_the_thread_that_draws_has_ended_when_serving_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    drawing: list[threading.Thread] = []

    def exposures() -> Iterator[Exposure]:
        while True:
            drawing.append(threading.current_thread())
            yield Exposure(np.zeros((720, 1280, 3), np.uint8), np.zeros((576, 640), np.uint16), 0.0)

    monkeypatch.setattr(stand_in, "Server", lambda *_: None)
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    stand_in.serve("127.0.0.1", exposures())
    assert drawing and not drawing[0].is_alive()

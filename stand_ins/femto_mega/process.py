"""Starts the camera stand-in as a process, and injects its faults."""

from __future__ import annotations

import subprocess
import sys
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from config.hardware import FemtoMegaSettings
from drivers.femto_mega.camera import FemtoMega


def no_extensions() -> Path:
    """An empty folder for the SDK's extensions: their licence is for Orbbec's own cameras. Skips without the SDK."""
    if find_spec("pyorbbecsdk") is None:
        pytest.skip("no Femto Mega: pyorbbecsdk is not installed: `just stand-ins` does it (Python up to 3.13)")
    return _empty


def femto_mega(stack: ExitStack, **settings: Any) -> FemtoMega:
    """The driver, not yet connected, of a stand-in that runs as long as ``stack``."""
    extensions = no_extensions()
    fake = stack.enter_context(FakeFemtoMega())
    return FemtoMega(FemtoMegaSettings(address=fake.host, extensions=extensions, **settings))


_folder = TemporaryDirectory(prefix="no-extensions-")
_empty = Path(_folder.name)  # one for the process, as the SDK's context is


class FakeFemtoMega:
    """The stand-in as a process; a context manager.

    Args:
        host: its own loopback address, because the ports are fixed.
        module: what is run, with the host as its argument, and further ones.
    """

    def __init__(self, host: str = "127.0.0.20", module: str = "stand_ins.femto_mega", *further: str) -> None:
        self.host, self._command = host, [sys.executable, "-m", module, host, *further]

    def __enter__(self) -> FakeFemtoMega:
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        self._expect("serving")
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(10)
        self._process.stdout.close()

    def fault(self, words: str) -> None:
        """One line of what `stand_ins.femto_mega.__main__` understands; returns when it is in effect."""
        assert self._process.stdin is not None
        self._process.stdin.write(words + "\n")
        self._process.stdin.flush()
        self._expect("done")

    def _expect(self, line: str) -> None:
        assert self._process.stdout is not None
        said = self._process.stdout.readline().strip()
        assert said == line, f"the stand-in said {said!r}, not {line!r}"

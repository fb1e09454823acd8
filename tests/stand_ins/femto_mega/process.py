"""Starts the stand-in and makes it misbehave."""

from __future__ import annotations

import subprocess
import sys


class FakeFemtoMega:
    """The stand-in as a process; a context manager.

    Args:
        host: its own loopback address, because the ports are fixed.
        module: what is run: a module that takes the host as its argument and serves.
    """

    def __init__(self, host: str = "127.0.0.20", module: str = "tests.stand_ins.femto_mega") -> None:
        self.host, self._module = host, module

    def __enter__(self) -> FakeFemtoMega:
        self._process = subprocess.Popen(
            [sys.executable, "-m", self._module, self.host], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._expect("serving")
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(10)
        self._process.stdout.close()

    def fault(self, words: str) -> None:
        """One line of what `tests.stand_ins.femto_mega.__main__` understands; returns when it is in effect."""
        assert self._process.stdin is not None
        self._process.stdin.write(words + "\n")
        self._process.stdin.flush()
        self._expect("done")

    def _expect(self, line: str) -> None:
        assert self._process.stdout is not None
        said = self._process.stdout.readline().strip()
        assert said == line, f"the stand-in said {said!r}, not {line!r}"

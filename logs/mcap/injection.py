"""A disk that misbehaves on demand, under the recorder's files."""

from __future__ import annotations

import errno
import os
from typing import BinaryIO

from bus.injection import Fault, Faulty


class FaultyDisk(Faulty):
    """Wraps the files of a `logs.mcap.recorder.Recorder`: each write is spoiled.

    ``off``: an I/O error. ``stuck``: it does not return. ``garbage``: other bytes are written. ``wrong``: the disk is
    full. ``slow``: it takes ``delay_s`` longer. What reads the file is not spoiled.
    """

    def __init__(self, fault: Fault = Fault.NONE, *, delay_s: float = 1.0) -> None:
        super().__init__(fault, delay_s)

    def under(self, file: BinaryIO) -> FaultyFile:
        """The file, on this disk."""
        return FaultyFile(file, self)

    def take(self, data: bytes) -> bytes:
        """What is really written of ``data``, after as long as that takes. Raises: OSError."""
        with self._turn:
            self._turn.wait_for(lambda: self._fault is not Fault.STUCK)
            self._turn.wait_for(lambda: self._fault is not Fault.SLOW, self.delay_s)
            fault = self._fault
        if fault in (Fault.OFF, Fault.WRONG):
            number = errno.EIO if fault is Fault.OFF else errno.ENOSPC
            raise OSError(number, f"{os.strerror(number)} (injected fault)")
        return bytes(255 - byte for byte in data[:64]) + data[64:] if fault is Fault.GARBAGE else data


class FaultyFile:
    """As much of a binary file as the recorder uses."""

    def __init__(self, file: BinaryIO, disk: FaultyDisk) -> None:
        self._file, self._disk = file, disk

    def write(self, data: bytes) -> int:
        return self._file.write(self._disk.take(bytes(data)))

    def flush(self) -> None:
        self._file.flush()

    def fileno(self) -> int:
        return self._file.fileno()

    def close(self) -> None:
        self._file.close()

    @property
    def closed(self) -> bool:
        return self._file.closed

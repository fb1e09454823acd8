"""Fault injection for the disk: a wrapper of the recorder's files that misbehaves on demand."""

from __future__ import annotations

import errno
import os
from typing import BinaryIO

from bus.fault_injection import Fault
from bus.faulty_bus import Faulty


class FaultyDisk(Faulty):
    """Wraps the files of a `logs.mcap.recorder.Recorder`; every write suffers the injected fault.

    ``off``: an I/O error. ``stuck``: the write does not return. ``garbage``: other bytes are written. ``wrong``: the
    disk
    is full. ``slow``: the write takes ``delay_s`` longer. Reads are not affected.
    """

    def __init__(self, fault: Fault = Fault.NONE, *, delay_s: float = 1.0) -> None:
        super().__init__(fault, delay_s)

    def under(self, file: BinaryIO) -> FaultyFile:
        """``file`` with this disk's faults."""
        return FaultyFile(file, self)

    def take(self, data: bytes) -> bytes:
        """Return the bytes to write instead of ``data``, after the fault's delay. Raises: OSError."""
        with self._turn:
            self._turn.wait_for(lambda: self._fault is not Fault.STUCK)
            self._turn.wait_for(lambda: self._fault is not Fault.SLOW, self.delay_s)
            fault = self._fault
        if fault in (Fault.OFF, Fault.WRONG):
            number = errno.EIO if fault is Fault.OFF else errno.ENOSPC
            raise OSError(number, f"{os.strerror(number)} (injected fault)")
        return bytes(255 - byte for byte in data[:64]) + data[64:] if fault is Fault.GARBAGE else data


class FaultyFile:
    """The part of a binary file's interface that the recorder uses, with the disk's faults."""

    def __init__(self, file: BinaryIO, disk: FaultyDisk) -> None:
        self._file, self._disk = file, disk

    def write(self, data: bytes) -> int:
        """Write ``data`` with the fault applied; return the number of bytes. Raises: OSError."""
        return self._file.write(self._disk.take(bytes(data)))

    def flush(self) -> None:
        """Flush the file."""
        self._file.flush()

    def fileno(self) -> int:
        """Return the file's descriptor."""
        return self._file.fileno()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def closed(self) -> bool:
        """True when the file is closed."""
        return self._file.closed

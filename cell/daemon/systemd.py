"""Tells systemd how the cell is, over the socket it names in NOTIFY_SOCKET (sd_notify); nothing where there is none."""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import contextmanager

from bus.commands import CellState, CommandRequest
from bus.frozen import Message
from bus.messages import CycleResult
from cell.machine.owner import Machine

_log = logging.getLogger(__name__)
_SEND_TIMEOUT_S = 1.0


class Service:
    """One process's side of ``Type=notify``; every member does nothing where no socket was named.

    Args:
        environment: its NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID are taken out: they are not for child processes.
    """

    def __init__(self, environment: MutableMapping[str, str]) -> None:
        self._address = environment.pop("NOTIFY_SOCKET", "")
        usec, pid = environment.pop("WATCHDOG_USEC", "0"), environment.pop("WATCHDOG_PID", "")
        is_ours = self._address != "" and pid in ("", str(os.getpid()))
        self.stroke_period_s = int(usec) / 2e6 if is_ours and usec.isdecimal() else 0.0
        self._stroked_s = -float("inf")
        self._is_alive: Callable[[], bool] = lambda: False

    @contextmanager
    def around(self, is_alive: Callable[[], bool]) -> Iterator[None]:
        """Around the loop that follows a running cell: ready, and in the end stopping.

        In between `turn` strokes the watchdog, while ``is_alive``; not at all while that does not return.
        """
        self._is_alive = is_alive
        self._send("READY=1")
        try:
            yield
        finally:
            # with a last stroke, because the controlled stop that follows may take a while
            self._send("STOPPING=1\nSTATUS=controlled stop" + "\nWATCHDOG=1" * (self.stroke_period_s > 0.0))

    def turn(self, said: Message | bytes | None) -> None:
        """One turn of the loop that follows the daemon, with what was said, if anything was."""
        if isinstance(said, CellState):
            self._send(f"STATUS={_status(said)}")
        elif isinstance(said, CycleResult):
            self._send(f"STATUS={' '.join([said.result, said.code or '', said.object]).strip()}")
        now_s = time.monotonic()
        if 0.0 < self.stroke_period_s <= now_s - self._stroked_s and self._is_alive():
            self._stroked_s = now_s
            self._send("WATCHDOG=1")

    def _send(self, lines: str) -> None:
        """A cell goes on where its service manager does not listen."""
        if not self._address:
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
                out.settimeout(_SEND_TIMEOUT_S)
                out.sendto(lines.encode(), address)
        except OSError as error:
            _log.warning("systemd does not hear us at %s: %s", self._address, error)


def takes_commands(machine: Machine) -> bool:
    """Whether the thread that owns the machine still answers; while it hangs, this does not return.

    It is asked for a command that does not exist, which it refuses in every state, and which leaves nothing behind.
    """
    return machine.command("watchdog", CommandRequest(client_id="watchdog")).code == "UNKNOWN_COMMAND"


def _status(state: CellState) -> str:
    """One line: ``Execute, plan, cycle 20261123T104703818``."""
    cycle = f"cycle {state.cycle_id}" if state.cycle_id else ""
    return ", ".join(part for part in (state.state, state.stage, cycle, " ".join(state.reason.split())) if part)

"""Reports the cell's state to systemd, over the socket in NOTIFY_SOCKET (sd_notify); does nothing without one."""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import contextmanager

from bus.codes import title_of
from bus.commands import CellState, CommandRequest
from bus.frozen import Message
from bus.messages import CycleResult
from cell.machine.owner import Machine

_log = logging.getLogger(__name__)
_SEND_TIMEOUT_S = 1.0


class Service:
    """The service side of ``Type=notify``; every member does nothing when no socket is named.

    Args:
        environment: NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID are removed from it: child processes must not use
            them.
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
        """Context around the loop that follows a running cell: reports ready, and at the end stopping.

        In between, `turn` resets the watchdog while ``is_alive``; the watchdog expires while that call does not return.
        """
        self._is_alive = is_alive
        self._send("READY=1")
        try:
            yield
        finally:
            # with a last watchdog reset, because the controlled stop that follows may take a while
            self._send("STOPPING=1\nSTATUS=controlled stop" + "\nWATCHDOG=1" * (self.stroke_period_s > 0.0))

    def turn(self, said: Message | bytes | None) -> None:
        """One turn of the loop that follows the daemon, with its message, if any."""
        if isinstance(said, CellState):
            self._send(f"STATUS={_status(said)}")
        elif isinstance(said, CycleResult):
            self._send(f"STATUS={title_of(said.result, said.code or '', said.object)}")
        now_s = time.monotonic()
        if 0.0 < self.stroke_period_s <= now_s - self._stroked_s and self._is_alive():
            self._stroked_s = now_s
            self._send("WATCHDOG=1")

    def _send(self, lines: str) -> None:
        """Send to the service manager; errors are ignored, because the cell works without it."""
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
    """True when the machine's owner thread answers; while that hangs, this call does not return.

    It sends an unknown command, which is refused in every state and has no effect.
    """
    return machine.command("watchdog", CommandRequest(client_id="watchdog")).code == "UNKNOWN_COMMAND"


def _status(state: CellState) -> str:
    """One line: ``Execute, plan, cycle 20261123T104703818``."""
    cycle = f"cycle {state.cycle_id}" if state.cycle_id else ""
    return ", ".join(part for part in (state.state, state.stage, cycle, " ".join(state.reason.split())) if part)

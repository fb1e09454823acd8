"""Sends commands for somebody who attends the motion; each has a connection of its own, and with it a lease."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack

from bus.commands import CellState, CommandReply, CommandRequest
from bus.errors import Refused
from cell.client import Client
from cell.machine.states import SETTLED


class Commander:
    """Holds the lease from the first motion command until that motion is over.

    Args:
        connect: opens a new connection to the cell; leaving its context closes it and ends the lease.
    """

    def __init__(self, connect: Callable[[], AbstractContextManager[Client]]) -> None:
        self._connect = connect
        self._alone = threading.Lock()
        self._open = ExitStack()
        self._client: Client | None = None
        self._since_ns = 0
        self._is_ended = False

    @property
    def is_open(self) -> bool:
        """True while there is a connection, and with it perhaps a lease."""
        return self._client is not None

    def command(
        self, verb: str, request: CommandRequest | None = None, is_stopped: Callable[[], bool] = lambda: False
    ) -> CommandReply:
        """Send one command, from any thread.

        Args:
            request: its content; the client id is that of the connection.
            is_stopped: asked before it is sent: whether the cell was stopped since it was wanted.

        Raises: as `Client.send`; Refused (NO_LEASE) after `end`, (WRONG_STATE) for a command that a stop overtook.
        """
        with self._alone:
            if self._is_ended:
                raise Refused("Nobody attends this motion any more.", "Connect again.", code="NO_LEASE")
            if self._client is None:
                self._client = self._open.enter_context(self._connect())
            if is_stopped():  # a connection takes a while to open
                raise Refused(f"A stop came before {verb!r} was sent.", "Send it again.", code="WRONG_STATE")
            reply = self._client.send(verb, request or CommandRequest())
            self._since_ns = reply.since_ns
            return reply

    def is_over(self, state: CellState | None, *, is_gone: bool) -> bool:
        """True when an open connection can be closed: ``state`` ends what was commanded, or the cell is gone."""
        if self._alone.locked() or self._client is None:
            return False
        return self._is_past(state, is_gone)

    def release(self) -> None:
        """Close the connection, which gives the lease back; the next command opens another one."""
        with self._alone:
            self._open.close()
            self._client = None

    def release_if_over(self, state: CellState | None, *, is_gone: bool) -> None:
        """As `release`, unless a command was accepted since ``state``: its motion is not over."""
        with self._alone:
            if self._is_past(state, is_gone):
                self._open.close()
                self._client = None

    def _is_past(self, state: CellState | None, is_gone: bool) -> bool:
        return is_gone or (state is not None and _is_at_rest(state) and state.since_ns >= self._since_ns)

    def end(self) -> None:
        """Release for good: further commands are refused."""
        self._is_ended = True
        self.release()


def _is_at_rest(state: CellState) -> bool:
    """Nothing moves, no pick of a job follows, and nobody moves the arm by hand."""
    return state.state in SETTLED and not state.job_id and not state.queue and state.mode != "Manual"

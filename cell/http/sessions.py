"""Sessions: who attends motion over HTTP. Each is an open event stream, and its end is the end of the lease.

A session that commands motion must also say that it runs, every second (`POST /api/heartbeat`): a page that hangs, or a
machine that was cut off, keeps its connection for a while, and would leave the motion without anybody who attends it.
"""

from __future__ import annotations

import itertools
import secrets
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

from bus.commands import CellState
from bus.errors import Refused
from cell.client import Client
from cell.commander import Commander

HEARTBEAT_S = 1.0
"""How often a session says that it runs."""
Connect = Callable[[str], AbstractContextManager[Client]]
"""Opens a connection to the cell under a client id."""


class Session:
    """One client with an open event stream.

    Attributes:
        token: what its commands carry; known to nobody else. ``client_id``: its name for the cell.
        commander: sends its motion commands. ``heard_s``: when it last said something.
    """

    def __init__(self, client_id: str, connect: Connect, now_s: float) -> None:
        self.token, self.client_id, self.heard_s = secrets.token_urlsafe(24), client_id, now_s
        numbers = itertools.count(1)
        # Each connection has a name of its own: the end of one must not be taken for the end of the next.
        self.commander = Commander(lambda: connect(f"{client_id}.{next(numbers)}"))


class Sessions:
    """The sessions that are open. Its members are called on the loop's thread only.

    Args:
        connect: opens a connection of its own for a session.
        now_s: the clock of deadlines. ``silence_s``: the longest silence of a session that holds a connection.
    """

    def __init__(self, connect: Connect, now_s: Callable[[], float], silence_s: float) -> None:
        self._connect, self._now_s, self._silence_s = connect, now_s, silence_s
        self._open: dict[str, Session] = {}

    def open(self, client_id: str) -> Session:
        """A new session, from now on."""
        session = Session(client_id, self._connect, self._now_s())
        self._open[session.token] = session
        return session

    def close(self, session: Session) -> None:
        """Forget a session; its commander is the caller's to end."""
        self._open.pop(session.token, None)

    def of(self, token: str | None) -> Session | None:
        """Return the session of a token, which has said something now; None for another token."""
        session = self._open.get(token or "")
        if session is not None:
            session.heard_s = self._now_s()
        return session

    def require(self, token: str | None, verb: str) -> Session:
        """Return the session of a token. Raises: Refused (NO_LEASE)."""
        session = self.of(token)
        if session is None:
            what = "that session is over" if token else "no session comes with it"
            raise Refused(
                f"{verb!r} moves the arm, and needs somebody who attends it: {what}.",
                "Open GET /api/events?client=NAME, send the session that it says first as X-Cell-Session, and"
                f" POST /api/heartbeat every {HEARTBEAT_S:.0f} s; or POST /api/picks, which waits for the result.",
                code="NO_LEASE",
            )
        return session

    def due(self, state: CellState | None, *, is_gone: bool) -> Iterator[tuple[Session, bool]]:
        """Yield the sessions to be closed, each with True when it fell silent, and False when its motion is over."""
        for session in self._open.values():
            is_silent = self._now_s() - session.heard_s > self._silence_s
            if session.commander.is_open and is_silent:
                yield session, True
            elif session.commander.is_over(state, is_gone=is_gone):
                yield session, False

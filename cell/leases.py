"""Who may make the arm move: the client whose lease (a liveliness token) the motion runs under.

The first motion command takes the lease, and it ends with the client's token: when its program ends, dies or hangs, or
its network does. Whoever commands motion must hold a token; anyone may stop, hold, suspend, abort or clear.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from bus import topics
from bus.errors import Refused
from bus.session import Bus

NEEDS_LEASE = frozenset({"reset", "start", "pick"})
"""These need the lease: one holder at a time."""
NEEDS_TOKEN = frozenset({"unhold", "unsuspend"})
"""These let the holder's motion go on: any client with a token may, and becomes the holder if there is none."""
CELL_CLIENT = "cell"
"""``client_id`` of the cell itself: of what it commands between cycles, and of the token that says it is there."""
_ARRIVAL_S = 0.05
"""How long a token may arrive after the command that needs it."""


class Leases:
    """The tokens that are there, and who holds the lease.

    Args:
        on_lost: told, on Zenoh's thread, the client id of the holder whose token went; it may only enqueue.
    """

    def __init__(self, on_lost: Callable[[str], None]) -> None:
        self._on_lost = on_lost
        self._alive: set[str] = set()
        self._change = threading.Condition()
        self.holder = ""

    def listen(self, bus: Bus) -> None:
        """Hear tokens."""
        bus.watch_alive(topics.LEASE, self.change)

    def change(self, client_id: str, is_alive: bool) -> None:
        """A client's token came or went."""
        with self._change:
            (self._alive.add if is_alive else self._alive.discard)(client_id)
            is_lost = not is_alive and client_id == self.holder
            if is_lost:
                self.holder = ""
            self._change.notify_all()
        if is_lost:
            self._on_lost(client_id)

    def require(self, verb: str, client_id: str) -> None:
        """Raises: Refused (NO_LEASE, LEASE_HELD) when ``client_id`` may not command ``verb``."""
        if verb not in NEEDS_LEASE | NEEDS_TOKEN:
            return
        with self._change:
            is_there = self._change.wait_for(lambda: client_id in self._alive, _ARRIVAL_S)
            holder = self.holder
        if not is_there:
            raise Refused(
                f"{verb!r} moves the arm, and needs a lease: {client_id or 'a client without an id'!r} holds no token.",
                "Keep a Zenoh liveliness token on cell/CELL_ID/lease/CLIENT_ID while the arm may move, and send that"
                " client_id; `cell` commands do so themselves.",
                code="NO_LEASE",
            )
        if verb in NEEDS_LEASE and holder not in ("", client_id):
            raise Refused(
                f"The cell moves for {holder!r}, which holds the lease.",
                "Wait until that program ends, or `cell stop` and end it.",
                code="LEASE_HELD",
            )

    def take(self, verb: str, client_id: str) -> str:
        """After an accepted command: who holds the lease now."""
        if verb not in NEEDS_LEASE | NEEDS_TOKEN:
            return self.holder
        with self._change:
            self.holder = self.holder or client_id
            is_lost = self.holder not in self._alive
            if is_lost:
                self.holder = ""
        if is_lost:  # it went in the very moment of the command
            self._on_lost(client_id)
        return self.holder

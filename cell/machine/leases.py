"""Decides which client may move the arm: the one that holds the lease.

The first motion command takes the lease. It ends with the client's liveliness token, and when the client's heartbeat
on the token's key is missing: a hanging program keeps its token as long as its transport allows, up to 10 s. A client
that commands motion must hold a token; any client may stop, hold, suspend, abort or clear.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial

from bus import topics
from bus.clock import WALL_CLOCK, DeadlineClock
from bus.errors import Refused
from bus.sample import Sample
from bus.session import Bus
from bus.silence import Silence
from cell.machine.states import MANUAL_MOTIONS

NEEDS_LEASE = frozenset({"reset", "start", "pick", *MANUAL_MOTIONS})
"""Commands that need the lease: one holder at a time."""
NEEDS_TOKEN = frozenset({"unhold", "unsuspend"})
"""Commands that resume the holder's motion: any client with a token may send them, and takes a free lease."""
CELL_CLIENT = "cell"
"""``client_id`` of the cell itself: of its commands between cycles, and of the token that shows its presence."""
HEARTBEAT_S = 0.2
"""Heartbeat period of a client that holds the lease."""
ARRIVAL_S = 0.5
"""Longest delay of a token after the command that needs it."""

Lost = Callable[[str, str], None]
"""Called with the client whose lease was lost, and the reason."""


class Leases:
    """The present tokens, and the holder of the lease.

    Args:
        on_lost: called on any thread; it may only enqueue.
        silence_s: longest gap in the holder's heartbeat.
        look_s: period of `look`.
        arrival_s: longest delay of a token after the command that needs it was received.
        clock: the clock of all three.
        of_holder: commands besides `NEEDS_LEASE` that only the present holder may send.
    """

    def __init__(
        self,
        on_lost: Lost,
        silence_s: float,
        look_s: float,
        arrival_s: float = ARRIVAL_S,
        clock: DeadlineClock = WALL_CLOCK,
        of_holder: frozenset[str] = frozenset(),
    ) -> None:
        self._clock, self._of_holder = clock, of_holder
        self._on_lost, self._silence_s, self._arrival_s = on_lost, silence_s, arrival_s
        self._new_silence = partial(Silence, silence_s, look_s, clock.now_s)
        self._alive: set[str] = set()
        self._change = threading.Condition()
        self._silence = self._new_silence()  # of the holder's heartbeat
        self._source = ""  # the holder's session, "" when unknown
        self.holder = ""

    def listen(self, bus: Bus) -> None:
        """Subscribe to tokens, and to the heartbeats on their keys."""
        bus.watch_alive(topics.LEASE, self.change)
        bus.subscribe(topics.LEASE_HEARTBEAT.key.format(name="*"), self.hear)

    def change(self, client_id: str, is_alive: bool) -> None:
        """Process the arrival or the end of a client's token."""
        with self._change:
            (self._alive.add if is_alive else self._alive.discard)(client_id)
            is_lost = not is_alive and client_id == self.holder
            if is_lost:
                self.holder = ""
            self._change.notify_all()
        if is_lost:
            self._on_lost(client_id, "its token is gone")

    def hear(self, sample: Sample) -> None:
        """Process a client's heartbeat; it counts only from the session of the holder's commands."""
        if sample.key.rpartition("/")[2] == self.holder and sample.source == self._source:
            self._silence.hear()

    def look(self) -> None:
        """Take the lease from a holder whose heartbeat is missing; called every ``look_s``."""
        with self._change:
            holder = self.holder
            if not self._silence.is_broken() or not holder:
                return
            self.holder = ""
        busy = self._clock.busy_note().removesuffix(".")
        self._on_lost(holder, f"no heartbeat for {self._silence_s:.1f} s{'.' if busy else ''}{busy}")

    def must_wait(self, verb: str, client_id: str) -> bool:
        """True when `require` would wait for the client's token."""
        return verb in NEEDS_LEASE | NEEDS_TOKEN and client_id not in self._alive

    def require(self, verb: str, client_id: str, received_s: float) -> None:
        """Refuse ``verb`` to a client that may not command it. Waits for its token.

        Args:
            received_s: arrival of the command (monotonic); waiting commands share the waiting time.

        Raises: Refused (NO_LEASE, LEASE_HELD).
        """
        if verb in self._of_holder and client_id != self.holder:
            raise Refused(
                f"{verb!r} is for the client that holds the lease, which is {self.holder or 'nobody'!r}.",
                "Send it from that client, or set execute.approve = 'client'.",
                code="LEASE_HELD" if self.holder else "NO_LEASE",
            )
        if verb not in NEEDS_LEASE | NEEDS_TOKEN:
            return
        left_s = max(0.0, received_s + self._arrival_s - time.monotonic())
        with self._change:
            is_there = self._clock.wait_for(partial(self._change.wait_for, lambda: client_id in self._alive), left_s)
            holder = self.holder
        if not is_there:
            raise Refused(
                f"{verb!r} moves the arm, and needs a lease: {client_id or 'a client without an id'!r} holds no token.",
                "Keep a Zenoh liveliness token on cell/CELL_ID/lease/CLIENT_ID while the arm may move, put {} on that"
                f" key every {HEARTBEAT_S} s, and send that client_id; `cell` commands do so themselves.",
                code="NO_LEASE",
            )
        if verb in NEEDS_LEASE and holder not in ("", client_id):
            raise Refused(
                f"The cell moves for {holder!r}, which holds the lease.",
                "Wait until that program ends, or `cell stop` and end it.",
                code="LEASE_HELD",
            )

    def take(self, verb: str, client_id: str, source: str = "") -> str:
        """Update the lease after an accepted command; return its holder. The command is the holder's first heartbeat.

        Args:
            source: the session of the command, "" when unknown.
        """
        if verb not in NEEDS_LEASE | NEEDS_TOKEN:
            return self.holder
        with self._change:
            self.holder = self.holder or client_id
            if self.holder == client_id:
                self._silence, self._source = self._new_silence(), source
            is_lost = self.holder not in self._alive
            if is_lost:
                self.holder = ""
        if is_lost:  # the token ended at the moment of the command
            self._on_lost(client_id, "its token is gone")
        return self.holder

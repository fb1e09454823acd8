"""The lease of a client: while it says that it runs, it alone may command motion."""

from __future__ import annotations

import threading
from contextlib import suppress

from bus import topics
from bus.commands import Heartbeat
from bus.errors import BusError, ReplyTimeout
from bus.session import Bus
from bus.threads import OwnedThread, Role
from cell.machine.leases import HEARTBEAT_S


class HeldLease:
    """The liveliness token of one client's lease, and the heartbeat on its key, every `HEARTBEAT_S`.

    Args:
        client_id: of `client_name`.
    """

    def __init__(self, bus: Bus, client_id: str) -> None:
        self._bus, self._client_id = bus, client_id
        self._heartbeat: OwnedThread | None = None
        self._given_back = threading.Event()

    def take(self) -> None:
        """Declare the token, and start the heartbeat. Idempotent."""
        if self._heartbeat is not None:
            return
        self._bus.announce(topics.LEASE, name=self._client_id)
        with suppress(ReplyTimeout):  # the cell waits for it, too, as it is commanded
            self._bus.alive(topics.LEASE)  # answered only after the token has arrived
        self._given_back.clear()
        self._heartbeat = OwnedThread(Role.LOOP, self._beat, of="lease").start()

    def give_back(self) -> None:
        """End the heartbeat, and withdraw the token. Idempotent."""
        if self.end_heartbeat():
            self._bus.withdraw(topics.LEASE, name=self._client_id)

    def end_heartbeat(self) -> bool:
        """End the heartbeat, and return whether there was one.

        Its thread must have ended before the process does: one that publishes then takes the process down.
        """
        self._given_back.set()
        heartbeat, self._heartbeat = self._heartbeat, None
        if heartbeat is not None:
            heartbeat.join()
        return heartbeat is not None

    def _beat(self) -> None:
        while not self._given_back.is_set():
            try:
                self._bus.publish(topics.LEASE_HEARTBEAT, Heartbeat(), name=self._client_id)
            except BusError:  # the session is closed, which also ends the token
                return
            self._given_back.wait(HEARTBEAT_S)

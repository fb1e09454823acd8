"""The part that the requests share: the connection to the cell, what it said last, streams, sessions, threads."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

from bus import topics
from bus.codec import decode
from bus.commands import CellHealth, CellState, CommandReply, CommandRequest, Event
from bus.errors import BadPayload, BusError, CellError
from bus.frozen import Message
from bus.messages import Attempt, CycleResult, LivePicture, PictureRequest, PlanView, Proposal
from bus.sample import Sample
from cell.commander import Commander
from cell.http.access import Access
from cell.http.hub import Hub, Listening, Said
from cell.http.jobs import Jobs
from cell.http.pictures import Pictures
from cell.http.sessions import Connect, Session, Sessions
from cell.machine.states import PAUSED, SETTLED
from config.http import HttpSettings
from config.schema import Station

LOOK_S, REFRESH_S = 0.2, 2.0
_ASKING, _STOPPING, _RELEASING = 12, 4, 4
"""Threads that wait for the cell: for commands that bring to rest, and the end of a lease, apart from the others."""
_NAMES: dict[str, tuple[str, type[Message]]] = {
    topics.STATE.key: ("state", CellState),
    topics.HEALTH.key: ("health", CellHealth),
    topics.EVENT.key: ("event", Event),
    topics.RESULT.key: ("result", CycleResult),
    topics.PROPOSAL.key: ("proposal", Proposal),
    topics.ATTEMPT.key: ("attempt", Attempt),
}
ALSO = (topics.HEALTH, topics.EVENT, topics.PROPOSAL, topics.ATTEMPT, topics.VIEW_COLOR, topics.VIEW_ANNOTATIONS)
"""Topics that the connection hears besides states and results."""
_SHOWN = PictureRequest(media_type="image/jpeg", from_capture_pose=False)
"""For a page, that looks."""
_GONE = Said(
    "event",
    Event(code="CELL_GONE", severity="error", text="The cell is gone: it ended, or the link to it.").model_dump_json(),
)
AnswerT = TypeVar("AnswerT")
_log = logging.getLogger(__name__)


class Cell(Protocol):
    """The connection to the cell that all requests share (`cell.client.Client`)."""

    client_id: str

    @property
    def is_gone(self) -> bool:
        """Whether the cell has ended, or the link to it."""

    def state(self) -> CellState:
        """Return the state now."""

    def health(self) -> CellHealth:
        """Return the health now."""

    def send(self, verb: str, request: CommandRequest) -> CommandReply:
        """Send one command."""

    def result(self, cycle_id: str) -> CycleResult | None:
        """Return the result of a cycle."""

    def proposal(self) -> Proposal:
        """Return the planned motion that waits for an answer."""

    def plan_view(self) -> PlanView:
        """Return the last plan."""

    def picture(self, request: PictureRequest | None = None) -> LivePicture:
        """A picture of now."""


class Door:
    """The shared part of an HTTP interface. Without another word, members are for the loop's thread.

    Args:
        cell: the shared connection. ``connect``: opens one more, under a client id.
        station: whose cell it is.
        now_s: the clock of deadlines.
    """

    def __init__(
        self,
        cell: Cell,
        connect: Connect,
        station: Station,
        access: Access,
        now_s: Callable[[], float],
    ) -> None:
        self.cell, self.station, self.access = cell, station, access
        self.settings: HttpSettings = station.http
        self.recordings: Path = station.recording.folder
        self._connect = connect
        self.hub, self.pictures, self.jobs = Hub(self.settings.most_streams), Pictures(), Jobs()
        self.sessions = Sessions(connect, now_s, self.settings.silence_s)
        self._state: CellState | None = None
        self._was_gone = False
        self._stops = 0
        self._asking = ThreadPoolExecutor(_ASKING, "http-asking")
        self._stopping = ThreadPoolExecutor(_STOPPING, "http-stopping")
        self._releasing = ThreadPoolExecutor(_RELEASING, "http-releasing")
        self._ending: set[Session] = set()

    async def ask(self, question: Callable[[], AnswerT], *, stops: bool = False) -> AnswerT:
        """Ask the cell, or read a file, in a thread. ``stops``: it is a command that brings motion to rest."""
        return await asyncio.get_running_loop().run_in_executor(self._stopping if stops else self._asking, question)

    def stop(self) -> None:
        """A stop was asked for: what moves the arm and is not sent yet is not sent any more."""
        self._stops += 1

    def stopped_from_now(self) -> Callable[[], bool]:
        """Return what tells whether a stop was asked for since; it may be called on any thread."""
        before = self._stops
        return lambda: self._stops != before

    def commander(self, client_id: str) -> Commander:
        """One that sends the motion commands of a single request."""
        return Commander(lambda: self._connect(client_id))

    def end(self, commander: Commander) -> None:
        """End a commander in the background: whatever it had in motion is held."""
        self._releasing.submit(commander.end)

    async def ended(self, commander: Commander) -> None:
        """End a commander, and return when its lease is given back."""
        await asyncio.get_running_loop().run_in_executor(self._releasing, commander.end)

    # --- what the cell says -------------------------------------------------------------------------------------------

    def join(self) -> Listening:
        """A new stream, told what counts now. Raises: Refused (TOO_MANY)."""
        listening = self.hub.join()
        if self._was_gone:  # the state that it is told is the last one
            listening.put(_GONE)
        return listening

    def hear(self, sample: Sample) -> None:
        """Pass one sample of the cell on to the streams."""
        if sample.key in (topics.VIEW_COLOR.key, topics.VIEW_ANNOTATIONS.key):
            shown = self.pictures.hear(sample)
            if shown is not None:
                self.hub.tell(shown[0], json.dumps(_stamp(shown[1])))
            return
        name, kind = _NAMES[sample.key]
        try:
            said = decode(kind, sample.payload)
        except BadPayload as error:
            _log.warning("not passed on: %s", error)
            return
        if isinstance(said, Attempt):
            self.jobs.begun(said)
            self.tell_jobs()
            return
        self.hub.tell(name, said.model_dump_json())
        if isinstance(said, CellState):
            self._take(said)

    def tell_jobs(self) -> None:
        """Say what the jobs are about, where that is new."""
        said = self.jobs.of(self._state) if self._state is not None else "{}"
        if said != (self.hub.last("jobs") or "{}"):
            self.hub.tell("jobs", said)

    def look(self) -> None:
        """Give leases back whose motion is over, or whose session is silent; called every `LOOK_S`."""
        is_gone = self.cell.is_gone
        for session, is_silent in list(self.sessions.due(self._state, is_gone=is_gone)):
            if session not in self._ending:
                self._ending.add(session)
                release = (
                    session.commander.release
                    if is_silent
                    else partial(session.commander.release_if_over, self._state, is_gone=is_gone)
                )
                done = partial(self._released, asyncio.get_running_loop(), session)
                self._releasing.submit(release).add_done_callback(done)
                if is_silent:
                    self._tell(session, "LEASE_LOST", "its heartbeat is missing: the cell holds what it moved.")
        if is_gone and not self._was_gone:
            self.hub.tell(*_GONE)
        self._was_gone = is_gone

    async def refresh(self) -> None:
        """Ask for the state, because a sample may have been lost, or the cell was gone; called every `REFRESH_S`."""
        before = self._state
        with suppress(BusError):
            state = await self.ask(self.cell.state)
            if self._state is before:  # else the one that was heard meanwhile is newer
                self.greet(state)

    async def show_live(self) -> None:
        """Take a picture of now, where nothing moves and somebody looks; called every `HttpSettings.picture_s`."""
        if not self.hub.is_listened_to or self._state is None or self._state.state not in SETTLED | PAUSED:
            return
        before = self.pictures.picture
        with suppress(CellError):  # it works already, or its camera does not: its health says so
            live = await self.ask(partial(self.cell.picture, _SHOWN))
            if self.pictures.picture is before and self.pictures.at(live.stamp_ns) is None:  # else a newer one came
                self.pictures.take(live)
                told = {"is_live": True, "from_capture_pose": live.from_capture_pose, "gone": live.gone}
                told |= {"things": str(live.things_ns)}
                self.hub.tell("picture", json.dumps(_stamp(live.stamp_ns) | told))

    def _released(self, loop: asyncio.AbstractEventLoop, session: Session, _done: object) -> None:
        loop.call_soon_threadsafe(self._ending.discard, session)

    def _tell(self, session: Session, code: str, why: str) -> None:
        event = Event(code=code, severity="warning", text=f"{session.client_id}: {why}")
        self.hub.tell("event", event.model_dump_json())

    def greet(self, state: CellState) -> None:
        """Take the present state, and pass it on where it is new."""
        if state != self._state:
            self.hub.tell("state", state.model_dump_json())
            self._take(state)

    def _take(self, state: CellState) -> None:
        self._state = state
        self._was_gone = False  # of a cell that is gone it comes late: that it is gone is said again
        self.tell_jobs()

    def close(self) -> None:
        """End all streams, which are told so; their sessions end with them."""
        self.hub.tell("end", "{}")
        self.hub.close()

    def wait(self) -> None:
        """Wait until every lease is given back; after the loop's end, on any thread."""
        for pool in (self._asking, self._stopping, self._releasing):
            pool.shutdown(wait=True)


def _stamp(stamp_ns: int) -> dict[str, Any]:
    """A stamp as a number, and as text for programs whose numbers have fewer digits."""
    return {"stamp_ns": stamp_ns, "stamp": str(stamp_ns)}

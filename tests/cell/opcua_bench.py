"""A cell on a bus whose state the test sets, its OPC UA door in a thread, and a plain asyncua client."""

from __future__ import annotations

import asyncio
import queue
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, nullcontext, suppress
from typing import Any

from asyncua import Client, ua

from bus import topics
from bus.codec import decode
from bus.commands import CellHealth, CellState, CommandReply, CommandRequest, Event
from bus.errors import Refused
from bus.messages import CycleResult, LivePicture, Proposal
from bus.sample import Asked
from bus.session import Bus
from cell.machine.leases import CELL_CLIENT, Leases
from cell.machine.states import BESIDE, State, after_command, available
from cell.opcua.address_space import NAMESPACE
from cell.opcua.door import serve
from config.schema import Station

PICTURE = LivePicture(
    stamp_ns=1_700_000_000_000_000_001, data=bytes(700_000), media_type="image/png", from_capture_pose=True
)
_ANYONES = ("stop", "abort", "hold", "suspend", "clear")


class ScriptedCell:
    """Answers commands by the real table and the real leases; nothing moves, and no state ends by itself.

    Attributes:
        commands: as they were accepted. ``lost``: clients whose lease was lost. ``arrived``: motion commands that came;
            each waits until ``goes_on`` is set.
    """

    def __init__(self, endpoint: str) -> None:
        self.bus = Bus.listen("sim", endpoint)
        self.state, self.stage = State.STOPPED, ""
        self.arrived, self.goes_on = threading.Semaphore(0), threading.Event()
        self.goes_on.set()
        self.proposal: Proposal | None = None
        self.commands: list[tuple[str, CommandRequest]] = []
        self.lost: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.leases = Leases(lambda client_id, why: self.lost.put(client_id), 60.0, 1.0)
        self.leases.listen(self.bus)
        self.bus.answer(topics.STATE_NOW, lambda _payload, _asked: self.now(), worker="state")
        healthy = CellHealth(is_healthy=True, nodes={})
        self.bus.answer(topics.HEALTH_NOW, lambda _payload, _asked: healthy, worker="state")
        self.bus.answer(topics.PROPOSAL_NOW, lambda _payload, _asked: self._waiting(), worker="state")
        self.bus.answer(topics.PICTURE_NOW, lambda _payload, _asked: PICTURE, worker="state")
        self.bus.answer(topics.COMMAND, self._command, worker=self._worker, verb="*")
        self.bus.announce(topics.LEASE, name=CELL_CLIENT)

    @staticmethod
    def _worker(asked: Asked, _payload: bytes) -> str:
        return "stop" if asked.verb in _ANYONES else "command"

    def now(self, reason: str = "") -> CellState:
        return CellState(state=self.state, stage=self.stage, cycle_id="", since_ns=time.time_ns(),
                         available=available(self.state), reason=reason)  # fmt: skip

    def _waiting(self) -> Proposal:
        if self.proposal is None:
            raise Refused("No planned motion waits.", code="NO_PROPOSAL")
        return self.proposal

    def propose(self, proposal: Proposal) -> None:
        """Publish a planned pick; the cell waits for an answer."""
        self.proposal, self.stage = proposal, "approve"
        self.bus.publish(topics.PROPOSAL, proposal)
        self.enter(State.EXECUTE)

    def enter(self, state: State, reason: str = "") -> None:
        if state is not State.EXECUTE:
            self.stage, self.proposal = "", None
        self.state = state
        self.bus.publish(topics.STATE, self.now(reason))

    def say(self, said: CycleResult | Event) -> None:
        self.bus.publish(topics.RESULT if isinstance(said, CycleResult) else topics.EVENT, said)

    def _command(self, payload: bytes, asked: Asked) -> CommandReply:
        request = decode(CommandRequest, payload)
        if asked.verb not in _ANYONES:
            self.arrived.release()
            assert self.goes_on.wait(60)
        self.leases.require(asked.verb, request.client_id, asked.received_s)
        if asked.verb not in BESIDE:
            after_command(self.state, asked.verb)
        self.commands.append((asked.verb, request))
        lease = self.leases.take(asked.verb, request.client_id, asked.source)
        is_pick = asked.verb in ("pick", "start")
        return CommandReply(ok=True, state=self.state, lease=lease, cycle_id="c1" if is_pick else "",
                            job_id=request.job.job_id or "c1", position=2 if request.job.queue else 0)  # fmt: skip


@contextmanager
def serving(station: Station) -> Iterator[str]:
    """The endpoint of a door that serves in a thread of this process."""
    ended, told = threading.Event(), queue.SimpleQueue[str | BaseException]()

    def wait_for_end() -> None:
        ended.wait()

    def run() -> None:
        try:
            serve(station, told.put, wait_for_end)
        except BaseException as error:  # noqa: BLE001 - raised where it is waited for
            told.put(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        where = told.get(timeout=60)
        if isinstance(where, BaseException):
            raise where
        yield where
    finally:
        ended.set()
        thread.join(30)


class Plain:
    """A plain client, and the few things that the tests say to it."""

    def __init__(self, client: Client, index: int) -> None:
        self.client, self.index, self.is_broken = client, index, False

    def node(self, path: str = "") -> Any:
        return self.client.get_node(ua.NodeId(f"Cell.{path}" if path else "Cell", self.index))

    async def read(self, path: str) -> Any:
        return await self.node(path).read_value()

    async def call(self, method: str, *arguments: Any) -> Any:
        """The outputs of a call. Raises: ua.UaStatusCodeError."""
        return await self.node().call_method(self.node(method).nodeid, *arguments)

    async def status(self, method: str, *arguments: Any) -> str:
        """The name of a call's status."""
        return str((await self.raw(method, *arguments)).StatusCode.name)

    async def raw(self, method: str, *arguments: Any) -> Any:
        """The whole result of a call, as it is on the wire."""
        variants = [one if isinstance(one, ua.Variant) else ua.Variant(one) for one in arguments]
        request = ua.CallMethodRequest(
            ObjectId=self.node().nodeid, MethodId=self.node(method).nodeid, InputArguments=variants
        )
        (result,) = await self.client.uaclient.call([request])
        return result

    async def until(self, path: str, wanted: Any) -> None:
        """Until a variable has this value."""
        give_up_s = time.monotonic() + 30
        while (found := await self.read(path)) != wanted:
            assert time.monotonic() < give_up_s, f"{path} is still {found!r}, not {wanted!r}"
            await asyncio.sleep(0.002)

    def break_off(self) -> None:
        """End the connection as the kernel does for a process that was killed."""
        self.is_broken = True
        self.client.uaclient.protocol.transport.abort()


@asynccontextmanager
async def connected(
    endpoint: str, prepare: Callable[[Client], Awaitable[None]] | None = None, *, timeout_s: float = 20
) -> AsyncIterator[Plain]:
    """A connected plain client. ``prepare``: sets its certificate or user."""
    client = Client(endpoint, timeout=timeout_s)
    client.application_uri = "urn:vlad-cell:client"
    if prepare is not None:
        await prepare(client)
    await client.connect()
    plain = Plain(client, await client.get_namespace_index(NAMESPACE))
    try:
        yield plain
    finally:
        with suppress(Exception) if plain.is_broken else nullcontext():  # however asyncua says that the line is dead
            await client.disconnect()


def talk(endpoint: str, say: Callable[[Plain], Awaitable[None]], *, timeout_s: float = 20) -> None:
    """Run a conversation of one plain client."""

    async def run() -> None:
        async with connected(endpoint, timeout_s=timeout_s) as plain:
            await say(plain)

    asyncio.run(run())

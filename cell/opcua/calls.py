"""Calls of the cell's methods: checked, sent to the cell from a thread, answered with what it said."""

from __future__ import annotations

import asyncio
import itertools
import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from typing import Any, TypeVar

from asyncua import ua

from bus.commands import CommandReply, CommandRequest
from bus.errors import CellError, CellUnreachable, Refused
from bus.messages import LivePicture
from cell import client
from cell.client import Client, client_name
from cell.commander import Commander
from cell.machine.leases import NEEDS_LEASE, NEEDS_TOKEN
from cell.machine.states import ANSWERS, ENDING
from cell.opcua.address_space import AddressSpace
from cell.opcua.methods import Given, Method, fitting, request_of
from cell.opcua.refusals import Refusals
from cell.opcua.structures import utc_of
from cell.opcua.users import Person
from config.schema import Station

_log = logging.getLogger(__name__)
ResultT = TypeVar("ResultT")
_COMMANDS, _STOPS, _RELEASES = 16, 4, 4
"""Threads: of commands; of what brings the cell to rest, and of the end of a lease, which wait for none of them."""


class Attendant:
    """The commands of one session, and its lease: another connection to the cell, from its first motion command on.

    Args:
        name: of the user.
    """

    def __init__(self, calls: Calls, name: str) -> None:
        self._calls = calls
        self.client_id = client_name("-".join(filter(None, ("opcua", name))))
        self._numbers = itertools.count(1)
        self._commander = self._new()

    def _new(self) -> Commander:
        # Each connection has a name of its own: the end of one must not be taken for the end of the next.
        return Commander(lambda: self._calls.connect(f"{self.client_id}.{next(self._numbers)}"))

    @property
    def is_attending(self) -> bool:
        """True while it has a connection of its own, and with it perhaps the lease."""
        return self._commander.is_open

    def command(self, verb: str, request: CommandRequest) -> asyncio.Future[CommandReply]:
        """Send a command that needs the lease; a command that still waits when the session goes is refused."""
        return self._calls.in_thread(self._commander.command, verb, request)

    def leave(self) -> Future[None]:
        """Give the lease back: motion that continues is held. The next command takes it anew."""
        gone, self._commander = self._commander, self._new()
        return self._calls.end(gone)


class Calls:
    """Answers the calls of every session.

    Args:
        viewer: the door's own connection; commands that need no lease go over it.
    """

    def __init__(self, station: Station, space: AddressSpace, viewer: Client) -> None:
        self.station, self._space, self._viewer = station, space, viewer
        self._refusals = Refusals(space)
        self._threads = ThreadPoolExecutor(_COMMANDS, "opcua-command")
        self._stopping = ThreadPoolExecutor(_STOPS, "opcua-stop")
        self._releasing = ThreadPoolExecutor(_RELEASES, "opcua-release")

    def connect(self, client_id: str) -> AbstractContextManager[Client]:
        """Open one more connection to the cell, under this name."""
        return client.connect(self.station, client_id=client_id)

    def in_thread(self, run: Callable[..., ResultT], *arguments: Any) -> asyncio.Future[ResultT]:
        """Return the future of ``run(*arguments)`` in a thread of the commands."""
        return asyncio.wrap_future(self._threads.submit(run, *arguments))

    def end(self, commander: Commander) -> Future[None]:
        """Close a session's connection to the cell, which gives its lease back."""
        ending = self._releasing.submit(commander.end)
        ending.add_done_callback(_log_failure)
        return ending

    def close(self) -> None:
        """Start no further command; what runs is left to the end of the process."""
        for pool in (self._threads, self._stopping, self._releasing):
            pool.shutdown(wait=False, cancel_futures=True)

    def method_of(self, request: ua.CallMethodRequest) -> Method | None:
        """Return the cell's method that is called; None when it is one of another object."""
        if request.ObjectId not in self._space.callable_on:
            return None
        return self._space.methods.get(request.MethodId)

    async def answer(
        self, method: Method, given: list[ua.Variant], person: Person, attendant: Attendant
    ) -> ua.CallMethodResult:
        """Carry out one call. A refusal is its answer, never an exception."""
        fits: list[bool] = []
        try:
            self._require_right(method, person)
            fits = _require_fitting(method, given)
            request = request_of(method, [one.Value for one in given])
            if method.name == "Release":
                await asyncio.wrap_future(attendant.leave())
                return _result(method, [])
            if method.name == "Picture":
                return _result(method, _shown(await self.in_thread(self._viewer.picture)))
            reply = await self._send(method.verb, request, attendant)
        except _BadArguments as refusal:
            return await self._refusals.answer(refusal, method.name, attendant.client_id, refusal.fits)
        except CellError as refusal:
            return await self._refusals.answer(refusal, method.name, attendant.client_id, fits)
        if method.verb in NEEDS_LEASE:
            await self._space.write({"Status.EquipmentBlocked": False})
        return _result(method, _begun(reply) if method.outputs else [])

    async def _send(self, verb: str, request: CommandRequest, attendant: Attendant) -> CommandReply:
        """Send a command. It goes on when the client goes meanwhile: its lease is given back after it.

        Raises: CellUnreachable at once when the cell is known to be gone; as `Client.send`.
        """
        if self._viewer.is_gone:
            raise CellUnreachable(
                "The cell is gone: it ended, or the link to it.", "Start it: this server will see it."
            )
        by_its_holder = verb in ANSWERS and attendant.is_attending  # `execute.approve = "holder"` asks for that name
        if verb in NEEDS_LEASE | NEEDS_TOKEN or by_its_holder:
            return await asyncio.shield(attendant.command(verb, request))
        named = request.model_copy(update={"client_id": attendant.client_id})
        pool = self._stopping if verb in ENDING else self._threads
        return await asyncio.shield(asyncio.wrap_future(pool.submit(self._viewer.send, verb, named)))

    @staticmethod
    def _require_right(method: Method, person: Person) -> None:
        if not person.may_command and method.verb not in ENDING and method.name != "Picture":
            raise Refused(
                f"The user {person.name!r} may look, and bring the cell to rest, no more.",
                "Connect as an operator (opcua.users).",
                code="NO_RIGHT",
            )


class _BadArguments(Refused):
    """Arguments of a wrong number or type. ``fits``: for each of them, whether it is right."""

    def __init__(self, text: str, code: str, fits: list[bool]) -> None:
        super().__init__(text, "The method's InputArguments say what it takes.", code=code)
        self.fits = fits


def _require_fitting(method: Method, given: list[ua.Variant]) -> list[bool]:
    """Check number and types of the arguments: asyncua checks neither."""
    wanted = method.inputs
    if len(given) != len(wanted):
        code = "ARGUMENT_MISSING" if len(given) < len(wanted) else "ARGUMENT_TOO_MANY"
        raise _BadArguments(f"{method.name} takes {len(wanted)} arguments, not {len(given)}.", code, [])
    kinds = ["" if one.is_array or isinstance(one.Value, list) else one.VariantType.name for one in given]
    fits = fitting(wanted, [Given(kind, one.Value) for kind, one in zip(kinds, given, strict=True)])
    if not all(fits):
        wrong = wanted[fits.index(False)]
        text = f"{method.name}: {wrong.name} is one {wrong.kind}, of 64 KiB at most."
        raise _BadArguments(text, "BAD_ARGUMENT", fits)
    return fits


def _begun(reply: CommandReply) -> list[ua.Variant]:
    """Cycle, job and place in the queue of what was accepted."""
    return [
        ua.Variant(reply.cycle_id),
        ua.Variant(reply.job_id),
        ua.Variant(reply.position, ua.VariantType.UInt32),
    ]


def _shown(picture: LivePicture) -> list[ua.Variant]:
    return [
        ua.Variant(picture.data, ua.VariantType.ByteString),
        ua.Variant(utc_of(picture.stamp_ns), ua.VariantType.DateTime),
        ua.Variant(str(picture.stamp_ns), ua.VariantType.String),
    ]


def _result(method: Method, outputs: list[ua.Variant]) -> ua.CallMethodResult:
    """The result of an accepted call."""
    return ua.CallMethodResult(
        StatusCode=ua.StatusCode(),
        InputArgumentResults=[ua.StatusCode() for _ in method.inputs],
        OutputArguments=outputs,
    )


def _log_failure(ending: Future[None]) -> None:
    if not ending.cancelled() and (error := ending.exception()) is not None:
        _log.warning("a lease could not be given back in order: %s", error)

"""``POST /api/commands/VERB`` and ``POST /api/picks``: commands to the cell, and a pick whose result is waited for."""

from __future__ import annotations

from collections.abc import AsyncIterator
from functools import partial

from starlette.requests import Request
from starlette.responses import Response

from bus.codec import decode, encode
from bus.commands import CommandReply, CommandRequest, ErrorReply
from bus.errors import CellError, Refused
from bus.frozen import Message
from bus.messages import Job
from bus.remote_errors import error_reply
from cell.client import SETTLED, client_name
from cell.http.access import HttpRole
from cell.http.answers import JSON, say
from cell.http.door import Door
from cell.http.events import SESSION, name_in
from cell.http.hub import Listening
from cell.http.streams import PING_S, EndingStream
from cell.machine.leases import NEEDS_LEASE, NEEDS_TOKEN
from cell.machine.states import COMMANDS, ENDING

VERBS = (*COMMANDS, "cancel")


async def command(request: Request, door: Door) -> Response:
    """Send one command, and answer what the cell answers. Raises: CellError."""
    verb = request.path_params["verb"]
    if verb not in VERBS:
        raise Refused(f"There is no command {verb!r}.", "See `available`.", code="UNKNOWN_COMMAND", available=VERBS)
    require_right(request, verb)
    wanted = decode(CommandRequest, await request.body() or b"{}")
    token = request.headers.get(SESSION)
    if verb in NEEDS_LEASE | NEEDS_TOKEN:
        session = door.sessions.require(token, verb)
        return say(await door.ask(partial(session.commander.command, verb, wanted)))
    attending = door.sessions.of(token)
    if attending is not None and not wanted.client_id:
        wanted = wanted.model_copy(update={"client_id": attending.client_id})
    return say(await door.ask(partial(door.cell.send, verb, wanted), stops=verb in ENDING))


def require_right(request: Request, verb: str) -> None:
    """Raises: Refused (NO_RIGHT) when the role of who asks may not send ``verb``."""
    role: HttpRole = request.state.role
    if not role.may(verb):
        raise Refused(
            f"A {role} may look, and bring motion to rest; not {verb!r}.", "Use an operator's token.", code="NO_RIGHT"
        )


async def pick(request: Request, door: Door) -> Response:
    """Begin a pick and answer its result; the lease is this request's, and ends with it. Raises: CellError."""
    require_right(request, "pick")
    job = decode(Job, await request.body() or b"{}")
    commander = door.commander(client_name(f"http-{name_in(request) or 'pick'}"))
    listening = door.hub.join()

    def end() -> None:
        door.hub.leave(listening)
        door.end(commander)

    try:
        reply = await door.ask(partial(commander.command, "pick", CommandRequest(job=job)))
    except BaseException:
        end()
        raise
    return EndingStream(_awaited(door, listening, reply), JSON, end)


async def _awaited(door: Door, listening: Listening, reply: CommandReply) -> AsyncIterator[bytes]:
    """Blank lines until the result is there, so that a client that is gone is noticed; then the result."""
    yield b"\n"
    cycle_id, is_dropped = reply.cycle_id, False
    while True:
        try:
            result = await door.ask(partial(door.cell.result, cycle_id))
            if result is not None and result.retried_as:
                cycle_id = result.retried_as
                continue
            if result is not None or is_dropped:
                yield _line(result or _dropped(reply))
                return
            is_dropped = await _is_dropped(door, reply)
        except CellError as error:
            yield _line(error_reply(error))
            return
        try:
            if await _next_result(listening) is None:
                yield _line(ErrorReply(code="CLOSED", reason="The HTTP interface is closing: the cell holds."))
                return
        except TimeoutError:
            yield b"\n"


async def _next_result(listening: Listening) -> object:
    """Wait for the next result, of any cycle; None when the interface closes. Raises: TimeoutError after `PING_S`."""
    while (said := await listening.next(PING_S)) is not None and said.name != "result":
        pass
    return said


async def _is_dropped(door: Door, reply: CommandReply) -> bool:
    """True when the cell rests, and neither works at this job nor lets it wait: it has a result, or was dropped."""
    state = await door.ask(door.cell.state)
    return state.state in SETTLED and reply.job_id not in (state.job_id, *state.queue)


def _dropped(reply: CommandReply) -> ErrorReply:
    return ErrorReply(
        code="JOB_DROPPED",
        reason=f"The job {reply.job_id!r} ended without a cycle: what ended the motion dropped what waited.",
        advice="Make the cell ready, and send it again.",
    )


def _line(message: Message) -> bytes:
    return encode(message) + b"\n"

"""Requests that attend their motion themselves: the lease is theirs, and they are answered when the motion is over.

The answer begins at once, with blank lines, which JSON allows: writing to a client that is gone fails, which ends the
request, its lease, and with it the motion.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import partial

from starlette.requests import Request
from starlette.responses import Response

from bus.codec import decode, encode
from bus.commands import CellState, CommandReply, CommandRequest, ErrorReply
from bus.errors import CellError
from bus.frozen import Message
from bus.messages import Job
from bus.remote_errors import error_reply
from cell.client import client_name
from cell.http.access import require_right
from cell.http.answers import JSON
from cell.http.door import Door
from cell.http.events import name_in
from cell.http.hub import Listening
from cell.http.streams import PING_S, EndingStream
from cell.machine.states import SETTLED
from cell.outcome import Outcome

Awaited = Callable[[Door, Listening, CommandReply], AsyncIterator[Message | None]]
"""Yields None as long as an accepted command lasts, then the answer."""


async def pick(request: Request, door: Door) -> Response:
    """Begin a pick, and answer its result. Raises: CellError."""
    job = decode(Job, await request.body() or b"{}")
    return await attended(request, door, "pick", CommandRequest(job=job), result)


async def attended(request: Request, door: Door, verb: str, wanted: CommandRequest, comes_to: Awaited) -> Response:
    """Send a command and answer what it comes to, on a lease of its own. Raises: CellError when it is refused."""
    require_right(request.state.role, verb)
    commander = door.commander(client_name(f"http-{name_in(request) or verb}"))
    listening = door.hub.join()

    def end() -> None:
        door.hub.leave(listening)
        door.end(commander)

    try:
        reply = await door.ask(partial(commander.command, verb, wanted, door.stopped_from_now()))
        door.jobs.sent(verb, wanted, reply)
        door.tell_jobs()
    except BaseException:
        end()
        raise
    return EndingStream(_lines(comes_to(door, listening, reply), partial(door.ended, commander)), JSON, end)


async def _lines(said: AsyncIterator[Message | None], ended: Callable[[], Awaitable[None]]) -> AsyncIterator[bytes]:
    """Blank lines, then the answer, when the lease is given back: whoever reads it may command at once."""
    yield b"\n"
    answer: Message = _CLOSED
    try:
        async for message in said:
            if message is None:
                yield b"\n"
            else:
                answer = message
    except CellError as error:
        answer = error_reply(error)
    await ended()
    yield encode(answer) + b"\n"


async def at_rest(door: Door, listening: Listening, _reply: CommandReply) -> AsyncIterator[Message | None]:
    """Yield None until nothing moves any more and no pick follows, then that state."""
    while not _rests(state := await door.ask(door.cell.state)):
        if await _turn(listening, "state") is None:
            yield _CLOSED
            return
        yield None
    yield state


async def result(door: Door, listening: Listening, reply: CommandReply) -> AsyncIterator[Message | None]:
    """Yield None until the pick is over, then the result of its last attempt. Raises: Refused (JOB_DROPPED)."""
    outcome = Outcome(door.cell, reply.cycle_id, reply.job_id)
    while (found := await door.ask(outcome.ask)) is None:
        if await _turn(listening, "result") is None:
            yield _CLOSED
            return
        yield None
    yield found


async def _turn(listening: Listening, name: str) -> bool | None:
    """Wait for the next message of that name, for `PING_S` at most: whether it came; None when the interface closes."""
    try:
        async with asyncio.timeout(PING_S):
            while (said := await listening.next()) is not None:
                if said.name == name:
                    return True
    except TimeoutError:
        return False
    return None


def _rests(state: CellState) -> bool:
    moves_by_hand = state.mode == "Manual" and state.stage != ""
    return state.state in SETTLED and not state.job_id and not state.queue and not moves_by_hand


_CLOSED = ErrorReply(code="CLOSED", reason="The HTTP interface is closing: the cell holds.", advice="Connect again.")

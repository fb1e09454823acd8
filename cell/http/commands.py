"""``POST /api/commands/VERB``: one command to the cell, answered as soon as the cell has accepted or refused it."""

from __future__ import annotations

from functools import partial

from starlette.requests import Request
from starlette.responses import Response

from bus.codec import decode
from bus.commands import CommandRequest
from bus.errors import BadPayload, Refused
from cell.http.access import require_right
from cell.http.answers import say
from cell.http.door import Door
from cell.http.events import SESSION
from cell.http.waiting import at_rest, attended
from cell.machine.leases import NEEDS_LEASE, NEEDS_TOKEN
from cell.machine.states import ANSWERS, ENDING, VERBS

MOVES = NEEDS_LEASE | NEEDS_TOKEN
"""Commands that somebody must attend."""


async def command(request: Request, door: Door) -> Response:
    """Send one command, and answer what the cell answers. Raises: CellError."""
    verb = request.path_params["verb"]
    if verb not in VERBS:
        known = f"Commands: {', '.join(VERBS)}."
        raise Refused(f"There is no command {verb!r}.", known, code="UNKNOWN_COMMAND", available=VERBS)
    require_right(request.state.role, verb)
    wanted, is_waited_for = decode(CommandRequest, await request.body() or b"{}"), _waits(request, verb)
    token = request.headers.get(SESSION)
    if is_waited_for:
        return await attended(request, door, verb, wanted, at_rest)
    if verb in MOVES:
        session = door.sessions.require(token, verb)
        reply = await door.ask(partial(session.commander.command, verb, wanted, door.stopped_from_now()))
        door.jobs.sent(verb, wanted, reply)
        door.tell_jobs()
        return say(reply)
    if verb in ("stop", "abort"):
        door.stop()
    attending = door.sessions.of(token)
    if verb in ANSWERS and attending is not None and attending.commander.is_open:  # it holds the lease by that name
        wanted = wanted.model_copy(update={"client_id": ""})
        return say(await door.ask(partial(attending.commander.command, verb, wanted)))
    if attending is not None and not wanted.client_id:
        wanted = wanted.model_copy(update={"client_id": attending.client_id})
    return say(await door.ask(partial(door.cell.send, verb, wanted), stops=verb in ENDING))


def _waits(request: Request, verb: str) -> bool:
    """True when the request attends the motion itself, and is answered at its end. Raises: BadPayload."""
    wait = request.query_params.get("wait")
    if wait not in (None, "true"):
        raise BadPayload("wait: true, or left out.", "See GET /api.")
    if wait is not None and verb not in MOVES:
        raise BadPayload(f"wait: {verb!r} is answered at once.", f"It is for {', '.join(sorted(MOVES))}.")
    return wait is not None

"""``GET /api/events``: what the cell says, as server-sent events; with a name, the session of who attends motion."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncIterator

from starlette.requests import Request
from starlette.responses import Response

from bus.errors import BadPayload
from cell.client import client_name
from cell.http.door import Door
from cell.http.hub import Listening
from cell.http.sessions import HEARTBEAT_S, Session
from cell.http.streams import PING_S, EndingStream, event

SESSION = "X-Cell-Session"
"""The header of a session's commands."""
_EVENTS = "text/event-stream"
_NAME = re.compile(r"[A-Za-z0-9._-]{1,40}")
_RETRY_MS = 1000


def name_in(request: Request) -> str:
    """Return the client's name in a request's query, "" without. Raises: BadPayload."""
    name = request.query_params.get("client", "")
    if name and _NAME.fullmatch(name) is None:
        raise BadPayload("client: at most 40 of A-Z, a-z, 0-9, '.', '_' and '-'.", "Choose another name.")
    return name


async def listen(request: Request, door: Door) -> Response:
    """Open a stream. Raises: BadPayload for a bad name, Refused (TOO_MANY)."""
    name = name_in(request)
    if request.method == "HEAD":
        return Response(media_type=_EVENTS)
    listening = door.join()
    session = door.sessions.open(client_name(f"http-{name}")) if name else None

    def end() -> None:
        door.hub.leave(listening)
        if session is not None:
            door.sessions.close(session)
            door.end(session.commander)

    return EndingStream(_told(door, listening, session), _EVENTS, end)


async def _told(door: Door, listening: Listening, session: Session | None) -> AsyncIterator[bytes]:
    yield f"retry: {_RETRY_MS}\n\n".encode()
    if session is not None:
        yield event("session", _about(session, door))
    loop = asyncio.get_running_loop()
    pinged_s = loop.time()
    while True:
        try:
            async with asyncio.timeout_at(pinged_s + PING_S):
                said = await listening.next()
        except TimeoutError:
            pinged_s = loop.time()
            yield event("ping", "{}")
            continue
        if said is None:
            return
        yield event(said.name, said.data)


def _about(session: Session, door: Door) -> str:
    return json.dumps(
        {
            "session": session.token,
            "client_id": session.client_id,
            "heartbeat_s": HEARTBEAT_S,
            "silence_s": door.settings.silence_s,
        }
    )


async def heartbeat(request: Request, door: Door) -> Response:
    """A session says that it runs. Raises: Refused (NO_LEASE) when it is over."""
    door.sessions.require(request.headers.get(SESSION), "heartbeat")
    return Response(status_code=204)

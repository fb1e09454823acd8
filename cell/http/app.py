"""The application: the table's handlers behind the guard, with an answer for every error."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.types import ASGIApp

from bus.errors import CellError
from cell.http import openapi
from cell.http.answers import answer_error, bad_value, refuse
from cell.http.door import Door
from cell.http.files import Downloads
from cell.http.guard import Guard
from cell.http.page_files import PageFiles, index
from cell.http.routes import TABLE, Handler

OPEN = ("/", "/page/", "/api", "/api/openapi.json", "/api/login")
"""Paths that need no token."""
_CODES = {404: "NOT_FOUND", 405: "METHOD", 400: "BAD_REQUEST"}
_log = logging.getLogger(__name__)


def application(door: Door) -> ASGIApp:
    """Return the whole interface of one door."""
    document, listing = openapi.document(), openapi.page()

    async def described(_request: Request) -> Response:
        return JSONResponse(document)

    async def listed(_request: Request) -> Response:
        return HTMLResponse(listing)

    routes: list[BaseRoute] = [Route(one.path, _handled(one.handler, door), methods=[one.method]) for one in TABLE]
    routes += [
        Route("/api/openapi.json", described),
        Route("/api", listed),
        Route("/", index),
        Mount("/page", PageFiles()),
        Mount("/recordings", Downloads(door.recordings, ".mcap")),
        Mount("/reports", Downloads(door.recordings, ".html")),
    ]
    handlers = {HTTPException: _not_served, Exception: _defect}
    app = Starlette(routes=routes, exception_handlers=handlers)  # type: ignore[arg-type]
    app.router.redirect_slashes = False  # a redirect would name what the client calls us
    return Guard(app, door.settings, door.access, OPEN)


def _handled(handler: Handler, door: Door) -> Callable[[Request], Awaitable[Response]]:
    """The handler with an answer for every error of the tree."""

    async def handled(request: Request) -> Response:
        try:
            return await handler(request, door)
        except CellError as error:
            return answer_error(error)
        except ValidationError as error:
            return answer_error(bad_value(error))

    return handled


async def _not_served(request: Request, error: HTTPException) -> Response:
    code = _CODES.get(error.status_code, "HTTP")
    answer = refuse(error.status_code, code, f"{request.method} {request.url.path}: {error.detail}.", "See GET /api.")
    answer.headers.update(error.headers or {})
    return answer


async def _defect(request: Request, error: Exception) -> Response:
    _log.error("defect at %s %s", request.method, request.url.path, exc_info=error)
    return refuse(500, "INTERNAL", f"{type(error).__name__} in the HTTP interface.", "This is a defect: report it.")

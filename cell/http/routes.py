"""The table of everything that is served; the application and its OpenAPI document are both made from it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from starlette.requests import Request
from starlette.responses import Response

from bus.commands import CellHealth, CellState, CommandReply, CommandRequest
from bus.frozen import Message
from bus.messages import CycleResult, Job, PlanView, Proposal
from cell.http import commands, events, reading, recorded, storage, waiting
from cell.http.door import Door
from logs.catalogue.labels import Label

Handler = Callable[[Request, Door], Awaitable[Response]]


@dataclass(frozen=True)
class Served:
    """One row of the table.

    Attributes:
        path: with ``{fields}``. ``what``: a sentence.
        takes: the body. ``says``: the answer as JSON; None where it is none of the cell's messages.
        media_type: of the answer. ``queries``: parameters after the ``?``, and what they are.
        needs_session: it may carry the header X-Cell-Session.
        refusals: statuses besides those that every request may have.
    """

    method: str
    path: str
    handler: Handler
    what: str
    takes: type[Message] | None = None
    says: type[Message] | None = None
    media_type: str = "application/json"
    queries: tuple[tuple[str, str], ...] = ()
    needs_session: bool = False
    refusals: tuple[int, ...] = ()


_NO_CELL = (503, 504)
_CLIENT = ("client", "Your name, at most 40 letters, digits, '.', '_', '-'.")

TABLE = (
    Served("GET", "/api/state", reading.state, "The machine's state now.", says=CellState, refusals=_NO_CELL),
    Served("GET", "/api/cell", reading.about, "What the station is: its name and places; your role; the clock."),
    Served("GET", "/api/health", reading.health, "The cell and its nodes now.", says=CellHealth, refusals=_NO_CELL),
    Served(
        "GET",
        "/api/events",
        events.listen,
        "Server-sent events: session, state, health, event, proposal, result, picture, scene, jobs, ping; first what"
        " counts.",
        media_type="text/event-stream",
        queries=(_CLIENT,),
        refusals=(422, 503),
    ),
    Served(
        "POST",
        "/api/heartbeat",
        events.heartbeat,
        "The session runs: every second, while it may move the arm. Answer 204; 409 when the session is over.",
        needs_session=True,
        refusals=(409,),
    ),
    Served(
        "POST",
        "/api/commands/{verb}",
        commands.command,
        "One command. What moves the arm needs a session, or attends itself (`wait`); stop, abort, hold, suspend,"
        " clear, cancel, approve, next_grasp, reject and mode need neither.",
        takes=CommandRequest,
        says=CommandReply,
        queries=(("wait", "true: the answer comes when nothing moves any more, and is the CellState."), _CLIENT),
        needs_session=True,
        refusals=(404, 409, 422, *_NO_CELL),
    ),
    Served(
        "POST",
        "/api/picks",
        waiting.pick,
        "One pick, answered with its result, after blank lines while it lasts. Who leaves before leaves it held."
        " After them an ErrorReply is possible, too: look at `ok`, or for `result`.",
        takes=Job,
        says=CycleResult,
        queries=(_CLIENT,),
        refusals=(409, 422, *_NO_CELL),
    ),
    Served(
        "GET",
        "/api/results/{cycle_id}",
        reading.result,
        "The result of one of the last 64 cycles.",
        says=CycleResult,
        refusals=(404, 422, *_NO_CELL),
    ),
    Served(
        "GET",
        "/api/proposal",
        reading.proposal,
        "The planned motion that waits for approve, next_grasp or reject.",
        says=Proposal,
        refusals=(409, *_NO_CELL),
    ),
    Served(
        "GET",
        "/api/plan",
        reading.plan,
        "The last plan in 3-D: the robot on its way, the cloud, the known boxes.",
        says=PlanView,
        refusals=(409, *_NO_CELL),
    ),
    Served(
        "GET",
        "/api/cycles",
        recorded.cycles,
        "The newest recordings; `file` and `report` are paths of this server, `labels` what persons said of them.",
        queries=(("limit", "How many, 1 to 500; 20 if left out."), ("failed", "true: only those that failed.")),
        refusals=(422,),
    ),
    Served(
        "GET",
        "/api/thumbnails/{cycle_id}",
        recorded.small_picture,
        "A small picture of a recorded cycle.",
        media_type="image/jpeg",
        refusals=(404,),
    ),
    Served(
        "POST",
        "/api/labels/{cycle_id}",
        recorded.verdict,
        "What a person says of a recorded cycle: good, bad, a note. It is appended, and changes nothing.",
        takes=recorded.Verdict,
        says=Label,
        refusals=(404, 409, 422),
    ),
    Served(
        "GET",
        "/api/summary",
        recorded.summary,
        "The figures of `cell cycles --summary --json`.",
        queries=(("day", "today, 2026-11-28, 2026-11 or 2026 (UTC); all days if left out."),),
        refusals=(404, 409, 422),
    ),
    Served("GET", "/api/storage", storage.storage, "The disk, and what will be deleted next.", refusals=(404, 409)),
    Served(
        "GET",
        "/api/picture/now",
        reading.picture_now,
        "What the camera sees now, from the capture pose: a pixel of it is a target. NOT_AT_REST while it works.",
        media_type="image/png",
        refusals=(409, *_NO_CELL),
    ),
    Served(
        "GET",
        "/api/picture",
        reading.picture,
        "The last picture.",
        media_type="image/jpeg",
        queries=(("at", "The stamp [ns] of one of the last eight."),),
        refusals=(404, 422),
    ),
    Served(
        "GET",
        "/api/scene",
        reading.scene,
        "What is drawn into it: outlines of things, grasp rectangles (the chosen one green), numbers.",
        refusals=(404,),
    ),
    Served("GET", "/api/role", reading.role, "Who you are: operator or viewer."),
    Served("POST", "/api/login", reading.login, "Keep a token in a cookie, for a browser.", takes=reading.Login),
)

"""Answers to what is read: state, health, results, the station, the last picture, who one is."""

from __future__ import annotations

import time
from functools import partial

from pydantic import Field
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from bus.codec import decode
from bus.errors import BadPayload, Refused
from bus.frozen import Message
from cell.http.answers import JSON, refuse, say
from cell.http.door import Door
from cell.http.guard import COOKIE


class Login(Message):
    """A token, to be kept by the browser in a cookie that no script can read."""

    token: str = Field(max_length=1000)


async def state(_request: Request, door: Door) -> Response:
    """Answer the state now."""
    return say(await door.ask(door.cell.state))


async def about(request: Request, door: Door) -> Response:
    """Answer with the station: name, places, whether it can be picked empty, the client's role, the clock here."""
    station = door.station
    return JSONResponse(
        {
            "cell_id": station.cell_id,
            "is_simulated": station.simulated,
            "is_never_empty": station.simulated and station.sim.clutter == 0,  # as in `cell.daemon.simulated_table`
            "places": [{"name": place.name, "capacity": place.capacity} for place in station.scene.places],
            "role": str(request.state.role),
            "now_ns": time.time_ns(),
        }
    )


async def health(_request: Request, door: Door) -> Response:
    """Answer the health now."""
    return say(await door.ask(door.cell.health))


async def result(request: Request, door: Door) -> Response:
    """Answer the result of one of the last cycles. Raises: Refused (NO_RESULT)."""
    cycle_id = request.path_params["cycle_id"]
    found = await door.ask(partial(door.cell.result, cycle_id))
    if found is None:
        raise Refused(
            f"There is no result of a cycle {cycle_id!r}: it is not over, or was not one of the last.",
            "Recorded ones: GET /api/cycles.",
            code="NO_RESULT",
        )
    return say(found)


async def proposal(_request: Request, door: Door) -> Response:
    """Answer the planned motion that waits for an answer. Raises: Refused (NO_PROPOSAL)."""
    return say(await door.ask(door.cell.proposal))


async def plan(_request: Request, door: Door) -> Response:
    """Answer the last plan, to look at in 3-D. Raises: Refused (NO_PLAN)."""
    return say(await door.ask(door.cell.plan_view))


async def picture(request: Request, door: Door) -> Response:
    """Answer the last colour image, or that of a stamp. Raises: Refused (NO_PICTURE), BadPayload."""
    shown = door.pictures.picture
    if shown is None:
        raise _nothing_shown()
    at = request.query_params.get("at", "")
    if at and not (at.isascii() and at.isdecimal() and len(at) < 20):
        raise BadPayload("at: the stamp of a picture, in ns.", "Leave it out for the last one.")
    if at and (shown := door.pictures.at(int(at))) is None:
        raise Refused("That picture is not kept any more.", "There is a newer one.", code="NO_PICTURE")
    headers = {"ETag": shown.etag, "Cache-Control": "no-cache"}
    if request.headers.get("if-none-match") == shown.etag:
        return Response(status_code=304, headers=headers)
    return Response(shown.data, media_type=shown.media_type, headers=headers)


async def picture_now(_request: Request, door: Door) -> Response:
    """Answer with what the camera sees now, from the capture pose, as a PNG file. Raises: Refused (NOT_AT_REST)."""
    taken = await door.ask(door.cell.picture)
    return Response(taken.data, media_type=taken.media_type, headers={"X-Stamp-Ns": str(taken.stamp_ns)})


async def scene(_request: Request, door: Door) -> Response:
    """Answer with what is drawn into that image: outlines, rectangles, numbers. Raises: Refused (NO_PICTURE)."""
    if not door.pictures.scene:
        raise _nothing_shown()
    return Response(door.pictures.scene, media_type=JSON)


def _nothing_shown() -> Refused:
    return Refused("The cell has shown nothing since this began.", "It does with the next pick.", code="NO_PICTURE")


async def role(request: Request, _door: Door) -> Response:
    """Answer with who the client is."""
    return JSONResponse({"role": str(request.state.role)})


async def login(request: Request, door: Door) -> Response:
    """Keep a token in a cookie, for a browser, whose pictures and downloads carry no header."""
    token = decode(Login, await request.body()).token
    found = door.access.role_of(token)
    if found is None:
        return refuse(401, "NO_TOKEN", "Nobody has this token.")
    answer = JSONResponse({"role": str(found)})
    if door.access.tokens:
        answer.set_cookie(COOKIE, token, httponly=True, samesite="strict", secure=request.url.scheme == "https")
    return answer

"""A question and what comes back: the replies, or why there is none."""

from __future__ import annotations

import time

import zenoh

from bus.codec import decode
from bus.commands import ErrorReply
from bus.errors import BusError, CellError, ReplyTimeout
from bus.heard import Heard, Tap
from bus.remote_errors import error_from_reply
from bus.topics import encoding_of

AS_ERROR = encoding_of(ErrorReply)  # a timeout is not: Zenoh itself says it
_ROUTES_S, _AGAIN_S = 1.0, 0.002


def replies_to(
    session: zenoh.Session, root: str, name: str, question: bytes, encoding: str, timeout_s: float
) -> list[zenoh.Reply]:
    """Zenoh's replies to a question on ``name`` below ``root``.

    A queryable that is not yet in the routing table of a new session is asked again for a moment: often, a stop may be
    waiting. Raises: BusError after close.
    """
    give_up = time.monotonic() + min(_ROUTES_S, timeout_s)
    while True:
        try:
            replies = list(
                session.get(
                    f"{root}{name}",
                    payload=question,
                    encoding=encoding,
                    timeout=timeout_s,
                    accept_replies=zenoh.ReplyKeyExpr.ANY,
                )
            )
        except zenoh.ZError as error:
            raise BusError(f"Cannot ask {name}: the bus is closed.") from error
        if replies or time.monotonic() > give_up:
            return replies
        time.sleep(_AGAIN_S)


def heard_in(replies: list[zenoh.Reply], root: str, name: str, timeout_s: float, record: Tap) -> list[Heard]:
    """The replies to a question on ``name`` below ``root``, each also recorded.

    Raises: the error that one of them is, as its own type; ReplyTimeout.
    """
    heard = []
    for reply in replies:
        if reply.ok is None:
            if reply.err is not None and str(reply.err.encoding) == AS_ERROR:
                record(Heard(f"{name}/error", AS_ERROR, reply.err.payload.to_bytes()))
            raise _error_from(reply.err, f"{name!r} got no answer within {timeout_s:.1f} s.")
        key = str(reply.ok.key_expr).removeprefix(root)
        key = f"{key}/reply" if key == name else key
        heard.append(Heard(key, str(reply.ok.encoding), reply.ok.payload.to_bytes()))
    for one in heard:
        record(one)
    return heard


def _error_from(failure: zenoh.ReplyError | None, timeout_text: str) -> CellError:
    if failure is None or failure.payload.to_bytes() == b"Timeout":
        return ReplyTimeout(timeout_text, "The node is busy or frozen; see its log.")
    return error_from_reply(decode(ErrorReply, failure.payload.to_bytes()))

"""One process on the bus: open Zenoh safely, publish, hear, ask, answer, be alive.

Rules this file keeps so that nobody else must (measured): loopback only unless `bus.secured` finds the way beyond it
safe; every question is answered, errors included, because silence, absence and denial look alike; callbacks only
enqueue; the encoding is always set; the session is closed on every path.
"""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, TypeVar

import zenoh

from bus import topics
from bus.codec import decode, encode
from bus.commands import ErrorReply
from bus.errors import BadPayload, BusError, CellError, CellUnreachable, NoReply, PortOccupied, ReplyTimeout
from bus.frozen import Message
from bus.lane import Lane
from bus.remote_errors import error_from_reply, error_reply
from bus.secured import LEASE_MS, MAX_PAYLOAD_BYTES, is_loopback, session_config
from bus.topics import Topic, encoding_of

__all__ = ["LEASE_MS", "MAX_PAYLOAD_BYTES", "Bus", "Handler", "Heard", "Tap"]

MAX_RECORDED_QUESTION_BYTES = 64 * 1024
"""Longer questions to a cell that records are a stranger's; its commands have some hundred bytes."""

_log = logging.getLogger(__name__)
_FIELD = re.compile(r"\{\w+\}")
_AS_ERROR = encoding_of(ErrorReply)  # a timeout is not: Zenoh itself says it

MessageT = TypeVar("MessageT", bound=Message)


class Heard(NamedTuple):
    """One payload that travelled: ``key`` is below ``cell/{cell_id}/``."""

    key: str
    encoding: str
    payload: bytes


Tap = Callable[[Heard], None]
Handler = Callable[[bytes, Mapping[str, str]], "Message | list[Heard]"]


class Bus:
    """A Zenoh session that speaks the topic table of one cell.

    Args:
        session: an open Zenoh session, owned from now on.
        cell_id: the cell's name in every key.

    Attributes:
        tap: called with everything this process publishes, asks and is answered; set by whoever records.
    """

    def __init__(self, session: zenoh.Session, cell_id: str, security: Path | None = None) -> None:
        self.cell_id = cell_id
        self.tap: Tap | None = None
        self._session = session
        self._security = security
        self._lanes: dict[str, Lane] = {}
        self._making = threading.Lock()
        self._declared: list[Any] = []

    @classmethod
    def listen(
        cls,
        cell_id: str,
        endpoint: str,
        *,
        beyond: str | None = None,
        router: str | None = None,
        security: Path | None = None,
    ) -> Bus:
        """Open the cell's own endpoint.

        Args:
            endpoint: on loopback, for this machine's programs.
            beyond: another one, for other machines. ``router``: one to join, now or whenever it is up.
            security: the Zenoh file that makes these two safe.

        Raises: PortOccupied; ConfigError when that file does not make them safe.
        """
        listen = [endpoint, beyond] if beyond else [endpoint]
        security = None if all(is_loopback(one) for one in (*listen, router) if one) else security
        config = session_config("peer", listen=listen, connect=[router] if router else [], file=security)
        try:
            return cls(zenoh.open(config), cell_id, security)
        except zenoh.ZError as error:
            also = ", or an address is not this machine's" if beyond else ""
            raise PortOccupied(
                f"Cannot listen on {' and '.join(listen)}: another program uses it{also}.",
                "Is the cell already running (`cell status`)? Else choose another port: --set bus.endpoint=...",
            ) from error

    @classmethod
    def join(cls, cell_id: str, endpoint: str, *, security: Path | None = None) -> Bus:
        """Connect to a running cell, or to a router. Raises: CellUnreachable; ConfigError as `listen`."""
        security = None if is_loopback(endpoint) else security
        config = session_config("client", listen=[], connect=[endpoint], file=security)
        try:
            return cls(zenoh.open(config), cell_id, security)
        except zenoh.ZError as error:
            advice = "Start it with `cell start`, or name its --config."
            if security is not None:
                advice += f" Or it does not accept the certificate of {security}, or has one of another name."
            raise CellUnreachable(f"No cell answers at {endpoint}.", advice) from error

    def key(self, topic: Topic, **fields: str) -> str:
        """The whole Zenoh key of ``topic`` in this cell."""
        return f"{topics.ROOT}/{self.cell_id}/{topic.key.format(**fields)}"

    def _short(self, key: object) -> str:
        return str(key).removeprefix(f"{topics.ROOT}/{self.cell_id}/")

    def _record(self, heard: Heard) -> None:
        if self.tap is not None:
            self.tap(heard)

    # --- publish and hear ---------------------------------------------------------------------------------------------

    def publish(self, topic: Topic, message: Message | bytes, **fields: str) -> None:
        """Put one message (or the protobuf bytes of one) on ``topic``. Raises: BusError after close."""
        payload = message if isinstance(message, bytes) else encode(message)
        encoding = encoding_of(topic.says)
        try:
            self._session.put(self.key(topic, **fields), payload, encoding=encoding)
        except zenoh.ZError as error:
            raise BusError(f"Cannot publish {topic.key}: the bus is closed.") from error
        if topic.logged:
            self._record(Heard(topic.key.format(**fields), encoding, payload))

    def put(self, key: str, payload: bytes, encoding: str) -> None:
        """Put bytes on a whole Zenoh ``key`` that is none of this cell's. Raises: BusError after close."""
        try:
            self._session.put(key, payload, encoding=encoding)
        except zenoh.ZError as error:
            raise BusError(f"Cannot publish {key}: the bus is closed.") from error

    def is_heard(self, pattern: str) -> bool:
        """Whether anybody else subscribes to something of ``pattern``, a whole Zenoh key expression."""
        publisher = self._session.declare_publisher(pattern, allowed_destination=zenoh.Locality.REMOTE)
        try:
            status: Any = publisher.matching_status  # its stub calls it a bool; it is an object, and true
            return bool(status.matching)
        finally:
            publisher.undeclare()  # type: ignore[no-untyped-call]

    def subscribe(self, pattern: str, callback: Callable[[Heard], None], *, own: bool = False) -> None:
        """Call ``callback`` with what others (or also we: ``own``) publish on ``pattern`` below the cell's root.

        The callback runs on Zenoh's thread: it may only enqueue.
        """

        def hear(sample: zenoh.Sample) -> None:
            if len(sample.payload) > MAX_PAYLOAD_BYTES:
                _log.warning("%s: %d bytes are too many; not heard", sample.key_expr, len(sample.payload))
                return
            callback(Heard(self._short(sample.key_expr), str(sample.encoding), sample.payload.to_bytes()))

        origin = zenoh.Locality.ANY if own else zenoh.Locality.REMOTE
        key = f"{topics.ROOT}/{self.cell_id}/{pattern}"
        self._declared.append(self._session.declare_subscriber(key, hear, allowed_origin=origin))

    # --- ask and answer -----------------------------------------------------------------------------------------------

    def ask(self, topic: Topic, request: Message, *, timeout_s: float, **fields: str) -> list[Heard]:
        """Every reply to one question.

        Raises: NoReply (nobody there), ReplyTimeout, or the error the other side answered with, as its own type.
        """
        key, question = self.key(topic, **fields), encode(request)
        if topic.logged:
            self._record(Heard(f"{self._short(key)}/query", encoding_of(topic.asks), question))
        replies = self._get(key, question, encoding_of(topic.asks), timeout_s)
        if not replies:
            advice = "Is the node that serves it running? See `cell status`."
            if self._security is not None:
                advice += f" Or the certificate of {self._security} may not ask this: docs/security.md."
            raise NoReply(f"Nobody answers {self._short(key)!r}.", advice)
        heard = []
        for reply in replies:
            if reply.ok is None:
                if topic.logged and reply.err is not None and str(reply.err.encoding) == _AS_ERROR:
                    self._record(Heard(f"{self._short(key)}/error", _AS_ERROR, reply.err.payload.to_bytes()))
                raise _error_from(reply.err, f"{self._short(key)!r} got no answer within {timeout_s:.1f} s.")
            name = self._short(reply.ok.key_expr)
            name = f"{name}/reply" if name == self._short(key) else name
            heard.append(Heard(name, str(reply.ok.encoding), reply.ok.payload.to_bytes()))
        if topic.logged:
            for one in heard:
                self._record(one)
        return heard

    def request(
        self, topic: Topic, request: Message, answer_type: type[MessageT], *, timeout_s: float, **fields: str
    ) -> MessageT:
        """The one decoded answer to one question. Raises: as `ask`, and BadPayload."""
        answer = self.ask(topic, request, timeout_s=timeout_s, **fields)[0]
        try:
            return decode(answer_type, answer.payload)
        except BadPayload as error:
            key = topic.key.format(**fields)
            raise BadPayload(f"{key!r} was answered with what cannot be read: {error.text}", "See its node.") from error

    def _get(self, key: str, payload: bytes, encoding: str, timeout_s: float) -> list[zenoh.Reply]:
        """Zenoh's replies; a queryable that is not yet in the routing table is asked again for a moment."""
        give_up = time.monotonic() + min(1.0, timeout_s)
        while True:
            try:
                replies = list(
                    self._session.get(
                        key,
                        payload=payload,
                        encoding=encoding,
                        timeout=timeout_s,
                        accept_replies=zenoh.ReplyKeyExpr.ANY,
                    )
                )
            except zenoh.ZError as error:
                raise BusError(f"Cannot ask {self._short(key)}: the bus is closed.") from error
            if replies or time.monotonic() > give_up:
                return replies
            time.sleep(0.05)

    def answer(self, topic: Topic, handler: Handler, *, lane: str | Callable[[str], str], **fields: str) -> None:
        """Answer questions on ``topic`` with ``handler(payload, fields)``, one at a time per ``lane`` (a thread).

        A ``lane`` that depends on the key's last chunk keeps what is urgent from waiting for what is not.

        The handler returns a message, or the payloads to reply with. A `CellError` it raises is sent back typed.
        """
        key = self.key(topic, **fields)

        def receive(query: zenoh.Query) -> None:
            name = lane if isinstance(lane, str) else lane(str(query.key_expr).rpartition("/")[2])
            self.lane(name).post(lambda: self._reply(topic, query, handler))

        self._declared.append(self._session.declare_queryable(key, receive))

    def lane(self, name: str) -> Lane:
        """The lane called ``name``; made on first use."""
        with self._making:
            if name not in self._lanes:
                self._lanes[name] = Lane(name)
            return self._lanes[name]

    def _reply(self, topic: Topic, query: zenoh.Query, handler: Handler) -> None:
        with query:
            payload = query.payload.to_bytes() if query.payload is not None else b"{}"
            verb = str(query.key_expr).rpartition("/")[2]
            name = _FIELD.sub(verb, topic.key)  # not the question's key: that may be a pattern over many cells
            fields = {"verb": verb}
            try:
                if len(payload) > MAX_PAYLOAD_BYTES:
                    raise BadPayload(f"The payload has {len(payload)} bytes; at most {MAX_PAYLOAD_BYTES} are accepted.")
                answer = handler(payload, fields)
            except CellError as error:
                said = encode(error_reply(error))
                self._record_answered(topic, name, payload, [Heard(f"{name}/error", _AS_ERROR, said)])
                query.reply_err(said, encoding=_AS_ERROR)
                return
            except Exception as error:
                defect = ErrorReply(
                    error="CellError",
                    code="INTERNAL",
                    text=f"{type(error).__name__}: {error}",
                    advice="This is a defect.",
                )
                query.reply_err(encode(defect), encoding=_AS_ERROR)
                raise
            if isinstance(answer, Message):
                answer = [Heard(name, encoding_of(type(answer)), encode(answer))]
            told = [part._replace(key=f"{name}/reply") if part.key == name else part for part in answer]
            self._record_answered(topic, name, payload, told)
            for part in answer:
                key = f"{topics.ROOT}/{self.cell_id}/{part.key}"
                query.reply(key, part.payload, encoding=part.encoding)

    def survey(self, topic: Topic, request: Message, *, timeout_s: float) -> dict[str, bytes]:
        """What every cell that can be seen answers to one question, by cell id; the bus's ``cell_id`` is ``*``."""
        replies = self._get(self.key(topic), encode(request), encoding_of(topic.asks), timeout_s)
        answers = [reply.ok for reply in replies if reply.ok is not None]
        return {str(answer.key_expr).split("/")[1]: answer.payload.to_bytes() for answer in answers}

    def _record_answered(self, topic: Topic, name: str, question: bytes, told: list[Heard]) -> None:
        """What we were asked and said: recorded together, when it is answered. What is far too long is not kept."""
        if topic.logged and self.tap is not None and len(question) <= MAX_RECORDED_QUESTION_BYTES:
            for heard in (Heard(f"{name}/query", encoding_of(topic.asks), question), *told):
                self._record(heard)

    # --- be alive -----------------------------------------------------------------------------------------------------

    def announce(self, topic: Topic, **fields: str) -> None:
        """Hold a liveliness token (a node's, a lease) until close."""
        self._declared.append(self._session.liveliness().declare_token(self.key(topic, **fields)))

    def alive(self, topic: Topic) -> set[str]:
        """Who holds a token of ``topic``, a key with one field."""
        replies = self._session.liveliness().get(self.key(topic, name="*"), timeout=1.0)
        return {self._short(reply.ok.key_expr).split("/")[1] for reply in replies if reply.ok is not None}

    def watch_alive(self, topic: Topic, callback: Callable[[str, bool], None]) -> None:
        """Call ``callback(name, is_alive)`` when a token of ``topic`` comes or goes; it may only enqueue."""

        def change(sample: zenoh.Sample) -> None:
            callback(self._short(sample.key_expr).split("/")[1], sample.kind == zenoh.SampleKind.PUT)

        key = self.key(topic, name="*")
        self._declared.append(self._session.liveliness().declare_subscriber(key, change, history=True))

    # --- close --------------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Undeclare everything and close; idempotent."""
        for lane in self._lanes.values():
            lane.close()
        if not self._session.is_closed():
            self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Bus:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def _error_from(failure: zenoh.ReplyError | None, timeout_text: str) -> CellError:
    if failure is None or failure.payload.to_bytes() == b"Timeout":
        return ReplyTimeout(timeout_text, "The node is busy or frozen; see its log.")
    return error_from_reply(decode(ErrorReply, failure.payload.to_bytes()))

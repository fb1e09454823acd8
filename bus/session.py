"""One process on the bus: open Zenoh safely, publish, hear, ask, answer, be alive.

Rules this file keeps so that nobody else must (measured): loopback only unless `bus.secured` finds the way beyond it
safe; every question is answered, errors included, because silence, absence and denial look alike; callbacks only
enqueue; the encoding is always set, and so is the source; the session is closed on every path. What comes back of a
question is in `bus.asking`, how one is answered in `bus.answering`, and who may ask what acts in `bus.access`.
"""

from __future__ import annotations

import itertools
import logging
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import zenoh

from bus import topics
from bus.access import asked, is_sealed, refusal, source_of
from bus.answering import Answers, payload_of, refuse, reply_to
from bus.asking import Signed, heard_in, replies_to
from bus.codec import decode, encode
from bus.errors import BadPayload, BusError, CellUnreachable, NoReply, PortOccupied, Refused
from bus.frozen import Message
from bus.sample import Asked, Handler, Sample, Tap, WorkerOf
from bus.seal import Seal
from bus.secured import MAX_PAYLOAD_BYTES, is_loopback, session_config
from bus.topics import Topic, encoding_of
from bus.worker import SerialWorker

_log = logging.getLogger(__name__)

MessageT = TypeVar("MessageT", bound=Message)
_LATE_S = 1.0
"""Zenoh's own end of a question may come so late."""
_LAST_NUMBER = 0xFFFFFFFF
"""Zenoh numbers what a session says with 32 bits."""


class Bus:
    """A Zenoh session that speaks the topic table of one cell.

    Args:
        session: an open Zenoh session, owned from now on.
        cell_id: the cell's name in every key.
        is_host: it is the cell's own, which others join.

    Attributes:
        tap: called with everything this process publishes, asks and is answered; set by whoever records.
        seal: of the secret that the cell shares with the nodes it starts; None for everybody else.
    """

    def __init__(
        self, session: zenoh.Session, cell_id: str, security: Path | None = None, *, is_host: bool = False
    ) -> None:
        self.cell_id, self._is_host = cell_id, is_host
        self._root = f"{topics.ROOT}/{cell_id}/"
        self.tap: Tap | None = None
        self._session = session
        self._security = security
        self._workers: dict[str, SerialWorker] = {}
        self._making = threading.Lock()
        self._declared: list[Any] = []
        self._tokens: dict[str, Any] = {}  # by their whole key
        self._numbers = itertools.count()
        self.seal = Seal.new() if is_host else None

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
            return cls(zenoh.open(config), cell_id, security, is_host=True)
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
        return f"{self._root}{topic.key.format(**fields)}"

    @property
    def source(self) -> str:
        """This session, as others see where its samples and questions come from."""
        return str(self._session.zid())

    @property
    def cell(self) -> str | None:
        """The session of the cell: the one that was joined, or this one; None behind a router.

        There it cannot be told, and certificates say who may speak for the cell (docs/security.md).
        """
        if self._is_host:
            return self.source
        peers = list(self._session.info.peers_zid())
        return str(peers[0]) if len(peers) == 1 else None

    def _signed(self, key: str, payload: bytes) -> Signed:
        """Who says or asks this, and with which number; sealed where we have a secret."""
        number = next(self._numbers) & _LAST_NUMBER
        seal = self.seal.of(key, self.source, number, payload) if self.seal is not None else None
        return Signed(zenoh.SourceInfo(self._session.id, number), seal)

    def _short(self, key: object) -> str:
        return str(key).removeprefix(self._root)

    def _record(self, sample: Sample) -> None:
        if self.tap is not None:
            self.tap(sample)

    # --- publish and hear ---------------------------------------------------------------------------------------------

    def publish(self, topic: Topic, message: Message | bytes, **fields: str) -> None:
        """Put one message (or the protobuf bytes of one) on ``topic``. Raises: BusError after close."""
        payload = message if isinstance(message, bytes) else encode(message)
        encoding, key = encoding_of(topic.says), self.key(topic, **fields)
        signed = self._signed(key, payload)
        try:
            self._session.put(key, payload, encoding=encoding, source_info=signed.source, attachment=signed.seal)
        except zenoh.ZError as error:
            raise BusError(f"Cannot publish {topic.key}: the bus is closed.") from error
        if topic.logged:
            self._record(Sample(topic.key.format(**fields), encoding, payload))

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

    def subscribe(self, pattern: str, callback: Callable[[Sample], None], *, own: bool = False) -> None:
        """Call ``callback`` with what others (or also we: ``own``) publish on ``pattern`` below the cell's root.

        The callback runs on Zenoh's thread: it may only enqueue.
        """

        def hear(sample: zenoh.Sample) -> None:
            if len(sample.payload) > MAX_PAYLOAD_BYTES:
                _log.warning("%s: %d bytes are too many; not heard", sample.key_expr, len(sample.payload))
                return
            key, payload, sealed = self._short(sample.key_expr), sample.payload.to_bytes(), is_sealed(sample, self.seal)
            callback(Sample(key, str(sample.encoding), payload, source_of(sample), sealed))

        origin = zenoh.Locality.ANY if own else zenoh.Locality.REMOTE
        self._declared.append(self._session.declare_subscriber(f"{self._root}{pattern}", hear, allowed_origin=origin))

    # --- ask and answer -----------------------------------------------------------------------------------------------

    def ask(self, topic: Topic, request: Message, *, timeout_s: float, **fields: str) -> list[Sample]:
        """Every reply to one question.

        Raises: NoReply (nobody there), ReplyTimeout, TwoAnswers, or the error the other side answered with, as its own
        type.
        """
        name, question, encoding = topic.key.format(**fields), encode(request), encoding_of(topic.asks)
        record = self._record if topic.logged else _do_not_record
        record(Sample(f"{name}/query", encoding, question))
        key = f"{self._root}{name}"
        replies = replies_to(self._session, key, question, encoding, timeout_s, self._signed(key, question))
        if not replies:
            advice = "Is the node that serves it running? See `cell status`."
            if self._security is not None:
                advice += f" Or the certificate of {self._security} may not ask this: docs/security.md."
            raise NoReply(f"Nobody answers {name!r}.", advice)
        return heard_in(replies, self._root, name, timeout_s, record)

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

    def answer(self, topic: Topic, handler: Handler, *, worker: str | WorkerOf, **fields: str) -> None:
        """Answer questions on ``topic`` with ``handler(payload, asked)``, one at a time per ``worker`` (a thread).

        A ``worker`` that depends on the question keeps what is urgent from waiting for what is not. What is refused
        unseen (`bus.access`) waits for nothing.

        The handler returns a message, or the payloads to reply with. A `CellError` it raises is sent back typed.
        """
        key, answers = self.key(topic, **fields), Answers()

        def receive(query: zenoh.Query) -> None:
            question = asked(query, self.seal)
            why = refusal(topic, question, self.cell, needs_seal=self.seal is not None)
            if why is not None:
                self.worker("refusals").post(partial(_refuse, query, why))
                return
            name = worker if isinstance(worker, str) else worker(question, payload_of(query))
            self.worker(name).post(lambda: self._reply(topic, key, query, question, handler, answers))

        self._declared.append(self._session.declare_queryable(key, receive))

    def worker(self, name: str) -> SerialWorker:
        """The lane called ``name``; made on first use."""
        with self._making:
            if name not in self._workers:
                self._workers[name] = SerialWorker(name)
            return self._workers[name]

    def _reply(
        self, topic: Topic, key: str, query: zenoh.Query, question: Asked, handler: Handler, answers: Answers
    ) -> None:
        with query:
            reply_to(query, question, topic, key, handler, self._record, answers)

    def survey(self, topic: Topic, request: Message, *, timeout_s: float) -> dict[str, bytes]:
        """What every cell that can be seen answers to one question, by cell id; the bus's ``cell_id`` is ``*``."""
        encoding = encoding_of(topic.asks)
        key, question = f"{self._root}{topic.key}", encode(request)
        replies = replies_to(
            self._session, key, question, encoding, timeout_s, self._signed(key, question), others_s=timeout_s
        )
        answers = [reply.ok for reply in replies if reply.ok is not None]
        return {str(answer.key_expr).split("/")[1]: answer.payload.to_bytes() for answer in answers}

    def sessions(self, topic: Topic, *, timeout_s: float, **fields: str) -> dict[str, bytes]:
        """Who answers a question without content on ``topic``, and what: by session; a refusal is an answer, too."""
        key, encoding = self.key(topic, **fields), encoding_of(topic.asks)
        signed = self._signed(key, b"{}")
        replies = replies_to(self._session, key, b"{}", encoding, timeout_s, signed, others_s=timeout_s + _LATE_S)
        payloads = ((one.replier_id, one.ok.payload if one.ok is not None else None) for one in replies)
        return {str(who.zid): said.to_bytes() if said is not None else b"" for who, said in payloads if who is not None}

    # --- be alive -----------------------------------------------------------------------------------------------------

    def announce(self, topic: Topic, **fields: str) -> None:
        """Hold a liveliness token (a node's, a lease) until `withdraw` or close."""
        key = self.key(topic, **fields)
        self._tokens[key] = self._session.liveliness().declare_token(key)

    def withdraw(self, topic: Topic, **fields: str) -> None:
        """Give a token back; nothing when it is not held."""
        token = self._tokens.pop(self.key(topic, **fields), None)
        if token is not None:
            token.undeclare()

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
        for worker in self._workers.values():
            worker.close()
        if not self._session.is_closed():
            self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Bus:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def _refuse(query: zenoh.Query, why: Refused) -> None:
    with query:
        refuse(query, why)


def _do_not_record(_heard: Sample) -> None: ...

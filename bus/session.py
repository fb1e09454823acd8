"""One process on the bus: open Zenoh safely, publish, subscribe, ask, answer, announce liveliness.

Rules that this file keeps for all its users (measured): loopback only, unless `bus.secured` approves the way beyond
it; every query is answered, errors included, because silence, absence and denial look alike; callbacks only enqueue;
encoding and source are always set; the session is closed on every path. `bus.asking` handles the replies to a query,
`bus.answering` the answers, and `bus.access` who may ask a topic that acts.
"""

from __future__ import annotations

import itertools
import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import zenoh

from bus import topics
from bus.access import asked, is_sealed, refusal, source_of
from bus.answering import Answers, payload_of, refuse, reply_to
from bus.asking import Signed, replies_to, samples_in, tokens_on
from bus.clock import WALL_CLOCK, DeadlineClock
from bus.codec import decode, encode
from bus.errors import BadPayload, BusError, CellUnreachable, NoReply, PortOccupied, Refused
from bus.frozen import Message
from bus.sample import Asked, Handler, Sample, Tap, WorkerOf
from bus.seal import Seal
from bus.secured import MAX_PAYLOAD_BYTES, needed_file, session_config
from bus.topics import Topic, encoding_of
from bus.worker import SerialWorker

_log = logging.getLogger(__name__)

MessageT = TypeVar("MessageT", bound=Message)
_TOKENS_S = 1.0
_HEARING = "hearing"
_HANDED_ON_S = 1.0
"""Longest wait for what was heard to be handed on [s]."""
_LATE_S = 1.0
"""How late Zenoh may report the end of a query [s]."""
_LAST_NUMBER = 0xFFFFFFFF
"""Zenoh's sequence numbers have 32 bits."""


class Bus:
    """A Zenoh session that uses the topic table of one cell.

    Args:
        session: an open Zenoh session, owned from now on.
        cell_id: the cell's name in every key.
        security: the Zenoh file that the session was opened with, for error texts.
        is_host: it is the cell's own session, which others join.

    Attributes:
        tap: receives everything this process publishes, asks and is answered; set by a recorder.
        seal: of the secret that the cell shares with the nodes it starts; None for every other process.
        clock: the clock of every deadline of this process (`config.clock.clock_of`).
    """

    def __init__(
        self,
        session: zenoh.Session,
        cell_id: str,
        security: Path | None = None,
        *,
        is_host: bool = False,
        clock: DeadlineClock = WALL_CLOCK,
    ) -> None:
        self.cell_id, self._is_host, self.clock = cell_id, is_host, clock
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
        clock: DeadlineClock = WALL_CLOCK,
    ) -> Bus:
        """Open the cell's own endpoint.

        Args:
            endpoint: on loopback, for this machine's programs.
            beyond: another one, for other machines. ``router``: one to join, now or once it is up.
            security: the Zenoh file that makes these two safe.

        Raises:
            PortOccupied: another program listens there.
            ConfigError: the file is not there, or does not make the endpoints safe.
        """
        listen = [endpoint, beyond] if beyond else [endpoint]
        security = needed_file(security, (*listen, router))
        connect, waits = [router] if router else [], clock.is_slowed
        config = session_config("peer", listen=listen, connect=connect, file=security, is_slowed=waits)
        try:
            return cls(zenoh.open(config), cell_id, security, is_host=True, clock=clock)
        except zenoh.ZError as error:
            also = ", or an address is not this machine's" if beyond else ""
            raise PortOccupied(
                f"Cannot listen on {' and '.join(listen)}: another program uses it{also}.",
                "Is the cell already running (`cell status`)? Else choose another port: --set bus.endpoint=...",
            ) from error

    @classmethod
    def join(
        cls, cell_id: str, endpoint: str, *, security: Path | None = None, clock: DeadlineClock = WALL_CLOCK
    ) -> Bus:
        """Connect to a running cell, or to a router. Raises: CellUnreachable; ConfigError as `listen`."""
        security, waits = needed_file(security, [endpoint]), clock.is_slowed
        config = session_config("client", listen=[], connect=[endpoint], file=security, is_slowed=waits)
        try:
            return cls(zenoh.open(config), cell_id, security, clock=clock)
        except zenoh.ZError as error:
            advice = "Start it with `cell start`, or name its --config."
            if security is not None:
                advice += f" Or it does not accept the certificate of {security}, or has one of another name."
            raise CellUnreachable(f"No cell answers at {endpoint}.", advice) from error

    def key(self, topic: Topic, **fields: str) -> str:
        """Return the complete Zenoh key of ``topic`` in this cell; ``fields`` fill its ``{field}``."""
        return f"{self._root}{topic.key.format(**fields)}"

    @property
    def is_secured(self) -> bool:
        """Whether it joined through certificates: rules of access may hide what is there."""
        return self._security is not None

    @property
    def source(self) -> str:
        """Id of this session, as other sessions see it in samples and queries."""
        with self._open() as session:
            return str(session.zid())

    @property
    def cell(self) -> str | None:
        """Id of the cell's session: the one that was joined, or this one; None behind a router.

        A router hides it; there certificates decide who may publish for the cell (docs/security.md).
        """
        if self._is_host:
            return self.source
        with self._open() as session:
            peers = list(session.info.peers_zid())
        return str(peers[0]) if len(peers) == 1 else None

    def _signed(self, key: str, payload: bytes) -> Signed:
        """Return this session with the next number, sealed where there is a secret."""
        number = next(self._numbers) & _LAST_NUMBER
        seal = self.seal.of(key, self.source, number, payload) if self.seal is not None else None
        with self._open() as session:
            return Signed(zenoh.SourceInfo(session.id, number), seal)

    @contextmanager
    def _open(self) -> Iterator[zenoh.Session]:
        """Give the session; what Zenoh refuses meanwhile, closed by any thread, is a BusError."""
        try:
            yield self._session
        except zenoh.ZError as error:
            if self._session.is_closed():
                raise BusError("This connection is closed.", "Open a new one.") from error
            raise BusError(f"Zenoh refuses it: {error}.") from error

    def _short(self, key: object) -> str:
        return str(key).removeprefix(self._root)

    def _record(self, sample: Sample) -> None:
        if self.tap is not None:
            self.tap(sample)

    # --- publish and subscribe ----------------------------------------------------------------------------------------

    def publish(self, topic: Topic, message: Message | bytes, **fields: str) -> None:
        """Publish one message, or the protobuf bytes of one, on ``topic``. Raises: BusError after close."""
        payload = message if isinstance(message, bytes) else encode(message)
        encoding, key = encoding_of(topic.says), self.key(topic, **fields)
        signed = self._signed(key, payload)
        with self._open() as session:
            session.put(key, payload, encoding=encoding, source_info=signed.source, attachment=signed.seal)
        if topic.logged:
            self._record(Sample(topic.key.format(**fields), encoding, payload))

    def put(self, key: str, payload: bytes, encoding: str) -> None:
        """Publish bytes on a complete Zenoh ``key`` outside this cell's table. Raises: BusError after close."""
        with self._open() as session:
            session.put(key, payload, encoding=encoding)

    def is_heard(self, pattern: str) -> bool:
        """Whether another session subscribes to a key that matches ``pattern``, a complete Zenoh key expression."""
        with self._open() as session:
            publisher = session.declare_publisher(pattern, allowed_destination=zenoh.Locality.REMOTE)
            try:
                status: Any = publisher.matching_status  # its typing says bool; it is an object, which is always truthy
                return bool(status.matching)
            finally:
                publisher.undeclare()  # type: ignore[no-untyped-call]

    def subscribe(
        self, pattern: str, callback: Callable[[Sample], None], *, own: bool = False, in_order: bool = False
    ) -> None:
        """Call ``callback`` with every sample that others publish on ``pattern`` below the cell's root.

        The callback runs on a thread of Zenoh: it may only enqueue. Each subscription has a thread of its own, so one
        may be called before another although its sample came after. Samples above the payload limit are dropped, with
        a warning.

        Args:
            own: call it with this session's own samples too.
            in_order: call it on one thread with all others for which this is set, in the order of what they hear.
                The link then waits for Python with every sample: not for streams.
        """

        def hear(sample: zenoh.Sample) -> None:
            if len(sample.payload) > MAX_PAYLOAD_BYTES:
                _log.warning("%s: %d bytes are too many; not heard", sample.key_expr, len(sample.payload))
                return
            key, payload, sealed = self._short(sample.key_expr), sample.payload.to_bytes(), is_sealed(sample, self.seal)
            callback(Sample(key, str(sample.encoding), payload, source_of(sample), sealed))

        origin = zenoh.Locality.ANY if own else zenoh.Locality.REMOTE
        called = self._in_order(hear) if in_order else hear
        with self._open() as session:
            self._declared.append(session.declare_subscriber(f"{self._root}{pattern}", called, allowed_origin=origin))

    def _in_order(self, hear: Callable[[zenoh.Sample], None]) -> zenoh.handlers.Callback[zenoh.Sample]:
        """Return what Zenoh calls on the thread of the link itself, which only enqueues for the one that hears."""
        worker = self.worker(_HEARING)
        return zenoh.handlers.Callback(lambda sample: worker.post(partial(hear, sample)), indirect=False)

    def await_heard(self) -> None:
        """Return when what came before now on subscriptions ``in_order`` was given to their callbacks.

        An answer comes by the same link, after what was published before it, and is here before its turn in the queue.
        """
        worker = self._workers.get(_HEARING)
        if worker is not None:
            with suppress(TimeoutError):  # this session closes
                worker.submit(lambda: None).result(_HANDED_ON_S)

    # --- ask and answer -----------------------------------------------------------------------------------------------

    def ask(self, topic: Topic, request: Message, *, timeout_s: float, **fields: str) -> list[Sample]:
        """Send one query and return every reply.

        Args:
            timeout_s: how long to wait for a reply [s].
            fields: fill the ``{field}`` of the topic's key.

        Raises:
            NoReply: no process serves the key.
            ReplyTimeout: a process serves it, but did not answer in time.
            TwoAnswers: several sessions serve it.
            CellError: the error that the other process answered with, as its own type.
        """
        name, question, encoding = topic.key.format(**fields), encode(request), encoding_of(topic.asks)
        record = self._record if topic.logged else _do_not_record
        record(Sample(f"{name}/query", encoding, question))
        key = f"{self._root}{name}"
        signed = self._signed(key, question)
        replies = replies_to(self._session, key, question, encoding, timeout_s, signed, self.clock)
        if not replies:
            advice = "Is the node that serves it running? See `cell status`."
            if self._security is not None:
                advice += f" Or the certificate of {self._security} may not ask this: docs/security.md."
            raise NoReply(f"Nobody answers {name!r}.{self.clock.busy_note()}", advice)
        return samples_in(replies, self._root, name, timeout_s, record, self.clock)

    def request(
        self, topic: Topic, request: Message, answer_type: type[MessageT], *, timeout_s: float, **fields: str
    ) -> MessageT:
        """Send one query and return its decoded answer within ``timeout_s`` [s]. Raises: as `ask`, and BadPayload."""
        answer = self.ask(topic, request, timeout_s=timeout_s, **fields)[0]
        try:
            return decode(answer_type, answer.payload)
        except BadPayload as error:
            key = topic.key.format(**fields)
            raise BadPayload(f"{key!r} was answered with what cannot be read: {error.text}", "See its node.") from error

    def answer(self, topic: Topic, handler: Handler, *, worker: str | WorkerOf, **fields: str) -> None:
        """Answer queries on ``topic`` with ``handler(payload, asked)``, one at a time per ``worker`` (a thread).

        A query that `bus.access` refuses is answered by a worker of its own and does not wait.

        Args:
            handler: returns a message, or the payloads to reply with; a `CellError` it raises is sent back typed.
            worker: name of the worker, or a function that names it by the query, so that urgent queries do not wait
                for others.
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

        with self._open() as session:
            self._declared.append(session.declare_queryable(key, receive))

    def worker(self, name: str) -> SerialWorker:
        """Return the worker called ``name``; it is made at first use."""
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
        """Ask one query of every visible cell and return the answers by cell id; this bus's ``cell_id`` is then ``*``.

        Args:
            timeout_s: how long to collect answers [s].
        """
        encoding = encoding_of(topic.asks)
        key, question = f"{self._root}{topic.key}", encode(request)
        signed = self._signed(key, question)
        replies = replies_to(self._session, key, question, encoding, timeout_s, signed, self.clock, others_s=timeout_s)
        answers = [reply.ok for reply in replies if reply.ok is not None]
        return {str(answer.key_expr).split("/")[1]: answer.payload.to_bytes() for answer in answers}

    def sessions(self, topic: Topic, *, timeout_s: float, **fields: str) -> dict[str, bytes]:
        """Ask a query without content on ``topic`` and return the answers by session; a refusal counts, as empty bytes.

        Args:
            timeout_s: how long to collect answers [s].
        """
        key, encoding = self.key(topic, **fields), encoding_of(topic.asks)
        signed = self._signed(key, b"{}")
        replies = replies_to(
            self._session, key, b"{}", encoding, timeout_s, signed, self.clock, others_s=timeout_s + _LATE_S
        )
        payloads = ((one.replier_id, one.ok.payload if one.ok is not None else None) for one in replies)
        return {str(who.zid): said.to_bytes() if said is not None else b"" for who, said in payloads if who is not None}

    # --- be alive -----------------------------------------------------------------------------------------------------

    def announce(self, topic: Topic, **fields: str) -> None:
        """Hold a liveliness token (of a node or a lease) until `withdraw` or close."""
        key = self.key(topic, **fields)
        with self._open() as session:
            self._tokens[key] = session.liveliness().declare_token(key)

    def withdraw(self, topic: Topic, **fields: str) -> None:
        """Give a token back; without effect when it is not held. A closed session holds none."""
        token = self._tokens.pop(self.key(topic, **fields), None)
        if token is not None and not self._session.is_closed():
            with self._open():
                token.undeclare()

    def alive(self, topic: Topic) -> set[str]:
        """Return the names whose token of ``topic``, a key with one field, is held now.

        Raises: ReplyTimeout when that is not known in time; BusError.
        """
        with self._open() as session:
            replies = tokens_on(session, self.key(topic, name="*"), _TOKENS_S, self.clock)
        return {self._short(reply.ok.key_expr).split("/")[1] for reply in replies if reply.ok is not None}

    def watch_alive(self, topic: Topic, callback: Callable[[str, bool], None]) -> None:
        """Call ``callback(name, is_alive)`` when a token of ``topic`` comes or goes; it may only enqueue."""

        def change(sample: zenoh.Sample) -> None:
            callback(self._short(sample.key_expr).split("/")[1], sample.kind == zenoh.SampleKind.PUT)

        key = self.key(topic, name="*")
        with self._open() as session:
            self._declared.append(session.liveliness().declare_subscriber(key, change, history=True))

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

"""The live view: forwards published messages unchanged to Foxglove or Lichtblick over a WebSocket.

Strictly one way: the server accepts no messages, parameters or calls, and only programs of this machine can connect.
"""

from __future__ import annotations

import functools
import importlib
import logging
import queue
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.message import DecodeError

from bus import topics
from bus.clock import WALL_CLOCK, DeadlineClock
from bus.codec import schema_of
from bus.errors import ConfigError
from bus.sample import Sample
from bus.session import Bus
from bus.threads import OwnedThread, Role
from bus.topics import encoding_of

if TYPE_CHECKING:
    import foxglove.websocket

_log = logging.getLogger(__name__)

HOST = "127.0.0.1"
DEFAULT_PORT = 8765
_WAITING = 2000
"""Most messages queued between the bus and the server; further ones are left out, so the bus is never delayed."""
_NOT_AGAIN = (topics.EVENT.key, topics.VIEW_LOG.key)
"""Topics that are not repeated. Of all others a new viewer receives the last message: state, image, transform, result.
"""
_LOOK_S, _CLOSE_PATIENCE_S = 0.1, 2.0
_MOST_WARNED = 100
_TF_PARTS = ("color", "fr3_link0", "link0")
"""The first child frame of each kind of message on `topics.TF`."""
_JSON = {"jsonschema": "json"}


class _Said(NamedTuple):
    sample: Sample
    fits: bool


class LiveView:
    """Serves the messages published on ``bus`` until closed.

    Args:
        bus: a separate session or the cell's; it remains the caller's to close.
        port: 0 = any free port.

    Attributes:
        port: the port in use. ``left_out``: number of messages that did not fit into the queue.
        unknown: number of messages in another encoding than their topic's.

    Raises: ConfigError without foxglove-sdk, or for a port in use.
    """

    def __init__(self, bus: Bus, port: int = DEFAULT_PORT) -> None:
        self._sdk = sdk()
        self._context = self._sdk.Context()
        self._channels: dict[str, foxglove.Channel] = {}
        self._last: dict[str, dict[str, Sample]] = {}
        self._queue: queue.Queue[_Said | str] = queue.Queue(_WAITING)
        self.left_out = self.unknown = 0
        self._warned: set[str] = set()
        self._is_closing = threading.Event()
        self._server = self._start(bus.cell_id, port)
        self.port = int(self._server.port)
        self._thread = OwnedThread(Role.LIVE_VIEW, self._feed).start()
        for topic in topics.TOPICS:
            if topic.kind == "publish":
                hear = functools.partial(self._hear, encoding_of(topic.says))
                bus.subscribe(topic.key.replace("{name}", "*"), hear, own=True)

    def close(self) -> None:
        """End the server promptly, dropping queued messages; idempotent."""
        if not self._is_closing.is_set():
            self._is_closing.set()
            self._thread.join(_CLOSE_PATIENCE_S)
            self._server.stop()

    def _start(self, name: str, port: int) -> foxglove.websocket.WebSocketServer:
        view = self

        class Listener(self._sdk.websocket.ServerListener):  # type: ignore[misc, name-defined]
            def on_subscribe(self, _client: foxglove.websocket.Client, channel: foxglove.websocket.ChannelView) -> None:
                view._enqueue(str(channel.topic))

        try:
            return self._sdk.start_server(
                name=f"vlad-cell {name}", host=HOST, port=port, server_listener=Listener(), context=self._context
            )
        except (RuntimeError, OSError) as error:
            raise ConfigError(
                f"The live view cannot listen on {HOST}:{port}: {error}.", "Choose another: --foxglove-port."
            ) from error

    def _hear(self, encoding: str, sample: Sample) -> None:
        self._enqueue(_Said(sample, fits=sample.encoding == encoding))

    def _enqueue(self, said: _Said | str) -> None:
        """Queue a payload, or the topic that a viewer just subscribed to; called on other threads."""
        try:
            self._queue.put_nowait(said)
        except queue.Full:
            self.left_out += 1

    def _feed(self) -> None:
        while not self._is_closing.is_set():
            try:
                said = self._queue.get(timeout=_LOOK_S)
            except queue.Empty:
                continue
            if isinstance(said, str):
                self._repeat(said.removeprefix("/"))
            elif said.fits:
                self._show(said.sample)
            else:
                self._skip(said.sample)

    def _show(self, sample: Sample) -> None:
        self._channel(sample).log(sample.payload, log_time=time.time_ns())
        if sample.key not in _NOT_AGAIN:
            self._last.setdefault(sample.key, {})[_part(sample)] = sample

    def _repeat(self, key: str) -> None:
        for last in self._last.get(key, {}).values():
            self._channel(last).log(last.payload, log_time=time.time_ns())

    def _skip(self, sample: Sample) -> None:
        """Count and log a message in a foreign encoding, which no viewer can read; any program may publish here."""
        self.unknown += 1
        if sample.key not in self._warned and len(self._warned) < _MOST_WARNED:
            self._warned.add(sample.key)
            _log.warning("not shown, now and later: what travels on %s as %.80r", sample.key, sample.encoding)

    def _channel(self, sample: Sample) -> foxglove.Channel:
        if sample.key not in self._channels:
            schema = schema_of(sample.encoding)
            self._channels[sample.key] = self._sdk.Channel(
                f"/{sample.key}",
                message_encoding=_JSON.get(schema.encoding, schema.encoding),
                schema=self._sdk.Schema(name=schema.name, encoding=schema.encoding, data=schema.data),
                context=self._context,
            )
        return self._channels[sample.key]


def _part(sample: Sample) -> str:
    """The part of a topic that is published in parts: the transforms of the arm's links, or of the capture; else ""."""
    if sample.key != topics.TF.key:
        return ""
    try:
        transforms = FrameTransforms.FromString(sample.payload).transforms
    except DecodeError:
        return ""
    return str(transforms[0].child_frame_id) if transforms and transforms[0].child_frame_id in _TF_PARTS else ""


@contextmanager
def watching(cell_id: str, endpoint: str, port: int, clock: DeadlineClock = WALL_CLOCK) -> Iterator[LiveView]:
    """A live view of the running cell at ``endpoint``. Raises: ConfigError, CellUnreachable."""
    with Bus.join(cell_id, endpoint, clock=clock) as bus, closing(LiveView(bus, port)) as view:
        yield view


@functools.cache
def sdk() -> ModuleType:
    """Import and return the optional package foxglove-sdk. Raises: ConfigError."""
    try:
        importlib.import_module("foxglove.websocket")
        return importlib.import_module("foxglove")
    except ImportError as error:
        raise ConfigError(
            "The live view needs the package foxglove-sdk.", "Install it: uv pip install 'vlad-cell[foxglove]'."
        ) from error

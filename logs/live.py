"""The bus as a live view: what is published travels on, byte for byte, to Foxglove or Lichtblick over a WebSocket.

Strictly one way: the server takes no messages, parameters or calls, and only programs of this machine reach it.
"""

from __future__ import annotations

import functools
import importlib
import queue
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

from bus import topics
from bus.codec import schema_of
from bus.errors import ConfigError
from bus.heard import Heard
from bus.session import Bus

HOST = "127.0.0.1"
DEFAULT_PORT = 8765
_WAITING = 2000
"""Messages between the bus and the server; what does not fit is left out of the view, never held back on the bus."""
_NOT_AGAIN = (topics.EVENT.key, topics.VIEW_LOG.key)
"""All others are said again to a viewer that comes later: the last state, picture, transform, stage result."""
_JSON = {"jsonschema": "json"}


class LiveView:
    """Serves what is published on ``bus`` until closed. Raises: ConfigError without foxglove-sdk, or for a port in use.

    Args:
        bus: a session of its own or the cell's; stays the caller's.
        port: 0 = any that is free.

    Attributes:
        port: where it listens. ``left_out``: messages that did not fit.
    """

    def __init__(self, bus: Bus, port: int = DEFAULT_PORT) -> None:
        self._sdk = sdk()
        self._context = self._sdk.Context()
        self._channels: dict[str, Any] = {}
        self._last: dict[str, Heard] = {}
        self._queue: queue.Queue[Heard | str | None] = queue.Queue(_WAITING)
        self.left_out = 0
        self._server = self._start(bus.cell_id, port)
        self.port = int(self._server.port)
        self._feeder = threading.Thread(target=self._feed, name="live-view", daemon=True)
        self._feeder.start()
        for topic in topics.TOPICS:
            if topic.kind == "publish":
                bus.subscribe(topic.key.replace("{name}", "*"), self._enqueue, own=True)

    def close(self) -> None:
        """End the server; idempotent."""
        if self._feeder.is_alive():
            self._queue.put(None)
            self._feeder.join()
            self._server.stop()

    def _start(self, name: str, port: int) -> Any:
        view = self

        class Listener(self._sdk.websocket.ServerListener):  # type: ignore[misc, name-defined]
            def on_subscribe(self, _client: Any, channel: Any) -> None:
                view._enqueue(str(channel.topic))

        try:
            return self._sdk.start_server(
                name=f"vlad-cell {name}", host=HOST, port=port, server_listener=Listener(), context=self._context
            )
        except (RuntimeError, OSError) as error:
            raise ConfigError(
                f"The live view cannot listen on {HOST}:{port}: {error}.", "Choose another: --foxglove-port."
            ) from error

    def _enqueue(self, said: Heard | str) -> None:
        """Called on others' threads: a payload, or the topic that a viewer just began to look at."""
        try:
            self._queue.put_nowait(said)
        except queue.Full:
            self.left_out += 1

    def _feed(self) -> None:
        while (said := self._queue.get()) is not None:
            if isinstance(said, Heard):
                if said.key not in _NOT_AGAIN:
                    self._last[said.key] = said
                self._channel(said).log(said.payload, log_time=time.time_ns())
            elif (last := self._last.get(said.removeprefix("/"))) is not None:
                self._channel(last).log(last.payload, log_time=time.time_ns())

    def _channel(self, heard: Heard) -> Any:
        if heard.key not in self._channels:
            schema = schema_of(heard.encoding)
            self._channels[heard.key] = self._sdk.Channel(
                f"/{heard.key}",
                message_encoding=_JSON.get(schema.encoding, schema.encoding),
                schema=self._sdk.Schema(name=schema.name, encoding=schema.encoding, data=schema.data),
                context=self._context,
            )
        return self._channels[heard.key]


@contextmanager
def watching(cell_id: str, endpoint: str, port: int) -> Iterator[LiveView]:
    """A live view of the running cell at ``endpoint``. Raises: ConfigError, CellUnreachable."""
    with Bus.join(cell_id, endpoint) as bus, closing(LiveView(bus, port)) as view:
        yield view


@functools.cache
def sdk() -> Any:
    """The optional package, loaded only where it is asked for. Raises: ConfigError."""
    try:
        importlib.import_module("foxglove.websocket")
        return importlib.import_module("foxglove")
    except ImportError as error:
        raise ConfigError(
            "The live view needs the package foxglove-sdk.", "Install it: uv pip install 'vlad-cell[foxglove]'."
        ) from error

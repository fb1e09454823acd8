"""The live view, as Foxglove sees it: a real WebSocket client beside a real bus."""

from __future__ import annotations

import importlib
import json
import re
import struct
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from bus import topics
from bus.commands import CellState, Event
from bus.errors import ConfigError
from bus.messages import Frame
from bus.sensor_codec import frame_to_wire, transforms_to_wire
from bus.session import Bus
from logs import live
from tests.listeners import await_listeners

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")

STATE = CellState(state="Idle", stage="", cycle_id="", since_ns=1, available=("start",), reason="")


class Viewer:
    """A viewer of the ``foxglove.sdk.v1`` protocol; ``greeting`` is what the server says of itself."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._channels: dict[str, dict[str, Any]] = {}
        self.greeting = json.loads(socket.recv(timeout=60))

    def channel(self, topic: str) -> dict[str, Any]:
        """Wait for what the server advertises under ``topic``, and return it."""
        while topic not in self._channels:
            said = self._socket.recv(timeout=60)
            if isinstance(said, str) and (message := json.loads(said))["op"] == "advertise":
                self._channels |= {one["topic"]: one for one in message["channels"]}
        return self._channels[topic]

    def look_at(self, topic: str) -> Iterator[bytes]:
        """Subscribe, and yield the payloads.

        On a busy machine foxglove-sdk may not know yet the channel that it advertised just before: subscribe again.
        """
        subscription = {"id": 7, "channelId": self.channel(topic)["id"]}
        subscribe = json.dumps({"op": "subscribe", "subscriptions": [subscription]})
        self._socket.send(subscribe)
        give_up_s = time.monotonic() + 60
        while True:
            try:
                said = self._socket.recv(timeout=2)
            except TimeoutError:
                assert time.monotonic() < give_up_s, f"nothing on {topic}"
                self._socket.send(subscribe)
                continue
            if isinstance(said, bytes) and said[0] == 1 and struct.unpack_from("<I", said, 1)[0] == 7:
                yield said[13:]

    def say(self, message: dict[str, Any]) -> None:
        self._socket.send(json.dumps(message))


@pytest.fixture
def bus(endpoint: str) -> Iterator[Bus]:
    with Bus.listen("sim", endpoint) as bus:
        yield bus


@pytest.fixture
def view(bus: Bus) -> Iterator[live.LiveView]:
    with closing(live.LiveView(bus, 0)) as view:
        yield view


@pytest.fixture
def viewer(view: live.LiveView) -> Iterator[Viewer]:
    with connect(f"ws://{live.HOST}:{view.port}", subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:  # type: ignore[list-item]
        yield Viewer(socket)


def test_what_was_said_before_the_viewer_came_is_shown_to_it(bus: Bus, viewer: Viewer) -> None:
    bus.publish(topics.STATE, STATE)
    channel = viewer.channel("/state")
    assert (channel["schemaName"], channel["encoding"], channel["schemaEncoding"]) == (
        "vlad.CellState",
        "json",
        "jsonschema",
    )
    assert CellState.model_validate_json(next(viewer.look_at("/state"))) == STATE


def test_pictures_of_another_process_come_byte_for_byte_under_foxgloves_names(
    bus: Bus, endpoint: str, frame: Frame, viewer: Viewer
) -> None:
    parts = frame_to_wire(frame)
    with Bus.join("sim", endpoint) as camera:
        await_listeners(camera, *topics.FRAME_PARTS)
        for topic in topics.FRAME_PARTS:
            camera.publish(topic, parts[topic.key])
        assert viewer.channel("/camera/color")["schemaName"] == "foxglove.CompressedImage"
        payload = next(viewer.look_at("/camera/color"))
    assert payload == parts["camera/color"]
    assert CompressedImage.FromString(payload).format == "jpeg"


def test_it_takes_nothing(bus: Bus, viewer: Viewer) -> None:
    assert viewer.greeting["op"] == "serverInfo" and viewer.greeting["capabilities"] == []
    viewer.say({"op": "advertise", "channels": [{"id": 1, "topic": "/state", "encoding": "json", "schemaName": ""}]})
    bus.publish(topics.EVENT, Event(code="X", severity="info", text="still here"))
    assert viewer.channel("/event")["schemaName"] == "vlad.Event"


@pytest.mark.parametrize("encoding", ["zenoh/bytes", "", "application/json;vlad.Event", "application/json;vlad.State"])
def test_what_a_stranger_says_under_our_names_is_counted_and_the_rest_still_shown(
    bus: Bus, endpoint: str, view: live.LiveView, viewer: Viewer, encoding: str
) -> None:
    with Bus.join("sim", endpoint) as stranger:
        await_listeners(stranger, topics.STATE)
        for _ in range(3):
            stranger.put("cell/sim/state", b"hello", encoding)
        stranger.publish(topics.STATE, STATE)
        assert CellState.model_validate_json(next(viewer.look_at("/state"))) == STATE
    assert view.unknown == 3


def test_a_viewer_that_comes_later_has_the_captures_transform_and_the_links(bus: Bus, viewer: Viewer) -> None:
    for child in ("color", "fr3_link0", "fr3_link0"):
        bus.publish(topics.TF, transforms_to_wire({("base", child): np.eye(4)}, 1).SerializeToString())
    missing = {"color", "fr3_link0"}  # in any order, and more than once: the last may come while the viewer does
    for payload in viewer.look_at("/tf"):
        missing -= {one.child_frame_id for one in topics.TF.says.FromString(payload).transforms}
        if not missing:
            return


def test_closing_waits_for_nothing_that_is_still_to_be_shown(bus: Bus) -> None:
    view = live.LiveView(bus, 0)
    for _ in range(3000):
        bus.publish(topics.STATE, STATE)
    began_s = time.monotonic()
    view.close()
    view.close()
    assert time.monotonic() - began_s < 2
    with pytest.raises((OSError, WebSocketException)):
        connect(f"ws://{live.HOST}:{view.port}")


def test_a_port_in_use_is_named(bus: Bus, view: live.LiveView) -> None:
    with pytest.raises(ConfigError, match=f"{view.port}.*--foxglove-port"):
        live.LiveView(bus, view.port)


def test_without_the_package_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise ModuleNotFoundError(name)

    live.sdk.cache_clear()
    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(ConfigError, match=r"vlad-cell\[foxglove\]"):
        live.sdk()


def test_the_layout_shows_topics_that_exist() -> None:
    layout = json.loads((Path(__file__).parents[2] / "docs" / "foxglove" / "vlad-cell.json").read_text())
    shown = set(re.findall(r'"/([a-z/]+?)(?:"|\.)', json.dumps(layout["configById"])))
    assert shown and shown <= {topic.key for topic in topics.TOPICS}
    panels = set(re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"])))
    assert panels == layout["configById"].keys()

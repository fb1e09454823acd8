"""What the cell says while it is asked is newer than its answer: the door's streams are not told of it afterwards."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from bus import topics
from bus.codec import encode
from bus.commands import CellState
from bus.messages import LivePicture
from bus.sample import Sample
from cell.http.door import Door
from cell.http.hub import Listening
from tests.cell.http_bench import IDLE, FakeCell, door_of

WORKING = IDLE.model_copy(update={"state": "Execute"})


@pytest.fixture
def cell() -> FakeCell:
    return FakeCell(live=LivePicture(stamp_ns=5, data=b"\xff\xd8", media_type="image/jpeg", from_capture_pose=True))


@pytest.fixture
def door(cell: FakeCell, tmp_path: Path) -> Door:
    return door_of(cell, tmp_path)


def hear(door: Door, state: CellState) -> None:
    door.hear(Sample(topics.STATE.key, "", encode(state)))


def told(door: Door, name: str) -> object:
    return json.loads(door.hub.last(name))


def while_asked(
    monkeypatch: pytest.MonkeyPatch, door: Door, cell: FakeCell, question: str, say: Callable[[], None]
) -> None:
    """The cell says something while the door's question waits for its answer, which is then of before."""
    is_said, answer = threading.Event(), getattr(cell, question)
    monkeypatch.setattr(cell, question, lambda *of: (is_said.wait(60), answer(*of))[1])

    async def run() -> None:
        door.hub.join()
        asked = asyncio.create_task(door.refresh() if question == "state" else door.show_live())
        await asyncio.sleep(0)  # it is asked
        say()
        is_said.set()
        await asked

    asyncio.run(run())
    door.wait()


def test_a_state_that_was_asked_for_does_not_cover_a_newer_one(
    monkeypatch: pytest.MonkeyPatch, door: Door, cell: FakeCell
) -> None:
    hear(door, IDLE)
    while_asked(monkeypatch, door, cell, "state", lambda: hear(door, WORKING))
    assert told(door, "state") == WORKING.model_dump(mode="json")


def test_a_picture_of_now_that_comes_late_does_not_cover_that_of_a_pick(
    monkeypatch: pytest.MonkeyPatch, door: Door, cell: FakeCell
) -> None:
    image = CompressedImage(data=b"\xff\xd8", format="jpeg")
    image.timestamp.FromNanoseconds(6)
    hear(door, IDLE)
    sample = Sample(topics.VIEW_COLOR.key, "", image.SerializeToString())
    while_asked(monkeypatch, door, cell, "picture", lambda: door.hear(sample))
    assert told(door, "picture") == {"stamp_ns": 6, "stamp": "6"}


def test_a_state_that_comes_when_the_cell_is_gone_does_not_make_it_live_again(door: Door, cell: FakeCell) -> None:
    async def run() -> list[list[str]]:
        listening = door.hub.join()
        cell.is_gone = True
        door.look()
        hear(door, IDLE)
        door.look()
        later = door.join()
        door.hub.close()
        return [await names(listening), await names(later)]

    first, later = asyncio.run(run())
    assert first == ["event", "state", "event"], "that it is gone is said last"
    assert later == ["state", "event"], "to a page that is opened then, too"
    door.wait()


async def names(listening: Listening) -> list[str]:
    """What is said, until the end."""
    told = []
    while (said := await listening.next()) is not None:
        told.append(said.name)
    return told

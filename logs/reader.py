"""Reads one recorded cycle: what every stage worked on and gave, and how it ended."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import zstandard
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Message, Metadata
from mcap.stream_reader import StreamReader

from bus import topics
from bus.codec import decode
from bus.commands import CellState, Event, Health
from bus.errors import BadPayload, RecordingError
from bus.messages import Attempt, CycleResult, Execution, Frame, HandState, ModelReply, Observation, StageRecord, View
from bus.wire import frame_from_wire
from logs.migrate import Content, migrate
from logs.recorder import PART

STAGE_TOPICS = (topics.CAPTURE, topics.DETECT, topics.PLAN, topics.EXECUTE, topics.VERIFY, topics.DELIVER)
_STATION = "station.json"
RECOVERED = "recovered"
"""Key of the metadata of a recording that was made whole again; it may end anywhere."""
_HEALTH = re.compile(topics.NODE_HEALTH.key.format(name="[^/]+"))

DAMAGE = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    OSError,
    ValueError,
    KeyError,
    EOFError,
    OverflowError,
    MemoryError,
)
"""What the MCAP reader and its decompressor raise on a file that is torn, damaged or no MCAP."""


class Timed(NamedTuple):
    """One recorded payload: when it was logged [ns UTC] and what it says."""

    log_time_ns: int
    message: Any


@dataclass(frozen=True)
class CycleRecord:
    """One cycle as it was recorded.

    Attributes:
        metadata: versions, seeds, hashes; then the result's own.
        station: the station file's tree, as configured then.
        stages: the record of every stage that ran, in order.
        attempt: which try of its pick this cycle is.
        observation, after: what was seen before the pick, and while holding; None when not reached.
        replies: every call to the goal-image model, in order.
        states, events, hand: what the cell and the hand said, in order.
        health: what the nodes said of themselves, node by node. ``arm``: what the arm said, as foxglove.JointStates.
    """

    cycle_id: str
    metadata: dict[str, str]
    station: dict[str, Any]
    stages: dict[str, StageRecord[Any]]
    observation: Observation | None
    after: Observation | None
    result: CycleResult | None
    attempt: Attempt
    replies: tuple[ModelReply, ...] = ()
    states: tuple[Timed, ...] = ()
    events: tuple[Timed, ...] = ()
    hand: tuple[Timed, ...] = ()
    health: tuple[Timed, ...] = ()
    arm: tuple[Timed, ...] = ()


def read_cycle(path: Path) -> CycleRecord:
    """Read one closed recording, older ones migrated. Raises: RecordingError, saying what is wrong with the file."""
    raw = _read(path)
    if raw.station is None or "cycle_id" not in raw.metadata:
        raise RecordingError(f"{path} is an MCAP, but not a recording of this cell.", f"It lacks {_STATION}.")
    migrate(raw)
    try:
        return _cycle(raw)
    except BadPayload as error:
        raise RecordingError(f"{path} holds a damaged message: {error.text}", "It cannot be replayed.") from error


def _read(path: Path) -> Content:
    if path.name.endswith(PART):
        raise RecordingError(
            f"{path} was not finished.",
            f"Its process ended in the cycle, or still writes: `cell recover {path}` makes it whole.",
        )
    if not path.is_file():
        raise RecordingError(f"There is no recording {path}.", "See `cell cycles`.")
    raw = Content()
    try:
        with path.open("rb") as file:
            _fill(raw, StreamReader(file, validate_crcs=True))
    except DAMAGE as error:
        raise RecordingError(
            f"{path} is damaged or no MCAP ({type(error).__name__}).", "Copy it again from where it was recorded."
        ) from error
    return raw


def _fill(raw: Content, reader: StreamReader) -> None:
    """Everything in the data section, whose checksum is looked at; the summary only repeats it."""
    keys: dict[int, str] = {}
    for record in reader.records:
        match record:
            case Metadata():
                raw.metadata.update(record.metadata)
            case Attachment(name=name) if name == _STATION:
                raw.station = json.loads(record.data)
            case Channel():
                keys[record.id] = record.topic.removeprefix("/")
            case Message():
                raw.payloads.setdefault(keys[record.channel_id], []).append((record.log_time, record.data))


def _cycle(raw: Content) -> CycleRecord:
    stages = {
        record.stage: record
        for topic in STAGE_TOPICS
        for record in (decode(topic.says, payload) for _, payload in raw.payloads.get(topic.key, []))
    }
    frames, is_recovered = dict(_frames(raw)), RECOVERED in raw.metadata
    capture, execute = stages.get("capture"), stages.get("execute")
    execution: Execution | None = execute.result if execute is not None else None
    results, attempts = raw.payloads.get(topics.RESULT.key, []), raw.payloads.get(topics.ATTEMPT.key, [])
    return CycleRecord(
        cycle_id=raw.metadata["cycle_id"],
        metadata=raw.metadata,
        station=raw.station or {},
        stages=dict(stages),
        observation=_observation(capture.result if capture is not None else None, frames, is_recovered),
        after=_observation(execution.after if execution is not None else None, frames, is_recovered),
        result=decode(CycleResult, results[-1][1]) if results else None,
        attempt=decode(Attempt, attempts[0][1]) if attempts else Attempt(cycle_id=raw.metadata["cycle_id"]),
        replies=tuple(decode(ModelReply, payload) for _, payload in raw.payloads.get(topics.MODEL_REPLY.key, [])),
        states=_timed(raw, topics.STATE.key, CellState),
        events=_timed(raw, topics.EVENT.key, Event),
        hand=_timed(raw, topics.HAND_STATE.key, HandState),
        health=tuple(said for key in raw.payloads if _HEALTH.fullmatch(key) for said in _timed(raw, key, Health)),
        arm=tuple(_arm_states(raw)),
    )


def _timed(raw: Content, key: str, kind: type[Any]) -> tuple[Timed, ...]:
    """What was said and can be read: a node that talks nonsense is recorded as it talks."""
    timed = []
    for log_time_ns, payload in raw.payloads.get(key, []):
        with suppress(BadPayload):
            timed.append(Timed(log_time_ns, decode(kind, payload)))
    return tuple(timed)


def _arm_states(raw: Content) -> Iterator[Timed]:
    """As `_timed`, in protobuf."""
    for log_time_ns, payload in raw.payloads.get(topics.ARM_STATE.key, []):
        with suppress(DecodeError):
            yield Timed(log_time_ns, JointStates.FromString(payload))


def _frames(raw: Content) -> Iterator[tuple[int, Frame]]:
    """Every recorded frame by its stamp. The five parts of one were recorded together, in order."""
    columns = [raw.payloads.get(topic.key, []) for topic in topics.FRAME_PARTS]
    if len({len(column) for column in columns}) > 1 and RECOVERED not in raw.metadata:
        raise BadPayload("Parts of a frame are missing.")
    for parts in zip(*columns, strict=False):  # of a torn file, the last frame's parts may be missing
        with suppress(BadPayload):  # what cannot be read was never used: its capture failed
            frame = frame_from_wire(
                {topic.key: payload for topic, (_, payload) in zip(topics.FRAME_PARTS, parts, strict=True)}
            )
            yield frame.stamp_ns, frame


def _observation(view: View | None, frames: dict[int, Frame], is_recovered: bool) -> Observation | None:
    if view is None:
        return None
    frame = frames.get(view.stamp_ns)
    if frame is None:
        if is_recovered:
            return None
        raise BadPayload(f"The frame with the stamp {view.stamp_ns} is missing.")
    return Observation(view=view, frame=frame)

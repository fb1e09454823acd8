"""Reads one recorded cycle: the inputs and results of all stages, and the end of the cycle."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata

from bus import topics
from bus.arrays import Transform
from bus.codec import Json, MessageT, decode
from bus.commands import CellState, Event, Health
from bus.errors import BadFrame, BadPayload, RecordingError
from bus.messages import (
    Approval,
    Attempt,
    CycleResult,
    Detections,
    Execution,
    Frame,
    HandState,
    ModelReply,
    Observation,
    ObservedScene,
    StageRecord,
    View,
)
from bus.sensor_codec import arm_joints, frame_from_wire
from logs.mcap.finished_reader import Summary, records
from logs.mcap.migrate import Content, migrate
from logs.mcap.names import reading, shown
from logs.mcap.pictures import without_pictures
from logs.mcap.recorder import PART
from logs.mcap.records import Damage
from logs.mcap.thin import ARCHIVED, THINNED

STAGE_TOPICS = (
    topics.CAPTURE,
    topics.DETECT,
    topics.PLAN,
    topics.APPROVE,
    topics.EXECUTE,
    topics.VERIFY,
    topics.DELIVER,
)
_TOLD = (*STAGE_TOPICS, topics.ATTEMPT, topics.RESULT, topics.SCENE, topics.MODEL_REPLY, topics.STATE, topics.EVENT)
"""Topics that `read_stages` reads."""
STATION = "station.json"
RECOVERED = "recovered"
"""Metadata key of a recovered recording; such a recording may end anywhere."""
PLUG_INS = "plug_ins"
"""Metadata key of the packages of other makers, a JSON object: by the setting that names what one brings."""
_STATION_DEPTH = 32
_HEALTH = re.compile(topics.NODE_HEALTH.key.format(name="[^/]+"))


Payload = TypeVar("Payload")
Stage = StageRecord[Any]
"""Of any of the stages."""


class Timed(NamedTuple, Generic[Payload]):
    """One recorded payload.

    Attributes:
        log_time_ns: UTC. ``message``: the decoded payload.
    """

    log_time_ns: int
    message: Payload


@dataclass(frozen=True)
class CycleRecord:
    """One recorded cycle.

    Attributes:
        metadata: versions, seeds, hashes; then those of the result.
        station: the tree of the station file at that time.
        stages: the record of every stage that ran, in order; of one that ran again, the last.
        superseded: the records of earlier looks and what was made of them, in the order of time.
        attempt: the attempt of the pick that this cycle is.
        passed_over: base_from_tcp (4, 4) of the proposed grasps that a person passed over, in order.
        looks: the captures before the pick, in order. ``after``: the one while holding; None when not reached.
        replies: all calls to the goal-image model, in order. ``last_replies``: those since the last look.
        scene: what detect saw; None when it did not come so far.
        states, events, hand: messages of the cell and the hand, in order.
        health: health messages of the nodes, node by node. ``arm``: the arm's states as foxglove.JointStates.
    """

    cycle_id: str
    metadata: dict[str, str]
    station: Json
    stages: dict[str, Stage]
    looks: tuple[Observation, ...]
    after: Observation | None
    result: CycleResult | None
    attempt: Attempt
    superseded: tuple[Stage, ...] = ()
    passed_over: tuple[Transform, ...] = ()
    replies: tuple[ModelReply, ...] = ()
    last_replies: tuple[ModelReply, ...] = ()
    scene: ObservedScene | None = None
    states: tuple[Timed[CellState], ...] = ()
    events: tuple[Timed[Event], ...] = ()
    hand: tuple[Timed[HandState], ...] = ()
    health: tuple[Timed[Health], ...] = ()
    arm: tuple[Timed[JointStates], ...] = ()

    @property
    def trimmed(self) -> str:
        """The time when the pictures were trimmed, and where the whole recording is, in words; "" for a whole one."""
        if THINNED not in self.metadata:
            return ""
        said = self.metadata[THINNED]
        day = f" on {datetime.fromtimestamp(int(said) / 1e9, UTC):%Y-%m-%d}" if re.fullmatch(r"\d{1,19}", said) else ""
        where = self.metadata.get(ARCHIVED, "")
        return f"trimmed{day}; {f'whole at {where}' if where else 'nowhere whole'}"

    @property
    def observation(self) -> Observation | None:
        """The look that the images of detect belong to; None when nothing was captured."""
        shown = self.scene.shown if self.scene is not None else 0
        return self.looks[shown] if shown < len(self.looks) else None


def read_cycle(path: Path) -> CycleRecord:
    """Read one closed recording; older ones are migrated. Raises: RecordingError, which names the error of the file."""
    return _made(path, _read(path), has_frames=True)


def read_with_messages(path: Path) -> tuple[CycleRecord, Content]:
    """As `read_cycle`, with a single pixel for each picture of detect; and all messages as they travelled.

    Raises: RecordingError.
    """
    raw = _read(path)
    return _made(path, raw, has_frames=True, has_pictures=False), raw


def read_stages(path: Path) -> CycleRecord:
    """As `read_cycle`, without what takes long: ``looks``, ``after``, ``hand``, ``health`` and ``arm`` are left out.

    The pictures of detect are a single pixel each.

    Raises: RecordingError.
    """
    require_finished(path)
    with reading(path), path.open("rb") as file:
        summary = Summary(file)
        raw = _content(summary) if summary.is_there else None
    return _made(path, raw or _read(path), has_frames=False, has_pictures=False)


def _content(summary: Summary) -> Content:
    """The metadata, the station and the messages of `_TOLD`. Raises: Damage, OSError."""
    raw = Content()
    for table in summary.metadata():
        raw.metadata.update(table.metadata)
    station = summary.attachment(STATION)
    raw.station = station_tree(station) if station is not None else None
    for topic, at_ns, payload in summary.timed_messages(frozenset(f"/{one.key}" for one in _TOLD)):
        raw.payloads.setdefault(topic.removeprefix("/"), []).append((at_ns, payload))
    return raw


def _made(path: Path, raw: Content, *, has_frames: bool, has_pictures: bool = True) -> CycleRecord:
    require_ours(path, has_station=raw.station is not None, metadata=raw.metadata)
    migrate(raw)
    if not has_pictures:
        for key in (topics.DETECT.key, topics.SCENE.key):
            raw.payloads[key] = [(at_ns, without_pictures(payload)) for at_ns, payload in raw.payloads.get(key, [])]
    try:
        return _cycle(raw, has_frames=has_frames)
    except BadPayload as error:
        raise RecordingError(
            f"{shown(path)} holds a damaged message: {error.text}", "It cannot be replayed."
        ) from error


def require_ours(path: Path, *, has_station: bool, metadata: Mapping[str, str]) -> None:
    """Refuse an MCAP of another program. Raises: RecordingError."""
    if not has_station or "cycle_id" not in metadata:
        raise RecordingError(f"{shown(path)} is an MCAP, but not a recording of this cell.", f"It lacks {STATION}.")


def require_finished(path: Path) -> None:
    """Refuse a missing or unfinished recording. Raises: RecordingError."""
    with reading(path):
        is_file = path.is_file()
    if is_file and path.name.endswith(PART):
        raise RecordingError(
            f"{shown(path)} was not finished.",
            f"Its process ended in the cycle, or still writes: `cell recover {shown(path)}` makes it whole.",
        )
    if not is_file:
        raise RecordingError(f"There is no recording {shown(path)}.", "See `cell cycles`.")


def _read(path: Path) -> Content:
    require_finished(path)
    raw = Content()
    with reading(path), path.open("rb") as file:
        _fill(raw, records(file))
    return raw


def _fill(raw: Content, found: Iterator[McapRecord]) -> None:
    """Read all records of the data section, checking its checksum; the summary only repeats them. Raises: Damage."""
    keys: dict[int, str] = {}
    for record in found:
        match record:
            case Metadata():
                raw.metadata.update(record.metadata)
            case Attachment(name=name) if name == STATION:
                raw.station = station_tree(record.data)
            case Channel():
                keys[record.id] = record.topic.removeprefix("/")
            case Message():
                if record.channel_id not in keys:
                    raise Damage("a message of it belongs to no channel")
                raw.payloads.setdefault(keys[record.channel_id], []).append((record.log_time, record.data))


def station_tree(document: bytes) -> Json:
    """Return the attached station, a JSON document that is a tree of settings. Raises: Damage for any other."""
    try:
        tree = json.loads(document)
        json.dumps(tree, ensure_ascii=False).encode()  # raises for characters that cannot be encoded
    except (ValueError, RecursionError) as error:
        raise Damage(f"{STATION} is no JSON") from error
    if not isinstance(tree, dict) or not _is_shallow(tree, _STATION_DEPTH):
        raise Damage(f"{STATION} is no tree of settings")
    return tree


def _is_shallow(value: object, levels: int) -> bool:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return levels > 0 and all(_is_shallow(one, levels - 1) for one in inner)


def recorded_number(tree: object, *keys: str) -> float | None:
    """A numeric setting of a recorded station of any version; None without such a number."""
    for key in keys:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return float(tree) if isinstance(tree, int | float) and math.isfinite(tree) else None


def _cycle(raw: Content, *, has_frames: bool) -> CycleRecord:
    looked = [
        Timed(at_ns, decode(topics.CAPTURE.says, said)) for at_ns, said in raw.payloads.get(topics.CAPTURE.key, [])
    ]
    since_ns = looked[-1].log_time_ns if looked else 0
    runs = list(_stages(raw))
    stages: dict[str, Stage] = {stage.stage: stage for at_ns, stage in runs if at_ns >= since_ns}
    before = (stage for at_ns, stage in runs if at_ns < since_ns)
    frames, is_whole = _frames(raw) if has_frames else ({}, False)
    execute, replies = stages.get("execute"), _timed(raw, topics.MODEL_REPLY.key, ModelReply)
    execution: Execution | None = execute.result if execute is not None else None
    results, attempts = raw.payloads.get(topics.RESULT.key, []), raw.payloads.get(topics.ATTEMPT.key, [])
    return CycleRecord(
        cycle_id=raw.metadata["cycle_id"],
        metadata=raw.metadata,
        station=raw.station or {},
        stages=stages,
        superseded=tuple(sorted(before, key=lambda stage: stage.started_ns)),
        looks=tuple(_looks([one.message.result for one in looked], frames, is_whole)),
        after=_observation(execution.after if execution is not None else None, frames, is_whole),
        result=decode(CycleResult, results[-1][1]) if results else None,
        attempt=decode(Attempt, attempts[0][1]) if attempts else Attempt(cycle_id=raw.metadata["cycle_id"]),
        passed_over=tuple(_passed_over(stage for _, stage in runs)),
        scene=_scene(raw, [stage for _, stage in runs if stage.stage == "detect"]),
        replies=tuple(reply.message for reply in replies),
        last_replies=tuple(reply.message for reply in replies if reply.log_time_ns >= since_ns),
        states=_timed(raw, topics.STATE.key, CellState),
        events=_timed(raw, topics.EVENT.key, Event),
        hand=_timed(raw, topics.HAND_STATE.key, HandState),
        health=tuple(said for key in raw.payloads if _HEALTH.fullmatch(key) for said in _timed(raw, key, Health)),
        arm=tuple(_arm_states(raw)),
    )


def _scene(raw: Content, detected: Sequence[Stage]) -> ObservedScene | None:
    """Return what was seen last: in the result of detect, or of a detection that failed on its own."""
    if detected and isinstance(detected[-1].result, Detections):
        return detected[-1].result.scene
    alone = raw.payloads.get(topics.SCENE.key, [])
    return decode(ObservedScene, alone[-1][1]) if alone else None


def _stages(raw: Content) -> Iterator[tuple[int, Stage]]:
    """The stage records with the times of their messages, in the order of the cycle's stages."""
    for topic in STAGE_TOPICS:
        for at_ns, payload in raw.payloads.get(topic.key, []):
            record: Stage = decode(topic.says, payload)
            if not topic.key.endswith(f"/{record.stage}"):
                raise BadPayload(f"What was said of {record.stage} lies under {topic.key!r}.")
            yield at_ns, record


def _passed_over(runs: Iterable[Stage]) -> Iterator[Transform]:
    for run in runs:
        if isinstance(run.result, Approval) and run.result.decision == "next_grasp":
            yield run.result.base_from_tcp


def _timed(raw: Content, key: str, kind: type[MessageT]) -> tuple[Timed[MessageT], ...]:
    """The decodable messages of ``key``; undecodable ones, e.g. of a faulty node, are recorded but skipped here."""
    timed = []
    for log_time_ns, payload in raw.payloads.get(key, []):
        with suppress(BadPayload):
            timed.append(Timed(log_time_ns, decode(kind, payload)))
    return tuple(timed)


def _arm_states(raw: Content) -> Iterator[Timed[JointStates]]:
    """As `_timed`, in protobuf."""
    for log_time_ns, payload in raw.payloads.get(topics.ARM_STATE.key, []):
        with suppress(BadPayload):
            yield Timed(log_time_ns, arm_joints(payload))


def _frames(raw: Content) -> tuple[dict[int, Frame], bool]:
    """All recorded frames by their stamp [ns UTC], and whether every frame that was used must be among them.

    The five parts of a frame are recorded together, in order. Of a recovered file some may be missing, of a trimmed one
    all are, and an older one may hold a frame that today no cycle would use.
    """
    frames: dict[int, Frame] = {}
    is_whole = RECOVERED not in raw.metadata and THINNED not in raw.metadata
    columns = [raw.payloads.get(topic.key, []) for topic in topics.FRAME_PARTS]
    if len({len(column) for column in columns}) > 1 and is_whole:
        raise BadPayload("Parts of a frame are missing.")
    for parts in zip(*columns, strict=False):  # in a torn file, parts of the last frame may be missing
        payloads = {topic.key: payload for topic, (_, payload) in zip(topics.FRAME_PARTS, parts, strict=True)}
        try:
            frame = frame_from_wire(payloads)
            frames[frame.stamp_ns] = frame
        except BadPayload:  # an undecodable frame was never used: its capture failed
            continue
        except BadFrame:
            is_whole = False
    return frames, is_whole


def _looks(views: list[View | None], frames: dict[int, Frame], is_whole: bool) -> Iterator[Observation]:
    """The observations of the captures that succeeded; of a torn file, those before the first that is missing."""
    for view in views:
        if view is None:
            continue
        observation = _observation(view, frames, is_whole)
        if observation is None:
            return
        yield observation


def _observation(view: View | None, frames: dict[int, Frame], is_whole: bool) -> Observation | None:
    if view is None:
        return None
    frame = frames.get(view.stamp_ns)
    if frame is None:
        if not is_whole:
            return None
        raise BadPayload(f"The frame with the stamp {view.stamp_ns} is missing.")
    return Observation(view=view, frame=frame)

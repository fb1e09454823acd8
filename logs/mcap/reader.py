"""Reads one recorded cycle: the inputs and results of all stages, and the end of the cycle."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

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
from logs.mcap.content_reader import read_content, read_topics, require_ours
from logs.mcap.migrate import Content, migrate
from logs.mcap.names import shown
from logs.mcap.pictures import without_pictures
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
RECOVERED = "recovered"
"""Metadata key of a recovered recording; such a recording may end anywhere."""
PLUG_INS = "plug_ins"
"""Metadata key of the packages of other makers, a JSON object: by the setting that names what one brings."""
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
    return _made(path, read_content(path), has_frames=True)


def read_with_messages(path: Path) -> tuple[CycleRecord, Content]:
    """As `read_cycle`, with a single pixel for each picture of detect; and all messages as they travelled.

    Raises: RecordingError.
    """
    raw = read_content(path)
    return _made(path, raw, has_frames=True, has_pictures=False), raw


def read_stages(path: Path) -> CycleRecord:
    """As `read_cycle`, without what takes long: ``looks``, ``after``, ``hand``, ``health`` and ``arm`` are left out.

    The pictures of detect are a single pixel each.

    Raises: RecordingError.
    """
    raw = read_topics(path, [topic.key for topic in _TOLD])
    return _made(path, raw, has_frames=False, has_pictures=False)


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

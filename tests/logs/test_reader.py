"""What was recorded comes back equal; a file that is not what was recorded is refused in one line."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from bus import topics
from bus.codec import encode
from bus.codes import Code
from bus.commands import CellState, Event
from bus.errors import RecordingError
from bus.frozen import Message
from bus.messages import (
    ArmMode,
    ArmState,
    CycleResult,
    Execution,
    Failure,
    Frame,
    HandState,
    ModelReply,
    Motion,
    PickPlan,
    Segment,
    SegmentRun,
    StageRecord,
    Verdict,
    View,
)
from bus.rejection import Rejection
from bus.sensor_codec import frame_from_wire, frame_to_wire
from bus.topics import Topic, encoding_of
from bus.trajectory import Trajectory
from logs.differences import compare
from logs.mcap.migrate import SCHEMA_VERSION
from logs.mcap.reader import CycleRecord, read_cycle
from logs.mcap.recorder import Recorder

CYCLE_ID = "20260101T000000000"
STATION = {"cell_id": "sim", "camera": {"max_age_s": 1.0}}
Q_RAD = np.linspace(-1.5, 1.5, 7)
HAND = HandState(stamp_ns=5, width_m=0.031, is_moving=False, is_homed=True)
FLIPS = 60


def _view(stamp_ns: int) -> View:
    arm = ArmState(stamp_ns=3, mode=ArmMode.IDLE, q_rad=Q_RAD, dq_rad_s=np.zeros(7), tau_ext_nm=np.full(7, np.nan))
    return View(stamp_ns=stamp_ns, arm=arm, base_from_color=np.diag([1.0, -1.0, -1.0, 1.0]))


def _run() -> SegmentRun:
    q_rad = np.random.default_rng(0).normal(size=(20, 7))
    motion = Motion(
        finished=True, commanded_q_rad=q_rad, t_s=np.arange(20.0) * 0.01, q_rad=q_rad, dq_rad_s=-q_rad, tau_ext_nm=q_rad
    )
    return SegmentRun(name="reach", motion=motion, hand=HAND)


def _results(frame: Frame) -> dict[Topic, Message]:
    """One result a stage; detect is left out, its images would only make the file bigger."""
    segment = Segment(
        name="reach", route="straight", trajectory=Trajectory(raw_q_rad=np.stack([Q_RAD, Q_RAD + 0.1]), window=4)
    )
    return {
        topics.CAPTURE: _view(frame.stamp_ns),
        topics.PLAN: PickPlan(
            grasp=1,
            tilt_rad=0.0,
            segments=(segment,),
            rejected=(Rejection(grasp=0, tilt_rad=0.0, code=Code.COLLISION, reason="tray"),),
        ),
        topics.EXECUTE: Execution(runs=(_run(),), grasped=HAND, stopped_in=None, after=_view(frame.stamp_ns + 1)),
        topics.VERIFY: Verdict(
            held=True, code=None, reason="Held.", hold_s=3.0, width_min_m=0.03, load_n=1.0, cleared_fraction=1.0
        ),
    }


def _record_of(topic: Topic, result: Message | None, failure: Failure | None = None) -> StageRecord[Message]:
    stage = topic.key.rpartition("/")[2]
    record: StageRecord[Message] = topic.says(
        cycle_id=CYCLE_ID, stage=stage, started_ns=1, duration_s=0.25, result=result, failure=failure
    )
    return record


RESULT = CycleResult(
    cycle_id=CYCLE_ID,
    object="box",
    result="SUCCESS",
    code=None,
    reason="Held.",
    stages={"capture": 0.25},
    wall_s=1.0,
    recording="",
)
STATE = CellState(state="Execute", stage="plan", cycle_id=CYCLE_ID, since_ns=1, available=("stop",), reason="")
EVENT = Event(code="NOTE", severity="info", text="Hello.")


def _write(path: Path, said: list[tuple[Topic, Message]], frames: list[Frame]) -> Path:
    recorder = Recorder(path, metadata={"cycle_id": CYCLE_ID, "seed": "7"}, clock=lambda: 1)
    recorder.attach("station.json", "application/json", json.dumps(STATION).encode())
    for frame in frames:
        for topic in topics.FRAME_PARTS:
            payload = frame_to_wire(frame)[topic.key]
            recorder.write(topic.key, encoding_of(topic.says), payload, log_time_ns=frame.stamp_ns)
    for index, (topic, message) in enumerate(said):
        recorder.write(topic.key, encoding_of(topic.says), encode(message), log_time_ns=100 + index)
        recorder.flush()
    return recorder.close({"result": "SUCCESS", "code": "", "reason": "Held."})


@pytest.fixture
def second_frame(frame: Frame) -> Frame:
    return frame.model_copy(update={"stamp_ns": frame.stamp_ns + 1, "depth_m": frame.depth_m[::-1]})


@pytest.fixture
def said(frame: Frame) -> list[tuple[Topic, Message]]:
    """Everything one good cycle says."""
    stages: list[tuple[Topic, Message]] = [
        (topic, _record_of(topic, result)) for topic, result in _results(frame).items()
    ]
    return [(topics.STATE, STATE), *stages, (topics.HAND_STATE, HAND), (topics.EVENT, EVENT), (topics.RESULT, RESULT)]


@pytest.fixture
def recording(tmp_path: Path, said: list[tuple[Topic, Message]], frame: Frame, second_frame: Frame) -> Path:
    """A whole cycle."""
    return _write(tmp_path / "cycle.mcap", said, [frame, second_frame])


def _text(cycle: CycleRecord) -> str:
    """Everything a cycle record holds, bit for bit."""
    parts: list[object] = [cycle.cycle_id, sorted(cycle.metadata.items()), cycle.station, list(cycle.stages)]
    messages = [*cycle.stages.values(), cycle.observation, cycle.after, cycle.result]
    parts += [None if message is None else message.model_dump_json() for message in messages]
    for told in (cycle.states, cycle.events, cycle.hand):
        parts += [(entry.log_time_ns, entry.message.model_dump_json()) for entry in told]
    return json.dumps(parts)


# --- whole recordings -------------------------------------------------------------------------------------------------


def test_every_stage_comes_back_equal(recording: Path, frame: Frame) -> None:
    cycle = read_cycle(recording)
    assert list(cycle.stages) == ["capture", "plan", "execute", "verify"]
    for topic, result in _results(frame).items():
        record = cycle.stages[topic.key.rpartition("/")[2]]
        assert compare(_record_of(topic, result), record, {}) == []


def test_both_observations_come_back_as_the_stages_had_them(recording: Path, frame: Frame, second_frame: Frame) -> None:
    cycle = read_cycle(recording)
    for seen, taken in ((cycle.observation, frame), (cycle.after, second_frame)):
        assert seen is not None and seen.view.stamp_ns == seen.frame.stamp_ns == taken.stamp_ns
        assert compare(frame_from_wire(frame_to_wire(taken)), seen.frame, {}) == []
        assert compare(_view(taken.stamp_ns), seen.view, {}) == []


def test_an_older_recording_of_a_frame_that_no_cycle_would_use_now_is_read_without_its_picture(
    tmp_path: Path, said: list[tuple[Topic, Message]], frame: Frame, second_frame: Frame
) -> None:
    """Its depth was of another unit, and its cycle ended in detection; nothing checked frames then."""
    far = frame.model_copy(update={"depth_m": frame.depth_m * 1000})
    cycle = read_cycle(_write(tmp_path / "cycle.mcap", said, [far, second_frame]))
    assert cycle.observation is None and cycle.after is not None
    assert list(cycle.stages) == ["capture", "plan", "execute", "verify"]


def test_everything_else_comes_back_in_order_with_its_time(recording: Path) -> None:
    cycle = read_cycle(recording)
    assert (cycle.cycle_id, cycle.result) == (CYCLE_ID, RESULT)
    assert {key: cycle.station[key] for key in STATION} == STATION, "a migration may say what was so before"
    assert cycle.metadata == {
        "cycle_id": CYCLE_ID,
        "seed": "7",
        "schema": str(SCHEMA_VERSION),
        "commit": "unknown",
        "dirty": "unknown",
        "result": "SUCCESS",
        "code": "",
        "reason": "Held.",
    }
    assert cycle.states == ((100, STATE),)
    assert cycle.hand == ((105, HAND),)
    assert cycle.events == ((106, EVENT),)


# --- several looks ----------------------------------------------------------------------------------------------------


@pytest.fixture
def looked_again(
    tmp_path: Path, said: list[tuple[Topic, Message]], frame: Frame, second_frame: Frame
) -> Callable[[Message | Failure], CycleRecord]:
    """A cycle whose first look led to nothing, so that the arm looked again; with how its second capture ended."""

    def read(second: Message | Failure) -> CycleRecord:
        results = _results(frame)
        superseded = results[topics.PLAN].model_copy(update={"grasp": 7})
        third_frame = frame.model_copy(update={"stamp_ns": frame.stamp_ns + 2})
        failure = second if isinstance(second, Failure) else None
        last = _results(second_frame)
        after = [topics.PLAN, topics.EXECUTE, topics.VERIFY] if failure is None else []
        told: list[tuple[Topic, Message]] = [
            (topics.CAPTURE, _record_of(topics.CAPTURE, results[topics.CAPTURE])),
            (topics.MODEL_REPLY, _reply("of the first look")),
            (topics.PLAN, _record_of(topics.PLAN, superseded)),
            (topics.CAPTURE, _record_of(topics.CAPTURE, None if failure else second, failure)),
            *([] if failure else [(topics.MODEL_REPLY, _reply("of both looks"))]),
            *((topic, _record_of(topic, last[topic])) for topic in after),
            (topics.RESULT, RESULT),
        ]
        return read_cycle(_write(tmp_path / "again.mcap", told, [frame, second_frame, third_frame]))

    return read


def _reply(text: str) -> ModelReply:
    return ModelReply(step="reason", model="geometric", prompt="?", text=text)


Again = Callable[[Message | Failure], CycleRecord]


def test_every_look_comes_back_with_its_reason_and_the_plan_of_fewer_looks_is_superseded(
    looked_again: Again, frame: Frame, second_frame: Frame
) -> None:
    view = _view(second_frame.stamp_ns).model_copy(update={"why": "no way to grasp is free"})
    cycle = looked_again(view)
    assert [look.view.why for look in cycle.looks] == ["", "no way to grasp is free"]
    assert [look.frame.stamp_ns for look in cycle.looks] == [frame.stamp_ns, second_frame.stamp_ns]
    assert list(cycle.stages) == ["capture", "plan", "execute", "verify"]
    planned, captured = cycle.stages["plan"].result, cycle.stages["capture"].result
    assert isinstance(planned, PickPlan) and planned.grasp == 1, "the plan of both looks"
    assert isinstance(captured, View) and captured.why == "no way to grasp is free"


def test_answers_before_the_last_look_are_kept_but_not_replayed(looked_again: Again, second_frame: Frame) -> None:
    cycle = looked_again(_view(second_frame.stamp_ns))
    assert [reply.text for reply in cycle.replies] == ["of the first look", "of both looks"]
    assert [reply.text for reply in cycle.last_replies] == ["of both looks"]


def test_a_look_that_was_not_taken_supersedes_too_and_is_none(looked_again: Again) -> None:
    cycle = looked_again(Failure(code=Code.STOPPED, text="Stopped on the way to another look."))
    assert len(cycle.looks) == 1 and list(cycle.stages) == ["capture"]
    assert cycle.stages["capture"].failure is not None and cycle.stages["capture"].failure.code == Code.STOPPED
    assert len(cycle.replies) == 1 and cycle.last_replies == ()


def test_a_cycle_of_one_look_has_that_and_all_its_answers(recording: Path) -> None:
    cycle = read_cycle(recording)
    assert len(cycle.looks) == 1 and cycle.observation is cycle.looks[0]
    assert cycle.replies == cycle.last_replies


def test_a_cycle_that_failed_ends_with_the_failure_of_its_last_stage(tmp_path: Path, frame: Frame) -> None:
    failure = Failure(code=Code.NO_OBJECT, text="Nothing there.")
    said: list[tuple[Topic, Message]] = [
        (topics.CAPTURE, _record_of(topics.CAPTURE, _view(frame.stamp_ns))),
        (topics.DETECT, _record_of(topics.DETECT, None, failure)),
    ]
    cycle = read_cycle(_write(tmp_path / "cycle.mcap", said, [frame]))
    assert cycle.stages["detect"].failure == failure and cycle.stages["detect"].result is None
    assert cycle.after is None and cycle.result is None


def test_a_cycle_that_failed_to_capture_has_no_observation(tmp_path: Path) -> None:
    failure = Failure(code=Code.STALE_FRAME, text="Old.")
    said: list[tuple[Topic, Message]] = [(topics.CAPTURE, _record_of(topics.CAPTURE, None, failure))]
    cycle = read_cycle(_write(tmp_path / "cycle.mcap", said, []))
    assert cycle.observation is None and cycle.stages["capture"].failure == failure


# --- what is no whole recording ---------------------------------------------------------------------------------------


def _refused(path: Path, match: str) -> None:
    with pytest.raises(RecordingError, match=match) as failure:
        read_cycle(path)
    assert str(path) in str(failure.value) and "\n" not in str(failure.value) and failure.value.advice


def test_a_capture_without_its_frame_is_refused(tmp_path: Path, frame: Frame) -> None:
    said: list[tuple[Topic, Message]] = [(topics.CAPTURE, _record_of(topics.CAPTURE, _view(42)))]
    _refused(_write(tmp_path / "cycle.mcap", said, [frame]), "stamp 42 is missing")


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    _refused(tmp_path / "missing.mcap", "no recording")
    _refused(tmp_path, "no recording")


@pytest.mark.parametrize(
    "content",
    [b"", b"hello\n" * 50, b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" * 2, bytes(4096)],
    ids=["empty", "text", "start", "start and end", "zeros"],
)
def test_what_is_no_mcap_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "cycle.mcap"
    path.write_bytes(content)
    _refused(path, "damaged or no MCAP")


def _foreign(writer: Writer) -> None:
    schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data")
    channel = writer.register_channel("/chatter", "ros1", schema)
    writer.add_message(channel, 1, b"\x02\x00\x00\x00hi", 1)


def _half_ours(writer: Writer) -> None:
    writer.add_metadata("run", {"cycle_id": CYCLE_ID})


def _wrong_content(writer: Writer) -> None:
    writer.add_metadata("run", {"cycle_id": CYCLE_ID})
    writer.add_attachment(1, 1, "station.json", "application/json", b"{}")
    channel = writer.register_channel("/cycle/plan", "json", 0)
    writer.add_message(channel, 1, b'{"cycle_id": 1}', 1)


def _wrong_station(writer: Writer) -> None:
    writer.add_metadata("run", {"cycle_id": CYCLE_ID})
    writer.add_attachment(1, 1, "station.json", "application/json", b"not JSON")


def _half_frame(writer: Writer) -> None:
    writer.add_metadata("run", {"cycle_id": CYCLE_ID})
    writer.add_attachment(1, 1, "station.json", "application/json", b"{}")
    channel = writer.register_channel("/camera/color", "protobuf", 0)
    writer.add_message(channel, 1, b"", 1)


def _broken_frame(writer: Writer) -> None:
    writer.add_metadata("run", {"cycle_id": CYCLE_ID})
    writer.add_attachment(1, 1, "station.json", "application/json", b"{}")
    for topic in topics.FRAME_PARTS:
        channel = writer.register_channel(f"/{topic.key}", "protobuf", 0)
        writer.add_message(channel, 1, b"\xff\xff", 1)


@pytest.mark.parametrize(
    ("fill", "match"),
    [
        (_foreign, "not a recording of this cell"),
        (_half_ours, "not a recording of this cell"),
        (_wrong_content, "damaged message"),
        (_wrong_station, "damaged"),
        (_half_frame, "damaged"),
    ],
)
def test_an_mcap_of_somebody_else_is_refused(tmp_path: Path, fill: Callable[[Writer], None], match: str) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        fill(writer)
        writer.finish()  # type: ignore[no-untyped-call]
    _refused(path, match)


def test_a_frame_that_cannot_be_read_and_was_not_used_is_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "nonsense.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        _broken_frame(writer)
        writer.finish()  # type: ignore[no-untyped-call]
    assert read_cycle(path).observation is None


def test_an_unfinished_recording_is_refused(recording: Path) -> None:
    part = recording.with_name("cycle.mcap.part")
    recording.rename(part)
    _refused(part, "not finished")


@pytest.mark.parametrize("share", [0.001, 0.05, 0.3, 0.6, 0.9, 0.99, 0.999])
def test_a_torn_recording_is_refused(recording: Path, share: float) -> None:
    content = recording.read_bytes()
    recording.write_bytes(content[: int(share * len(content))])
    _refused(recording, "damaged")


def _same_or_refused(path: Path, truth: str) -> bool:
    """Read a damaged file: True = refused in one line, False = read back the same; anything else fails."""
    try:
        read = read_cycle(path)
    except RecordingError as error:
        assert "\n" not in str(error)
        return True
    assert _text(read) == truth
    return False


def test_a_flipped_byte_is_refused_or_changes_nothing(recording: Path) -> None:
    content, truth = recording.read_bytes(), _text(read_cycle(recording))
    rng = random.Random(0)
    refused = 0
    for _ in range(FLIPS):
        damaged = bytearray(content)
        damaged[rng.randrange(len(content))] ^= rng.randrange(1, 256)
        recording.write_bytes(damaged)
        refused += _same_or_refused(recording, truth)
    assert refused > FLIPS / 4, "the rest falls on what nobody reads: the summary"


@pytest.mark.parametrize(
    "text", [CYCLE_ID.encode(), b'"max_age_s": 1.0', b"/cycle/capture", b"/camera/depth/calibration"]
)
def test_damage_outside_the_compressed_chunks_is_refused_too(recording: Path, text: bytes) -> None:
    """One flipped bit in each character of the text's last occurrence: of the summary's, where it is in there."""
    content, truth = recording.read_bytes(), _text(read_cycle(recording))
    start = content.rindex(text)
    for offset in range(len(text)):
        damaged = bytearray(content)
        damaged[start + offset] ^= 1
        recording.write_bytes(damaged)
        _same_or_refused(recording, truth)

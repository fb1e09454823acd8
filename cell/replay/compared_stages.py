"""THE table of the cycle's stages: which of them a replay runs again, and how their outputs are compared.

A *pure* stage gives the same output for the same inputs, configuration and recorded model replies, bit for bit on one
machine; the tolerances allow for the floating point of another processor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from bus import topics
from bus.errors import RecordingError
from bus.frozen import Message
from bus.messages import Detections, Execution, Observation, PickPlan, StageName
from bus.topics import Topic
from cell.pick.detect import detect
from cell.pick.plan import plan
from cell.pick.verify import verify
from config.schema import Station
from logs.differences import Tolerance
from logs.mcap.reader import CycleRecord
from perception.goal.imagine import OnReply
from perception.models import Models
from planning.robot import Robot

Rerun = Callable[[CycleRecord, Station, Robot, Models, OnReply], Message]


@dataclass(frozen=True)
class Stage:
    """One row.

    Attributes:
        rerun: computes its output again from a recording, and says each call of a goal-image model; None = its output
            is recorded, not recomputed.
        tolerances: field pattern -> tolerance of a replayed value.
        steps: (step, the fields it produces), in the order of cause and effect.
    """

    name: StageName
    topic: Topic
    rerun: Rerun | None = None
    tolerances: Mapping[str, Tolerance] = field(default_factory=dict)
    steps: tuple[tuple[str, tuple[str, ...]], ...] = ()

    @property
    def pure(self) -> bool:
        """True when the stage can be rerun."""
        return self.rerun is not None

    def step_of(self, path: str) -> str:
        """Return the step that produces the field at ``path``; the stage itself if none does."""
        return next((step for step, fields in self.steps if path.startswith(fields)), self.name)


def _looks(record: CycleRecord, station: Station) -> Sequence[Observation]:
    """The recorded looks, at most as many as the station asks for: "what would one have seen?"."""
    if not record.looks:
        raise RecordingError(
            f"The recording of {record.cycle_id} holds no observation.", "It ended before its capture."
        )
    views = station.capture.views
    return record.looks if views == "auto" else record.looks[:views]


def _seen_by(found: Detections, record: CycleRecord) -> Sequence[Observation]:
    """The looks that a detection was made of, which may be fewer than today's station asks for."""
    made_of = record.looks[: len(found.scene.look_labels)]
    if len(made_of) < len(found.scene.look_labels):
        raise RecordingError(f"The recording of {record.cycle_id} lacks a look that was detected in.")
    return made_of


def _result(record: CycleRecord, name: StageName, kind: type[Message]) -> Message:
    stage = record.stages.get(name)
    if stage is None or not isinstance(stage.result, kind):
        raise RecordingError(f"The recording of {record.cycle_id} holds no {name} result.", "It ended before.")
    return stage.result


def _detect(record: CycleRecord, station: Station, _robot: Robot, models: Models, on_reply: OnReply) -> Message:
    return detect(_looks(record, station), station, models, on_reply, failed_at=record.attempt.failed_at)


def _plan(record: CycleRecord, station: Station, robot: Robot, _models: Models, _on_reply: OnReply) -> Message:
    found = _result(record, "detect", Detections)
    assert isinstance(found, Detections)
    return plan(found, _seen_by(found, record), robot, station, (*record.attempt.missed, *record.passed_over))


def _verify(record: CycleRecord, station: Station, robot: Robot, _models: Models, _on_reply: OnReply) -> Message:
    found, execution = _result(record, "detect", Detections), _result(record, "execute", Execution)
    chosen = _result(record, "plan", PickPlan)
    assert isinstance(found, Detections) and isinstance(execution, Execution) and isinstance(chosen, PickPlan)
    if execution.after is not None and record.after is None:
        raise RecordingError(f"The recording of {record.cycle_id} lacks the second observation.")
    before = _seen_by(found, record)[found.scene.shown]
    return verify(execution, found, found.grasps[chosen.grasp], before, record.after, robot, station)


_PIXELS = Tolerance(0.05, "px")
_LENGTH = Tolerance(5e-5, "m")
_ANGLE = Tolerance(1e-3, "rad")
_JOINT = Tolerance(1e-4, "rad")
"""Corresponds to 0.1 mm at the tcp. Time-optimal timing amplifies rounding of another processor to up to 1e-5 rad."""
_EXACT_ENOUGH = Tolerance(1e-9, "")
_SHARE = Tolerance(1e-4, "")

STAGES: tuple[Stage, ...] = (
    Stage("capture", topics.CAPTURE),
    Stage(
        "detect",
        topics.DETECT,
        _detect,
        {
            "rectangles[*].center_px[*]": _PIXELS,
            "rectangles[*].width_px": _PIXELS,
            "rectangles[*].height_px": _PIXELS,
            "rectangles[*].angle_rad": _ANGLE,
            "grasps[*].base_from_tcp": Tolerance(0.05, "mm|deg"),
            "grasps[*].width_m": _LENGTH,
            "grasps[*].opening_m": _LENGTH,
            "grasps[*].score": Tolerance(1e-6, ""),
            "grasps[*].terms*": Tolerance(1e-6, ""),
            "grasps[*].imagined_base_from_tcp": Tolerance(0.05, "mm|deg"),
            "evidence.*points": _LENGTH,
            "evidence.rod_ends*": _LENGTH,
            "evidence.alignment.observed_from_goal": Tolerance(0.05, "mm|deg"),
            "evidence.alignment.*": _EXACT_ENOUGH,
            "evidence.drift.*": _EXACT_ENOUGH,
            "scene.table.base_from_table": Tolerance(0.05, "mm|deg"),
            "scene.table.offset_m": _LENGTH,
            "scene.table.tilt_rad": _ANGLE,
            "scene.region_seen": _SHARE,
            "scene.instances[*].top_m": _LENGTH,
            "scene.instances[*].size_m": _LENGTH,
            "scene.instances[*].depth_share": _SHARE,
            "tried[*].score": Tolerance(1e-6, ""),
        },
        (
            ("see", ("scene", "evidence.color")),
            ("outline", ("evidence.object_mask",)),
            ("imagine", ("evidence.goal_",)),
            ("lift", ("evidence.observed_points",)),
            ("drift", ("evidence.drift",)),
            ("align", ("evidence.alignment", "evidence.aligned_points")),
            ("project", ("evidence.rod_", "rectangles")),
            ("try", ("tried",)),
            ("rank", ("grasps", "evidence.sample", "evidence.agreement")),
        ),
    ),
    Stage(
        "plan",
        topics.PLAN,
        _plan,
        {
            "segments[*].trajectory.raw_q_rad": _JOINT,
            "rejected[*].obstacle.too_near_m": Tolerance(1e-3, "m"),
            "rejected[*].obstacle.base_from_tcp": Tolerance(0.05, "mm|deg"),
            "rejected[*].obstacle.*": _LENGTH,
        },
    ),
    Stage("approve", topics.APPROVE),
    Stage("execute", topics.EXECUTE),
    Stage(
        "verify",
        topics.VERIFY,
        _verify,
        {
            "load_n": Tolerance(1e-6, "N"),
            "carried_n": Tolerance(1e-6, "N"),
            "cleared_fraction": Tolerance(1e-3, ""),
            "hold_s": Tolerance(1e-9, "s"),
        },
    ),
    Stage("deliver", topics.DELIVER),
)

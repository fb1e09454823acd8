"""Small but whole recordings: what a cell would write, made of the frame fixture and short arrays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bus import codec, sensor_codec, topics
from bus.codes import Code
from bus.commands import CellState
from bus.frozen import Message
from bus.messages import (
    Alignment,
    ArmMode,
    ArmState,
    CycleResult,
    Detections,
    Drift,
    Evidence,
    Execution,
    Failure,
    Frame,
    Grasp,
    HandState,
    Instance,
    ModelReply,
    Motion,
    ObservedScene,
    PickPlan,
    Rectangle,
    SeenTable,
    Segment,
    SegmentRun,
    Tried,
    Verdict,
    View,
)
from bus.rejection import Rejection
from bus.topics import Topic, encoding_of
from bus.trajectory import Trajectory
from config.load import load_station
from logs.mcap.recorder import Recorder

CYCLE_ID = "20260101T000000000"
REJECTED = (Rejection(grasp=0, tilt_rad=0.0, code=Code.COLLISION, reason="approach: left finger touches post"),)
HOSTILE = "<script>alert('rod')</script>"
Record = Callable[..., Path]

_HAND = HandState(stamp_ns=1, width_m=0.03, is_moving=False, is_homed=True)
_HOME = np.array([0.0, -0.45, 0.0, -1.83, 0.0, 1.38, 0.785])


def _view(stamp_ns: int, why: str = "", base_from_color: np.ndarray | None = None) -> View:
    arm = ArmState(stamp_ns=1, mode=ArmMode.IDLE, q_rad=_HOME, dq_rad_s=np.zeros(7), tau_ext_nm=np.zeros(7))
    pose = np.diag([1.0, -1.0, -1.0, 1.0]) if base_from_color is None else base_from_color
    return View(stamp_ns=stamp_ns, arm=arm, base_from_color=pose, why=why)


def _detections(frame: Frame) -> Detections:
    mask = np.zeros(frame.color.shape[:2], dtype=bool)
    mask[30:50, 60:90] = True
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (50, 3)).astype(np.float32)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    return Detections(
        rectangles=(Rectangle(center_px=(75.0, 40.0), angle_rad=0.3, width_px=30.0, height_px=12.0),),
        grasps=(
            Grasp(
                base_from_tcp=pose,
                width_m=0.03,
                opening_m=0.045,
                score=0.7,
                instance=1,
                rectangle=0,
                imagined_base_from_tcp=pose,
                terms={"flat": 0.9, "patch": 0.5},
            ),
        ),
        evidence=Evidence(
            color=frame.color,
            object_mask=mask,
            goal_image=frame.color,
            goal_object_mask=mask,
            goal_rod_mask=mask,
            observed_points=points,
            goal_points=points,
            aligned_points=points,
            rod_points=points,
            rod_ends=(np.zeros(3), np.array([0.05, 0.0, 0.0])),
            alignment=Alignment(
                method="pca_cfopt",
                observed_from_goal=np.eye(4),
                scale=1.0,
                chamfer_m2=1e-6,
                goal_to_observed_m=0.001,
                observed_to_goal_m=0.001,
                residual=0.02,
                hypotheses=4,
                took_s=0.01,
            ),
            drift=Drift(
                changed_outside=0.0,
                other_objects=0.0,
                silhouette_iou=0.97,
                shift_px=0.0,
                turn_rad=0.0,
                scale=1.0,
                color_shift=1.0,
            ),
            sample=0,
            agreement=1.0,
        ),
        scene=scene_of(mask),
        tried=(Tried(instance=1, sample=0, score=0.7),),
    )


def scene_of(mask: np.ndarray) -> ObservedScene:
    """One thing where the mask (H, W) is, on a table 3 mm too high; a corner of the region was not seen."""
    unseen = np.zeros_like(mask)
    unseen[:8, :8] = True
    thing = Instance(number=1, top_m=np.array([0.45, 0.0, 0.05]), size_m=np.array([0.08, 0.03, 0.05]), in_view=True,
                     depth_share=0.98)  # fmt: skip
    return ObservedScene(
        table=SeenTable(base_from_table=np.eye(4), offset_m=0.003, tilt_rad=0.01),
        region_seen=0.97,
        instances=(thing,),
        labels=mask.astype(np.uint8),
        unseen=unseen,
    )


def _run(name: str) -> SegmentRun:
    q_rad = _HOME + 0.1 * (0.5 - 0.5 * np.cos(np.linspace(0, 2 * np.pi, 200)))[:, None]
    measured = q_rad[::10]
    motion = Motion(
        finished=True,
        commanded_q_rad=q_rad,
        t_s=np.arange(len(measured), dtype=np.float64) * 0.01,
        q_rad=measured,
        dq_rad_s=np.zeros_like(measured),
        tau_ext_nm=np.zeros_like(measured),
    )
    return SegmentRun.model_validate({"name": name, "motion": motion, "hand": _HAND})


def _aside(tilt_rad: float) -> np.ndarray:
    """The pose (4, 4) of a camera that looks from the robot's left, tilted thus."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[1:3, 1:3] = [[-np.cos(tilt_rad), -np.sin(tilt_rad)], [np.sin(tilt_rad), -np.cos(tilt_rad)]]
    return pose


def _stages(frame: Frame, again: str) -> dict[str, tuple[Topic, Message]]:
    names = ("reach", "carry", "hold")
    still = Trajectory(raw_q_rad=_HOME[None], window=1)
    after = frame.stamp_ns + 1
    execution = Execution(runs=tuple(_run(name) for name in names), grasped=_HAND, stopped_in=None, after=_view(after))
    verdict = Verdict(
        held=True, code=None, reason="Held.", hold_s=3.0, width_min_m=0.03, load_n=1.0, cleared_fraction=1.0
    )
    return {
        "capture": (topics.CAPTURE, _view(frame.stamp_ns, again, _aside(np.pi / 4) if again else None)),
        "detect": (topics.DETECT, _detections(frame)),
        "plan": (
            topics.PLAN,
            PickPlan(
                grasp=0,
                tilt_rad=0.0,
                segments=(Segment(name="reach", route="straight", trajectory=still),),
                rejected=(),
            ),
        ),
        "execute": (topics.EXECUTE, execution),
        "verify": (topics.VERIFY, verdict),
    }


@pytest.fixture
def record(tmp_path: Path, frame: Frame) -> Record:
    """Write a recording whose stage ``failed`` (if any) ended the cycle; give its path.

    With ``again`` a second look is taken for that reason, tilted by 45 degrees; before it, detect failed or ``found``.
    """

    def write(failed: str | None = None, name: str = CYCLE_ID, again: str = "", *, found: bool = False) -> Path:
        recorder = Recorder(
            tmp_path / f"{name}.mcap", metadata={"cycle_id": name, "schema": "1"}, clock=lambda: frame.stamp_ns
        )
        recorder.attach("station.json", "application/json", load_station().model_dump_json().encode())
        time_ns = frame.stamp_ns

        def say(topic: Topic, message: Message) -> None:
            nonlocal time_ns
            time_ns += 1_000_000
            recorder.write(topic.key, encoding_of(topic.says), codec.encode(message), log_time_ns=time_ns)

        for seen in (frame.model_copy(update={"stamp_ns": frame.stamp_ns + n}) for n in range(3 if again else 2)):
            for key, payload in sensor_codec.frame_to_wire(seen).items():
                says = next(topic.says for topic in topics.FRAME_PARTS if topic.key == key)
                recorder.write(key, encoding_of(says), payload, log_time_ns=time_ns)
        state = CellState(state="Execute", stage="", cycle_id=name, since_ns=1, available=("stop",), reason="")
        say(topics.STATE, state)
        say(topics.HAND_STATE, _HAND)
        say(topics.MODEL_REPLY, ModelReply(step="reason", model="geometric", prompt="?", text=HOSTILE))
        if again:
            first = {"cycle_id": name, "started_ns": time_ns, "duration_s": 0.2}
            said = topics.CAPTURE.says(**first, stage="capture", result=_view(frame.stamp_ns + 2), failure=None)
            say(topics.CAPTURE, said)
            nothing = Failure(code=Code.NOT_SEEN, text="Too little of it was seen.")
            seen_first = {"result": _detections(frame)} if found else {"failure": nothing}
            say(
                topics.DETECT,
                topics.DETECT.says(**first, stage="detect", **{"result": None, "failure": None, **seen_first}),
            )
        code = None
        for stage, (topic, result) in _stages(frame, again).items():
            code = Code.NO_GRASP if stage == failed else None
            if stage == failed == "detect":
                assert isinstance(result, Detections)
                say(topics.SCENE, result.scene)
            rejected = REJECTED if stage == "plan" else ()
            failure = None if code is None else Failure(code=code, text=f"{stage} failed.", rejected=rejected)
            say(
                topic,
                topic.says(
                    cycle_id=name,
                    stage=stage,
                    started_ns=time_ns,
                    duration_s=0.5,
                    result=None if failure else result,
                    failure=failure,
                ),
            )
            if failure:
                break
        outcome = "FAILED" if code else "SUCCESS"
        result = CycleResult.model_validate(
            {"cycle_id": name, "object": "box", "result": outcome, "code": code, "reason": "So it ended.",
             "stages": {}, "wall_s": 2.0, "recording": ""}
        )  # fmt: skip
        say(topics.RESULT, result)
        return recorder.close({"result": outcome, "code": code or "", "reason": "So it ended."})

    return write

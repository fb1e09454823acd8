"""Comparing any two messages: silent about equal ones, one difference for one changed leaf, in mm and degrees."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bus.codes import Code
from bus.frozen import Message
from bus.messages import (
    Alignment,
    CameraModel,
    CycleResult,
    Drift,
    Evidence,
    Execution,
    Failure,
    Grasp,
    HandState,
    ModelReply,
    Motion,
    PickPlan,
    Rectangle,
    SegmentRun,
    StageRecord,
    Verdict,
)
from bus.rejection import Rejection
from logs.differences import POSE, Difference, Tolerance, compare

_UNCOMPARED = ("latency_s", "took_s")
NUMBERS = st.floats(-1e3, 1e3) | st.just(math.nan)
SEEDS = st.integers(0, 2**32 - 1)


def _array(*shape: int) -> st.SearchStrategy[np.ndarray]:
    """Random numbers, some of them NaN."""

    def draw(seed: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        return np.where(rng.uniform(size=shape) < 0.1, np.nan, rng.normal(size=shape))

    return SEEDS.map(draw)


def _image(*shape: int) -> st.SearchStrategy[np.ndarray]:
    return SEEDS.map(lambda seed: np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8))


MASKS = _image(4, 5).map(lambda image: image > 127)
HANDS = st.builds(HandState, stamp_ns=st.integers(0, 10), width_m=NUMBERS, is_moving=st.booleans())
VERDICTS = st.builds(Verdict, hold_s=NUMBERS, width_min_m=NUMBERS, load_n=NUMBERS, cleared_fraction=NUMBERS)
MOTIONS = st.builds(
    Motion,
    commanded_q_rad=_array(3, 7),
    t_s=_array(2),
    q_rad=_array(2, 7),
    dq_rad_s=_array(2, 7),
    tau_ext_nm=_array(2, 7),
)
ALIGNMENTS = st.builds(Alignment, observed_from_goal=_array(4, 4), scale=NUMBERS, chamfer_m2=NUMBERS, took_s=NUMBERS)
RUNS = st.lists(st.builds(SegmentRun, motion=MOTIONS, hand=HANDS), max_size=3).map(tuple)
EVIDENCES = st.builds(
    Evidence,
    color=_image(4, 5, 3),
    object_mask=MASKS,
    goal_image=_image(4, 5, 3),
    goal_object_mask=MASKS,
    goal_rod_mask=MASKS,
    observed_points=_array(3, 3),
    goal_points=_array(3, 3),
    aligned_points=_array(1, 3),
    rod_points=_array(2, 3),
    rod_ends=st.tuples(_array(3), _array(3)),
    alignment=ALIGNMENTS,
    drift=st.builds(Drift, scale=NUMBERS, color_shift=NUMBERS),
    agreement=NUMBERS,
)
MESSAGES: st.SearchStrategy[Message] = st.one_of(
    VERDICTS,
    st.builds(Rectangle, center_px=st.tuples(NUMBERS, NUMBERS), angle_rad=NUMBERS, width_px=NUMBERS),
    st.builds(
        Grasp,
        base_from_tcp=_array(4, 4),
        width_m=NUMBERS,
        score=NUMBERS,
        imagined_base_from_tcp=_array(4, 4),
        terms=st.dictionaries(st.sampled_from(["flat", "patch", "depth"]), NUMBERS),
    ),
    st.builds(ModelReply, latency_s=NUMBERS, image_png=st.none() | st.binary(max_size=4)),
    st.builds(CameraModel, fx=NUMBERS, distortion=st.lists(NUMBERS, max_size=8).map(tuple)),
    st.builds(Execution, runs=RUNS, grasped=st.none() | HANDS, after=st.none()),
    st.builds(
        StageRecord[Verdict],
        duration_s=NUMBERS,
        result=st.none() | VERDICTS,
        failure=st.none() | st.builds(Failure, rejected=st.just(())),
    ),
    EVIDENCES,
)

Change = tuple[str, Callable[[], Any]]
"""The path of a leaf, and its message with that leaf changed."""


def _other(value: Any) -> Any:
    """Another value of the same kind."""
    if isinstance(value, Enum):
        return next(member for member in type(value) if member is not value)
    if isinstance(value, bool | np.bool_):
        return not value
    if isinstance(value, float | np.floating):
        return value + 1.0 + abs(float(value)) if math.isfinite(value) else 0.0
    if isinstance(value, int | np.integer):
        return value + 1 if value < 255 else 0
    if isinstance(value, bytes):
        return value + b"!"
    return value + "!" if isinstance(value, str) else Code.DROPPED


def _grasp(pose: np.ndarray, score: float) -> Grasp:
    return Grasp(
        base_from_tcp=pose,
        width_m=0.03,
        opening_m=0.04,
        score=score,
        rectangle=0,
        imagined_base_from_tcp=np.eye(4),
        terms={},
    )


def _changes(path: str, value: Any) -> list[Change]:
    """Every way to change one leaf of ``value``."""
    if isinstance(value, Message):
        return [
            (leaf, lambda name=name, made=made: value.model_copy(update={name: made()}))  # type: ignore[misc]
            for name in type(value).model_fields
            if name not in _UNCOMPARED
            for leaf, made in _changes(f"{path}.{name}" if path else name, getattr(value, name))
        ]
    if isinstance(value, tuple):
        return [
            (leaf, lambda index=index, made=made: (*value[:index], made(), *value[index + 1 :]))  # type: ignore[misc]
            for index, part in enumerate(value)
            for leaf, made in _changes(f"{path}[{index}]", part)
        ]
    if isinstance(value, dict):
        return [
            (leaf, lambda name=name, made=made: {**value, name: made()})  # type: ignore[misc]
            for name, part in value.items()
            for leaf, made in _changes(f"{path}.{name}", part)
        ]
    if isinstance(value, np.ndarray):
        return [(_label(path, value, index), partial(_with, value, index)) for index in np.ndindex(value.shape)]
    return [(path, lambda: _other(value))]


def _label(path: str, array: np.ndarray, index: tuple[int, ...]) -> str:
    is_image = array.dtype in (np.uint8, np.bool_)
    return path if is_image else f"{path}[{','.join(map(str, index))}]"


def _with(array: np.ndarray, index: tuple[int, ...]) -> np.ndarray:
    copy = array.copy()
    copy[index] = _other(array[index])
    return copy


def _json(found: list[Difference]) -> str:
    """Strict JSON: NaN and infinity must already be text."""
    return json.dumps([difference.to_json() for difference in found], allow_nan=False)


@given(MESSAGES)
def test_a_message_equals_itself_and_its_copy_through_json(message: Message) -> None:
    assert compare(message, message, {}) == []
    assert compare(message, type(message).model_validate_json(message.model_dump_json()), {}) == []


@settings(max_examples=150)
@given(MESSAGES, st.data())
def test_one_changed_leaf_is_one_difference_that_names_it(message: Message, data: st.DataObject) -> None:
    path, changed = data.draw(st.sampled_from(_changes("", message)))
    for found in (compare(message, changed(), {}), compare(changed(), message, {})):
        assert [difference.field for difference in found] == [path]
        assert _json(found) and found[0].describe().startswith(f"{path}: ")


@given(MESSAGES, st.data())
def test_differences_come_in_the_order_of_the_fields(message: Message, data: st.DataObject) -> None:
    top = [n for n in type(message).model_fields if n not in _UNCOMPARED and _changes(n, getattr(message, n))]
    names = data.draw(st.sets(st.sampled_from(top), min_size=1))
    update = {name: _changes(name, getattr(message, name))[0][1]() for name in names}
    found = [difference.field for difference in compare(message, message.model_copy(update=update), {})]
    assert [path.partition("[")[0].partition(".")[0] for path in found] == [name for name in top if name in names]


@given(_array(3, 7), SEEDS, st.floats(0.0, 0.2))
def test_an_array_differs_where_it_differs_most_and_only_beyond_its_tolerance(
    q_rad: np.ndarray, seed: int, allowed: float
) -> None:
    noise = np.random.default_rng(seed).uniform(-0.1, 0.1, q_rad.shape)
    one = Motion(
        finished=True, commanded_q_rad=q_rad, t_s=np.zeros(1), q_rad=q_rad[:1], dq_rad_s=q_rad[:1], tau_ext_nm=q_rad[:1]
    )
    other = one.model_copy(update={"commanded_q_rad": q_rad + noise})
    found = compare(one, other, {"commanded_*": Tolerance(allowed, "rad")})
    deviation = np.nan_to_num(np.abs(one.commanded_q_rad - other.commanded_q_rad))
    row, column = np.unravel_index(deviation.argmax(), deviation.shape)
    if deviation.max() <= allowed:
        assert found == []
    else:
        (difference,) = found
        assert difference.field == f"commanded_q_rad[{row},{column}]"
        assert (difference.difference, difference.tolerance, difference.unit) == (deviation.max(), allowed, "rad")


@given(
    st.lists(st.floats(-1, 1), min_size=3, max_size=3),
    st.floats(0, math.pi - 0.01),
    st.lists(st.floats(-0.1, 0.1), min_size=3, max_size=3),
    st.floats(0.01, 200.0),
)
def test_poses_differ_by_millimetres_and_degrees(
    rotvec: list[float], turn_rad: float, shift_m: list[float], allowed: float
) -> None:
    before, after = np.eye(4), np.eye(4)
    before[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    after[:3, :3] = before[:3, :3] @ Rotation.from_rotvec([0.0, turn_rad, 0.0]).as_matrix()
    after[:3, 3] = shift_m
    one = _grasp(before, 1.0)
    found = compare(one, one.model_copy(update={"base_from_tcp": after}), {"base_from_tcp": Tolerance(allowed, POSE)})
    truth = {"translation": (1e3 * math.hypot(*shift_m), "mm"), "rotation": (math.degrees(turn_rad), "deg")}
    reported = {difference.field.removeprefix("base_from_tcp."): difference for difference in found}
    for part, (amount, unit) in truth.items():
        if abs(amount - allowed) > 1e-6:
            assert (part in reported) == (amount > allowed)
        if part in reported:
            assert reported[part].difference == pytest.approx(amount, abs=1e-6) and reported[part].unit == unit
    assert _json(found) is not None


@given(st.integers(0, 4), st.integers(0, 4))
def test_tuples_of_different_length_are_one_difference_of_their_counts(one: int, other: int) -> None:
    plans = [
        PickPlan(
            grasp=0,
            tilt_rad=0.0,
            segments=(),
            rejected=tuple(Rejection(grasp=n, tilt_rad=0.0, code=Code.COLLISION, reason="tray") for n in range(count)),
        )
        for count in (one, other)
    ]
    found = [(d.field, d.recorded, d.replayed) for d in compare(plans[0], plans[1], {})]
    assert found == ([] if one == other else [("rejected.count", one, other)])


@given(EVIDENCES, st.integers(0, 20), st.integers(0, 20))
def test_images_differ_by_their_number_of_pixels(evidence: Evidence, differing: int, allowed: int) -> None:
    changed = (np.arange(20) < differing).reshape(4, 5)
    other = evidence.model_copy(
        update={
            "object_mask": evidence.object_mask ^ changed,
            "color": np.where(changed[..., None], 255 - evidence.color, evidence.color),
        }
    )
    rules = {name: Tolerance(allowed, "px") for name in ("object_mask", "color")}
    found = [(d.field, d.difference, d.tolerance, d.unit) for d in compare(evidence, other, rules)]
    assert found == [(name, differing, allowed, "px") for name in ("color", "object_mask") if differing > allowed]


@given(MESSAGES, MESSAGES)
def test_any_two_messages_compare_to_strict_json(one: Message, other: Message) -> None:
    found = compare(one, other, {})
    _json(found)
    if type(one) is not type(other):
        assert [(d.field, d.recorded, d.replayed) for d in found] == [
            ("type", type(one).__name__, type(other).__name__)
        ]


@given(VERDICTS)
def test_a_stage_that_failed_instead_differs_by_its_type(verdict: Verdict) -> None:
    failure = Failure(code=Code.NO_GRASP, text="None.")
    for one, other in ((verdict, failure), (failure, verdict)):
        (difference,) = compare(one, other, {"*": Tolerance(1e9, "m")})
        assert (difference.field, difference.recorded) == ("type", type(one).__name__)
        assert (difference.replayed, difference.difference) == (type(other).__name__, None)


def test_the_first_pattern_that_fits_counts_and_stars_stand_for_indices() -> None:
    boxes = tuple(
        CycleResult(
            cycle_id="one", object="", result="SUCCESS", code=None, reason="", stages={}, wall_s=wall_s, recording=""
        )
        for wall_s in (1.0, 1.4)
    )
    assert compare(boxes[0], boxes[1], {"wall_s": Tolerance(0.5, "s"), "*": Tolerance(0.0, "s")}) == []
    (difference,) = compare(boxes[0], boxes[1], {"wall_?": Tolerance(9.0, "s"), "*_s": Tolerance(0.1, "s")})
    assert (difference.tolerance, difference.unit) == (0.1, "s")
    camera = CameraModel(width=1, height=1, fx=1.0, fy=1.0, cx=0.0, cy=0.0, distortion=(0.1, 0.2))
    bent = camera.model_copy(update={"distortion": (0.1, 0.3)})
    assert compare(camera, bent, {"distortion[*]": Tolerance(0.2, "")}) == []
    assert [d.field for d in compare(camera, bent, {"distortion[0]": Tolerance(0.2, "")})] == ["distortion[1]"]


@pytest.mark.parametrize(
    ("value", "rules"), [(math.nan, {"base_from_tcp": Tolerance(0.1, POSE)}), (math.inf, {}), (math.nan, {})]
)
def test_what_is_not_finite_equals_itself(value: float, rules: dict[str, Tolerance]) -> None:
    pose = np.eye(4)
    pose[0, 3] = value
    grasp = _grasp(pose, value)
    assert compare(grasp, grasp, rules) == []


def test_a_pose_that_became_nan_differs() -> None:
    pose, broken = np.eye(4), np.eye(4)
    broken[0, 3] = broken[1, 1] = math.nan
    one = _grasp(pose, 1.0)
    found = compare(one, one.model_copy(update={"base_from_tcp": broken}), {"base_from_tcp": Tolerance(1e9, POSE)})
    assert [(d.field, d.difference) for d in found] == [
        ("base_from_tcp.translation", None),
        ("base_from_tcp.rotation", None),
    ]
    _json(found)

"""Two messages are equal if and only if nothing is reported, and what is reported names field, values and unit."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.codes import Code
from bus.messages import Alignment, Failure, HandState, Rectangle, Verdict
from bus.rejection import Obstacle, Rejection
from bus.trajectory import Trajectory
from logs.differences import POSE, Tolerance, compare

VERDICT = Verdict(
    held=True, code=None, reason="Held.", hold_s=3.0, width_min_m=0.03, load_n=math.nan, cleared_fraction=1.0
)
CHANGES = {
    "held": False,
    "code": Code.DROPPED,
    "reason": "Lost.",
    "hold_s": 2.0,
    "width_min_m": 0.01,
    "load_n": 1.0,
    "cleared_fraction": 0.5,
}


def test_a_message_equals_itself_nan_included() -> None:
    assert compare(VERDICT, VERDICT.model_copy(), {}) == []


@given(st.sets(st.sampled_from(sorted(CHANGES))))
def test_exactly_the_changed_fields_are_reported(changed: set[str]) -> None:
    other = VERDICT.model_copy(update={name: CHANGES[name] for name in changed})
    found = compare(VERDICT, other, {})
    assert {difference.field for difference in found} == changed
    json.dumps([difference.to_json() for difference in found])
    assert all(difference.describe() for difference in found)


@given(st.floats(0, 1), st.floats(0, 1), st.floats(0, 0.5))
def test_a_tolerance_is_kept_and_named_with_its_unit(a: float, b: float, allowed: float) -> None:
    one, other = VERDICT.model_copy(update={"load_n": a}), VERDICT.model_copy(update={"load_n": b})
    found = compare(one, other, {"load_*": Tolerance(allowed, "N")})
    assert bool(found) == (a != b and abs(a - b) > allowed)
    for difference in found:
        assert (difference.recorded, difference.replayed, difference.unit) == (a, b, "N")


def test_the_unit_is_read_from_the_name_where_no_rule_says() -> None:
    shorter = VERDICT.model_copy(update={"hold_s": 2.0, "width_min_m": 0.0})
    assert [difference.unit for difference in compare(VERDICT, shorter, {})] == ["s", "m"]


def test_nested_fields_and_indices_are_named() -> None:
    box = Rectangle(center_px=(1.0, 2.0), angle_rad=0.1, width_px=10.0, height_px=5.0)
    moved = box.model_copy(update={"center_px": (1.0, 2.5)})
    (difference,) = compare(box, moved, {})
    assert (difference.field, difference.difference) == ("center_px[1]", 0.5)


def test_poses_differ_in_millimetres_and_degrees() -> None:
    pose = np.eye(4)
    turned = np.eye(4)
    turned[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    turned[0, 3] = 0.002
    one, other = (
        Alignment(
            method="pca_cfopt",
            observed_from_goal=matrix,
            scale=1.0,
            chamfer_m2=0.0,
            goal_to_observed_m=0.0,
            observed_to_goal_m=0.0,
            residual=0.0,
            hypotheses=4,
            took_s=0.01,
        )
        for matrix in (pose, turned)
    )
    rules = {"observed_from_goal": Tolerance(0.1, POSE)}
    found = compare(one, other, rules)
    assert [(d.field.rpartition(".")[2], round(d.difference or 0, 6), d.unit) for d in found] == [
        ("translation", 2.0, "mm"),
        ("rotation", 90.0, "deg"),
    ]
    assert compare(one, other, {"observed_from_goal": Tolerance(100.0, POSE)}) == []


def test_arrays_report_their_largest_deviation_and_a_different_length() -> None:
    one = Trajectory(raw_q_rad=np.zeros((3, 7)), window=1)
    bent = np.zeros((3, 7))
    bent[1, 2], bent[2, 3] = 0.1, 0.3
    (difference,) = compare(one, Trajectory(raw_q_rad=bent, window=1), {"raw_q_rad": Tolerance(0.01, "rad")})
    assert (difference.field, difference.difference, difference.unit) == ("raw_q_rad[2,3]", 0.3, "rad")
    (difference,) = compare(one, Trajectory(raw_q_rad=np.zeros((4, 7)), window=1), {})
    assert difference.field == "raw_q_rad.shape"


def test_what_an_older_recording_says_nothing_of_is_no_difference() -> None:
    said = {"grasp": 0, "tilt_rad": 0.0, "code": Code.COLLISION, "reason": "table"}
    now = Rejection.model_validate({**said, "obstacle": None}).model_copy(update={"obstacle": OBSTACLE})
    assert compare(Rejection.model_validate(said), now, {}) == []
    (difference,) = compare(Rejection.model_validate({**said, "obstacle": None}), now, {})
    assert difference.field == "obstacle"


OBSTACLE = Obstacle(
    part="left finger", name="table", kind="box", too_near_m=0.003, needed_m=0.002, touch_m=np.zeros(3),
    base_from_tcp=np.eye(4), opening_m=0.05, points_m=np.zeros((8, 3), np.float32),
)  # fmt: skip


@pytest.mark.parametrize(
    "other",
    [
        Failure(code=Code.NO_GRASP, text="None."),
        HandState(stamp_ns=1, width_m=0.1, is_moving=False, is_homed=True),
        Rejection(grasp=0, tilt_rad=0.0, code=Code.COLLISION, reason="table"),
    ],
)
def test_another_kind_of_outcome_is_one_difference(other: Failure | HandState | Rejection) -> None:
    (difference,) = compare(VERDICT, other, {})
    assert (difference.field, difference.recorded, difference.replayed) == ("type", "Verdict", type(other).__name__)

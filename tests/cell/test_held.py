"""`benchmarks held`: what counts as held, lost and missed, where a cycle's time goes, and a pick of the whole cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.heaps.shapes import box_corners
from benchmarks.held.figures import figures
from benchmarks.held.rounds import Attempt, Pick, Window, attempt_of
from benchmarks.held.run import Wanted, beside, judge, run
from benchmarks.held.solids import Thing, corners, scene_of
from benchmarks.held.watched import ARM, CAPTURE, GRASP, HAND, HOLD, PRESENT, Deed
from bus.codes import Code
from bus.messages import CycleResult
from config.load import load_station

LIES_M, LIFTED_M = 0.02, 0.17


def result(outcome: str = "SUCCESS", code: Code | None = None, **changed: object) -> CycleResult:
    made = {"cycle_id": "1", "object": "brick", "result": outcome, "code": code, "reason": "", "wall_s": 1.0,
            "stages": {"capture": 1.0, "execute": 1.0}, "recording": "", "retried_as": ""}  # fmt: skip
    return CycleResult.model_validate(made | changed)


def deeds(*steps: tuple[str, float, float, tuple[float, ...]]) -> list[Deed]:
    """One after the other, each after 0.1 s of nothing: kind, seconds, simulated seconds, heights afterwards."""
    made: list[Deed] = []
    now_s, simulated_s = 100.0, 0.0
    for kind, wall_s, took_s, heights_m in steps:
        now_s += 0.1
        pose = np.tile(np.eye(4), (len(heights_m), 1, 1))
        span = (now_s, now_s + wall_s, simulated_s, simulated_s + took_s)
        made.append(Deed(kind, *span, np.array(heights_m), np.array(heights_m) > LIES_M, pose))
        now_s, simulated_s = now_s + wall_s, simulated_s + took_s
    return made


def cycle(held_m: tuple[float, ...], released_m: tuple[float, ...], said: CycleResult | None = None) -> Attempt:
    """A cycle that lifts: where everything is at the end of the hold, and just before the hand opens."""
    lies = (LIES_M,) * len(held_m)
    made = deeds(
        (PRESENT, 1.0, 1.6, lies), (CAPTURE, 0.5, 0.0, lies), (HAND, 0.2, 1.0, lies), (ARM, 0.3, 1.5, lies),
        (GRASP, 0.2, 2.0, lies), (ARM, 0.2, 1.0, held_m), (HOLD, 0.1, 3.0, held_m), (CAPTURE, 0.5, 0.0, held_m),
        (ARM, 0.2, 1.0, released_m), (HAND, 0.2, 1.0, lies), (ARM, 0.2, 1.0, lies),
    )  # fmt: skip
    end_s = made[-1].ended_s
    return attempt_of(Window(99.0, end_s + 0.1, end_s + 0.3, end_s + 0.4, said or result(), made))


def pick(attempt: Attempt, name: str = "brick", feasible: bool | None = True) -> Pick:
    return Pick(name, 1, [attempt], None, feasible)


HELD = cycle((LIFTED_M,), (LIFTED_M,))


@pytest.mark.parametrize(
    ("held_m", "released_m", "risen", "carried"),
    [
        ((LIFTED_M,), (LIFTED_M,), (0,), (0,)),
        ((LIFTED_M,), (LIES_M,), (0,), ()),
        ((LIES_M + 0.04,), (LIFTED_M,), (), ()),
        ((LIES_M, LIFTED_M, LIFTED_M), (LIES_M, LIFTED_M, LIES_M), (1, 2), (1,)),
    ],
    ids=["held", "lost on the way", "only tilted", "two at once, one lost"],
)
def test_what_rose_by_50_mm_at_the_end_of_the_hold_is_held(
    held_m: tuple[float, ...], released_m: tuple[float, ...], risen: tuple[int, ...], carried: tuple[int, ...]
) -> None:
    attempt = cycle(held_m, released_m)
    assert attempt.is_executed and (attempt.risen, attempt.carried) == (risen, carried)


def test_a_cycle_without_a_hold_held_nothing() -> None:
    refused = Window(99.0, 101.0, 101.1, 101.2, result("FAILED", Code.NO_GRASP), deeds((CAPTURE, 0.5, 0.0, (LIES_M,))))
    attempt = attempt_of(refused)
    assert not attempt.is_executed and attempt.risen == ()


def test_the_parts_of_a_cycle_add_up_from_the_presentation_to_the_next_cycle() -> None:
    times = HELD.times
    assert (times.motion, times.hand, times.hold, times.simulated) == pytest.approx((4.5, 4.0, 3.0, 11.5))
    assert times.capture == pytest.approx(1.0)
    assert times.log == pytest.approx(0.2)
    assert times.compute_not_hidden == pytest.approx(10 * 0.1 + 0.1 + 0.1)
    moving_s = 0.2 + 0.3 + 0.2 + 0.2 + 0.1 + 0.2 + 0.2 + 0.2
    assert times.wall == pytest.approx(times.capture + times.compute_not_hidden + times.log + moving_s)


def test_what_is_done_at_once_counts_once() -> None:
    made = deeds((CAPTURE, 0.5, 0.0, (LIES_M,)), (ARM, 1.0, 2.0, (LIES_M,)))
    opening = replace(made[1], kind=HAND, to_s=made[1].to_s + 0.5)
    looking = replace(made[1], kind=CAPTURE)
    end_s = made[-1].ended_s
    times = attempt_of(Window(100.0, end_s, end_s, end_s, result(), [*made, opening, looking])).times
    assert (times.motion, times.hand, times.capture) == pytest.approx((2.0, 0.5, 0.5))


def test_the_figures_keep_apart_what_the_cell_says_and_what_is_true() -> None:
    failed = result("FAILED", Code.DROPPED)
    told = figures(
        [
            pick(HELD),
            pick(cycle((LIES_M,), (LIES_M,))),  # the cell says success
            pick(cycle((LIFTED_M,), (LIFTED_M,), failed)),  # the cell says dropped
            pick(cycle((LIFTED_M,), (LIES_M,), failed)),  # it was dropped on the way
            pick(cycle((LIFTED_M, LIFTED_M), (LIFTED_M, LIFTED_M)), "two"),
            pick(attempt_of(Window(99.0, result=result("FAILED", Code.NO_OBJECT, stages={}))), "ball", None),
            pick(
                attempt_of(Window(99.0, result=result("FAILED", Code.NO_GRASP, stages={"detect": 1}))), "plate", False
            ),
            pick(attempt_of(Window(99.0, result=result("ABORTED", Code.ARM_REFLEX))), "cup"),
        ],
        binned=[(5, 1), (5, 0)],
        is_paced=False,
    )
    assert (told["picks"], told["not_presented"], told["feasible"], told["infeasible"]) == (7, 1, 6, 1)
    assert (told["held_by_physics"], told["verdict_success"], told["missed"]) == (4, 3, 1)
    assert (told["false_success"], told["false_failure"], told["lost_on_the_way"]) == (1, 1, 1)
    assert (told["multi_pick"], told["cleared"], told["bins_emptied"]) == (1, 0.9, 1)
    assert told["by_code"] == {"SUCCESS": 3, "DROPPED": 2, "NOT_PRESENTED": 1, "NO_GRASP": 1, "ARM_REFLEX": 1}
    assert told["lost_at"] == {"before_motion": 1, "reach_or_lift": 1, "slipped": 1, "on_the_way": 1, "verdict": 1}
    assert told["picks_per_hour"] == {"simulated": pytest.approx(3600 * 4 / (5 * 11.5), abs=0.1), "wall": None}
    assert told["per_object"]["two"]["held"] == 1 and len(told["failures"]) == 6


@pytest.mark.parametrize(
    "geom",
    ["sphere' size='.03", "ellipsoid' size='.01 .02 .03", "capsule' size='.01 .03", "cylinder' size='.02 .03",
     "box' size='.01 .02 .03"],
)  # fmt: skip
def test_the_oracle_takes_every_primitive_in_its_size(geom: str) -> None:
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><body><geom type='{geom}'/></body></worldbody></mujoco>"
    )
    points = corners(model, 0)
    np.testing.assert_allclose(np.abs(points).max(axis=0), model.geom_aabb[0, 3:], rtol=1e-6)
    assert points.mean(axis=0) == pytest.approx(0.0, abs=1e-9)


def test_what_was_held_is_feasible_and_what_was_not_is_asked_of_the_oracle() -> None:
    station = load_station()
    pose = np.eye(4)
    pose[:3, 3] = 0.45, 0.0, 0.02
    brick = Thing("brick", (box_corners(np.array([0.05, 0.08, 0.04]), np.zeros(3)),))
    away = Thing("in the tray", brick.parts)
    there = np.array([pose, pose + np.array([[0, 0, 0, 0], [0, 0, 0, 0.45], [0, 0, 0, 0], [0, 0, 0, 0]])])
    scene = scene_of(station, [brick, away], there, seed=1)
    assert scene.names == ("brick",) and {part.body for part in scene.parts} == {-1, 0}
    missed = attempt_of(Window(99.0, result=result("FAILED", Code.NO_GRASP)))
    for asked in (Pick("brick", 1, [HELD], None), Pick("brick", 1, [missed], scene)):
        judge(asked)
        assert asked.feasible


@pytest.mark.thorough
def test_picks_of_the_whole_cell_are_judged_by_physics_a_network_s_beside_ours(
    tmp_path: Path, new_endpoint: Callable[[], str]
) -> None:
    from tests.perception.small_networks import gradients  # noqa: PLC0415  it needs onnx, and skips this test without

    network, lines = f"onnx:{gradients(tmp_path / 'n.onnx')}", list[str]()
    once = ("verify.hold_s=0.5", "retry.looks=0", "retry.grasps=0")
    told = beside(Wanted(None, range(1), new_endpoint(), first=1, detector=network, overrides=once), lines.append)
    ours, peer = told["ours"], told["peer"]
    assert (ours["picks"], ours["held_by_physics"], ours["verdict_success"]) == (1, 1, 1)
    assert ours["per_object"]["bottle"]["feasible"] == 1 and ours["failures"] == []
    assert ours["cycle_s"]["hold"] == pytest.approx(0.5, abs=0.1) and ours["cycle_s"]["motion"] > 3
    assert told["detector"] == network and peer["picks"] == 1 and set(peer["per_object"]) == {"bottle"}
    assert [line.split(":")[0] for line in lines] == ["vlad", "onnx"]


@pytest.mark.thorough
def test_a_bin_is_emptied_and_nothing_is_held_by_slippery_fingers(new_endpoint: Callable[[], str]) -> None:
    told = run(Wanted(None, range(1), new_endpoint(), bin=2), lambda line: None)
    assert (told["held_by_physics"], told["cleared"], told["bins_emptied"]) == (2, 1.0, 1)
    slippery = Wanted(None, range(1), new_endpoint(), first=2, overrides=("sim.friction=0.0",))
    told = run(slippery, lambda line: None)
    assert (told["picks"], told["held_by_physics"], told["false_success"]) == (2, 0, 0)
    assert told["missed"] == told["executed"] >= 2

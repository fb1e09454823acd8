"""What a person points at in a picture is the thing that they meant, or is refused; pictures of now."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import Refused
from bus.messages import (
    ArmMode,
    ArmState,
    CycleResult,
    Execution,
    HandState,
    Instance,
    Job,
    ObservedScene,
    SeenTable,
    StageRecord,
    Target,
    Verdict,
    View,
)
from cell.daemon.pointed import Pointed

FIRST_NS, SECOND_NS, LIVE_NS = 10, 20, 30
TOPS_M = {1: (0.5, 0.0, 0.06), 2: (0.4, 0.2, 0.1)}


def record(stage: Any, result: Any) -> StageRecord[Any]:
    return StageRecord[Any](cycle_id="c", stage=stage, started_ns=0, duration_s=0.1, result=result, failure=None)


def ended(result: Any) -> CycleResult:
    code = None if result == "SUCCESS" else Code.GRASP_MISSED
    return CycleResult(
        cycle_id="c", object="", result=result, code=code, reason="", stages={}, wall_s=1.0, recording=""
    )


def view(stamp_ns: int, why: str = "") -> StageRecord[Any]:
    rest = np.zeros(7)
    arm = ArmState(stamp_ns=1, q_rad=rest, dq_rad_s=rest, tau_ext_nm=rest, mode=ArmMode.IDLE)
    return record("capture", View(stamp_ns=stamp_ns, arm=arm, base_from_color=np.eye(4), why=why))


def scene(shown: int = 0) -> ObservedScene:
    """Thing 1 is left, thing 2 right."""
    labels = np.zeros((100, 200), np.uint8)
    labels[40:60, 20:60], labels[40:60, 140:180] = 1, 2
    things = tuple(
        Instance(number=n, top_m=np.array(top), size_m=np.full(3, 0.05), in_view=True, depth_share=1.0)
        for n, top in TOPS_M.items()
    )
    table = SeenTable(base_from_table=np.eye(4), offset_m=0.0, tilt_rad=0.0)
    unseen = np.zeros((100, 200), bool)
    return ObservedScene(table=table, region_seen=1.0, instances=things, labels=labels, unseen=unseen, shown=shown)


@pytest.fixture
def pointed() -> Pointed:
    """A cell that has looked from its capture pose, and found two things."""
    pointed = Pointed()
    pointed.hear(view(FIRST_NS))
    pointed.hear(scene())
    return pointed


def at(picture_ns: int | None, pixel: tuple[float, float] = (150.0, 50.0)) -> Job:
    return Job(target=Target(pixel=pixel, picture_ns=picture_ns))


def refusal(pointed: Pointed, job: Job) -> str:
    with pytest.raises(Refused) as refused:
        pointed.resolved(job)
    return refused.value.code


@pytest.mark.parametrize("job", [Job(), Job(target=Target(text="the cup")), at(None)])
def test_what_names_no_picture_is_left_to_the_next_look(pointed: Pointed, job: Job) -> None:
    assert pointed.resolved(job) is job


def test_a_click_in_the_last_picture_from_the_capture_pose_counts_as_it_is(pointed: Pointed) -> None:
    assert pointed.resolved(at(FIRST_NS)) == at(FIRST_NS)


def test_a_click_in_a_picture_before_the_last_one_is_refused(pointed: Pointed) -> None:
    pointed.hear(view(SECOND_NS))
    pointed.hear(scene())
    assert refusal(pointed, at(FIRST_NS)) == "PICTURE_OUTDATED"
    assert refusal(Pointed(), at(FIRST_NS)) == "PICTURE_OUTDATED"


def test_a_click_in_a_further_look_is_carried_to_the_thing_that_is_there(pointed: Pointed) -> None:
    pointed.hear(view(FIRST_NS))
    pointed.hear(view(SECOND_NS, why="the best grasp is weak"))
    pointed.hear(scene(shown=1))
    assert pointed.resolved(at(SECOND_NS)).target == Target(point_m=TOPS_M[2])
    around = Job(target=Target(box=(10.0, 30.0, 70.0, 70.0), picture_ns=SECOND_NS))
    assert pointed.resolved(around).target == Target(point_m=TOPS_M[1])
    both = Job(target=Target(box=(0.0, 0.0, 199.0, 99.0), picture_ns=SECOND_NS))
    assert refusal(pointed, both) == "PICTURE_ELSEWHERE"
    assert refusal(pointed, at(SECOND_NS, (100.0, 0.0))) == "PICTURE_ELSEWHERE", "nothing is there"


def test_a_picture_of_now_counts_where_it_shows_what_the_cell_will_see(pointed: Pointed) -> None:
    assert pointed.show_live(LIVE_NS, is_from_capture_pose=True) == (FIRST_NS, ())
    assert pointed.show_live(LIVE_NS + 1, is_from_capture_pose=False) == (0, ())
    assert pointed.resolved(at(LIVE_NS)) == at(LIVE_NS)
    assert refusal(pointed, at(LIVE_NS + 1)) == "PICTURE_ELSEWHERE"
    pointed.hear(scene())
    assert refusal(pointed, at(LIVE_NS)) == "PICTURE_OUTDATED", "the cell has looked since"


def test_what_is_being_picked_cannot_be_chosen_again_until_that_has_failed(pointed: Pointed) -> None:
    pointed.choose(2)
    assert refusal(pointed, at(FIRST_NS)) == "ALREADY_CHOSEN"
    assert pointed.resolved(at(FIRST_NS, (40.0, 50.0))), "the other one can"
    assert pointed.show_live(LIVE_NS, is_from_capture_pose=True) == (FIRST_NS, (2,)), "it is not there any more"
    pointed.hear(ended("FAILED"))
    assert pointed.resolved(at(FIRST_NS)) == at(FIRST_NS)
    assert pointed.show_live(LIVE_NS, is_from_capture_pose=True) == (FIRST_NS, ())


@pytest.mark.parametrize("result", ["FAILED", "ABORTED"])
@pytest.mark.parametrize("is_known", [True, False])
def test_where_the_fingers_closed_in_vain_nothing_is_known_until_the_next_look(
    pointed: Pointed, result: Any, is_known: bool
) -> None:
    pointed.choose(2)
    closed = HandState(stamp_ns=1, width_m=0.03, is_moving=False, is_homed=True)
    execution = Execution(runs=(), grasped=closed, stopped_in="carry", after=None)
    pointed.hear(record("execute", execution if is_known else None))
    pointed.hear(ended(result))
    assert pointed.show_live(LIVE_NS, is_from_capture_pose=True) == (0, ())
    pointed.hear(view(SECOND_NS))
    pointed.hear(scene())
    assert pointed.show_live(LIVE_NS, is_from_capture_pose=True) == (SECOND_NS, ())


def test_what_was_picked_is_gone_with_all_that_left_with_it(pointed: Pointed) -> None:
    pointed.choose(2)
    verdict = Verdict(held=True, code=None, reason="", hold_s=1, width_min_m=0.03, load_n=1, cleared_fraction=1,
                      also_gone=(1,))  # fmt: skip
    pointed.hear(record("verify", verdict))
    pointed.hear(ended("SUCCESS"))
    assert pointed.show_live(LIVE_NS, is_from_capture_pose=True) == (FIRST_NS, (1, 2))


def test_what_touched_the_thing_that_was_picked_may_have_been_a_part_of_it(pointed: Pointed) -> None:
    labels = scene().labels.copy()
    labels[40:60, 61:80] = 3  # 1 px beside thing 1
    pointed.hear(scene().model_copy(update={"labels": labels}))
    pointed.choose(1)
    pointed.hear(ended("SUCCESS"))
    assert pointed.show_live(LIVE_NS, is_from_capture_pose=True) == (FIRST_NS, (1, 3))

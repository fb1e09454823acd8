"""``vlad_cell.read_cycle``: a recording as numpy, an older one too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vlad_cell import Cycle, RecordingError, detect, read_cycle

GOLDEN = Path(__file__).parents[1] / "golden"


@pytest.fixture(scope="module")
def cycle() -> Cycle:
    return read_cycle(GOLDEN / "cycle-schema4.mcap")


def test_how_it_ended_is_there_without_its_pictures(cycle: Cycle) -> None:
    assert (cycle.result, cycle.code) == ("SUCCESS", None) and "Held" in cycle.reason
    assert list(cycle.took_s)[:3] == ["capture", "detect", "plan"]
    told = cycle.record.result
    assert told is not None and told.cycle_id == cycle.cycle_id
    same = ("cycle_id", "result", "reason", "advice")
    assert [getattr(cycle, name) for name in same] == [getattr(told, name) for name in same], "one name for one fact"
    assert cycle.chosen is not None and cycle.grasps[cycle.chosen].width_m < 0.08
    assert "_whole" not in vars(cycle) and "_pictured" not in vars(cycle)


def test_in_a_notebook_each_is_one_line_and_nothing_is_decoded_for_it() -> None:
    cycle = read_cycle(GOLDEN / "cycle-schema4.mcap")
    assert repr(cycle) == "Cycle 20261129T112355162, SUCCESS spatula, 4 grasps"
    assert set(vars(cycle)) == {"path", "record"}, "nothing was decoded"
    (look,) = cycle.looks
    told = [repr(one) for one in (look, cycle.joints, cycle.hand, cycle.grasps[0], cycle.detections)]
    words = ["Look of 640 x 360 px", "JointTrack: 7 joints", "HandTrack: ", "Grasp of thing 1", "Detections: "]
    assert [line for line, word in zip(told, words, strict=True) if not line.startswith(word)] == []
    assert max(map(len, told)) < 120 and "\n" not in "".join(told)


def test_every_look_is_a_color_image_with_depth_in_its_pixels(cycle: Cycle) -> None:
    (look,) = cycle.looks
    height, width = look.color.shape[:2]
    assert look.color.dtype == np.uint8 and look.depth_m.shape == (height, width)
    assert 0.3 < np.nanmedian(look.depth_m) < 1.0
    assert look.K.shape == (3, 3) and look.base_from_camera.shape == (4, 4) and look.why == ""
    assert cycle.after is not None and cycle.after.stamp_ns > look.stamp_ns
    assert cycle.color is look.color


def test_the_arm_and_the_hand_are_arrays_over_time(cycle: Cycle) -> None:
    joints, hand = cycle.joints, cycle.hand
    assert joints.q_rad.shape == joints.dq_rad_s.shape == joints.tau_ext_nm.shape == (len(joints.time_s), 7)
    assert (np.diff(joints.time_s) >= 0).all() and joints.time_s[-1] > 3
    chosen = cycle.grasps[cycle.chosen or 0]
    assert hand.width_m.min() == pytest.approx(chosen.width_m, abs=0.006)


def test_what_it_saw_is_detected_again(cycle: Cycle) -> None:
    found = detect(cycle.color, cycle.depth_m, cycle.K, cycle.base_from_camera, config=cycle.station)
    away_m = found.grasps[0].base_from_grasp[:3, 3] - cycle.grasps[0].base_from_grasp[:3, 3]
    assert np.linalg.norm(away_m) < 0.02


def test_its_picture_shows_the_grasps(cycle: Cycle) -> None:
    assert cycle.picture().rgb.shape == cycle.color.shape
    assert cycle.picture(close_up=True).rgb.shape < cycle.color.shape
    assert cycle.detections.goal_image.shape == cycle.color.shape


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="There is no recording"):
        read_cycle(tmp_path / "gone.mcap")

"""The judge of `benchmarks scenes` on boxes whose grasps anyone can judge; its oracle, lifts and cached scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.heaps.clipping import half_spaces, moved
from benchmarks.heaps.figures import Row, figures
from benchmarks.heaps.heap import FIXED, Heap, Part, load, make, path_of, save
from benchmarks.heaps.judge import Judge
from benchmarks.heaps.lift import lift
from benchmarks.heaps.oracle import search
from benchmarks.heaps.run import evaluate
from benchmarks.heaps.shapes import box, box_corners
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Grasp, Observation
from bus.transforms import apply, from_rotation
from config.devices import HandSettings
from config.franka_hand import FINGER_TIP_M
from config.schema import Station

Array = npt.NDArray[np.float64]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]

ONE: Box = ((0.05, 0.04, 0.03), (0.40, 0.0, 0.015))
"""50 mm along x, 40 mm along y, 30 mm high, on the table."""
TOUCHING: Box = ((0.05, 0.04, 0.03), (0.45, 0.0, 0.015))
NARROW_PAIR: tuple[Box, Box] = (((0.03, 0.04, 0.03), (0.40, 0.0, 0.015)), ((0.03, 0.04, 0.03), (0.43, 0.0, 0.015)))
BESIDE: Box = ((0.03, 0.03, 0.03), (0.40, 0.04, 0.015))
TALL_BESIDE: Box = ((0.03, 0.03, 0.09), (0.40, 0.075, 0.045))
LEANING = from_rotation(Rotation.from_euler("xyz", [3, -2, 20], degrees=True).as_matrix(), (0.02, 0.01, -0.008))


@dataclass(frozen=True)
class Only:
    """Stands for what a detector returns."""

    grasps: tuple[Grasp, ...]


def _parts(*boxes: Box) -> tuple[Part, ...]:
    return tuple(Part(box_corners(np.array(size), np.array(at)), body) for body, (size, at) in enumerate(boxes))


def _grasp(x_m: float, y_m: float, heading_deg: float, tip_m: float = 0.01, lean_deg: float = 0.0) -> Array:
    """From above, leaning about the closing axis."""
    turn = Rotation.from_euler("z", heading_deg - 90, degrees=True) * Rotation.from_euler("x", 180, degrees=True)
    leaning = turn * Rotation.from_euler("y", lean_deg, degrees=True)
    tip = np.array([x_m, y_m, tip_m])
    return from_rotation(leaning.as_matrix(), tip - FINGER_TIP_M * leaning.apply([0.0, 0.0, 1.0]))


CASES = [
    ("square", (ONE,), _grasp(0.40, 0.0, 90), 0.06, "true", 0.040),
    ("square, the other way", (ONE,), _grasp(0.40, 0.0, 0), 0.08, "true", 0.050),
    ("leaning by 5 degrees along the face", (ONE,), _grasp(0.40, 0.0, 90, lean_deg=5), 0.06, "true", 0.040),
    ("turned by 40 degrees", (ONE,), _grasp(0.40, 0.0, 130), 0.08, "slips", None),
    ("over the edge of two that touch", (ONE, TOUCHING), _grasp(0.425, 0.0, 90), 0.06, "seam", 0.040),
    ("both ends of two that touch", NARROW_PAIR,
     _grasp(0.415, 0.0, 0), 0.08, "seam", 0.060),
    ("a finger in the neighbour", (ONE, BESIDE), _grasp(0.40, 0.0, 90), 0.06, "collides", None),
    ("past the neighbour", (ONE, BESIDE), _grasp(0.40, 0.0, 0), 0.08, "true", 0.050),
    ("the palm on a tall neighbour", (ONE, TALL_BESIDE), _grasp(0.40, 0.0, 90), 0.06, "collides", None),
    ("beside the palm", (ONE, TALL_BESIDE), _grasp(0.40, 0.0, 0), 0.08, "true", 0.050),
    ("into the table", (ONE,), _grasp(0.40, 0.0, 90, tip_m=0.0), 0.06, "collides", None),
    ("a finger on the object", (ONE,), _grasp(0.40, 0.0, 90), 0.038, "collides", None),
    ("above it", (ONE,), _grasp(0.40, 0.0, 90, tip_m=0.031), 0.06, "nothing", None),
    ("beside it", (ONE,), _grasp(0.50, 0.0, 90), 0.06, "nothing", None),
    ("12 mm off the middle", (ONE,), _grasp(0.40, 0.012, 90), 0.08, "off", 0.040),
    ("by its last millimetre", (ONE,), _grasp(0.40, 0.0, 90, tip_m=0.029), 0.06, "true", 0.040),
    ("by a corner's tip", (ONE,), _grasp(0.4345, 0.0, 90), 0.06, "true", 0.040),
    ("wider than the jaw", (((0.05, 0.081, 0.03), (0.40, 0.0, 0.015)),), _grasp(0.40, 0.0, 90), 0.09, "collides", None),
]  # fmt: skip


@pytest.mark.parametrize(("boxes", "grasp", "opening_m", "verdict", "width_m"), [case[1:] for case in CASES],
                         ids=[case[0] for case in CASES])  # fmt: skip
def test_boxes_are_judged_as_anyone_would(
    boxes: tuple[Box, ...], grasp: Array, opening_m: float, verdict: str, width_m: float | None
) -> None:
    judged = Judge(_parts(*boxes), np.eye(4), HandSettings()).judge(grasp, opening_m)
    assert judged.name == verdict, judged
    if width_m is not None:
        assert judged.width_m == pytest.approx(width_m, abs=2e-4)


@pytest.mark.parametrize(("boxes", "grasp", "opening_m", "verdict", "width_m"), [case[1:] for case in CASES],
                         ids=[case[0] for case in CASES])  # fmt: skip
def test_the_verdict_is_the_same_where_table_and_all_on_it_are_moved(
    boxes: tuple[Box, ...], grasp: Array, opening_m: float, verdict: str, width_m: float | None
) -> None:
    parts = [replace(part, corners=apply(LEANING, part.corners)) for part in _parts(*boxes)]
    assert Judge(parts, LEANING, HandSettings()).judge(LEANING @ grasp, opening_m).name == verdict


def test_a_wall_between_the_pads_is_a_collision() -> None:
    wall = replace(_parts(ONE)[0], body=FIXED)
    assert Judge([wall], np.eye(4), HandSettings()).judge(_grasp(0.40, 0.0, 90), 0.06).name == "collides"


def test_a_wedge_slips_out_though_its_outline_is_square() -> None:
    flanks = np.array(
        [[x, y, z] for x in (-0.025, 0.025) for y, z in ((-0.03, 0), (0.03, 0), (-0.005, 0.03), (0.005, 0.03))]
    )
    wedge = Part(flanks + 0.40 * np.eye(3)[0], 0)
    assert Judge([wedge], np.eye(4), HandSettings()).judge(_grasp(0.40, 0.0, 90), 0.07).name == "slips"
    assert Judge([wedge], np.eye(4), HandSettings()).judge(_grasp(0.40, 0.0, 0), 0.07).name == "true"


def test_lines_are_clipped_exactly() -> None:
    corners = box_corners(np.array([0.05, 0.04, 0.03]), np.zeros(3))
    turned = from_rotation(Rotation.from_euler("z", 45, degrees=True).as_matrix())
    solid = moved(half_spaces(corners), corners, turned)
    chords = solid.clip(np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.0, 0.0151]]), 1)
    assert len(solid.offsets) == 6
    np.testing.assert_allclose(chords.leave[:2], [0.02 * 2**0.5, 0.025 * 2**0.5 - 0.01], atol=1e-9)
    np.testing.assert_allclose(chords.entry[0], -0.02 * 2**0.5, atol=1e-9)
    assert np.isinf(chords.entry[2:]).all()


# --- oracle, lifts, scenes --------------------------------------------------------------------------------------------


def _heap(*boxes: Box) -> Heap:
    """A scene on a leaning table, with nothing in its picture."""
    moved_parts = tuple(replace(part, corners=apply(LEANING, part.corners)) for part in _parts(*boxes))
    blank = np.zeros((720, 1280, 3), np.uint8), np.full((576, 640), np.nan, np.float32)
    pose = np.eye(4)
    return Heap(len(boxes), 0, "table", "", ("box",) * len(boxes), *blank, pose, pose, LEANING, moved_parts)


def test_the_oracle_finds_a_grasp_that_the_judge_confirms_and_physics_lifts() -> None:
    heap = _heap(ONE, TOUCHING)
    found = search(heap)
    assert found.base_from_tcp is not None
    assert Judge.of(heap).judge(found.base_from_tcp, found.opening_m).name == "true"
    done = lift(heap, found.base_from_tcp, found.opening_m)
    assert not done.touched and not done.unstable and len(done.held) == 1


@pytest.mark.parametrize("anywhere", [2000, pytest.param(20_000, marks=pytest.mark.thorough)])
def test_the_oracle_finds_none_on_what_no_jaw_takes(anywhere: int) -> None:
    wide = _heap(((0.10, 0.10, 0.03), (0.40, 0.0, 0.015)))
    found = search(wide, rounds=1, anywhere=anywhere)
    assert found.base_from_tcp is None and found.judged > 0


def test_physics_loses_what_stands_beside_the_jaw_and_feels_what_is_under_a_finger() -> None:
    heap = _heap(ONE, BESIDE)
    assert lift(heap, LEANING @ _grasp(0.50, 0.0, 90), 0.06).held == ()
    assert lift(heap, LEANING @ _grasp(0.40, 0.0, 90), 0.06).touched


def test_a_scene_is_the_same_from_its_seed_and_from_its_file(tmp_path: Path) -> None:
    shapes = (box("slab", (0.09, 0.05, 0.02)), box("post", (0.03, 0.03, 0.08)))
    heap, again = make(2, 3, shapes), make(2, 3, shapes)
    save(heap, tmp_path)
    kept = load(path_of(tmp_path, 2, 3))
    for other in (again, kept):
        assert np.array_equal(heap.color, other.color)
        assert np.array_equal(heap.depth_m, other.depth_m, equal_nan=True)
        assert all(np.array_equal(one.corners, two.corners) for one, two in zip(heap.parts, other.parts, strict=True))
        assert (heap.kind, heap.names) == (other.kind, other.names) == ("bin", heap.names)
    assert not np.allclose(heap.base_from_color, heap.true_base_from_color, atol=1e-4)


def test_refusals_and_verdicts_are_counted_by_number_of_objects() -> None:
    heap = replace(_heap(ONE), feasible=True)
    grasp = Grasp(
        base_from_tcp=LEANING @ _grasp(0.40, 0.0, 90), width_m=0.04, opening_m=0.06, score=1.0, rectangle=0,
        imagined_base_from_tcp=np.eye(4), terms={},
    )  # fmt: skip

    def refuse(_observations: Sequence[Observation], _station: Station) -> Only:
        raise CycleFailure(Code.NO_GRASP, "Nothing.")

    rows: list[Row] = [*evaluate([heap], lambda *_: Only((grasp,))), *evaluate([heap], refuse)]
    counted = figures(rows)["1"]
    assert (counted["true_grasp"], counted["refused"], counted["refused_feasible"]) == (0.5, 0.5, 0.5)
    assert counted["refused_by_code"] == {"NO_GRASP": 1}

"""`benchmarks scenes` with several views: sides of the judge and the oracle, cached views, sets, and looking again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.heaps import oracle, sides
from benchmarks.heaps.figures import figures
from benchmarks.heaps.heap import FIXED, Heap, Look, Part, load, make, path_of, save
from benchmarks.heaps.judge import Judge
from benchmarks.heaps.lift import lift
from benchmarks.heaps.plan import BOWLS, BOXES, SETS, TALL, plan
from benchmarks.heaps.run import LOOKS, evaluate_one
from benchmarks.heaps.shapes import box_corners
from benchmarks.heaps.things import thing
from benchmarks.heaps.viewpoints import viewpoints
from benchmarks.heaps.views import with_views
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Grasp, Observation
from bus.transforms import apply, from_rotation, inverse
from config.devices import HandSettings
from config.franka_hand import FINGER_TIP_M
from config.schema import Station

Array = npt.NDArray[np.float64]
Box = tuple[tuple[float, float, float], tuple[float, float, float]]

POST: Box = ((0.05, 0.04, 0.20), (0.45, 0.0, 0.10))
"""50 mm along x, 40 mm along y, 200 mm high."""
ROOF: Box = ((0.12, 0.12, 0.02), (0.45, 0.0, 0.21))
BEFORE_IT: Box = ((0.03, 0.40, 0.16), (0.30, 0.0, 0.08))
LEANING = from_rotation(Rotation.from_euler("xyz", [3, -2, 20], degrees=True).as_matrix(), (0.02, 0.01, -0.008))
TOWARDS_X = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""A hand that comes along x with its fingers side by side: tcp z = base x, tcp y = base y."""


def _parts(*boxes: Box) -> list[Part]:
    return [Part(box_corners(np.array(size), np.array(at)), body) for body, (size, at) in enumerate(boxes)]


def _from_side(height_m: float, dip_deg: float = 0.0, tip_x_m: float = 0.46) -> Array:
    """Level from the base's side, or dipping; the tips at that height."""
    turn = Rotation.from_euler("y", dip_deg, degrees=True).as_matrix() @ TOWARDS_X
    return from_rotation(turn, np.array([tip_x_m, 0.0, height_m]) - FINGER_TIP_M * turn[:, 2])


SIDES = [
    ("level", (POST,), _from_side(0.12), "true", ""),
    ("dipping by 30 degrees", (POST,), _from_side(0.12, 30, 0.44), "true", ""),
    ("with the hand in the table", (POST,), _from_side(0.02), "collides", "palm in the table"),
    ("up out of the table", (POST,), _from_side(0.12, -30), "collides", "in the table"),
    ("over something lower", (POST, BEFORE_IT), _from_side(0.195), "true", ""),
    ("through something in the way", (POST, BEFORE_IT), _from_side(0.12), "collides", "body 1"),
    ("under a roof", (POST, ROOF), _from_side(0.12), "true", ""),
    ("from above onto a roof", (POST, ROOF), _from_side(0.19, 90, 0.45), "collides", "body 1"),
    ("deeper than the fingers are long", (POST,), _from_side(0.12, 0, 0.48), "collides", "palm in body 0"),
    ("too high", (POST,), _from_side(0.25), "nothing", ""),
]


@pytest.mark.parametrize(("boxes", "grasp", "verdict", "why"), [case[1:] for case in SIDES],
                         ids=[case[0] for case in SIDES])  # fmt: skip
@pytest.mark.parametrize("base_from_table", [np.eye(4), LEANING], ids=["level table", "leaning table"])
def test_a_grasp_from_the_side_is_judged_along_its_own_approach(
    boxes: tuple[Box, ...], grasp: Array, verdict: str, why: str, base_from_table: Array
) -> None:
    parts = [replace(part, corners=apply(base_from_table, part.corners)) for part in _parts(*boxes)]
    judged = Judge(parts, base_from_table, HandSettings()).judge(base_from_table @ grasp, 0.06)
    assert judged.name == verdict and why in judged.why, judged


def test_the_way_past_a_wall_is_not_free() -> None:
    wall = replace(_parts(BEFORE_IT)[0], body=FIXED)
    judged = Judge([*_parts(POST), wall], np.eye(4), HandSettings()).judge(_from_side(0.12), 0.06)
    assert (judged.name, judged.why) == ("collides", "finger in a wall")


def test_the_camera_needs_one_free_side_of_the_hand() -> None:
    above: Box = ((0.03, 0.03, 0.03), (0.25, 0.0, 0.12 + 0.065))
    below: Box = ((0.03, 0.03, 0.03), (0.25, 0.0, 0.12 - 0.065))
    for beside, verdict in (((above,), "true"), ((below,), "true"), ((above, below), "collides")):
        judged = Judge(_parts(POST, *beside), np.eye(4), HandSettings()).judge(_from_side(0.12), 0.06)
        assert judged.name == verdict, judged
    assert judged.why.startswith("camera")


# --- the oracle -------------------------------------------------------------------------------------------------------


def _heap(*boxes: Box) -> Heap:
    """One body made of all boxes on a leaning table, with nothing in its picture."""
    parts = tuple(Part(apply(LEANING, part.corners), 0) for part in _parts(*boxes))
    blank = np.zeros((720, 1280, 3), np.uint8), np.full((576, 640), np.nan, np.float32)
    return Heap(1, 0, "table", "", ("box",), *blank, np.eye(4), np.eye(4), LEANING, parts)


def test_what_has_a_stem_under_a_wide_top_is_taken_from_the_side_only() -> None:
    heap = _heap(POST, ROOF)
    assert oracle.search(heap, rounds=1, anywhere=2000).base_from_tcp is None
    found = sides.search(heap)
    assert found.base_from_tcp is not None
    assert oracle.is_robust(Judge.of(heap), found.base_from_tcp, found.opening_m)
    approach_table = LEANING[:3, :3].T @ found.base_from_tcp[:3, 2]
    assert approach_table[2] > -np.cos(np.deg2rad(25))
    done = lift(heap, found.base_from_tcp, found.opening_m)
    assert not done.touched and done.held == (0,)


def test_what_is_wider_than_the_jaw_on_every_side_is_taken_from_none() -> None:
    heap = _heap(((0.10, 0.11, 0.05), (0.45, 0.0, 0.025)))
    assert sides.search(heap, sides.directions(heap)[::4]).base_from_tcp is None


def test_a_far_thing_is_in_reach_from_the_near_side_only() -> None:
    from_here = _from_side(0.15, tip_x_m=0.66)
    half_a_turn = np.diag([-1.0, -1.0, 1.0])
    from_beyond = from_rotation(half_a_turn @ from_here[:3, :3], from_here[:3, 3])
    assert sides.in_reach("table", from_here)
    assert not sides.in_reach("table", from_beyond)


# --- views ------------------------------------------------------------------------------------------------------------


def test_viewpoints_lean_towards_the_pick_region_from_either_side_and_are_near() -> None:
    for kind in ("table", "bin"):
        left, right = viewpoints(kind)
        assert left.base_from_color[1, 3] > 0.2 and right.base_from_color[1, 3] < -0.2
        for one in (left, right):
            down = -one.base_from_color[2, 2]
            assert down == pytest.approx(np.cos(np.deg2rad(45)), abs=1e-6)
            just_above = one.base_from_color[:3, 3] + 0.70 * one.base_from_color[:3, 2]
            np.testing.assert_allclose(just_above, [0.46, 0.0, 0.03], atol=1e-6)
            assert 0.3 < one.motion_s < 2.0


def test_kept_views_are_those_rendered_and_all_share_one_error_of_the_mount(tmp_path: Path) -> None:
    heap = make(1, 3, (), TALL)
    seen, kept, again = (with_views(heap, tmp_path, cache) for cache in (tmp_path, tmp_path, None))
    assert path_of(tmp_path, 1, 3, TALL).with_suffix(".views.npz").exists()
    first, *further = seen.observations()
    assert len(further) == 2 and np.array_equal(first.frame.color, heap.color)
    nominal_from_true = inverse(heap.base_from_color) @ heap.true_base_from_color
    for other in (kept, again):
        for one, two in zip(seen.further, other.further, strict=True):
            assert np.array_equal(one.color, two.color) and one.motion_s == two.motion_s
            assert np.array_equal(one.depth_m, two.depth_m, equal_nan=True)
            assert np.array_equal(one.base_from_color, two.base_from_color)
    for observation, look in zip(further, seen.further, strict=True):
        assert np.array_equal(observation.view.base_from_color, look.base_from_color)
        np.testing.assert_allclose(inverse(look.base_from_color) @ look.true_base_from_color, nominal_from_true)
        assert np.isfinite(look.depth_m).mean() > 0.3
    assert np.linalg.norm(nominal_from_true[:3, 3]) == pytest.approx(0.001)


# --- sets -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("set_name", [TALL, BOWLS, BOXES])
def test_a_thing_of_a_set_is_the_same_from_its_seed_and_from_its_file(set_name: str, tmp_path: Path) -> None:
    heap, again = make(1, 5, (), set_name), make(1, 5, (), set_name)
    save(heap, tmp_path)
    kept = load(path_of(tmp_path, 1, 5, set_name))
    for other in (again, kept):
        assert np.array_equal(heap.color, other.color) and heap.names == other.names
        assert (other.kind, other.set_name) == ("table", set_name)
        assert all(np.array_equal(one.corners, two.corners) for one, two in zip(heap.parts, other.parts, strict=True))
    lowest_m = min(apply(inverse(heap.base_from_table), part.corners)[:, 2].min() for part in heap.parts)
    assert abs(lowest_m) < 0.002


def test_sets_hold_what_they_are_named_for() -> None:
    sizes: dict[str, list[Array]] = {name: [] for name in SETS}
    for set_name in (TALL, BOWLS, BOXES):
        for seed in range(30):
            shape = thing(plan(1, seed, set_name))
            sizes[set_name].append(np.ptp(np.concatenate(shape.parts), axis=0))
            assert 200 < shape.density_kg_m3 < 2500
    tall, bowls, boxes = (np.array(sizes[name]) for name in (TALL, BOWLS, BOXES))
    standing = tall[:, 2] > 0.15
    assert 15 < standing.sum() < 30 and (tall.max(axis=1) > 0.18).all() and (tall.max(axis=1) <= 0.22).all()
    assert (np.sort(tall, axis=1)[:, 0] <= 0.075).all()
    assert (bowls[:, 0] > 0.099).all() and (bowls[:, 0] <= 0.25).all() and (bowls[:, 2] < 0.095).all()
    assert (boxes[:, 0] >= 0.09).all() and (boxes[:, 0] <= 0.12).all()
    assert (boxes[:, 2] >= 0.03).all() and (boxes[:, 2] <= 0.07).all()
    assert len({tuple(size) for size in boxes}) == 30


# --- looking again ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Only:
    """Stands for what a detector returns."""

    grasps: tuple[Grasp, ...]


def _twice_seen(heap: Heap) -> Heap:
    look = Look(np.zeros(7), 0.5, heap.color, heap.depth_m, np.eye(4), np.eye(4))
    return replace(heap, further=(look, look))


def _needs(count: int, observations: Sequence[Observation]) -> Only:
    """A detector that finds something once it is given so many views."""
    if len(observations) < count:
        raise CycleFailure(Code.NO_GRASP, "Nothing.")
    grasp = Grasp(
        base_from_tcp=LEANING @ _from_side(0.12), width_m=0.04, opening_m=0.06, score=1.0, rectangle=0,
        imagined_base_from_tcp=np.eye(4), terms={},
    )  # fmt: skip
    return Only((grasp,))


def _while_refused(outcome: object, _looks: int, _station: Station) -> str:
    return "refused" if isinstance(outcome, CycleFailure) else ""


@pytest.mark.parametrize(
    ("views", "needed", "outcome", "seen", "extra_s"),
    [("1", 1, "true", 1, 0.0), ("1", 2, "refused", 1, 0.0), ("2", 2, "true", 2, 0.5), ("3", 1, "true", 3, 1.0),
     ("auto", 1, "true", 1, 0.0), ("auto", 2, "true", 2, 0.5), ("auto", 4, "refused", 3, 1.0)],
)  # fmt: skip
def test_views_are_taken_at_once_or_while_the_rule_asks_for_them(
    views: str, needed: int, outcome: str, seen: int, extra_s: float
) -> None:
    row = evaluate_one(
        replace(_heap(POST), feasible=True), lambda observations, _station: _needs(needed, observations),
        looks=LOOKS[views], again=_while_refused, seen=_twice_seen,
    )  # fmt: skip
    assert (row.outcome, row.views, row.extra_s) == (outcome, seen, extra_s)
    counted = figures([row])["1"]
    assert (counted["views"], counted["extra_s"]) == (seen, extra_s)

"""One scene of several looks: what is free, what is there, which look is shown, and grasps from the sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections, Observation
from bus.transforms import from_translation
from cell.pick.detect import detect
from config.load import load_station
from perception.goal.imagine import observed_object_of
from perception.grasps.closing import close
from perception.grasps.faces import across_faces
from perception.grasps.rank import facing, grasps_of_rod
from perception.grasps.search import search
from perception.models import open_models
from perception.scene.change import cleared_fraction
from perception.scene.heightmap import Grid, HeightMap, highest
from perception.scene.look import Look
from perception.scene.scene import Scene, scene_of
from perception.scene.seen import RegionView, described
from tests.perception.from_aside import ABOVE, LEFT, RIGHT, Solid, look

STATION = load_station()
BLUE = (40, 90, 200)
POST = Solid((0.46, 0.0, 0.0), (0.06, 0.06, 0.12))
LEFT_OF_IT, RIGHT_OF_IT = (0.46, 0.055), (0.46, -0.055)
"""Places 25 mm beside the post."""
WELL = (
    Solid((0.46, 0.06, 0.0), (0.14, 0.02, 0.14)),
    Solid((0.46, -0.06, 0.0), (0.14, 0.02, 0.14)),
    Solid((0.40, 0.0, 0.0), (0.02, 0.10, 0.14)),
    Solid((0.52, 0.0, 0.0), (0.02, 0.10, 0.14)),
)
"""Four walls around a place that is seen only from above."""


def _scene(solids: Sequence[Solid], *directions: tuple[float, float], noise_m: float = 0.0) -> Scene:
    return scene_of([Look.of(look(solids, one, noise_m=noise_m), STATION) for one in directions], STATION)


def _bound_m(scene: Scene, xy_m: tuple[float, float]) -> float:
    """Up to which height a place may be occupied."""
    heights = scene.heights
    return float(heights.framed.bound_m[heights.cells(np.array([xy_m[0]]), np.array([xy_m[1]]))][0])


# --- what is free -----------------------------------------------------------------------------------------------------


def test_a_place_is_free_when_any_look_sees_past_it() -> None:
    left, right, both = _scene([POST], LEFT), _scene([POST], RIGHT), _scene([POST], LEFT, RIGHT)
    assert _bound_m(left, RIGHT_OF_IT) > 0.05 and _bound_m(left, LEFT_OF_IT) < 0.01
    assert _bound_m(right, LEFT_OF_IT) > 0.05 and _bound_m(right, RIGHT_OF_IT) < 0.01
    assert _bound_m(both, RIGHT_OF_IT) < 0.01 and _bound_m(both, LEFT_OF_IT) < 0.01
    assert _bound_m(both, (0.46, 0.0)) == pytest.approx(0.12, abs=0.005), "the thing itself is not"


def test_what_all_looks_hide_may_be_occupied() -> None:
    middle = (0.46, 0.0)
    assert _bound_m(_scene(WELL, LEFT, RIGHT), middle) > 0.05
    assert _bound_m(_scene(WELL, LEFT, RIGHT, ABOVE), middle) < 0.01


def test_another_look_makes_no_place_less_free() -> None:
    """Than it was within 4 mm: so near to a wall, no look tells the wall from what is before it."""
    solids = [POST, WELL[0]]
    one, more = _scene(solids, LEFT), _scene(solids, LEFT, ABOVE)
    x, y = np.meshgrid(np.arange(0.36, 0.56, 0.006), np.arange(-0.15, 0.15, 0.006))
    before_m = one.heights.framed.around_m[one.heights.cells(x, y)]
    after_m = more.heights.framed.bound_m[more.heights.cells(x, y)]
    assert (after_m < before_m + 0.007).mean() > 0.998, "free space is measured in steps of 6 mm"


def test_the_share_of_the_region_that_was_seen_is_that_of_all_looks() -> None:
    tall = POST._replace(size_m=(0.10, 0.10, 0.14))
    shares = [RegionView.of(_scene([tall], *looks), STATION).share for looks in ((LEFT,), (RIGHT,), (LEFT, RIGHT))]
    assert shares[2] >= max(shares) and shares[2] > 0.99


# --- what is there ----------------------------------------------------------------------------------------------------


def test_a_thin_wall_keeps_both_its_faces() -> None:
    wall = Solid((0.46, 0.0, 0.0), (0.10, 0.0025, 0.06))
    points = _scene([wall], LEFT, RIGHT).cloud.points_table
    of_wall = (
        (np.abs(points[:, 0] - 0.46) < 0.045) & (np.abs(points[:, 1]) < 0.01) & (np.abs(points[:, 2] - 0.03) < 0.02)
    )
    faces = points[of_wall, 1]
    assert (faces > 0).sum() > 200 and (faces < 0).sum() > 200
    np.testing.assert_allclose(np.abs(faces), 0.00125, atol=2e-4)


def test_the_noise_of_many_looks_does_not_raise_a_flat_table() -> None:
    scene = _scene([POST], ABOVE, LEFT, RIGHT, noise_m=0.0015)
    seen_m = _table_cells_m(scene)
    unaveraged_m = _table_cells_m(scene, averaged=False)
    assert abs(seen_m.mean()) < 1e-4
    assert unaveraged_m.mean() > 2e-4, "the highest of many has the largest error"


def _table_cells_m(scene: Scene, *, averaged: bool = True) -> np.ndarray:
    """Heights of the cells around the middle where only the table is."""
    grid = Grid(np.array([0.40, 0.06]), (40, 60))
    weights = scene.cloud.weights if averaged else None
    height_m = highest(grid, scene.cloud.points_table, weights).height_m
    return np.asarray(height_m[np.isfinite(height_m)])


def test_a_cell_is_as_high_as_the_points_just_below_its_top() -> None:
    """Points of a rim and of what is below it fall into one cell; those below do not count."""
    grid = Grid(np.zeros(2), (1, 2))
    z_m = np.array([0.050, 0.048, 0.030, 0.0, 0.010], dtype=np.float32)
    points = np.column_stack([[0.0, 0.0, 0.0, 0.0, 0.002], np.zeros(5), z_m]).astype(np.float32)
    weights = np.array([1.0, 3.0, 9.0, 9.0, 2.0])
    assert highest(grid, points, weights).height_m[0] == pytest.approx([0.0485, 0.010], abs=1e-6)
    assert highest(grid, points).height_m[0] == pytest.approx([0.050, 0.010], abs=1e-6)


def test_the_same_looks_give_the_same_bits_in_the_order_of_the_cubes() -> None:
    once, again = (_scene([POST], ABOVE, LEFT, RIGHT, noise_m=0.001) for _ in range(2))
    assert again.cloud.points_table.tobytes() == once.cloud.points_table.tobytes()
    assert again.heights.bound_m.tobytes() == once.heights.bound_m.tobytes()
    cubes = np.floor(once.cloud.points_table / np.float32(0.002))
    steps = np.sign(np.diff(cubes, axis=0))
    assert (steps @ [1, 2, 4] > 0).mean() > 0.999, "by z, then y, then x; but for means on a cube's face"


def test_a_thing_has_one_number_in_all_looks() -> None:
    scene = _scene(
        [POST, POST._replace(foot_m=(0.40, 0.12, 0.0), size_m=(0.04, 0.04, 0.04), rgb=BLUE)], ABOVE, LEFT, RIGHT
    )
    assert scene.count == 2
    for seen, labels in zip(scene.looks, scene.look_labels, strict=True):
        assert set(np.unique(labels)) == {0, 1, 2}
        for number, (x, y) in ((1, (0.46, 0.0)), (2, (0.40, 0.12))):
            middle = np.nanmedian(seen.view.points_base[labels == number], axis=0)
            assert middle[:2] == pytest.approx((x, y), abs=0.035)


# --- which look is shown ----------------------------------------------------------------------------------------------


def test_the_first_look_is_shown_unless_another_shows_clearly_more() -> None:
    assert _scene([POST], ABOVE, LEFT, RIGHT).shown == 0
    out_of_sight = POST._replace(foot_m=(0.46, 0.0, 0.0), size_m=(0.06, 0.06, 0.20))
    scene = _scene([out_of_sight], ABOVE, LEFT)
    assert scene.shown == 1, "from above, it is nearer than the camera measures"
    assert scene.look is scene.looks[1] and scene.labels is scene.look_labels[1]
    seen = described(scene, RegionView.of(scene, STATION))
    assert seen.shown == 1 and len(seen.further_labels) == 1
    assert [int(labels.max()) for labels in seen.look_labels] == [0, 1]


def test_what_one_look_cuts_and_another_shows_whole_is_in_view() -> None:
    far = POST._replace(foot_m=(0.77, 0.0, 0.0), size_m=(0.10, 0.10, 0.05))
    wide = load_station(None, ["scene.pick_region_m=[0.2, 0.85, -0.2, 0.2]"])
    for directions, is_whole in (((ABOVE,), False), ((ABOVE, (30.0, 180.0)), True)):
        scene = scene_of([Look.of(look([far], one, distance_m=0.6), wide) for one in directions], wide)
        (thing,) = described(scene, RegionView.of(scene, wide)).instances
        assert thing.in_view is is_whole


# --- grasps from the sides --------------------------------------------------------------------------------------------

LID = Solid((0.46, 0.0, 0.15), (0.11, 0.11, 0.02), BLUE)
STEM = Solid((0.46, 0.0, 0.0), (0.035, 0.035, 0.15), BLUE)
"""A lid wider than the jaw, on a stem: only the stem can be held, and only from the side."""


def _detected(observations: list[Observation]) -> Detections:
    return detect(observations, STATION, open_models(STATION, {}))


def test_what_can_be_held_only_from_the_side_is_held_so() -> None:
    observations = [look([LID, STEM], one, noise_m=0.0005) for one in (ABOVE, LEFT, RIGHT)]
    with pytest.raises(CycleFailure) as from_above:
        _detected(observations[:1])
    assert from_above.value.failure in (Code.NO_GRASP, Code.NOT_SEEN)
    found = _detected(observations)
    for grasp in found.grasps:
        tilt_deg = np.degrees(np.arccos(-grasp.base_from_tcp[2, 2]))
        assert 30 < tilt_deg < 90, "from the side, and never from below"
        assert grasp.width_m == pytest.approx(0.035 * np.hypot(1, 0.2), abs=0.015)
        assert 0.01 < grasp.base_from_tcp[2, 3] < 0.15 and np.hypot(*(grasp.base_from_tcp[:2, 3] - [0.46, 0.0])) < 0.03


@pytest.mark.parametrize("leans_deg", [25.0, pytest.param(-25.0, marks=pytest.mark.thorough)])
def test_the_hand_leans_with_the_faces_that_it_closes_on(leans_deg: float) -> None:
    leaning = Solid((0.46, 0.0, 0.0), (0.012, 0.14, 0.09), leans_rad=float(np.radians(leans_deg)))
    across_faces = leaning.from_base()[0]
    (best, *_) = _detected([look([leaning], one, noise_m=0.0005) for one in (ABOVE, LEFT, RIGHT, (45.0, 0.0))]).grasps
    assert abs(best.base_from_tcp[:3, 1] @ across_faces) > np.cos(np.radians(7.0))
    assert best.width_m == pytest.approx(0.012, abs=0.006)


def test_how_high_above_its_middle_a_thing_is_held_from_the_side_does_not_count() -> None:
    scene = _scene([Solid((0.46, 0.0, 0.0), (0.03, 0.03, 0.13))], LEFT, RIGHT)
    level = facing(np.array([[0.46, -0.015, 0.06], [0.46, 0.015, 0.06]]), np.array([0.97, 0.0, -0.26]))
    heights, _ = scene.along(level, 1)
    places = heights.middles[0][1] + np.outer([0.0, 0.03], heights.up_xy)
    across_rad = np.full(2, np.arctan2(heights.up_xy[0], -heights.up_xy[1]))

    def central(of: HeightMap) -> list[float]:
        return [float(one) for one in close(of, places, across_rad, np.full(2, 0.01), STATION).terms["central"]]

    at_middle, above = central(heights)
    assert above == pytest.approx(at_middle, abs=0.05)
    at_middle, above = central(replace(heights, up_xy=np.zeros(2)))
    assert above < at_middle - 0.2, "so far beside its middle, from above, it would turn"


def test_a_thing_that_only_other_looks_show_does_not_end_the_detection_of_the_rest() -> None:
    tall, flat = Solid((0.46, 0.10, 0.0), (0.10, 0.09, 0.17)), Solid((0.46, -0.12, 0.0), (0.12, 0.07, 0.04))
    behind = Solid((0.46, 0.17, 0.0), (0.06, 0.025, 0.03), BLUE)
    observations = [look([tall, behind, flat], one, distance_m=0.72) for one in (ABOVE, LEFT, RIGHT)]
    scene = scene_of([Look.of(one, STATION) for one in observations], STATION)
    hidden = set(range(1, scene.count + 1)) - set(np.unique(scene.color_labels).tolist())
    assert hidden, "a thing stands in the shadow of another, as the shown look sees it"
    found = _detected(observations)
    assert found.grasps[0].instance not in hidden
    assert {one.code for one in found.tried if one.instance in hidden} <= {Code.NO_DEPTH}


def test_a_rods_known_approach_is_taken_and_otherwise_none_is_guessed() -> None:
    scene = _scene([LID, STEM], ABOVE, LEFT, RIGHT)
    seen = described(scene, RegionView.of(scene, STATION))
    stem, _ = observed_object_of(scene, seen.instances, 1, scene.outline(1))
    across = np.array([[0.46, -0.0175, 0.05], [0.46, 0.0175, 0.05]])
    tilt_rad = np.radians(75.0)
    approach = np.array([np.sin(tilt_rad), 0.0, -np.cos(tilt_rad)])
    assert grasps_of_rod(across, 0, stem, STATION) == [], "the lid is in the way"
    grasps = grasps_of_rod(across, 3, stem, STATION, approach)
    assert grasps
    for grasp in grasps:
        assert grasp.base_from_tcp[:3, 2] @ approach > np.cos(np.radians(1.0))
        assert abs(grasp.base_from_tcp[1, 1]) > np.cos(np.radians(25.0)), "it closes along the rod"
        assert (grasp.rectangle, grasp.instance) == (3, 1)


def test_an_approach_from_above_is_searched_from_above_and_if_nothing_is_free_leaning() -> None:
    scene = _scene([POST._replace(size_m=(0.06, 0.06, 0.05))], ABOVE)
    seen = described(scene, RegionView.of(scene, STATION))
    post, _ = observed_object_of(scene, seen.instances, 1, scene.outline(1))
    across = np.array([[0.46, -0.03, 0.03], [0.46, 0.03, 0.03]])
    down = np.array([0.0, 0.0, -1.0])
    known, unknown = grasps_of_rod(across, 0, post, STATION, down), grasps_of_rod(across, 0, post, STATION)
    assert known and [one.model_dump_json() for one in known] == [one.model_dump_json() for one in unknown]


@pytest.mark.parametrize("along", [(0.0, 1.0, 0.0), (0.2, 0.9, 0.1), (0.0, 0.1, 1.0)])
def test_a_level_faces_the_approach_as_nearly_as_its_rod_allows(along: tuple[float, float, float]) -> None:
    ends = np.array([0.4, 0.1, 0.1]) + np.outer([-0.02, 0.02], along)
    approach = np.array([np.sin(1.3), 0.0, -np.cos(1.3)])
    pose = facing(ends, approach)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
    unit = np.array(along) / np.linalg.norm(along)
    assert pose[:3, 0] @ unit == pytest.approx(1)
    assert -approach @ pose[:3, 2] == pytest.approx(np.sqrt(1 - (approach @ unit) ** 2))


def test_a_thing_from_the_side_is_one_piece_whose_far_end_is_the_floor() -> None:
    scene = _scene([LID, STEM], ABOVE, LEFT, RIGHT)
    level = facing(np.array([[0.46, -0.02, 0.05], [0.46, 0.02, 0.05]]), np.array([0.97, 0.0, -0.26]))
    heights, base_from_level = scene.along(level, 1)
    np.testing.assert_array_equal(heights.labels, heights.pieces)
    ours = heights.surface_m[heights.labels == 1]
    assert ours.min() >= -0.003 and 0.10 < ours.max() < 0.16, "as deep as the lid is long"
    np.testing.assert_allclose(base_from_level[:3, :3], level[:3, :3])


# --- what failed before -------------------------------------------------------------------------------------------


def test_a_thing_where_a_pick_failed_is_no_target_and_when_no_other_is_left_that_is_said() -> None:
    left, right = ((0.46, 0.08), (0.46, -0.08))
    observation = look([Solid((*place, 0.0), (0.05, 0.05, 0.04)) for place in (left, right)])
    models = open_models(STATION, {})
    for failed, other in ((left, right), (right, left)):
        failed_at = np.array([failed[0] + 0.03, failed[1], 0.03])
        for grasp in detect([observation], STATION, models, failed_at=[failed_at]).grasps:
            assert np.hypot(*(grasp.base_from_tcp[:2, 3] - other)) < 0.03
    everywhere = [np.array([*place, 0.03]) for place in (left, right)]
    with pytest.raises(CycleFailure, match=r"x, y = \(0.46, 0.08\), \(0.46, -0.08\) m") as over:
        detect([observation], STATION, models, failed_at=everywhere)
    assert over.value.failure is Code.LEFT_OVER
    beside = [np.array([0.46, 0.0, 0.03]), np.array([2.0, -3.0, 0.0])]
    assert len({grasp.instance for grasp in detect([observation], STATION, models, failed_at=beside).grasps}) == 2


# --- what left its place ----------------------------------------------------------------------------------------------

LYING = Solid((0.46, 0.0, 0.03), (0.20, 0.03, 0.02), BLUE)
UNDER_IT = Solid((0.46, 0.0, 0.0), (0.16, 0.12, 0.03))


def test_what_lay_on_another_thing_has_left_its_place_when_that_is_seen_instead() -> None:
    station = load_station(None, ["perception.target.pixel=[160,144]"])
    before, without = (look(solids, noise_m=0.0005) for solids in ([UNDER_IT, LYING], [UNDER_IT]))
    found = detect([before], station, open_models(station, {}))
    assert cleared_fraction(found, found.grasps[0].instance, before, before, station) == pytest.approx(0.0, abs=0.1)
    assert cleared_fraction(found, found.grasps[0].instance, before, without, station) == pytest.approx(1.0, abs=0.05)
    pushed = LYING._replace(foot_m=(0.46, 0.02, 0.03))
    share = cleared_fraction(found, found.grasps[0].instance, before, look([UNDER_IT, pushed], noise_m=0.0005), station)
    assert share is not None and 0.4 < share < 0.9, "pushed aside"


def test_the_place_is_that_of_the_thing_that_was_grasped_and_not_of_the_best_proposal() -> None:
    first, second = (Solid((0.46, y, 0.0), (0.05, 0.05, 0.04)) for y in (0.08, -0.08))
    before, after = look([first, second]), look([first])
    found = detect([before], STATION, open_models(STATION, {}))
    taken = {bool(grasp.base_from_tcp[1, 3] < 0): grasp.instance for grasp in found.grasps}
    assert cleared_fraction(found, taken[True], before, after, STATION) == pytest.approx(1.0, abs=0.05)
    assert cleared_fraction(found, taken[False], before, after, STATION) == pytest.approx(0.0, abs=0.1)


def test_of_a_place_behind_something_that_hides_it_nothing_is_said() -> None:
    station = load_station()
    before, hidden = look([LYING._replace(foot_m=(0.46, 0.0, 0.0))]), look([Solid((0.46, 0.0, 0.25), (0.3, 0.3, 0.02))])
    found = detect([before], station, open_models(station, {}))
    assert cleared_fraction(found, found.grasps[0].instance, before, hidden, station) is None


# --- the mounting -----------------------------------------------------------------------------------------------------


def test_all_that_was_seen_follows_the_base_it_is_seen_in() -> None:
    shift = from_translation((0.02, -0.01, 0.0))
    still = scene_of([Look.of(look([POST], one), STATION) for one in (LEFT, RIGHT)], STATION)
    moved = scene_of([Look.of(look([POST], one, base_from_base=shift), STATION) for one in (LEFT, RIGHT)], STATION)
    middles = [scene.cloud.points_table[scene.cloud_labels == 1].mean(axis=0) for scene in (still, moved)]
    assert middles[1] - middles[0] == pytest.approx([0.02, -0.01, 0.0], abs=1e-3)


def test_a_thing_nearly_as_wide_as_the_jaw_asks_for_another_look() -> None:
    """One look does not know by how much its camera is mounted amiss: fingers may come down on it."""

    def best(width_m: float, *directions: tuple[float, float]) -> float:
        scene = _scene([Solid((0.46, 0.0, 0.0), (0.10, width_m, 0.05))], *directions)
        closings = search(scene.heights, STATION)
        return float(across_faces(closings, scene, scene.table.base_from_table).score.max())

    assert best(0.060, ABOVE) > STATION.capture.weak_score
    assert best(0.075, ABOVE) < STATION.capture.weak_score
    assert best(0.075, ABOVE, LEFT, RIGHT) > best(0.075, ABOVE)

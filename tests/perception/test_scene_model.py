"""The model of the scene: the table as it is seen, things told apart, what was not seen, and grasps all over it."""

from __future__ import annotations

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections, Observation, ObservedScene
from bus.transforms import apply, from_rotation, from_translation, inverse
from config.load import load_station
from config.schema import Station
from perception.detector import detect, ignore_reply
from perception.models import open_models
from perception.scene.scene import observe
from tests.perception.conftest import BAR, Box, Look

REGION = "scene.pick_region_m=[0.1, 0.8, -0.3, 0.3]"
BLUE, RED, BLACK = (40, 90, 200), (200, 60, 40), (10, 10, 10)
BLOCK = Box((190, 290), (160, 184), 0.03, BLUE)
"""In the middle: 127 x 30 x 30 mm."""


def _station(*overrides: str) -> Station:
    return load_station(None, [REGION, *overrides])


def _detect(observation: Observation, *overrides: str) -> Detections:
    station = _station(*overrides)
    return detect(observation, station, open_models(station, {}), ignore_reply)


def _moved(observation: Observation, base_from_base: np.ndarray) -> Observation:
    """The observation of a camera that the station believes elsewhere."""
    pose = base_from_base @ observation.view.base_from_color
    return observation.model_copy(update={"view": observation.view.model_copy(update={"base_from_color": pose})})


def _tilted(deg: float) -> np.ndarray:
    """A turn about the y axis through the middle of the region."""
    c, s = np.cos(np.deg2rad(deg)), np.sin(np.deg2rad(deg))
    middle = from_translation((0.45, 0.0, 0.0))
    return middle @ from_rotation(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])) @ inverse(middle)


# --- the table -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("offset_m", [-0.012, 0.0, 0.012])
@pytest.mark.parametrize("tilt_deg", [0.0, 3.0, -4.5])
def test_offset_and_tilt_of_the_table_are_seen(look: Look, offset_m: float, tilt_deg: float) -> None:
    moved = from_translation((0.0, 0.0, offset_m)) @ _tilted(tilt_deg)
    table = observe(_moved(look([BLOCK]), moved), _station()).table
    assert table.offset_m == pytest.approx(offset_m, abs=5e-4)
    assert np.degrees(table.tilt_rad) == pytest.approx(abs(tilt_deg), abs=0.1)


@pytest.mark.parametrize(
    "moved", [from_translation((0.0, 0.0, 0.012)), from_translation((0.0, 0.0, -0.012)), _tilted(3)]
)
def test_a_grasp_is_where_the_table_is_seen(look: Look, moved: np.ndarray) -> None:
    """Its place on the object, and its approach along the table's normal, do not depend on where the table lies."""
    still, shifted = (_detect(seen).grasps[0] for seen in (look([BLOCK]), _moved(look([BLOCK]), moved)))
    apart = inverse(moved @ still.base_from_tcp) @ shifted.base_from_tcp
    # a parallel hand has no front, and along the bar one place is as good as another
    assert abs(apart[2, 2]) == pytest.approx(1, abs=1e-3) and abs(apart[2, 3]) < 0.002 and abs(apart[1, 3]) < 0.003


@pytest.mark.parametrize("moved", [from_translation((0.0, 0.0, 0.02)), _tilted(6)])
def test_a_table_that_lies_too_far_off_ends_with_the_advice_to_calibrate(look: Look, moved: np.ndarray) -> None:
    said: list[ObservedScene] = []
    station = _station()
    with pytest.raises(CycleFailure, match="calibrate") as failure:
        detect(_moved(look([BLOCK]), moved), station, open_models(station, {}), ignore_reply, on_scene=said.append)
    assert failure.value.failure is Code.TABLE_MOVED
    assert len(said) == 1, "what was seen is said, also of a refusal"


def test_a_large_flat_box_is_not_the_table(look: Look) -> None:
    lid = Box((60, 420), (60, 300), 0.05, RED)
    assert observe(look([lid]), _station()).table.offset_m == pytest.approx(0, abs=1e-3)


# --- things ----------------------------------------------------------------------------------------------------------


def _count(observation: Observation, *overrides: str) -> int:
    return observe(observation, _station(*overrides)).count


@pytest.mark.parametrize("height_m", [0.03, 0.05])
def test_touching_boxes_of_two_colours_are_two_things_when_a_step_parts_them(look: Look, height_m: float) -> None:
    beside = Box((290, 390), (160, 184), height_m, RED)
    assert _count(look([BLOCK, beside])) == (1 if height_m == BLOCK.height_m else 2)


def test_boxes_a_few_millimetres_apart_are_two_things(look: Look) -> None:
    block = BLOCK._replace(columns=(190, 240))
    beside = block._replace(rows=(190, 214))  # 8 mm: what was one thing, and a drifted picture of one
    found = _detect(look([block, beside]))
    assert len(found.scene.instances) == 2
    assert {grasp.instance for grasp in found.grasps} == {1, 2}, "all that survives goes on to planning"


def test_no_grasp_reaches_over_two_things(look: Look) -> None:
    """Two slabs of 25 mm, 5 mm apart, as wide as one box that would fit the jaw."""
    slabs = [Box((190, 240), (150, 170), 0.04, BLUE), Box((190, 240), (174, 194), 0.04, RED)]
    for grasp in _detect(look(slabs)).grasps:
        ends = grasp.base_from_tcp[:3, 3] + np.outer([-1, 1], grasp.base_from_tcp[:3, 1]) * grasp.width_m / 2
        rows = 180 - ends[:, 1] / 0.57 * 450
        assert not (rows.min() < 171 and rows.max() > 173), "from one slab to the other"


def test_what_stands_higher_than_an_object_may_is_none(look: Look) -> None:
    stand = Box((340, 370), (160, 190), 0.15, RED)
    assert _count(look([BLOCK, stand])) == 2
    assert _count(look([BLOCK, stand]), "scene.max_height_m=0.1") == 1


def test_what_hardly_reaches_into_the_region_is_none_and_no_grasp_lies_outside_it(look: Look) -> None:
    """The bar lies from y = -0.005 to 0.025 m and from x = 0.39 to 0.51 m."""
    assert _count(look([BLOCK]), "scene.pick_region_m=[0.49, 0.8, -0.3, 0.3]") == 0
    found = _detect(look([BLOCK]), "scene.pick_region_m=[0.46, 0.8, -0.3, 0.3]")
    assert all(grasp.base_from_tcp[0, 3] > 0.44 for grasp in found.grasps)


def test_known_boxes_are_no_objects(look: Look) -> None:
    box = "scene.obstacles=[{name='stand', center_m=[0.52, 0.0, 0.02], size_m=[0.06, 0.06, 0.04]}]"
    stand = Box((275, 320), (160, 200), 0.04, RED)
    assert _count(look([BLOCK._replace(columns=(120, 220)), stand]), box) == 1


def test_the_inside_of_a_cup_belongs_to_it(look: Look) -> None:
    cup = [Box((210, 270), (150, 210), 0.08, RED), Box((218, 262), (158, 202), 0.012, (240, 240, 240))]
    assert _count(look(cup)) == 1


# --- what was not seen -----------------------------------------------------------------------------------------------


def test_what_has_no_depth_and_another_colour_is_not_an_empty_table(look: Look) -> None:
    glass = Box((200, 240), (160, 200), None, BLACK)
    with pytest.raises(CycleFailure, match="no depth") as failure:
        _detect(look([glass]))
    assert failure.value.failure is Code.NO_DEPTH


@pytest.mark.parametrize(
    ("columns", "rows", "code"),
    [((200, 240), (160, 200), Code.NO_DEPTH), ((200, 212), (160, 172), Code.NO_OBJECT)],
    ids=["25 cm2", "2 cm2"],
)
def test_a_large_hole_with_the_table_around_it_may_hide_what_has_the_tables_colour(
    look: Look, columns: tuple[int, int], rows: tuple[int, int], code: Code
) -> None:
    with pytest.raises(CycleFailure) as failure:
        _detect(look([Box(columns, rows, None, (165, 165, 165))]))
    assert failure.value.failure is code


def test_no_finger_goes_where_nothing_was_seen(look: Look) -> None:
    """Something black, 25 mm wide, stands 3 mm beside the block: it may be of any height."""
    black = Box((190, 240), (187, 207), None, BLACK)
    seen = look([BLOCK._replace(columns=(190, 240)), black])
    for grasp in _detect(seen).grasps:
        side = grasp.opening_m / 2 + 0.006
        tips = apply(grasp.base_from_tcp, np.array([[0.0, -side, 0.0], [0.0, side, 0.0]]))
        u, v = (tips[:, 0] - 0.45) / 0.57 * 450 + 240, 180 - tips[:, 1] / 0.57 * 450
        assert not ((v > 187) & (v < 207) & (u > 190) & (u < 290)).any()


@pytest.mark.parametrize(
    ("shoulder_m", "may_reach_m"), [(0.08, 0.20), (0.04, 0.04)], ids=["nearly too near", "farther away"]
)
def test_a_hole_beside_what_is_almost_too_near_may_be_of_any_height(
    look: Look, shoulder_m: float, may_reach_m: float
) -> None:
    """A bottle's neck rises from its shoulder: nearer than the camera measures, it looks like a shadow beside a step.

    The camera is 0.6 m above the table, and measures nothing nearer than 0.5 m.
    """
    shoulder = Box((228, 252), (168, 192), shoulder_m, BLUE)
    neck = Box((233, 247), (173, 187), None, BLUE)
    heights = observe(look([shoulder, neck]), _station()).heights
    bound_m = heights.framed.bound_m[heights.cells(np.array([0.45]), np.array([0.0]))]
    assert bound_m == pytest.approx(may_reach_m, abs=0.012)


def test_a_camera_without_a_least_range_hides_no_necks(look: Look) -> None:
    shoulder, neck = Box((228, 252), (168, 192), 0.08, BLUE), Box((233, 247), (173, 187), None, BLUE)
    heights = observe(look([shoulder, neck]), _station("camera.least_range_m=0")).heights
    bound_m = heights.framed.bound_m[heights.cells(np.array([0.45]), np.array([0.0]))]
    assert bound_m == pytest.approx(0.08, abs=0.012)


def test_hidden_space_is_the_reason_when_only_it_is_in_the_way(look: Look) -> None:
    around = [Box((170, 310), rows, None, BLACK) for rows in ((90, 159), (185, 254))]
    ends = [Box(columns, (90, 254), None, BLACK) for columns in ((150, 189), (291, 330))]
    with pytest.raises(CycleFailure, match="another side") as failure:
        _detect(look([*around, *ends, BLOCK]))
    assert failure.value.failure is Code.NOT_SEEN


def test_what_fills_the_view_is_too_near(look: Look) -> None:
    with pytest.raises(CycleFailure) as failure:
        _detect(look([Box((0, 480), (0, 360), 0.2, BLUE)]))
    assert failure.value.failure is Code.TOO_NEAR


# --- grasps ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width_m", [0.020, 0.050, 0.076])
def test_the_width_is_read_to_the_millimetre_and_76_mm_fit_an_80_mm_jaw(look: Look, width_m: float) -> None:
    rows = round(width_m / 0.56 * 450)
    box = Box((150, 330), (180 - rows // 2, 180 - rows // 2 + rows), 0.04, BLUE)
    best = _detect(look([box])).grasps[0]
    assert best.width_m == pytest.approx(rows * 0.56 / 450, abs=0.0015) and best.opening_m <= 0.080


def test_a_vessel_wider_than_the_jaw_is_taken_at_its_rim(look: Look) -> None:
    bowl = [Box((180, 300), (120, 240), 0.06, RED), Box((187, 293), (127, 233), 0.008, RED)]
    best = _detect(look(bowl)).grasps[0]
    assert best.width_m < 0.015


def test_the_painted_rod_is_not_searched_for_by_colour(look: Look) -> None:
    """A heap that has all colours of rods; its own picture is nothing that the embedded model can refuse."""
    colors = [(255, 0, 200), (0, 220, 255), (90, 255, 0), (255, 230, 0)]
    strips = [BLOCK._replace(columns=(190 + 25 * index, 215 + 25 * index), rgb=rgb) for index, rgb in enumerate(colors)]
    found = _detect(look(strips))
    assert found.evidence.alignment.method == "painted" and found.evidence.drift.silhouette_iou == 1


def test_when_one_thing_yields_nothing_the_next_is_tried(look: Look) -> None:
    plate = Box((300, 440), (120, 260), 0.03, RED)  # 177 mm wide
    found = _detect(look([BLOCK._replace(columns=(120, 220)), plate]))
    assert found.scene.instances[found.grasps[0].instance - 1].size_m[1] < 0.05
    assert all(one.score is not None or one.code for one in found.tried)


def test_a_bar_of_any_colour_is_one_thing(look: Look) -> None:
    assert _count(look([BAR])) == 1

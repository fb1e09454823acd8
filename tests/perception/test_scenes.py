"""Which object is taken, what its outline is, and which of several proposals: on scenes whose truth is known."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.baselines.color_only import segment_by_color
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections, ModelReply, Observation
from cell.pick.detect import detect_unless_halted
from config.load import load_station
from config.schema import Station
from perception.detector import detect, ignore_reply
from perception.goal.imagine import free_background, free_rod_color
from perception.grasps.rank import tilted
from perception.grasps.search import search
from perception.models import Models, open_models
from perception.scene.scene import observe
from stand_ins.model_server import Fault, ModelServer
from stand_ins.painter import paint, say
from tests.perception.conftest import BAR, PLATE, Box, Look

KEY = {"OPENAI_API_KEY": "x"}
REGION = "scene.pick_region_m=[0.1, 0.8, -0.3, 0.3]"


def _station(*overrides: str) -> Station:
    return load_station(None, [REGION, *overrides])


def _detect(observation: Observation, *overrides: str) -> Detections:
    station = _station(*overrides)
    return detect(observation, station, open_models(station, {}), ignore_reply)


def _hosted(server: ModelServer, folder: Path, *overrides: str) -> Station:
    return _station(
        "perception.model=openai",
        f"perception.hosted.base_url={server.url}/v1",
        "perception.hosted.text_model=words",
        "perception.hosted.image_model=pictures",
        f"recording.folder={folder}",
        *overrides,
    )


# --- which object ----------------------------------------------------------------------------------------------------


def test_objects_come_largest_first(look: Look) -> None:
    observation = look([BAR, PLATE])
    scene = observe(observation, _station())
    areas = [int(scene.outline(number).sum()) for number in range(1, scene.count + 1)]
    assert areas == pytest.approx([160 * 150, 100 * 24], rel=0.05)


def test_of_several_the_one_with_the_best_grasp_is_taken(look: Look) -> None:
    """The plate is larger, and wider than the jaw."""
    mask = _detect(look([BAR, PLATE])).evidence.object_mask
    assert mask[112, 130] and not mask[250, 320]


def test_a_pixel_names_the_target_also_from_beside_it(look: Look) -> None:
    other = BAR._replace(columns=(300, 400), rows=(180, 204))
    for pixel in ("[350, 190]", "[350, 220]"):
        assert _detect(look([BAR, other]), f"perception.target.pixel={pixel}").evidence.object_mask[190, 350]
    with pytest.raises(CycleFailure, match="no object within") as failure:
        _detect(look([BAR, other]), "perception.target.pixel=[240, 300]")
    assert failure.value.failure is Code.TARGET_NOT_FOUND


def test_words_name_the_target_and_the_model_points_at_it(look: Look, tmp_path: Path) -> None:
    other = BAR._replace(columns=(300, 400), rows=(180, 204))

    def point(prompt: str, image: np.ndarray | None) -> str:
        return "747, 410" if "Find this object in it: the right bar" in prompt else say(prompt, image)

    replies: list[ModelReply] = []
    with ModelServer(paint, say=point) as server:
        station = _hosted(server, tmp_path, "perception.target.text=the right bar")
        with closing(open_models(station, KEY)) as models:
            assert detect(look([BAR, other]), station, models, replies.append).evidence.object_mask[190, 350]
    assert [reply.step for reply in replies] == ["locate", "reason", "direct", "render"]


def test_a_target_the_model_does_not_see_is_no_object(look: Look, tmp_path: Path) -> None:
    with ModelServer(paint, say=lambda prompt, image: "none") as server:
        station = _hosted(server, tmp_path, "perception.target.text=a zebra")
        with closing(open_models(station, KEY)) as models, pytest.raises(CycleFailure, match="zebra") as failure:
            detect(look([BAR]), station, models, ignore_reply)
    assert failure.value.failure is Code.TARGET_NOT_FOUND


def test_the_embedded_model_names_the_words_that_it_does_not_understand(look: Look) -> None:
    with pytest.raises(CycleFailure, match="does not understand"):
        _detect(look([BAR]), "perception.target.text=the bar")


# --- its outline -----------------------------------------------------------------------------------------------------


def _mask(look: Look, boxes: list[Box]) -> np.ndarray:
    return observe(look(boxes), _station()).outline(1)


def test_a_hole_that_only_depth_leaves_is_closed(look: Look) -> None:
    shiny = Box((290, 330), (230, 270), None, (250, 250, 250))
    assert _mask(look, [PLATE, shiny])[250, 310]


def test_a_hole_with_the_table_in_it_is_a_hole(look: Look) -> None:
    assert not _mask(look, [PLATE, Box((270, 370), (205, 305), 0.0, (165, 165, 165))])[250, 320]


def test_the_rim_follows_the_colour_where_depth_is_ragged(look: Look) -> None:
    ragged = [Box((column, column + 2), (122, 126), 0.0, (165, 165, 165)) for column in range(80, 180, 4)]
    lost = [box._replace(rgb=BAR.rgb, rows=(122, 124)) for box in ragged]
    mask, truth = _mask(look, [BAR, *ragged, *lost]), np.zeros((360, 480), bool)
    truth[100:124, 80:180] = True
    assert (mask & truth).sum() / (mask | truth).sum() > 0.96


def test_without_depth_colour_finds_the_object(look: Look) -> None:
    bar = BAR._replace(columns=(190, 290), rows=(170, 194))
    mask, truth = segment_by_color(look([bar]).frame.color), np.zeros((360, 480), bool)
    truth[170:194, 190:290] = True
    assert (mask & truth).sum() / (mask | truth).sum() > 0.95
    with pytest.raises(CycleFailure) as failure:
        segment_by_color(look([]).frame.color)
    assert failure.value.failure is Code.NO_OBJECT


def test_rod_and_background_take_colours_the_object_has_not() -> None:
    magenta_and_white = np.array([[255, 0, 200], [250, 250, 250]] * 50, np.uint8)
    assert free_rod_color(magenta_and_white).name != "magenta"
    assert free_background(magenta_and_white) != (255, 255, 255)


class _Outline:
    """A segmenter that finds ``mask``, whatever it is shown."""

    reads_text = False

    def __init__(self, mask: np.ndarray) -> None:
        self._mask = mask

    def by_box(self, color: np.ndarray, box_px: tuple[float, ...]) -> np.ndarray:
        return self._mask


def _outline(*where: slice | int) -> np.ndarray:
    mask = np.zeros((360, 480), bool)
    mask[where] = True
    return mask


DARK = Box((300, 340), (300, 340), None, (10, 10, 10))


def _ends(observation: Observation, mask: np.ndarray) -> Code | None:
    """The code a detection with that outline ends with; None for grasps."""
    models = Models(open_models(_station(), {}).imaginer, _Outline(mask))  # type: ignore[arg-type]
    try:
        detect(observation, _station(), models, ignore_reply)
    except CycleFailure as failure:
        return failure.failure
    return None


@pytest.mark.parametrize(
    "mask",
    [_outline(slice(305, 330), slice(305, 330)), _outline(310, 310), np.zeros((360, 480), bool)],
    ids=["dark", "one dark pixel", "none"],
)
def test_an_outline_without_any_depth_was_not_seen(mask: np.ndarray, look: Look) -> None:
    assert _ends(look([BAR, DARK]), mask) is Code.NO_DEPTH


@given(
    corner=st.tuples(st.integers(0, 359), st.integers(0, 479)), size=st.tuples(*[st.sampled_from([1, 2, 5, 60])] * 2)
)
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_outline_is_a_defect(corner: tuple[int, int], size: tuple[int, int], look: Look) -> None:
    where = (slice(start, start + extent) for start, extent in zip(corner, size, strict=True))
    assert _ends(look([BAR, DARK]), _outline(*where)) in (None, Code.NO_DEPTH, Code.NO_GRASP, *_OF_MODEL)


_OF_MODEL = tuple(code for code in Code if code.startswith("MODEL_"))


def test_a_camera_that_measures_nothing_sees_no_table(look: Look) -> None:
    assert _code(look([Box((0, 480), (0, 360), None, (10, 10, 10))])) is Code.NO_TABLE


def test_a_table_that_was_seen_and_on_which_nothing_rises_is_empty(look: Look) -> None:
    assert _code(look([])) is Code.NO_OBJECT


@pytest.mark.parametrize(
    ("columns", "code"), [((0, 200), Code.NO_OBJECT), ((0, 300), Code.NOT_SEEN), ((100, 480), Code.NOT_SEEN)]
)
def test_a_table_is_empty_only_when_enough_of_it_was_seen(columns: tuple[int, int], code: Code, look: Look) -> None:
    glass = Box(columns, (0, 360), None, (165, 165, 165))
    assert _code(look([glass]), "scene.pick_region_m=[0.2, 0.7, -0.2, 0.2]", "perception.min_table_seen=0.5") is code


def test_a_pick_region_outside_the_view_was_not_seen(look: Look) -> None:
    assert _code(look([]), "scene.pick_region_m=[1.5, 1.9, -0.2, 0.2]") is Code.NOT_SEEN


def _code(observation: Observation, *overrides: str) -> Code:
    with pytest.raises(CycleFailure) as failure:
        _detect(observation, *overrides)
    return failure.value.failure


# --- which grasp -----------------------------------------------------------------------------------------------------


def test_the_bar_is_taken_across_and_every_term_is_named(look: Look) -> None:
    best = _detect(look([BAR])).grasps[0]
    assert abs(best.base_from_tcp[1, 1]) > 0.99, "closing along base y, across the bar"
    assert best.width_m == pytest.approx(24 * 0.57 / 450, abs=0.005)
    assert set(best.terms) >= {"square", "solid", "wide", "robust", "consistent", "seen"}
    assert all(0 <= value <= 1 for value in best.terms.values()) and 0 <= best.score <= 1


def test_a_tilted_approach_turns_about_the_rod(look: Look) -> None:
    station = _station()
    scene = observe(look([BAR]), station)
    ends = np.array([[0.32, 0.075, 0.015], [0.32, 0.12, 0.015]])
    base_from_level = tilted(ends, np.deg2rad(20), scene.table.base_from_table)
    heights, _ = scene.along(base_from_level, 1)
    anywhere = _station("scene.pick_region_m=[-2, 2, -2, 2]")  # the level frame's x and y are its own
    assert np.isfinite(search(heights, anywhere).score).any()
    rotation = base_from_level[:3, :3]
    assert np.degrees(np.arccos(rotation[2, 2])) == pytest.approx(20, abs=0.5)
    assert np.linalg.det(rotation) == pytest.approx(1) and abs(rotation[2, 0]) < 0.1, "the axis stays level"


def test_the_best_of_several_proposals_is_kept_and_their_agreement_told(look: Look) -> None:
    replies: list[ModelReply] = []
    station = _station("perception.imagine.samples=3")
    found = detect(look([BAR]), station, open_models(station, {}), replies.append)
    assert [reply.sample for reply in replies if reply.step == "reason"] == [0, 1, 2]
    assert 0 <= found.evidence.sample < 3 and 1 / 3 <= found.evidence.agreement <= 1


def test_one_good_proposal_is_enough(look: Look, tmp_path: Path) -> None:
    with ModelServer(paint, say=say, faults=[Fault.REFUSAL], faults_for="image") as server:
        station = _hosted(server, tmp_path, "perception.imagine.samples=2")
        with closing(open_models(station, KEY)) as models:
            found = detect(look([BAR]), station, models, ignore_reply)
    assert found.evidence.sample == 1 and found.evidence.agreement == 0.5


# --- a stop ----------------------------------------------------------------------------------------------------------


def test_a_stop_does_not_wait_for_a_model_that_hangs(look: Look, tmp_path: Path) -> None:
    said: list[ModelReply] = []
    with ModelServer(paint, say=say, faults=[Fault.HANG]) as server:
        station = _hosted(server, tmp_path, "perception.hosted.deadline_s=60", "perception.hosted.attempts=1")
        with closing(open_models(station, KEY)) as models, pytest.raises(CycleFailure) as failure:
            detect_unless_halted([look([BAR])], station, models, said.append, lambda: bool(server.requests))
    assert failure.value.failure is Code.STOPPED
    assert [reply.failure for reply in said] == [Code.STOPPED], "the call that was given up is said"

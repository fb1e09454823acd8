"""Grasp rectangles: when they count as right, how the datasets write them, and what a network makes of an image."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper

from benchmarks import grasps
from benchmarks.baselines.flat import flat_object
from benchmarks.datasets.cornell import read_cornell
from benchmarks.datasets.jacquard import read_jacquard
from benchmarks.datasets.sample import halves
from bus.errors import ConfigError
from bus.messages import ModelReply, Rectangle
from config.load import load_station
from perception.goal.imagine import Conversation
from perception.models import open_models
from perception.proposal import propose
from perception.rectangles.metric import iou, matches
from perception.rectangles.network import GraspNetwork

DATA = Path(os.environ.get("VLAD_CELL_DATA", "nowhere"))
NUMBERS = st.floats(-200, 200)
RECTANGLES = st.builds(
    Rectangle,
    center_px=st.tuples(NUMBERS, NUMBERS),
    angle_rad=st.floats(0, 3.14),
    width_px=st.floats(5, 120),
    height_px=st.floats(5, 60),
)


def _box(
    angle_deg: float = 0.0, at: tuple[float, float] = (100, 100), width: float = 60, height: float = 20
) -> Rectangle:
    return Rectangle(center_px=at, angle_rad=np.deg2rad(angle_deg) % np.pi, width_px=width, height_px=height)


# --- the metric ------------------------------------------------------------------------------------------------------


@given(RECTANGLES, RECTANGLES)
def test_the_overlap_is_symmetric_and_a_share(one: Rectangle, other: Rectangle) -> None:
    assert 0 <= iou(one, other) <= 1
    assert iou(one, other) == pytest.approx(iou(other, one), abs=1e-4)
    assert iou(one, one) == pytest.approx(1, abs=1e-3)


@given(RECTANGLES, RECTANGLES, NUMBERS, NUMBERS, st.floats(0, 3.14))
def test_the_overlap_does_not_depend_on_where_both_lie(
    one: Rectangle, other: Rectangle, u: float, v: float, turn_rad: float
) -> None:
    turn = np.array([[np.cos(turn_rad), -np.sin(turn_rad)], [np.sin(turn_rad), np.cos(turn_rad)]])

    def moved(rectangle: Rectangle) -> Rectangle:
        center_px = tuple((turn @ rectangle.center_px + (u, v)).tolist())
        angle_rad = (rectangle.angle_rad + turn_rad) % np.pi
        return rectangle.model_copy(update={"center_px": center_px, "angle_rad": angle_rad})

    assert iou(moved(one), moved(other)) == pytest.approx(iou(one, other), abs=1e-6)


@pytest.mark.parametrize("size", [(0, 20), (60, 0), (0, 0)])
def test_what_has_no_area_overlaps_nothing(size: tuple[float, float]) -> None:
    flat = _box(at=(0, 0), width=size[0], height=size[1])
    for other in (_box(angle_deg, at=(0, 0)) for angle_deg in range(0, 180, 7)):
        assert iou(flat, other) == iou(other, flat) == iou(flat, flat) == 0


def test_overlap_and_angle_both_count() -> None:
    assert matches(_box(29), _box(0)) and not matches(_box(31), _box(0))
    assert matches(_box(175), _box(0)), "axes have no sign"
    assert not matches(_box(0, at=(145, 100)), _box(0)), "too far along: IoU 14 %"


def test_corners_begin_along_the_closing_axis() -> None:
    first, second, third, _ = _box(90).corners_px()
    np.testing.assert_allclose(second - first, [0, 60], atol=1e-9)
    np.testing.assert_allclose(third - second, [-20, 0], atol=1e-9)


# --- datasets --------------------------------------------------------------------------------------------------------


def _cornell(root: Path, labels: str, number: str = "0100") -> Path:
    for folder in ("rgb", "rgbd"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(root / f"rgbd/pcd{number}r.png"), np.full((48, 64, 3), (10, 20, 30), np.uint8))
    depth_m = np.full((48, 64), 0.7, np.float32)
    depth_m[0, 0] = 0
    cv2.imwrite(str(root / f"rgbd/pcd{number}d.tiff"), depth_m)
    (root / f"rgbd/pcd{number}cpos.txt").write_text(labels)
    return root


def test_cornell_labels_close_along_their_first_edge(tmp_path: Path) -> None:
    nan = "NaN NaN\n10 10\n20 20\n30 30\n"
    (sample,) = read_cornell(_cornell(tmp_path, "10 20\n40 20\n40 30\n10 30\n" + nan))
    (truth,) = sample.truths
    assert truth == Rectangle(center_px=(25.0, 25.0), angle_rad=0.0, width_px=30.0, height_px=10.0)
    assert tuple(sample.color[0, 0]) == (30, 20, 10), "RGB"
    assert sample.depth_m is not None and np.isnan(sample.depth_m[0, 0]) and sample.depth_m[1, 1] == np.float32(0.7)


@pytest.mark.parametrize("labels", ["10 20\n40 20\n", "a b\n1 2\n3 4\n5 6\n"])
def test_damaged_labels_are_named(labels: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="pcd0100cpos"):
        list(read_cornell(_cornell(tmp_path, labels)))


def test_jacquard_angles_turn_from_u_towards_v(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "0_a_RGB.png"), np.zeros((32, 32, 3), np.uint8))
    mask = np.zeros((32, 32), np.uint8)
    mask[8:20, 8:20] = 255
    cv2.imwrite(str(tmp_path / "0_a_mask.png"), mask)
    (tmp_path / "0_a_grasps.txt").write_text("12.5;13.5;30;18;9\n")
    (sample,) = read_jacquard(tmp_path)
    assert sample.truths[0].angle_rad == pytest.approx(np.deg2rad(30)) and sample.truths[0].width_px == 18
    assert sample.mask is not None and sample.mask.sum() == 144 and sample.depth_m is None


def _jacquard(root: Path, labels: str) -> Path:
    cv2.imwrite(str(root / "0_a_RGB.png"), np.zeros((32, 32), np.uint8))
    cv2.imwrite(str(root / "0_a_mask.png"), np.zeros((32, 32), np.uint8))
    (root / "0_a_grasps.txt").write_text(labels)
    return root


def test_jacquard_rows_with_a_nan_are_left_out_and_grey_is_a_colour(tmp_path: Path) -> None:
    (sample,) = read_jacquard(_jacquard(tmp_path, "1;2;nan;4;5\n1;2;3;4;5\n"))
    assert len(sample.truths) == 1 and sample.color.shape == (32, 32, 3)


def test_what_jacquard_lacks_is_named(tmp_path: Path) -> None:
    root = _jacquard(tmp_path, "1;2;3;4;5\n")
    with pytest.raises(ConfigError, match="stereo_depth"):
        list(read_jacquard(root, "depth"))
    (root / "0_a_mask.png").unlink()
    with pytest.raises(ConfigError, match="0_a_mask"):
        list(read_jacquard(root))


@pytest.mark.parametrize("read", [read_cornell, read_jacquard])
def test_a_missing_dataset_is_a_clear_error(read, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ConfigError, match="no folder"):
        list(read(tmp_path / "nothing"))


def test_whole_objects_belong_to_one_half_and_both_halves_have_as_many_images(tmp_path: Path) -> None:
    assert halves([6, 4, 4, 1]) == ["development", "report", "report", "development"]
    for number in ("0106", "0107", "0110"):  # sunglasses from two sides; a sandal
        _cornell(tmp_path, "10 20\n40 20\n40 30\n10 30\n", number)
    _cornell(tmp_path, "10 20\n40 20\n40 30\n10 30\n")
    half_of = {sample.name: sample.half for sample in read_cornell(tmp_path)}
    assert half_of == {"pcd0100": "development", "pcd0106": "report", "pcd0107": "report", "pcd0110": "development"}


def test_images_without_the_depth_that_a_network_needs_are_skipped_and_counted(tmp_path: Path) -> None:
    root = _cornell(tmp_path / "cornell", "10 20\n40 20\n40 30\n10 30\n")
    _cornell(root, "10 20\n40 20\n40 30\n10 30\n", "0110")
    (root / "rgbd/pcd0110d.tiff").unlink()
    box = cv2.rectangle(np.full((480, 640, 3), 200, np.uint8), (260, 200), (380, 260), (0, 0, 90), -1)
    for picture in root.glob("rgbd/*.png"):
        cv2.imwrite(str(picture), box)
    cv2.imwrite(str(root / "rgbd/pcd0100d.tiff"), np.full((480, 640), 0.7, np.float32))
    network, none = _network(tmp_path / "n.onnx", 1), f"perception.salient.path={tmp_path / 'none.onnx'}"
    told: list[str] = []
    figures = grasps.run("cornell", root, f"onnx:{network}", [none], told.append)
    assert (figures["images"], figures["skipped"], figures["masks"]) == (1, 1, "color")
    assert "colour alone" in told[0] and "skipped" in told[-1]


@pytest.mark.skipif(not DATA.is_dir(), reason="VLAD_CELL_DATA names no folder with cornell/ and jacquard/")
def test_the_real_datasets_can_be_read() -> None:
    assert sum(bool(sample.truths) for sample in read_cornell(DATA / "cornell")) > 50
    inside = [
        sample.mask[round(truth.center_px[1]), round(truth.center_px[0])]
        for sample in read_jacquard(DATA / "jacquard")
        for truth in sample.truths
        if sample.mask is not None
    ]
    assert np.mean(inside) > 0.7, "most labelled grasps lie on their object"


# --- networks --------------------------------------------------------------------------------------------------------


def _network(path: Path, channels: int = 1, outputs: int = 4, size: int = 64) -> Path:
    """Quality = the depth's negative (the nearest pixel wins), a constant angle of +30 degrees, a constant width."""
    shape = [1, channels, size, size]
    planes = helper.make_tensor("start", TensorProto.INT64, [1], [0])
    end = helper.make_tensor("end", TensorProto.INT64, [1], [1])
    axis = helper.make_tensor("axis", TensorProto.INT64, [1], [1])
    angle = np.deg2rad(60)
    constants = {"zero": 0.0, "cos2": float(np.cos(angle)), "sin2": float(np.sin(angle)), "wide": 0.2}
    nodes = [
        helper.make_node("Slice", ["image", "start", "end", "axis"], ["first"]),
        helper.make_node("Neg", ["first"], ["quality"]),
        helper.make_node("Mul", ["first", "zero"], ["flat"]),
        *(helper.make_node("Add", ["flat", name], [f"{name}_map"]) for name in ("cos2", "sin2", "wide")),
    ]
    names = ["quality", "cos2_map", "sin2_map", "wide_map"][:outputs]
    graph = helper.make_graph(
        nodes,
        "grasp",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1, size, size]) for name in names],
        [planes, end, axis, *(helper.make_tensor(k, TensorProto.FLOAT, [], [v]) for k, v in constants.items())],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=9)
    onnx.save(model, str(path))
    return path


@pytest.mark.parametrize("channels", [1, 4])
def test_a_network_s_peak_becomes_a_rectangle_of_the_whole_image(channels: int, tmp_path: Path) -> None:
    color, depth_m = np.zeros((128, 256, 3), np.uint8), np.full((128, 256), 1.0, np.float32)
    depth_m[40:56, 150:166] = 0.5
    depth_m[0, 0] = np.nan
    found = GraspNetwork(_network(tmp_path / "n.onnx", channels)).detect(color, depth_m)
    assert np.allclose(found.center_px, (157.5, 47.5), atol=2)
    assert np.degrees(found.angle_rad) == pytest.approx(150), "counter-clockwise in the map, v points down in the image"
    assert found.width_px == pytest.approx(0.2 * 150 * 2) and found.height_px == pytest.approx(30)


def test_a_network_can_imagine_the_rod(tmp_path: Path) -> None:
    """Its rectangle, painted as a rod, comes back through the whole of Algorithm 1."""
    color, mask = np.full((240, 320, 3), 170, np.uint8), np.zeros((240, 320), np.uint8)
    corners_px = cv2.boxPoints(((160, 120), (120, 36), 60)).astype(int)
    cv2.fillPoly(color, [corners_px], (40, 90, 200))
    cv2.fillPoly(mask, [corners_px], 1)
    station = load_station(None, ["perception.model=onnx", f"perception.onnx.path={_network(tmp_path / 'n.onnx', 4)}"])
    models, observed_object = open_models(station, {}), flat_object(color, mask > 0, 0.001, station)
    models.imaginer.begin()
    replies: list[ModelReply] = []
    found = propose(Conversation(models.imaginer, replies.append), observed_object, models, station).rectangles[0]
    assert np.degrees(found.angle_rad) == pytest.approx(150, abs=2) and found.width_px == pytest.approx(36, abs=4)
    assert replies[0].model == "onnx" and "network's best rectangle" in replies[0].text


def test_what_is_no_grasp_network_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="tensors"):
        GraspNetwork(_network(tmp_path / "three.onnx", outputs=3))
    with pytest.raises(ConfigError, match="there is no file"):
        GraspNetwork(tmp_path / "nothing.onnx")
    (tmp_path / "text.onnx").write_text("no network at all")
    with pytest.raises(ConfigError, match="no ONNX file"):
        GraspNetwork(tmp_path / "text.onnx")


def test_a_depth_network_needs_depth(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="needs depth"):
        GraspNetwork(_network(tmp_path / "n.onnx")).detect(np.zeros((64, 64, 3), np.uint8), None)


def test_without_onnxruntime_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("perception.onnx_session.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"vlad-cell\[onnx\]"):
        GraspNetwork(tmp_path / "n.onnx")

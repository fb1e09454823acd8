"""The tensor contract of grasp networks, by small models made here: what goes in, what the four maps mean."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bus.errors import ConfigError
from bus.messages import Rectangle
from perception.rectangles.metric import matches
from perception.rectangles.network import GraspNetwork
from tests.perception.small_networks import FLOAT, MAPS, SIZE, Node, gradients, node, onnx, save


def _one_plane(path: Path, channels: int, plane: int) -> GraspNetwork:
    """Quality and width are one of the planes as it came in; the angle is 0."""
    nodes = [
        node("Slice", "image first last axis", "quality"),
        node("Mul", "quality zero", "sin2"),
        node("Add", "sin2 one", "cos2"),
        node("Identity", "quality", "wide"),
    ]
    whole = {"first": plane, "last": plane + 1, "axis": 1}
    constants = {name: np.array([value], np.int64) for name, value in whole.items()}
    constants |= {"zero": np.zeros((), np.float32), "one": np.ones((), np.float32)}
    return GraspNetwork(save(path, channels, nodes, constants))


def _scene() -> tuple[np.ndarray, np.ndarray]:
    """128 x 192: a far spot, a red, a green and a blue one, each in its own place."""
    color, depth_m = np.full((128, 192, 3), 40, np.uint8), np.full((128, 192), 1.0, np.float32)
    depth_m[20:32, 60:72] = 1.5
    color[20:32, 120:132, 0] = 240
    color[96:108, 60:72, 1] = 240
    color[96:108, 120:132, 2] = 240
    return color, depth_m


DEPTH, RED, GREEN, BLUE = (65.5, 25.5), (125.5, 25.5), (65.5, 101.5), (125.5, 101.5)


@pytest.mark.parametrize(
    ("channels", "plane", "spot"),
    [(1, 0, DEPTH), (3, 0, RED), (3, 1, GREEN), (3, 2, BLUE), (4, 0, DEPTH), (4, 1, RED), (4, 2, GREEN), (4, 3, BLUE)],
)
def test_depth_comes_first_then_red_green_blue(
    channels: int, plane: int, spot: tuple[float, float], tmp_path: Path
) -> None:
    found = _one_plane(tmp_path / "n.onnx", channels, plane).detect(*_scene())
    np.testing.assert_allclose(found.center_px, spot, atol=2)


def test_color_is_a_share_less_its_mean(tmp_path: Path) -> None:
    color = np.zeros((SIZE, SIZE, 3), np.uint8)
    color[:, :, 0] = 255
    found = _one_plane(tmp_path / "n.onnx", 3, 0).detect(color, None)
    assert found.width_px == pytest.approx(150 * 2 / 3, rel=1e-5), "a width of 1 is 150 px; red is 1 - 1/3"


def test_depth_is_clipped_to_a_metre_about_its_mean(tmp_path: Path) -> None:
    depth_m = np.full((SIZE, SIZE), 1.0, np.float32)
    depth_m[30:34, 30:34] = 9.0
    found = _one_plane(tmp_path / "n.onnx", 1, 0).detect(np.zeros((SIZE, SIZE, 3), np.uint8), depth_m)
    assert found.width_px == pytest.approx(150) and found.height_px == pytest.approx(75)


def test_a_grasp_is_looked_for_on_the_objects_only(tmp_path: Path) -> None:
    """The brighter spot lies beside the object."""
    color, on = np.zeros((96, 96, 3), np.uint8), np.zeros((96, 96), bool)
    color[20:30, 20:30, 0], color[60:70, 60:70, 0] = 250, 120
    on[56:74, 56:74] = True
    network = _one_plane(tmp_path / "n.onnx", 3, 0)
    np.testing.assert_allclose(network.detect(color, None).center_px, (24.5, 24.5), atol=2)
    np.testing.assert_allclose(network.detect(color, None, on).center_px, (64.5, 64.5), atol=2)


@pytest.mark.parametrize(("side_px", "scale"), [(30, 1.0), (160, 200 / SIZE)], ids=["fits", "larger than the network"])
def test_objects_are_seen_at_the_image_s_own_scale(side_px: int, scale: float, tmp_path: Path) -> None:
    color, on = np.zeros((480, 640, 3), np.uint8), np.zeros((480, 640), bool)
    on[300 : 300 + side_px, 400 : 400 + side_px] = True
    color[on] = (255, 0, 0)
    spot = (400 + side_px // 2, 300 + side_px // 2)
    cv2.circle(color, spot, max(3, side_px // 5), (255, 255, 0), -1)
    found = _one_plane(tmp_path / "n.onnx", 3, 1).detect(color, None, on)
    np.testing.assert_allclose(found.center_px, spot, atol=side_px / 5)
    brightest = 1.0 - float((color[_around(on, round(SIZE * scale))] / 255).mean())
    assert found.width_px == pytest.approx(150 * scale * brightest, rel=0.03), "a width of 1 is 150 of its pixels"


def _around(on: np.ndarray, side: int) -> tuple[slice, slice]:
    """The square of that side in the middle of the mask."""
    rows, columns = np.flatnonzero(on.any(axis=1)), np.flatnonzero(on.any(axis=0))
    top, left = ((int(line[0]) + int(line[-1]) + 1 - side) // 2 for line in (rows, columns))
    return slice(top, top + side), slice(left, left + side)


def test_a_square_at_the_rim_of_the_image_stays_inside(tmp_path: Path) -> None:
    color, on = np.zeros((480, 640, 3), np.uint8), np.zeros((480, 640), bool)
    on[470:480, 0:12] = True
    color[472:478, 3:9] = 255
    found = _one_plane(tmp_path / "n.onnx", 3, 0).detect(color, None, on)
    np.testing.assert_allclose(found.center_px, (5.5, 474.5), atol=2)


@pytest.mark.parametrize("shape", [(128, 256), (256, 128)])
def test_the_middle_square_is_looked_at_at_the_network_s_size(shape: tuple[int, int], tmp_path: Path) -> None:
    depth_m = np.full(shape, 1.0, np.float32)
    depth_m[:8], depth_m[:, :8] = 2.0, 2.0
    middle = (shape[1] / 2 + 20, shape[0] / 2 - 12)
    cv2.circle(depth_m, (round(middle[0]), round(middle[1])), 8, 4.0, -1)
    found = _one_plane(tmp_path / "n.onnx", 1, 0).detect(np.zeros((*shape, 3), np.uint8), depth_m)
    np.testing.assert_allclose(found.center_px, middle, atol=2)
    assert found.width_px == pytest.approx(2 * 150), "widths scale with the crop"


@pytest.mark.parametrize("angle_deg", range(0, 180, 15))
def test_the_jaw_closes_across_a_bar_however_it_lies(angle_deg: int, tmp_path: Path) -> None:
    """Cos and sin of twice the counter-clockwise angle: the whole way from depth to a rectangle that counts."""
    depth_m = np.full((128, 192), 1.0, np.float32)
    truth = Rectangle(center_px=(100.0, 60.0), angle_rad=np.deg2rad(angle_deg), width_px=36, height_px=20)
    bar = cv2.boxPoints((truth.center_px, (20, 70), float(angle_deg)))
    cv2.fillPoly(depth_m, [np.rint(bar).astype(np.int32)], 0.9)
    found = GraspNetwork(gradients(tmp_path / "n.onnx")).detect(np.zeros((128, 192, 3), np.uint8), depth_m)
    apart_deg = (np.degrees(found.angle_rad) - angle_deg + 90) % 180 - 90
    assert abs(apart_deg) < 5 and 0 <= found.angle_rad < np.pi
    along = np.array([-np.sin(truth.angle_rad), np.cos(truth.angle_rad)])
    slid = np.array(truth.center_px) + along * ((np.array(found.center_px) - truth.center_px) @ along)
    assert matches(found, truth.model_copy(update={"center_px": tuple(slid.tolist())})), "anywhere along the bar"
    assert np.linalg.norm(slid - truth.center_px) < 25


def test_holes_in_the_depth_are_no_grasps(tmp_path: Path) -> None:
    color, depth_m = _scene()
    depth_m[60:70, 90:100] = np.nan
    found = _one_plane(tmp_path / "n.onnx", 4, 0).detect(color, depth_m)
    assert np.isfinite(found.width_px) and np.allclose(found.center_px, DEPTH, atol=2)


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    _one_plane(tmp_path / "n.onnx", 1, 0)
    whole = (tmp_path / "n.onnx").read_bytes()
    (tmp_path / "half.onnx").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ConfigError, match=r"half\.onnx"):
        GraspNetwork(tmp_path / "half.onnx")


def _passing(path: Path, side: int, kind: int = FLOAT, step: Node | None = None, inputs: int = 1) -> Path:
    """Four maps of this side: the input itself, or ``step`` of it."""
    shape = [1, 1, SIZE, SIZE]
    graph = onnx.helper.make_graph(
        [step or node("Identity", "image", "map"), *(node("Identity", "map", name) for name in MAPS)],
        "grasp",
        [onnx.helper.make_tensor_value_info("image", kind, shape)] * inputs,
        [onnx.helper.make_tensor_value_info(name, kind, [1, 1, side, side]) for name in MAPS],
    )
    onnx.save(onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)], ir_version=9), str(path))
    return path


HALF = node("AveragePool", "image", "map", kernel_shape=[2, 2], strides=[2, 2])
BLANK = node("Constant", "", "map", value=onnx.numpy_helper.from_array(np.zeros((1, 1, SIZE, SIZE), np.float32)))


@pytest.mark.parametrize(
    ("made", "said"),
    [
        ({"side": SIZE // 2, "step": HALF}, "gives maps of the shapes"),
        ({"side": SIZE, "kind": onnx.TensorProto.FLOAT16}, "float16"),
        ({"side": SIZE, "step": BLANK, "inputs": 0}, "has the tensors"),
        ({"side": SIZE, "step": node("Identity", "missing", "map")}, "onnxruntime can run"),
        ({"side": SIZE, "step": node("NoSuchOperator", "image", "map")}, "onnxruntime can run"),
    ],
)
def test_what_breaks_the_contract_is_refused_with_what_was_found(
    made: dict[str, Any], said: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=said):
        GraspNetwork(_passing(tmp_path / "n.onnx", **made))


def test_an_empty_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.onnx").touch()
    with pytest.raises(ConfigError, match=r"empty\.onnx"):
        GraspNetwork(tmp_path / "empty.onnx")


def test_weights_may_lie_in_a_file_beside(tmp_path: Path) -> None:
    """As PyTorch's exporter writes them by default."""
    gradients(tmp_path / "n.onnx")
    beside = {"save_as_external_data": True, "location": "n.onnx.data", "size_threshold": 0}
    onnx.save(onnx.load(tmp_path / "n.onnx"), str(tmp_path / "n.onnx"), **beside)
    assert GraspNetwork(tmp_path / "n.onnx").size_px == SIZE
    (tmp_path / "n.onnx.data").unlink()
    with pytest.raises(ConfigError, match=r"n\.onnx"):
        GraspNetwork(tmp_path / "n.onnx")


@pytest.mark.parametrize("depth_m", [np.full((128, 192), np.nan, np.float32), np.ones((64, 96), np.float32)])
def test_depth_that_says_nothing_is_refused(depth_m: np.ndarray, tmp_path: Path) -> None:
    network = _one_plane(tmp_path / "n.onnx", 4, 0)
    with pytest.raises(ConfigError, match="needs depth"):
        network.detect(_scene()[0], depth_m)

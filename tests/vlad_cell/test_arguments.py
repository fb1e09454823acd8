"""What is wrong with the arguments of ``vlad_cell.detect`` is said of the argument, and never of a lens or a cell."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from bus.codes import ADVICE, Code
from config.load import load_station
from config.origins import leaves
from tests.perception.from_aside import CAMERA, Solid, look
from tests.vlad_cell.test_detect_image import BASE_FROM_CAMERA, HIGH_M, K, image
from vlad_cell import BadFrame, CycleFailure, detect
from vlad_cell.advice import FOR_AN_IMAGE

COLOR, DEPTH_M = image()
HEIGHT, WIDTH = DEPTH_M.shape
FX, CX, CY = 450.0, 240.0, 180.0


def refusal(**changed: Any) -> BadFrame:
    given = {"color": COLOR, "depth_m": DEPTH_M, "K": K, "base_from_camera": BASE_FROM_CAMERA, **changed}
    with pytest.raises(BadFrame) as refused:
        detect(**given)
    return refused.value


def scaled(by: float) -> np.ndarray:
    return np.asarray(np.diag([by, by, 1]) @ K)


def seen_from(x_m: float, y_m: float, z_m: float, pose: np.ndarray = BASE_FROM_CAMERA) -> np.ndarray:
    moved = np.array(pose)
    moved[:3, 3] = x_m, y_m, z_m
    return moved


TILTED = seen_from(0.45, -0.35, 0.5) @ np.block(
    [[np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]), np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]
)
"""Looks at the table aslant, from one side."""
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])

WRONG: dict[str, tuple[str, Any, str, str]] = {
    "color from 0 to 1": ("color", COLOR / 255, "float64, from .* to", r"255 \* color"),
    "color from 0 to 255, as float": ("color", COLOR.astype(float), "float64", "astype"),
    "color of 16 bits": ("color", COLOR.astype(np.uint16) << 8, "uint16, from .* to 5", "color >> 8"),
    "color below 0": ("color", COLOR.astype(np.int16) - 200, "int16, from -1", "0 to 255"),
    "grey": ("color", COLOR[..., 0], r"\(360, 480\)", "np.dstack"),
    "RGBA": ("color", np.dstack([COLOR, COLOR[..., :1]]), r"\(360, 480, 4\)", r"color\[\.\.\., :3\]"),
    "channels first": ("color", np.moveaxis(COLOR, -1, 0), r"\(3, 360, 480\)", "np.moveaxis"),
    "a batch": ("color", COLOR[None], r"\(1, 360, 480, 3\)", r"color\[0\]"),
    "two channels": ("color", COLOR[..., :2], r"\(360, 480, 2\)", "RGB"),
    "no picture": ("color", "image.png", "<U9", "numpy array"),
    "None": ("depth_m", None, "depth_m is None", "numpy array"),
    "masked depth": ("depth_m", np.ma.masked_less(DEPTH_M, 0.59), "a masked array", r"filled\(np\.nan\)"),
    "no depth": ("depth_m", np.zeros_like(DEPTH_M), "nothing measured", "in metres"),
    "depth in whole millimetres": ("depth_m", (DEPTH_M * 1000).astype(np.uint16), "600 m", "by 1000"),
    "depth in millimetres": ("depth_m", DEPTH_M * 1000, "600 m", "by 1000"),
    "depth in tenths of a millimetre": ("depth_m", DEPTH_M * 50_000, "3e[+]04 m", "by 10000"),
    "metres taken for millimetres": ("depth_m", DEPTH_M / 1000, "0.0006 m", "twice"),
    "a picture of the depth": ("depth_m", (DEPTH_M * 200).astype(np.uint8), "120 m", "greys"),
    "a coloured picture of the depth": ("depth_m", COLOR, r"\(360, 480, 3\)", "colours"),
    "depth of another size": ("depth_m", DEPTH_M[::2, ::2], r"\(180, 240\), and color \(360, 480", "Register"),
    "depth with a channel": ("depth_m", DEPTH_M[..., None], r"\(360, 480, 1\)", "squeeze"),
    "depth turned": ("depth_m", DEPTH_M.T, r"\(480, 360\)", r"depth_m\.T"),
    "the identity": ("K", np.eye(3), "like the identity: no pixels of a picture of 480 x 360", "fx, 0, cx"),
    "K in parts of the picture": ("K", (0.94, 1.25, 0.5, 0.5), "no pixels", "multiply by its size"),
    "K in millimetres": ("K", (4.0, 4.0, CX, CY), "focal lengths 4 and 4 px.* 178 degrees", "millimetres"),
    "K transposed": ("K", K.T, "transposed", r"K\.T"),
    "K with a skew": ("K", K + 2 * np.eye(3)[[1, 2, 2]] * np.eye(3)[:, [0]], "no matrix", "fx, 0, cx"),
    "K of a picture twice as large": ("K", scaled(2), r"principal point at \(480, 360\) px", "Scale fx, cx"),
    "K of a picture half as large": ("K", scaled(0.5), "the middle of one of 50%", "Scale K"),
    "K in another order": ("K", (FX, CX, FX, CY), r"principal point at \(450, 180\)", "fx, cx"),
    "a projection": ("K", np.eye(3, 4), r"\(3, 4\)", r"K\[:, :3\]"),
    "no K": ("K", np.eye(2), r"\(2, 2\)", "fx, 0, cx"),
    "no focal length": ("K", (0, FX, CX, CY), "fx is 0", "fx, 0, cx"),
    "a focal length of NaN": ("K", (np.nan, FX, CX, CY), "not finite", "finite"),
    "three coefficients": ("distortion", (0.1, 0.1, 0.1), r"\(3,\)", "0, 4, 5, 8"),
    "a coefficient of NaN": ("distortion", (np.nan,) * 4, "not finite", "finite"),
    "a pose that grows": ("base_from_camera", 2 * BASE_FROM_CAMERA, "not rigid", "pose of the camera"),
    "a pose that mirrors": ("base_from_camera", BASE_FROM_CAMERA @ np.diag([1, 1, -1, 1]), "mirrors", "pose"),
    "a pose in millimetres": ("base_from_camera", seen_from(450, 0, 600), "750 m away", "in metres"),
    "a pose of three rows": ("base_from_camera", BASE_FROM_CAMERA[:3], r"\(3, 4\)", "np.vstack"),
    "a rotation": ("base_from_camera", np.eye(3), r"\(3, 3\)", "pose of the camera"),
    "a pose transposed": ("base_from_camera", BASE_FROM_CAMERA.T, "transposed", r"base_from_camera\.T"),
    "no pose": ("base_from_camera", np.eye(4), "at z = 0.000 m, not above the table", "table's top is at z = 0 there"),
    "the inverse": ("base_from_camera", np.linalg.inv(BASE_FROM_CAMERA), "x -0.7", r"np\.linalg\.inv"),
    "the inverse, aslant": ("base_from_camera", np.linalg.inv(TILTED), "x -0.7", r"np\.linalg\.inv"),
    "a camera with y up": ("base_from_camera", BASE_FROM_CAMERA @ OPENGL, "looks up", r"OpenGL.*np\.diag"),
    "the inverse of one": ("base_from_camera", np.linalg.inv(TILTED @ OPENGL), "", r"OpenGL.*np\.linalg"),
    "a camera below": ("base_from_camera", seen_from(0.45, 0, -0.6), "at z = -0.600 m, not above", "table's top"),
    "a camera elsewhere": ("base_from_camera", seen_from(2, 0, HIGH_M), "nothing of the pick .* x 1.7", "region_m"),
    "a camera too high": ("base_from_camera", seen_from(0.45, 0, 1.6), "z = 1.000 m", "in metres"),
    "a camera too low": ("base_from_camera", seen_from(0.45, 0, 0.2), "z = -0.400 m, below the table", "in metres"),
}  # fmt: skip


@pytest.mark.parametrize(("argument", "given", "received", "instead"), WRONG.values(), ids=WRONG)
def test_the_argument_is_named_with_what_came_and_what_to_pass(
    argument: str, given: Any, received: str, instead: str
) -> None:
    said = refusal(**{argument: given})
    assert argument in said.text.split(":")[0]
    with pytest.raises(BadFrame, match=rf"(?s){received}.*{instead}"):
        raise said
    assert "cell" not in str(said) and "lens" not in str(said)


def test_a_camera_that_sees_the_table_aslant_is_no_mistake() -> None:
    """Its picture fits its pose: a table without anything on it."""
    v, u = np.indices(DEPTH_M.shape)
    rays = np.stack([(u - CX) / FX, (v - CY) / FX, np.ones_like(u, float)], axis=-1) @ TILTED[:3, :3].T
    depth_m = -TILTED[2, 3] / rays[..., 2]
    with pytest.raises(CycleFailure, match="Nothing rises above the table") as refused:
        detect(np.full_like(COLOR, 165), depth_m, K, TILTED, region_m=(0.35, 0.55, -0.1, 0.1))
    assert refused.value.code == "NO_OBJECT" and "region_m" in refused.value.advice


def test_every_setting_that_the_advice_names_is_there() -> None:
    known = set(leaves(load_station()))
    for advice in FOR_AN_IMAGE.values():
        named = re.findall(r"(?:scene|perception|camera)\.[a-z_.]*[a-z]", advice)
        assert all(any(one == name or one.startswith(f"{name}.") for one in known) for name in named), advice


def test_no_advice_about_an_image_is_for_who_has_a_cell() -> None:
    """A code that detect never ends with needs no other advice."""
    devices = {"ARM_REFLEX", "BAD_FRAME", "CONTACT", "DEVICE_LOST", "DROPPED", "GRASP_MISSED", "HAND_FAULT", "INTERNAL",
               "LEFT_OVER", "MOTION_REFUSED", "NODE_LOST", "RECORDING", "STALE_FRAME", "STOPPED"}  # fmt: skip
    for code in set(Code) - {Code(name) for name in devices}:
        advice = FOR_AN_IMAGE.get(code, ADVICE[code])
        assert not any(word in advice for word in ("`cell", "report", "arm.", "clear_way")), (code, advice)


def test_the_inverse_that_lets_the_camera_see_some_table_is_named_where_none_is_found() -> None:
    seen = look([Solid((0.46, 0.0, 0.0), (0.1, 0.04, 0.06))], (20.0, 90.0))
    pose = np.linalg.inv(seen.view.base_from_color)
    with pytest.raises(CycleFailure, match=r"Is it camera_from_base\? .*np\.linalg\.inv") as failure:
        detect(seen.frame.color, seen.frame.depth_m, (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy), pose)
    assert failure.value.failure is Code.NO_TABLE

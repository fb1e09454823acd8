"""The Femto Mega's frames from a recording, through the SDK; and our registration of depth against the SDK's own."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bus.messages import Frame
from config.hardware import FemtoMegaSettings
from drivers.femto_mega.camera import depth_m
from drivers.femto_mega.session import Pair, Session, pair_of
from drivers.sim.optics import COLOR, COLOR_FROM_DEPTH, DEPTH
from perception.geometry.depth import register
from stand_ins.bag import write_bag
from stand_ins.femto_mega.process import no_extensions

SPOTS_PX = [(u, v) for u in range(220, 440, 40) for v in range(240, 400, 40)]
SPOT_PX = 8


def _dotted_depth_mm() -> np.ndarray:
    """A board at 0.9 m with blocks standing out of it by 0.25 m, whose middles can be found."""
    depth_mm = np.full((576, 640), 900, np.uint16)
    for u, v in SPOTS_PX:
        depth_mm[v - SPOT_PX : v + SPOT_PX + 1, u - SPOT_PX : u + SPOT_PX + 1] = 650
    return depth_mm


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    extensions = no_extensions()
    path: Path = tmp_path_factory.mktemp("bag") / "still.bag"
    color = np.full((720, 1280, 3), 90, np.uint8)
    write_bag(path, [(color, _dotted_depth_mm())] * 20, COLOR, DEPTH, COLOR_FROM_DEPTH)
    session = Session(FemtoMegaSettings(extensions=extensions), lambda sdk, _: sdk.PlaybackDevice(str(path)))
    yield session
    session.close()


def _first_pair_and_aligned(session: Session) -> tuple[Pair, np.ndarray]:
    """One pair by the driver, and the same frames registered by the SDK (mm, in the undistorted colour image)."""
    sdk: Any = importlib.import_module("pyorbbecsdk")
    align = sdk.AlignFilter(align_to_stream=sdk.OBStreamType.COLOR_STREAM)
    frames = None
    for _ in range(20):
        frames = session._pipeline.wait_for_frames(1000)
        if frames is not None:
            break
    assert frames is not None
    aligned = align.process(frames).as_frame_set().get_depth_frame()
    data = np.frombuffer(np.asarray(aligned.get_data()).tobytes(), "<u2")
    pair = pair_of(frames)
    assert pair is not None
    return pair, data.reshape(aligned.get_height(), aligned.get_width())


def _middles_px(near: np.ndarray) -> np.ndarray:
    """Centres (n, 2) of the near blobs, in reading order of the board's columns and rows."""
    _, _, stats, centres = cv2.connectedComponentsWithStats(near.astype(np.uint8))
    return np.asarray(centres[1:][stats[1:, cv2.CC_STAT_AREA] > 50])


def test_registered_depth_agrees_with_an_independent_reprojection_and_with_the_sdk(session: Session) -> None:
    pair, aligned_mm = _first_pair_and_aligned(session)
    assert np.array_equal(pair.depth_mm, _dotted_depth_mm())
    frame = Frame(
        stamp_ns=0,
        color=np.zeros((720, 1280, 3), np.uint8),
        depth_m=depth_m(pair),
        color_camera=session.color_camera,
        depth_camera=session.depth_camera,
        color_from_depth=session.color_from_depth,
    )
    ours_px = _middles_px(register(frame).depth_m < 0.78)
    sdk_px = _middles_px((aligned_mm > 0) & (aligned_mm < 780))
    by_hand_px = _projected_px(np.array(SPOTS_PX, dtype=float), 0.650)
    assert len(ours_px) == len(sdk_px) == len(SPOTS_PX)
    from_opencv_px, from_sdk_px = _apart_px(ours_px, by_hand_px), _apart_px(ours_px, sdk_px)
    assert np.linalg.norm(from_opencv_px, axis=1).max() < 1.0
    # the SDK grows each pixel to the right and down: a shift that all share, beside which the two agree
    shift_px = from_sdk_px.mean(axis=0)
    assert (shift_px > 0.0).all() and (shift_px < 2.0).all()
    assert np.linalg.norm(from_sdk_px - shift_px, axis=1).max() < 1.0


def _apart_px(ours_px: np.ndarray, other_px: np.ndarray) -> np.ndarray:
    """From each of ours to the nearest of the others."""
    nearest = np.linalg.norm(ours_px[:, None] - other_px[None], axis=2).argmin(axis=1)
    return np.asarray(other_px[nearest] - ours_px)


def _projected_px(pixels: np.ndarray, z_m: float) -> np.ndarray:
    """Pixels of the depth camera at a depth, in the undistorted colour image (OpenCV's functions only)."""
    matrix = np.array([[DEPTH.fx, 0, DEPTH.cx], [0, DEPTH.fy, DEPTH.cy], [0, 0, 1]])
    many = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-12)
    rays = cv2.undistortPoints(pixels[:, None], matrix, np.array(DEPTH.distortion), criteria=many)[:, 0]
    points = np.concatenate([rays * z_m, np.full((len(rays), 1), z_m)], axis=1)
    rotation, _ = cv2.Rodrigues(COLOR_FROM_DEPTH[:3, :3])
    color_matrix = np.array([[COLOR.fx, 0, COLOR.cx], [0, COLOR.fy, COLOR.cy], [0, 0, 1]])
    return np.asarray(cv2.projectPoints(points, rotation, COLOR_FROM_DEPTH[:3, 3], color_matrix, None)[0][:, 0])

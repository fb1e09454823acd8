"""A picture of now is given while the cell rests, as a file of the kind that was asked for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from bus.errors import Refused
from bus.messages import ArmMode, ArmState, CameraModel, Frame, PictureRequest
from cell.daemon.live_picture import AGAIN_S, LivePictures
from cell.daemon.pointed import Pointed
from config.load import load_station
from planning.robot import Robot

PINHOLE = CameraModel(width=64, height=36, fx=50.0, fy=50.0, cx=32.0, cy=18.0, distortion=())
ORANGE = (230, 90, 20)


class Desk:
    """A cell whose arm, camera and clock a test sets."""

    def __init__(self) -> None:
        station = load_station()
        self.capture_q_rad = np.array(station.arm.capture_q_rad)
        self.q_rad, self.is_at_rest, self.time_s, self.taken = self.capture_q_rad, True, 0.0, 0
        equipment = SimpleNamespace(camera=self, arm=self, robot=Robot(station), station=station)
        self.is_held = False
        self.pictures = LivePictures(
            cast(Any, equipment), lambda: self.is_at_rest, lambda: self.is_held, Pointed(), lambda: self.time_s
        )

    def state(self) -> ArmState:
        rest = np.zeros(7)
        return ArmState(stamp_ns=1, q_rad=self.q_rad, dq_rad_s=rest, tau_ext_nm=rest, mode=ArmMode.IDLE)

    def capture(self) -> Frame:
        self.taken += 1
        color = np.full((36, 64, 3), ORANGE, np.uint8)
        return Frame(stamp_ns=self.taken, color=color, depth_m=np.ones((36, 64), np.float32), color_camera=PINHOLE,
                     depth_camera=PINHOLE, color_from_depth=np.eye(4))  # fmt: skip


@pytest.fixture
def desk() -> Desk:
    return Desk()


@pytest.mark.parametrize("media_type", ["image/png", "image/jpeg"])
def test_it_is_a_file_of_the_kind_that_was_asked_for(desk: Desk, media_type: Any) -> None:
    picture = desk.pictures.now(PictureRequest(media_type=media_type))
    assert (picture.media_type, picture.stamp_ns, picture.from_capture_pose) == (media_type, 1, True)
    bgr = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR)
    assert bgr is not None and np.abs(bgr[18, 32, ::-1].astype(int) - ORANGE).max() < 10


def test_who_asks_again_at_once_gets_the_same_one_and_later_a_new_one(desk: Desk) -> None:
    first, again = desk.pictures.now(PictureRequest()), desk.pictures.now(PictureRequest())
    desk.time_s += AGAIN_S + 0.1
    assert [first.stamp_ns, again.stamp_ns, desk.pictures.now(PictureRequest()).stamp_ns] == [1, 1, 2]


def test_while_the_cell_works_there_is_none(desk: Desk) -> None:
    desk.is_at_rest = False
    with pytest.raises(Refused, match="works") as refused:
        desk.pictures.now(PictureRequest())
    assert refused.value.code == "NOT_AT_REST" and desk.taken == 0


def test_from_elsewhere_it_is_to_look_at_and_not_to_point_into(desk: Desk) -> None:
    desk.q_rad = desk.capture_q_rad + 0.1
    with pytest.raises(Refused, match="Reset the cell") as refused:
        desk.pictures.now(PictureRequest())
    assert refused.value.code == "PICTURE_ELSEWHERE"
    assert not desk.pictures.now(PictureRequest(from_capture_pose=False)).from_capture_pose


def test_while_the_cell_is_held_one_may_look_and_not_point(desk: Desk) -> None:
    desk.is_at_rest, desk.is_held = False, True
    picture = desk.pictures.now(PictureRequest(from_capture_pose=False))
    assert not picture.from_capture_pose, "even where the arm has not left its capture pose yet"
    with pytest.raises(Refused) as refused:
        desk.pictures.now(PictureRequest())
    assert refused.value.code == "NOT_AT_REST"

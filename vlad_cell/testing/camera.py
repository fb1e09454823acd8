"""The checks that every RGB-D camera passes."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

from bus.errors import NotConnected
from bus.messages import CameraModel
from drivers.interface import Camera, Devices
from vlad_cell.testing.devices import DriverSuite


class CameraSuite(DriverSuite):
    """The checks of a camera, which looks at something 0.3 to 1.5 m away."""

    @pytest.fixture
    def camera(self, devices: Devices) -> Iterator[Camera]:
        """Yield the camera, connected."""
        assert devices.camera is not None, "the driver brings no camera"
        devices.camera.connect()
        yield devices.camera

    def test_it_implements_the_protocol(self, devices: Devices) -> None:
        assert isinstance(devices.camera, Camera)

    def test_a_frame_is_fresh_complete_and_plausible(self, camera: Camera) -> None:
        asked_ns = time.time_ns()
        frame = camera.capture()
        assert frame.stamp_ns >= asked_ns
        assert frame.color.shape == (frame.color_camera.height, frame.color_camera.width, 3)
        assert frame.depth_m.shape == (frame.depth_camera.height, frame.depth_camera.width)
        assert frame.color.std() > 5, "the image is empty"
        valid = np.isfinite(frame.depth_m)
        assert valid.mean() > 0.4
        assert 0.3 < np.median(frame.depth_m[valid]) < 1.5

    def test_calibration_is_usable(self, camera: Camera) -> None:
        frame = camera.capture()
        for model in (frame.color_camera, frame.depth_camera):
            assert isinstance(model, CameraModel)
            assert 0 < model.cx < model.width and 0 < model.cy < model.height and model.fx > 100 and model.fy > 100
        rotation = frame.color_from_depth[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.norm(frame.color_from_depth[:3, 3]) < 0.2

    def test_two_frames_have_rising_stamps(self, camera: Camera) -> None:
        assert camera.capture().stamp_ns < camera.capture().stamp_ns

    def test_before_connect_and_after_close_it_says_so(self, devices: Devices) -> None:
        camera = devices.camera
        assert camera is not None
        camera.close()
        camera.close()
        with pytest.raises(NotConnected):
            camera.capture()
        camera.connect()
        camera.capture()

"""The simulated Femto Mega: what its pixels mean, its noise, its threads, and its absence."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from bus.commands import PresentRequest
from bus.messages import CameraModel, Frame
from config.load import load_station
from config.schema import Station
from drivers.interface import ObjectPresenter
from drivers.sim.camera import SimCamera
from drivers.sim.devices import SimPresenter
from drivers.sim.sensor import MAX_RANGE_M, MIN_RANGE_M, sense
from drivers.sim.world import World

Array = npt.NDArray[np.float64]

CUP_HEIGHT_M = 0.085


class View:
    """A camera on a world of its own, looking down from the capture pose."""

    def __init__(self, station: Station) -> None:
        self.world = World(station)
        self.presenter: ObjectPresenter = SimPresenter(self.world)
        self.camera = SimCamera(self.world)
        self.camera.connect()

    def of(self, name: str, seed: int = 3) -> tuple[Frame, Array]:
        """A frame of ``name`` and its true pose."""
        truth = self.presenter.present(PresentRequest(object=name, cycle=0, seed=seed))
        return self.camera.capture(), np.asarray(truth.base_from_object)

    def base_from_color(self) -> Array:
        camera = self.world.station.camera
        hand_from_color = np.eye(4)
        hand_from_color[:3, :3] = Rotation.from_quat(camera.hand_from_color_wxyz, scalar_first=True).as_matrix()
        hand_from_color[:3, 3] = camera.hand_from_color_position_m
        hand = self.world.data.body("hand")
        base_from_hand = np.eye(4)
        base_from_hand[:3, :3], base_from_hand[:3, 3] = hand.xmat.reshape(3, 3), hand.xpos
        return base_from_hand @ hand_from_color


def lens(model: CameraModel) -> tuple[Array, Array]:
    return np.array([[model.fx, 0, model.cx], [0, model.fy, model.cy], [0, 0, 1]]), np.array(model.distortion)


def pixels_of(points_m: Array, model: CameraModel) -> Array:
    """(n, 3) points in the camera -> (n, 2) distorted pixels."""
    pixels: Array = cv2.projectPoints(points_m[:, None], np.zeros(3), np.zeros(3), *lens(model))[0]
    return pixels[:, 0]


def points_of(depth_m: npt.NDArray[np.float32], model: CameraModel) -> Array:
    """(h, w, 3) points in the camera, NaN where invalid."""
    v, u = np.indices(depth_m.shape, dtype=float)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-12)
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    rays = cv2.undistortPoints(pixels, *lens(model), criteria=criteria)[:, 0]
    return np.dstack([rays.reshape(*depth_m.shape, 2), np.ones_like(depth_m)]) * depth_m[..., None]


def moved(points_m: Array, transform: npt.NDArray[np.floating]) -> Array:
    there: Array = points_m @ transform[:3, :3].T + transform[:3, 3]
    return there


def seen_in_base(frame: Frame, base_from_color: Array) -> Array:
    """(h, w, 3) of the depth image in ``base``."""
    return moved(points_of(frame.depth_m, frame.depth_camera), base_from_color @ frame.color_from_depth)


@pytest.fixture(scope="module")
def exact() -> Iterator[View]:
    """A camera without noise."""
    view = View(load_station(None, ["sim.depth_noise=0"]))
    yield view
    view.camera.close()


@pytest.fixture(scope="module")
def real() -> Iterator[View]:
    view = View(load_station())
    yield view
    view.camera.close()


# --- geometry ---------------------------------------------------------------------------------------------------------


def test_it_looks_straight_down_on_the_pick_region(exact: View) -> None:
    pose = exact.base_from_color()
    np.testing.assert_allclose(pose[:3, 2], [0, 0, -1], atol=1e-3)
    assert pose[:3, 3] == pytest.approx([0.45, 0.0, 0.70], abs=0.03)


@pytest.mark.parametrize("camera", ["color", "depth"])
def test_the_whole_pick_region_is_in_view(exact: View, camera: str) -> None:
    frame, _ = exact.of("drone")
    x_min, x_max, y_min, y_max = exact.world.station.scene.pick_region_m
    corners = np.array([[x, y, 0.0] for x in (x_min, x_max) for y in (y_min, y_max)])
    base_from_color = exact.base_from_color()
    pose = base_from_color if camera == "color" else base_from_color @ frame.color_from_depth
    model = frame.color_camera if camera == "color" else frame.depth_camera
    pixels = pixels_of(moved(corners, np.linalg.inv(pose)), model)
    assert (pixels > 5).all() and (pixels < [model.width - 5, model.height - 5]).all()
    if camera == "depth":
        columns, rows = pixels.round().astype(int).T
        assert np.isfinite(frame.depth_m[rows, columns]).all(), "a corner lies outside the lit hexagon"


def test_the_table_is_the_plane_z_0(exact: View) -> None:
    frame, truth = exact.of("drone")
    seen = seen_in_base(frame, exact.base_from_color())
    x, y, z = seen[..., 0], seen[..., 1], seen[..., 2]
    table = np.isfinite(z) & (np.hypot(x - truth[0, 3], y - truth[1, 3]) > 0.2) & (y < 0.3)
    assert table.sum() > 50_000
    assert np.abs(z[table]).max() < 1.5e-3  # 1 mm steps, and the render's own resolution


def test_depth_shows_the_object_where_it_is(exact: View) -> None:
    """The cup's rim: its height, and its centre from the rim's extent."""
    frame, truth = exact.of("cup")
    seen = seen_in_base(frame, exact.base_from_color()).reshape(-1, 3)
    near = np.hypot(*(seen[:, :2] - truth[:2, 3]).T) < 0.036
    rim = seen[near & (seen[:, 2] > CUP_HEIGHT_M - 3e-3)]
    assert len(rim) > 200
    assert np.median(rim[:, 2]) == pytest.approx(CUP_HEIGHT_M, abs=1e-3)
    assert (rim[:, :2].min(axis=0) + rim[:, :2].max(axis=0)) / 2 == pytest.approx(truth[:2, 3], abs=2e-3)


def test_color_shows_the_object_where_it_is(exact: View) -> None:
    """The bottle's red cap, found by its colour, against the projection of its true centre."""
    frame, truth = exact.of("bottle")
    red, green, blue = frame.color.astype(int).transpose(2, 0, 1)
    rows, columns = np.nonzero((red > 120) & (red > 2 * green) & (red > 2 * blue))
    cap_of_bottle_m = np.array([[0.100, 0.0, 0.0]])
    in_color = moved(moved(cap_of_bottle_m, truth), np.linalg.inv(exact.base_from_color()))
    (expected,) = pixels_of(in_color, frame.color_camera)
    cap = np.hypot(columns - expected[0], rows - expected[1]) < 30  # the label has a red stripe, too
    assert np.array([columns[cap].mean(), rows[cap].mean()]) == pytest.approx(expected, abs=2.5)


def test_color_and_depth_agree(exact: View) -> None:
    """Depth pixels of the controller's dark grip land on dark pixels of the colour image."""
    frame, truth = exact.of("drone")
    points = points_of(frame.depth_m, frame.depth_camera)
    seen = moved(points, exact.base_from_color() @ frame.color_from_depth)
    in_object = moved(seen.reshape(-1, 3), np.linalg.inv(truth))
    canopy = (np.hypot(in_object[:, 0] / 0.030, in_object[:, 1] / 0.014) < 1) & (in_object[:, 2] > 0.035)
    columns, rows = pixels_of(moved(points.reshape(-1, 3)[canopy], frame.color_from_depth), frame.color_camera).T
    colors = frame.color[rows.round().astype(int), columns.round().astype(int)]
    assert canopy.sum() > 300
    assert (colors.max(axis=1) < 90).mean() > 0.98


def test_nothing_of_the_robot_is_in_view(exact: View) -> None:
    """However far the hand is open, no depth pixel is much nearer than the tallest object."""
    frame, _ = exact.of("spatula")
    for width_m in (0.0, 0.08):
        exact.world.data.qpos[exact.world._finger_qpos] = width_m / 2
        depth_m = exact.camera.capture().depth_m
        assert np.nanmin(depth_m) > 0.55
        assert np.isfinite(depth_m).sum() == pytest.approx(np.isfinite(frame.depth_m).sum(), rel=0.01)


# --- sensor -----------------------------------------------------------------------------------------------------------


def test_noise_is_a_millimetre_or_two_on_the_table(exact: View, real: View) -> None:
    truth, _ = exact.of("cup")
    noisy, _ = real.of("cup")
    error_m = (noisy.depth_m - truth.depth_m)[300:500, 60:200]
    middle = error_m[np.isfinite(error_m)]
    assert len(middle) > 20_000
    assert 0.5e-3 < middle.std() < 3e-3
    assert abs(middle.mean()) < 4e-3


def test_depth_comes_in_millimetres(real: View) -> None:
    depth_m = real.of("cup")[0].depth_m
    millimetres = depth_m[np.isfinite(depth_m)].astype(float) * 1000
    np.testing.assert_allclose(millimetres, millimetres.round(), atol=1e-3)


def test_out_of_range_and_dark_corners_are_invalid() -> None:
    depth_m = np.full((576, 640), 1.0, np.float32)
    depth_m[280:290, 300:310], depth_m[280:290, 320:330] = MIN_RANGE_M - 0.02, MAX_RANGE_M + 0.2
    measured = sense(depth_m, np.random.default_rng(0), 0, 0.0)
    assert np.isnan(measured[281:289, 301:309]).all() and np.isnan(measured[281:289, 321:329]).all()
    assert np.isnan(measured[[0, 0, -1, -1], [0, -1, 0, -1]]).all()
    assert np.isfinite(measured[288, 100]) and np.isfinite(measured[100, 320])


def test_edges_are_half_lost_half_mixed() -> None:
    depth_m = np.full((576, 640), 0.7, np.float32)
    depth_m[:, 320:] = 0.6
    edge = sense(depth_m, np.random.default_rng(0), 0, 1.0)[100:476, 319:321]
    assert np.isnan(edge).mean() == pytest.approx(0.5, abs=0.1)
    left = edge[np.isfinite(edge)]
    assert ((left > 0.61) & (left < 0.69)).mean() > 0.5


def test_the_same_seeds_give_the_same_frame() -> None:
    """Twice from scratch: identical to the bit; another seed is another frame."""
    first, second = View(load_station()), View(load_station())
    (a, a_truth), (b, b_truth) = first.of("spatula", seed=8), second.of("spatula", seed=8)
    np.testing.assert_array_equal(a_truth, b_truth)
    np.testing.assert_array_equal(a.color, b.color)
    np.testing.assert_array_equal(a.depth_m, b.depth_m)
    assert (first.camera.capture().depth_m != a.depth_m).any(), "a second frame has its own noise"
    assert (first.of("spatula", seed=9)[1] != a_truth).any()
    first.camera.close()
    second.camera.close()


# --- threads and graphics ---------------------------------------------------------------------------------------------


def test_any_thread_may_capture(real: View) -> None:
    """The graphics context follows: connected here, used there, and here again."""
    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(1) as other:
        for pool in (one, other, one):
            assert pool.submit(real.camera.capture).result(timeout=60).color.std() > 5
    assert real.camera.capture().color.std() > 5


NO_GRAPHICS = """
from bus.errors import DriverUnavailable
from config.load import load_station
from drivers.node.registry import open_devices
try:
    open_devices("sim", load_station()).camera.connect()
except DriverUnavailable as error:
    print("REFUSED", error)
"""


@pytest.mark.parametrize(
    ("broken", "what_to_do"),
    [
        ({"__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent"}, "apt-get install libegl1 libgl1-mesa-dri"),
        ({"MUJOCO_GL": "nonsense"}, "Unset MUJOCO_GL (it says nonsense)"),
    ],
)
def test_without_egl_it_says_what_to_do(broken: dict[str, str], what_to_do: str) -> None:
    environment = {**os.environ, "MUJOCO_GL": "egl", **broken}
    ran = subprocess.run([sys.executable, "-c", NO_GRAPHICS], env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert "REFUSED" in ran.stdout
    assert what_to_do in ran.stdout

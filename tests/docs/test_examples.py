"""The packages of examples/ and the files of docs/examples."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from benchmarks.baselines.flat import flat_object
from bus.errors import ConfigError
from bus.messages import CameraModel, Frame, Observation, View
from cell.daemon.live_picture import encoded
from cell.daemon.noted_png import with_region
from config.load import load_station
from docs.examples.pixel import pixel_of
from drivers.sim.objects import object_names, require_presentable
from perception.goal.imagine import Conversation
from perception.models import Models, open_models
from perception.models.registry import open_local
from perception.proposal import propose
from tests.docs.example_packages import EXAMPLES, PACKAGES, install
from vlad_cell.testing import DetectorSuite, GoalModelSuite, HandSuite

OBJECTS = EXAMPLES.parent / "docs" / "examples" / "objects"


@pytest.fixture(scope="module", autouse=True)
def _packages(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        install(patch, tmp_path_factory.mktemp("installed"), *PACKAGES)
        yield


class TestGripper(HandSuite):
    """As examples/hand_driver/test_acme_gripper.py, with nothing installed."""

    name = "acme_gripper"


class TestCrosswise(GoalModelSuite):
    """As examples/goal_model/test_acme_model.py."""

    name = "acme"


class TestGeometric(GoalModelSuite):
    """Ours passes, too."""

    name = "geometric"


class TestTongs(DetectorSuite):
    """As examples/detector/test_acme_detector.py."""

    name = "acme"


@pytest.mark.parametrize(
    ("override", "said"),
    [
        (
            "perception.settings.height=2",
            r"perception\.settings\.height: .*less than 1 \(the goal-image model 'acme' says",
        ),
        ("perception.settings.hight=0.5", r"perception\.settings\.hight: Extra inputs.*Its settings: height, length_m"),
    ],
)
def test_a_goal_image_model_s_settings_are_checked_by_its_own_model(override: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        open_local("acme", load_station(None, ["perception.model=acme", override]))


def test_beside_another_detector_whose_settings_they_are_the_goal_image_model_has_its_defaults() -> None:
    both = ["perception.detector=acme", "perception.model=acme", "perception.settings.headings=36"]
    models = open_models(load_station(None, both), {})
    assert models.detector is not None and models.imaginer.name == "acme"


def test_the_model_lays_its_rod_across_the_narrow_side() -> None:
    """A bar, 40 x 130 mm at 1 mm a pixel, turned by 30 degrees."""
    color, mask = np.full((360, 480, 3), 170, np.uint8), np.zeros((360, 480), np.uint8)
    corners = cv2.boxPoints(((240, 180), (130, 40), 30)).astype(int)
    cv2.fillPoly(color, [corners], (40, 90, 200))
    cv2.fillPoly(mask, [corners], 1)
    station = load_station(None, ["perception.model=acme"])
    model = open_local("acme", station)
    proposal = propose(
        Conversation(model, lambda reply: None), flat_object(color, mask > 0, 0.001, station), Models(model), station
    )
    ends = proposal.ends[0]
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(0.040, abs=0.006)


def test_a_client_without_any_package_finds_the_pixel_of_a_coloured_thing() -> None:
    """A camera's picture: noise, a lamp's reflex, and the larger of two orange things is hollow."""
    color = np.full((180, 320, 3), 150, np.uint8)
    color[20:30, 20:30] = (20, 90, 230)
    cv2.circle(color, (200, 100), 30, (20, 90, 230), 8)
    noisy = np.clip(color + np.random.default_rng(1).normal(0, 4, color.shape), 0, 255).astype(np.uint8)
    png = encoded(noisy[..., ::-1], "image/png")
    u, v = pixel_of(png, "orange")
    assert tuple(color[v, u]) == (20, 90, 230)
    assert abs(np.hypot(u - 200, v - 100) - 30) < 5
    with pytest.raises(ValueError, match="nothing blue"):
        pixel_of(png, "blue")


def test_it_takes_nothing_that_lies_in_the_tray() -> None:
    """The pick region is seen aslant; beyond it lies what is larger, and of the same colour."""
    color = np.full((180, 320, 3), 150, np.uint8)
    color[60:90, 140:170] = color[100:170, 240:310] = (230, 90, 20)
    station = load_station(None, ["scene.pick_region_m=[0.4, 0.5, -0.1, 0.1]"])
    camera = CameraModel(width=320, height=180, fx=300.0, fy=300.0, cx=160.0, cy=90.0)
    aslant = np.array([[1, 0, 0, 0.45], [0, -0.8, 0.6, -0.4], [0, -0.6, -0.8, 0.5], [0, 0, 0, 1]])
    frame = Frame(stamp_ns=1, color=color, depth_m=np.ones((180, 320), np.float32), color_camera=camera,
                  depth_camera=camera, color_from_depth=np.eye(4))  # fmt: skip
    seen = Observation(view=View(stamp_ns=1, base_from_color=aslant), frame=frame)
    png = with_region(encoded(color, "image/png"), seen, station)
    u, v = pixel_of(png, "orange")
    assert 140 <= u < 170 and 60 <= v < 90
    assert pixel_of(encoded(color, "image/png"), "orange")[0] >= 240, "without a region: all of it"
    shown = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert shown is not None and np.array_equal(shown, color[..., ::-1]), "any program shows it"


def test_its_objects_can_be_presented() -> None:
    assert object_names(OBJECTS) == ("brick", "wedge")
    require_presentable(OBJECTS, load_station().scene.pick_region_m)


# --- from outside -----------------------------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("package", "kind", "name", "listing"),
    [
        ("hand_driver", "driver", "acme_gripper", "drivers"),
        ("goal_model", "goal-model", "acme", "goal-models"),
        ("detector", "detector", "acme", "detectors"),
    ],
)
def test_a_package_is_installed_listed_checked_and_tested_from_outside(
    tmp_path: Path, package: str, kind: str, name: str, listing: str
) -> None:
    """In an environment of its own over this one, in another folder."""
    venv = tmp_path / "venv"
    site = venv / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
    _said([sys.executable, "-m", "venv", "--without-pip", str(venv)], tmp_path)
    beside = [str(EXAMPLES.parent), *(path for path in sys.path if path.endswith("site-packages"))]
    (site / "beside.pth").write_text("\n".join(beside))
    python, source = str(venv / "bin" / "python"), tmp_path / "source"
    _copied(EXAMPLES / package, source)
    install_it = ["uv", "pip", "install", "--quiet", "--offline", "--no-deps", "--no-build-isolation"]
    _said([*install_it, "--python", python, str(source)], tmp_path)
    assert name in _said([python, "-m", "cell", listing], tmp_path)
    assert " passed" in _said([python, "-m", "vlad_cell.testing", kind, name], tmp_path)
    (test,) = source.glob("test_*.py")
    assert " passed" in _said([python, "-m", "pytest", "-p", "no:cacheprovider", str(test)], tmp_path)


def _copied(package: Path, to: Path) -> None:
    """Only what is the package's: no folder that a build left."""
    to.mkdir()
    for file in package.iterdir():
        if file.is_file():
            (to / file.name).write_bytes(file.read_bytes())


def _said(command: list[str], folder: Path) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=200, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout

"""The packages of docs/examples: a driver (its contract: tests/contracts), a goal-image model, objects."""

from __future__ import annotations

import tomllib
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.baselines.flat import flat_object
from bus.messages import CameraModel, Frame
from cell.pick.picture import as_picture
from config.load import load_station
from docs.examples.goal_model.acme_model import Crosswise
from docs.examples.pixel import pixel_of
from drivers.node import registry as drivers
from drivers.sim.objects import object_names, require_presentable
from perception.goal.imagine import Conversation
from perception.models import Models
from perception.models import registry as models
from perception.proposal import propose

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
STATION = load_station()
CAMERA = CameraModel(width=320, height=180, fx=250.0, fy=250.0, cx=160.0, cy=90.0)
BLANK = Frame(stamp_ns=1, color=np.zeros((180, 320, 3), np.uint8), depth_m=np.ones((180, 320), np.float32),
              color_camera=CAMERA, depth_camera=CAMERA, color_from_depth=np.eye(4))  # fmt: skip


@pytest.mark.parametrize(("folder", "group"), [("hand_driver", drivers.GROUP), ("goal_model", models.GROUP)])
def test_a_package_names_its_entry_point(folder: str, group: str) -> None:
    project = tomllib.loads((EXAMPLES / folder / "pyproject.toml").read_text())["project"]
    (target,) = project["entry-points"][group].values()
    module, _, name = target.partition(":")
    assert callable(getattr(import_module(f"docs.examples.{folder}.{module}"), name))


def test_the_model_lays_its_rod_across_the_narrow_side() -> None:
    """A bar, 40 x 130 mm at 1 mm a pixel, turned by 30 degrees."""
    color, mask = np.full((360, 480, 3), 170, np.uint8), np.zeros((360, 480), np.uint8)
    corners = cv2.boxPoints(((240, 180), (130, 40), 30)).astype(int)
    cv2.fillPoly(color, [corners], (40, 90, 200))
    cv2.fillPoly(mask, [corners], 1)
    model = Crosswise(STATION)
    proposal = propose(
        Conversation(model, lambda reply: None), flat_object(color, mask > 0, 0.001, STATION), Models(model), STATION
    )
    ends = proposal.ends[0]
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(0.040, abs=0.006)


def test_a_client_without_any_package_finds_the_pixel_of_a_coloured_thing() -> None:
    """A camera's picture: noise, a lamp's reflex, and the larger of two orange things is hollow."""
    color = np.full((180, 320, 3), 150, np.uint8)
    color[20:30, 20:30] = (20, 90, 230)
    cv2.circle(color, (200, 100), 30, (20, 90, 230), 8)
    noisy = np.clip(color + np.random.default_rng(1).normal(0, 4, color.shape), 0, 255).astype(np.uint8)
    frame = BLANK.model_copy(update={"color": noisy[..., ::-1]})
    u, v = pixel_of(as_picture(frame).png, "orange")
    assert tuple(color[v, u]) == (20, 90, 230)
    assert abs(np.hypot(u - 200, v - 100) - 30) < 5
    with pytest.raises(ValueError, match="nothing blue"):
        pixel_of(as_picture(frame).png, "blue")


def test_its_objects_can_be_presented() -> None:
    assert object_names(EXAMPLES / "objects") == ("brick", "wedge")
    require_presentable(EXAMPLES / "objects", STATION.scene.pick_region_m)

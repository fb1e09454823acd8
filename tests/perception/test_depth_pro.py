"""Depth Pro through the real transformers code, on a tiny untrained model: units, shapes and errors, not skill."""

from __future__ import annotations

import json
import shutil
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import ConfigError, CycleFailure
from perception.models.depth_pro import DepthPro

IMAGE = np.random.default_rng(0).integers(0, 255, (48, 80, 3), dtype=np.uint8)
PATCH = 32
BACKBONE = {
    "model_type": "dinov2", "hidden_size": 16, "num_hidden_layers": 4, "num_attention_heads": 2, "mlp_ratio": 1,
    "image_size": PATCH, "patch_size": 8, "out_features": ["stage4"], "reshape_hidden_states": False,
}  # fmt: skip


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A model that believes in about 60 degrees, and in different depths for different pixels."""
    reason = "the extra vlad-cell[models] is not installed"
    torch, _, hf = (pytest.importorskip(name, reason=reason) for name in ("torch", "torchvision", "transformers"))
    torch.manual_seed(0)
    config = hf.DepthProConfig(
        fusion_hidden_size=16, patch_size=PATCH, scaled_images_ratios=[0.5, 1.0],
        scaled_images_overlap_ratios=[0.0, 0.2], scaled_images_feature_dims=[16, 16], intermediate_hook_ids=[2, 0],
        intermediate_feature_dims=[16, 16], image_model_config=BACKBONE, patch_model_config=BACKBONE,
        fov_model_config=BACKBONE, use_fov_model=True, num_fov_head_layers=1,
    )  # fmt: skip
    folder = tmp_path_factory.mktemp("depth_pro")
    model = hf.DepthProForDepthEstimation(config)
    model.head.layers[-2].bias.data.fill_(0.5)
    model.fov_model.head.layers[-1].bias.data.fill_(60.0)
    model.save_pretrained(folder)
    hf.DepthProImageProcessor(size={"height": 2 * PATCH, "width": 2 * PATCH}).save_pretrained(folder)
    return str(folder)


def test_depth_is_a_positive_finite_image_of_the_same_size(weights: str) -> None:
    depth_m, focal_px = DepthPro(weights).estimate(IMAGE)
    assert depth_m.shape == IMAGE.shape[:2]
    assert depth_m.dtype == np.float32
    assert np.isfinite(depth_m).all()
    assert (depth_m > 0).all()
    assert depth_m.std() > 0
    assert isinstance(focal_px, float)
    assert 50 < focal_px < 100


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_depth_grows_with_a_known_focal_length(factor: float, weights: str) -> None:
    model = DepthPro(weights)
    believed = model.estimate(IMAGE)
    known = model.estimate(IMAGE, focal_px=factor * believed.focal_px)
    assert known.focal_px == factor * believed.focal_px
    assert known.depth_m.dtype == np.float32
    np.testing.assert_allclose(known.depth_m, factor * believed.depth_m, rtol=1e-5)


def test_the_same_image_has_the_same_depth(weights: str) -> None:
    first, second = DepthPro(weights), DepthPro(weights)
    once = first.estimate(IMAGE)
    for again in (first.estimate(IMAGE), second.estimate(IMAGE)):
        np.testing.assert_array_equal(again.depth_m, once.depth_m)
        assert again.focal_px == once.focal_px


def test_a_model_without_focal_length_is_refused(weights: str, tmp_path: Path) -> None:
    shutil.copytree(weights, tmp_path, dirs_exist_ok=True)
    config = json.loads((tmp_path / "config.json").read_text()) | {"use_fov_model": False}
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(ConfigError, match="no focal length"):
        DepthPro(str(tmp_path))


def test_an_impossible_focal_length_is_no_estimate(weights: str) -> None:
    model = DepthPro(weights)
    model._model.fov_model.head.layers[-1].bias.data.fill_(-60.0)
    with pytest.raises(CycleFailure, match="focal length of -") as failure:
        model.estimate(IMAGE)
    assert failure.value.failure is Code.MODEL_BAD_IMAGE


@pytest.mark.usefixtures("weights")
@pytest.mark.parametrize("name", ["nothing", "an/unknown-hub-id"])
def test_weights_that_are_not_there_are_named(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=f"Cannot load the weights '{name}'"):
        DepthPro(name)


@pytest.mark.parametrize("package", ["torch", "torchvision", "transformers"])
def test_a_missing_package_is_named_with_its_cure(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "perception.models.transformers.find_spec", lambda name: None if name == package else find_spec("json")
    )
    with pytest.raises(ConfigError, match="depth estimator 'depth_pro' needs torch") as refusal:
        DepthPro("anything")
    assert "uv pip install 'vlad-cell[models]'" in refusal.value.advice

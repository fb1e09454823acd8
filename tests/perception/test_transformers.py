"""SAM and Depth Pro through the real transformers code, on tiny models that the tests make: shapes, not skill."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.errors import ConfigError
from perception.models.depth_pro import DepthPro
from perception.models.sam import Sam
from perception.models.transformers import PACKAGES, require

installed = pytest.mark.skipif(
    any(find_spec(name) is None for name in PACKAGES), reason="the extra vlad-cell[models] is not installed"
)
pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]
IMAGE = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)


@pytest.fixture(scope="module", params=["sam", "sam2"])
def sam_weights(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch, transformers = require("this test")
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp(request.param)
    {"sam": _save_sam, "sam2": _save_sam2}[request.param](transformers, folder)
    return folder


def _save_sam(transformers: Any, folder: Path) -> None:
    vision = transformers.SamVisionConfig(
        hidden_size=16, num_hidden_layers=1, num_attention_heads=2, image_size=64, patch_size=16, output_channels=16,
        mlp_dim=16, window_size=2, global_attn_indexes=[0], num_pos_feats=8,
    )  # fmt: skip
    prompt = transformers.SamPromptEncoderConfig(
        hidden_size=16, image_size=64, patch_size=16, mask_input_channels=4, image_embedding_size=4
    )
    decoder = transformers.SamMaskDecoderConfig(
        hidden_size=16, mlp_dim=16, num_hidden_layers=1, num_attention_heads=2, iou_head_hidden_dim=16
    )
    config = transformers.SamConfig(
        vision_config=vision.to_dict(), prompt_encoder_config=prompt.to_dict(), mask_decoder_config=decoder.to_dict()
    )
    transformers.SamModel(config).save_pretrained(folder)
    images = transformers.SamImageProcessor(size={"longest_edge": 64}, pad_size={"height": 64, "width": 64})
    transformers.SamProcessor(images).save_pretrained(folder)


def _save_sam2(transformers: Any, folder: Path) -> None:
    backbone = transformers.Sam2HieraDetConfig(
        hidden_size=8, num_attention_heads=1, image_size=[64, 64], window_positional_embedding_background_size=[2, 2],
        blocks_per_stage=[1, 1, 1, 1], embed_dim_per_stage=[8, 16, 32, 64], num_attention_heads_per_stage=[1, 1, 2, 2],
        window_size_per_stage=[8, 4, 2, 2], global_attention_blocks=[],
    )  # fmt: skip
    vision = transformers.Sam2VisionConfig(
        backbone_config=backbone, backbone_channel_list=[64, 32, 16, 8], fpn_hidden_size=16,
        backbone_feature_sizes=[[16, 16], [8, 8], [4, 4]],
    )  # fmt: skip
    prompt = transformers.Sam2PromptEncoderConfig(hidden_size=16, image_size=64, patch_size=16, mask_input_channels=4)
    decoder = transformers.Sam2MaskDecoderConfig(
        hidden_size=16, mlp_dim=16, num_hidden_layers=1, num_attention_heads=2, iou_head_hidden_dim=16
    )
    config = transformers.Sam2Config(vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=decoder)
    transformers.Sam2Model(config).save_pretrained(folder)
    images = transformers.Sam2ImageProcessor(size={"height": 64, "width": 64}, mask_size={"height": 16, "width": 16})
    transformers.Sam2Processor(images).save_pretrained(folder)


@pytest.fixture(scope="module")
def depth_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch, transformers = require("this test")
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("depth_pro")
    backbone = {
        "model_type": "dinov2", "hidden_size": 16, "num_hidden_layers": 4, "num_attention_heads": 2,
        "intermediate_size": 16, "image_size": 32, "patch_size": 8, "mlp_ratio": 1, "out_features": ["stage4"],
        "reshape_hidden_states": False,
    }  # fmt: skip
    config = transformers.DepthProConfig(
        fusion_hidden_size=16, patch_size=32, scaled_images_ratios=[0.5, 1.0], scaled_images_overlap_ratios=[0.0, 0.2],
        scaled_images_feature_dims=[16, 16], intermediate_hook_ids=[2, 0], intermediate_feature_dims=[16, 16],
        image_model_config=backbone, patch_model_config=backbone, fov_model_config=backbone, use_fov_model=True,
        num_fov_head_layers=1,
    )  # fmt: skip
    transformers.DepthProForDepthEstimation(config).save_pretrained(folder)
    transformers.DepthProImageProcessor(size={"height": 64, "width": 64}).save_pretrained(folder)
    return folder


@installed
def test_sam_masks_what_a_box_and_a_point_prompt(sam_weights: Path) -> None:
    sam = Sam(str(sam_weights))
    for ask in (lambda: sam.by_box(IMAGE, (10, 10, 50, 40)), lambda: sam.by_point(IMAGE, (30, 20))):
        mask = ask()
        assert mask.shape == IMAGE.shape[:2] and mask.dtype == np.bool_ and mask.any()
        np.testing.assert_array_equal(mask, ask())


@installed
def test_only_sam_3_reads_words(sam_weights: Path) -> None:
    with pytest.raises(ConfigError, match="no words"):
        Sam(str(sam_weights)).by_text(IMAGE, "the cup")


@installed
def test_weights_of_another_kind_are_refused(depth_weights: Path) -> None:
    with pytest.raises(ConfigError, match="depth_pro"):
        Sam(str(depth_weights))


@installed
@pytest.mark.parametrize("kind", [Sam, DepthPro])
def test_missing_weights_are_a_clear_error(kind: type, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="Cannot load the weights"):
        kind(str(tmp_path / "nothing"))


@installed
def test_depth_pro_gives_metres_and_takes_a_known_focal_length(depth_weights: Path) -> None:
    model = DepthPro(str(depth_weights))
    believed = model.estimate(IMAGE)
    assert believed.depth_m.shape == IMAGE.shape[:2] and believed.depth_m.dtype == np.float32
    assert np.isfinite(believed.depth_m).all() and (believed.depth_m > 0).all()
    known = model.estimate(IMAGE, focal_px=2 * believed.focal_px)
    np.testing.assert_allclose(known.depth_m, 2 * believed.depth_m, rtol=1e-5)


def test_without_the_packages_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perception.models.transformers.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"vlad-cell\[models\]"):
        Sam("anything")

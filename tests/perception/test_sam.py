"""Every family of SAM through the real transformers code, on tiny untrained models: shapes and errors, not skill."""

from __future__ import annotations

import json
import shutil
import string
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from bus.codes import Code
from bus.errors import ConfigError, CycleFailure
from perception.models.sam import Sam

IMAGE = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
SIDE = 64
DECODER = {
    "hidden_size": 16, "mlp_dim": 16, "num_hidden_layers": 1, "num_attention_heads": 2, "iou_head_hidden_dim": 16,
}  # fmt: skip
PROMPTS: dict[str, Callable[[Sam], npt.NDArray[np.bool_]]] = {
    "box": lambda sam: sam.by_box(IMAGE, (10, 10, 50, 40)),
    "text": lambda sam: sam.by_text(IMAGE, "a cup"),
}


def tiny_sam(hf: Any, folder: Path) -> None:
    vision = {
        "hidden_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2, "image_size": SIDE, "patch_size": 16,
        "output_channels": 16, "mlp_dim": 16, "window_size": 2, "global_attn_indexes": [0], "num_pos_feats": 8,
    }  # fmt: skip
    prompt = {"hidden_size": 16, "image_size": SIDE, "image_embedding_size": 4, "mask_input_channels": 4}
    config = hf.SamConfig(vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=DECODER)
    hf.SamModel(config).save_pretrained(folder)
    images = hf.SamImageProcessor(size={"longest_edge": SIDE}, pad_size={"height": SIDE, "width": SIDE})
    hf.SamProcessor(images).save_pretrained(folder)


def tiny_sam2(hf: Any, folder: Path) -> None:
    backbone = hf.Sam2HieraDetConfig(
        hidden_size=8, num_attention_heads=1, image_size=[SIDE, SIDE], blocks_per_stage=[1, 1, 1, 1],
        embed_dim_per_stage=[8, 16, 32, 64], num_attention_heads_per_stage=[1, 1, 1, 1],
        window_size_per_stage=[2, 2, 2, 2], global_attention_blocks=[],
    )  # fmt: skip
    vision = hf.Sam2VisionConfig(
        backbone_config=backbone, backbone_channel_list=[64, 32, 16, 8], fpn_hidden_size=16,
        backbone_feature_sizes=[[16, 16], [8, 8], [4, 4]],
    )  # fmt: skip
    prompt = {"hidden_size": 16, "image_size": SIDE, "patch_size": 16, "mask_input_channels": 4}
    config = hf.Sam2Config(vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=DECODER)
    hf.Sam2Model(config).save_pretrained(folder)
    hf.Sam2Processor(hf.Sam2ImageProcessor(size={"height": SIDE, "width": SIDE})).save_pretrained(folder)


def tiny_sam3_model(hf: Any) -> Any:
    """Every query scores 0.98: an untrained one finds nothing."""
    backbone = hf.Sam3VisionConfig().backbone_config.__class__(
        hidden_size=16, intermediate_size=16, num_hidden_layers=1, num_attention_heads=2, image_size=56, patch_size=14,
        window_size=2, global_attn_indexes=[0], pretrain_image_size=28,
    )  # fmt: skip
    vision = hf.Sam3VisionConfig(
        backbone_config=backbone, fpn_hidden_size=16, backbone_feature_sizes=[[16, 16], [8, 8], [4, 4]]
    )
    text = hf.CLIPTextConfig(
        vocab_size=256, hidden_size=16, intermediate_size=16, projection_dim=16, num_hidden_layers=1,
        num_attention_heads=2, max_position_embeddings=32, bos_token_id=0, eos_token_id=1,
    )  # fmt: skip
    width = {"hidden_size": 16, "num_attention_heads": 2}
    layer = {**width, "num_layers": 1, "intermediate_size": 16}
    config = hf.Sam3Config(
        vision_config=vision, text_config=text, geometry_encoder_config=layer, detr_encoder_config=layer,
        detr_decoder_config={**layer, "num_queries": 4}, mask_decoder_config={**width, "num_upsampling_stages": 2},
    )  # fmt: skip
    model = hf.Sam3Model(config)
    model.detr_decoder.presence_head.layer3.bias.data.fill_(10.0)
    for projection in (model.dot_product_scoring.text_proj, model.dot_product_scoring.query_proj):
        projection.weight.data.zero_()
        projection.bias.data.fill_(1.0)
    return model


def save_sam3_processor(hf: Any, folder: Path) -> None:
    letters = [letter + end for letter in string.ascii_lowercase for end in ("", "</w>")]
    vocabulary = {token: index for index, token in enumerate(["<|startoftext|>", "<|endoftext|>", *letters])}
    images = hf.Sam3ImageProcessor(size={"height": 56, "width": 56}, mask_size={"height": 16, "width": 16})
    hf.Sam3Processor(images, hf.CLIPTokenizer(vocab=vocabulary, merges=[])).save_pretrained(folder)


def tiny_sam3(hf: Any, folder: Path) -> None:
    tiny_sam3_model(hf).save_pretrained(folder)
    save_sam3_processor(hf, folder)


def tiny_sam3_video(hf: Any, folder: Path) -> None:
    """As the hub's SAM 3: detector and tracker in one folder, of which `Sam` takes the detector."""
    detector = tiny_sam3_model(hf)
    tracker = hf.Sam3TrackerVideoConfig(
        vision_config=detector.config.vision_config.to_dict(), image_size=56, mask_decoder_config=DECODER,
        prompt_encoder_config={"hidden_size": 16, "image_size": 56, "patch_size": 14, "mask_input_channels": 4},
        memory_attention_hidden_size=16, memory_attention_num_layers=1, memory_attention_feed_forward_hidden_size=16,
        memory_encoder_hidden_size=16, memory_encoder_output_channels=8, mask_downsampler_embed_dim=16,
        memory_fuser_embed_dim=16, memory_fuser_intermediate_dim=16, memory_fuser_num_layers=1,
        memory_attention_rope_feat_sizes=[4, 4],
    )  # fmt: skip
    video = hf.Sam3VideoModel(
        hf.Sam3VideoConfig(detector_config=detector.config.to_dict(), tracker_config=tracker.to_dict())
    )
    video.detector_model.load_state_dict(detector.state_dict())
    video.save_pretrained(folder)
    save_sam3_processor(hf, folder)


BUILDERS = {"sam": tiny_sam, "sam2": tiny_sam2, "sam3": tiny_sam3, "sam3_video": tiny_sam3_video}
READING = ("sam3", "sam3_video")
ASKED = [(kind, prompt) for kind in BUILDERS for prompt in PROMPTS if prompt != "text" or kind in READING]


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], str]:
    """The folder of a kind's tiny model, made when first asked for."""
    reason = "the extra vlad-cell[models] is not installed"
    torch, _, hf = (pytest.importorskip(name, reason=reason) for name in ("torch", "torchvision", "transformers"))
    made: dict[str, Path] = {}

    def of(kind: str) -> str:
        if kind not in made:
            torch.manual_seed(0)
            made[kind] = tmp_path_factory.mktemp(kind)
            BUILDERS[kind](hf, made[kind])
        return str(made[kind])

    return of


def transformers() -> Any:
    """The package; imported late, because it takes seconds and is an extra."""
    return import_module("transformers")


@pytest.mark.parametrize(("kind", "prompt"), ASKED)
def test_every_prompt_gives_one_mask_of_the_images_size(kind: str, prompt: str, weights: Callable[[str], str]) -> None:
    mask = PROMPTS[prompt](Sam(weights(kind)))
    assert mask.shape == IMAGE.shape[:2]
    assert mask.dtype == np.bool_
    assert mask.any()


@pytest.mark.parametrize("kind", BUILDERS)
def test_the_same_question_has_the_same_answer(kind: str, weights: Callable[[str], str]) -> None:
    first, second = Sam(weights(kind)), Sam(weights(kind))
    for prompt in (prompt for asked, prompt in ASKED if asked == kind):
        np.testing.assert_array_equal(PROMPTS[prompt](first), PROMPTS[prompt](first))
        np.testing.assert_array_equal(PROMPTS[prompt](first), PROMPTS[prompt](second))


@pytest.mark.parametrize("kind", ["sam", "sam2"])
def test_words_are_refused_by_a_model_that_reads_none(kind: str, weights: Callable[[str], str]) -> None:
    with pytest.raises(ConfigError, match=f"{kind!r} model understands no words") as refusal:
        Sam(weights(kind)).by_text(IMAGE, "a cup")
    assert "SAM 3" in refusal.value.advice


@pytest.mark.parametrize("prompt", PROMPTS)
def test_no_instance_is_no_object(prompt: str, weights: Callable[[str], str]) -> None:
    with pytest.raises(CycleFailure) as failure:
        PROMPTS[prompt](Sam(weights("sam3"), min_score=1.0))
    assert failure.value.failure is Code.TARGET_NOT_FOUND


@pytest.mark.parametrize("kind", ["sam", "sam2"])
def test_an_empty_mask_is_no_object(kind: str, weights: Callable[[str], str], monkeypatch: pytest.MonkeyPatch) -> None:
    sam = Sam(weights(kind))
    processor = {"sam": transformers().SamProcessor, "sam2": transformers().Sam2Processor}[kind]
    whole = processor.post_process_masks
    monkeypatch.setattr(processor, "post_process_masks", lambda *given: [mask.zero_() for mask in whole(*given)])
    with pytest.raises(CycleFailure) as failure:
        sam.by_box(IMAGE, (10, 10, 50, 40))
    assert failure.value.failure is Code.TARGET_NOT_FOUND


@pytest.mark.usefixtures("weights")
@pytest.mark.parametrize("name", ["nothing", "an/unknown-hub-id"])
def test_weights_that_are_not_there_are_named(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=f"Cannot load the weights '{name}'"):
        Sam(name)


def test_a_torn_configuration_is_a_clear_error(weights: Callable[[str], str], tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text(Path(weights("sam"), "config.json").read_text()[:50])
    with pytest.raises(ConfigError, match="Cannot load the weights"):
        Sam(str(tmp_path))


@pytest.mark.usefixtures("weights")
def test_weights_of_another_kind_are_refused(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text('{"model_type": "dinov2"}')
    with pytest.raises(ConfigError, match="'dinov2' model"):
        Sam(str(tmp_path))


@pytest.mark.parametrize("package", ["torch", "torchvision", "transformers"])
def test_a_missing_package_is_named_with_its_cure(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "perception.models.transformers.find_spec", lambda name: None if name == package else find_spec("json")
    )
    with pytest.raises(ConfigError, match="segmenter 'sam' needs torch") as refusal:
        Sam("anything")
    assert "uv pip install 'vlad-cell[models]'" in refusal.value.advice


def damaged(weights: str, folder: Path, damage: Callable[[Path], object]) -> str:
    """A copy of the weights to which something was done."""
    shutil.copytree(weights, folder, dirs_exist_ok=True)
    damage(folder)
    return str(folder)


def shorten(folder: Path) -> None:
    file = folder / "model.safetensors"
    file.write_bytes(file.read_bytes()[:1000])


def widen(folder: Path) -> None:
    config = json.loads((folder / "config.json").read_text())
    config["mask_decoder_config"]["mlp_dim"] = 32
    (folder / "config.json").write_text(json.dumps(config))


def mistype(folder: Path) -> None:
    config = json.loads((folder / "config.json").read_text())
    config["mask_decoder_config"]["mlp_dim"] = "wide"
    (folder / "config.json").write_text(json.dumps(config))


@pytest.mark.parametrize("damage", [shorten, widen, mistype])
def test_damaged_weights_are_a_clear_error(
    damage: Callable[[Path], object], weights: Callable[[str], str], tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="Cannot load the weights"):
        Sam(damaged(weights("sam2"), tmp_path, damage))


def test_weights_that_lack_tensors_are_refused_rather_than_made_up(
    weights: Callable[[str], str], tmp_path: Path
) -> None:
    files = pytest.importorskip("safetensors.torch")

    def leave_out(folder: Path) -> None:
        tensors = files.load_file(folder / "model.safetensors")
        kept = {name: tensor for name, tensor in tensors.items() if not name.startswith("mask_decoder")}
        files.save_file(kept, folder / "model.safetensors", metadata={"format": "pt"})

    with pytest.raises(ConfigError, match=r"lack \d+ tensors of a Sam2Model"):
        Sam(damaged(weights("sam2"), tmp_path, leave_out))


@pytest.mark.parametrize("kind", BUILDERS)
@pytest.mark.parametrize("precision", ["float16", "bfloat16"])
def test_weights_in_half_precision_run_in_single(
    precision: str, kind: str, weights: Callable[[str], str], tmp_path: Path
) -> None:
    torch = pytest.importorskip("torch")
    model = Sam(weights(kind))._model.to(getattr(torch, precision))
    sam = Sam(damaged(weights(kind), tmp_path, model.save_pretrained))
    assert sam._model.dtype is torch.float32
    assert PROMPTS["box"](sam).shape == IMAGE.shape[:2]


def test_a_device_that_is_not_here_is_a_clear_error(weights: Callable[[str], str]) -> None:
    with pytest.raises(ConfigError, match="cannot use the device 'abacus'"):
        Sam(weights("sam"), "abacus")


@pytest.mark.parametrize("left", [0, 32])
def test_sam_3_takes_the_instance_in_the_box_not_the_best_anywhere(
    left: int, weights: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    sam = Sam(weights("sam3"))
    torch = pytest.importorskip("torch")
    masks = torch.zeros((2, *IMAGE.shape[:2]), dtype=torch.int64)
    masks[0, 10:40, :30] = masks[1, 10:40, 32:62] = 1
    found = {"masks": masks, "scores": torch.tensor([0.9, 0.6])}
    monkeypatch.setattr(transformers().Sam3Processor, "post_process_instance_segmentation", lambda *_, **__: [found])
    boxed = sam.by_box(IMAGE, (left, 10, left + 29, 39))
    np.testing.assert_array_equal(boxed, masks[int(left > 0)].numpy() > 0)
    with pytest.raises(CycleFailure):
        sam.by_box(IMAGE, (2, 0, 8, 4))

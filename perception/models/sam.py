"""Segment Anything: masks from a box, a pixel or words. SAM, SAM 2 and SAM 3 through transformers."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import ConfigError, CycleFailure
from perception.models.transformers import loaded, loaded_model, require

_CLASSES = {
    "sam": ("SamModel", "SamProcessor"),
    "sam2": ("Sam2Model", "Sam2Processor"),
    "sam2_video": ("Sam2Model", "Sam2Processor"),
    "sam3": ("Sam3Model", "Sam3Processor"),
    "sam3_video": ("Sam3Model", "Sam3Processor"),
}
"""Model and processor by the configuration's ``model_type``; the hub's SAM 2 and 3 are labelled as video models."""
_MIN_SCORE = 0.5

Image = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]
Scores = npt.NDArray[np.float32]


class Sam:
    """One loaded model. Masks are (H, W), the best-scoring one of those it offers.

    Args:
        weights: a folder or a hub id. ``device``: ``cpu`` or ``cuda``.
        min_score: below it (0 to 1), what SAM 3 finds is no instance.

    Raises: ConfigError for missing packages, missing weights, or another kind of model.
    """

    def __init__(self, weights: str, device: str = "cpu", min_score: float = _MIN_SCORE) -> None:
        self._torch, transformers = require("The segmenter 'sam'")
        self.kind = str(loaded(weights, lambda: transformers.AutoConfig.from_pretrained(weights)).model_type)
        if self.kind not in _CLASSES:
            raise ConfigError(
                f"The weights {weights!r} are of a {self.kind!r} model.", f"Known: {', '.join(_CLASSES)}."
            )
        model, processor = (getattr(transformers, name) for name in _CLASSES[self.kind])
        self._processor = loaded(weights, lambda: processor.from_pretrained(weights))
        self._model = loaded_model(weights, model, device)
        self._device, self._min_score = device, min_score

    @property
    def reads_text(self) -> bool:
        """True for SAM 3, which accepts words."""
        return self.kind.startswith("sam3")

    def by_box(self, image: Image, box_px: tuple[float, float, float, float]) -> Mask:
        """Return the mask (H, W) of the object in a box (u0, v0, u1, v1) [px].

        Raises: CycleFailure(TARGET_NOT_FOUND).
        """
        if self.reads_text:
            found, scores = self._instances(image, input_boxes=[[list(box_px)]], input_boxes_labels=[[1]])
            return _best(found, scores * _overlaps(found, box_px))
        return self._prompted(image, input_boxes=[[list(box_px)]])

    def by_text(self, image: Image, text: str) -> Mask:
        """Return the mask (H, W) of the named object.

        Raises:
            ConfigError: SAM and SAM 2 accept no words.
            CycleFailure: TARGET_NOT_FOUND.
        """
        if not self.reads_text:
            raise ConfigError(f"A {self.kind!r} model understands no words.", "Use SAM 3, or name the target's pixel.")
        return _best(*self._instances(image, text=text))

    def _prompted(self, image: Image, **prompts: Any) -> Mask:
        """SAM and SAM 2: the best of three masks a prompt, each with its predicted overlap."""
        inputs = self._processor(images=image, return_tensors="pt", **prompts).to(self._device)
        with self._torch.inference_mode():
            outputs = self._model(**inputs)
        sizes = [inputs["original_sizes"].cpu()]
        sizes += [inputs["reshaped_input_sizes"].cpu()] if "reshaped_input_sizes" in inputs else []
        masks = self._processor.post_process_masks(outputs.pred_masks.cpu(), *sizes)[0]
        best = int(outputs.iou_scores.flatten().argmax())
        return _required(np.asarray(masks.flatten(0, 1)[best].numpy() > 0))

    def _instances(self, image: Image, **prompts: Any) -> tuple[Mask, Scores]:
        """SAM 3: all instances (n, H, W) that match the prompt, anywhere in the image, and their scores (n,)."""
        inputs = self._processor(images=image, return_tensors="pt", **prompts).to(self._device)
        with self._torch.inference_mode():
            outputs = self._model(**inputs)
        found = self._processor.post_process_instance_segmentation(
            outputs, threshold=self._min_score, mask_threshold=0.5, target_sizes=inputs["original_sizes"].tolist()
        )[0]
        masks = found["masks"].cpu().numpy() > 0
        return masks.reshape(-1, *image.shape[:2]), found["scores"].cpu().numpy()


def _overlaps(masks: Mask, box_px: tuple[float, float, float, float]) -> Scores:
    """Intersection over union (n,) of each mask and the box."""
    u0, v0, u1, v1 = (round(edge) for edge in box_px)
    box = np.zeros(masks.shape[1:], dtype=bool)
    box[max(0, v0) : v1 + 1, max(0, u0) : u1 + 1] = True
    shared, either = (masks & box).sum(axis=(1, 2)), (masks | box).sum(axis=(1, 2))
    return np.asarray(shared / np.maximum(either, 1), dtype=np.float32)


def _best(masks: Mask, scores: Scores) -> Mask:
    if not (scores > 0).any():
        raise CycleFailure(Code.TARGET_NOT_FOUND, "SAM sees nothing of the kind.")
    return _required(masks[int(scores.argmax())])


def _required(mask: Mask) -> Mask:
    if not mask.any():
        raise CycleFailure(Code.TARGET_NOT_FOUND, "SAM finds no object there.")
    return mask

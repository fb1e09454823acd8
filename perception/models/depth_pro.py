"""Depth Pro: metric depth and focal length from one colour image, through transformers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import ConfigError, CycleFailure
from perception.models.transformers import loaded, loaded_model, require


class DepthEstimate(NamedTuple):
    """A metric depth estimate.

    Attributes:
        depth_m: (H, W) z-depth. ``focal_px``: the focal length it assumes.
    """

    depth_m: npt.NDArray[np.float32]
    focal_px: float


class DepthPro:
    """One loaded Depth Pro model.

    Args:
        weights: a folder or a hub id. ``device``: ``cpu`` or ``cuda``.

    Raises: ConfigError for missing packages or weights, or weights without the focal length estimator.
    """

    def __init__(self, weights: str, device: str = "cpu") -> None:
        self._torch, transformers = require("The depth estimator 'depth_pro'")
        self._processor = loaded(weights, lambda: transformers.DepthProImageProcessor.from_pretrained(weights))
        self._model = loaded_model(weights, transformers.DepthProForDepthEstimation, device)
        if not self._model.config.use_fov_model:
            raise ConfigError(f"The weights {weights!r} estimate no focal length.", "Use them with use_fov_model.")
        self._device = device

    def estimate(self, image: npt.NDArray[np.uint8], focal_px: float | None = None) -> DepthEstimate:
        """Depth of an RGB image (H, W, 3); rescaled to ``focal_px`` [px] if given.

        Raises: CycleFailure(MODEL_BAD_IMAGE) when the estimated focal length is unusable.
        """
        inputs = self._processor(images=image, return_tensors="pt").to(self._device)
        with self._torch.inference_mode():
            outputs = self._model(**inputs)
        found = self._processor.post_process_depth_estimation(outputs, target_sizes=[image.shape[:2]])[0]
        believed_px = float(found["focal_length"])
        if not 0.0 < believed_px < np.inf:
            raise CycleFailure(Code.MODEL_BAD_IMAGE, f"Depth Pro believes in a focal length of {believed_px:.0f} px.")
        depth_m = found["predicted_depth"].cpu().numpy().astype(np.float32)
        if focal_px is None:
            return DepthEstimate(depth_m, believed_px)
        return DepthEstimate(depth_m * np.float32(focal_px / believed_px), focal_px)

"""The role of the goal-image model: three calls, as in the paper's stage 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from perception.depth import Rgbd
from perception.segment import Scene


@dataclass(frozen=True)
class RodColor:
    """The colour a rod is asked for, and found again by."""

    name: str
    rgb: tuple[int, int, int]


@dataclass(frozen=True)
class Subject:
    """What a model is shown: the image with its object, and - for models that can use it - the depth.

    Attributes:
        masked: the colour image with the background taken out (I_S of the paper).
        base_from_color: where the camera stands.
        rod: the colour to draw the rod in; nothing else in the image has it.
    """

    rgbd: Rgbd
    scene: Scene
    masked: npt.NDArray[np.uint8]
    base_from_color: Transform
    rod: RodColor


@dataclass(frozen=True)
class GoalImage:
    """An imagined goal: the image, and its depth where the model knows it.

    Attributes:
        image: (H, W, 3) RGB, of the observed image's size.
        depth_m: (H, W) z-depth, rod included; None = it must be estimated.
    """

    image: npt.NDArray[np.uint8]
    depth_m: npt.NDArray[np.float32] | None


class GoalImageModel(Protocol):
    """Imagines the rod. Each call gets the prompt it is to follow; ``name`` is recorded with every reply."""

    name: str

    def reason(self, subject: Subject, prompt: str) -> str:
        """Where and how the object can be grasped, in words (R of the paper)."""

    def direct(self, reasoning: str, prompt: str) -> str:
        """One precise, self-contained editing instruction (T2)."""

    def render(self, subject: Subject, directive: str, prompt: str) -> GoalImage:
        """The goal image (I_G): the same object, impaled by the rod."""

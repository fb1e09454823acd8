"""The words between segmentation and the models: what a model is shown, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.messages import Usage
from perception.geometry.depth import Rgbd
from perception.scene.heightmap import HeightMap
from perception.scene.segment import Scene


@dataclass(frozen=True)
class RodColor:
    """The colour a rod is asked for, and found again by."""

    name: str
    rgb: tuple[int, int, int]


@dataclass(frozen=True)
class ObservedObject:
    """What a model is shown: the image with its object, and - for models that can use it - the depth.

    Attributes:
        heights: the scene from above. ``masked``: the colour image with the background taken out (I_S of the paper).
        background: the colour it was replaced by, far from the object's own colours.
        base_from_color: where the camera stands.
        rod: the colour to draw the rod in; nothing else in the image has it.
    """

    rgbd: Rgbd
    scene: Scene
    heights: HeightMap
    masked: npt.NDArray[np.uint8]
    background: tuple[int, int, int]
    base_from_color: Transform
    rod: RodColor

    @cached_property
    def level_depth_m(self) -> npt.NDArray[np.float32]:
        """(H, W) z-depth [m] of the plane z = constant of ``base`` through the middle of the object's seen surface."""
        camera, down = self.rgbd.camera, self.base_from_color[2, :3]
        level_m = float(np.nanmedian(self.scene.points_base[self.scene.object_mask][:, 2]))
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        slope = down[0] * (u - camera.cx) / camera.fx + down[1] * (v - camera.cy) / camera.fy + down[2]
        return np.asarray((level_m - self.base_from_color[2, 3]) / slope, dtype=np.float32)


@dataclass(frozen=True)
class GoalImage:
    """An imagined goal: the image, and its depth where the model knows it.

    Attributes:
        image: (H, W, 3) RGB, in the observed image's frame.
        depth_m: (H, W) z-depth, rod included; None = it must be estimated.
    """

    image: npt.NDArray[np.uint8]
    depth_m: npt.NDArray[np.float32] | None


_NOTHING = Usage()


@dataclass(frozen=True)
class Answer:
    """What a model gave for one step: words, or a picture.

    Attributes:
        image_png: a picture of the window it was shown (`perception.geometry.window`), as it came; hosted models.
        goal: the picture in the observed image's frame; embedded models.
        attempts: how often it was asked.
    """

    text: str = ""
    image_png: bytes | None = None
    goal: GoalImage | None = None
    usage: Usage = _NOTHING
    attempts: int = 1

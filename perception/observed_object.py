"""The types between segmentation and the models: a model's input and its answer. Frames: docs/frames.md."""

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
    """The colour of a rod, used in the prompt and to segment the rod.

    Attributes:
        name: in the prompt. ``rgb``: 0 to 255.
    """

    name: str
    rgb: tuple[int, int, int]


@dataclass(frozen=True)
class ObservedObject:
    """The model's input: the image with its object and, for models that use it, the depth.

    Attributes:
        rgbd, scene: the crop around the object.
        heights: the height map around the object. ``masked``: (H, W, 3) the object on the plain background (I_S of the
            paper).
        background: colour of that background, far from the object's own colours.
        base_from_color: (4, 4) pose of the colour camera.
        rod: the colour to draw the rod in; the object does not have it.
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
    """An imagined goal: the image, and its depth if the model provides it.

    Attributes:
        image: (H, W, 3) RGB, aligned with the observed image.
        depth_m: (H, W) z-depth, rod included; None = it must be estimated.
    """

    image: npt.NDArray[np.uint8]
    depth_m: npt.NDArray[np.float32] | None


_NOTHING = Usage()


@dataclass(frozen=True)
class Answer:
    """A model's answer to one step: text, or a picture.

    Attributes:
        image_png: a picture of the window it was shown (`perception.geometry.window`), unchanged; hosted models.
        goal: the goal image, aligned with the observed image; embedded models.
        attempts: number of requests that were made.
    """

    text: str = ""
    image_png: bytes | None = None
    goal: GoalImage | None = None
    usage: Usage = _NOTHING
    attempts: int = 1

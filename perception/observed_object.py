"""The types between the scene and the models: a model's input and its answer. Frames: docs/frames.md."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.messages import Instance, Usage
from perception.geometry.depth import Rgbd
from perception.scene.scene import Scene


@dataclass(frozen=True)
class RodColor:
    """The colour of a rod, used in the prompt and to segment the rod.

    Attributes:
        name: in the prompt. ``rgb``: 0 to 255.
    """

    name: str
    rgb: tuple[int, int, int]


@dataclass(frozen=True)
class Axis:
    """An axis along which the jaw could close on an object.

    Attributes:
        ends_base: (2, 3) [m] the contacts, in ``base``. ``approach_base``: (3,) the hand's way there, of length 1.
        score: of the closing, higher is better.
    """

    ends_base: npt.NDArray[np.float64]
    approach_base: npt.NDArray[np.float64]
    score: float

    @property
    def width_m(self) -> float:
        """Distance between the contacts."""
        return float(np.linalg.norm(self.ends_base[1] - self.ends_base[0]))


@dataclass(frozen=True)
class ObservedObject:
    """The model's input: the image with its object and, for models that use it, the depth.

    Attributes:
        scene: the whole scene. ``instances``: the things in it. ``instance``: this object.
        rgbd: the crop of the colour image around the object. ``mask``: (H, W) its outline there.
        height_m: (H, W) height above the table, NaN = no depth.
        masked: (H, W, 3) the object on the plain background (I_S of the paper).
        background: colour of that background, far from the object's own colours.
        base_from_color: (4, 4) pose of the colour camera.
        rod: the colour to draw the rod in; the object does not have it.
        axes: along which the jaw could close on it, the best first; for models that imagine nothing of their own.
    """

    scene: Scene
    instances: tuple[Instance, ...]
    instance: Instance
    rgbd: Rgbd
    mask: npt.NDArray[np.bool_]
    height_m: npt.NDArray[np.float32]
    masked: npt.NDArray[np.uint8]
    background: tuple[int, int, int]
    base_from_color: Transform
    rod: RodColor
    axes: tuple[Axis, ...] = ()

    @cached_property
    def level_depth_m(self) -> npt.NDArray[np.float32]:
        """(H, W) z-depth [m] of the plane parallel to the table through the middle of the object's seen surface."""
        camera, table = self.rgbd.camera, self.scene.table
        table_from_color = table.table_from_base @ self.base_from_color
        down = table_from_color[2, :3]
        level_m = float(np.nanmedian(self.height_m[self.mask]))
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        slope = down[0] * (u - camera.cx) / camera.fx + down[1] * (v - camera.cy) / camera.fy + down[2]
        return np.asarray((level_m - table_from_color[2, 3]) / slope, dtype=np.float32)


@dataclass(frozen=True)
class PaintedRod:
    """The parts of a goal image whose maker knows them: nothing is searched for by colour, nothing moved.

    Attributes:
        rod, object: (H, W) masks.
        run: (2, 3) [m] the rod's run through the object, in the ``color`` frame; None = it follows from the masks.
        approach_base: (3,) the hand's way to it, in ``base``; None = from above, or whatever is free.
    """

    rod: npt.NDArray[np.bool_]
    object: npt.NDArray[np.bool_]
    run: npt.NDArray[np.float64] | None
    approach_base: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True)
class GoalImage:
    """An imagined goal: the image, and its depth if the model provides it.

    Attributes:
        image: (H, W, 3) RGB, aligned with the observed image.
        depth_m: (H, W) z-depth, rod included; None = it must be estimated.
        painted: its parts, if the model knows them; None = they must be found in the image.
    """

    image: npt.NDArray[np.uint8]
    depth_m: npt.NDArray[np.float32] | None
    painted: PaintedRod | None = None


_NOTHING = Usage()


@dataclass(frozen=True)
class Answer:
    """A model's answer to one step: text, or a picture.

    Attributes:
        text: in words; of ``locate`` the place in the form that the prompt asks for.
        image_png: a picture of the window it was shown (`perception.geometry.window`), unchanged; hosted models.
        goal: the goal image, aligned with the observed image; embedded models.
        usage: what a hosted model counts. ``attempts``: number of requests that were made.
    """

    text: str = ""
    image_png: bytes | None = None
    goal: GoalImage | None = None
    usage: Usage = _NOTHING
    attempts: int = 1

"""The role of a detector that another package brings: what was seen in, 6-DoF grasps out. Frames: docs/frames.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.cancel import Cancel
from bus.messages import CameraModel, Instance
from config.devices import HandSettings


@dataclass(frozen=True, eq=False)
class SeenLook:
    """One look: images of the undistorted colour camera. The arrays cannot be written to.

    Attributes:
        color: (H, W, 3) RGB. ``depth_m``: (H, W) z-depth registered to it, NaN = not measured.
        camera: its intrinsics [px]. ``base_from_camera``: (4, 4) [m].
        labels: (H, W) the number of the thing in each pixel, 0 = none: ``labels == one.number`` is its mask.
    """

    color: npt.NDArray[np.uint8]
    depth_m: npt.NDArray[np.float32]
    camera: CameraModel
    base_from_camera: Transform
    labels: npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class SeenScene:
    """The scene that the cell has seen, and which things it wants.

    Attributes:
        looks: one or several, of the same scene from different places, in the order of time.
        shown: index of the look that people are shown: a thing that is not in it is not picked.
        things: what stands in the pick region, numbered from 1 on.
        targets: the numbers of the things that may be picked; grasps of others are left out.
        base_from_table: (4, 4) [m] the table as it was seen, z along its normal.
        hand: the jaw's and the fingers' measures.
    """

    looks: tuple[SeenLook, ...]
    shown: int
    things: tuple[Instance, ...]
    targets: tuple[int, ...]
    base_from_table: Transform
    hand: HandSettings

    @property
    def look(self) -> SeenLook:
        """The look that is shown."""
        return self.looks[self.shown]


@dataclass(frozen=True, eq=False)
class FoundGrasp:
    """One grasp for a parallel hand.

    Attributes:
        base_from_tcp: (4, 4) [m]: tcp z = approach direction, tcp y = closing axis, origin between the finger pads.
        width_m: object width between the pads; the hand approaches it wider, by ``perception.approach_clearance_m``.
        score: between 0 and 1, higher is better. Below ``capture.weak_score`` the cell may look again.
        instance: number of the thing that it holds; None = the one that was seen nearest to the tcp.
    """

    base_from_tcp: Transform
    width_m: float
    score: float
    instance: int | None = None


class GraspDetector(Protocol):
    """Finds grasps. One call at a time.

    A call that raises, or gives what is no grasp, ends the cycle with DETECTOR_FAILED; one that takes longer than
    ``perception.detector_deadline_s`` with DETECTOR_TIMEOUT. A CycleFailure ends it as it says. An attribute
    ``Settings`` of the entry point, a pydantic model, checks ``[perception.settings]``.

    Attributes:
        is_deterministic: same input, same grasps, bit for bit: a replay calls it again. Otherwise it gets back the
            recorded grasps.
    """

    is_deterministic: bool

    def detect(self, seen: SeenScene, cancel: Cancel) -> Sequence[FoundGrasp]:
        """Grasps in any order. ``cancel``: set after a stop; then nobody waits for them."""

    def close(self) -> None:
        """Release memory and connections; no call follows."""

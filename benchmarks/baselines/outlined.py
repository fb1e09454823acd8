"""An object in an image without depth, with the closings that its outline allows as the axes of the embedded model.

As in `benchmarks.baselines.flat`, lengths along the line of sight are invented, so it never moves an arm.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from benchmarks.baselines.flat import flat_scene
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Rectangle
from bus.transforms import apply
from config.schema import Station
from perception.geometry.crop import Mask
from perception.geometry.lift import lift_pixels, project
from perception.goal.imagine import observed_object_of
from perception.observed_object import Axis, ObservedObject
from perception.proposal import Proposal
from perception.rectangles.outline import Closing, Jaw, closings, rectangle_along

_AXES = 12


def jaw_of(station: Station, m_per_px: float) -> Jaw:
    """The station's jaw in an image of that scale."""
    hand, room_m = station.hand, station.perception.rectangle_margin_m
    return Jaw(hand.max_width_m / m_per_px, hand.finger_width_m / m_per_px, room_m / m_per_px)


def outlined_rectangle(mask: Mask, jaw: Jaw) -> Rectangle:
    """The search alone: the best closing on an outline (H, W). Raises: CycleFailure(NO_GRASP)."""
    return _closings(mask, jaw)[0].rectangle(jaw)


def outlined_object(
    color: npt.NDArray[np.uint8], mask: Mask, jaw: Jaw, m_per_px: float, station: Station
) -> ObservedObject:
    """The masked object in a flat scene, with its best closings as axes. Raises: CycleFailure(NO_OBJECT, NO_GRASP)."""
    scene, instances = flat_scene(color, mask, m_per_px, station)
    number = int(np.bincount(scene.color_labels[mask], minlength=scene.count + 1)[1:].argmax()) + 1
    depth_m = float(np.nanmin(scene.rgbd.depth_m))
    axes = []
    for one in _closings(mask, jaw)[:_AXES]:
        ends = lift_pixels(one.ends_px(), np.full(2, depth_m), scene.rgbd.camera)
        axes.append(Axis(apply(scene.base_from_color, ends), -scene.table.base_from_table[:3, 2], one.score))
    return observed_object_of(scene, instances, number, mask, tuple(axes), max(mask.shape))[0]


def imagined_rectangle(proposal: Proposal, observed_object: ObservedObject, jaw: Jaw) -> Rectangle:
    """The rectangle of a proposal's first run, as `Closing.rectangle` draws it."""
    return rectangle_along(project(proposal.ends[0], observed_object.rgbd.camera), jaw)


def _closings(mask: Mask, jaw: Jaw) -> list[Closing]:
    found = closings(mask, jaw)
    if not found:
        raise CycleFailure(Code.NO_GRASP, "The outline has no two opposite sides.")
    return found

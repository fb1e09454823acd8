"""The evidence of a proposal, for the record: in the whole undistorted colour image and the ``color`` frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bus.messages import Evidence
from bus.transforms import apply
from perception.align.base import Shape
from perception.geometry.crop import Crop
from perception.geometry.depth import Rgbd
from perception.geometry.lift import lift, subsample_float32
from perception.observed_object import ObservedObject
from perception.proposal import Proposal

_SHOWN_POINTS = 3000
"""Most points of a cloud in the evidence."""


def evidence_of(
    rgbd: Rgbd, crop: Crop, observed_object: ObservedObject, proposal: Proposal, sample: int, agreement: float
) -> Evidence:
    """Return what led to a proposal's grasps.

    Args:
        crop: of ``rgbd`` around the object. ``sample``, ``agreement``: see `bus.messages.Evidence`.
    """
    observed_from_goal, goal_points = proposal.alignment.observed_from_goal, _points(proposal.imagined)
    rod_points = lift(proposal.parts.rod, proposal.depth_m, observed_object.rgbd.camera)
    nothing = np.zeros(rgbd.depth_m.shape, dtype=bool)
    background = np.empty_like(rgbd.color)
    background[:] = observed_object.background
    return Evidence(
        color=rgbd.color,
        object_mask=crop.back(observed_object.mask, nothing),
        goal_image=crop.back(proposal.goal.image, background),
        goal_object_mask=crop.back(proposal.parts.object, nothing),
        goal_rod_mask=crop.back(proposal.parts.rod, nothing),
        observed_points=subsample_float32(_points(proposal.observed), _SHOWN_POINTS),
        goal_points=subsample_float32(goal_points, _SHOWN_POINTS),
        aligned_points=subsample_float32(apply(observed_from_goal, goal_points), _SHOWN_POINTS),
        rod_points=subsample_float32(apply(observed_from_goal, rod_points), _SHOWN_POINTS),
        rod_ends=(proposal.ends[0][0], proposal.ends[0][1]),
        alignment=proposal.alignment,
        drift=proposal.drift,
        sample=sample,
        agreement=agreement,
    )


def _points(shape: Shape) -> npt.NDArray[np.float64]:
    """(n, 3) [m] what is seen of a shape, however little: a rod may cover most of a thin thing."""
    return lift(shape.mask, shape.depth_m, shape.camera)

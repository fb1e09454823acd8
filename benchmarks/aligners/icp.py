"""Iterative closest point, point to point, in the ``color`` frame; starts at the imagined pose with equalised sizes."""

from __future__ import annotations

import numpy as np

from perception.align.base import Fit, Shape, rms_radius_m
from perception.align.refine import Clouds, Pose
from perception.geometry.lift import subsample

_ITERATIONS = 40
_POINTS = 500


def icp(goal: Shape, observed: Shape) -> Fit:
    """Align by ICP (Besl and McKay 1992).

    The scale is the ratio of the rms radii: estimated by ICP, it would shrink the cloud.
    """
    goal_center, observed_center = goal.points.mean(axis=0), observed.points.mean(axis=0)
    clouds = Clouds(
        subsample(goal.points, _POINTS) - goal_center, subsample(observed.points, _POINTS) - observed_center
    )
    scale = rms_radius_m(observed.points) / rms_radius_m(goal.points)
    start = Pose(np.eye(3), scale, np.zeros(3))
    pose = clouds.refine(start, _ITERATIONS, relief=False, rescale=False)
    return Fit(pose.between(goal_center, observed_center), scale, 1)

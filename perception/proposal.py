"""One proposal: a rod imagined through an object, aligned to it, and the grasps that follow (paper, stages 1 to 3).

Images and points are in the ``color`` frame, grasps in ``base``; see docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Alignment, CameraModel, Drift, Grasp, Rectangle
from bus.transforms import apply
from config.schema import Station
from perception.align import align
from perception.align.base import Shape
from perception.geometry.rod import fit_line, lift_run, rectangle, rod_depth, runs
from perception.goal.depth import carried_depth, scaled_to_observed
from perception.goal.drift import NO_DRIFT, NOTHING_MOVED, measure, require_faithful
from perception.goal.drift import register as register_outlines
from perception.goal.imagine import Conversation, imagine
from perception.goal.parts import GoalParts, take_apart
from perception.grasps.rank import grasps_of_rod, rank
from perception.models import Models
from perception.observed_object import GoalImage, ObservedObject, PaintedRod

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Proposal:
    """One imagined rod, aligned to the observed object.

    Attributes:
        goal, parts, drift: the goal image, its segmentation, and its deviation from the observed image.
        depth_m: (H, W) z-depth of the goal image.
        observed, imagined: the object in the observed image and in the goal image. ``alignment``: between the two.
        ends: ends (2, 3) [m] of each run of the rod through the object, in the ``color`` frame, the widest first.
        rectangles: the runs as grasp rectangles, in the order of ``ends``.
    """

    goal: GoalImage
    parts: GoalParts
    drift: Drift
    depth_m: npt.NDArray[np.float32]
    observed: Shape
    imagined: Shape
    alignment: Alignment
    ends: tuple[Array, ...]
    rectangles: tuple[Rectangle, ...]


def propose(talk: Conversation, observed_object: ObservedObject, models: Models, station: Station) -> Proposal:
    """Imagine one rod and align it to the observed object (stages 1 to 3). Raises: CycleFailure, as `detect`."""
    goal = imagine(talk, observed_object, station)
    if goal.painted is not None and goal.depth_m is not None:
        return as_painted(goal, goal.painted, goal.depth_m, observed_object, station)
    return _carried_back(goal, observed_object, models, station)


def as_painted(
    goal: GoalImage,
    painted: PaintedRod,
    depth_m: npt.NDArray[np.float32],
    observed_object: ObservedObject,
    station: Station,
) -> Proposal:
    """Return the proposal of a model that painted into the observed image: it knows its rod, and nothing has moved."""
    rgbd, nothing = observed_object.rgbd, np.zeros_like(painted.rod)
    parts = GoalParts(painted.rod, painted.object, nothing)
    observed = Shape(observed_object.mask, nothing, rgbd.depth_m, rgbd.camera)
    imagined = Shape(parts.object, parts.rod, depth_m, rgbd.camera)
    ends = (painted.run,) if painted.run is not None else _run_ends(parts, depth_m, rgbd.camera, np.eye(4))
    rectangles = tuple(rectangle(run_ends, rgbd.camera, station) for run_ends in ends)
    return Proposal(goal, parts, NO_DRIFT, depth_m, observed, imagined, NOTHING_MOVED, ends, rectangles)


def _carried_back(goal: GoalImage, observed_object: ObservedObject, models: Models, station: Station) -> Proposal:
    """The proposal of a model that drew a picture: its parts are found, checked for drift, and carried back."""
    rgbd, settings = observed_object.rgbd, station.perception

    # Stage 1: the parts of the goal image, and its drift from the observed object.
    parts = take_apart(goal.image, observed_object, models.salient)
    observed = Shape(observed_object.mask, np.zeros_like(parts.rod), rgbd.depth_m, rgbd.camera)
    outline_fit, overlap = register_outlines(Shape(parts.object, parts.rod, rgbd.depth_m, rgbd.camera), observed.mask)
    drift = measure(goal.image, parts, observed_object, outline_fit, overlap)
    require_faithful(drift, settings.drift)

    # Stage 2: lift both objects, and align the imagined one to the observed one.
    if goal.depth_m is not None:
        depth_m = goal.depth_m
    elif models.depth is not None:
        depth_m = scaled_to_observed(models.depth.estimate(goal.image, rgbd.camera.fx).depth_m, parts, observed_object)
    else:
        depth_m = carried_depth(parts, observed_object, outline_fit)
    imagined = Shape(parts.object, parts.rod, depth_m, rgbd.camera)
    alignment = align(settings.align, imagined, observed, max_residual=settings.max_residual)

    # Stage 3: the aligned runs of the rod through the object, as rectangles.
    ends = _run_ends(parts, depth_m, rgbd.camera, alignment.observed_from_goal)
    rectangles = tuple(rectangle(run_ends, rgbd.camera, station) for run_ends in ends)
    return Proposal(goal, parts, drift, depth_m, observed, imagined, alignment, ends, rectangles)


def _run_ends(
    parts: GoalParts, depth_m: npt.NDArray[np.float32], camera: CameraModel, observed_from_goal: Transform
) -> tuple[Array, ...]:
    """Ends (2, 3) [m] of the rod's runs, carried back. Raises: CycleFailure(MODEL_NO_ROD) when there are none."""
    line = fit_line(parts.rod)
    inverse_depth = rod_depth(line, parts.rod, depth_m)
    ends = tuple(
        apply(observed_from_goal, lift_run(line, run, inverse_depth, camera))
        for run in runs(line, parts.rod, parts.object)
    )
    if not ends:
        raise CycleFailure(Code.MODEL_NO_ROD, "The rod in the goal image does not pass through the object.")
    return ends


def grasps_of(proposal: Proposal, observed_object: ObservedObject, station: Station) -> tuple[Grasp, ...]:
    """Return the ranked grasps of every run. Raises: CycleFailure(NO_GRASP), with the runs' widths [mm]."""
    grasps: list[Grasp] = []
    painted = proposal.goal.painted
    approach_base = painted.approach_base if painted is not None else None
    for index, run_ends in enumerate(proposal.ends):
        ends_base = apply(observed_object.base_from_color, run_ends)
        grasps += grasps_of_rod(ends_base, index, observed_object, station, approach_base)
    if not grasps:
        widths = ", ".join(f"{np.linalg.norm(ends[1] - ends[0]) * 1e3:.0f}" for ends in proposal.ends)
        raise CycleFailure(
            Code.NO_GRASP, f"The imagined rod crosses the object nowhere the jaw can close on (runs of {widths} mm)."
        )
    return rank(grasps, station)

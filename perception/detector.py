"""VLAD-Grasp (paper, Algorithm 1) on one screen: imagine a rod, align it to the object, derive grasps.

Images and points are in the ``color`` frame, grasps in ``base``; see docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Alignment, Detections, Drift, Evidence, Grasp, ModelReply, Observation, Rectangle
from bus.transforms import apply
from config.schema import Station
from perception.align import align
from perception.align.base import Shape
from perception.geometry.crop import Crop
from perception.geometry.depth import Rgbd, register
from perception.geometry.lift import lift, subsample_float32
from perception.geometry.rod import fit_line, lift_run, rectangle, rod_depth, runs
from perception.goal.depth import carried_depth, scaled_to_observed
from perception.goal.drift import measure, require_faithful
from perception.goal.drift import register as register_outlines
from perception.goal.imagine import Conversation, OnReply, imagine, observed_object_of
from perception.goal.parts import GoalParts, take_apart
from perception.goal.target import choose
from perception.grasps.rank import grasps_of_rod, rank
from perception.models import Models
from perception.observed_object import GoalImage, ObservedObject
from perception.rectangles.metric import matches
from perception.scene.heightmap import MARGIN_M
from perception.scene.segment import Scene, segment

Array = npt.NDArray[np.float64]

_SHOWN_POINTS = 3000
"""Most points of a cloud in the evidence."""


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


def detect(
    observation: Observation, station: Station, models: Models, on_reply: OnReply, cancel: Cancel | None = None
) -> Detections:
    """Detect ranked grasps of the target in the pick region, with their evidence. Pure, except for the models.

    Args:
        on_reply: called with the record of every call to the goal-image model, as soon as the call ends.
        cancel: a stop request; checked before each proposal and each call.

    Raises:
        CycleFailure: NO_OBJECT, NOT_SEEN, TARGET_NOT_FOUND, NO_GRASP, MODEL_*, SPEND_LIMIT or STOPPED. With several
            proposals, one that succeeds is enough.
    """
    cancel, base_from_color = cancel or Cancel(), observation.view.base_from_color
    cancel.raise_if_set("detect")
    models.imaginer.begin()
    rgbd = register(observation.frame)
    talk = Conversation(models.imaginer, on_reply, cancel=cancel)
    scene = choose(segment(rgbd, base_from_color, station), rgbd.color, talk, station, models.sam)
    scene = models.refined(scene, rgbd.color)
    _require_depth(rgbd, scene)
    crop = Crop.around(scene.object_mask, _margin_px(rgbd, scene))
    observed_object = observed_object_of(crop.rgbd(rgbd), scene.within(crop), base_from_color)
    found: list[tuple[tuple[Grasp, ...], Proposal, int]] = []
    failures: list[CycleFailure] = []
    for sample in range(station.perception.imagine.samples):
        cancel.raise_if_set("detect")
        try:
            proposal = propose(replace(talk, sample=sample), observed_object, models, station)
            found.append((grasps_of(proposal, observed_object, station), proposal, sample))
        except CycleFailure as failure:
            if failure.failure is Code.STOPPED:
                raise
            failures.append(failure)
    if not found:
        raise failures[0]
    grasps, proposal, sample = max(found, key=lambda one: one[0][0].score)
    agree = [_same_place(proposal, other) for _, other, _ in found]
    rectangles = tuple(rectangle(ends, rgbd.camera, station) for ends in proposal.ends)
    agreement = sum(agree) / station.perception.imagine.samples
    evidence = _evidence(rgbd, crop, observed_object, proposal, sample, agreement)
    return Detections(rectangles=rectangles, grasps=grasps, evidence=evidence)


def propose(talk: Conversation, observed_object: ObservedObject, models: Models, station: Station) -> Proposal:
    """Imagine one rod and align it to the observed object (stages 1 to 3). Raises: CycleFailure, as `detect`."""
    rgbd, settings = observed_object.rgbd, station.perception

    # Stage 1: the goal image, and its drift from the observed object.
    goal = imagine(talk, observed_object, station)
    parts = take_apart(goal.image, observed_object)
    line = fit_line(parts.rod)
    observed = Shape(observed_object.scene.object_mask, np.zeros_like(parts.rod), rgbd.depth_m, rgbd.camera)
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
    inverse_depth = rod_depth(line, parts.rod, depth_m)
    ends = tuple(
        apply(alignment.observed_from_goal, lift_run(line, run, inverse_depth, rgbd.camera))
        for run in runs(line, parts.rod, parts.object)
    )
    if not ends:
        raise CycleFailure(Code.MODEL_NO_ROD, "The rod in the goal image does not pass through the object.")
    rectangles = tuple(rectangle(run_ends, rgbd.camera, station) for run_ends in ends)
    return Proposal(goal, parts, drift, depth_m, observed, imagined, alignment, ends, rectangles)


def grasps_of(proposal: Proposal, observed_object: ObservedObject, station: Station) -> tuple[Grasp, ...]:
    """The ranked grasps of every run. Raises: CycleFailure(NO_GRASP), with the runs' widths [mm]."""
    grasps: list[Grasp] = []
    for index, run_ends in enumerate(proposal.ends):
        ends_base = apply(observed_object.base_from_color, run_ends)
        grasps += grasps_of_rod(ends_base, index, observed_object, station)
    if not grasps:
        widths = ", ".join(f"{np.linalg.norm(ends[1] - ends[0]) * 1e3:.0f}" for ends in proposal.ends)
        raise CycleFailure(
            Code.NO_GRASP, f"The imagined rod crosses the object nowhere the jaw can close on (runs of {widths} mm)."
        )
    return rank(grasps, station)


def _same_place(chosen: Proposal, other: Proposal) -> bool:
    return any(matches(one, another) for one in chosen.rectangles for another in other.rectangles)


def _require_depth(rgbd: Rgbd, scene: Scene) -> None:
    """Raises: CycleFailure(NOT_SEEN) when no pixel of the outline, which a segmenter may have redrawn, has depth."""
    if not np.isfinite(rgbd.depth_m[scene.object_mask]).any():
        pixels = int(scene.object_mask.sum())
        raise CycleFailure(
            Code.NOT_SEEN, f"The camera measures no depth on the object (outline of {pixels} pixels): glass, or black?"
        )


def _margin_px(rgbd: Rgbd, scene: Scene) -> int:
    """Margin around the object [px] that contains everything the hand may collide with."""
    nearest_m = float(np.nanmin(rgbd.depth_m[scene.object_mask]))
    return int(np.ceil(MARGIN_M * rgbd.camera.fx / nearest_m))


def _evidence(
    rgbd: Rgbd, crop: Crop, observed_object: ObservedObject, proposal: Proposal, sample: int, agreement: float
) -> Evidence:
    """The evidence of the chosen proposal, in the whole undistorted colour image and the ``color`` frame."""
    observed_from_goal, goal_points = proposal.alignment.observed_from_goal, proposal.imagined.points
    rod_points = lift(proposal.parts.rod, proposal.depth_m, observed_object.rgbd.camera)
    nothing = np.zeros(rgbd.depth_m.shape, dtype=bool)
    background = np.empty_like(rgbd.color)
    background[:] = observed_object.background
    return Evidence(
        color=rgbd.color,
        object_mask=crop.back(observed_object.scene.object_mask, nothing),
        goal_image=crop.back(proposal.goal.image, background),
        goal_object_mask=crop.back(proposal.parts.object, nothing),
        goal_rod_mask=crop.back(proposal.parts.rod, nothing),
        observed_points=subsample_float32(proposal.observed.points, _SHOWN_POINTS),
        goal_points=subsample_float32(goal_points, _SHOWN_POINTS),
        aligned_points=subsample_float32(apply(observed_from_goal, goal_points), _SHOWN_POINTS),
        rod_points=subsample_float32(apply(observed_from_goal, rod_points), _SHOWN_POINTS),
        rod_ends=(proposal.ends[0][0], proposal.ends[0][1]),
        alignment=proposal.alignment,
        drift=proposal.drift,
        sample=sample,
        agreement=agreement,
    )


def ignore_reply(_reply: ModelReply) -> None:
    """Discard a reply: an ``on_reply`` for callers that record nothing."""

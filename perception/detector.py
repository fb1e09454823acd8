"""VLAD-Grasp (paper, Algorithm 1) on one screen: imagine a rod, carry it back, make grasps of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Alignment, Detections, Evidence, Grasp, ModelReply, Observation
from config.schema import Station
from perception.align import align
from perception.depth import Rgbd, register
from perception.heightmap import height_map
from perception.imagine import free_rod_color, imagine, masked
from perception.lift import lift, thin, transform
from perception.models.base import GoalImageModel, Subject
from perception.models.geometric import GeometricModel
from perception.project import fit_line, lift_run, rectangle, rod_depth, runs
from perception.rank import grasps_of_rod, rank
from perception.segment import Mask, Scene, segment, segment_goal

Array = npt.NDArray[np.float64]

_SHOWN_POINTS = 3000
_MIN_ROD_PX = 60
_MODELS = {GeometricModel.name: GeometricModel}


@dataclass(frozen=True)
class _Goal:
    """The goal image, taken apart: its rod, its object, its depth."""

    rgbd: Rgbd
    rod: Mask
    object: Mask
    replies: tuple[ModelReply, ...]


def detect(observation: Observation, station: Station, model: GoalImageModel | None = None) -> Detections:
    """Ranked grasps of the object in the pick region, and the evidence for them. Pure.

    Args:
        model: the goal-image model; None = the one that ``station.perception.model`` names.

    Raises:
        CycleFailure: NO_OBJECT, NO_GRASP, MODEL_REFUSED (no rod in the goal image), MODEL_DRIFT (no object in it).
    """
    base_from_color = observation.view.base_from_color
    rgbd = register(observation.frame)

    # Stage 1: segment, and imagine the rod.
    scene = segment(rgbd, base_from_color, station)
    goal = _imagined(rgbd, scene, base_from_color, model or _MODELS[station.perception.model](station), station)

    # Stage 2: lift both, and align the imagined object to the observed one.
    observed_points = lift(scene.object_mask, rgbd.depth_m, rgbd.camera)
    goal_points = lift(goal.object, goal.rgbd.depth_m, rgbd.camera)
    alignment = align(goal_points, observed_points)

    # Stage 3: the rod's runs through the object, as rectangles and as grasps.
    line = fit_line(goal.rod)
    inverse_depth = rod_depth(line, goal.rod, goal.rgbd.depth_m)
    crossings = runs(line, goal.rod, goal.object)
    ends = [
        transform(alignment.observed_from_goal, lift_run(line, run, inverse_depth, rgbd.camera)) for run in crossings
    ]
    heights = height_map(scene)
    grasps: list[Grasp] = []
    for index, run_ends in enumerate(ends):
        grasps += grasps_of_rod(transform(base_from_color, run_ends), index, heights, station)
    if not grasps:
        raise CycleFailure(Code.NO_GRASP, "The imagined rod crosses the object nowhere the jaw can close on.")
    return Detections(
        rectangles=tuple(
            rectangle(line, run, float(run_ends[:, 2].mean()), rgbd.camera, station)
            for run, run_ends in zip(crossings, ends, strict=True)
        ),
        grasps=rank(grasps, station),
        evidence=_evidence(rgbd, scene, goal, observed_points, goal_points, ends[0], alignment),
    )


def _imagined(rgbd: Rgbd, scene: Scene, base_from_color: Transform, model: GoalImageModel, station: Station) -> _Goal:
    rod_color = free_rod_color(rgbd.color, scene.region_mask)
    subject = Subject(rgbd, scene, masked(rgbd.color, scene.object_mask), base_from_color, rod_color)
    goal, replies = imagine(model, subject, station)
    rod, goal_object = segment_goal(goal.image, rod_color.rgb, scene)
    if rod.sum() < _MIN_ROD_PX:
        raise CycleFailure(Code.MODEL_REFUSED, "There is no rod in the goal image.")
    depth_m = rgbd.depth_m if goal.depth_m is None else goal.depth_m
    return _Goal(Rgbd(goal.image, depth_m, rgbd.camera), rod, goal_object, replies)


def _evidence(
    rgbd: Rgbd,
    scene: Scene,
    goal: _Goal,
    observed_points: Array,
    goal_points: Array,
    rod_ends: Array,
    alignment: Alignment,
) -> Evidence:
    rod_points = lift(goal.rod, goal.rgbd.depth_m, rgbd.camera)
    observed_from_goal = alignment.observed_from_goal
    return Evidence(
        color=rgbd.color,
        object_mask=scene.object_mask,
        goal_image=goal.rgbd.color,
        goal_object_mask=goal.object,
        goal_rod_mask=goal.rod,
        observed_points=thin(observed_points, _SHOWN_POINTS),
        goal_points=thin(goal_points, _SHOWN_POINTS),
        aligned_points=thin(transform(observed_from_goal, goal_points), _SHOWN_POINTS),
        rod_points=thin(transform(observed_from_goal, rod_points), _SHOWN_POINTS),
        rod_ends=(rod_ends[0], rod_ends[1]),
        alignment=alignment,
        replies=goal.replies,
    )

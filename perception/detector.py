"""VLAD-Grasp (paper, Algorithm 1) on one screen: imagine a rod, carry it back, make grasps of it."""

from __future__ import annotations

import numpy as np

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections, Evidence, Grasp, Observation
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
from perception.segment import segment, segment_goal

_SHOWN_POINTS = 3000
_MIN_ROD_PX = 60


def detect(observation: Observation, station: Station, model: GoalImageModel | None = None) -> Detections:
    """Ranked grasps of the object in the pick region, and the evidence for them. Pure.

    Args:
        model: the goal-image model; None = the one that ``station.perception.model`` names.

    Raises:
        CycleFailure: NO_OBJECT, NO_GRASP, MODEL_REFUSED (no rod in the goal image).
    """
    base_from_color = observation.view.base_from_color
    rgbd = register(observation.frame)

    # Stage 1: segment, and imagine the rod.
    scene = segment(rgbd, base_from_color, station)
    rod_color = free_rod_color(rgbd.color, scene.region_mask)
    subject = Subject(rgbd, scene, masked(rgbd.color, scene.object_mask), base_from_color, rod_color)
    goal, replies = imagine(model or GeometricModel(station), subject, station)
    rod_mask, goal_object = segment_goal(goal.image, rod_color.rgb, scene)
    if rod_mask.sum() < _MIN_ROD_PX:
        raise CycleFailure(Code.MODEL_REFUSED, "There is no rod in the goal image.")

    # Stage 2: lift both, and align the imagined object to the observed one.
    goal_rgbd = Rgbd(goal.image, rgbd.depth_m if goal.depth_m is None else goal.depth_m, rgbd.camera)
    observed_points = lift(scene.object_mask, rgbd.depth_m, rgbd.camera)
    goal_points = lift(goal_object, goal_rgbd.depth_m, rgbd.camera)
    alignment = align(goal_points, observed_points)

    # Stage 3: the rod's runs through the object, as rectangles and as grasps.
    line = fit_line(rod_mask)
    inverse_depth = rod_depth(line, rod_mask, goal_rgbd.depth_m)
    carried = [
        (run, transform(alignment.observed_from_goal, lift_run(line, run, inverse_depth, rgbd.camera)))
        for run in runs(line, rod_mask, goal_object)
    ]
    heights = height_map(scene)
    grasps: list[Grasp] = []
    for index, (_, ends) in enumerate(carried):
        grasps += grasps_of_rod(transform(base_from_color, ends), index, heights, station)
    if not grasps:
        raise CycleFailure(Code.NO_GRASP, "The imagined rod crosses the object nowhere the jaw can close on.")
    rod_points = lift(rod_mask, goal_rgbd.depth_m, rgbd.camera)
    return Detections(
        rectangles=tuple(rectangle(line, run, float(ends[:, 2].mean()), rgbd.camera, station) for run, ends in carried),
        grasps=rank(grasps, station),
        evidence=Evidence(
            color=rgbd.color,
            object_mask=scene.object_mask,
            goal_image=goal.image,
            goal_object_mask=goal_object,
            goal_rod_mask=rod_mask,
            observed_points=thin(observed_points, _SHOWN_POINTS),
            goal_points=thin(goal_points, _SHOWN_POINTS),
            aligned_points=thin(transform(alignment.observed_from_goal, goal_points), _SHOWN_POINTS),
            rod_points=thin(transform(alignment.observed_from_goal, rod_points), _SHOWN_POINTS),
            rod_ends=(np.asarray(carried[0][1][0]), np.asarray(carried[0][1][1])),
            alignment=alignment,
            replies=replies,
        ),
    )

"""The object in a cycle's result: the thing it went for, the grasp that was executed, where it was laid."""

from __future__ import annotations

import numpy as np

from bus.arrays import Vector3
from bus.messages import Delivery, Detections, FoundThing, Grasp, GraspOutcome, HandState, Laid, PickPlan, Verdict
from perception.goal.described import in_words
from planning.robot import Robot


def found_thing(found: Detections, grasp: Grasp) -> FoundThing | None:
    """Return the thing that a grasp holds; None in a scene that does not number it."""
    instance = next((one for one in found.scene.instances if one.number == grasp.instance), None)
    if instance is None:
        return None
    pixels = found.evidence.color[found.scene.labels == instance.number]
    return FoundThing(text=in_words(pixels, instance), top_m=instance.top_m, size_m=instance.size_m)


def grasp_outcome(grasp: Grasp, grasped: HandState | None, verdict: Verdict | None) -> GraspOutcome:
    """Return the executed grasp, with what the hand measured as far as it came."""
    return GraspOutcome(
        base_from_tcp=grasp.base_from_tcp,
        score=grasp.score,
        width_m=grasped.width_m if grasped is not None else None,
        load_n=verdict.load_n if verdict is not None else None,
    )


def lays_at(plan: PickPlan, robot: Robot) -> Vector3 | None:
    """Return where the tcp (3,) will let go, in ``base``; None for a plan that lays nothing down."""
    lowers = [part.trajectory for part in plan.segments if part.name == "place"]
    return robot.base_from_tcp(lowers[-1].end_q_rad)[:3, 3] if lowers else None


def laid_at(done: Delivery, robot: Robot, place: str) -> Laid | None:
    """Return where the hand let go; None when it did not get there."""
    lowered = [run.motion for run in done.runs if run.name == "place" and run.motion.finished]
    if done.released is None or not lowered:
        return None
    tcp_m = robot.base_from_tcp(np.asarray(lowered[-1].commanded_q_rad[-1]))[:3, 3]
    return Laid(place=place, position_m=tcp_m)

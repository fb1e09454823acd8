"""Columns of what was seen, imagined and found: looks, scene, alignment, drift, grasps, models."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable

from bus.messages import Detections, Instance, ObservedScene, Usage
from logs.catalogue.column import Column, Told, Value, packed


def _of_scene(take: Callable[[ObservedScene], Value]) -> Callable[[Told], Value]:
    return lambda told: take(told.scene) if told.scene is not None else None


def _of_mount(name: str) -> Callable[[Told], Value]:
    return _of_scene(lambda scene: getattr(scene.mount, name) if scene.mount is not None else None)


def _found(take: Callable[[Detections], Value]) -> Callable[[Told], Value]:
    return lambda told: take(told.detections) if told.detections is not None else None


def _alignment(name: str) -> Callable[[Told], Value]:
    return _found(lambda found: getattr(found.evidence.alignment, name))


def _drift(name: str) -> Callable[[Told], Value]:
    return _found(lambda found: getattr(found.evidence.drift, name))


def _looks(told: Told) -> Value:
    return sum(run.stage == "capture" and run.result is not None for run in told.runs)


def _again(told: Told) -> Value:
    whys = [run.result.why for run in told.runs if run.stage == "capture" and run.result is not None and run.result.why]
    return json.dumps(whys) if whys else None


def _best(take: str) -> Callable[[Told], Value]:
    return _found(lambda found: getattr(found.grasps[0], take) if found.grasps else None)


def _thing(take: Callable[[Instance], Value]) -> Callable[[Told], Value]:
    """Of the thing that the chosen grasp holds, else of the best grasp's."""

    def of(told: Told) -> Value:
        found, scene = told.detections, told.scene
        grasp = told.chosen or (found.grasps[0] if found is not None and found.grasps else None)
        seen = scene.instances if scene is not None and grasp is not None else ()
        return next((take(one) for one in seen if grasp is not None and one.number == grasp.instance), None)

    return of


def _tried_codes(told: Told) -> Value:
    return packed(Counter(one.code for one in told.detections.tried if one.code)) if told.detections else None


def _models(told: Told) -> Value:
    return ", ".join(sorted({reply.model for reply in told.record.replies})) or None


def _usage(take: Callable[[Usage], int | float]) -> Callable[[Told], Value]:
    return lambda told: sum(take(reply.usage) for reply in told.record.replies)


SEEN = (
    Column("looks", "INTEGER", "", "Captures before the pick.", _looks),
    Column("looked_again", "TEXT", "", "Why it looked again, each time: a JSON list.", _again),
    Column("region_seen", "REAL", "", "Share of the pick region that was seen.",
           _of_scene(lambda scene: scene.region_seen)),
    Column("instances", "INTEGER", "", "Things that were seen.", _of_scene(lambda scene: len(scene.instances))),
    Column("table_offset_m", "REAL", "m", "Height of the table over the station's.",
           _of_scene(lambda scene: scene.table.offset_m)),
    Column("table_tilt_rad", "REAL", "rad", "Angle between it and the station's.",
           _of_scene(lambda scene: scene.table.tilt_rad)),
    Column("mount_turn_rad", "REAL", "rad", "Error of the camera's mounting by several looks.", _of_mount("turn_rad")),
    Column("mount_shift_m", "REAL", "m", "The same, its shift.", _of_mount("shift_m")),
    Column("thing_length_m", "REAL", "m", "Length of the thing that was gone for.",
           _thing(lambda one: float(one.size_m[0]))),
    Column("thing_width_m", "REAL", "m", "Its width.", _thing(lambda one: float(one.size_m[1]))),
    Column("thing_height_m", "REAL", "m", "Its height.", _thing(lambda one: float(one.size_m[2]))),
    Column("thing_top_m", "REAL", "m", "Height of its highest point in `base`.",
           _thing(lambda one: float(one.top_m[2]))),
    Column("thing_depth_share", "REAL", "", "Share of its pixels that have depth.",
           _thing(lambda one: one.depth_share)),
    Column("found", "TEXT", "", "The thing that was gone for, in words.",
           lambda told: told.record.result.found.text if told.record.result and told.record.result.found else None),
)  # fmt: skip

IMAGINED = (
    Column("detector", "TEXT", "", "The other package's detector that gave the grasps; empty: ours.",
           _found(lambda found: found.detector)),
    Column("tried", "INTEGER", "", "Rods that were imagined.", _found(lambda found: len(found.tried))),
    Column("tried_codes", "TEXT", "", "Of those that failed: a JSON object, code to count.", _tried_codes),
    Column("rectangles", "INTEGER", "", "Grasp rectangles that survived.", _found(lambda found: len(found.rectangles))),
    Column("agreement", "REAL", "", "Share of the proposals whose rod grasps at the same place.",
           _found(lambda found: found.evidence.agreement)),
    Column("align_method", "TEXT", "", "How the imagined object was aligned.", _alignment("method")),
    Column("align_scale", "REAL", "", "Scale of the alignment.", _alignment("scale")),
    Column("align_residual", "REAL", "", "Mean distance after it, as a share of the object's radius.",
           _alignment("residual")),
    Column("align_chamfer_m2", "REAL", "m²", "Its chamfer distance.", _alignment("chamfer_m2")),
    Column("align_s", "REAL", "s", "Time it took.", _alignment("took_s")),
    Column("drift_outside", "REAL", "", "Share of the background that the goal image changed.",
           _drift("changed_outside")),
    Column("drift_iou", "REAL", "", "Overlap of the imagined outline with the observed one.", _drift("silhouette_iou")),
    Column("drift_shift_px", "REAL", "px", "Shift between the two.", _drift("shift_px")),
    Column("drift_turn_rad", "REAL", "rad", "Turn between the two.", _drift("turn_rad")),
    Column("drift_color", "REAL", "", "Distance of their median colours (CIE76).", _drift("color_shift")),
    Column("grasps", "INTEGER", "", "Grasps that were found.", _found(lambda found: len(found.grasps))),
    Column("best_score", "REAL", "", "Score of the best one.", _best("score")),
    Column("best_width_m", "REAL", "m", "Its width between the pads.", _best("width_m")),
)  # fmt: skip

MODELS = (
    Column("model", "TEXT", "", "Goal-image models, and detectors of other packages, that were called.", _models),
    Column("model_calls", "INTEGER", "", "Calls of them.", lambda told: len(told.record.replies)),
    Column("model_failures", "INTEGER", "", "Calls without a usable reply.",
           lambda told: sum(reply.failure is not None for reply in told.record.replies)),
    Column("model_s", "REAL", "s", "Time they took, one after the other.",
           lambda told: sum(reply.latency_s for reply in told.record.replies)),
    Column("input_tokens", "INTEGER", "", "As the provider counts them.", _usage(lambda usage: usage.input_tokens)),
    Column("output_tokens", "INTEGER", "", "As the provider counts them.", _usage(lambda usage: usage.output_tokens)),
    Column("reasoning_tokens", "INTEGER", "", "As the provider counts them.",
           _usage(lambda usage: usage.reasoning_tokens)),
    Column("cost_usd", "REAL", "USD", "Price of the calls.", _usage(lambda usage: usage.cost_usd)),
    Column("cost_is_complete", "INTEGER", "", "0: tokens and price are lower bounds.",
           lambda told: all(reply.usage.is_complete for reply in told.record.replies)),
)  # fmt: skip

"""Several looks at one scene on a page: each look, what it added, all of them as one cloud, and the mounting."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus.arrays import Mask
from bus.messages import Detections, Observation, ObservedScene, SeenMount
from logs.direction import direction_in_words
from logs.mcap.reader import CycleRecord
from logs.mcap.unseen_scene import is_made_up
from logs.report import images
from logs.report.clouds import fused
from logs.report.evidence import Choice
from logs.report.look_points import added_shares, points_of_things
from logs.report.page import Figure
from logs.report.scene import region_px, what_to_show
from logs.scene_picture import draw_scene

COLORS = ("#5d6b7a", "#e0632d", "#2f6fde", "#2c9c69", "#a855c7")
"""Of the looks, in order."""
_WIDTH_PX = 560


class ShownLook(NamedTuple):
    """One look.

    Attributes:
        number: from 1. ``color``: its tint in the cloud, CSS. ``why``: "" for the first one.
        took_s: with the way there; None when unknown. ``added``: share of the things' points that it was first to see.
        is_shown: detect worked in its image. ``uri``: its picture.
    """

    number: int
    color: str
    direction: str
    why: str
    took_s: float | None
    added: float
    is_shown: bool
    uri: str


class Looks(NamedTuple):
    """All looks of a cycle. ``mount``: how they disagreed, in sentences. ``cloud``: what they measured of things."""

    looks: list[ShownLook]
    mount: list[str]
    cloud: Figure


def looks_view(record: CycleRecord, found: Detections | None, chosen: Choice) -> Looks | None:
    """Return the looks of a cycle; None of a single one, or where the scene was not recorded."""
    scene = record.scene
    if scene is None or len(record.looks) < 2 or is_made_up(scene):
        return None
    clouds = points_of_things(scene, record.looks)
    looks = [_look(record, scene, index, share) for index, share in enumerate(added_shares(clouds))]
    named = [
        (f"look {one.number}: {one.direction}", one.color, points, np.asarray(seen.view.base_from_color)[:3, 3])
        for one, points, seen in zip(looks, clouds, record.looks, strict=True)
    ]
    grasp = found.grasps[chosen.grasp] if found is not None and chosen.grasp is not None else None
    return Looks(looks, mount_in_words(scene.mount), fused(named, grasp))


def _look(record: CycleRecord, scene: ObservedScene, index: int, added: float) -> ShownLook:
    seen = record.looks[index]
    return ShownLook(
        index + 1,
        COLORS[index % len(COLORS)],
        direction_in_words(seen.view.base_from_color),
        seen.view.why,
        _took_s(record, seen),
        added,
        index == scene.shown,
        images.data_uri(_picture(record, scene, index, seen), width_px=_WIDTH_PX),
    )


def _picture(record: CycleRecord, scene: ObservedScene, index: int, seen: Observation) -> images.Image:
    """The look around the pick region, its things outlined; what was not seen is known of the shown look only."""
    color, labels = images.undistorted(seen.frame), scene.look_labels
    if index >= len(labels) or labels[index].shape != color.shape[:2]:
        return color
    unseen: Mask = scene.unseen if index == scene.shown else np.zeros(color.shape[:2], dtype=bool)
    ours = scene.model_copy(update={"labels": labels[index], "unseen": unseen})
    corners = region_px(record, scene.table, seen)
    return images.crop(draw_scene(color, ours, corners), what_to_show(ours, corners))


def _took_s(record: CycleRecord, seen: Observation) -> float | None:
    captures = [stage for stage in (*record.superseded, *record.stages.values()) if stage.stage == "capture"]
    took_s = [
        one.duration_s for one in captures if one.result is not None and one.result.stamp_ns == seen.view.stamp_ns
    ]
    return took_s[0] if took_s else None


def mount_in_words(mount: SeenMount | None) -> list[str]:
    """Say how several looks disagreed, in sentences; none when nobody compared them."""
    if mount is None:
        return []
    return [_agreement(mount), *_excess(mount), _by_planes(mount)]


def _agreement(mount: SeenMount) -> str:
    before_m, after_m = mount.residual_before_m, mount.residual_after_m
    if before_m is None or after_m is None:
        return "The looks have no surface in common: nobody can say whether they agree."
    turn = f"{np.degrees(mount.turn_rad):.2f}° (±{np.degrees(mount.turn_deviation_rad):.2f}°)"
    correction = f"{turn} and {mount.shift_m * 1e3:.1f} mm (±{mount.shift_deviation_m * 1e3:.1f} mm)"
    disagreed = f"The looks disagreed by {before_m * 1e3:.1f} mm"
    if np.array_equal(mount.color_from_corrected, np.eye(4)):
        return f"{disagreed}; a correction of the camera's mounting by {correction} would leave {after_m * 1e3:.1f} mm."
    return f"{disagreed}, {after_m * 1e3:.1f} mm after a correction of the camera's mounting by {correction}."


def _excess(mount: SeenMount) -> Sequence[str]:
    cut = "They ask for more than is believed of a calibrated mounting: the correction was cut."
    return [cut] if mount.is_cut else []


def _by_planes(mount: SeenMount) -> str:
    tilt_deg = np.degrees(mount.table_tilt_rad)
    figures = f"table {tilt_deg:.2f}°, mounting {mount.off_mounting:.1f} standard deviations of a calibrated one"
    match mount.named:
        case "table":
            return f"By the planes that they show, the table is tilted ({figures})."
        case "mount":
            return f"By the planes that they show, the camera's mounting is off: calibrate ({figures})."
        case _:
            return f"By the planes that they show, neither table nor mounting is off ({figures})."

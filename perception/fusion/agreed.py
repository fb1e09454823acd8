"""Makes several looks agree: one correction of the camera's mounting for all of them, and what else is off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bus.errors import CycleFailure
from bus.messages import Observation, SeenMount
from bus.transforms import angle_between_rad
from config.schema import Station
from perception.fusion.mounting import MountCorrection, common_correction
from perception.fusion.table_or_mount import TableOrMount, table_or_mount
from perception.scene.look import Look
from perception.scene.region import within
from perception.scene.table import find_table

_AROUND_M = 0.15
_WRONG_M = 0.0009
"""Median distance between the surfaces of two looks: 0.7 mm where the mounting is right, 1.5 where it is 1 mm off."""


def agreed(looks: Sequence[Look], station: Station) -> tuple[tuple[Look, ...], SeenMount | None]:
    """Return the looks from where they were truly taken, and by how much the mounting is off; None for one look.

    With ``capture.mount_correction`` off the difference is told, and the looks stay as they are. So they do when two
    looks hardly disagree (two leave much open; correcting what is right costs 0.2 mm: docs/method.md), and when a
    correction does not help, or would be more than is believed: then something else has moved.
    """
    if len(looks) == 1:
        return tuple(looks), None
    found = disagreement(looks, station)
    helps = found.residual_after_m < found.residual_before_m and not found.is_cut
    disagree = len(looks) > 2 or found.residual_before_m > _WRONG_M
    use = station.capture.mount_correction and helps and disagree
    told = _told(found if use else replace(found, color_from_corrected=np.eye(4)), found, _planes(looks, station))
    if not use:
        return tuple(looks), told
    return tuple(
        replace(
            look,
            view=found.view(look.view, look.base_from_color),
            base_from_color=look.base_from_color @ found.color_from_corrected,
        )
        for look in looks
    ), told


def disagreement(looks: Sequence[Look], station: Station) -> MountCorrection:
    """Return the one correction of the mounting that would mend most of the looks' disagreement at the pick region."""
    views, poses = [look.view for look in looks], [look.base_from_color for look in looks]
    near = [within(view.points_base, station, _AROUND_M) for view in views]
    return common_correction(views, [look.surface for look in looks], poses, near)


def corrected(observation: Observation, mount: SeenMount | None) -> Observation:
    """Return the observation from where it was truly taken, by the correction that was used."""
    return observation if mount is None else observation.corrected(mount.color_from_corrected)


def _planes(looks: Sequence[Look], station: Station) -> TableOrMount | None:
    """Table or mounting, by the plane of each look; None when one shows no table."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    middle = np.array([(x_min + x_max) / 2, (y_min + y_max) / 2, station.scene.table.top_m])
    try:
        tables = [find_table(look.view.points_base, station) for look in looks]
    except CycleFailure:
        return None
    return table_or_mount(tables, [look.base_from_color for look in looks], middle)


def _told(used: MountCorrection, found: MountCorrection, planes: TableOrMount | None) -> SeenMount:
    deviation = np.sqrt(np.diag(found.covariance))
    return SeenMount(
        color_from_corrected=used.color_from_corrected,
        turn_rad=float(angle_between_rad(np.eye(4), found.color_from_corrected)),
        shift_m=float(np.linalg.norm(found.color_from_corrected[:3, 3])),
        turn_deviation_rad=float(np.linalg.norm(deviation[:3])),
        shift_deviation_m=float(np.linalg.norm(deviation[3:])),
        residual_before_m=found.residual_before_m if found.pairs else None,
        residual_after_m=found.residual_after_m if found.pairs else None,
        is_cut=found.is_cut,
        named="" if planes is None else planes.named,
        table_tilt_rad=0.0 if planes is None else planes.tilt_rad,
        off_mounting=0.0 if planes is None else planes.off_mounting,
    )

"""Whether the faces that the pads touch stand across the closing axis: by the normals of a scene of several looks.

A height map knows what is highest; that a bowl's wall leans below its rim, only another look shows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.transforms import from_rotation, inverse
from perception.geometry.depth import moved
from perception.grasps.closing import Closings
from perception.scene.heightmap import Labels
from perception.scene.scene import Scene

_TESTED, _SHARE = 150, 0.2
"""How many closings are looked at, and how much the faces count in the score."""
_PAD_M, _DEEP_M, _ABOVE_M = 0.010, 0.003, 0.002
"""The pad's half width; how far behind the first contact, and above the edge, what it touches may lie."""
_FEWEST = 4
"""Fewer normals say nothing."""
_STEEP_RAD, _LARGEST_RAD = float(np.deg2rad(35)), float(np.deg2rad(50))
"""Angle between the closing axis and the mean normal from which a face counts nothing, and beyond which it is refused.
Friction 0.5 holds 27 degrees; on curved things the mean is of more than what is touched."""

Array = npt.NDArray[np.float64]


def across_faces(closings: Closings, scene: Scene, base_from_level: Transform) -> Closings:
    """The closings, not feasible where a touched face leans too much; the term ``faces`` counts in the score of others.

    Only the best are looked at, the others count as leaning as much as they may. One look knows no such faces.
    """
    normals = scene.cloud.normals_table
    if normals is None:
        return closings
    level_from_table = inverse(base_from_level) @ scene.table.base_from_table
    known = np.flatnonzero((scene.cloud_labels > 0) & normals.any(axis=1))
    points = moved(scene.cloud.points_table[known][None], level_from_table)[0]
    turned = moved(normals[known][None], from_rotation(level_from_table[:3, :3]))[0]
    labels = scene.cloud_labels[known]
    faces, score = np.zeros(len(closings.score)), closings.score.copy()
    best = np.argsort(-closings.score, kind="stable")[:_TESTED]
    for index in best[np.isfinite(closings.score[best])]:
        angle = _angle_rad(closings, int(index), points, turned, labels)
        faces[index] = 1 - min(angle / _STEEP_RAD, 1)
        if angle > _LARGEST_RAD:
            score[index] = -np.inf
    return replace(closings, terms={**closings.terms, "faces": faces}, score=(1 - _SHARE) * score + _SHARE * faces)


def _angle_rad(
    closings: Closings, index: int, points: npt.NDArray[np.float32], normals: npt.NDArray[np.float32], labels: Labels
) -> float:
    """The larger angle of the two pads between the closing axis and the mean normal of what they touch.

    Where neither touches anything whose normal is known, the face may lean: it counts as half steep.
    """
    heading = closings.heading_rad[index]
    along, across = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    off = points[:, :2] - closings.center_m[index]
    x, y, z = off @ along, off @ across, points[:, 2]
    near = (np.abs(y) < _PAD_M) & (z > closings.slice_m[index] - _ABOVE_M) & (labels == closings.instance[index])
    near &= z < closings.edge_m[index] + _ABOVE_M
    half = closings.width_m[index] / 2
    angles = []
    for sign in (-1.0, 1.0):
        outwards = normals[:, :2] @ along * sign
        touched = near & (np.abs(sign * x - half) < _DEEP_M) & (outwards > 0)
        if touched.sum() >= _FEWEST:
            mean = normals[touched].mean(axis=0)
            axis = np.array([*along, 0.0]) * sign
            angles.append(float(np.arccos(np.clip(mean @ axis / np.linalg.norm(mean), -1, 1))))
    return max(angles, default=_STEEP_RAD / 2)

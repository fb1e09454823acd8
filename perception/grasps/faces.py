"""Whether the faces that the pads touch stand across the closing axis: by the normals of a scene of several looks.

A height map knows what is highest; that a bowl's wall leans below its rim, only another look shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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
_STEEP_RAD, _LARGEST_RAD = float(np.arctan(0.5)), float(np.deg2rad(50))
"""Angle between the closing axis and the mean normal from which a face counts nothing, and beyond which it is refused.
Friction 0.5 holds 27 degrees; on curved things the mean is of more than what is touched."""
_UNKNOWN = 0.5
"""Of a face that was not seen, by how much it leans, as a share of the steepest."""
_TIGHT = 0.3
"""How much a jaw without room beside the fingers counts in one look, which does not know the error of its mounting."""
_THIN_M = 0.016
"""The two faces of a wall so thin lean alike; of a thicker thing, what is seen of one says nothing of the other."""

Array = npt.NDArray[np.float64]
Points = npt.NDArray[np.float32]


def across_faces(closings: Closings, scene: Scene, base_from_level: Transform) -> Closings:
    """Return the closings, not feasible where a touched face leans too much; the others are scored by ``faces``, too.

    Only the best are looked at, the others count as leaning as much as they may. One look shows only one face of a thin
    wall: that it leans, or may lean beneath its rim, lowers the score; so does little room beside the fingers.
    """
    surfaces = Surfaces.of(scene, base_from_level)
    if surfaces is None:
        is_deep = closings.edge_m - closings.slice_m > _THIN_M
        leans = np.maximum(closings.lean, _UNKNOWN * is_deep)
        tight = _TIGHT * (1 - closings.terms["free"])
        return replace(closings, score=closings.score - _SHARE * leans * (closings.width_m < _THIN_M) - tight)
    faces, score = np.zeros(len(closings.score)), closings.score.copy()
    best = np.argsort(-closings.score, kind="stable")[:_TESTED]
    for index in best[np.isfinite(closings.score[best])]:
        angle = _angle_rad(surfaces.touched(closings, int(index)))
        faces[index] = 1 - min(angle / _STEEP_RAD, 1)
        if angle > _LARGEST_RAD:
            score[index] = -np.inf
    return replace(closings, terms={**closings.terms, "faces": faces}, score=(1 - _SHARE) * score + _SHARE * faces)


@dataclass(frozen=True)
class Faces:
    """The surfaces that the two pads of a closing touch, in the plane of closing axis and approach.

    Attributes:
        outwards: for the left and the right pad, the mean normal (along the closing axis away from the thing, along the
            level frame's z, across the pad); None = too little of it was seen.
        width_m: between the pads.
    """

    outwards: tuple[Array | None, Array | None]
    width_m: float

    @property
    def lean_rad(self) -> float | None:
        """By how much the thing leans in the jaw: so turned, the closing axis is as square to both faces as it can be.

        Positive turns the closing axis up at the right pad. None where too little was seen of it.
        """
        turns = [
            float(np.arctan2(sign * normal[1], normal[0]))
            for sign, normal in zip((-1.0, 1.0), self.outwards, strict=True)
            if normal is not None
        ]
        if len(turns) == 2 or (turns and self.width_m < _THIN_M):
            return float(np.mean(turns))
        return None


@dataclass(frozen=True)
class Surfaces:
    """The points of things whose normals are known, in a level frame: (n, 3), (n, 3) and the things' numbers (n,)."""

    points: Points
    normals: Points
    labels: Labels

    @classmethod
    def of(cls, scene: Scene, base_from_level: Transform) -> Surfaces | None:
        """Return the surfaces of a scene; None of one look, which knows no normals."""
        normals = scene.cloud.normals_table
        if normals is None:
            return None
        level_from_table = inverse(base_from_level) @ scene.table.base_from_table
        known = np.flatnonzero((scene.cloud_labels > 0) & scene.cloud.has_normal)
        points = moved(scene.cloud.points_table[known][None], level_from_table)[0]
        turned = moved(normals[known][None], from_rotation(level_from_table[:3, :3]))[0]
        return cls(points, turned, scene.cloud_labels[known])

    def touched(self, closings: Closings, index: int) -> Faces:
        """Return what the pads of a closing touch first."""
        heading = closings.heading_rad[index]
        along, across = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
        off = self.points[:, :2] - closings.center_m[index]
        x, y, z = off @ along, off @ across, self.points[:, 2]
        near = (np.abs(y) < _PAD_M) & (self.labels == closings.instance[index])
        near &= (z > closings.slice_m[index] - _ABOVE_M) & (z < closings.edge_m[index] + _ABOVE_M)
        half = closings.width_m[index] / 2

        def of_pad(sign: float) -> Array | None:
            outwards = self.normals[:, :2] @ along * sign
            touches = near & (np.abs(sign * x - half) < _DEEP_M) & (outwards > 0)
            if touches.sum() < _FEWEST:
                return None
            mean = np.array(
                [outwards[touches].mean(), self.normals[touches, 2].mean(), (self.normals[touches, :2] @ across).mean()]
            )
            return np.asarray(mean / np.linalg.norm(mean))

        return Faces((of_pad(-1.0), of_pad(1.0)), float(closings.width_m[index]))


def _angle_rad(faces: Faces) -> float:
    """The larger angle of the two pads between the closing axis and the mean normal of what they touch.

    Where neither touches anything whose normal is known, the face may lean: it counts as half as steep as it may be.
    """
    angles = [float(np.arccos(np.clip(normal[0], -1, 1))) for normal in faces.outwards if normal is not None]
    return max(angles, default=_STEEP_RAD * _UNKNOWN)

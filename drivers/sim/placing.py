"""Puts an object on the table: as it is modelled, at a chosen heading and place, wholly inside the pick region."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

OBJECT = "object"
"""Name of the only object's free body; several are called ``object-0``, ``object-1`` and so on."""
_MARGIN_M = 0.005
"""Objects are put at least this far inside the pick region, with all their extent if they fit."""
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
_DROP_M = 0.002
_STILL_M_S, _STILL_RAD_S = 0.02, 0.2
"""A slower thing rests: one of many parts trembles where it lies, by less."""
_PARK_M = 5.0


class Placing:
    """Moves one free object of a model; no simulated time passes here.

    Args:
        pick_region_m: (x_min, x_max, y_min, y_max) in ``base``.
        body: name of the free body.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        pick_region_m: tuple[float, float, float, float],
        body: str = OBJECT,
    ) -> None:
        self._model, self._data, self._pick_region_m = model, data, pick_region_m
        self.body = body

    def stand(self, heading_rad: float) -> None:
        """Put the object as modelled, turned by ``heading_rad`` about the vertical, just above the region's middle."""
        x_min, x_max, y_min, y_max = self._pick_region_m
        joint = self._data.joint(self.body)
        joint.qpos[:3] = (x_min + x_max) / 2, (y_min + y_max) / 2, 1.0
        joint.qpos[3:] = np.cos(heading_rad / 2), 0.0, 0.0, np.sin(heading_rad / 2)
        joint.qvel[:] = 0.0
        mujoco.mj_forward(self._model, self._data)
        joint.qpos[2] += _DROP_M - self.extent()[0, 2]
        self._data.qacc_warmstart[:] = 0.0  # the object before must not change the last bits

    def shift_into_region(self, share: npt.NDArray[np.float64]) -> None:
        """Move the resting object so that all of it lies in the pick region, at ``share`` (2,) of the free range."""
        low, high = self.extent()[:, :2]
        first, last = self.region() - [low, high]
        shift = np.where(first <= last, first + share * (last - first), (first + last) / 2)
        joint = self._data.joint(self.body)
        joint.qpos[:2] += shift
        joint.qvel[:] = 0.0

    def put(self, position_m: npt.NDArray[np.float64], wxyz: npt.NDArray[np.float64]) -> None:
        """Put the object's body at rest at a pose in ``base``.

        Args:
            position_m: (3,).
            wxyz: (4,) unit quaternion.
        """
        joint = self._data.joint(self.body)
        joint.qpos[:3], joint.qpos[3:] = position_m, wxyz
        joint.qvel[:] = 0.0
        mujoco.mj_kinematics(self._model, self._data)

    def stop(self) -> None:
        """Take all its speed from the object."""
        self._data.joint(self.body).qvel[:] = 0.0

    def is_moving(self) -> bool:
        """Whether the object moves or turns."""
        speeds = np.abs(self._data.joint(self.body).qvel)
        return bool(speeds[:3].max() > _STILL_M_S or speeds[3:].max() > _STILL_RAD_S)

    def pose(self) -> npt.NDArray[np.float64]:
        """Return (7,): position [m] and quaternion wxyz of the object's body in ``base``."""
        return np.array(self._data.joint(self.body).qpos)

    def region(self) -> npt.NDArray[np.float64]:
        """Return (2, 2): lowest and highest corner [m] of the area where objects may lie."""
        x_min, x_max, y_min, y_max = self._pick_region_m
        return np.array([[x_min + _MARGIN_M, y_min + _MARGIN_M], [x_max - _MARGIN_M, y_max - _MARGIN_M]])

    def extent(self) -> npt.NDArray[np.float64]:
        """Return (2, 3): lowest and highest corner of the object's contact geoms in ``base`` [m]."""
        every = self.outline()
        return np.array([every.min(axis=0), every.max(axis=0)])

    def outline(self) -> npt.NDArray[np.float64]:
        """Return (n, 3): points in ``base`` [m] that span the object's contact geoms."""
        model, data = self._model, self._data
        solid = (model.body_rootid[model.geom_bodyid] == model.body(self.body).id) & (model.geom_contype != 0)
        points = [
            data.geom_xpos[geom] + self._span(int(geom)) @ data.geom_xmat[geom].reshape(3, 3).T
            for geom in np.flatnonzero(solid)
        ]
        return np.concatenate(points)

    def _span(self, geom: int) -> npt.NDArray[np.float64]:
        """Return points (n, 3) that span the geom, in its own frame: a mesh's vertices, or its bounding box."""
        model, mesh = self._model, self._model.geom_dataid[geom]
        if mesh >= 0:
            first = model.mesh_vertadr[mesh]
            return np.asarray(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], dtype=np.float64)
        return np.asarray(model.geom_aabb[geom, :3] + _CORNERS * model.geom_aabb[geom, 3:])

    def rests_inside(self) -> bool:
        """Whether the object rests, and its middle lies inside the pick region."""
        x_min, x_max, y_min, y_max = self._pick_region_m
        low, high = self.extent()
        x, y, z = (low + high) / 2
        return not self.is_moving() and x_min < x < x_max and y_min < y < y_max and z > 0

    def rests_wholly_inside(self) -> bool:
        """Whether the object rests, and all of it lies inside the pick region."""
        x_min, x_max, y_min, y_max = self._pick_region_m
        low, high = self.extent()[:, :2]
        return self.rests_inside() and bool((low > (x_min, y_min)).all() and (high < (x_max, y_max)).all())


def park(placings: Sequence[Placing]) -> None:
    """Put objects away from everything: below the table, and apart, where they fall."""
    for index, placing in enumerate(placings):
        placing.put(np.array([0.0, 0.0, -_PARK_M * (1 + index)]), np.array([1.0, 0.0, 0.0, 0.0]))

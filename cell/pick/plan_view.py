"""The last plan as a picture in 3-D, made when somebody asks for it: a cycle does not wait for it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bus.arrays import JointSamples, Mask, PointColors, Points
from bus.errors import Refused
from bus.messages import ONLY_TO_LOOK, NamedBox, Observation, PlannedPath, PlanView, Segment, SegmentName
from bus.trajectory import TICK_S
from bus.transforms import apply
from cell.pick.approving import Approvals, Planned
from config.scene import scene_boxes
from config.schema import Station
from perception.fusion.agreed import corrected
from perception.geometry.depth import register
from perception.geometry.lift import lift
from planning.distances import distances
from planning.outlines import Outlines
from planning.robot import Robot

SAMPLE_HZ = 20
MOST_POINTS = 5000
_ON_THINGS = 0.6
"""The largest share of the points that lies on things: of the table less is worth seeing."""
_ORDER: tuple[SegmentName, ...] = ("reach", "carry", "aside", "return", "place", "home")
"""In which the segments of a pick are played."""


class PlanViews:
    """Draws the last plan of a cell. Its members are for one thread.

    Args:
        approvals: know the last plan.
    """

    def __init__(self, approvals: Approvals, robot: Robot, station: Station) -> None:
        self._approvals, self._robot, self._station = approvals, robot, station
        self._outlines: Outlines | None = None
        self._drawn: tuple[Planned, PlanView] | None = None

    def now(self) -> PlanView:
        """Return the last plan. Raises: Refused (NO_PLAN)."""
        planned = self._approvals.last
        if planned is None:
            raise Refused("Nothing was planned since the cell began.", "It is with the next pick.", code="NO_PLAN")
        if self._drawn is None or self._drawn[0] is not planned:
            self._outlines = self._outlines or Outlines(self._robot)
            self._drawn = (planned, plan_view(planned, self._outlines, self._robot, self._station))
        waiting = self._approvals.waiting
        is_open = waiting is not None and waiting.proposal_id == planned.proposal.proposal_id
        return self._drawn[1].model_copy(update={"is_open": is_open})


def plan_view(planned: Planned, outlines: Outlines, robot: Robot, station: Station) -> PlanView:
    """Return the picture of a plan, as of one that nobody is asked about."""
    scene = planned.found.scene
    cloud_m, cloud_rgb = thinned_cloud(corrected(planned.looks[scene.shown], scene.mount), scene.labels > 0)
    segments = sorted(planned.plan.segments, key=lambda part: _ORDER.index(part.name))
    return PlanView(
        proposal=planned.proposal,
        is_open=False,
        frames=outlines.frames,
        parts=outlines.parts,
        segments=tuple(_path(part, planned, outlines, robot) for part in segments),
        boxes=tuple(
            NamedBox(name=box.name, center_m=np.array(box.center_m), size_m=np.array(box.size_m))
            for box in scene_boxes(station.scene)
        ),
        cloud_m=cloud_m,
        cloud_rgb=cloud_rgb,
    )


def _path(part: Segment, planned: Planned, outlines: Outlines, robot: Robot) -> PlannedPath:
    times_s, q_rad = sampled(part.trajectory.filtered())
    holds = part.name not in ("reach", "home")
    width_m = planned.grasp.width_m if holds else planned.grasp.opening_m
    poses, tcp_m = outlines.along(q_rad, width_m)
    pairs, apart_m = distances(robot, q_rad, width_m)
    nearest_m: dict[str, float] = {}
    for (_, box), least_m in zip(pairs, apart_m.min(axis=0), strict=True):
        nearest_m[box] = min(float(least_m), nearest_m.get(box, np.inf))
    return PlannedPath(
        name=part.name,
        only_to_look=part.name in ONLY_TO_LOOK,
        width_m=width_m,
        nearest_m=nearest_m,
        times_s=times_s,
        q_rad=q_rad,
        tcp_m=tcp_m,
        base_from_frame=poses,
    )


def sampled(commands_rad: JointSamples) -> tuple[npt.NDArray[np.float64], JointSamples]:
    """Return the times (n,) [s] and positions (n, joints) of 1 kHz commands at `SAMPLE_HZ`, with the last one."""
    rows = np.arange(0, len(commands_rad), round(1 / (TICK_S * SAMPLE_HZ)))
    if rows[-1] != len(commands_rad) - 1:
        rows = np.append(rows, len(commands_rad) - 1)
    return np.asarray(rows * TICK_S, dtype=np.float64), commands_rad[rows]


def thinned_cloud(look: Observation, things: Mask) -> tuple[Points, PointColors]:
    """At most `MOST_POINTS` of a look's points (n, 3) [m] in ``base``, and their colours (n, 3).

    Args:
        things: (H, W) pixels of the undistorted colour image that show things; of these most are kept.
    """
    seen = register(look.frame)
    has_depth = np.isfinite(seen.depth_m)
    kept = _every(has_depth & things, round(_ON_THINGS * MOST_POINTS))
    kept |= _every(has_depth & ~things, MOST_POINTS - int(kept.sum()))
    points = apply(look.view.base_from_color, lift(kept, seen.depth_m, seen.camera))
    return points.astype(np.float32), seen.color[kept].astype(np.uint16)


def _every(mask: Mask, most: int) -> Mask:
    """The pixels of a mask (H, W) on the finest grid that has at most so many of them."""
    for stride in range(1, max(mask.shape) + 1):
        if mask[::stride, ::stride].sum() <= most:
            break
    kept = np.zeros_like(mask)
    kept[::stride, ::stride] = mask[::stride, ::stride]
    return kept

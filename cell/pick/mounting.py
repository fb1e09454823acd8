"""The camera's mounting as the looks of earlier picks correct it, kept from pick to pick; and who is told.

Kept while the daemon runs: `cell calibrate` writes the mounting anew, and the next start begins with it.
"""

from __future__ import annotations

import numpy as np

from bus.arrays import Transform
from bus.commands import Event
from bus.messages import Observation, SeenMount
from bus.transforms import angle_between_rad, from_rotvec, to_rotvec
from perception.fusion.mounting import bounded

FEWEST_LOOKS = 3
"""Fewer looks leave too much open of a correction to keep it."""
_MEMORY = 10
"""As many picks count alike; what is older fades."""
_OFF_RAD, _OFF_M = float(np.deg2rad(0.4)), 0.004
"""A mounting is off beyond this; where nothing is wrong, looks ask for 0.2 deg and 1.6 mm (`benchmarks fusion`)."""
_QUIET = 5
"""After so many picks without a sign of it, what was told may be told again."""


class MountKeeper:
    """The mean correction of the mounting so far; never more than is believed of a calibrated one.

    Attributes:
        color_from_corrected: (4, 4) ``base_from_color @ color_from_corrected`` is the better pose.
        picks: how many picks it is made of.
    """

    def __init__(self) -> None:
        self.color_from_corrected: Transform = np.eye(4)
        self.picks = 0
        self._named, self._quiet = "", 0

    def applied(self, observation: Observation) -> Observation:
        """Return the observation as the kept correction has it."""
        if not self.picks:
            return observation
        return observation.corrected(self.color_from_corrected)

    def take(self, mount: SeenMount) -> None:
        """Let a pick's correction, which is relative to the kept one, count; one that was cut proves nothing."""
        if mount.is_cut or mount.residual_after_m is None:
            return
        self.picks = min(self.picks + 1, _MEMORY)
        step = from_rotvec(to_rotvec(mount.color_from_corrected) / self.picks)
        self.color_from_corrected = from_rotvec(bounded(to_rotvec(self.color_from_corrected @ step)))

    def news(self, mount: SeenMount) -> Event | None:
        """Return what to tell the operator: once, when the table or the mounting begins to be off.

        The kept correction counts: what drifts slowly is taken off pick by pick, and is off nevertheless.
        """
        off = self.color_from_corrected @ mount.color_from_corrected
        turn_rad, shift_m = float(angle_between_rad(np.eye(4), off)), float(np.linalg.norm(off[:3, 3]))
        has_drifted = turn_rad > _OFF_RAD or shift_m > _OFF_M
        named = mount.named or ("mount" if has_drifted else "")
        self._quiet = 0 if named else self._quiet + 1
        if named in ("", self._named):
            self._named = "" if self._quiet >= _QUIET else self._named
            return None
        self._named = named
        return _event(named, mount, turn_rad, shift_m)


def _event(named: str, mount: SeenMount, turn_rad: float, shift_m: float) -> Event:
    if named == "table":
        return Event(
            code="TABLE_TILTED",
            severity="warning",
            text=f"The looks agree that the table leans by {np.degrees(mount.table_tilt_rad):.1f} deg.",
            advice="Level it, or correct scene.table; grasps follow the table as it is seen.",
        )
    return Event(
        code="MOUNT_MOVED",
        severity="warning",
        text=f"The looks disagree by {1e3 * (mount.residual_before_m or 0):.1f} mm: the camera's mounting seems off by"
        f" {np.degrees(turn_rad):.2f} +- {np.degrees(mount.turn_deviation_rad):.2f} deg and"
        f" {1e3 * shift_m:.1f} +- {1e3 * mount.shift_deviation_m:.1f} mm from the station's.",
        advice="Is the camera screwed tight? `cell calibrate check` measures it with the board.",
    )

"""Rejected grasps that the arm does not reach: how far away they are, beside how far it reaches."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus.codes import Code
from bus.messages import Detections
from bus.rejection import Rejection
from config.franka_hand import HAND_FROM_TCP_M
from config.limits import REACH_M, SHOULDER_M
from logs.mcap.reader import CycleRecord
from logs.recorded_settings import recorded_number


class Cause(NamedTuple):
    """One cause of rejections. ``ways``: to grasp, that it stood against; ``measured``: beside its ``limit``."""

    ways: int
    text: str
    measured: str
    limit: str


def unreached(record: CycleRecord, found: Detections, rejected: Sequence[Rejection]) -> list[Cause]:
    """Return the causes of the rejections as unreachable, the most frequent first."""
    groups: dict[str, list[float]] = defaultdict(list)
    for one in rejected:
        if one.code is Code.UNREACHABLE:
            groups[one.reason].append(_flange_m(record, found, one))
    return [
        _cause(record, reason, away_m) for reason, away_m in sorted(groups.items(), key=lambda group: -len(group[1]))
    ]


def _cause(record: CycleRecord, reason: str, away_m: Sequence[float]) -> Cause:
    text = f"{reason[:1].upper()}{reason[1:]}."
    low, high = f"{min(away_m):.2f}", f"{max(away_m):.2f}"
    measured = f"flange {low if low == high else f'{low} to {high}'} m from the shoulder"
    if record.station.get("robot") is not None:
        return Cause(len(away_m), text, measured, "not known of this arm")
    return Cause(len(away_m), text, measured, f"{REACH_M:.2f} m at most, in few directions so far")


def _flange_m(record: CycleRecord, found: Detections, one: Rejection) -> float:
    """Return how far from the shoulder the flange would be, at the grasp or where its approach begins."""
    pose = found.grasps[one.grasp].base_from_tcp
    approach = np.cos(one.tilt_rad) * pose[:3, 2] + np.sin(one.tilt_rad) * pose[:3, 0]
    back_m = recorded_number(record.station, "planning", "approach_m") or 0.0
    places = [pose[:3, 3] - (HAND_FROM_TCP_M + away_m) * approach for away_m in (0.0, back_m)]
    return max(float(np.linalg.norm(place - [0.0, 0.0, SHOULDER_M])) for place in places)

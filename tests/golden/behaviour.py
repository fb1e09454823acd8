"""What the pure stages decide on the golden recordings, as text: a change of behaviour is a diff of behaviour.json.

``just golden-update`` writes it anew; review the diff, and say why in the commit.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from bus.arrays import Transform
from bus.frozen import Message
from bus.messages import Detections, Failure, PickPlan, Verdict
from cell.replay.replay import Request, replay
from logs.mcap.reader import read_cycle

FOLDER = Path(__file__).parent
BEHAVIOUR = FOLDER / "behaviour.json"


def behaviour() -> dict[str, Any]:
    """Recording -> stage -> what it decides now, chained: rounded so that another processor gives the same."""
    return {
        path.name: {
            stage.stage: _said(stage.replayed)
            for stage in replay(read_cycle(path), Request(start="detect")).stages
        }
        for path in sorted(FOLDER.glob("*.mcap"))
    }  # fmt: skip


def _said(outcome: Message) -> dict[str, Any]:
    if isinstance(outcome, Detections):
        alignment = outcome.evidence.alignment
        return {
            "object_px": int(outcome.evidence.object_mask.sum()),
            "alignment_mm": _mm(alignment.observed_from_goal),
            "residual": round(alignment.residual, 4),
            "grasps": [
                {
                    "mm": _mm(grasp.base_from_tcp),
                    "width_mm": round(grasp.width_m * 1e3, 1),
                    "score": round(grasp.score, 3),
                }
                for grasp in outcome.grasps
            ],
        }
    if isinstance(outcome, PickPlan):
        return {
            "grasp": outcome.grasp,
            "tilt_deg": round(float(np.degrees(outcome.tilt_rad)), 1),
            "rejected": _rejected(outcome),
            "motion_s": {part.name: round(part.trajectory.duration_s, 2) for part in outcome.segments},
        }
    if isinstance(outcome, Verdict):
        return {
            "code": outcome.code,
            "load_n": round(outcome.load_n, 2),
            "cleared": outcome.cleared_fraction and round(outcome.cleared_fraction, 2),
        }
    assert isinstance(outcome, Failure)
    return {"failure": outcome.code, "text": outcome.text, "rejected": _rejected(outcome)}


def _rejected(outcome: PickPlan | Failure) -> list[str]:
    return [f"{one.grasp} at {np.degrees(one.tilt_rad):.0f} deg {one.code}: {one.reason}" for one in outcome.rejected]


def _mm(pose: Transform) -> list[float]:
    return [round(float(metres) * 1e3, 1) for metres in pose[:3, 3]]


def text() -> str:
    """As it stands in the file."""
    return json.dumps(behaviour(), indent=1) + "\n"


if __name__ == "__main__":
    BEHAVIOUR.write_text(text())

"""A detector's grasps as text of the record, and the detector of a replay that gives them back."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence

import numpy as np

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure, RecordingError
from bus.messages import ModelReply
from config.schema import Station
from perception.detectors.base import FoundGrasp, GraspDetector, SeenScene
from perception.detectors.registry import OURS, open_detector


def written(grasps: Sequence[FoundGrasp], *, is_deterministic: bool) -> str:
    """Return the grasps as JSON; its numbers read back bit for bit."""
    listed = [
        {
            "base_from_tcp": np.asarray(one.base_from_tcp).tolist(),
            "width_m": one.width_m,
            "score": one.score,
            "instance": one.instance,
        }
        for one in grasps
    ]
    return json.dumps({"is_deterministic": is_deterministic, "grasps": listed})


class RecordedDetector:
    """Gives back recorded grasps, or raises the recorded failure again. Raises: RecordingError for a damaged record."""

    is_deterministic = False

    def __init__(self, reply: ModelReply) -> None:
        self._reply = reply
        try:
            listed = json.loads(reply.text)["grasps"]
            self._grasps = [FoundGrasp(**{**one, "base_from_tcp": np.array(one["base_from_tcp"])}) for one in listed]
        except (ValueError, KeyError, TypeError) as error:
            raise RecordingError(f"The recorded grasps of {reply.model!r} cannot be read: {error}.") from error

    def detect(self, seen: SeenScene, cancel: Cancel) -> Sequence[FoundGrasp]:
        """Return the recorded grasps. Raises: the recorded CycleFailure."""
        if self._reply.failure is not None:
            raise CycleFailure(self._reply.failure, self._reply.text_of_failure)
        return self._grasps

    def close(self) -> None:
        """Do nothing; there are no resources."""


def replayed_detector(station: Station, replies: Iterable[ModelReply]) -> GraspDetector | None:
    """Return the detector of a replay; None = ours. One that is not deterministic gives back what was recorded.

    A recorded timeout happens again, too: it followed from how long the call took.

    Raises: ConfigError, as `open_detector`, when the detector itself is needed.
    """
    name = station.perception.detector
    own = [reply for reply in replies if reply.step == "detect" and reply.model == name]
    if name == OURS or not own or not _is_given_back(own[-1]):
        return open_detector(station)
    return RecordedDetector(own[-1])


def _is_given_back(reply: ModelReply) -> bool:
    try:
        return reply.failure is Code.DETECTOR_TIMEOUT or not json.loads(reply.text)["is_deterministic"]
    except (ValueError, KeyError, TypeError) as error:
        raise RecordingError(f"The recorded answer of the detector {reply.model!r} is damaged: {error}.") from error

"""One recorded cycle as numpy: ``read_cycle``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bus.codes import went_for
from bus.errors import RecordingError
from bus.messages import Detections as DetectionRecord
from config.schema import Station
from logs.export.clock import EpisodeClock, Played, played
from logs.export.signals import measured_joints, measured_width
from logs.mcap.migrate import Content
from logs.mcap.reader import CycleRecord, read_stages, read_with_messages
from logs.mcap.reader import read_cycle as read_whole
from logs.recorded_station import recorded_station
from logs.report.evidence import choice
from logs.report.timeline import UNFINISHED, Timeline, summarize
from vlad_cell.detection import Detections, Grasp, counted, drawn
from vlad_cell.look import Look, look_of
from vlad_cell.picture import Picture
from vlad_cell.tracks import HandTrack, JointTrack


@dataclass(frozen=True, eq=False)
class Cycle:
    """One recorded cycle. Results are there at once; pictures, joints and the hand are decoded when they are asked for.

    Attributes:
        path: of the recording.
        record: everything that the recording says but pictures and joints: stages, states, events, calls of models;
            ``record.result`` is the `CycleResult` that the client got, None when the cycle did not end.
    """

    path: Path
    record: CycleRecord

    def __repr__(self) -> str:
        told, found = self.record.result, self._found(self.record)
        if told is None:
            ended = [self.record.metadata.get("result", UNFINISHED)]
        else:
            code = told.code.value if told.code is not None else ""
            ended = [told.result, code, went_for(code, told.object, told.reason)]
        grasps = counted(len(found.grasps) if found is not None else 0, "grasp")
        return f"Cycle {self.cycle_id}, {' '.join(filter(None, ended))}, {grasps}"

    @property
    def cycle_id(self) -> str:
        """The id of the cycle: UTC time at which it was asked for, to the millisecond."""
        return self.record.cycle_id

    # --- how it ended -------------------------------------------------------------------------------------------------

    @property
    def result(self) -> str:
        """As `CycleResult.result`: SUCCESS, FAILED, ABORTED or EMPTY; UNFINISHED or INTERRUPTED when its process ended
        before the cycle did.
        """
        return self._timeline.outcome

    @property
    def code(self) -> str | None:
        """The code of its failure, one of docs/faults.md; None for none, as in `CycleResult`."""
        return self._timeline.code or None

    @property
    def reason(self) -> str:
        """The end of the cycle in a sentence or two."""
        return self._timeline.why

    @property
    def advice(self) -> str:
        """The advice about a failure; "" for nothing."""
        return self._timeline.advice

    @property
    def took_s(self) -> dict[str, float]:
        """The duration of every stage that ran, in seconds of the wall."""
        return self._timeline.took_s

    @cached_property
    def _timeline(self) -> Timeline:
        return summarize(self.record)

    @property
    def station(self) -> Station:
        """The station as it was then: ``detect(..., config=cycle.station)``. Raises: ConfigError."""
        return recorded_station(self.record)

    # --- what was seen ------------------------------------------------------------------------------------------------

    @cached_property
    def looks(self) -> tuple[Look, ...]:
        """Every look before the pick, in order; none of a recording whose pictures were trimmed."""
        return tuple(look_of(seen) for seen in self._whole[0].looks)

    @cached_property
    def after(self) -> Look | None:
        """The look while the object is held; None when the cycle did not come so far."""
        seen = self._whole[0].after
        return look_of(seen) if seen is not None else None

    @property
    def color(self) -> npt.NDArray[np.uint8]:
        """(H, W, 3) uint8, RGB: the look that the grasps' rectangles are in. Raises: RecordingError without a look."""
        return self._shown.color

    @property
    def depth_m(self) -> npt.NDArray[np.float32]:
        """(H, W) float32, metres, in the pixels of ``color``; NaN where nothing was measured."""
        return self._shown.depth_m

    @property
    def K(self) -> npt.NDArray[np.float64]:
        """(3, 3) intrinsics of ``color`` and ``depth_m``, in pixels."""
        return self._shown.K

    @property
    def base_from_camera(self) -> npt.NDArray[np.float64]:
        """(4, 4) pose of that look's camera in ``base``, in metres."""
        return self._shown.base_from_camera

    @property
    def _shown(self) -> Look:
        shown = self.record.scene.shown if self.record.scene is not None else 0
        if shown >= len(self.looks):
            why = self.record.trimmed or "nothing was captured"
            raise RecordingError(f"The recording of {self.cycle_id} holds no picture: {why}.", "See `cycle.reason`.")
        return self.looks[shown]

    # --- what was found -----------------------------------------------------------------------------------------------

    @property
    def grasps(self) -> tuple[Grasp, ...]:
        """The grasps that were found, the best first; none when detect failed."""
        found = self._found(self.record)
        return Detections(found).grasps if found is not None else ()

    @property
    def chosen(self) -> int | None:
        """The index in ``grasps`` of the one that was planned; None when none was."""
        plan = self.record.stages.get("plan")
        return getattr(plan.result, "grasp", None) if plan is not None else None

    @cached_property
    def detections(self) -> Detections:
        """The result of `detect`, with pictures. Raises: RecordingError when it found nothing; ``reason`` says why."""
        found = self._found(self._pictured)
        if found is None:
            raise RecordingError(f"Nothing was found in the cycle {self.cycle_id}: {self.reason}", self.advice)
        return Detections(found)

    def picture(self, *, close_up: bool = False) -> Picture:
        """Return the image with the grasps: the chosen one in yellow, those without a way to them in red.

        Args:
            close_up: only the part around the object.

        Raises: RecordingError, as ``detections``.
        """
        record = self.detections.record
        return drawn(record, choice(self.record, record), close_up=close_up)

    # --- what was done ------------------------------------------------------------------------------------------------

    @cached_property
    def joints(self) -> JointTrack:
        """The arm over time. Raises: RecordingError when no joints were recorded."""
        record, _ = self._whole
        samples = measured_joints(record, *self._time)
        q_rad, dq_rad_s, tau_ext_nm = np.split(samples.values, 3, axis=1)
        return JointTrack(samples.time_s, q_rad, dq_rad_s, tau_ext_nm)

    @cached_property
    def hand(self) -> HandTrack:
        """The hand over time. Raises: RecordingError when it was not recorded."""
        samples = measured_width(*self._whole, self._time[1])
        return HandTrack(samples.time_s, samples.values[:, 0])

    # --- decoded when it is asked for ---------------------------------------------------------------------------------

    @cached_property
    def _whole(self) -> tuple[CycleRecord, Content]:
        return read_with_messages(self.path)

    @cached_property
    def _pictured(self) -> CycleRecord:
        return read_whole(self.path)

    @cached_property
    def _time(self) -> tuple[list[Played], EpisodeClock]:
        """The motions since the first look, and the clock that begins with it."""
        record, content = self._whole
        start_ns = record.looks[0].view.stamp_ns if record.looks else self._timeline.start_ns
        motions = [one for one in played(content) if one.began_ns >= start_ns]
        return motions, EpisodeClock(start_ns, motions)

    @staticmethod
    def _found(record: CycleRecord) -> DetectionRecord | None:
        stage: Any = record.stages.get("detect")
        return stage.result if stage is not None and isinstance(stage.result, DetectionRecord) else None


def read_cycle(path: str | Path) -> Cycle:
    """Read one recording (``.mcap``), of this or an earlier version.

    Args:
        path: of the file, as `CycleResult.recording` names it.

    Raises: RecordingError when there is none, it is unfinished (``cell recover`` makes it whole), or is damaged.
    """
    return Cycle(Path(path), read_stages(Path(path)))

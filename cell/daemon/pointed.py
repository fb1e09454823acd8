"""The pictures that a person may point into: the cell knows which of them still count, and what they show."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy import ndimage

from bus.errors import CycleFailure, Refused
from bus.frozen import Message
from bus.messages import (
    CycleResult,
    Detections,
    Execution,
    Job,
    ObservedScene,
    PickPlan,
    StageRecord,
    Target,
    Verdict,
    View,
)
from perception.goal.target import mostly_in_box, nearest_number

_KEPT_LIVE = 1024
"""Live pictures whose stamps are known: of the last quarter of an hour and more."""
_TOUCHING = 0.01
"""Of the picture's width: things no farther apart in it may be parts of one, or have moved with it."""
_AGAIN = "Look at the picture that is there now, and choose again."


class Pointed:
    """The pictures of a cell that somebody may point into. Any thread may call its members."""

    def __init__(self) -> None:
        self._alone = threading.Lock()
        self._looks: list[View] = []
        self._found: Detections | None = None
        self._scene: ObservedScene | None = None
        self._shown: View | None = None
        self._chosen = 0
        self._gone: tuple[int, ...] = ()
        self._is_stirred = self._has_closed = False
        self._live: dict[int, bool] = {}

    def hear(self, message: Message | bytes) -> None:
        """Take what the cell says: looks, what is found in them, what is chosen, and what becomes of it."""
        with self._alone:
            if isinstance(message, ObservedScene):
                self._show(message)
            elif isinstance(message, CycleResult):
                self._end(message)
            elif isinstance(message, StageRecord):
                self._hear_stage(message)

    def choose(self, number: int) -> None:
        """Note that the cell goes for this thing of its last picture."""
        self._chosen = number

    def _end(self, result: CycleResult) -> None:
        """A cycle has ended: what it left of the things of the last picture."""
        if result.result == "SUCCESS":
            self._gone = (*self._gone, *self._touching(self._chosen))
        else:
            self._chosen = 0  # it may still be there
            self._is_stirred = self._is_stirred or self._has_closed
        self._has_closed = False

    def _touching(self, number: int) -> tuple[int, ...]:
        """The other things that touch one in the picture: no one knows whether they still lie there without it."""
        if self._scene is None or not number:
            return ()
        labels = np.asarray(self._scene.labels)
        far_px = ndimage.distance_transform_edt(labels != number)
        near = np.unique(labels[far_px <= _TOUCHING * labels.shape[1]])
        return tuple(int(one) for one in near if one not in (0, number))

    def _hear_stage(self, record: StageRecord[Any]) -> None:
        result = record.result
        if record.stage == "execute":  # one that failed does not say how far it came
            self._has_closed = not isinstance(result, Execution) or result.grasped is not None
        elif isinstance(result, Verdict):
            self._gone = (*self._gone, *result.also_gone)
        elif isinstance(result, View):
            self._looks = [*(self._looks if result.why else ()), result]
        elif isinstance(result, Detections):
            self._found = result
            self._show(result.scene)
        elif isinstance(result, PickPlan) and self._found is not None:
            self.choose(self._found.grasps[result.grasp].instance)

    def _show(self, scene: ObservedScene) -> None:
        """A new picture with what was found in it: those before it count no more."""
        self._scene, self._chosen, self._gone, self._is_stirred = scene, 0, (), False
        self._shown = self._looks[scene.shown] if scene.shown < len(self._looks) else None
        self._live.clear()

    def show_live(self, stamp_ns: int, *, is_from_capture_pose: bool) -> tuple[int, tuple[int, ...]]:
        """Count a live picture. Returns: `LivePicture.things_ns` and ``gone``."""
        with self._alone:
            self._live[stamp_ns] = is_from_capture_pose
            while len(self._live) > _KEPT_LIVE:
                del self._live[next(iter(self._live))]
            if not is_from_capture_pose or self._is_stirred or self._shown is None or self._shown.why:
                return 0, ()
            chosen = (self._chosen,) if self._chosen else ()
            return self._shown.stamp_ns, tuple(sorted({*chosen, *self._gone}))

    def resolved(self, job: Job) -> Job:
        """Return the job with what it points at as the cell finds it from its capture pose.

        Raises: Refused (PICTURE_OUTDATED, PICTURE_ELSEWHERE, ALREADY_CHOSEN).
        """
        target = job.target
        if target is None or target.picture_ns is None:
            return job
        with self._alone:
            if target.picture_ns in self._live:
                if not self._live[target.picture_ns]:
                    raise Refused(
                        "That picture was not taken from where the cell looks.",
                        "Reset the cell: then it looks from there.",
                        code="PICTURE_ELSEWHERE",
                    )
                return job
            if self._scene is None or self._shown is None or target.picture_ns != self._shown.stamp_ns:
                raise Refused("The cell has looked again since that picture.", _AGAIN, code="PICTURE_OUTDATED")
            return self._in_scene(job, target, self._scene, is_elsewhere=bool(self._shown.why))

    def _in_scene(self, job: Job, target: Target, scene: ObservedScene, *, is_elsewhere: bool) -> Job:
        """The job whose target was pointed at in the picture of the last detection."""
        meant = meant_by(target, scene)
        if target.pixel is not None and self._chosen in meant:
            raise Refused("That is what the cell picks now, or has picked.", "Choose another.", code="ALREADY_CHOSEN")
        if not is_elsewhere:
            return job
        if len(meant) != 1:
            raise Refused(
                f"That picture was taken from beside, and {len(meant)} things are meant.",
                "Click a single thing, or wait for the next picture.",
                code="PICTURE_ELSEWHERE",
            )
        top = next(one.top_m for one in scene.instances if one.number == meant[0])
        carried = Target(point_m=(float(top[0]), float(top[1]), float(top[2])))
        return job.model_copy(update={"target": carried})


def meant_by(target: Target, scene: ObservedScene) -> list[int]:
    """Return the numbers of the things that a pixel or a box means in the shown picture; none where nothing is."""
    numbers: Iterable[int] = ()
    if target.box is not None:
        numbers = mostly_in_box(np.asarray(scene.labels), target.box)
    elif target.pixel is not None:
        try:
            numbers = (nearest_number(np.asarray(scene.labels), target.pixel),)
        except CycleFailure:  # nothing is near
            numbers = ()
    known = {one.number for one in scene.instances}
    return [number for number in numbers if number in known]

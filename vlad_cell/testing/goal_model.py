"""The checks that every goal-image model passes: reason, direct, render."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import pytest

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections
from config.plug_ins import Group
from config.schema import Station
from perception.detector import detect
from perception.models import Models
from perception.models.base import GoalImageModel
from perception.models.registry import GROUP, open_local
from perception.observed_object import Answer, ObservedObject
from vlad_cell.testing.plug_in import PlugInSuite
from vlad_cell.testing.scene import BAR, REGION, seen


class _Watched:
    """Hands every call to a model, and keeps what it was shown and what it answered."""

    def __init__(self, model: GoalImageModel) -> None:
        self._model = model
        self.name, self.is_hosted = model.name, model.is_hosted
        self.shown: ObservedObject | None = None
        self.answers: dict[str, Answer] = {}

    def begin(self) -> None:
        self._model.begin()

    def locate(self, color: npt.NDArray[np.uint8], prompt: str, cancel: Cancel) -> Answer:
        return self._model.locate(color, prompt, cancel)

    def reason(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        self.shown = observed_object
        self.answers["reason"] = self._model.reason(observed_object, prompt, cancel)
        return self.answers["reason"]

    def direct(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        self.answers["direct"] = self._model.direct(observed_object, prompt, cancel)
        return self.answers["direct"]

    def render(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        self.answers["render"] = self._model.render(observed_object, prompt, cancel)
        return self.answers["render"]

    def close(self) -> None:
        self._model.close()


@dataclass(frozen=True)
class _Run:
    """The result of the whole of perception for the bar with a model, and what the model was asked for it."""

    watched: _Watched
    detections: Detections

    @classmethod
    def of(cls, model: GoalImageModel, station: Station) -> _Run:
        watched = _Watched(model)
        watched.begin()
        return cls(watched, detect(seen([BAR]), station, Models(watched), lambda _: None))

    @property
    def poses(self) -> list[tuple[bytes, float]]:
        """The grasps' poses, bit for bit, and scores."""
        return [(one.base_from_tcp.tobytes(), one.score) for one in self.detections.grasps]


class GoalModelSuite(PlugInSuite):
    """The checks of a goal-image model, on a bar (127 x 30 x 30 mm) seen from above.

    A model that is paid for is asked about five times.
    """

    group: ClassVar[Group] = GROUP
    overrides: ClassVar[Sequence[str]] = (REGION,)

    @pytest.fixture(scope="class")
    @classmethod
    def station(cls) -> Station:
        """Return the station that names it, with its settings."""
        station = cls.configured()
        named = {"detector": "vlad", "model": cls.name, "settings": dict(cls.settings)}
        return station.model_copy(update={"perception": station.perception.model_copy(update=named)})

    @pytest.fixture(scope="class")
    @classmethod
    def model(cls, station: Station) -> Iterator[GoalImageModel]:
        """Yield the model, opened."""
        model = open_local(cls.name, station)
        yield model
        model.close()

    @pytest.fixture(scope="class")
    @classmethod
    def run(cls, model: GoalImageModel, station: Station) -> _Run:
        """One run of the whole of perception with it."""
        return _Run.of(model, station)

    def test_it_has_a_name_for_the_record_and_says_whether_its_calls_cost_money(self, model: GoalImageModel) -> None:
        assert isinstance(model.name, str) and model.name
        assert isinstance(model.is_hosted, bool)

    def test_its_rod_leads_to_a_grasp_on_the_bar(self, run: _Run) -> None:
        assert run.detections.grasps

    def test_it_answers_each_step_with_what_the_step_is_for(self, run: _Run) -> None:
        """Text, text, and a goal image aligned with the observed one, or else a picture as PNG."""
        shown, answers = run.watched.shown, run.watched.answers
        assert shown is not None and answers["reason"].text and answers["direct"].text
        goal = answers["render"].goal
        assert (goal is None) != (answers["render"].image_png is None)
        if goal is not None:
            assert goal.image.shape == shown.rgbd.color.shape and goal.image.dtype == np.uint8
            assert goal.depth_m is None or goal.depth_m.shape == shown.mask.shape

    def test_one_that_paints_into_the_image_paints_the_same_again(self, run: _Run, station: Station) -> None:
        """Its picture is not recorded: a replay opens it anew, asks again and compares."""
        if run.watched.answers["render"].goal is None:
            pytest.skip("its pictures are recorded, and a replay gives them back")
        anew = open_local(self.name, station)
        assert _Run.of(anew, station).poses == run.poses
        anew.close()

    def test_it_finds_a_thing_by_words_or_says_that_it_cannot(self, model: GoalImageModel) -> None:
        try:
            assert model.locate(seen([BAR]).frame.color, "Where is the bar?", Cancel()).text
        except CycleFailure as failure:
            assert failure.failure is Code.TARGET_NOT_FOUND

    def test_after_a_stop_it_answers_or_ends_with_stopped(self, model: GoalImageModel, run: _Run) -> None:
        stopped = Cancel()
        stopped.set()
        model.begin()
        assert run.watched.shown is not None
        try:
            model.reason(run.watched.shown, "Where would you grasp it?", stopped)
        except CycleFailure as failure:
            assert failure.failure is Code.STOPPED
        else:
            assert not model.is_hosted, "no call that costs money begins after a stop"

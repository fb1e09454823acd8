"""Another package's goal-image model that hangs, raises, or gives what is no answer: named, and no defect of ours."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from benchmarks.baselines.flat import flat_object
from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import ModelReply
from config.load import load_station
from perception.detector import detect
from perception.goal.imagine import Conversation
from perception.models import Models, replayed_models
from perception.models.geometric import GeometricModel
from perception.models.painter import paint
from perception.models.plug_in_model import PlugInModel
from perception.observed_object import Answer, ObservedObject
from perception.proposal import propose
from tests.perception.conftest import BAR, Look

STATION = load_station(None, ["scene.pick_region_m=[0.1, 0.8, -0.3, 0.3]"])
NAMED = "The goal-image model 'acme' of package acme-model"
Render = Callable[[ObservedObject], Any]


class Acme(GeometricModel):
    """Ours, but for its picture."""

    name = "acme"

    def __init__(self, render: Render) -> None:
        super().__init__(STATION)
        self._draw = render

    def render(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
        answer: Answer = self._draw(observed_object)
        return answer


@pytest.fixture(scope="module")
def observed_object() -> ObservedObject:
    """A bar, 40 x 130 mm at 1 mm a pixel."""
    color, mask = np.full((240, 320, 3), 170, np.uint8), np.zeros((240, 320), np.uint8)
    cv2.rectangle(mask, (140, 55), (180, 185), 1, -1)
    color[mask > 0] = (40, 90, 200)
    return flat_object(color, mask > 0, 0.001, STATION)


def failure_of(render: Render, observed_object: ObservedObject) -> CycleFailure:
    model = PlugInModel(Acme(render), "acme", "acme-model 0.1.0", 5.0)
    with pytest.raises(CycleFailure) as failed:
        propose(Conversation(model, lambda _: None), observed_object, Models(model), STATION)
    return failed.value


def raises(error: BaseException) -> Render:
    def render(_: ObservedObject) -> Any:
        raise error

    return render


def painted(**changed: Any) -> Render:
    """A rod across the bar, with other parts than those that were painted."""

    def render(observed_object: ObservedObject) -> Answer:
        at_m = observed_object.rgbd.camera
        middle_m = float(np.nanmedian(observed_object.level_depth_m))
        ends = np.array([[-0.06, 0.0, middle_m], [0.06, 0.0, middle_m]])
        ends[:, :2] += [(160 - at_m.cx) * middle_m / at_m.fx, (120 - at_m.cy) * middle_m / at_m.fy]
        goal = paint(observed_object, ends, 0.004)
        assert goal.painted is not None
        own = {name: value for name, value in changed.items() if name in ("image", "depth_m", "painted")}
        parts = {name: value for name, value in changed.items() if name not in own}
        return Answer("painted", goal=replace(goal, **{"painted": replace(goal.painted, **parts), **own}))

    return render


@pytest.mark.parametrize(
    ("render", "said"),
    [
        (raises(KeyError("rod")), "failed: KeyError: 'rod'."),
        (raises(ValueError("no weights.")), "failed: ValueError: no weights."),
        (raises(SystemExit(3)), "failed: SystemExit: 3."),
        (raises(KeyboardInterrupt()), "failed: KeyboardInterrupt."),
        (raises(CycleFailure(Code.ARM_REFLEX, "It aborts the cell.")), "ended with ARM_REFLEX: It aborts the cell."),
        (lambda _: None, "gave NoneType in render, and no Answer."),
        (lambda _: Answer(text=7), "gave Answer.text = int, and it is str."),  # type: ignore[arg-type]
        (lambda seen: Answer(goal=seen.masked), "gave Answer.goal = ndarray, and it is GoalImage."),
        (lambda seen: Answer(goal=paint(seen, np.full((2, 3), np.nan), 0.004)), "failed: ValueError: ends = [[nan"),
        (painted(image=np.zeros((8, 8, 3), np.uint8)), "gave GoalImage.image = (8, 8, 3) of uint8, and it is (2"),
        (painted(depth_m=[1, 2]), "gave GoalImage.depth_m = list, and it is"),
        (painted(rod=np.zeros((8, 8))), "gave PaintedRod.rod = (8, 8) of float64, and it is"),
        (painted(run=np.full((2, 3), np.nan)), "gave PaintedRod.run that is not of finite numbers."),
        (painted(run=np.ones((2, 3))), "gave PaintedRod.run that is no line in front of the camera."),
        (painted(approach_base=np.zeros(3)), "gave PaintedRod.approach_base that is not of length 1."),
    ],
)
def test_what_it_does_wrong_is_said_with_its_name_and_its_package(
    observed_object: ObservedObject, render: Render, said: str
) -> None:
    failure = failure_of(render, observed_object)
    assert failure.failure is Code.MODEL_FAILED
    assert f"{NAMED} {said}" in failure.text and ".." not in failure.text.removesuffix(" ...")
    assert failure.advice.endswith("The plug-in comes with acme-model 0.1.0.")


def test_a_rod_that_is_nowhere_or_without_depth_is_no_rod(observed_object: ObservedObject) -> None:
    shape = observed_object.mask.shape
    for render in (
        painted(rod=np.zeros(shape, bool)),
        painted(object=np.zeros(shape, bool)),
        painted(depth_m=np.full(shape, np.nan, np.float32)),
        painted(depth_m=np.zeros(shape, np.float32)),
    ):
        assert failure_of(render, observed_object).failure is Code.MODEL_NO_ROD
    blind = painted(depth_m=np.full(shape, np.nan, np.float32), painted=None)
    assert failure_of(blind, observed_object).failure is Code.MODEL_DRIFT


def test_the_pick_fails_and_the_next_one_works(look: Look) -> None:
    broken, replies = [True], list[ModelReply]()

    class Once(GeometricModel):
        def render(self, observed_object: ObservedObject, prompt: str, cancel: Cancel) -> Answer:
            if broken[0]:
                raise KeyError("rod")
            return super().render(observed_object, prompt, cancel)

    models = Models(PlugInModel(Once(STATION), "acme", "acme-model", 5.0))
    with pytest.raises(CycleFailure, match="'acme' of package acme-model failed: KeyError: 'rod'") as failed:
        detect(look([BAR]), STATION, models, replies.append)
    assert failed.value.failure is Code.MODEL_FAILED and Code.MODEL_FAILED in {one.failure for one in replies}
    broken[0] = False
    assert detect(look([BAR]), STATION, models, replies.append).grasps


def test_one_that_fails_to_begin_or_to_close_ends_neither_cell_nor_program(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise SystemExit(1)

    torn = GeometricModel(STATION)
    monkeypatch.setattr(torn, "begin", fail)
    monkeypatch.setattr(torn, "close", fail)
    model = PlugInModel(torn, "acme", "acme-model", 5.0)
    with pytest.raises(CycleFailure, match="failed: SystemExit: 1"):
        model.begin()
    model.close()


def test_one_that_hangs_as_a_cycle_begins_is_recorded_and_does_so_again_in_a_replay(
    look: Look, monkeypatch: pytest.MonkeyPatch, answered: threading.Event
) -> None:
    slow, replies = GeometricModel(STATION), list[ModelReply]()
    monkeypatch.setattr(slow, "begin", lambda: answered.wait(60))
    hanging = Models(PlugInModel(slow, "acme", "acme-model 0.1.0", 0.05))
    with pytest.raises(CycleFailure, match="gave no answer within") as failed:
        detect(look([BAR]), STATION, hanging, replies.append)
    again = replayed_models(STATION, replies)
    with pytest.raises(CycleFailure) as replayed:
        detect(look([BAR]), STATION, again, replies.append)
    assert replayed.value.text == failed.value.text
    assert [(one.step, one.failure) for one in replies] == [("begin", Code.MODEL_TIMEOUT)] * 2


@pytest.fixture
def answered() -> Iterator[threading.Event]:
    event = threading.Event()
    yield event
    event.set()


def test_one_that_hangs_ends_in_time_and_is_left_behind(
    observed_object: ObservedObject, answered: threading.Event
) -> None:
    """And a replay, whose model might hang again, has the same end."""

    def hang(_: ObservedObject) -> Any:
        answered.wait(60)

    model, replies = PlugInModel(Acme(hang), "acme", "acme-model", 0.05), list[ModelReply]()
    talk = Conversation(model, replies.append)
    for said in ("gave no answer within 0.05 s.", "is still busy"):
        with pytest.raises(CycleFailure, match=said) as failed:
            propose(talk, observed_object, Models(model), STATION)
        assert failed.value.failure is Code.MODEL_TIMEOUT and NAMED in failed.value.text
    model.close()
    assert all(one.daemon for one in threading.enumerate() if "acme" in one.name), "the process ends without it"
    again = replayed_models(STATION, replies[:3])
    with pytest.raises(CycleFailure, match="no answer within"):
        propose(Conversation(again.imaginer, lambda _: None), observed_object, again, STATION)


def test_a_stop_does_not_wait_for_it(observed_object: ObservedObject, answered: threading.Event) -> None:
    stop = Cancel()

    def hang(_: ObservedObject) -> Any:
        stop.set()
        answered.wait(60)

    model = PlugInModel(Acme(hang), "acme", "acme-model", 60.0)
    with pytest.raises(CycleFailure) as failed:
        propose(Conversation(model, lambda _: None, cancel=stop), observed_object, Models(model), STATION)
    assert failed.value.failure is Code.STOPPED

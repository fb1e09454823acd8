"""A goal-image model that misbehaves on demand: how a proposal ends, and that its recorded replies replay."""

from __future__ import annotations

import threading
import time

import cv2
import numpy as np
import pytest

from benchmarks.baselines.flat import flat_object
from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.fault_injection import Fault
from bus.messages import ModelReply
from cell.fault_injection import FaultInjection
from config.load import load_station
from perception.goal.imagine import Conversation
from perception.models import Models, open_models, replayed_models
from perception.models.fault_injection import FaultyModel
from perception.observed_object import ObservedObject
from perception.proposal import Proposal, propose

STATION = load_station(None, ["faults.allowed=true", "faults.delay_s=0.1", "perception.hosted.deadline_s=0.1"])


@pytest.fixture(scope="module")
def observed_object() -> ObservedObject:
    """A bar, 40 x 130 mm at 1 mm a pixel, turned by 30 degrees."""
    color = np.full((360, 480, 3), 170, np.uint8)
    mask = np.zeros((360, 480), np.uint8)
    corners = cv2.boxPoints(((240, 180), (130, 40), 30)).astype(int)
    cv2.fillPoly(color, [corners], (40, 90, 200))
    cv2.fillPoly(mask, [corners], 1)
    return flat_object(color, mask > 0, 0.001, STATION)


@pytest.fixture
def models() -> Models:
    return FaultInjection(STATION).around(open_models(STATION, {}))


def spoil(models: Models, fault: Fault) -> None:
    assert isinstance(models.imaginer, FaultyModel)
    models.imaginer.fault = fault


def proposed(models: Models, observed_object: ObservedObject, replies: list[ModelReply]) -> Proposal:
    models.imaginer.begin()
    return propose(Conversation(models.imaginer, replies.append), observed_object, models, STATION)


@pytest.mark.parametrize(
    ("fault", "codes"),
    [
        (Fault.OFF, {Code.MODEL_UNAVAILABLE}),
        (Fault.STUCK, {Code.MODEL_TIMEOUT}),
        (Fault.GARBAGE, {Code.MODEL_BAD_IMAGE}),
        (Fault.WRONG, {Code.MODEL_DRIFT, Code.MODEL_NO_ROD}),
    ],
)
def test_a_fault_has_its_code_and_its_replies_replay(
    models: Models, observed_object: ObservedObject, fault: Fault, codes: set[Code]
) -> None:
    spoil(models, fault)
    replies: list[ModelReply] = []
    with pytest.raises(CycleFailure) as failed:
        proposed(models, observed_object, replies)
    assert failed.value.failure in codes
    with pytest.raises(CycleFailure) as again:
        proposed(replayed_models(STATION, replies), observed_object, [])
    assert (again.value.failure, again.value.text) == (failed.value.failure, failed.value.text)


def test_a_slow_model_draws_the_same_later(models: Models, observed_object: ObservedObject) -> None:
    replies: list[ModelReply] = []
    promptly = proposed(models, observed_object, replies)
    spoil(models, Fault.SLOW)
    started_s = time.monotonic()
    np.testing.assert_array_equal(proposed(models, observed_object, []).goal.image, promptly.goal.image)
    assert time.monotonic() - started_s >= 0.3  # three calls
    anew = proposed(replayed_models(STATION, replies), observed_object, [])
    np.testing.assert_array_equal(anew.goal.image, promptly.goal.image)


def test_the_end_of_a_fault_ends_the_wait(observed_object: ObservedObject) -> None:
    model = FaultyModel(open_models(STATION, {}).imaginer, Fault.STUCK, deadline_s=60.0)
    healing = threading.Timer(0.05, lambda: setattr(model, "fault", Fault.NONE))
    healing.start()
    assert model.reason(observed_object, "", Cancel()).text
    healing.join()

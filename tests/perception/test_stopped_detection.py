"""A stop during detect: nothing more is asked, what was begun is said, and what it cost is booked where it belongs."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.fault_injection import Fault
from bus.messages import ModelReply, Usage
from cell.fault_injection import FaultInjection
from cell.pick.detect import detect_unless_halted
from config.load import load_station
from config.perception import HostedSettings, PriceSettings
from perception.detector import detect
from perception.models import Models, open_models
from perception.models.budget import Budget
from perception.models.errors import ModelError
from perception.models.fault_injection import FaultyModel
from perception.models.hosted import HostedModel
from perception.observed_object import Answer
from tests.perception.conftest import BAR, Look

STATION = load_station(
    None, ["scene.pick_region_m=[0.1, 0.8, -0.3, 0.3]", "perception.imagine.samples=4", "faults.allowed=true"]
)
PRICE = PriceSettings(usd_per_million_input_tokens=1e6)
"""1 USD a token."""


class Slow:
    """A provider whose every call waits to be answered."""

    name = "slow"

    def __init__(self) -> None:
        self.asked, self.answers, self.calls = threading.Event(), threading.Event(), 0
        self.fault: ModelError | None = None

    def complete(self, prompt: str, image_png: bytes | None, timeout_s: float) -> Answer:
        self.calls += 1
        self.asked.set()
        assert self.answers.wait(60)
        if self.fault is not None:
            raise self.fault
        return Answer("an axis", usage=Usage(input_tokens=3))

    def edit(self, image_png: bytes, keep_png: bytes, prompt: str, timeout_s: float) -> Answer:
        raise AssertionError("nothing is drawn in these tests")

    def close(self) -> None:
        """It holds nothing."""


@pytest.fixture
def provider() -> Slow:
    return Slow()


@pytest.fixture
def ledger(tmp_path: Path) -> Path:
    return tmp_path / "spend.jsonl"


@pytest.fixture
def model(provider: Slow, ledger: Path) -> HostedModel:
    how = HostedSettings(price=PRICE, backoff_s=60.0, max_cycle_usd=5.0)
    return HostedModel(provider, how, Budget(how, ledger))


def stopped(look: Look, models: Models, when: Callable[[], bool]) -> list[ModelReply]:
    """Return what was said when a stop came as ``when`` became true."""
    said: list[ModelReply] = []
    with pytest.raises(CycleFailure, match="Stopped during 'detect'") as failure:
        detect_unless_halted([look([BAR])], STATION, models, said.append, when)
    assert failure.value.failure is Code.STOPPED
    return said


def spent_usd(ledger: Path, lines: int) -> list[float]:
    """The ledger's amounts, once it has so many lines."""
    end_s = time.monotonic() + 60.0
    while time.monotonic() < end_s and (not ledger.exists() or ledger.read_text().count("\n") < lines):
        time.sleep(0.005)
    return [json.loads(line)["usd"] for line in ledger.read_text().splitlines()]


def test_the_call_under_way_is_given_up_said_and_the_last_one(look: Look, provider: Slow, model: HostedModel) -> None:
    said = stopped(look, Models(model), provider.asked.is_set)
    provider.answers.set()
    assert [(reply.step, reply.failure) for reply in said] == [("reason", Code.STOPPED)]
    assert "given up" in said[0].text_of_failure and said[0].prompt
    assert provider.calls == 1


def test_what_a_given_up_call_cost_is_on_the_ledger_and_not_on_the_next_cycle(
    look: Look, provider: Slow, model: HostedModel, ledger: Path, caplog: pytest.LogCaptureFixture
) -> None:
    stopped(look, Models(model), provider.asked.is_set)
    model.begin()
    provider.answers.set()
    assert spent_usd(ledger, 1) == [3.0]
    for _ in range(2):  # 3 USD each, of 5: a third call would not be made
        assert model.direct(None, "Say.", Cancel()).text == "an axis"  # type: ignore[arg-type]
    with pytest.raises(CycleFailure, match=r"6\.00 USD this cycle"):
        model.direct(None, "Say.", Cancel())  # type: ignore[arg-type]
    assert "given up has cost 3.0000 USD" in caplog.text


def test_a_stop_ends_the_wait_before_the_next_attempt(look: Look, provider: Slow, model: HostedModel) -> None:
    provider.fault = ModelError(Code.MODEL_QUOTA, "slowly", again=True)
    provider.answers.set()
    said = stopped(look, Models(model), provider.asked.is_set)
    assert [(reply.failure, provider.calls) for reply in said] == [(Code.STOPPED, 1)]


def test_after_a_stop_nothing_begins(look: Look, provider: Slow, model: HostedModel) -> None:
    cancel = Cancel()
    cancel.set()
    with pytest.raises(CycleFailure):
        detect(look([BAR]), STATION, Models(model), lambda _: None, cancel)
    with pytest.raises(CycleFailure):
        model.direct(None, "Say.", cancel)  # type: ignore[arg-type]
    assert provider.calls == 0


def test_a_stop_between_proposals_ends_the_embedded_model_too(look: Look) -> None:
    cancel, said = Cancel(), list[ModelReply]()

    def stop_at_the_second(reply: ModelReply) -> None:
        said.append(reply)
        if reply.sample == 1:
            cancel.set()

    with pytest.raises(CycleFailure) as failure:
        detect(look([BAR]), STATION, open_models(STATION, {}), stop_at_the_second, cancel)
    assert failure.value.failure is Code.STOPPED and [reply.sample for reply in said] == [0, 0, 0, 1]


def test_a_stop_ends_an_injected_hang(look: Look) -> None:
    models = FaultInjection(STATION).around(open_models(STATION, {}))
    assert isinstance(models.imaginer, FaultyModel)
    models.imaginer.fault = Fault.STUCK
    began = threading.Event()
    wrapped = models.imaginer._model

    def reason(*asked: Any) -> Answer:
        began.set()
        return wrapped.reason(*asked)

    models.imaginer._model = SimpleNamespace(name="said", is_hosted=False, begin=wrapped.begin, reason=reason)
    said = stopped(look, models, began.is_set)
    assert [reply.failure for reply in said] == [Code.STOPPED]


def test_a_deadline_ends_a_call_that_its_provider_does_not(provider: Slow, ledger: Path) -> None:
    how = HostedSettings(price=PRICE, deadline_s=0.1)
    model = HostedModel(provider, how, Budget(how, ledger))
    with pytest.raises(CycleFailure) as failure:
        model.direct(None, "Say.", Cancel())  # type: ignore[arg-type]
    assert failure.value.failure is Code.MODEL_TIMEOUT and provider.calls == 1
    provider.answers.set()
    assert spent_usd(ledger, 1) == [3.0]


def test_a_call_that_fails_late_costs_what_it_says(provider: Slow, model: HostedModel, ledger: Path) -> None:
    provider.fault = ModelError(Code.MODEL_REFUSED, "no", usage=Usage(input_tokens=2))
    provider.answers.set()
    with pytest.raises(CycleFailure, match="no"):
        model.direct(None, "Say.", Cancel())  # type: ignore[arg-type]
    assert spent_usd(ledger, 1) == [2.0]

"""A detector that another package brings, as an entry point of the group ``vlad_cell.detectors``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.cancel import Cancel
from bus.codes import DETECTOR_FOUND_NONE, Code
from bus.errors import ConfigError, CycleFailure
from bus.messages import Detections, ModelReply
from cell.replay.replay import Request, replay
from config.load import load_station
from config.plug_ins import Group
from config.schema import Station
from logs.differences import compare
from logs.mcap.reader import read_cycle
from logs.report.cycle_report import write_report
from perception.detector import detect
from perception.detectors.base import FoundGrasp, SeenScene
from perception.detectors.registry import GROUP, open_detector
from perception.models import Models, open_models, replayed_models
from perception.models.detector_call import DetectorCall
from perception.models.geometric import GeometricModel
from tests.docs.example_packages import EXAMPLES, information, install
from tests.perception.conftest import BAR, PLATE, Look

REGION = "scene.pick_region_m=[0.1, 0.8, -0.3, 0.3]"
STATION = load_station(None, [REGION, "perception.detector=acme"])


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, tmp_path, "detector", more="broken = not_there:Tongs")


class Fake:
    """Gives what it was made with: grasps, or an error that it raises."""

    is_deterministic = False

    def __init__(self, given: Any) -> None:
        self.given, self.asked = given, list[SeenScene]()

    def detect(self, seen: SeenScene, cancel: object) -> Sequence[FoundGrasp]:
        self.asked.append(seen)
        if isinstance(self.given, BaseException):
            raise self.given
        given: Sequence[FoundGrasp] = self.given
        return given

    def close(self) -> None: ...


def grasp(x_m: float, y_m: float, width_m: float = 0.03, score: float = 0.5, instance: int | None = None) -> FoundGrasp:
    """From above, 10 mm above the table, closing along y."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = x_m, y_m, 0.01
    return FoundGrasp(pose, width_m, score, instance)


def found(look: Look, fake: Fake, station: Station = STATION) -> tuple[Detections, list[ModelReply]]:
    """Return what the fake detector gives on a bar and a plate, and what was recorded of it."""
    replies: list[ModelReply] = []
    models = Models(GeometricModel(station), detector=DetectorCall("acme", fake, 5.0, "acme-detector 0.1.0"))
    return detect(look([BAR, PLATE]), station, models, replies.append), replies


def place_of(look: Look, number: int) -> tuple[float, float]:
    """Where thing ``number`` was seen, x and y in ``base``."""
    fake = Fake([])
    with pytest.raises(CycleFailure):
        found(look, fake)
    x_m, y_m, _ = fake.asked[0].things[number - 1].top_m
    return float(x_m), float(y_m)


def test_it_gets_what_was_seen_and_its_grasps_are_ranked_and_given_their_things(look: Look) -> None:
    one, other = place_of(look, 1), place_of(look, 2)
    fake = Fake([grasp(*one, score=0.4), grasp(*other, score=0.9), grasp(*one, score=0.6, instance=1)])
    detections, replies = found(look, fake)
    seen = fake.asked[0]
    assert seen.look.color.shape == (360, 480, 3) and seen.look.depth_m.shape == seen.look.labels.shape == (360, 480)
    assert set(np.unique(seen.look.labels)) == {0, 1, 2} and seen.targets == (1, 2)
    assert not seen.look.depth_m.flags.writeable
    assert [(one.instance, one.score) for one in detections.grasps] == [(2, 0.9), (1, 0.6), (1, 0.4)]
    assert detections.grasps[0].opening_m == pytest.approx(0.03 + 2 * STATION.perception.approach_clearance_m)
    assert detections.detector == "acme" and [reply.step for reply in replies] == ["detect"]
    assert [(one.instance, one.score) for one in detections.tried] == [(1, 0.6), (2, 0.9)]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (ValueError("no weights"), "failed: ValueError: no weights"),
        (SystemExit(3), "failed: SystemExit: 3."),
        (CycleFailure(Code.ARM_REFLEX, "It aborts the cell."), "ended with ARM_REFLEX"),
        (None, "gave NoneType, and no sequence"),
        ([{"pose": 1}], "gave dict as grasp 0"),
        ([grasp(0.4, 0.0), grasp(0.4, 0.0, width_m=0.09)], "grasp 1 with width_m = 0.09: it lies in (0, 0.08]"),
        ([grasp(0.4, 0.0, score=7.0)], "grasp 0 with score = 7"),
        ([grasp(0.4, 0.0, instance=3)], "grasp 0 with instance = 3: there are things 1 to 2"),
        ([grasp(0.4, 0.0, instance=1.7)], "grasp 0 with instance = 1.7: there are"),  # type: ignore[arg-type]
        ([grasp(np.nan, 0.0)], "grasp 0 whose base_from_tcp is not (4, 4) of finite numbers"),
        ([FoundGrasp(np.diag([1.0, 1.0, -1.0, 1.0]), 0.03, 0.5)], "grasp 0 whose base_from_tcp is no rotation"),
        ([FoundGrasp(np.eye(4), "wide", 0.5)], "grasp 0 that is not made of numbers"),  # type: ignore[arg-type]
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_no_grasp_ends_the_cycle_with_the_detector_s_name_and_the_field(
    look: Look, given: Any, said: str
) -> None:
    with pytest.raises(CycleFailure) as failure:
        found(look, Fake(given))
    assert failure.value.failure is Code.DETECTOR_FAILED
    assert "'acme'" in failure.value.text and said in failure.value.text
    assert failure.value.advice.endswith(
        "or set perception.detector to 'vlad'. The plug-in comes with acme-detector 0.1.0."
    )


def test_no_grasp_at_all_is_no_grasp(look: Look) -> None:
    with pytest.raises(CycleFailure, match=r"'acme' finds no grasp on the 2 things") as failure:
        found(look, Fake([]))
    assert failure.value.failure is Code.NO_GRASP
    assert failure.value.advice == DETECTOR_FOUND_NONE


def test_grasps_of_nothing_seen_and_of_what_failed_before_are_left_out_with_the_reason(look: Look) -> None:
    one = place_of(look, 1)
    models = Models(GeometricModel(STATION), detector=DetectorCall("acme", Fake([grasp(0.1, 0.28), grasp(*one)]), 5.0))
    with pytest.raises(
        CycleFailure,
        match=r"thing 1: it is not to be picked; thing 2: nothing was seen of .* \(0\.100, 0\.280, 0\.010\) m",
    ):
        detect(look([BAR, PLATE]), STATION, models, lambda _: None, failed_at=[np.array([*one, 0.02])])


def test_one_that_is_slow_ends_the_cycle_and_is_not_asked_a_second_time_meanwhile(look: Look) -> None:
    answered = threading.Event()

    class Slow(Fake):
        def detect(self, seen: SeenScene, cancel: object) -> Sequence[FoundGrasp]:
            assert answered.wait(60)
            return super().detect(seen, cancel)

    slow = Slow([])
    models = Models(GeometricModel(STATION), detector=DetectorCall("acme", slow, 0.01))
    try:
        for said in ("no answer within 0.01 s", "still busy"):
            with pytest.raises(CycleFailure, match=said) as failure:
                detect(look([BAR]), STATION, models, lambda _: None)
            assert failure.value.failure is Code.DETECTOR_TIMEOUT
    finally:
        answered.set()


def test_a_replay_gives_back_the_grasps_of_one_that_is_not_deterministic(look: Look) -> None:
    """Its package is not installed here: only the record is read."""
    detections, replies = found(look, Fake([grasp(*place_of(look, 2), width_m=0.1 / 3)]))
    again = detect(look([BAR, PLATE]), STATION, replayed_models(STATION, replies), lambda _: None)
    assert not compare(detections, again, {})


def test_a_timeout_happens_again_in_a_replay() -> None:
    reply = ModelReply(
        step="detect", model="acme", prompt="", text='{"is_deterministic": true, "grasps": []}',
        failure=Code.DETECTOR_TIMEOUT, text_of_failure="too slow",
    )  # fmt: skip
    again = replayed_models(STATION, [reply]).detector
    assert again is not None
    with pytest.raises(CycleFailure, match="too slow"):
        again.ask(SeenScene((), 0, (), (1,), np.eye(4), STATION.hand), lambda _: None, Cancel())


# --- the example, from outside ----------------------------------------------------------------------------------------


@pytest.mark.usefixtures("package")
def test_its_settings_are_checked_by_its_own_model_and_an_error_names_the_field() -> None:
    assert GROUP.names() == ("acme", "broken", "vlad")
    for override, said in (
        ("perception.settings.headings=1", r"perception\.settings\.headings: .*greater than or equal to 2"),
        ("perception.settings.heading=4", r"perception\.settings\.heading: Extra inputs"),
    ):
        with pytest.raises(ConfigError, match=said):
            open_models(load_station(None, ["perception.detector=acme", override]), {})
    with pytest.raises(ConfigError, match=r"'broken' cannot be loaded.*not_there"):
        open_models(load_station(None, ["perception.detector=broken"]), {})
    with pytest.raises(ConfigError, match=r"perception\.settings\.headings: neither the detector 'vlad' nor"):
        open_models(load_station(None, ["perception.settings.headings=4"]), {})


def test_one_that_does_not_say_whether_it_is_deterministic_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    unsure = Fake([])
    unsure.is_deterministic = "perhaps"  # type: ignore[assignment]
    monkeypatch.setattr(Group, "opened", lambda *_: unsure)
    with pytest.raises(
        ConfigError, match=r"is_deterministic of the detector 'acme' is 'perhaps', and no True or False"
    ):
        open_detector(STATION)


def test_an_unknown_detector_is_refused_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match=r"Unknown detector 'acme'.*vlad"):
        open_models(load_station(None, ["perception.detector=acme"]), {})


@pytest.mark.thorough
def test_a_cell_picks_records_replays_and_reports_with_it(tmp_path: Path, endpoint: str) -> None:
    site = information(tmp_path, "detector")
    path = os.pathsep.join([str(EXAMPLES.parent), str(site), str(EXAMPLES / "detector")])
    overrides = [
        f"bus.endpoint={endpoint}",
        "perception.detector=acme",
        "perception.settings.headings=36",
        "verify.hold_s=0.5",
    ]
    command = [sys.executable, "-m", "cell", "start", "--cycles", "1", "--seed", "1", "--json"]
    run = subprocess.run(
        [*command, *(word for one in overrides for word in ("--set", one))],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    (result,) = (json.loads(line) for line in run.stdout.splitlines())
    assert result["result"] == "SUCCESS", run.stderr
    record = read_cycle(tmp_path / result["recording"])
    assert record.station["perception"]["settings"] == {"headings": 36}, "they are recorded, and used again in a replay"
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(EXAMPLES / "detector")
        patch.syspath_prepend(site)
        again = replay(record, Request())
        assert again.equal and again.grasps > 0, "it is deterministic, so it is asked again"
    page = write_report(record, tmp_path / "report.html").read_text()
    assert "What the detector acme found" in page

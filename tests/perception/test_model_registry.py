"""A goal-image model that another package brings, as an entry point of the group ``vlad_cell.goal_models``."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest

from bus.errors import ConfigError
from bus.messages import ModelReply
from cell.doctor import reach
from cell.doctor.finding import Verdict
from config.load import load_station
from config.plug_ins import Group
from config.schema import Station
from perception.detectors.registry import GROUP as DETECTORS
from perception.models import open_models, opening, replayed_models
from perception.models.geometric import GeometricModel
from perception.models.plug_in_model import PlugInModel
from perception.models.recorded import RecordedModel
from perception.models.registry import GROUP, open_local
from tests.dist_info import write_dist_info

_MODULE = """
import threading
from perception.models.geometric import GeometricModel

class Painter(GeometricModel):
    name = "painter"

goes_on = threading.Event()

class Stuck(Painter):
    def __init__(self, station):
        goes_on.wait()
"""
_FORMER = "vlad_cell.models"
_ENTRY_POINTS = {
    GROUP.name: (
        "painter = painter_for_tests:Painter",
        "broken = painter_for_tests_that_is_not_there:Painter",
        "geometric = painter_for_tests:Painter",
        "stuck = painter_for_tests:Stuck",
    ),
    DETECTORS.name: ("stuck = painter_for_tests:Stuck",),
    _FORMER: ("forgotten = painter_for_tests:Painter",),
}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package: a module, and the folder in which its installer says what it brings."""
    (tmp_path / "painter_for_tests.py").write_text(_MODULE)
    write_dist_info(tmp_path, "painter-for-tests", "1.0", _ENTRY_POINTS)
    monkeypatch.syspath_prepend(tmp_path)


def station(model: str) -> Station:
    return load_station(None, [f"perception.model={model}"])


def reply(image_png: bytes | None) -> ModelReply:
    return ModelReply(step="render", model="painter", prompt="Draw.", image_png=image_png)


@pytest.mark.usefixtures("package")
def test_a_station_names_it_like_any_other() -> None:
    assert "painter" in GROUP.names()
    assert open_models(station("painter"), {}).imaginer.name == "painter"
    assert reach.model_key(station("painter"), {}).verdict is Verdict.SKIP


@pytest.mark.usefixtures("package")
def test_no_package_takes_the_place_of_one_of_ours() -> None:
    assert type(open_models(station("geometric"), {}).imaginer) is GeometricModel


@pytest.mark.usefixtures("package")
def test_a_model_whose_package_cannot_be_imported_says_so() -> None:
    with pytest.raises(ConfigError, match=r"'broken' cannot be loaded.*not_there"):
        open_models(station("broken"), {})


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize(("key", "kind"), [("model", "goal-image model"), ("detector", "detector")])
def test_one_that_never_starts_is_named_while_it_is_waited_for_and_refused_in_the_end(
    key: str, kind: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.delitem(sys.modules, "painter_for_tests", raising=False)  # it starts again after another test's
    monkeypatch.setattr(opening, "SLOW_S", 0.01)
    monkeypatch.setattr(opening, "LIMIT_S", 0.02)
    try:
        with pytest.raises(ConfigError) as error:
            open_models(load_station(None, [f"perception.{key}=stuck"]), {})
    finally:
        import_module("painter_for_tests").goes_on.set()
    assert error.value.text == f"The {kind} 'stuck' of painter-for-tests 1.0 has not started within 0.02 s."
    assert f"waiting for the {kind} 'stuck' of painter-for-tests 1.0 to start" in caplog.text


@pytest.mark.parametrize(
    ("member", "value", "said"),
    [
        ("name", "", "is no text: ''"),
        ("name", 7, "is no text: 7"),
        ("is_hosted", "no", "is 'no', and no True or False"),
    ],
)
def test_a_model_that_says_of_itself_what_cannot_be_is_refused(
    member: str, value: object, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = GeometricModel(load_station())
    setattr(model, member, value)
    monkeypatch.setattr(Group, "opened", lambda *_: model)
    with pytest.raises(ConfigError, match=said):
        open_local("acme", load_station())


@pytest.mark.usefixtures("package")
def test_a_package_of_the_group_s_former_name_is_told_the_new_one() -> None:
    with pytest.raises(ConfigError, match=r"'forgotten' of painter-for-tests 1.0 .* it is vlad_cell.goal_models now"):
        open_models(station("forgotten"), {})


def test_an_unknown_model_is_refused_with_the_names_of_those_there_are() -> None:
    named = r"'geometrc'.*gemini, geometric, onnx, openai"
    with pytest.raises(ConfigError, match=named):
        open_models(station("geometrc"), {})
    with pytest.raises(ConfigError, match=named):
        replayed_models(station("geometrc"), [])
    finding = reach.model_key(station("geometrc"), {})
    assert finding.verdict is Verdict.FIX and "geometric" in finding.advice


@pytest.mark.usefixtures("package")
def test_a_replay_gives_back_the_pictures_it_drew_and_asks_one_that_paints_again() -> None:
    assert isinstance(replayed_models(station("painter"), [reply(b"PNG")]).imaginer, RecordedModel)
    assert replayed_models(station("painter"), [reply(None)]).imaginer.name == "painter"
    assert isinstance(replayed_models(station("painter"), [reply(None)]).imaginer, PlugInModel)

"""The report page: whole, self-contained, safe, for cycles that ended anywhere; and a browser draws it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates

from bus.codes import Code
from bus.commands import Event, Health
from bus.errors import RecordingError
from bus.messages import ArmMode, ArmState, Attempt, Detections, Tried
from bus.rejection import Obstacle
from bus.sensor_codec import arm_state_to_wire
from docs.browser import find_chromium
from logs.mcap.reader import Timed, read_cycle
from logs.report.cycle_report import configuration_changes, write_report
from logs.report.day_report import INDEX, days, write_cycle, write_day
from logs.report.timeline import summarize
from tests.logs.browser import Page, chromium
from tests.logs.conftest import REJECTED

Record = Callable[..., Path]
HOSTILE = "<script>alert('arm')</script>"
SECTIONS = ("timeline", "seen", "imagined", "aligned", "grasps", "plan", "motion", "verdict", "log", "configuration",
            "about")  # fmt: skip
MISSING: dict[str | None, tuple[str, ...]] = {
    "capture": ("seen", "aligned", "grasps", "plan", "motion", "verdict"),
    "detect": ("aligned", "grasps", "plan", "motion", "verdict"),
    "plan": ("plan", "motion", "verdict"),
    "execute": ("verdict",),
    "verify": ("verdict",),
}
"""By the stage that failed: the sections of which there is nothing to show."""
OBSTACLE = Obstacle(
    part="left finger", name="an observed obstacle", kind="seen", too_near_m=0.012, needed_m=0.002,
    touch_m=np.array([0.0, 0.04, 0.0]), base_from_tcp=np.diag([1.0, -1.0, -1.0, 1.0]), opening_m=0.05,
    points_m=np.array([[0.0, 0.04, 0.0], [0.01, 0.05, 0.02]], np.float32),
)  # fmt: skip
FIGURES = {"clouds", *(f"joints-{n}" for n in range(4)), *(f"hand-{n}" for n in range(3))}


def _page(record: Record, tmp_path: Path, failed: str | None = None) -> str:
    return write_report(read_cycle(record(failed)), tmp_path / "page.html").read_text()


def _section(page: str, name: str) -> str:
    return page[page.index(f'<section id="{name}">') :].partition("</section>")[0]


def _words(html: str) -> str:
    """The text of a part of a page, in one line."""
    return " ".join(unescape(re.sub(r"<[^>]*>", " ", html)).split())


def _retold(record: Record, tmp_path: Path, **changes: object) -> str:
    """The page of a cycle whose detections have these fields."""
    told = read_cycle(record())
    detect = told.stages["detect"]
    assert detect.result is not None
    result = detect.result.model_copy(update=changes)
    stages = {**told.stages, "detect": detect.model_copy(update={"result": result})}
    return write_report(replace(told, stages=stages), tmp_path / "page.html").read_text()


@pytest.mark.parametrize("failed", [None, *MISSING])
def test_a_section_is_there_when_there_is_something_in_it(record: Record, tmp_path: Path, failed: str | None) -> None:
    page = _page(record, tmp_path, failed)
    assert re.findall(r'<section id="(\w+)">', page) == [one for one in SECTIONS if one not in MISSING.get(failed, ())]
    assert ("FAILED NO_GRASP" in page) == (failed is not None)
    assert (f"{failed} failed." in page) == (failed is not None)


def test_a_failed_detection_carries_no_charts(record: Record, tmp_path: Path) -> None:
    page = _page(record, tmp_path, "detect")
    assert "data-figure" not in page and len(page) < 1e6


@pytest.mark.parametrize("failed", [None, "detect"])
def test_what_was_seen_is_shown_also_of_a_failed_detection(record: Record, tmp_path: Path, failed: str | None) -> None:
    seen = _words(_section(_page(record, tmp_path, failed), "seen"))
    assert "height over the station's table +3.0 mm at most ±15 mm" in seen
    assert "tilt 0.6° at most 5°" in seen
    assert "seen of the pick region 97% at least" in seen
    assert "1 80 x 30 x 50 mm 98%" in seen and "cut by the border" not in seen


def test_a_thing_that_was_half_seen_is_marked(record: Record, tmp_path: Path) -> None:
    told = read_cycle(record("detect"))
    assert told.scene is not None
    cut = told.scene.instances[0].model_copy(update={"number": 2, "in_view": False, "depth_share": 0.5})
    two = told.scene.model_copy(update={"instances": (*told.scene.instances, cut)})
    page = write_report(replace(told, scene=two), tmp_path / "page.html").read_text()
    assert "2 80 x 30 x 50 mm 50% cut by the border" in _words(_section(page, "seen"))


def test_every_try_is_shown_with_its_score_or_its_reason(record: Record, tmp_path: Path) -> None:
    second = Tried(instance=1, sample=1, code="MODEL_DRIFT", text="Another object.")
    seen = _words(_section(_retold(record, tmp_path, tried=(Tried(instance=1, sample=0, score=0.7), second)), "seen"))
    assert "thing proposal best grasp 1 1 0.70 1 2 MODEL_DRIFT Another object." in seen


def test_a_scene_that_only_the_reader_made_up_is_not_shown(record: Record, tmp_path: Path) -> None:
    told = read_cycle(record())
    assert told.scene is not None
    nothing = told.scene.instances[0].model_copy(update={"size_m": np.zeros(3)})
    made_up = told.scene.model_copy(update={"instances": (nothing,)})
    page = write_report(replace(told, scene=made_up), tmp_path / "page.html").read_text()
    assert "pick region" not in _section(page, "seen") and "<th>thing</th>" not in page


def test_a_painted_rod_is_told_without_an_alignment(record: Record, tmp_path: Path) -> None:
    detections = read_cycle(record()).stages["detect"].result
    assert isinstance(detections, Detections)
    found = detections.evidence
    alignment = found.alignment.model_copy(update={"method": "painted"})
    page = _retold(record, tmp_path, evidence=found.model_copy(update={"alignment": alignment}))
    assert "nothing had to be carried back" in _section(page, "aligned")
    assert "data-view" not in _section(page, "aligned") and "residual" not in _section(page, "aligned")
    assert "outline overlaps" not in _section(page, "imagined")


def test_a_failed_plan_shows_every_grasp_with_the_reason_of_its_rejection(record: Record, tmp_path: Path) -> None:
    grasps = _section(_page(record, tmp_path, "plan"), "grasps")
    assert "COLLISION at 0°: approach: left finger touches post" in grasps
    assert "<b>chosen</b>" not in grasps and "yellow" not in grasps


def _in_the_way(record: Record, tmp_path: Path, **changes: object) -> str:
    """The page of a failed plan whose rejection says what was in the way: beside the thing, from above."""
    return _rejected(record, tmp_path, obstacle=OBSTACLE.model_copy(update=changes))


def _rejected(record: Record, tmp_path: Path, **changes: object) -> str:
    """The page of a failed plan with a rejection of these fields."""
    told = read_cycle(record("plan"))
    failure = told.stages["plan"].failure
    assert failure is not None
    rejected = REJECTED[0].model_copy(update=changes)
    plan = told.stages["plan"].model_copy(update={"failure": failure.model_copy(update={"rejected": (rejected,)})})
    told = replace(told, stages={**told.stages, "plan": plan})
    return write_report(told, tmp_path / "page.html").read_text()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "the left finger would touch something that was seen, 40 mm beside the middle of the jaw: 12 mm too near"),
        ({"kind": "box", "name": "bin-left"}, "the left finger would touch the left wall of the bin, 40 mm beside"),
        ({"kind": "unseen"}, "the left finger would touch space that the camera did not see, 40 mm beside"),
        ({"kind": "robot", "part": "link 7", "name": "link 3"}, "the link 7 would touch the link 3: 12 mm too near"),
        ({"kind": "target", "part": "hand", "touch_m": np.zeros(3)}, "the hand would touch the object itself: 12 mm"),
        ({"too_near_m": None}, "more than 60 mm too near (2 mm must stay free)"),
    ],
)
def test_a_failed_plan_tells_and_draws_what_was_in_the_way(
    record: Record, tmp_path: Path, changes: dict[str, object], said: str
) -> None:
    page = _in_the_way(record, tmp_path, **changes)
    assert said in _words(page[page.index("<header") :].partition("</header>")[0])
    section = _section(page, "obstacles")
    assert 'alt="the obstacle and the hand"' in section and 'data-figure="obstacles"' in section
    assert "What was in the way" not in _page(record, tmp_path, "plan"), "an older recording does not say it"


def test_a_grasp_out_of_reach_is_told_with_its_distance_beside_the_arm_s(record: Record, tmp_path: Path) -> None:
    page = _rejected(record, tmp_path, code=Code.UNREACHABLE, reason="unreachable: no arm configuration reaches it")
    section = _words(_section(page, "obstacles"))
    assert "What was out of reach" in section and "data-figure" not in _section(page, "obstacles")
    assert "flange 0.23 m from the shoulder 0.86 m at most" in section


def test_a_recording_without_a_result_is_told_as_unfinished(record: Record, tmp_path: Path) -> None:
    torn = replace(read_cycle(record()), result=None, metadata={"cycle_id": "1"})
    page = write_report(torn, tmp_path / "page.html").read_text()
    assert "UNFINISHED" in page and "the cycle was not finished" in page


def test_a_fault_of_the_cell_is_named_as_the_cause_behind_a_stop(record: Record) -> None:
    fault = Event(code="ABORTING", severity="error", text="The node 'sim' hangs. Check its cable.", advice="")
    timeline = summarize(replace(read_cycle(record("detect")), events=(Timed(2, fault),)))
    assert timeline.why == "So it ended. The node 'sim' hangs. Check its cable."


def test_the_log_tells_the_faults_of_the_nodes_once(record: Record, tmp_path: Path) -> None:
    health = Health(name="sim", pid=1, uptime_s=1.0, answered=1, failed=1, last_fault=f"arm: {HOSTILE}")
    told = replace(read_cycle(record()), health=(Timed(1, health), Timed(2, health)))
    page = write_report(told, tmp_path / "page.html").read_text()
    assert _section(page, "log").count("arm: &lt;script&gt;") == 1 and HOSTILE not in page


def test_a_motion_without_a_result_is_shown_as_the_arm_told_it(record: Record, tmp_path: Path) -> None:
    still = ArmState(stamp_ns=1, mode=ArmMode.REFLEX, q_rad=np.zeros(7), dq_rad_s=np.zeros(7), tau_ext_nm=np.ones(7))
    said = Timed(1, JointStates.FromString(arm_state_to_wire(still)))
    broken = replace(read_cycle(record("execute")), arm=(said, said, Timed(1, JointStates())))
    section = _section(write_report(broken, tmp_path / "page.html").read_text(), "motion")
    assert "The motions have no result" in section and section.count("data-figure") == 3


def test_the_tries_of_one_pick_lead_to_each_other(record: Record, tmp_path: Path) -> None:
    second = read_cycle(record())
    assert second.result is not None
    result = second.result.model_copy(update={"retried_as": "third"})
    attempt = Attempt(cycle_id=second.cycle_id, number=1, retry_of="first", asked_by="http-page-<7>")
    page = write_report(replace(second, result=result, attempt=attempt), tmp_path / "page.html").read_text()
    assert 'href="first.html"' in page and 'href="third.html"' in page and "try 2" in page
    assert "asked for by http-page-&lt;7&gt;" in page


def test_only_what_was_configured_otherwise_is_a_change(record: Record) -> None:
    station = read_cycle(record()).station
    assert configuration_changes(station) == []
    changed = {**station, "sim": {**station["sim"], "friction": 0.0}, "old": {"setting": 1}}
    assert configuration_changes(changed) == [("sim.friction", "0.0", "0.8"), ("old.setting", "1", "-")]
    older = {name: table for name, table in station.items() if name != "http"}
    assert configuration_changes(older) == [], "a setting that did not exist then was not changed"


def test_nothing_is_loaded_from_elsewhere_and_nothing_recorded_runs(record: Record, tmp_path: Path) -> None:
    page = _page(record, tmp_path)
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", page)
    assert "<script>alert" not in page and "&lt;script&gt;alert" in page
    assert len(page) < 4e5


def test_the_drawing_library_lies_beside_the_pages_once_or_in_the_one_that_is_sent(
    record: Record, tmp_path: Path
) -> None:
    told = read_cycle(record())
    (tmp_path / "pages").mkdir()
    first, second = (write_report(told, tmp_path / "pages" / name) for name in ("first.html", "second.html"))
    (library,) = (tmp_path / "pages").glob("plotly-*.js")
    assert first.read_text().count(f'<script src="{library.name}"></script>') == 1
    sent = write_report(told, tmp_path / "sent.html", embed=True)
    assert library.read_text() in sent.read_text() and "<script src" not in sent.read_text()
    assert not list(tmp_path.glob("plotly-*.js")) and second.exists()


def test_a_page_that_cannot_be_written_says_so(record: Record, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="--output"):
        write_report(read_cycle(record()), tmp_path / "absent" / "page.html")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    program = find_chromium()
    if program is None:
        pytest.skip("neither chromium-headless-shell nor chromium is installed")
    with chromium(program, tmp_path_factory.mktemp("profile")) as page:
        yield page


_CURVES = """[...document.querySelectorAll("[data-figure] .scatterlayer")]
             .map((one) => one.querySelectorAll("path.js-line").length)"""
_SHOWN = "document.querySelector('[data-figure=clouds]').data.filter((one) => one.visible).map((one) => one.name)"
_WIDTH = "document.documentElement.scrollWidth"


def test_a_browser_draws_every_figure_and_complains_of_nothing(browser: Page, record: Record, tmp_path: Path) -> None:
    _page(record, tmp_path)
    browser.open(tmp_path / "page.html", 390)
    assert browser.value(_WIDTH) <= 390
    places = "[...document.querySelectorAll('[data-figure]')].map((one) => one.dataset.figure)"
    assert set(browser.value(places)) == FIGURES
    assert sorted(browser.value(_CURVES)) == [1, 7, 7, 7, 7, 7, 7]
    assert browser.value("document.querySelectorAll('[data-figure=clouds] canvas').length") > 0
    browser.value("document.querySelector('[data-view=before]').click()")
    assert browser.value(_SHOWN) == ["observed", "imagined, as lifted", "its rod"]
    assert browser.errors == []


def test_a_browser_draws_the_obstacle_and_the_hand_where_it_would_have_been(
    browser: Page, record: Record, tmp_path: Path
) -> None:
    _in_the_way(record, tmp_path)
    browser.open(tmp_path / "page.html", 390)
    assert browser.value(_WIDTH) <= 390
    names = "document.querySelector('[data-figure=obstacles]').data.map((one) => one.name)"
    drawn = ["seen of the things", "in the way", "hand", "left finger", "right finger", "touch"]
    assert browser.value(names) == drawn and browser.errors == []


def test_a_browser_shows_the_day_and_a_cycle_that_did_not_move(browser: Page, record: Record, tmp_path: Path) -> None:
    tries = (("20260101T080000000", None), ("20260101T090000000", "capture"), ("20260101T100000000", "detect"))
    for name, failed in tries:
        write_cycle(record(failed, name))
    (day,) = days(tmp_path)
    write_day(day)
    for page in ("20260101T090000000.html", "20260101T100000000.html", INDEX):
        browser.open(tmp_path / page, 390)
        assert browser.value(_WIDTH) <= 390
        assert browser.errors == []
    assert browser.value("document.querySelectorAll('svg circle').length") == 8
    assert browser.value("[...document.images].every((one) => one.naturalWidth > 0)")

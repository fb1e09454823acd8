"""The operator's page in a real browser: at a simulated cell, and at one that says what a test wants."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from bus.commands import CellState
from bus.errors import Refused
from cell import client
from cell.http.access import Access, HttpRole
from cell.http.page_files import FOLDER
from config.schema import Station
from logs.catalogue.labels import read_labels
from tests.cell.http_bench import FakeCell, Site, door_of, served, served_for_real
from tests.logs.browser import find_chromium

playwright = pytest.importorskip("playwright.sync_api", reason="the package playwright is not installed")
axe_playwright = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe-playwright-python")
expect = playwright.expect

HOSTILE = "<img src=x onerror=alert(1)><script>alert(2)</script>&lt;b&gt;"
FLAGS = ("--no-sandbox", "--use-angle=swiftshader")
SERIOUS = {"serious", "critical"}
TOKENS = {HttpRole.OPERATOR: "operator-token-0123", HttpRole.VIEWER: "viewer-token-456789"}
LONG_MS = 60_000
THOROUGH = pytest.mark.thorough


@pytest.fixture(scope="module")
def program() -> str:
    found = find_chromium()
    if found is None:
        pytest.skip("neither chromium-headless-shell nor chromium is installed")
    return found


@pytest.fixture(scope="module")
def tool() -> Iterator[Any]:
    expect.set_options(timeout=LONG_MS)
    with playwright.sync_playwright() as tool:
        yield tool


@pytest.fixture(scope="module")
def browser(program: str, tool: Any) -> Iterator[Any]:
    browser = tool.chromium.launch(executable_path=program, args=list(FLAGS))
    yield browser
    browser.close()


Open = Callable[..., Any]


def is_complaint(said: Any) -> bool:
    """Not that the cell refused something, or wants a token: the page says so itself."""
    return said.type in ("error", "warning") and not re.search(r"status of (401|409)", said.text)


@pytest.fixture
def open_page(browser: Any) -> Iterator[Open]:
    """Opens a page of its own profile; after the test, none of them may have complained."""
    contexts, complaints = [], []

    def open_page(url: str, **options: Any) -> Any:
        context = browser.new_context(viewport={"width": 1400, "height": 1000}, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda said: complaints.append(said.text) if is_complaint(said) else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("dialog", lambda dialog: complaints.append(f"a script ran: {dialog.message}"))
        page.goto(url)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert not complaints, complaints


def state(page: Any) -> Any:
    return page.locator("#state")


def serious_findings(page: Any) -> list[str]:
    found = axe_playwright.Axe().run(page).response["violations"]
    return [f"{one['id']}: {one['nodes'][0]['html'][:120]}" for one in found if one["impact"] in SERIOUS]


@contextmanager
def doomed_page(tool: Any, program: str, profile: Path, url: str) -> Iterator[tuple[Any, Callable[[], None]]]:
    """A page in a browser of its own processes, and what kills them."""
    process = subprocess.Popen(
        [program, "--headless", "--remote-debugging-port=0", f"--user-data-dir={profile}", *FLAGS, url],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )

    def kill() -> None:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)

    try:
        assert process.stderr is not None
        address = next(line.split()[-1] for line in process.stderr if "DevTools listening on" in line)
        yield tool.chromium.connect_over_cdp(address).contexts[0].pages[0], kill
    finally:
        kill()
        process.communicate()


# --- at a simulated cell ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pace() -> float:
    return 3.0


@pytest.fixture(scope="module")
def shared_options(tmp_path_factory: pytest.TempPathFactory, new_endpoint: Callable[[], str]) -> list[str]:
    settings = (
        f"bus.endpoint={new_endpoint()}",
        f"recording.folder={tmp_path_factory.mktemp('page') / 'recordings'}",
        "verify.hold_s=0.5",
        "sim.clutter=3",
    )
    return [word for setting in settings for word in ("--set", setting)]


@pytest.fixture(scope="module")
def url(_shared_here: Station) -> Iterator[str]:
    """Where the shared cell is served."""
    with served_for_real(_shared_here) as address:
        yield address


def working(page: Any, stage: str = "grasps") -> None:
    expect(state(page)).to_have_text(f"Execute: {stage}")


def test_a_person_starts_chooses_an_object_pauses_and_stops(shared_cell: Station, url: str, open_page: Open) -> None:
    page = open_page(url)
    expect(state(page)).to_have_text("Stopped")
    expect(page.locator("#why-start")).to_have_text("Reset first.")
    assert page.locator("#start").get_attribute("title") == "Reset first."
    page.click("#reset")
    expect(state(page)).to_have_text("Idle")
    page.click("#start")
    working(page)
    page.click("#hold")
    expect(state(page)).to_have_text("Held")
    expect(page.locator("#overlay .line.grasp").first).to_be_attached()
    page.click("#unhold")
    expect(state(page)).to_have_text("Complete")
    expect(page.locator("#pick-list li[data-cycle] .tag").first).to_contain_text("picked")
    expect(page.locator("[data-figure=picks] dd")).to_have_text("1")
    left = page.locator("#overlay text.number").nth(1).bounding_box()
    page.mouse.click(left["x"] + left["width"] / 2, left["y"] + left["height"] / 2)
    expect(page.locator("#what")).to_have_text("The object at the cross")
    assert not serious_findings(page)
    page.click("#pick")
    expect(state(page)).to_have_text(re.compile("Execute"))
    page.keyboard.press("Escape")
    expect(state(page)).to_have_text("Stopped")
    expect(page.locator("#reason")).to_have_text("by this page")
    with client.connect(shared_cell) as cell:
        cell.command("abort")
        expect(state(page)).to_have_text("Aborted")
        page.click("#clear")
        expect(state(page)).to_have_text("Stopped")


def test_a_killed_browser_leaves_the_cell_held_and_another_page_says_why(
    shared_cell: Station, url: str, open_page: Open, program: str, tool: Any, tmp_path: Path
) -> None:
    page = open_page(url)
    with doomed_page(tool, program, tmp_path, url) as (doomed, kill):
        doomed.click("#reset")
        expect(state(doomed)).to_have_text("Idle")
        doomed.click("#start")
        working(page)
        kill()
        expect(state(page)).to_have_text("Held")
        expect(page.locator("#reason")).to_contain_text(re.compile("The lease of 'http-page-.*' was lost"))
    page.click("#unhold")
    working(page)
    page.reload()  # as when the page is closed: it attends the motion no more
    expect(state(page)).to_have_text("Held")
    page.click("#stop")
    expect(state(page)).to_have_text("Stopped")


@pytest.mark.thorough
def test_who_runs_the_cell_is_named_and_taking_over_asks_first(shared_cell: Station, url: str, open_page: Open) -> None:
    first, second = open_page(url), open_page(url)
    first.click("#reset")
    expect(state(second)).to_have_text("Idle")
    first.click("#start")
    working(second)
    second.fill("#words", "the largest")
    second.keyboard.press("Enter")
    second.click("#pick")
    expect(second.locator("#asking")).to_contain_text(re.compile("The cell moves for 'http-page-.*'"))
    second.get_by_role("button", name="Stop it, and take over").click()
    expect(state(first)).to_have_text("Stopping")
    expect(state(second)).to_have_text("Idle")
    second.click("#stop")
    expect(state(second)).to_have_text("Stopped")


# --- at a cell that says what a test wants ----------------------------------------------------------------------------


def saying(now: str, *available: str, reason: str = "", **more: Any) -> FakeCell:
    said = {"state": now, "stage": "", "cycle_id": "", "since_ns": 1, "available": available, "reason": reason}
    return FakeCell(now=CellState.model_validate(said | more))


@contextmanager
def site_of(cell: FakeCell, folder: Path, tokens: dict[HttpRole, str] | None = None) -> Iterator[tuple[Site, str]]:
    with served(door_of(cell, folder, Access(tokens or {})), cell) as site:
        yield site, f"http://127.0.0.1:{site.port}/"


ENTRY = {
    "cycle_id": "20261129T101500000", "result": "FAILED", "code": "GRASP_MISSED", "reason": HOSTILE, "object": HOSTILE,
    "wall_s": 3.0, "number": 0, "retry_of": "", "retried_as": "", "file": "/recordings/x.mcap", "report": "",
    "labels": [{"cycle_id": "c", "at_ns": 1, "who": HOSTILE, "label": "bad", "note": HOSTILE}],
}  # fmt: skip


def test_names_and_replies_with_tags_stay_text(open_page: Open, tmp_path: Path) -> None:
    cell = saying("Held", "stop", "unhold", reason=HOSTILE, job_id=HOSTILE, queue=(HOSTILE,))
    with site_of(cell, tmp_path) as (site, url):
        page = open_page("about:blank")
        about = {"cell_id": HOSTILE, "is_simulated": True, "places": [{"name": HOSTILE, "capacity": 0}],
                 "role": "operator", "now_ns": 1}  # fmt: skip
        page.route("**/api/cell", lambda route: route.fulfill(json=about))
        page.route("**/api/thumbnails/*", lambda route: route.fulfill(path=FOLDER / "no-picture.svg"))
        page.route("**/api/cycles*", lambda route: route.fulfill(json=[ENTRY]))
        page.goto(url)
        expect(page.locator("#reason")).to_have_text(HOSTILE)
        expect(page.locator("#pick-list")).to_contain_text(HOSTILE)
        expect(page.locator("#facts")).to_contain_text(HOSTILE)
        event = {"code": HOSTILE, "severity": "error", "text": f"{HOSTILE}!", "advice": HOSTILE}
        site.door.hub.tell("event", json.dumps(event))
        expect(page.locator("#message")).to_contain_text(HOSTILE)
        assert page.locator("img[src=x]").count() == 0 and page.locator("body script").count() == 0
        assert not serious_findings(page)


def test_a_viewer_enters_a_token_and_may_look_and_stop_only(open_page: Open, tmp_path: Path) -> None:
    cell = saying("Execute", "stop", "abort", "hold", "suspend")
    with site_of(cell, tmp_path, TOKENS) as (_, url):
        page = open_page("about:blank")
        page.goto(url)
        page.fill("#token", TOKENS[HttpRole.VIEWER])
        page.keyboard.press("Enter")
        expect(state(page)).to_have_text("Execute")
        for name in ("start", "hold", "abort", "reset"):
            expect(page.locator(f"#{name}")).to_have_attribute("aria-disabled", "true")
        expect(page.locator("#why-hold")).to_have_text("Only an operator may.")
        expect(page.locator("#facts")).to_contain_text("viewer")
        with page.expect_response("**/api/commands/stop"):
            page.click("#stop")
        assert [verb for verb, _ in cell.sent] == ["stop"]


def test_who_holds_the_lease_is_named_and_taking_over_asks_first(open_page: Open, tmp_path: Path) -> None:
    cell = saying("Idle", "start", "pick", "stop", "abort")
    with site_of(cell, tmp_path) as (_, url):
        page = open_page(url)
        expect(state(page)).to_have_text("Idle")
        cell.refusal = Refused("The cell moves for 'line-3', which holds the lease.", "Wait.", code="LEASE_HELD")
        page.click("#start")
        expect(page.locator("#asking")).to_contain_text("The cell moves for 'line-3'")
        page.get_by_role("button", name="Leave it").click()
        assert [verb for verb, _ in cell.sent] == ["start"]


def test_a_verdict_is_appended_with_who_said_it(open_page: Open, tmp_path: Path) -> None:
    day = tmp_path / "2026-11-29"
    day.mkdir()
    (day / f"{ENTRY['cycle_id']}.mcap").touch()
    with site_of(saying("Idle", "start", "pick", "stop", "abort"), tmp_path) as (_, url):
        page = open_page("about:blank")
        page.route("**/api/thumbnails/*", lambda route: route.fulfill(path=FOLDER / "no-picture.svg"))
        page.route("**/api/cycles*", lambda route: route.fulfill(json=[{**ENTRY, "labels": []}]))
        page.goto(url)
        page.get_by_role("button", name="Bad: 20261129T101500000").click()
        page.fill("#who", "anna")
        page.fill("#note", "it slipped")
        page.get_by_role("button", name="Save").click()
        expect(page.locator("#message")).to_have_text("Kept.")
        with page.expect_response("**/api/labels/*"):  # the name is known now
            page.get_by_role("button", name="Good: 20261129T101500000").click()
        said = [(one.who, one.label, one.note) for one in read_labels(tmp_path)]
        assert said == [("anna", "bad", "it slipped"), ("anna", "good", "")]


def test_the_arm_is_moved_by_hand_only_while_a_button_is_held(open_page: Open, tmp_path: Path) -> None:
    cell = saying("Stopped", "jog", "jog_home", "hand_open", "hand_close", "stop", "mode", mode="Manual")
    with site_of(cell, tmp_path) as (_, url):
        page = open_page(url)
        expect(page.locator("#why-reset")).to_contain_text("back to picking")
        up = page.get_by_role("button", name="up", exact=True)
        up.hover()
        with page.expect_response("**/api/commands/jog"):
            page.mouse.down()
        with page.expect_response("**/api/commands/jog"):
            pass  # it is sent again
        page.mouse.up()
        page.get_by_role("button", name="Open the hand").click()
        with page.expect_response("**/api/commands/stop"):
            page.keyboard.press("Escape")
        verbs = [verb for verb, _ in cell.sent]
        assert verbs[:2] == ["jog", "jog"] and verbs[-1] == "stop"  # nothing moves after it was let go
        assert (cell.sent[0][1].axis, cell.sent[0][1].direction) == ("z", 1)


def test_a_person_is_asked_before_it_moves_and_answers_what_they_saw(open_page: Open, tmp_path: Path) -> None:
    cell = saying("Execute", "stop", "abort", "hold", "approve", "next_grasp", "reject", stage="approve")
    with site_of(cell, tmp_path) as (_, url):
        page = open_page("about:blank")
        proposal = {"proposal_id": "c1-0", "object": HOSTILE, "motion_s": 5.7, "until_ns": 0}
        page.route("**/api/proposal", lambda route: route.fulfill(json=proposal))
        page.route("**/api/plan", lambda route: route.fulfill(status=409, json={"reason": "Nothing was planned."}))
        page.goto(url)
        expect(page.locator("#approve")).to_contain_text(HOSTILE)
        expect(state(page)).to_have_text("Execute: asks before it moves")
        page.fill("#answer-reason", "it would slip")
        for verb in ("next_grasp", "approve"):
            with page.expect_response(f"**/api/commands/{verb}"):
                page.click(f"#answer-{verb}")
        said = [(verb, request.proposal, request.reason) for verb, request in cell.sent]
        assert said == [("next_grasp", "c1-0", "it would slip"), ("approve", "c1-0", "")]
        assert not serious_findings(page)


@pytest.mark.parametrize(
    ("width", "height"),
    [(390, 844), pytest.param(820, 1180, marks=THOROUGH), pytest.param(1400, 1000, marks=THOROUGH)],
)
def test_the_page_fits_every_screen_light_and_dark(open_page: Open, tmp_path: Path, width: int, height: int) -> None:
    with site_of(saying("Aborted", "clear", reason="NODE_LOST: the node 'sim' is gone."), tmp_path) as (_, url):
        page = open_page(url)
        page.set_viewport_size({"width": width, "height": height})
        expect(state(page)).to_have_text("Aborted")
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            assert not serious_findings(page)
        stop = page.locator("#stop").bounding_box()
        assert stop["height"] >= 80 and stop["y"] + stop["height"] <= height
        assert float(state(page).evaluate("one => parseFloat(getComputedStyle(one).fontSize)")) >= 32


def test_a_page_is_small_and_reads_without_a_network_of_others() -> None:
    files = list(FOLDER.iterdir())
    assert sum(file.stat().st_size for file in files) < 300_000
    for file in files:
        text = file.read_text().replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in text and "https://" not in text
        assert "innerHTML" not in text

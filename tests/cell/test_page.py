"""The operator's page in a real browser: at a simulated cell, and at one that says what a test wants."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bus import topics
from bus.codec import encode
from bus.commands import CellHealth, CellState, DoorHealth, Event
from bus.errors import Refused
from bus.messages import LivePicture
from bus.sample import Sample
from bus.topics import encoding_of
from cell.http.access import Access, HttpRole
from cell.http.page_files import FOLDER
from config.http import HttpSettings
from config.schema import Station
from docs.browser import FLAGS, find_chromium, launch_chromium
from logs.catalogue.figures import DEFINITIONS, Counts
from logs.catalogue.labels import read_labels
from tests.cell.http_bench import RESULT, FakeCell, Site, door_of, served, served_for_real

playwright = pytest.importorskip("playwright.sync_api", reason="the package playwright is not installed")
axe_playwright = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe-playwright-python")
expect = playwright.expect

HOSTILE = "<img src=x onerror=alert(1)><script>alert(2)</script>&lt;b&gt;"
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
def browser(program: str, tool: Any) -> Iterator[Any]:  # skipped without the program
    browser = launch_chromium(tool)
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def complaints() -> list[str]:
    """The complaints of the console and the scripts of all pages."""
    return []


@pytest.fixture(autouse=True)
def nothing_complains(complaints: list[str]) -> Iterator[None]:
    complaints.clear()
    yield
    assert not complaints, complaints


def is_complaint(said: Any) -> bool:
    """Not that the cell refused something, or wants a token: the page says so itself."""
    return said.type in ("error", "warning") and not re.search(r"status of (401|404|409)", said.text)


Open = Callable[[str], Any]


@pytest.fixture(scope="module")
def open_page(browser: Any, complaints: list[str]) -> Open:
    """Opens a page of its own profile."""

    def open_page(url: str) -> Any:
        page = browser.new_context(viewport={"width": 1400, "height": 1000}).new_page()
        page.on("console", lambda said: complaints.append(said.text) if is_complaint(said) else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("dialog", lambda dialog: complaints.append(f"a script ran: {dialog.message}"))
        page.goto(url)
        return page

    return open_page


def state(page: Any) -> Any:
    return page.locator("#state")


def until(page: Any, text: str) -> None:
    """Until the page shows a state; looked for with every frame, where `expect` looks once a second."""
    page.wait_for_function("text => document.querySelector('#state')?.textContent === text", arg=text, timeout=LONG_MS)


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
    return 6.0


@pytest.fixture(scope="module")
def shared_options(tmp_path_factory: pytest.TempPathFactory, new_endpoint: Callable[[], str]) -> list[str]:
    settings = (
        f"bus.endpoint={new_endpoint()}",
        f"recording.folder={tmp_path_factory.mktemp('page') / 'recordings'}",
        "execute.approve=client",
        "capture.views=1",  # so that what was found can be drawn into a picture of now
        "verify.hold_s=0.2",
        "verify.look=auto",
        "sim.clutter=2",
    )
    return [word for setting in settings for word in ("--set", setting)]


@pytest.fixture(scope="module")
def url(_shared_here: Station) -> Iterator[str]:
    """Where the shared cell is served."""
    with served_for_real(_shared_here) as address:
        yield address


ASKS = "Execute: asks before it moves"
OUTDATED = {"stamp": "1", "outlines": [], "numbers": []}
"""What was found in another picture: answers overtake each other on a busy machine."""


def click_middle(page: Any, locator: Any) -> None:
    """As a person clicks: at that place of the page, whatever lies over it."""
    box = locator.bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


def test_a_day_at_the_cell(
    shared_cell: Station, url: str, open_page: Open, program: str, tool: Any, tmp_path: Path
) -> None:
    page = open_page(url)
    until(page, "Stopped")
    expect(page.locator("#why-start")).to_have_text("Reset first.")
    page.click("#reset")
    until(page, "Idle")
    expect(page.locator(".live")).to_be_visible()  # a picture of now, before the first pick

    page.route("**/api/scene", lambda route: route.fulfill(json=OUTDATED), times=1)  # then it is asked for again
    page.click("#start")
    until(page, ASKS)
    page.click("#answer-reject")
    until(page, "Complete")
    last = page.locator("#pick-list li[data-cycle]").first
    expect(last.locator(".tag")).to_contain_text("failed REJECTED")
    expect(page.locator("#reason")).to_contain_text("Done: the last pick FAILED - ")
    expect(page.locator("#banner")).to_have_class("tone-held")

    expect(page.locator("#overlay.earlier text.number")).to_have_count(2)  # in a picture of now, where they were
    click_middle(page, page.locator("#overlay text.number").nth(1))
    expect(page.locator("#what")).to_contain_text("The object at the cross")
    page.click("#pick")
    expect(page.locator("#jobs")).to_contain_text("Picks what you pointed at")
    until(page, ASKS)
    expect(page.locator("#approve")).to_contain_text(re.compile(r"It would take Thing \d"))
    expect(page.locator("#jobs")).not_to_contain_text("(Thing")  # it has looked again, and numbered things anew
    page.click("#answer-approve")
    until(page, "Execute: grasps")
    page.click("#hold")
    until(page, "Held")
    expect(page.locator(".live")).to_be_visible()  # now one must look at the arm
    page.click("#unhold")
    until(page, "Complete")
    expect(page.locator("#reason")).to_have_text("Done.")
    expect(last.locator(".tag")).to_contain_text("picked")
    expect(page.locator("[data-figure=picks] dd")).to_have_text("2")
    expect(page.locator("[data-figure=interventions]")).to_have_text("interventions1")  # too few for a rate
    expect(page.locator("[data-figure=success]")).to_have_text("picked1 of 2")
    last.get_by_role("button", name=re.compile("^Good: ")).click()
    page.fill("#who", "anna")
    page.get_by_role("button", name="Save").click()
    expect(last.locator(".said")).to_contain_text("Good by anna")

    with doomed_page(tool, program, tmp_path, url) as (doomed, kill):
        doomed.click("#reset")
        until(doomed, "Idle")
        doomed.click("#start")
        until(page, ASKS)
        kill()
        until(page, "Held")
        expect(page.locator("#reason")).to_contain_text("The page that started this pick was closed or reloaded")
    page.click("#unhold")
    until(page, ASKS)
    page.reload()  # as when the page is closed: it attends the motion no more
    until(page, "Held")
    page.keyboard.press("Escape")
    until(page, "Stopped")
    expect(page.locator("#reason")).to_have_text("by this page")
    page.click("#abort")
    until(page, "Aborted")
    page.click("#clear")
    until(page, "Stopped")


@pytest.mark.thorough
def test_a_browser_killed_in_the_motion_leaves_the_arm_held(
    shared_cell: Station, url: str, open_page: Open, program: str, tool: Any, tmp_path: Path
) -> None:
    page = open_page(url)
    with doomed_page(tool, program, tmp_path, url) as (doomed, kill):
        doomed.click("#reset")
        until(doomed, "Idle")
        doomed.click("#start")
        until(doomed, ASKS)
        assert not serious_findings(doomed)
        doomed.click("#answer-approve")
        until(page, "Execute: grasps")
        kill()
        until(page, "Held")


@pytest.mark.thorough
def test_who_runs_the_cell_is_named_and_taking_over_asks_first(shared_cell: Station, url: str, open_page: Open) -> None:
    first, second = open_page(url), open_page(url)
    first.click("#reset")
    until(second, "Idle")
    first.click("#start")
    until(second, ASKS)
    second.fill("#words", "the largest")
    second.keyboard.press("Enter")
    second.click("#pick")
    expect(second.locator("#asking")).to_contain_text("The cell is moved by another page.")
    second.get_by_role("button", name="Stop it, and take over").click()
    until(second, "Idle")
    second.click("#stop")
    until(second, "Stopped")


# --- at a cell that says what a test wants ----------------------------------------------------------------------------

CYCLE = "20261129T101500000"
ENTRY = {
    "cycle_id": CYCLE, "result": "FAILED", "code": "GRASP_MISSED", "reason": HOSTILE, "object": HOSTILE,
    "wall_s": 3.0, "number": 0, "retry_of": "", "retried_as": "", "file": "/recordings/x.mcap",
    "report": "/reports/x.html",
    "labels": [{"cycle_id": "c", "at_ns": 1, "who": HOSTILE, "label": "bad", "note": HOSTILE}],
}  # fmt: skip
ABOUT = {"cell_id": HOSTILE, "is_simulated": True, "is_never_empty": True,
         "places": [{"name": HOSTILE, "capacity": 0}], "role": "operator", "now_ns": 1}  # fmt: skip
NOT_THERE = "There is no object within 40 px of (648, 275); the nearest is 57 px away."
PICTURE_NS = 1_796_000_000_123_456_789


@dataclass
class Desk:
    """A page at a cell that says what a test wants; everything of others has tags in it."""

    cell: FakeCell
    site: Site
    page: Any
    recordings: Path

    def say(self, now: str, *available: str, **more: Any) -> None:
        """The cell is in this state, and the page shows it."""
        shown = more.pop("shown", now)
        self.cell.now = state_of(now, *available, **more)
        self.cell.said.put(Sample(topics.STATE.key, encoding_of(CellState), encode(self.cell.now)))
        until(self.page, shown)


def state_of(now: str, *available: str, **more: Any) -> CellState:
    said = {"state": now, "stage": "", "cycle_id": "", "since_ns": 1, "available": available, "reason": ""}
    return CellState.model_validate(said | more)


@contextmanager
def site_of(cell: FakeCell, folder: Path, tokens: dict[HttpRole, str] | None = None) -> Iterator[tuple[Site, str]]:
    settings = HttpSettings(picture_s=0.1)
    with served(door_of(cell, folder, Access(tokens or {}), settings), cell) as site:
        yield site, f"http://127.0.0.1:{site.port}/"


@pytest.fixture(scope="module")
def module_desk(open_page: Open, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Desk]:
    folder = tmp_path_factory.mktemp("desk")
    (folder / "2026-11-29").mkdir()
    (folder / "2026-11-29" / f"{CYCLE}.mcap").touch()
    jpeg = cv2.imencode(".jpg", np.zeros((90, 160, 3), np.uint8))[1].tobytes()
    live = LivePicture(stamp_ns=PICTURE_NS, data=jpeg, media_type="image/jpeg", from_capture_pose=True)
    cell = FakeCell(now=state_of("Idle"), live=live)
    with site_of(cell, folder) as (site, url):
        page = open_page("about:blank")
        page.route("**/api/cell", lambda route: route.fulfill(json=ABOUT))
        page.route("**/api/thumbnails/*", lambda route: route.fulfill(path=FOLDER / "no-picture.svg"))
        page.route("**/api/cycles*", lambda route: route.fulfill(json=[ENTRY]))
        page.goto(url)
        yield Desk(cell, site, page, folder)


@pytest.fixture
def desk(module_desk: Desk) -> Desk:
    module_desk.cell.refusal = None
    module_desk.say("Idle", "start", "pick", "stop", "abort")
    module_desk.cell.sent.clear()
    return module_desk


def test_names_and_replies_with_tags_stay_text(desk: Desk) -> None:
    page = desk.page
    desk.say("Held", "stop", "unhold", reason=HOSTILE, job_id=HOSTILE, queue=(f"{HOSTILE}2",))
    expect(page.locator("#reason")).to_have_text(HOSTILE)
    for part in ("#pick-list", "#facts", "#jobs", "#place"):
        expect(page.locator(part)).to_contain_text(HOSTILE)
    event = {"code": HOSTILE, "severity": "error", "text": f"{HOSTILE}!", "advice": HOSTILE}
    desk.site.door.hub.tell("event", json.dumps(event))
    expect(page.locator("#message")).to_contain_text(HOSTILE)
    assert page.locator("img[src=x]").count() == 0 and page.locator("body script").count() == 0
    assert not serious_findings(page)


def test_a_cell_at_rest_says_that_something_may_be_in_the_hand(desk: Desk) -> None:
    reason, todo = desk.page.locator("#reason"), desk.page.locator("#todo")
    hand = (
        "Something may be in the hand: its fingers are 66 mm apart. A reset opens the hand there and then, before the"
        " arm moves. To take it out first: mode Manual, and open the hand over a place, or while you hold the thing."
    )
    desk.say("Stopped", "reset", "abort", reason=hand)
    expect(reason).to_have_text("Something may be in the hand.")
    expect(todo).to_contain_text("Reset lets fall what is in the hand.")
    expect(desk.page.locator("#why-reset")).to_have_text("Lets fall what is in the hand; then the arm moves.")
    desk.say("Aborted", "clear", reason=f"ARM_REFLEX: The arm stopped itself. {hand}")
    expect(reason).to_have_text("ARM_REFLEX: The arm stopped itself.")
    expect(todo).to_contain_text("Reset lets fall what is in the hand.")
    expect(todo).not_to_contain_text("mode Manual")


def test_a_hand_that_was_emptied_by_hand_is_said_to_hold_nothing_more(desk: Desk) -> None:
    reason, hand = desk.page.locator("#reason"), "Something may be in the hand: its fingers are 66 mm apart."
    desk.say("Stopping", "abort", reason="command 'stop' from line-3")
    desk.say("Stopped", "mode", reason=hand)
    expect(reason).to_have_text("Something may be in the hand: its fingers are 66 mm apart.")
    desk.say("Stopped", "hand_open", "mode", mode="Manual", shown="Stopped: moved by hand")
    expect(reason).to_have_text("by line-3")


def test_a_cell_that_was_started_again_with_other_places_is_asked_for_them(desk: Desk) -> None:
    other = ABOUT | {"places": [{"name": "the new shelf", "capacity": 0}]}
    page, cells = desk.page, iter((ABOUT, ABOUT, other))  # a page asks twice as it begins
    ends = 'retry: 300\nevent: session\ndata: {"session": "s", "client_id": "c"}\n\n'
    page.route("**/api/cell", lambda route: route.fulfill(json=next(cells)), times=3)
    page.route("**/api/events*", lambda route: route.fulfill(body=ends, content_type="text/event-stream"), times=1)
    page.reload()
    expect(page.locator("#place")).to_contain_text("at the new shelf")
    page.reload()  # for the tests that follow


def test_the_last_pick_is_the_one_that_ended_last_whatever_the_list_says(desk: Desk) -> None:
    page = desk.page
    waited = RESULT.model_copy(update={"cycle_id": "20260101T000000000", "result": "FAILED", "reason": "It slipped."})
    page.route("**/api/cycles*", lambda route: route.fulfill(json=[ENTRY | {"result": "SUCCESS"}]), times=1)
    with page.expect_response("**/api/cycles*"):
        desk.site.door.hub.tell("result", waited.model_dump_json())
    desk.say("Complete", "reset", "pick")
    expect(page.locator("#reason")).to_have_text("Done: the last pick FAILED - It slipped.")


def test_the_card_of_a_pick_that_waited_has_the_time_at_which_it_began(desk: Desk) -> None:
    page = desk.page
    page.route("**/api/cycles*", lambda route: route.fulfill(json=[ENTRY | {"began": "20261129T113000000"}]), times=1)
    desk.site.door.hub.tell("result", RESULT.model_copy(update={"cycle_id": CYCLE}).model_dump_json())
    expect(page.locator("#pick-list")).to_contain_text(f"11:30 UTC · {CYCLE}")


def test_a_pick_that_found_the_bin_empty_says_so_and_what_to_do(desk: Desk) -> None:
    desk.site.door.hub.tell("result", RESULT.model_copy(update={"result": "EMPTY"}).model_dump_json())
    desk.say("Complete", "reset", "pick")
    expect(desk.page.locator("#reason")).to_have_text("Done: nothing is left.")
    expect(desk.page.locator("#todo")).to_contain_text("Put in what it shall pick next.")


def test_five_tasks_take_three_clicks_at_most(desk: Desk) -> None:
    page, cell = desk.page, desk.cell
    page.evaluate("() => { window.clicks = 0; document.addEventListener('click', () => window.clicks++, true); }")

    def clicks() -> int:
        return int(page.evaluate("() => { const made = window.clicks; window.clicks = 0; return made; }"))

    desk.say("Stopped", "reset", "abort")
    page.click("#reset")
    desk.say("Idle", "start", "pick", "stop", "abort")
    with page.expect_response("**/api/commands/start"):
        page.click("#start")
    assert (clicks(), [verb for verb, _ in cell.sent]) == (2, ["reset", "start"]), "start picking"

    desk.say("Execute", "stop", "abort", "hold")
    with page.expect_response("**/api/commands/stop"):
        page.click("#stop")
    assert (clicks(), cell.sent[-1][0]) == (1, "stop"), "stop it"

    failed = page.locator("#pick-list li").first
    expect(failed).to_contain_text("failed GRASP_MISSED")
    expect(failed).to_contain_text(f"10:15 UTC · {CYCLE}")
    expect(failed.get_by_text("Report", exact=True)).to_have_attribute("href", "/reports/x.html")
    assert clicks() == 0, "why did the last one fail"

    desk.say("Idle", "start", "pick", "stop", "abort")
    click_middle(page, page.locator("#overlay"))
    with page.expect_response("**/api/commands/pick"):
        page.click("#pick")
    target = cell.sent[-1][1].job.target
    assert target is not None and target.picture_ns == PICTURE_NS, "to the last digit"
    assert target.pixel is not None and abs(target.pixel[0] - 80) < 2 and abs(target.pixel[1] - 45) < 2
    assert clicks() == 2, "pick that cup"

    expect(page.locator("#today")).to_contain_text("No pick was made today.")
    assert clicks() == 0, "how was today"


def test_a_click_that_the_cell_refuses_says_why_and_stays_chosen(desk: Desk) -> None:
    desk.cell.refusal = Refused("The cell has looked again since that picture.", "Look.", code="PICTURE_OUTDATED")
    click_middle(desk.page, desk.page.locator("#overlay"))
    desk.page.click("#pick")
    expect(desk.page.locator("#message")).to_contain_text("has looked again since that picture. Look.")
    expect(desk.page.locator("#asked")).to_be_visible()


def test_a_failed_pick_is_no_success_and_says_why_in_plain_words(desk: Desk) -> None:
    page = desk.page
    click_middle(page, page.locator("#overlay"))
    page.click("#pick")
    desk.say("Execute", "stop", job_id="c1")
    expect(page.locator("#jobs")).to_contain_text("Picks what you pointed at, lays it into the tray")
    failed = RESULT.model_copy(update={"result": "FAILED", "reason": NOT_THERE})
    desk.site.door.hub.tell("result", failed.model_dump_json())
    desk.say("Complete", "reset", "pick")
    expect(page.locator("#reason")).to_have_text("Done: the last pick FAILED - Nothing lies where you clicked.")
    expect(page.locator("#banner")).to_have_class("tone-held")


def test_what_the_cell_says_in_its_own_terms_is_said_to_a_person_in_theirs(desk: Desk) -> None:
    page, reason = desk.page, desk.page.locator("#reason")
    desk.say("Resetting", "stop", reason="command 'reset' from http-page-root-vm-12800-2.1")
    expect(reason).to_have_text("The arm goes to its looking place (asked for by another page).")
    gone = (
        "' was lost (silent for 0.5 s): nobody attends the motion. It was to pick more: start it again after this pick."
    )
    desk.say("Held", "stop", "unhold", reason=f"The lease of 'http-page-root-vm-1-2.2{gone}")
    expect(reason).to_have_text(
        "The page that started this pick was closed or reloaded, or lost its link. It was to pick more: start it again"
        " after this pick."
    )
    desk.say("Held", "stop", "unhold", reason=f"The lease of 'line-3{gone}")
    expect(reason).to_contain_text("The program that started this pick (line-3) was ended, or lost its link. It was")
    lost = "The node 'sim' is gone. See where `cell start` runs, then `cell clear` and `cell reset`."
    desk.say("Aborted", "clear", reason=lost)
    expect(reason).to_have_text("The node 'sim' is gone.")
    advice = "See where `cell start` runs, then Clear and Reset. Look at the cell. Then Clear, then Reset."
    expect(desk.page.locator("#todo")).to_have_text(advice)
    stopped = RESULT.model_copy(update={"result": "FAILED", "reason": "Stopped during 'hold'."})
    desk.site.door.hub.tell("result", stopped.model_dump_json())
    desk.say("Complete", "reset", "pick")
    expect(reason).to_contain_text("It was stopped while it checked what it held.")
    early = stopped.model_copy(update={"reason": "Stopped before 'detect'."})
    desk.site.door.hub.tell("result", early.model_dump_json())
    expect(reason).to_contain_text("It was stopped before it grasped.")
    rejected = stopped.model_copy(update={"reason": "http-page-root-vm-1-3.1 rejected it: too near."})
    desk.site.door.hub.tell("result", rejected.model_dump_json())
    expect(reason).to_contain_text("Somebody at a page rejected it: too near.")
    words = "target.text: of 'the dog' this cell does not understand: 'dog'."
    desk.cell.refusal = Refused(words, "Correct that field and send it again: docs/use.md.", code="BAD_JOB")
    desk.say("Idle", "start", "pick")
    page.fill("#words", "the dog")
    page.keyboard.press("Enter")
    page.click("#pick")
    message = page.locator("#message")
    expect(message).to_contain_text(
        "Of 'the dog' this cell does not understand: 'dog'. Say it in other words, or click"
    )
    assert not re.search(r"target\.|docs/", message.inner_text())
    desk.cell.refusal = Refused("'left' is full.", "Empty it, then `cell stop` and `cell reset`.", code="PLACE_FULL")
    page.click("#pick")
    expect(message).to_have_text("'left' is full. Empty it, then Stop and Reset.")
    page.fill("#words", "")


def test_a_pick_that_found_nothing_says_what_was_asked_for(desk: Desk) -> None:
    page = desk.page
    entry = ENTRY | {"code": "TARGET_NOT_FOUND", "reason": "Nothing here is 'purple'.", "object": "bottle"}
    page.route("**/api/cycles*", lambda route: route.fulfill(json=[entry]), times=1)
    desk.site.door.hub.tell("result", RESULT.model_copy(update={"cycle_id": CYCLE}).model_dump_json())
    expect(page.locator("#pick-list .tag")).to_have_text("failed TARGET_NOT_FOUND · “purple”")
    expect(page.locator("#pick-list")).not_to_contain_text("bottle")


def test_cancel_is_off_once_the_only_grasp_of_a_job_has_begun(desk: Desk) -> None:
    cancel = desk.page.get_by_role("button", name="Cancel the job j1")
    for stage, said, is_off in (("plan", "plans", "false"), ("execute", "grasps", "true")):
        desk.say("Execute", "stop", stage=stage, job_id="j1", shown=f"Execute: {said}")
        expect(cancel).to_have_attribute("aria-disabled", is_off)


def test_a_picture_is_called_live_only_while_it_is_of_now(desk: Desk) -> None:
    live = desk.page.locator(".live")
    for now, since_ns, is_live in (("Held", 1, True), ("Idle", PICTURE_NS + 1000, False), ("Resetting", 1, False)):
        desk.say(now, "stop", since_ns=since_ns)
        expect(live).to_be_visible(visible=is_live)


def warn(desk: Desk, text: str) -> None:
    """The cell says something that stays on the page until it is dismissed, or another try begins."""
    desk.site.door.hub.tell("event", Event(code="X", severity="error", text=text).model_dump_json())
    expect(desk.page.locator("#message")).to_have_text(text)


def test_a_message_goes_when_another_try_begins_or_a_person_is_asked_or_dismisses_it(desk: Desk) -> None:
    page, message = desk.page, desk.page.locator("#message")
    warn(desk, "one")
    page.get_by_role("button", name="Dismiss this message").click()
    expect(message).to_be_empty()
    warn(desk, "two")
    desk.say("Complete", "reset", "pick")
    expect(message).to_have_text("two")  # nothing new
    page.click("#reset")
    expect(message).to_be_empty()
    for step in ({"now": "Resetting"}, {"now": "Execute", "cycle_id": "c2"}):
        warn(desk, f"before {step}")
        desk.say(**step)
        expect(message).to_be_empty()


def test_on_a_phone_state_and_stop_stay_in_view_and_a_message_covers_neither_them_nor_the_answers(desk: Desk) -> None:
    page = desk.page
    page.set_viewport_size({"width": 390, "height": 844})
    proposal = {"proposal_id": "c1-0", "object": "a cup", "motion_s": 5.7, "until_ns": 0}
    page.route("**/api/proposal", lambda route: route.fulfill(json=proposal))
    desk.say("Execute", "stop", "approve", "next_grasp", "reject", stage="approve", cycle_id="c3", shown=ASKS)
    page.locator("#answer-approve").scroll_into_view_if_needed()
    warn(desk, "A person closed the door of the room, and a lamp went out; see that both are as they were.")
    for selector in ("#state", "#stop", "#answer-approve"):
        middle = (
            "one => { const box = one.getBoundingClientRect();"
            " return one.contains(document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2)); }"
        )
        assert page.locator(selector).evaluate(middle), selector
    page.get_by_role("button", name="Dismiss this message").click()
    page.unroute("**/api/proposal")
    page.set_viewport_size({"width": 1400, "height": 1000})


def test_that_the_cell_has_ended_is_said_and_not_that_it_holds(desk: Desk) -> None:
    desk.say("Execute", "stop")
    gone = Event(code="CELL_GONE", severity="error", text="The cell is gone.")
    desk.site.door.hub.tell("event", gone.model_dump_json())
    until(desk.page, "The cell has ended")
    expect(desk.page.locator("#reason")).to_contain_text("What this page had in motion does not go on.")
    desk.say("Stopped", "reset")


def test_words_and_a_cross_replace_each_other_and_reset_clears_the_cross(desk: Desk) -> None:
    page, asked, words = desk.page, desk.page.locator("#asked"), desk.page.locator("#words")
    desk.say("Complete", "reset", "pick")
    click_middle(page, page.locator("#overlay"))
    expect(asked).to_be_visible()
    words.fill("the red one")
    expect(asked).to_be_hidden()
    page.get_by_role("button", name="Choose").click()
    expect(page.locator("#what")).to_have_text("“the red one”")
    click_middle(page, page.locator("#overlay"))
    expect(words).to_have_value("")
    page.click("#reset")
    expect(asked).to_be_hidden()


def test_by_keyboard_alone_an_object_is_chosen_where_nothing_has_a_number_yet(desk: Desk) -> None:
    page, keys = desk.page, desk.page.keyboard
    expect(page.locator("#sees")).to_contain_text("Things get their numbers when the cell looks for them")
    page.focus("#figure")
    for key in ("ArrowRight", "Shift+ArrowUp", "Tab", "Tab"):
        keys.press(key)
    expect(page.locator("#pick")).to_be_focused()
    with page.expect_response("**/api/commands/pick"):
        keys.press("Enter")
    target = desk.cell.sent[-1][1].job.target
    assert target is not None and target.picture_ns == PICTURE_NS
    assert target.pixel == (86, 44), "from the middle, (80, 45): a step of 4 % to the right, a small one up"
    expect(page.locator("#figure")).to_be_focused()
    page.focus("#words")
    keys.type("the red one")
    keys.press("Enter")
    expect(page.locator("#place")).to_be_focused()  # a key that is held does not press Pick it
    keys.press("Shift+Tab")
    assert not serious_findings(page)


def test_by_keyboard_reset_and_the_cards_are_a_few_tabs_away(desk: Desk) -> None:
    page, keys = desk.page, desk.page.keyboard
    focus = "document.activeElement.ariaLabel ?? document.activeElement.textContent"
    page.focus("#stop")
    for _ in range(2):
        keys.press("Tab")
    assert page.evaluate(focus) == "To the buttons", "what it asks is passed over, where it asks nothing"
    keys.press("Enter")
    keys.press("Tab")
    expect(page.locator("#start")).to_be_focused()
    page.focus("#failed-only")
    keys.press("Tab")
    for word in ("Report", "Good", "Bad"):
        assert page.evaluate(focus) == f"{word}: {CYCLE}"
        keys.press("ArrowRight")
    keys.press("Tab")
    expect(page.locator("#pick-list button:focus")).to_have_count(0)  # one stop for all cards
    assert not desk.cell.sent


def test_only_what_failed_is_listed_where_that_is_wanted(desk: Desk) -> None:
    with desk.page.expect_response("**/api/cycles?limit=6&failed=true"):
        desk.page.get_by_label("Failed only").check()
    with desk.page.expect_response("**/api/cycles?limit=6"):
        desk.page.get_by_label("Failed only").uncheck()


def test_few_picks_are_counted_and_many_are_rated_as_the_command_line_rates_them(desk: Desk) -> None:
    page = desk.page
    day = Counts(cycles=11, picks=11, succeeded=6, executed=9, missed=3, busy_s=110).to_json()
    many = Counts(cycles=22, picks=22, succeeded=12, executed=18, missed=6, busy_s=220).to_json()
    for said, success, missed in ((day, "6 of 11", "3 of 9"), (many, "54.5 %", "33.3 %")):
        summary = said | {"days": {}, "definitions": DEFINITIONS}
        page.route("**/api/summary*", lambda route, _, summary=summary: route.fulfill(json=summary))
        page.evaluate("import('/page/link.js').then(({ cell }) => cell.dispatchEvent(new Event('recorded')))")
        expect(page.locator("[data-figure=success] dd")).to_have_text(success)
        expect(page.locator("[data-figure=missed] dd")).to_have_text(missed)
        page.unroute("**/api/summary*")
    page.evaluate("import('/page/link.js').then(({ cell }) => cell.dispatchEvent(new Event('recorded')))")
    expect(page.locator("#today")).to_contain_text("No pick was made today.")


@contextmanager
def first_question_waits(page: Any, path: str, first: Any, then: Any) -> Iterator[None]:
    """The answer to the first question comes when the next ones are answered: at the end."""
    asked: list[Any] = []

    def answer(route: Any) -> None:
        asked.append(route)
        if len(asked) > 1:
            route.fulfill(json=then)

    page.route(path, answer)
    yield
    with page.expect_response(path):
        asked[0].fulfill(json=first)
    page.unroute(path)


def test_figures_of_before_do_not_cover_those_of_now(desk: Desk) -> None:
    page = desk.page
    before, now = (
        Counts(cycles=picks, picks=picks, succeeded=picks).to_json() | {"days": {}, "definitions": DEFINITIONS}
        for picks in (1, 2)
    )
    recorded = "import('/page/link.js').then(({ cell }) => cell.dispatchEvent(new Event('recorded')))"
    with first_question_waits(page, "**/api/summary*", before, now):
        with page.expect_request("**/api/summary*"):
            page.evaluate(recorded)
        page.evaluate(recorded)
        expect(page.locator("[data-figure=success] dd")).to_have_text("2 of 2")
    page.evaluate("() => new Promise(requestAnimationFrame)")
    expect(page.locator("[data-figure=success] dd")).to_have_text("2 of 2")


def test_a_list_of_before_does_not_cover_the_one_that_was_asked_for(desk: Desk) -> None:
    page, only = desk.page, desk.page.get_by_label("Failed only")
    missed = ENTRY | {"code": "GRASP_MISSED"}
    with first_question_waits(page, "**/api/cycles*", [missed, ENTRY | {"cycle_id": "another"}], [missed]):
        with page.expect_request("**/api/cycles*"):
            desk.site.door.hub.tell("result", RESULT.model_copy(update={"cycle_id": CYCLE}).model_dump_json())
        only.check()
        expect(page.locator("#pick-list li")).to_have_count(1)
    page.evaluate("() => new Promise(requestAnimationFrame)")
    expect(page.locator("#pick-list li")).to_have_count(1)


def test_what_keeps_another_interface_closed_stays_on_the_page(desk: Desk) -> None:
    closed = DoorHealth(problem="cannot open: its port is taken.", advice="Set opcua.port.")
    doors = {"http": DoorHealth(endpoint="http://127.0.0.1:8088"), "opcua": closed}
    health = CellHealth(is_healthy=False, nodes={}, doors=doors)
    desk.cell.said.put(Sample(topics.HEALTH.key, encoding_of(CellHealth), encode(health)))
    line = desk.page.locator("#lines .bad").filter(has_text="OPC UA")
    expect(line).to_have_text("OPC UA: cannot open: its port is taken.Set opcua.port.")
    expect(desk.page.locator("#lines")).to_contain_text("HTTP: open")


@pytest.mark.parametrize(
    ("rules", "said"),
    [({}, "Nothing is deleted by itself."), ({"recording.keep_days": 30}, "Nothing will be deleted within a day.")],
)
def test_the_disk_line_says_whether_anything_is_ever_deleted(desk: Desk, rules: dict[str, float], said: str) -> None:
    soon = {"recordings": 0, "bytes": 0, "trimmed": 0}
    disk = {"free_bytes": 10**11, "total_bytes": 2 * 10**11, "recordings_bytes": 1, "rules": rules, "soon": soon}
    desk.page.route("**/api/storage", lambda route: route.fulfill(json=disk | {"short": ""}), times=1)
    desk.page.reload()
    expect(desk.page.locator("#health")).to_contain_text(said)


def test_a_button_that_can_do_nothing_here_says_so_first(desk: Desk) -> None:
    expect(desk.page.locator("#why-empty")).to_contain_text("a new object with every pick")
    desk.say("Aborted", "clear", "mode", mode="Manual")
    expect(desk.page.locator("#why-jog")).to_have_text("First Clear, then it can be moved.")


def test_who_holds_the_lease_is_named_and_taking_over_asks_first_of_all(desk: Desk) -> None:
    desk.cell.refusal = Refused("The cell moves for 'line-3', which holds the lease.", "Wait.", code="LEASE_HELD")
    desk.page.click("#start")
    expect(desk.page.locator("#asking")).to_contain_text("The cell is moved by line-3.")
    desk.page.get_by_role("button", name="Leave it").click()
    assert [verb for verb, _ in desk.cell.sent] == ["start"]


def test_a_verdict_is_appended_with_who_said_it(desk: Desk) -> None:
    page = desk.page
    page.get_by_role("button", name=f"Bad: {CYCLE}").click()
    page.fill("#who", "anna")
    page.fill("#note", "it slipped")
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#message")).to_have_text("Kept.")
    with page.expect_response("**/api/labels/*"):  # the name is known now
        page.get_by_role("button", name=f"Good: {CYCLE}").click()
    said = [(one.who, one.label, one.note) for one in read_labels(desk.recordings)]
    assert said == [("anna", "bad", "it slipped"), ("anna", "good", "")]


@pytest.mark.parametrize(("width", "height"), [(1400, 1000), (390, 844)])
def test_stop_works_while_a_note_is_written(desk: Desk, width: int, height: int) -> None:
    page = desk.page
    desk.say("Execute", "stop", "abort", "hold")
    page.set_viewport_size({"width": width, "height": height})
    page.get_by_role("button", name=f"Note: {CYCLE}").click()
    expect(page.locator("#asking")).to_be_visible()
    with page.expect_response("**/api/commands/stop"):
        click_middle(page, page.locator("#stop"))
    assert [verb for verb, _ in desk.cell.sent] == ["stop"]
    assert not serious_findings(page)
    page.get_by_role("button", name="Close").click()
    page.set_viewport_size({"width": 1400, "height": 1000})


def test_the_arm_is_moved_by_hand_only_while_a_button_is_held(desk: Desk) -> None:
    page, moves = desk.page, ("jog", "jog_home", "hand_open", "hand_close", "stop", "mode")
    desk.say("Stopped", *moves, mode="Manual", shown="Stopped: moved by hand")
    expect(page.locator("#why-reset")).to_contain_text("back to picking")
    up = page.get_by_role("button", name="up", exact=True)
    up.hover()
    with page.expect_response("**/api/commands/jog"):
        page.mouse.down()
    with page.expect_response("**/api/commands/jog"):
        pass  # it is sent again
    page.mouse.up()
    with page.expect_response("**/api/commands/hand_open"):
        page.get_by_role("button", name="Open the hand").click()
    with page.expect_response("**/api/commands/stop"):
        page.keyboard.press("Escape")
    verbs = [verb for verb, _ in desk.cell.sent]
    assert verbs[:2] == ["jog", "jog"] and verbs[-1] == "stop"  # nothing moves after it was let go
    assert (desk.cell.sent[0][1].axis, desk.cell.sent[0][1].direction) == ("z", 1)


def test_a_person_is_asked_before_it_moves_and_answers_what_they_saw(desk: Desk) -> None:
    page, answers = desk.page, ("approve", "next_grasp", "reject")
    proposal = {"proposal_id": "c1-0", "object": HOSTILE, "motion_s": 5.7, "until_ns": 0}
    page.route("**/api/proposal", lambda route: route.fulfill(json=proposal))
    page.route("**/api/plan", lambda route: route.fulfill(status=409, json={"reason": "Nothing was planned."}))
    desk.say("Execute", "stop", "abort", "hold", *answers, stage="approve", shown=ASKS)
    expect(page.locator("#approve")).to_contain_text(HOSTILE)
    assert not serious_findings(page)
    page.fill("#answer-reason", "it would slip")
    for verb in ("next_grasp", "approve"):
        with page.expect_response(f"**/api/commands/{verb}"):
            page.click(f"#answer-{verb}")
    said = [(verb, request.proposal, request.reason) for verb, request in desk.cell.sent]
    assert said == [("next_grasp", "c1-0", "it would slip"), ("approve", "c1-0", "")]


@pytest.mark.parametrize(
    ("width", "height"),
    [(390, 844), pytest.param(820, 1180, marks=THOROUGH), pytest.param(1400, 1000, marks=THOROUGH)],
)
def test_the_page_fits_every_screen_light_and_dark(desk: Desk, width: int, height: int) -> None:
    page = desk.page
    desk.say("Aborted", "clear", reason="NODE_LOST: the node 'sim' is gone.")
    page.set_viewport_size({"width": width, "height": height})
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert not serious_findings(page)
    stop = page.locator("#stop").bounding_box()
    assert stop["height"] >= 80 and stop["y"] + stop["height"] <= height
    assert float(state(page).evaluate("one => parseFloat(getComputedStyle(one).fontSize)")) >= 32
    page.set_viewport_size({"width": 1400, "height": 1000})


def test_a_viewer_enters_a_token_and_may_look_and_stop_only(open_page: Open, tmp_path: Path) -> None:
    cell = FakeCell(now=state_of("Execute", "stop", "abort", "hold", "suspend"))
    with site_of(cell, tmp_path, TOKENS) as (_, url):
        page = open_page(url)
        page.fill("#token", TOKENS[HttpRole.VIEWER])
        page.keyboard.press("Enter")
        until(page, "Execute")
        for name in ("start", "hold", "abort", "reset"):
            expect(page.locator(f"#{name}")).to_have_attribute("aria-disabled", "true")
        expect(page.locator("#why-hold")).to_have_text("Only an operator may.")
        expect(page.locator("#facts")).to_contain_text("viewer")
        with page.expect_response("**/api/commands/stop"):
            page.click("#stop")
        assert [verb for verb, _ in cell.sent] == ["stop"]
        page.close()


def test_a_page_is_small_and_reads_without_a_network_of_others() -> None:
    files = list(FOLDER.iterdir())
    assert sum(file.stat().st_size for file in files) < 300_000
    for file in files:
        text = file.read_text().replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in text and "https://" not in text
        assert "innerHTML" not in text

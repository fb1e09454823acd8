"""The operator's page in a real browser: at a simulated cell, and at one that says what a test wants."""

from __future__ import annotations

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
from bus.frozen import Message
from bus.messages import Attempt, Job, LivePicture, Target
from bus.sample import Sample
from bus.topics import Topic, encoding_of
from cell.http.access import Access, HttpRole
from cell.http.page_files import FOLDER
from config.http import HttpSettings
from config.schema import Station
from docs.browser import FLAGS, find_chromium, launch_chromium
from logs.catalogue.figures import DEFINITIONS, Counts
from logs.catalogue.labels import read_labels
from tests.cell.http_bench import ACCEPTED, RESULT, FakeCell, Site, door_of, served, served_for_real

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


_HOLDS_ONCE_IT_MOVES = """() => import("/page/link.js").then(({ cell, now }) => {
  const look = () => {
    if (now.state.stage !== "execute") return;
    cell.removeEventListener("state", look);
    document.querySelector("#hold").click();
  };
  cell.addEventListener("state", look);
})"""
"""A person sees that it moves, and holds it; a test that looks from outside may come when it is over."""


def test_a_day_at_the_cell(
    shared_cell: Station, url: str, open_page: Open, program: str, tool: Any, tmp_path: Path
) -> None:
    page = open_page(url)
    until(page, "Stopped")
    expect(page.locator("#why-start")).to_have_text("Reset first.")
    page.click("#reset")
    until(page, "Idle")
    expect(page.locator("#picture")).to_be_visible()  # one of now, before the first pick

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
    page.evaluate(_HOLDS_ONCE_IT_MOVES)
    page.click("#answer-approve")
    until(page, "Held")
    expect(page.locator("#overlay.earlier.elsewhere")).to_have_count(1)  # a picture of now: one must look at the arm
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
SCENE = {"stamp": "0", "outlines": [], "numbers": [{"text": "7", "at_px": [9, 9]}]}
LEASE_HELD = {"code": "LEASE_HELD", "reason": "The cell moves for 'line-3', which holds the lease.", "advice": ""}
PROPOSAL = {"proposal_id": "c1-0", "object": "a cup", "motion_s": 5.7, "until_ns": 0}
PLAN: dict[str, Any] = {
    "parts": [], "boxes": [], "frames": [], "cloud_m": [], "cloud_rgb": [],
    "segments": [{"name": "reach", "only_to_look": False, "times_s": [0, 1], "base_from_frame": [],
                  "tcp_m": [[0, 0, 0], [0, 0, 1]]}],
    "proposal": {"base_from_tcp": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "opening_m": 0.05},
}  # fmt: skip


_SHOWS = """([said, shown]) => document.querySelector("#state").textContent === shown && import("/page/link.js").then(
  ({ now }) => JSON.stringify(now.state) === JSON.stringify(JSON.parse(said)))"""
"""Whether this very state is shown, and not one before it of the same name."""


_COMMANDS_ARE_COUNTED = """
const ask = window.fetch;
window.sending = 0;
window.fetch = async (path, init) => {
  const commands = Number(path.startsWith("/api/commands/"));
  window.sending += commands;
  try {
    return await ask(path, init);
  } finally {
    window.sending -= commands;
  }
};"""


@dataclass
class Desk:
    """A page at a cell that says what a test wants; everything of others has tags in it."""

    cell: FakeCell
    site: Site
    page: Any
    recordings: Path

    def settle(self) -> None:
        """Every command that the page has sent is answered: none comes after what a test sends next."""
        self.page.wait_for_function("() => !window.sending", timeout=LONG_MS)

    def say(self, now: str, *available: str, **more: Any) -> None:
        """The cell is in this state, and the page shows it."""
        shown = more.pop("shown", now)
        self.cell.now = state_of(now, *available, **more)
        self.tell(topics.STATE, self.cell.now)
        self.page.wait_for_function(_SHOWS, arg=[self.cell.now.model_dump_json(), shown], timeout=LONG_MS)

    def tell(self, topic: Topic, message: Message) -> None:
        """The cell says this."""
        self.cell.said.put(Sample(topic.key, encoding_of(type(message)), encode(message)))

    def result(self, **of: Any) -> None:
        """The cell says the result of a pick."""
        self.tell(topics.RESULT, RESULT.model_copy(update=of))


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
        page.add_init_script(_COMMANDS_ARE_COUNTED)
        page.goto(url)
        yield Desk(cell, site, page, folder)


@pytest.fixture
def desk(module_desk: Desk) -> Desk:
    module_desk.settle()
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
    desk.tell(topics.EVENT, Event(code=HOSTILE, severity="error", text=f"{HOSTILE}!", advice=HOSTILE))
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
    page.route("**/api/cycles*", lambda route: route.fulfill(json=[ENTRY | {"result": "SUCCESS"}]), times=1)
    with page.expect_response("**/api/cycles*"):
        desk.result(cycle_id="20260101T000000000", result="FAILED", reason="It slipped.")
    desk.say("Complete", "reset", "pick")
    expect(page.locator("#reason")).to_have_text("Done: the last pick FAILED - It slipped.")


def test_the_card_of_a_pick_that_waited_has_the_time_at_which_it_began(desk: Desk) -> None:
    page = desk.page
    page.route("**/api/cycles*", lambda route: route.fulfill(json=[ENTRY | {"began": "20261129T113000000"}]), times=1)
    desk.result(cycle_id=CYCLE)
    expect(page.locator("#pick-list")).to_contain_text(f"11:30 UTC · {CYCLE}")


def test_a_pick_that_found_the_bin_empty_says_so_and_what_to_do(desk: Desk) -> None:
    desk.result(result="EMPTY")
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
    desk.settle()
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
    desk.result(result="FAILED", reason=NOT_THERE)
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
    desk.result(result="FAILED", reason="Stopped during 'hold'.")
    desk.say("Complete", "reset", "pick")
    expect(reason).to_contain_text("It was stopped while it checked what it held.")
    desk.result(result="FAILED", reason="Stopped before 'detect'.")
    expect(reason).to_contain_text("It was stopped before it grasped.")
    desk.result(result="FAILED", reason="http-page-root-vm-1-3.1 rejected it: too near.")
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
    desk.result(cycle_id=CYCLE)
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
    desk.tell(topics.EVENT, Event(code="X", severity="error", text=text))
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
    page.route("**/api/proposal", lambda route: route.fulfill(json=PROPOSAL))
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
    desk.tell(topics.EVENT, Event(code="CELL_GONE", severity="error", text="The cell is gone."))
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
        announce(page, "recorded")
        expect(page.locator("[data-figure=success] dd")).to_have_text(success)
        expect(page.locator("[data-figure=missed] dd")).to_have_text(missed)
        page.unroute("**/api/summary*")
    announce(page, "recorded")
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
    page.unroute(path, answer)


def test_figures_of_before_do_not_cover_those_of_now(desk: Desk) -> None:
    page = desk.page
    before, now = (
        Counts(cycles=picks, picks=picks, succeeded=picks).to_json() | {"days": {}, "definitions": DEFINITIONS}
        for picks in (1, 2)
    )
    with first_question_waits(page, "**/api/summary*", before, now):
        with page.expect_request("**/api/summary*"):
            announce(page, "recorded")
        announce(page, "recorded")
        expect(page.locator("[data-figure=success] dd")).to_have_text("2 of 2")
    page.evaluate("() => new Promise(requestAnimationFrame)")
    expect(page.locator("[data-figure=success] dd")).to_have_text("2 of 2")


def test_a_list_of_before_does_not_cover_the_one_that_was_asked_for(desk: Desk) -> None:
    page, only = desk.page, desk.page.get_by_label("Failed only")
    missed = ENTRY | {"code": "GRASP_MISSED"}
    with first_question_waits(page, "**/api/cycles*", [missed, ENTRY | {"cycle_id": "another"}], [missed]):
        with page.expect_request("**/api/cycles*"):
            desk.result(cycle_id=CYCLE)
        only.check()
        expect(page.locator("#pick-list li")).to_have_count(1)
    page.evaluate("() => new Promise(requestAnimationFrame)")
    expect(page.locator("#pick-list li")).to_have_count(1)
    only.uncheck()


@contextmanager
def unanswered(page: Any, path: str) -> Iterator[Callable[[int], Any]]:
    """Questions that wait for the test's answer: gives the one of a number, from 0 on, when it was asked."""
    asked: list[Any] = []

    def keep(route: Any) -> None:
        asked.append(route)

    def question(number: int) -> Any:
        while len(asked) <= number:
            page.wait_for_timeout(10)
        return asked[number]

    page.route(path, keep)
    yield question
    page.unroute(path, keep)


def answer(page: Any, question: Any, said: Any, status: int = 200) -> None:
    """The answer comes, and the page has read it."""
    with page.expect_response(question.request.url) as response:
        question.fulfill(json=said, status=status)
    response.value.finished()
    page.evaluate("() => new Promise(requestAnimationFrame)")


def announce(page: Any, name: str, detail: object = None) -> None:
    """The parts of the page hear of something."""
    told = "cell.dispatchEvent(new CustomEvent(name, { detail }))"
    page.evaluate(f"([name, detail]) => import('/page/link.js').then(({{ cell }}) => {told})", [name, detail])


def set_linked(page: Any, is_linked: bool) -> None:
    page.evaluate("is => import('/page/link.js').then(({ now }) => { now.isLinked = is; })", is_linked)
    announce(page, "link", is_linked)


def test_on_a_slow_link_each_answer_is_shown_until_a_newer_one_is_there(desk: Desk) -> None:
    page, numbers = desk.page, desk.page.locator("#overlay text.number")
    with unanswered(page, "**/api/scene") as question:
        for number in (0, 1):  # asked again before the first answer
            announce(page, "scene")
            question(number)
        question(0).fulfill(json=SCENE)
        expect(numbers).to_have_text("7")
        question(1).fulfill(json=OUTDATED)
        expect(numbers).to_have_count(0)


LEARN = "() => import('/page/link.js').then(({ learn }) => { learn(); })"


def test_a_station_as_it_was_does_not_cover_what_it_is_now(desk: Desk) -> None:
    page, place = desk.page, desk.page.locator("#place")
    with unanswered(page, "**/api/cell") as question:
        for number in (0, 1):
            page.evaluate(LEARN)
            question(number)
        question(1).fulfill(json=ABOUT | {"places": [{"name": "the next shelf", "capacity": 0}]})
        expect(place).to_contain_text("at the next shelf")
        answer(page, question(0), ABOUT)
        expect(place).to_contain_text("at the next shelf")
    page.evaluate(LEARN)
    expect(place).not_to_contain_text("at the next shelf")


def test_an_answer_that_takes_long_makes_no_clock_wrong(desk: Desk) -> None:
    page, slow_ms = desk.page, 400
    with unanswered(page, "**/api/cell") as question:
        page.evaluate(LEARN)
        asked = question(0)
        page.wait_for_timeout(slow_ms)
        answer(page, asked, ABOUT)
    since_ms = "({ now }) => Date.now() + (now.offset_ns - now.about.now_ns) / 1e6"
    since_said_ms = page.evaluate(f"() => import('/page/link.js').then({since_ms})")
    assert since_said_ms >= slow_ms / 2, "it was said halfway between question and answer"


def test_the_health_that_was_asked_for_does_not_cover_what_was_said_meanwhile(open_page: Open, tmp_path: Path) -> None:
    cell = FakeCell(now=state_of("Idle"))
    with site_of(cell, tmp_path) as (site, url):
        page = open_page("about:blank")
        with unanswered(page, "**/api/health") as question:
            page.goto(url)
            before = question(0)
            said = CellHealth(is_healthy=False, nodes={}, defects=("a thread ended",))
            Desk(cell, site, page, tmp_path).tell(topics.HEALTH, said)
            expect(page.locator("#lines .bad")).to_contain_text("a thread ended")
            answer(page, before, CellHealth(is_healthy=True, nodes={}).model_dump(mode="json"))
            expect(page.locator("#lines .bad")).to_contain_text("a thread ended")
        page.close()


def test_a_proposal_that_comes_when_it_was_answered_is_not_asked_about(desk: Desk) -> None:
    page = desk.page
    with unanswered(page, "**/api/proposal") as question:
        desk.say("Execute", "stop", "approve", stage="approve", shown=ASKS)
        late = question(0)
        desk.say("Execute", "stop", stage="execute", shown="Execute: grasps")
        answer(page, late, PROPOSAL)
        expect(page.locator("#answer-approve")).to_have_count(0)


def test_a_plan_is_shown_only_with_the_proposal_that_it_is_of(desk: Desk) -> None:
    page = desk.page
    page.route("**/api/proposal", keep_proposal := lambda route: route.fulfill(json=PROPOSAL))
    for proposal_id, shown in (("c0-0", 0), (PROPOSAL["proposal_id"], 1)):
        with unanswered(page, "**/api/plan") as question:
            desk.say("Execute", "stop", "approve", stage="approve", shown=ASKS)
            answer(page, question(0), PLAN | {"proposal": {**PLAN["proposal"], "proposal_id": proposal_id}})
            expect(page.locator(".plan-view")).to_have_count(shown)
        desk.say("Execute", "stop", stage="execute", shown="Execute: grasps")
    page.unroute("**/api/proposal", keep_proposal)


def test_a_list_that_could_not_be_had_is_asked_for_again(desk: Desk) -> None:
    page = desk.page
    page.route("**/api/cycles*", lambda route: route.fulfill(status=404, json={"code": "CATALOGUE"}), times=1)
    with page.expect_response(lambda said: "/api/cycles" in said.url and said.status == 404):
        set_linked(page, True)
    with page.expect_response(lambda said: "/api/cycles" in said.url and said.ok):
        pass


def test_the_last_pick_from_before_the_link_was_lost_is_not_that_of_now(desk: Desk) -> None:
    page = desk.page
    desk.say("Complete", "reset", "pick")
    with unanswered(page, "**/api/cycles*") as question:
        set_linked(page, True)
        before = question(0)
        set_linked(page, False)
        answer(page, before, [ENTRY | {"cycle_id": "before", "reason": "It was lost."}])
        set_linked(page, True)
        answer(page, question(1), [ENTRY | {"cycle_id": "now", "reason": "It slipped."}])
    expect(page.locator("#reason")).to_have_text("Done: the last pick FAILED - It slipped.")


def test_what_is_chosen_while_a_pick_is_sent_stays_and_a_second_press_sends_nothing(desk: Desk) -> None:
    page, asked = desk.page, desk.page.locator("#asked")
    with unanswered(page, "**/api/commands/pick") as question:
        click_middle(page, page.locator("#overlay"))
        for _ in range(2):
            page.click("#pick")
        first = question(0)
        page.fill("#words", "the red one")
        page.get_by_role("button", name="Choose").click()
        answer(page, first, ACCEPTED.model_dump(mode="json"))
        expect(asked).to_be_visible()
        page.click("#pick")
        assert question(1).request.post_data_json["job"]["target"] == {"text": "the red one"}
        answer(page, question(1), ACCEPTED.model_dump(mode="json"))
        expect(asked).to_be_hidden()
    page.fill("#words", "")


def test_a_thing_whose_number_is_of_an_earlier_look_when_the_answer_comes_is_not_named_by_it(desk: Desk) -> None:
    page, what, jobs = desk.page, desk.page.locator("#what"), desk.page.locator("#jobs")
    whole = {"kind": "thing", "color": "#fff", "number": 7, "points_px": [[0, 0], [160, 0], [160, 90], [0, 90]]}
    with unanswered(page, "**/api/scene") as scene, unanswered(page, "**/api/commands/pick") as question:
        announce(page, "scene")
        scene(0).fulfill(json=SCENE | {"outlines": [whole]})
        expect(page.locator("#overlay text.number")).to_have_text("7")
        click_middle(page, page.locator("#overlay"))
        expect(what).to_contain_text("thing 7")
        page.click("#pick")
        question(0)
        announce(page, "scene")
        answer(page, scene(1), OUTDATED)
        answer(page, question(0), ACCEPTED.model_dump(mode="json"))
    desk.tell(topics.ATTEMPT, Attempt(cycle_id="c1", job=Job(job_id="c1", target=Target(pixel=(80, 45)))))
    desk.say("Execute", "stop", job_id="c1")
    expect(jobs).to_contain_text("Picks what you pointed at")
    expect(jobs).not_to_contain_text("Thing 7")


def test_what_the_cell_says_before_it_answers_a_command_stays(desk: Desk) -> None:
    page = desk.page
    with unanswered(page, "**/api/commands/start") as question:
        page.click("#start")
        warn(desk, "A node is lost.")
        answer(page, question(0), ACCEPTED.model_dump(mode="json"))
        expect(page.locator("#message")).to_have_text("A node is lost.")


def test_a_question_that_comes_late_does_not_take_the_place_of_what_is_written(desk: Desk) -> None:
    page = desk.page
    with unanswered(page, "**/api/commands/start") as question:
        page.click("#start")
        page.get_by_role("button", name=f"Note: {CYCLE}").click()
        page.fill("#note", "it slips")
        answer(page, question(0), LEASE_HELD, 409)
        expect(page.locator("#message")).to_contain_text("The cell is moved by line-3.")
        expect(page.locator("#note")).to_have_value("it slips")
    page.get_by_role("button", name="Close").click()


@pytest.mark.parametrize(
    ("in_hand", "then"), [("", ["reset"]), ("Something may be in the hand: its fingers are 36 mm apart.", [])]
)
def test_who_takes_over_does_not_drop_what_is_in_the_hand(desk: Desk, in_hand: str, then: list[str]) -> None:
    page = desk.page
    desk.say("Execute", "stop")
    desk.cell.refusal = Refused(LEASE_HELD["reason"], code="LEASE_HELD")
    page.fill("#words", "the red one")
    page.keyboard.press("Enter")
    page.click("#pick")
    take_over = page.get_by_role("button", name="Stop it, and take over")
    expect(take_over).to_be_visible()
    desk.cell.refusal = None
    desk.cell.sent.clear()
    with page.expect_response("**/api/commands/stop"):
        take_over.click()
    desk.say("Stopped", "reset", reason=in_hand)
    if then:
        expect(page.locator("#message")).to_have_text("The cell is yours, and ready.")
    desk.say("Stopped", "reset", "abort", reason=in_hand)
    assert [verb for verb, _ in desk.cell.sent] == ["stop", *then]


def test_who_moves_it_by_hand_is_named_in_plain_words(desk: Desk) -> None:
    desk.say("Stopped", "reset", reason="mode Manual from http-page-3-1")
    expect(desk.page.locator("#reason")).to_have_text("Nothing moves (asked for by another page).")


def test_of_a_cell_that_has_ended_no_part_is_called_well(desk: Desk) -> None:
    doors = {"http": DoorHealth(endpoint="http://127.0.0.1:8088")}
    desk.tell(topics.HEALTH, CellHealth(is_healthy=True, nodes={}, doors=doors))
    expect(desk.page.locator("#lines")).to_contain_text("HTTP")
    desk.tell(topics.EVENT, Event(code="CELL_GONE", severity="error", text="The cell is gone."))
    expect(desk.page.locator("#lines li").first).to_have_text("The cell does not answer.")
    expect(desk.page.locator("#lines")).not_to_contain_text("HTTP")
    desk.say("Idle")


@contextmanager
def a_jog_that_was_let_go(desk: Desk) -> Iterator[Callable[[int], Any]]:
    """A button of a jog was pressed and let go before its first step was answered; yields what was asked, by number."""
    page = desk.page
    desk.say("Stopped", "jog", "stop", mode="Manual", shown="Stopped: moved by hand")
    page.get_by_role("button", name="up", exact=True).hover()
    with unanswered(page, "**/api/commands/jog") as question:
        page.mouse.down()
        question(0)
        page.mouse.up()
        yield question


def test_a_button_that_is_let_go_and_held_anew_moves_once_at_a_time(desk: Desk) -> None:
    page, sent = desk.page, list[str]()
    with a_jog_that_was_let_go(desk) as question:
        page.mouse.down()
        question(1)
        page.on("request", note := lambda request: sent.append(request.url))
        answer(page, question(0), ACCEPTED.model_dump(mode="json"))
        page.wait_for_timeout(400)  # longer than from one step to the next
        assert not [url for url in sent if url.endswith("/jog")], "the second hold waits for its own answer"
        page.remove_listener("request", note)
        page.mouse.up()
        answer(page, question(1), ACCEPTED.model_dump(mode="json"))


def test_nothing_more_is_sent_for_a_button_that_was_let_go_whoever_holds_the_lease(desk: Desk) -> None:
    page = desk.page
    with a_jog_that_was_let_go(desk) as question:
        answer(page, question(0), LEASE_HELD, 409)
        expect(page.locator("#message")).to_contain_text("The cell is moved by line-3.")
        expect(page.locator("#asking")).to_be_hidden()


_PICTURES_ARE_NOTED = """() => {
  window.pictures = [];
  const note = () => window.pictures.push(document.querySelector("#picture").getAttribute("src"));
  new MutationObserver(note).observe(document.querySelector("#figure"), { childList: true });
}"""


def test_a_picture_of_now_that_comes_late_gives_way_to_that_of_the_pick_that_goes_on(desk: Desk) -> None:
    page, live = desk.page, {"is_live": True, "from_capture_pose": True, "gone": [], "things": "0"}
    page.route("**/api/picture?at=5", of_the_pick := lambda route: route.fulfill(path=FOLDER / "no-picture.svg"))
    announce(page, "picture", {"stamp": "5"})
    expect(page.locator("#picture")).to_have_attribute("src", "/api/picture?at=5")
    desk.say("Held", "stop", "unhold")
    with unanswered(page, "**/api/picture?at=6") as question:
        announce(page, "picture", {"stamp": "6"} | live)
        late = question(0)
        desk.say("Unholding", "stop")
        page.evaluate(_PICTURES_ARE_NOTED)
        late.fulfill(path=FOLDER / "no-picture.svg")
        page.wait_for_function("() => window.pictures.at(-1) === '/api/picture?at=5'", timeout=LONG_MS)
    page.unroute("**/api/picture?at=5", of_the_pick)
    desk.say("Idle", "pick")
    announce(page, "picture", {"stamp": str(PICTURE_NS)} | live)
    expect(page.locator("#picture")).to_have_attribute("src", f"/api/picture?at={PICTURE_NS}")


def test_what_keeps_another_interface_closed_stays_on_the_page(desk: Desk) -> None:
    closed = DoorHealth(problem="cannot open: its port is taken.", advice="Set opcua.port.")
    doors = {"http": DoorHealth(endpoint="http://127.0.0.1:8088"), "opcua": closed}
    health = CellHealth(is_healthy=False, nodes={}, doors=doors)
    desk.tell(topics.HEALTH, health)
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
    desk.settle()
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

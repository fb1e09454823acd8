"""Draws the pictures of docs/first_hour.md from a run of its own: ``uv run python -m docs.first_hour_pictures``."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from playwright.sync_api import Browser, sync_playwright

from cell.replay.replay import Request, replay
from docs.browser import launch_chromium
from docs.chart import Image
from docs.planning_pictures import motions
from docs.tiles import row, save, strip, titled
from logs.mcap.reader import read_cycle as read_record
from logs.report.cycle_report import write_report
from perception.geometry.window import Window
from planning.robot import Robot
from vlad_cell import Cycle, Detections, read_cycle, simulated_cell

FOLDER = Path(__file__).parent / "first_hour"
OBJECTS = Path(__file__).parent / "examples" / "objects"
NARROW = "hand.max_width_m=0.021"
_TILE_PX, _PAGE_PX = 230, (1000, 620)


def main() -> None:
    """Pick, fail and ask what if, in simulated cells; then draw."""
    with TemporaryDirectory() as folder:
        with simulated_cell(seed=1, folder=folder) as cell:
            cell.reset()
            held = read_cycle(cell.pick(object_name="spatula").recording)
            failed = read_cycle(cell.pick("purple").recording)
        with simulated_cell(seed=1, folder=folder, objects=OBJECTS) as cell:
            cell.reset()
            own = [read_cycle(cell.pick(object_name=name).recording) for name in ("brick", "wedge")]
        _pick(held)
        _what_if(held)
        _objects(own)
        _pages(held, failed, Path(folder))


def _near(cycle: Cycle, image: Image, fill: int = 0) -> Image:
    """The part of an image around the object of the best grasp."""
    return Window.around(cycle.detections.record.evidence.object_mask).cut(image, fill)


def _pick(cycle: Cycle) -> None:
    """One pick from left to right."""
    plan = cycle.record.stages["plan"].result
    after = cycle.after
    assert plan is not None and after is not None
    tiles = {
        "1  what it sees": _near(cycle, cycle.color),
        "2  the goal image": _near(cycle, cycle.detections.goal_image, 255),
        "3  the grasp": _near(cycle, cycle.picture().rgb),
        "4  the plan": motions(plan, Robot(cycle.station), cycle.station),
        "5  what it holds": _squarer(after.color),
    }
    save(strip(tiles, _TILE_PX), FOLDER / "pick.jpg")


def _squarer(image: Image) -> Image:
    """The middle of a wide image."""
    height_px, width_px = image.shape[:2]
    left = (width_px - height_px) // 2
    return image[:, left : left + height_px]


def _what_if(cycle: Cycle) -> None:
    """The chosen grasp as it was, and with a hand that opens less."""
    outcome = replay(read_record(cycle.path), Request.of([NARROW], None, None))
    again = Detections(next(one.replayed for one in outcome.stages if one.stage == "detect"))  # type: ignore[arg-type]
    tiles = {
        "the hand opens 80 mm": _near(cycle, cycle.picture().rgb),
        "what if it opened 21 mm?": _near(cycle, again.picture().rgb),
    }
    save(row([titled(title, tile, _TILE_PX) for title, tile in tiles.items()]), FOLDER / "what_if.jpg")


def _objects(cycles: list[Cycle]) -> None:
    """The grasps on objects of a folder of one's own."""
    tiles = [titled(f"{cycle.result}: {_name(cycle)}", _near(cycle, cycle.picture().rgb), _TILE_PX) for cycle in cycles]
    save(row(tiles), FOLDER / "own_objects.jpg")


def _name(cycle: Cycle) -> str:
    return cycle.record.result.object if cycle.record.result is not None else ""


def _pages(held: Cycle, failed: Cycle, folder: Path) -> None:
    """The heads of the report pages, in a browser."""
    with sync_playwright() as tool:
        browser = launch_chromium(tool)
        for name, cycle in (("report", held), ("failure", failed)):
            page = write_report(read_record(cycle.path), folder / f"{name}.html")
            _shot(browser, page, FOLDER / f"{name}.jpg")
        browser.close()


def _shot(browser: Browser, page: Path, path: Path) -> None:
    width, height = _PAGE_PX
    shown = browser.new_page(viewport={"width": width, "height": height})
    shown.goto(page.resolve().as_uri())
    shown.wait_for_timeout(1500)
    png = np.frombuffer(shown.screenshot(), np.uint8)
    image = cv2.resize(cv2.imdecode(png, cv2.IMREAD_COLOR), None, fx=0.8, fy=0.8, interpolation=cv2.INTER_AREA)
    save(np.asarray(image, np.uint8)[..., ::-1], path)
    shown.close()


if __name__ == "__main__":
    main()

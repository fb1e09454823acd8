"""The operator's page in a headless browser, at a simulated cell at real-time pace, served by a process of its own.

``first_paint_ms``: the browser's first contentful paint, the median of several loads. ``event_to_screen_ms``: from the
beginning of a state or stage, as the cell stamps it, until the page's document says it; ``event_to_frame_ms``: until
the frame that shows it is drawn. ``daemon_cpu_share``: processor time of the HTTP process and of the daemon, of one
core, with so many pages open at a cell that is Idle and shows pictures of now; the daemon shares its process with this
program, which waits. ``stop_to_brake_ms``: from the press on Stop, by the browser's clock (1 ms coarse), to the brake
(`benchmarks.stopping`). All of it depends on what else the machine does: ``load_average``.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

from benchmarks.stopping import Bench, Witness, wait
from bus import topics
from bus.commands import CommandRequest
from bus.free_port import free_port
from bus.session import Bus
from cell.build import running_cell
from cell.daemon.daemon import Daemon
from cell.http.page_files import FOLDER
from cell.machine.states import State
from config.load import load_station
from docs.browser import launch_chromium

_LOADS, _PAGES, _LISTEN_S = 7, (0, 1, 5), 10.0
_NOTE_LATENESS = """async () => {
  const { now } = await import("/page/link.js");
  window.late_ms = { changed: [], shown: [] };
  const note = () => {
    const since_ms = now.state.since_ns / 1e6;
    window.late_ms.changed.push(Date.now() - since_ms);
    requestAnimationFrame(() => window.late_ms.shown.push(Date.now() - since_ms));
  };
  new MutationObserver(note).observe(document.querySelector("#state"), { childList: true });
}"""
_PRESS = """() => {
  const at_ms = Date.now();
  document.querySelector("#stop").dispatchEvent(new PointerEvent("pointerdown"));
  return at_ms;
}"""
_PAINT = "() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? null"


@dataclass(frozen=True)
class PageBench(Bench):
    """Stops are pressed on a page."""

    page: Page

    def send(self, verb: str) -> int:
        """Press Stop; return when [ns UTC]."""
        assert verb == "stop"
        return round(1e6 * float(self.page.evaluate(_PRESS)))


def run(stops: int, seed: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """All figures of ``stops`` picks that are stopped from the page."""
    loaded = os.getloadavg()[0]
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    with TemporaryDirectory() as folder:
        overrides = [f"bus.endpoint={endpoint}", f"recording.folder={folder}", "sim.pace=1", "bus.ask_timeout_s=20"]
        station, witness = load_station(None, overrides), Witness()
        with (
            running_cell(station, witness.observe) as daemon,
            Bus.join(station.cell_id, endpoint) as ear,
            _door(overrides, port) as door,
            sync_playwright() as tool,
        ):
            ear.subscribe(topics.ARM_STATE.key, witness.hear)
            browser = launch_chromium(tool)
            url = f"http://127.0.0.1:{port}/"
            paints = [_first_paint_ms(browser, url) for _ in range(_LOADS)]
            tell(f"first paint {paints}")
            _make_idle(daemon)
            pids = (door.pid, os.getpid())
            shares = {str(count): _share(browser, url, pids, count) for count in _PAGES}
            tell(f"shares {shares}")
            daemon.command("stop", CommandRequest())
            wait(lambda: daemon.machine.state is State.STOPPED)
            page = _ready(browser, url)
            page.evaluate(_NOTE_LATENESS)
            bench = PageBench(daemon, station, overrides, witness, np.random.default_rng(seed), page)
            brakes = [one.first_ms for one in bench.measure("stop", bench.interrupted, stops, tell)]
            late_ms = page.evaluate("() => window.late_ms")
            browser.close()
    return {
        "first_paint_ms": round(float(np.median(paints)), 1),
        "event_to_screen_ms": _quantiles(late_ms["changed"]) | {"n": len(late_ms["changed"])},
        "event_to_frame_ms": _quantiles(late_ms["shown"]),
        "daemon_cpu_share": shares,
        "page_kb": round(sum(file.stat().st_size for file in FOLDER.iterdir()) / 1e3, 1),
        "stop_to_brake_ms": _quantiles(brakes) | {"n": len(brakes)},
        "load_average": {"before": loaded, "after": os.getloadavg()[0]},
    }


def _quantiles(values: list[float]) -> dict[str, float]:
    return {name: round(float(np.quantile(values, q)), 1) for name, q in (("p50", 0.5), ("p99", 0.99))}


def _ready(browser: Browser, url: str) -> Page:
    """A page that is linked to its cell."""
    page = browser.new_page(viewport={"width": 1400, "height": 1000})
    page.goto(url)
    wait(lambda: page.locator("#banner.tone-none").count() == 0)
    return page


def _first_paint_ms(browser: Browser, url: str) -> float:
    page = browser.new_page()
    page.goto(url)
    wait(lambda: page.evaluate(_PAINT) is not None)
    paint_ms = float(page.evaluate(_PAINT))
    page.close()
    return paint_ms


def _make_idle(daemon: Daemon) -> None:
    daemon.command("reset", CommandRequest())
    wait(lambda: daemon.machine.state is State.IDLE)


def _share(browser: Browser, url: str, pids: tuple[int, ...], count: int) -> float:
    """Processor time of some processes, of one core, with so many pages open."""
    pages = [_ready(browser, url) for _ in range(count)]
    time.sleep(2.0)
    began_s, used_s = time.monotonic(), sum(map(_used_s, pids))
    time.sleep(_LISTEN_S)
    share = (sum(map(_used_s, pids)) - used_s) / (time.monotonic() - began_s)
    for page in pages:
        page.close()
    return round(share, 4)


def _used_s(pid: int) -> float:
    with open(f"/proc/{pid}/stat") as file:
        fields = file.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _door(overrides: list[str], port: int) -> Iterator[subprocess.Popen[bytes]]:
    """``cell http`` beside the running cell."""
    settings = [word for one in (*overrides, f"http.port={port}") for word in ("--set", one)]
    process = subprocess.Popen([sys.executable, "-m", "cell", "http", *settings], stdout=subprocess.DEVNULL)
    try:
        wait(lambda: _answers(port))
        yield process
    finally:
        process.terminate()
        process.communicate()


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0

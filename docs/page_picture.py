"""Makes docs/page.jpg and docs/page_phone.jpg, the operator's page at a real run of the simulated bin, nothing staged:
``uv run python -m docs.page_picture``. A minute; needs Chromium.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from playwright.sync_api import Page, ViewportSize, expect, sync_playwright

from bus.free_port import free_port
from docs.browser import launch_chromium

HERE = Path(__file__).parent
PICTURES = {"page": (1400, 1240), "page_phone": (390, 844)}
LARGEST_BYTES = 150_000
_SETTINGS = ("sim.clutter=8", "sim.heaped=true", "sim.seed=3", "capture.views=1", "recording.keep_gb=20")
_PICKS, _PATIENCE_MS = 3, 240_000


def main() -> None:
    """Run the cell, pick some things, and take the pictures in the middle of the next pick."""
    expect.set_options(timeout=_PATIENCE_MS)
    with _cell() as url, sync_playwright() as tool:
        browser = launch_chromium(tool)
        page = browser.new_page(viewport=_size("page"))
        page.goto(url)
        page.click("#reset")
        expect(page.locator("#state")).to_have_text("Idle")
        page.fill("#count", str(_PICKS + 1))
        page.click("#start")
        expect(page.locator("#pick-list li[data-cycle] a.report")).to_have_count(_PICKS)
        page.fill("#words", "the orange one")
        page.keyboard.press("Enter")
        page.click("#pick")
        page.locator("#message").evaluate("one => one.replaceChildren()")
        expect(page.locator("#state")).to_have_text(re.compile("Execute: grasps"))
        for name in PICTURES:
            page.set_viewport_size(_size(name))
            page.evaluate("scrollTo(0, 0)")
            _save(page, name)
        page.click("#stop")
        browser.close()


@contextmanager
def _cell() -> Iterator[str]:
    """A running cell of its own, and where its page is."""
    port = free_port()
    with TemporaryDirectory() as folder:
        own = (f"recording.folder={folder}", f"http.port={port}", f"bus.endpoint=tcp/127.0.0.1:{free_port()}")
        settings = (*_SETTINGS, *own)
        words = [word for setting in settings for word in ("--set", setting)]
        command = [sys.executable, "-m", "cell", "start", "--http", "--config", "config/bin.toml", *words]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            next(line for line in process.stdout if "DOOR_OPEN" in line)
            yield f"http://127.0.0.1:{port}/"
        finally:
            process.terminate()
            process.communicate()


def _size(name: str) -> ViewportSize:
    width, height = PICTURES[name]
    return ViewportSize(width=width, height=height)


def _save(page: Page, name: str) -> None:
    """Save what is in the window, as well as it fits."""
    pixels = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    for quality in range(90, 40, -5):
        jpeg = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        if len(jpeg) <= LARGEST_BYTES:
            break
    (HERE / f"{name}.jpg").write_bytes(jpeg)


if __name__ == "__main__":
    main()

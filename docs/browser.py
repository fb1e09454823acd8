"""The browser of the pictures, the benchmarks and the tests: the Chromium of the system."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # `find_chromium` needs no playwright
    from playwright.sync_api import Browser, Playwright

FLAGS = ("--no-sandbox", "--use-angle=swiftshader")
"""Root may not use the sandbox; WebGL is drawn by the processor."""


def find_chromium() -> str | None:
    """The program: Debian's headless shell (64 MB to load) or the whole browser; None = neither is there."""
    return shutil.which("chromium-headless-shell") or shutil.which("chromium")


def launch_chromium(tool: Playwright) -> Browser:
    """A headless browser; it ends with ``tool``."""
    program = find_chromium()
    assert program is not None, "no browser: apt-get install chromium-headless-shell"
    return tool.chromium.launch(executable_path=program, args=list(FLAGS))

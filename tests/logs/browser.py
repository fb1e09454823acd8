"""A headless Chromium, spoken to in its own protocol: opens a page, waits for its figures, says what went wrong."""

from __future__ import annotations

import base64
import itertools
import json
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

_START_S, _ANSWER_S = 30.0, 30.0
_FLAGS = ("--headless", "--no-sandbox", "--enable-unsafe-swiftshader", "--no-first-run", "--disable-extensions",
          "--disable-background-networking", "--disable-dev-shm-usage", "--remote-debugging-port=0")  # fmt: skip
_READY = """new Promise((done) => {
  const all = [...document.querySelectorAll("[data-figure]")];
  const look = () => all.every((one) => one.querySelector(".plot-container"))
    ? requestAnimationFrame(() => requestAnimationFrame(() => done(true))) : setTimeout(look, 50);
  look();
})"""


class Page:
    """One open page. ``errors``: everything its console, its scripts and its network complained about."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._numbers = socket, itertools.count(1)
        self.errors: list[str] = []
        self._loaded: set[str] = set()
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._ask(f"{domain}.enable")
        self._ask("Page.setLifecycleEventsEnabled", enabled=True)

    def open(self, path: Path, width_px: int, height_px: int = 900) -> None:
        """Show a file in a window of that size, and wait until every figure is drawn."""
        self.errors.clear()
        size = {"width": width_px, "height": height_px, "deviceScaleFactor": 1, "mobile": width_px < 600}
        self._ask("Emulation.setDeviceMetricsOverride", **size)
        loader = self._ask("Page.navigate", url=path.as_uri())["loaderId"]
        while loader not in self._loaded:  # that page, not the one before; it may be there before the answer is
            self._hear()
        self.value(_READY)

    def value(self, expression: str) -> Any:
        """Return what a JavaScript expression gives, or the promise of it."""
        answer = self._ask("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def screenshot(self, path: Path) -> None:
        """The whole page, as long as it is."""
        picture = self._ask("Page.captureScreenshot", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(picture["data"]))

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while (said := self._hear()).get("id") != number:
            pass
        assert "error" not in said, said
        return dict(said["result"])

    def _hear(self) -> dict[str, Any]:
        said: dict[str, Any] = json.loads(self._socket.recv(timeout=_ANSWER_S))
        match said.get("method"), said.get("params", {}):
            case "Page.lifecycleEvent", {"name": "load", "loaderId": loader}:
                self._loaded.add(loader)
            case "Runtime.exceptionThrown", {"exceptionDetails": details}:
                self.errors.append(details.get("exception", {}).get("description") or details["text"])
            case "Runtime.consoleAPICalled", {"type": "error" | "warning" as kind, "args": words}:
                self.errors.append(f"{kind}: {' '.join(str(word.get('value')) for word in words)}")
            case "Log.entryAdded", {"entry": {"level": "error", "text": text}}:
                self.errors.append(text)
            case "Network.requestWillBeSent", {"request": {"url": url}} if url.startswith(("http", "ws", "ftp")):
                self.errors.append(f"fetched {url}")
        return said


@contextmanager
def chromium(program: str, profile: Path) -> Iterator[Page]:
    """A browser of its own with one page, ended on every path."""
    process = subprocess.Popen(  # Debian's program is a shell around the real one: a group ends as a whole
        [program, *_FLAGS, f"--user-data-dir={profile}"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    try:
        assert process.stderr is not None
        address = next(line.split()[-1] for line in process.stderr if "DevTools listening on" in line)
        with connect(address, open_timeout=_START_S, max_size=None) as browser:
            browser.send(json.dumps({"id": 0, "method": "Target.createTarget", "params": {"url": "about:blank"}}))
            target = json.loads(browser.recv(timeout=_ANSWER_S))["result"]["targetId"]
            host = address.split("/devtools/")[0]
            with connect(f"{host}/devtools/page/{target}", max_size=None) as socket:
                yield Page(socket)
            browser.send(json.dumps({"id": 1, "method": "Browser.close"}))
            browser.recv(timeout=_ANSWER_S)
            process.communicate(timeout=_ANSWER_S)
    finally:
        with suppress(ProcessLookupError):  # it has ended by itself
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()

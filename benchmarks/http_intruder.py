"""An intruder's tries at the HTTP door: without a token, from another page, as a viewer, with hostile requests.

A try is accepted when it is answered with anything but a refusal.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import httpx2
import numpy as np

from benchmarks.guarded import OPERATOR_TOKEN, VIEWER_TOKEN
from benchmarks.tally import Tally
from cell.http.guard import MAX_BODY_BYTES
from cell.http.routes import TABLE
from cell.machine.states import ENDING, VERBS

_JSON = "application/json"
_PATIENCE_S = 30.0
_HALF_OPEN = 40
_PROTECTED = tuple((one.method, one.path) for one in TABLE if one.path != "/api/login")
_ESCAPES = (
    "/recordings/../config/sim.toml",
    "/recordings/%2e%2e/%2e%2e/etc/passwd",
    "/recordings/..%2f..%2fetc/passwd",
    "/recordings//etc/passwd",
    "/recordings/%5c..%5c..%5cetc",
    "/reports/../tokens.toml",
    "/recordings/x%00.mcap",
    "/page/../cell/http/app.py",
    "/page/%2e%2e/%2e%2e/pyproject.toml",
    "/recordings/.",
    "/recordings/users",
    "/api/thumbnails/..%2f..%2fetc%2fpasswd",
    "/api/results/../../state/x",
)
_HOSTILE: tuple[Any, ...] = (
    {"target": {"text": ""}}, {"target": {"pixel": [1e999, 0]}}, {"target": {"pixel": ["1", None]}},
    {"target": {"text": "red", "pixel": [1, 2]}}, {"target": {"text": "x" * 5000}}, {"place": {"name": "../left"}},
    {"place": {"position_m": [0.4, 0.4]}}, {"place": {}}, {"job_id": "a" * 500}, {"job_id": {"$gt": ""}},
    {"deadline_s": -1}, {"deadline_s": "NaN"}, {"grasp": {"max_force_n": -5}}, {"grasp": {"max_force_n": 1e9}},
    {"__proto__": {"admin": True}}, {"clear_way": "maybe"}, [], "pick", 7, None,
)  # fmt: skip


class Request(NamedTuple):
    """One request. ``token``: as it is sent; "" = none."""

    method: str
    path: str
    token: str = ""
    body: bytes = b"{}"
    headers: tuple[tuple[str, str], ...] = ()


class HttpIntruder:
    """Tries, and counts what comes back.

    Args:
        url: of the door. ``tally``: counts.
    """

    def __init__(self, url: str, tally: Tally, rng: np.random.Generator) -> None:
        self._tally, self._rng = tally, rng
        self._http = httpx2.Client(base_url=url, timeout=_PATIENCE_S)
        where = urlsplit(url)
        self._address = (where.hostname or "", where.port or 0)
        self.kinds: dict[str, Callable[[], Request]] = {
            "http_no_token": lambda: self._protected(""),
            "http_wrong_token": lambda: self._protected(self._guess()),
            "http_foreign": self._foreign,
            "http_oversized": self._oversized,
            "http_half_open": self._half_open,
            "http_path": lambda: Request("GET", self._one_of(_ESCAPES), VIEWER_TOKEN),
            "http_viewer": self._as_viewer,
            "http_job": self._hostile_job,
        }

    def attempt(self, kind: str) -> None:
        """One try of a kind."""
        request = self.kinds[kind]()
        try:
            status, code = self._send(request)
        except httpx2.HTTPError as error:
            self._tally.crash(f"{kind} {request.method} {request.path}: {error!r}")
            return
        self._tally.by_code[f"HTTP {status} {code}".strip()] += 1
        is_look = kind == "http_half_open"  # an honest question beside what is left open
        if status >= 500 or (is_look and status != 200):
            self._tally.crash(f"{kind} {request.method} {request.path}: {status} {code}")
        elif status < 400 and not is_look:
            self._tally.accept(kind, f"{request.method} {request.path} {status}")

    def close(self) -> None:
        """End the connections."""
        self._http.close()

    def _send(self, request: Request) -> tuple[int, str]:
        """Status, and the code of the refusal; the path goes out as it is written, not made tidy."""
        headers = {"Content-Type": _JSON} if request.method == "POST" else {}
        headers |= {"Authorization": f"Bearer {request.token}"} if request.token else {}
        headers |= dict(request.headers)
        base = self._http.base_url
        raw = httpx2.URL(scheme=base.scheme, host=base.host, port=base.port, raw_path=request.path.encode())
        with self._http.stream(request.method, raw, content=request.body or None, headers=headers) as answer:
            if answer.status_code < 400:  # its content counts for nothing, and may have no end
                return answer.status_code, ""
            try:
                return answer.status_code, str(json.loads(answer.read()).get("code", ""))
            except (ValueError, AttributeError):
                return answer.status_code, ""

    # --- the kinds ----------------------------------------------------------------------------------------------------

    def _protected(self, token: str) -> Request:
        method, path = _PROTECTED[int(self._rng.integers(len(_PROTECTED)))]
        return Request(method, path.format(verb=self._one_of(VERBS), cycle_id="20260101T000000-0"), token)

    def _guess(self) -> str:
        """A token that is nearly one, or none at all."""
        near = (OPERATOR_TOKEN[:-1], OPERATOR_TOKEN + "x", OPERATOR_TOKEN.upper(), VIEWER_TOKEN[1:], "operator", "null")
        return self._one_of(near) if self._rng.random() < 0.5 else self._rng.bytes(12).hex()

    def _foreign(self) -> Request:
        """From a page of another server, or under a name that is not ours, with an operator's token."""
        foreign = self._one_of(
            ("http://evil.example", "null", f"http://127.0.0.1:{self._address[1] + 1}", "https://cell")
        )
        header = (
            ("Origin", foreign) if self._rng.random() < 0.5 else ("Host", urlsplit(foreign).netloc or "evil.example")
        )
        is_port = header == ("Host", urlsplit(foreign).netloc) and "127.0.0.1" in foreign
        header = ("Host", "127.0.0.1.evil.example") if is_port else header
        return Request("POST", f"/api/commands/{self._one_of(VERBS)}", OPERATOR_TOKEN, headers=(header,))

    def _oversized(self) -> Request:
        size = MAX_BODY_BYTES + 1 + int(self._rng.integers(4 * MAX_BODY_BYTES))
        return Request("POST", f"/api/commands/{self._one_of(VERBS)}", OPERATOR_TOKEN, b" " * size)

    def _half_open(self) -> Request:
        """Connections that begin a request and do not end it; then an honest look."""
        plugs = [socket.create_connection(self._address, _PATIENCE_S) for _ in range(_HALF_OPEN)]
        for plug in plugs:
            plug.sendall(b"POST /api/commands/reset HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 50\r\n")
        status, code = self._send(Request("GET", "/api/state", VIEWER_TOKEN, b""))
        for plug in plugs:
            plug.close()
        if status != 200:
            self._tally.crash(f"http_half_open: {status} {code} while {_HALF_OPEN} connections are half open")
        return Request("GET", "/api/state", VIEWER_TOKEN, b"")

    def _as_viewer(self) -> Request:
        """Return a request that a viewer may not make: command motion, pick, write down a verdict."""
        verb = self._one_of([verb for verb in VERBS if verb not in ENDING])
        path = self._one_of(
            (f"/api/commands/{verb}", f"/api/commands/{verb}", "/api/picks", "/api/labels/20260101T000000-0")
        )
        body = {"who": "eve", "label": "good"} if "labels" in path else {}
        return Request("POST", path, VIEWER_TOKEN, json.dumps(body).encode())

    def _hostile_job(self) -> Request:
        job = _HOSTILE[int(self._rng.integers(len(_HOSTILE)))]
        if self._rng.random() < 0.5:
            return Request("POST", "/api/picks", OPERATOR_TOKEN, json.dumps(job).encode())
        return Request("POST", "/api/commands/pick", OPERATOR_TOKEN, json.dumps({"job": job}).encode())

    def _one_of(self, some: Any) -> Any:
        return some[int(self._rng.integers(len(some)))]

"""Whatever is asked over HTTP: the answer is JSON that says why, and never that this program is broken."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from bus.errors import NoReply
from cell.http.routes import TABLE
from cell.machine.states import VERBS
from tests.cell.http_bench import RESULT, Asked, FakeCell, door_of, refused

METHODS = ("GET", "POST", "HEAD", "PUT", "DELETE", "OPTIONS", "PATCH", "TRACE", "\u00e4")
SERVED = (
    *((one.method, one.path) for one in TABLE), *(("POST", f"/api/commands/{verb}") for verb in VERBS),
    ("GET", "/recordings/c1.mcap"), ("GET", "/reports/c1.html"),
)  # fmt: skip
PATHS = (
    *(path for _, path in SERVED), "/", "/api", "/api/openapi.json", "/recordings/../../etc/passwd",
    "/recordings/\x00.mcap", "//", "*", "",
)  # fmt: skip
WORDS = (
    "job", "job_id", "target", "text", "pixel", "box", "point_m", "place", "name", "position_m", "yaw_rad",
    "deadline_s", "grasp", "max_force_n", "from_above", "clear_way", "queue", "cycles", "until_empty", "object",
    "client_id", "command_id", "token", "\ud800", "__class__", "", "$ref",
)  # fmt: skip
VALUES: tuple[object, ...] = (
    None,
    True,
    0,
    -1,
    1e308,
    -1e308,
    2**70,
    "",
    "\x00",
    "cell",
    "\ud800",
    "a" * 300,
    [],
    {},
    [1, 2],
    [0, 0, 0, 0],
)
HEADERS = {
    "host": ("127.0.0.1", "localhost:99999999", "evil", "[::1]", "[", "\u00e4"),
    "content-type": ("application/json", "application/json; charset=utf-16", "text/plain", "\x00"),
    "content-length": ("0", "-1", "9" * 30, "2", "x"),
    "origin": ("http://127.0.0.1", "null", "http://[", "\u00e4"),
    "cookie": ("vlad_cell_token=a", "=;=;", '"\\', "a" * 5000),
    "authorization": ("Bearer x", "Basic", "Bearer \u00e4", ""),
    "x-cell-session": ("x", "\u00e4", "a" * 5000),
    "range": ("bytes=0-1", "bytes=1-,0-0", "bytes=-", "bytes=9-1", "bytes=" + "0-1," * 200, "bytes=\u0661-2", "\u00e4"),
    "if-none-match": ('"x"', "*", "\u00e4"),
    "if-modified-since": ("yesterday", "Sun, 99 Foo 2026 99:99:99 GMT"),
    "if-range": ("x", 'W/"x"'),
    "transfer-encoding": ("chunked", "gzip"),
}
QUERIES = (
    "",
    "client=ann",
    "client=%00",
    "client=" + "a" * 500,
    "limit=5",
    "limit=-1",
    "limit=1e9",
    "limit=\u0661",
    "&&=",
)


@pytest.fixture
def cell() -> FakeCell:
    return FakeCell(results={"c1": RESULT})


@pytest.fixture
def asking(cell: FakeCell, tmp_path: Path) -> Iterator[tuple[Asked, str]]:
    """Asks a door, and the token of a session of it."""
    (tmp_path / "c1.mcap").write_bytes(b"no recording")
    (tmp_path / "c1.html").write_text("<p>")
    door = door_of(cell, tmp_path)
    session = door.sessions.open("http-test")
    with closing(Asked(door)) as ask:
        yield ask, session.token
    session.commander.end()
    door.wait()
    assert cell.connected == []


def _tree(rng: random.Random, depth: int = 0) -> object:
    kind = rng.random()
    if depth > 3 or kind < 0.4:
        return rng.choice(VALUES)
    if kind < 0.5:
        return [_tree(rng, depth + 1) for _ in range(rng.randrange(5))]
    return {rng.choice(WORDS): _tree(rng, depth + 1) for _ in range(rng.randrange(4))}


def _body(rng: random.Random) -> bytes:
    kind = rng.random()
    if kind < 0.1:
        return rng.choice([b"", b"\xff\xfe", b"[" * 50_000, b'{"a":' * 20_000, b"1" * 9_000, b"NaN", b"x" * 70_000])
    text = json.dumps(_tree(rng)).encode(errors="replace")
    return text if kind < 0.9 else bytes(rng.choice((byte, rng.randrange(256))) for byte in text)


def _ask_at_random(rng: random.Random, ask: Asked, cell: FakeCell, session: str) -> None:
    cell.refusal = rng.choice((None, None, None, refused(), NoReply("Nobody answers.")))
    method, path = rng.choice(SERVED) if rng.random() < 0.8 else (rng.choice(METHODS), rng.choice(PATHS))
    path = path.replace("{verb}", rng.choice(VERBS)).replace("{cycle_id}", rng.choice(("c1", "x", "y" * 200, "\x00")))
    if rng.random() < 0.1:
        path = "".join(rng.choice((one, chr(rng.randrange(1, 0x250)))) for one in path)
    names = rng.sample(sorted(HEADERS), rng.choice((0, 0, 0, 1, 1, 2, 3)))
    headers = {"x-cell-session": session} | {name: rng.choice(HEADERS[name]) for name in names}
    answer = ask(method, path, _body(rng), headers, rng.choice(QUERIES))
    assert answer.status < 500 or answer.status in (503, 504), (method, path, headers)
    if answer.status >= 400 and answer.status != 416 and method != "HEAD" and "json" in answer.headers["content-type"]:
        assert json.loads(answer.body)["ok"] is False


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in range(1, 20))])
def test_no_request_breaks_it(seed: int, asking: tuple[Asked, str], cell: FakeCell) -> None:
    """500 requests of a seed; all seeds together are 10 000."""
    rng, (ask, session) = random.Random(seed), asking
    for _ in range(500):
        _ask_at_random(rng, ask, cell, session)

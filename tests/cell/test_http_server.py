"""The served HTTP interface under what networks and strangers do to it, and its streams and leases to their end."""

from __future__ import annotations

import json
import os
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx2
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations

from bus import topics
from bus.codec import encode
from bus.commands import Event
from bus.errors import ConfigError, PortOccupied
from bus.messages import Attempt, Job, LivePicture, Place, Target
from bus.sample import Sample
from bus.topics import encoding_of
from cell.cli.network.tls_keys import make_keys
from cell.client import Client
from cell.http import guard, hub, patience
from cell.http.access import VARIABLES, Access
from cell.http.server import _listening
from config.http import HttpSettings
from tests.cell.http_bench import IDLE, RESULT, FakeCell, Site, door_of, served

JSON = {"Content-Type": "application/json"}
HEAD = b"Host: 127.0.0.1\r\nContent-Type: application/json\r\n"
SOON_S = 20.0


def until(is_so: Callable[[], object], within_s: float = SOON_S) -> None:
    give_up_s = time.monotonic() + within_s
    while not is_so():
        assert time.monotonic() < give_up_s
        time.sleep(0.01)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings with a page, and a secret beside the folder that a link leads to."""
    above = tmp_path_factory.mktemp("above")
    recordings = above / "recordings"
    (recordings / "2026-11-29").mkdir(parents=True)
    (recordings / "2026-11-29" / "c1.mcap").write_bytes(bytes(range(100)))
    (recordings / "2026-11-29" / "c1.html").write_text("<p>why</p>")
    (recordings / "2026-11-29" / "drawn.html").write_text('<p>why</p><script src="plotly-1.min.js"></script>')
    (recordings / "2026-11-29" / "alone.html").write_text('<script src="plotly-0.min.js"></script>')
    (recordings / "2026-11-29" / "plotly-1.min.js").write_text("draw()")
    (recordings / "2026-11-29" / "c2.mcap.part").write_bytes(b"torn")
    (above / "secret.mcap").write_text("hidden words")
    (recordings / "link.mcap").symlink_to(above / "secret.mcap")
    return recordings


@pytest.fixture(scope="module")
def shared_site(folder: Path) -> Iterator[Site]:
    """For tests that open no stream."""
    cell = FakeCell()
    with served(door_of(cell, folder), cell) as site:
        yield site


@pytest.fixture
def site(folder: Path) -> Iterator[Site]:
    cell = FakeCell()
    with served(door_of(cell, folder, settings=HttpSettings(most_streams=4)), cell) as site:
        yield site


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time-outs of a fraction of a second."""
    monkeypatch.setattr(patience, "HEAD_S", 0.3)
    monkeypatch.setattr(guard, "BODY_S", 0.3)


# --- files ------------------------------------------------------------------------------------------------------------


def test_a_recording_is_downloaded_whole_or_in_part_and_not_twice(shared_site: Site) -> None:
    path = "/recordings/2026-11-29/c1.mcap"
    whole = shared_site.http.get(path)
    assert (whole.status_code, whole.content) == (200, bytes(range(100)))
    assert whole.headers["content-disposition"] == 'attachment; filename="c1.mcap"'
    for given, status, content in (
        ("bytes=10-19", 206, bytes(range(10, 20))),
        ("bytes=-5", 206, bytes(range(95, 100))),
        ("bytes=90-", 206, bytes(range(90, 100))),
        ("bytes=200-", 416, None),
        ("metres=1-2", 400, None),
    ):
        part = shared_site.http.get(path, headers={"Range": given})
        assert part.status_code == status
        assert content is None or part.content == content
    assert shared_site.http.get(path, headers={"If-None-Match": whole.headers["etag"]}).status_code == 304


def test_a_report_is_a_page_of_its_own_that_reaches_nothing_here(shared_site: Site) -> None:
    page = shared_site.http.get("/reports/2026-11-29/c1.html")
    assert (page.status_code, page.text) == (200, "<p>why</p>")
    policy = page.headers["content-security-policy"]
    assert "sandbox allow-scripts" in policy and "allow-same-origin" not in policy and "default-src 'none'" in policy


def test_a_report_has_its_drawing_library_inside_because_it_may_fetch_nothing(shared_site: Site) -> None:
    page = shared_site.http.get("/reports/2026-11-29/drawn.html")
    assert page.text == "<p>why</p><script>draw()</script>" and page.headers["content-encoding"] == "gzip"
    plain = shared_site.http.get("/reports/2026-11-29/drawn.html", headers={"Accept-Encoding": "identity"})
    assert plain.text == page.text and "content-encoding" not in plain.headers
    assert "sandbox allow-scripts" in page.headers["content-security-policy"]
    assert shared_site.http.get("/reports/2026-11-29/alone.html").text == '<script src="plotly-0.min.js"></script>'
    assert shared_site.http.get("/reports/2026-11-29/plotly-1.min.js").status_code == 404


@pytest.mark.parametrize(
    "path",
    [
        "/recordings/../secret.mcap",
        "/recordings/%2e%2e/secret.mcap",
        "/recordings/..%2fsecret.mcap",
        "/recordings/..%5csecret.mcap",
        "/recordings//etc/passwd.mcap",
        "/recordings/%00.mcap",
        "/recordings/link.mcap",
        "/recordings/" + "a" * 5000 + ".mcap",
        "/recordings/2026-11-29/c2.mcap.part",
        "/recordings/2026-11-29/c1.html",
        "/reports/2026-11-29/c1.mcap",
        "/recordings/2026-11-29",
        "/recordings/",
        "/reports",
    ],
)
def test_nothing_else_is_served(shared_site: Site, path: str) -> None:
    answer = shared_site.raw(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
    assert b" 404 " in answer.split(b"\r\n")[0]
    assert b"hidden" not in answer.partition(b"\r\n\r\n")[2]


# --- what strangers send ----------------------------------------------------------------------------------------------


def test_a_large_body_is_refused_before_it_is_read(shared_site: Site) -> None:
    assert b" 413 " in shared_site.raw(b"POST /api/picks HTTP/1.1\r\n" + HEAD + b"Content-Length: 200000000\r\n\r\n")


def test_a_large_body_without_a_length_is_refused_when_it_is_too_large(shared_site: Site) -> None:
    chunk = b"8000\r\n" + b" " * 0x8000 + b"\r\n"
    request = b"POST /api/picks HTTP/1.1\r\n" + HEAD + b"Transfer-Encoding: chunked\r\n\r\n" + 4 * chunk
    assert b" 413 " in shared_site.raw(request)


@pytest.mark.parametrize("request_", [b"\x00\xff" * 500, b"GET / HTTP/9\r\n\r\n", b"GET /" + b"a" * 100_000])
def test_what_is_no_request_is_refused(shared_site: Site, request_: bytes) -> None:
    assert shared_site.raw(request_)[:12] in (b"HTTP/1.1 400", b"")
    assert shared_site.http.get("/api/state").status_code == 200


@pytest.mark.usefixtures("impatient")
def test_who_does_not_finish_a_request_is_not_waited_for(shared_site: Site) -> None:
    begun = b"POST /api/picks HTTP/1.1\r\n" + HEAD
    assert b" 408 " in shared_site.raw(begun + b"Content-Length: 10\r\n\r\n{"), "a body that does not end"
    assert shared_site.raw(begun) == b"", "a head that does not end"
    assert shared_site.raw(b"") == b"", "a connection without a word"


@pytest.mark.usefixtures("impatient")
def test_a_head_that_comes_in_drops_is_not_waited_for_either(shared_site: Site) -> None:
    with socket.create_connection(("127.0.0.1", shared_site.port), timeout=SOON_S) as plug:
        began_s = time.monotonic()
        with pytest.raises(OSError):
            while time.monotonic() < began_s + SOON_S:
                plug.sendall(b"X")
                time.sleep(0.02)
    assert time.monotonic() - began_s < 5.0


def test_half_open_connections_keep_nobody_out(shared_site: Site) -> None:
    with ExitStack() as stack:
        for _ in range(200):
            plug = stack.enter_context(socket.create_connection(("127.0.0.1", shared_site.port)))
            plug.sendall(b"GET /api/state HTTP/1.1\r\nHost: 127")
        assert shared_site.http.get("/api/state", timeout=SOON_S).status_code == 200


# --- streams ----------------------------------------------------------------------------------------------------------


class Events:
    """One open event stream."""

    def __init__(self, site: Site, stack: ExitStack, name: str = "") -> None:
        query = {"client": name} if name else {}
        self.answer = stack.enter_context(site.http.stream("GET", "/api/events", params=query))
        assert self.answer.status_code == 200
        self._lines = self.answer.iter_lines()

    def next(self, *names: str) -> tuple[str, dict[str, object]]:
        """The next event of one of these names."""
        for line in self._lines:
            if line.startswith("event: ") and line[7:] in names:
                return line[7:], json.loads(next(self._lines).removeprefix("data: "))
        return "", {}

    def ends(self) -> bool:
        return list(self._lines) is not None


def test_a_stream_says_what_counts_now_then_what_the_cell_says(site: Site) -> None:
    with ExitStack() as stack:
        events = Events(site, stack)
        assert events.next("state")[1]["state"] == "Idle"
        said = (
            (topics.STATE, IDLE.model_copy(update={"state": "Execute"})),
            (topics.EVENT, Event(code="NODE_BACK", severity="info", text="It is\nback.")),
            (topics.RESULT, RESULT),
        )
        for topic, message in said:
            site.cell.said.put(Sample(topic.key, encoding_of(topic.says), encode(message)))
        assert events.next("state")[1]["state"] == "Execute"
        assert events.next("event")[1]["text"] == "It is\nback."
        assert events.next("result")[1]["cycle_id"] == "c1"
        assert events.next("ping") == ("ping", {})


def test_what_cannot_be_read_is_not_passed_on(site: Site) -> None:
    with ExitStack() as stack:
        events = Events(site, stack)
        for key in (topics.STATE.key, topics.VIEW_COLOR.key, topics.VIEW_ANNOTATIONS.key, topics.EVENT.key):
            site.cell.said.put(Sample(key, "", b"\xff\x00 nonsense"))
        site.cell.said.put(Sample(topics.RESULT.key, "", encode(RESULT)))
        assert events.next("event", "picture", "scene", "result")[0] == "result"


def test_a_picture_is_told_of_and_read_once(site: Site) -> None:
    image = CompressedImage(data=b"\xff\xd8 a picture", format="jpeg")
    image.timestamp.FromNanoseconds(5)
    drawn = ImageAnnotations()
    drawn.points.add().points.add(x=1.25, y=2.0)
    drawn.texts.add(text="1").position.x = 3.0
    with ExitStack() as stack:
        events = Events(site, stack)
        for topic, message in ((topics.VIEW_COLOR, image), (topics.VIEW_ANNOTATIONS, drawn)):
            site.cell.said.put(Sample(topic.key, "", message.SerializeToString()))
        assert events.next("picture") == ("picture", {"stamp_ns": 5, "stamp": "5"})
        assert events.next("scene")[0] == "scene"
    picture = site.http.get("/api/picture")
    assert (picture.content, picture.headers["content-type"]) == (b"\xff\xd8 a picture", "image/jpeg")
    assert site.http.get("/api/picture", headers={"If-None-Match": picture.headers["etag"]}).status_code == 304
    assert site.http.get("/api/picture", params={"at": "5"}).content == picture.content
    missing, bad = (site.http.get("/api/picture", params={"at": at}) for at in ("6", "now"))
    assert (missing.status_code, missing.json()["code"], bad.status_code) == (404, "NO_PICTURE", 422)
    scene = site.http.get("/api/scene").json()
    assert scene["outlines"][0]["points_px"] == [[1.2, 2.0]]
    assert scene["numbers"] == [{"text": "1", "at_px": [3.0, 0.0]}]


def test_while_somebody_listens_to_a_cell_at_rest_it_shows_pictures_of_now(site: Site) -> None:
    stamp_ns = 2**60 + 1  # more digits than a browser's numbers have
    live = LivePicture(
        stamp_ns=stamp_ns, data=b"\xff\xd8 now", media_type="image/jpeg", from_capture_pose=True, things_ns=5, gone=(2,)
    )
    with ExitStack() as stack:
        events = Events(site, stack)
        site.cell.live = live
        site.cell.said.put(Sample(topics.STATE.key, "", encode(IDLE)))
        said = {"is_live": True, "from_capture_pose": True, "things": "5", "gone": [2]}
        assert events.next("picture")[1] == {"stamp_ns": stamp_ns, "stamp": str(stamp_ns)} | said
    assert site.http.get("/api/picture", params={"at": stamp_ns}).content == b"\xff\xd8 now"


def test_what_a_job_is_about_is_told_with_the_state_that_names_it(site: Site) -> None:
    job = Job(job_id="j1", target=Target(text="the red one"), place=Place(name="left"))
    with ExitStack() as stack:
        events = Events(site, stack)
        site.cell.said.put(Sample(topics.ATTEMPT.key, "", encode(Attempt(cycle_id="c1", job=job))))
        working = IDLE.model_copy(update={"state": "Execute", "job_id": "j1", "queue": ("of others",)})
        site.cell.said.put(Sample(topics.STATE.key, "", encode(working)))
        about = {"target": job.target, "place": job.place}
        known = {"j1": {name: part and part.model_dump(mode="json") for name, part in about.items()}}
        assert events.next("jobs")[1] == known


def test_open_streams_end_at_once_with_the_interface(folder: Path) -> None:
    cell = FakeCell()
    with ExitStack() as stack:
        with served(door_of(cell, folder), cell) as site:
            http = stack.enter_context(httpx2.Client(base_url=site.http.base_url, timeout=30))
            streams = [Events(site._replace(http=http), stack, f"c{number}") for number in range(5)]
            waiting = stack.enter_context(http.stream("POST", "/api/picks", headers=JSON, content=b"{}"))
            began_s = time.monotonic()
        assert time.monotonic() - began_s < 2.0  # 0.3 s on an idle machine; cancelled after 2 s if they did not end
        assert all(stream.ends() for stream in streams)
        assert json.loads(waiting.read())["code"] == "CLOSED"
    assert cell.connected == []


def test_more_streams_than_allowed_are_refused(site: Site) -> None:
    with ExitStack() as stack:
        for _ in range(4):
            Events(site, stack)
        refused = site.http.get("/api/events")
        assert (refused.status_code, refused.json()["code"]) == (503, "TOO_MANY")
    until(lambda: not site.door.hub._open)


def test_who_takes_nothing_of_a_stream_is_left_behind(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hub, "KEPT", 8)
    with ExitStack() as stack:
        slow = stack.enter_context(socket.create_connection(("127.0.0.1", site.port)))
        slow.sendall(b"GET /api/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        events = Events(site, stack)
        text = encode(Event(code="LONG", severity="info", text="x" * 200_000))
        until(lambda: len(site.door.hub._open) == 2)
        for number in range(100):
            site.cell.said.put(Sample(topics.EVENT.key, "", text))
            assert events.next("event")[0] == "event", number


def test_who_takes_nothing_for_a_while_is_not_waited_for(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "STALL_S", 0.2)
    with socket.create_connection(("127.0.0.1", site.port)) as slow:
        slow.sendall(b"GET /api/events?client=slow HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        until(lambda: site.door.hub._open)
        text = encode(Event(code="LONG", severity="info", text="x" * 200_000))
        for _ in range(100):
            site.cell.said.put(Sample(topics.EVENT.key, "", text))
        until(lambda: not site.door.hub._open)


# --- sessions ---------------------------------------------------------------------------------------------------------


def _session(events: Events) -> dict[str, str]:
    return {**JSON, "X-Cell-Session": str(events.next("session")[1]["session"])}


def test_a_motion_that_a_stop_overtakes_is_not_sent_any_more(folder: Path) -> None:
    """A connection for the first motion of a session takes a while to open."""
    cell, may_connect, begun = FakeCell(), threading.Event(), threading.Event()
    door = door_of(cell, folder)
    connect = door._connect

    @contextmanager
    def late(client_id: str) -> Iterator[Client]:
        begun.set()
        may_connect.wait(60)
        with connect(client_id) as client:
            yield client

    door.sessions._connect = late
    with served(door, cell) as site, ExitStack() as stack, ThreadPoolExecutor() as pool:
        events = Events(site, stack, "page")
        session = _session(events)
        jog = pool.submit(site.http.post, "/api/commands/jog", headers=session, content=b"{}")
        assert begun.wait(60)
        assert site.http.post("/api/commands/stop", headers=session, content=b"{}").status_code == 200
        may_connect.set()
        assert (jog.result().status_code, jog.result().json()["code"]) == (409, "WRONG_STATE")
        assert [verb for verb, _ in cell.sent] == ["stop"]
        assert site.http.post("/api/commands/jog", headers=session, content=b"{}").status_code == 200


def test_the_lease_ends_with_the_stream(site: Site) -> None:
    site.cell.now = IDLE.model_copy(update={"state": "Execute", "since_ns": 5})  # at rest it would end by itself
    with ExitStack() as stack:
        events = Events(site, stack, "ann")
        session = _session(events)
        assert site.http.post("/api/commands/pick", headers=session, content=b"{}").status_code == 200
        assert len(site.cell.connected) == 1 and site.cell.connected[0].startswith("http-ann-")
    until(lambda: site.cell.connected == [])
    gone = site.http.post("/api/commands/pick", headers=session, content=b"{}")
    assert (gone.status_code, gone.json()["code"]) == (409, "NO_LEASE")


def test_the_lease_of_a_cut_connection_ends_too(site: Site) -> None:
    plug = socket.create_connection(("127.0.0.1", site.port))
    plug.sendall(b"POST /api/picks?client=curl HTTP/1.1\r\n" + HEAD + b"Content-Length: 2\r\n\r\n{}")
    until(lambda: site.cell.connected)
    plug.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")  # a reset, as of a killed process
    plug.close()
    until(lambda: site.cell.connected == [])


def test_a_silent_session_loses_its_lease_and_one_that_says_that_it_runs_does_not(folder: Path) -> None:
    now_s = [0.0]
    cell = FakeCell(now=IDLE.model_copy(update={"state": "Execute"}))
    door = door_of(cell, folder, settings=HttpSettings(silence_s=3.0), now_s=lambda: now_s[0])
    with served(door, cell) as site, ExitStack() as stack:
        events = Events(site, stack, "page")
        session = _session(events)
        site.http.post("/api/commands/start", headers=session, content=b"{}")
        for _ in range(3):
            now_s[0] += 2.0
            assert site.http.post("/api/heartbeat", headers=session).status_code == 204
        assert len(cell.connected) == 1
        now_s[0] += 3.5
        assert events.next("event")[1]["code"] == "LEASE_LOST"
        until(lambda: cell.connected == [])


def test_the_lease_is_given_back_when_the_motion_is_over(site: Site) -> None:
    site.cell.now = IDLE.model_copy(update={"state": "Execute", "since_ns": 5})
    with ExitStack() as stack:
        events = Events(site, stack, "page")
        session = _session(events)
        site.http.post("/api/commands/pick", headers=session, content=b"{}")
        assert len(site.cell.connected) == 1
        site.cell.now = IDLE.model_copy(update={"state": "Complete", "since_ns": 6})
        site.cell.said.put(Sample(topics.STATE.key, "", encode(site.cell.now)))
        until(lambda: site.cell.connected == [])


def test_a_pick_is_answered_with_the_result_of_its_last_attempt(site: Site) -> None:
    site.cell.now = IDLE.model_copy(update={"state": "Execute", "job_id": "c1"})
    with site.http.stream("POST", "/api/picks", headers=JSON, content=b'{"job_id": "c1"}') as answer:
        site.cell.results["c2"] = RESULT.model_copy(update={"cycle_id": "c2"})
        site.cell.results["c1"] = RESULT.model_copy(update={"result": "FAILED", "retried_as": "c2"})
        site.cell.said.put(Sample(topics.RESULT.key, "", encode(RESULT)))
        assert json.loads(answer.read())["cycle_id"] == "c2"
    until(lambda: site.cell.connected == [])


def test_a_command_that_is_waited_for_is_answered_when_nothing_moves_any_more(site: Site) -> None:
    site.cell.now = IDLE.model_copy(update={"state": "Resetting"})
    with site.http.stream("POST", "/api/commands/reset?wait=true&client=curl", headers=JSON, content=b"{}") as answer:
        assert site.cell.connected[0].startswith("http-curl-")
        site.cell.now = IDLE
        site.cell.said.put(Sample(topics.STATE.key, "", encode(IDLE)))
        assert json.loads(answer.read())["state"] == "Idle"
    until(lambda: site.cell.connected == [])


def test_whoever_reads_the_answer_may_command_at_once(folder: Path) -> None:
    """The lease of the request that is answered is given back before."""
    cell = FakeCell()
    door = door_of(cell, folder)
    connect = door._connect

    @contextmanager
    def slow(client_id: str) -> Iterator[Client]:
        with connect(client_id) as client:
            yield client
            time.sleep(0.2)  # as long as a session of Zenoh may take to close

    door._connect = slow
    with served(door, cell) as site:
        for path in ("/api/commands/reset?wait=true", "/api/picks"):
            site.http.post(path, headers=JSON, content=b"{}")
            assert cell.connected == [], path


def test_a_dropped_job_is_answered_too(site: Site) -> None:
    site.cell.now = IDLE.model_copy(update={"state": "Stopped"})
    answer = site.http.post("/api/picks", headers=JSON, content=b"{}")
    assert (answer.status_code, answer.json()["code"]) == (200, "JOB_DROPPED")


# --- beyond loopback --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    make_keys(folder, [])
    return folder


def test_beyond_loopback_it_needs_tls_and_a_token(keys: Path) -> None:
    with pytest.raises(ValueError, match="needs TLS"):
        HttpSettings(host="0.0.0.0")
    settings = HttpSettings(host="0.0.0.0", certificate=keys / "cell.pem", key=keys / "cell.key")
    with pytest.raises(ConfigError, match="no operator's token"):
        Access.of(settings, {})
    assert Access.of(settings, {VARIABLES["operator"]: "0123456789abcdef"}).role_of("0123456789abcdef") == "operator"


@pytest.mark.parametrize(
    ("text", "mode", "why"),
    [
        ('operator = "short"', 0o600, "fewer than 16"),
        ('operator = "0123456789abcdef"', 0o604, "Everybody"),
        ('viewer = "0123456789abcdef"', 0o600, "none of an operator"),
        ('operator = "0123456789abcdef"\nviewer = "0123456789abcdef"', 0o600, "the same token"),
        ('root = "0123456789abcdef"', 0o600, "holds other things"),
        ("operator = 5", 0o600, "holds other things"),
        ("operator", 0o600, "not valid TOML"),
    ],
)
def test_bad_tokens_are_refused_and_never_shown(tmp_path: Path, text: str, mode: int, why: str) -> None:
    file = tmp_path / "tokens.toml"
    file.write_text(text)
    file.chmod(mode)
    with pytest.raises(ConfigError, match=why) as refused:
        Access.of(HttpSettings(tokens=file), {})
    assert "0123456789abcdef" not in str(refused.value)


def test_with_a_certificate_it_speaks_tls_only(folder: Path, keys: Path) -> None:
    settings = HttpSettings(certificate=keys / "cell.pem", key=keys / "cell.key")
    cell = FakeCell()
    with served(door_of(cell, folder, settings=settings), cell) as site:
        trusted = ssl.create_default_context(cafile=keys / "ca.pem")
        trusted.verify_flags |= ssl.VERIFY_X509_STRICT  # the default from Python 3.13 on
        assert httpx2.get(f"https://127.0.0.1:{site.port}/api/state", verify=trusted).json()["state"] == "Idle"
        with pytest.raises(httpx2.HTTPError):
            site.http.get("/api/state")


def test_a_port_in_use_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(PortOccupied, match="Another program"):
        _listening(HttpSettings(port=taken.getsockname()[1]))


def test_a_certificate_that_is_none_is_refused(tmp_path: Path) -> None:
    for name in ("a.pem", "a.key"):
        (tmp_path / name).write_text("nothing")
        os.chmod(tmp_path / name, 0o600)
    with pytest.raises(ConfigError, match="cannot be used"):
        Access.of(HttpSettings(certificate=tmp_path / "a.pem", key=tmp_path / "a.key"), {})

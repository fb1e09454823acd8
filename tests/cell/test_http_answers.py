"""What the HTTP interface answers to each request, and how it refuses: asked without a server, of a cell that obeys."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from bus.errors import BusError, NoReply, ReplyTimeout
from cell.http.access import VARIABLES, Access
from cell.http.routes import TABLE
from cell.machine.leases import NEEDS_LEASE, NEEDS_TOKEN
from cell.machine.states import ENDING, VERBS
from config.http import HttpSettings
from tests.cell.http_bench import RESULT, Answer, Asked, FakeCell, door_of, refused

OPERATOR, VIEWER = "operator-token-0123456789", "viewer-token-0123456789"


class Desk:
    """One interface, and the cell behind it."""

    def __init__(self, folder: Path, access: Access) -> None:
        self.cell = FakeCell()
        self.door = door_of(self.cell, folder, access)
        self.ask = Asked(self.door)

    def post(self, path: str, body: Any = None, **headers: str) -> Answer:
        given = {name.replace("_", "-"): value for name, value in headers.items()}
        return self.ask("POST", path, json.dumps({} if body is None else body).encode(), given)


def _desk(folder: Path, access: Access) -> Iterator[Desk]:
    desk = Desk(folder, access)
    with closing(desk.ask):
        yield desk
    desk.door.wait()


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    yield from _desk(tmp_path, Access({}))


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[Desk]:
    """With a token for each role."""
    environ = {VARIABLES["operator"]: OPERATOR, VARIABLES["viewer"]: VIEWER}
    yield from _desk(tmp_path, Access.of(HttpSettings(), environ))


def said(answer: Answer) -> Any:
    return json.loads(answer.body)


# --- what is read -----------------------------------------------------------------------------------------------------


def test_state_health_and_results_are_the_cells_own_messages(desk: Desk) -> None:
    desk.cell.results["c1"] = RESULT
    assert said(desk.ask("GET", "/api/state"))["state"] == "Idle"
    about = said(desk.ask("GET", "/api/cell"))
    assert about["is_simulated"] and about["is_never_empty"]  # no sim.clutter: a new object with every pick
    assert said(desk.ask("GET", "/api/health")) == {"is_healthy": True, "nodes": {}, "defects": [], "doors": {}}
    assert said(desk.ask("GET", "/api/results/c1")) == json.loads(RESULT.model_dump_json())
    missing = desk.ask("GET", "/api/results/c2")
    assert (missing.status, said(missing)["code"]) == (404, "NO_RESULT")


def test_without_recordings_the_list_is_empty(desk: Desk) -> None:
    assert said(desk.ask("GET", "/api/cycles")) == []
    bad = desk.ask("GET", "/api/cycles", query="limit=none")
    assert (bad.status, "limit" in said(bad)["reason"]) == (422, True)


def test_before_the_first_picture_there_is_none(desk: Desk) -> None:
    for path in ("/api/picture", "/api/scene"):
        assert said(desk.ask("GET", path))["code"] == "NO_PICTURE"


def test_the_openapi_document_has_every_path_and_every_schema_it_names(desk: Desk) -> None:
    document = said(desk.ask("GET", "/api/openapi.json"))
    assert set(document["paths"]) == {one.path for one in TABLE}
    named = {part.split('"')[0] for part in json.dumps(document).split("#/components/schemas/")[1:]}
    assert named <= set(document["components"]["schemas"])
    assert {"CommandRequest", "Job", "CycleResult", "ErrorReply"} <= named


def test_the_page_that_lists_it_loads_and_runs_nothing(desk: Desk) -> None:
    page = desk.ask("GET", "/api").body.decode()
    assert all(one.path in page for one in TABLE)
    assert "<script" not in page and "src=" not in page and "http:" not in page


def test_before_something_waits_there_is_nothing_to_approve_nor_to_look_at(desk: Desk) -> None:
    for path, code in (("/api/proposal", "NO_PROPOSAL"), ("/api/plan", "NO_PLAN")):
        answer = desk.ask("GET", path)
        assert (answer.status, said(answer)["code"]) == (404, code)


# --- commands ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("verb", sorted(set(VERBS) - NEEDS_LEASE - NEEDS_TOKEN))
def test_what_brings_to_rest_needs_no_session_and_says_who_sent_it(desk: Desk, verb: str) -> None:
    answer = desk.post(f"/api/commands/{verb}", {"client_id": "plc"})
    assert (answer.status, said(answer)["ok"]) == (200, True)
    assert [(sent, request.client_id) for sent, request in desk.cell.sent] == [(verb, "plc")]


@pytest.mark.parametrize("verb", sorted(NEEDS_LEASE | NEEDS_TOKEN))
def test_motion_without_a_session_is_refused_with_what_to_do(desk: Desk, verb: str) -> None:
    for token in ({}, {"X_Cell_Session": "of another day"}):
        answer = desk.post(f"/api/commands/{verb}", **token)
        assert (answer.status, said(answer)["code"]) == (409, "NO_LEASE")
        assert "/api/events?client=" in said(answer)["advice"]
    assert desk.cell.sent == []


def test_motion_with_a_session_is_sent_on_a_connection_of_its_own(desk: Desk) -> None:
    session = desk.door.sessions.open("http-ann")
    job = {"job_id": "7", "target": {"text": "the largest red one"}}
    answer = desk.post("/api/commands/start", {"job": job, "cycles": 3}, X_Cell_Session=session.token)
    assert answer.status == 200
    ((verb, request),) = desk.cell.sent
    assert (verb, request.cycles, request.job.job_id) == ("start", 3, "7")
    assert desk.cell.connected == ["http-ann.1"]
    yes = desk.post("/api/commands/approve", {"proposal": "c-0", "client_id": "x"}, X_Cell_Session=session.token)
    assert yes.status == 200 and desk.cell.sent[-1][1].proposal == "c-0"
    assert desk.cell.sent[-1][1].client_id == "", "it goes out on that connection, under the name that holds the lease"
    session.commander.end()
    assert desk.cell.connected == []


@pytest.mark.parametrize(("verb", "wait"), [("stop", "true"), ("reset", "long")])
def test_only_motion_is_waited_for(desk: Desk, verb: str, wait: str) -> None:
    answer = desk.ask("POST", f"/api/commands/{verb}", b"{}", query=f"wait={wait}")
    assert (answer.status, "wait" in said(answer)["reason"]) == (422, True)
    assert desk.cell.sent == []


def test_a_refusal_has_code_reason_advice_and_what_is_available(desk: Desk) -> None:
    desk.cell.refusal = refused("LEASE_HELD")
    answer = desk.post("/api/commands/stop")
    assert answer.status == 409
    assert said(answer) == {
        "ok": False, "state": "Execute", "code": "LEASE_HELD", "reason": "It is not possible now.", "advice": "Wait.",
        "available": ["stop"], "error": "Refused",
    }  # fmt: skip


def test_an_unknown_command_is_answered_with_those_there_are(desk: Desk) -> None:
    answer = desk.post("/api/commands/dance")
    assert (answer.status, said(answer)["available"]) == (404, list(VERBS))
    assert ", ".join(VERBS) in said(answer)["advice"]


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"job": {"target": {}}}, "job.target"),
        ({"job": {"deadline_s": -1}}, "job.deadline_s"),
        ({"cycles": 0}, "cycles"),
        ({"speed": 3}, "speed"),
        ([], "payload"),
    ],
)
def test_a_bad_body_is_answered_with_the_name_of_the_field(desk: Desk, body: Any, field: str) -> None:
    answer = desk.post("/api/commands/stop", body)
    assert (answer.status, said(answer)["code"]) == (422, "BAD_PAYLOAD")
    assert field in said(answer)["reason"]


@pytest.mark.parametrize(
    ("error", "status"), [(NoReply("Nobody answers."), 503), (BusError("Closed."), 503), (ReplyTimeout("Late."), 504)]
)
def test_without_a_cell_it_says_so(desk: Desk, error: Exception, status: int) -> None:
    desk.cell.refusal = error
    for answer in (desk.ask("GET", "/api/state"), desk.post("/api/commands/stop"), desk.post("/api/picks")):
        assert (answer.status, said(answer)["ok"]) == (status, False)


# --- who may ----------------------------------------------------------------------------------------------------------


def test_without_a_token_only_the_documentation_is_read(guarded: Desk) -> None:
    assert guarded.ask("GET", "/api/openapi.json").status == 200
    for path in ("/api/state", "/api/events", "/api/picture", "/recordings/a.mcap", "/nothing"):
        answer = guarded.ask("GET", path)
        assert (answer.status, answer.headers["www-authenticate"]) == (401, "Bearer")
    assert guarded.post("/api/commands/stop", authorization="Bearer wrong-token-0123456789").status == 401


def test_a_viewer_looks_and_stops_and_commands_nothing_else(guarded: Desk) -> None:
    token = {"authorization": f"Bearer {VIEWER}"}
    assert said(guarded.ask("GET", "/api/role", headers=token)) == {"role": "viewer"}
    for verb in VERBS:
        answer = guarded.post(f"/api/commands/{verb}", **token)
        assert answer.status == (200 if verb in ENDING else 403)
    assert said(guarded.post("/api/picks", **token))["code"] == "NO_RIGHT"


def test_a_browser_keeps_its_token_in_a_cookie_that_no_script_reads(guarded: Desk) -> None:
    answer = guarded.post("/api/login", {"token": OPERATOR})
    cookie = answer.headers["set-cookie"]
    assert "HttpOnly" in cookie and "SameSite=strict" in cookie
    held = {"cookie": cookie.partition(";")[0]}
    assert said(guarded.ask("GET", "/api/role", headers=held)) == {"role": "operator"}
    assert guarded.post("/api/login", {"token": "wrong-token-0123456789"}).status == 401


def test_on_loopback_without_tokens_everybody_is_the_operator(desk: Desk) -> None:
    assert said(desk.ask("GET", "/api/role")) == {"role": "operator"}


# --- what a request must be -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "", "[::1", "a@b:c:d"])
def test_a_foreign_host_is_refused(desk: Desk, host: str) -> None:
    answer = desk.ask("GET", "/api/state", headers={"host": host})
    assert (answer.status, said(answer)["code"]) == (403, "FOREIGN_HOST")


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.1:8088", "localhost:1", "LOCALHOST", "[::1]:8088"])
def test_this_machine_has_these_names(desk: Desk, host: str) -> None:
    assert desk.ask("GET", "/api/state", headers={"host": host}).status == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1", "http://127.0.0.1:1"])
def test_a_page_of_another_server_is_refused(desk: Desk, origin: str) -> None:
    for answer in (
        desk.ask("GET", "/api/events", headers={"origin": origin}),
        desk.post("/api/commands/stop", origin=origin),
    ):
        assert (answer.status, said(answer)["code"]) == (403, "FOREIGN_ORIGIN")
    assert desk.post("/api/commands/stop", origin="http://127.0.0.1").status == 200


@pytest.mark.parametrize("kind", ["", "text/plain", "application/x-www-form-urlencoded", "multipart/form-data"])
def test_what_a_form_can_send_is_refused(desk: Desk, kind: str) -> None:
    answer = desk.ask("POST", "/api/commands/stop", b"{}", {"content-type": kind})
    assert (answer.status, said(answer)["code"]) == (415, "CONTENT_TYPE")
    assert said(answer)["advice"] == "With curl: -H 'Content-Type: application/json'."


def test_a_method_that_there_is_not_is_refused(desk: Desk) -> None:
    for method, path in (("DELETE", "/api/state"), ("GET", "/api/commands/stop"), ("OPTIONS", "/api/picks")):
        answer = desk.ask(method, path)
        assert (answer.status, said(answer)["code"]) == (405, "METHOD")


def test_every_answer_carries_the_headers_of_a_careful_server(desk: Desk) -> None:
    for answer in (
        desk.ask("GET", "/api/state"),
        desk.ask("GET", "/nothing"),
        desk.ask("GET", "/", headers={"host": "x"}),
    ):
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert "default-src 'self'" in answer.headers["content-security-policy"]
        assert answer.headers["cache-control"] == "no-store"
        assert "access-control-allow-origin" not in answer.headers

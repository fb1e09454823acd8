"""What the HTTP interface tells of recordings: small pictures, the figures of a day, the disk, verdicts of persons."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bus.errors import CatalogueError
from cell.http.access import Access, HttpRole
from logs.catalogue import open_catalogue, summary
from logs.catalogue.labels import read_labels
from tests.cell.http_bench import Answer, Asked, FakeCell, door_of

GOLDEN = Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap"
CYCLE, TORN = "20261129T101500000", "20261129T101600000"
TOKENS = Access({HttpRole.OPERATOR: "operator-token-0123", HttpRole.VIEWER: "viewer-token-456789"})
LABEL = f"/api/labels/{CYCLE}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    recordings = tmp_path_factory.mktemp("recordings")
    day = recordings / "2026-11-29"
    day.mkdir()
    shutil.copy(GOLDEN, day / f"{CYCLE}.mcap")
    (day / f"{TORN}.mcap").write_bytes(b"no recording")
    with open_catalogue(recordings):
        return recordings


@pytest.fixture
def ask(folder: Path) -> Iterator[Asked]:
    door = door_of(FakeCell(), folder)
    with closing(Asked(door)) as ask:
        yield ask
    door.wait()


def told(answer: Answer) -> Any:
    return json.loads(answer.body)


def test_a_thumbnail_is_the_picture_of_the_cycle_and_small(ask: Asked) -> None:
    answer = ask("GET", f"/api/thumbnails/{CYCLE}")
    image = cv2.imdecode(np.frombuffer(answer.body, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None and image.shape[1] == 320 and len(answer.body) < 40_000
    again = ask("GET", f"/api/thumbnails/{CYCLE}", headers={"If-None-Match": answer.headers["etag"]})
    assert again.status == 304


@pytest.mark.parametrize("cycle", ["20261129T101700000", TORN, "..", "x%00", "20261129T101500000.mcap"])
def test_what_is_no_recording_has_no_thumbnail(ask: Asked, cycle: str) -> None:
    assert ask("GET", f"/api/thumbnails/{cycle}").status == 404


def test_only_what_failed_is_listed_where_that_is_wanted(ask: Asked) -> None:
    assert [one["cycle_id"] for one in told(ask("GET", "/api/cycles", query="failed=true"))] == [TORN]
    assert ask("GET", "/api/cycles", query="failed=perhaps").status == 422


def test_the_figures_are_those_of_the_command_line(ask: Asked, folder: Path) -> None:
    assert told(ask("GET", "/api/summary")) == json.loads(json.dumps(summary(folder).to_json()))
    assert told(ask("GET", "/api/summary", query="day=1999"))["cycles"] == 0
    assert ask("GET", "/api/summary", query="day=' OR 1").status == 422


@pytest.mark.parametrize("path", ["/api/cycles", "/api/summary"])
def test_a_list_that_cannot_be_had_is_an_error_and_not_an_empty_list(
    ask: Asked, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def busy(*_: object, **__: object) -> None:
        raise CatalogueError("The catalogue cannot be used: it is locked.")

    monkeypatch.setattr("cell.http.recorded.open_catalogue", busy)
    answer = ask("GET", path)
    assert answer.status == 404 and told(answer)["code"] == "CATALOGUE"


def test_the_disk_is_told(ask: Asked) -> None:
    disk = told(ask("GET", "/api/storage"))
    assert 0 < disk["free_bytes"] <= disk["total_bytes"]
    assert disk["recordings_bytes"] >= GOLDEN.stat().st_size
    assert disk["soon"] == {"recordings": 0, "bytes": 0, "trimmed": 0}


def test_verdicts_are_appended_and_listed_with_their_cycle(ask: Asked, folder: Path) -> None:
    for body in (b'{"who": "anna", "label": "bad", "note": "it slipped"}', b'{"who": "ben", "note": "twice"}'):
        assert ask("POST", LABEL, body).status == 200
    assert [(one.who, one.label, one.note) for one in read_labels(folder)] == [
        ("anna", "bad", "it slipped"),
        ("ben", "", "twice"),
    ]
    cycles = {Path(one["file"]).stem: one for one in told(ask("GET", "/api/cycles"))}
    # a label goes by the cycle's id, which is also the name of its file, but for copies like this one
    assert set(cycles) == {CYCLE, TORN} and all("labels" in one for one in cycles.values())


@pytest.mark.parametrize(
    "body", [b"{}", b'{"who": "", "label": "good"}', b'{"who": "a"}', b'{"who": "a", "label": "fine"}']
)
def test_a_verdict_that_says_nothing_is_refused(ask: Asked, body: bytes) -> None:
    assert ask("POST", LABEL, body).status == 422


def test_a_viewer_gives_no_verdict(folder: Path) -> None:
    door = door_of(FakeCell(), folder, TOKENS)
    with closing(Asked(door)) as ask:
        given = {"authorization": "Bearer viewer-token-456789"}
        assert ask("POST", LABEL, b'{"who": "eve", "label": "good"}', given).status == 403
        assert ask("GET", "/").status == 200 and ask("GET", "/page/main.js").status == 200  # the page asks for a token
        assert ask("GET", "/api/summary").status == 401
    door.wait()

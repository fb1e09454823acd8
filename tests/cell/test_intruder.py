"""What `benchmarks intruder` tries, without its cell: the series of its tries, what it forges, what a door answers."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import zenoh

from benchmarks.forging import FORGED, forged
from benchmarks.guarded import OPERATOR_TOKEN, VIEWER_TOKEN, Guarded
from benchmarks.http_intruder import HttpIntruder
from benchmarks.intruder import SHARES, series
from benchmarks.questions import PATTERNS
from benchmarks.tally import Tally
from bus import topics
from bus.codec import decode
from bus.commands import CellState
from bus.free_port import free_port
from bus.sensor_codec import arm_q_rad
from cell.http.access import Access, HttpRole
from tests.cell.http_bench import EVERYBODY, FakeCell, door_of, served


def _series(tries: int, only: tuple[str, ...] = ()) -> list[str]:
    return series(tries, np.random.default_rng(1), only)


def test_every_kind_is_tried_where_there_are_enough_tries() -> None:
    assert set(_series(len(SHARES))) == set(SHARES)
    assert len(_series(1)) == 1


def test_only_what_was_named_is_tried() -> None:
    assert set(_series(50, ("twin", "token"))) == {"twin", "token"}


def test_the_series_of_a_seed_is_always_the_same() -> None:
    assert _series(200) == _series(200)


def test_every_acting_key_is_met_by_a_pattern() -> None:
    patterns = [zenoh.KeyExpr(pattern.format(cell="sim")) for pattern in PATTERNS]
    for topic in topics.TOPICS:
        if topic.acts and topic is not topics.FAULT:
            key = zenoh.KeyExpr(f"cell/sim/{topic.key.format(verb='reset')}")
            assert any(pattern.includes(key) for pattern in patterns), key


def test_what_is_forged_can_be_read() -> None:
    assert decode(CellState, forged(topics.STATE)).reason == FORGED
    assert not arm_q_rad(forged(topics.ARM_STATE)).any()


def test_the_figures_add_up() -> None:
    tally = Tally()
    tally.by_kind["stranger"] += 2
    tally.accept("stranger", "arm/stop")
    tally.crash("no answer")
    figures = tally.figures()
    assert (figures["tries"], figures["accepted"], figures["moved"], figures["crashes"]) == (2, 1, 0, 1)


# --- at the HTTP door -------------------------------------------------------------------------------------------------

HTTP_KINDS = [kind for kind in SHARES if kind.startswith("http_")]
TOKENS = Access({HttpRole.OPERATOR: OPERATOR_TOKEN, HttpRole.VIEWER: VIEWER_TOKEN})


def _tried(folder: Path, access: Access, kinds: list[str], tries: int) -> tuple[Tally, FakeCell]:
    cell, tally = FakeCell(), Tally()
    with served(door_of(cell, folder, access), cell) as site:
        intruder = HttpIntruder(f"http://127.0.0.1:{site.port}", tally, np.random.default_rng(1))
        with closing(intruder):
            assert list(intruder.kinds) == HTTP_KINDS
            for kind in kinds:
                for _ in range(tries):
                    intruder.attempt(kind)
    return tally, cell


def test_the_http_door_lets_no_intruder_in(tmp_path: Path) -> None:
    tally, cell = _tried(tmp_path, TOKENS, [kind for kind in HTTP_KINDS if kind != "http_half_open"], 20)
    assert (tally.figures()["accepted_kinds"], tally.cases) == ({}, [])
    assert cell.sent == [] and cell.connected == []
    refusals = set(tally.by_code)
    for status in ("401 NO_TOKEN", "403 NO_RIGHT", "403 FOREIGN_HOST", "403 FOREIGN_ORIGIN", "404", "413", "422"):
        assert any(status in code for code in refusals), status


def test_half_open_connections_are_no_reason_to_refuse_a_viewer(tmp_path: Path) -> None:
    tally, _ = _tried(tmp_path, TOKENS, ["http_half_open"], 2)
    assert (tally.by_code["HTTP 200"], tally.cases) == (2, [])


def test_a_door_that_lets_everybody_in_is_told(tmp_path: Path) -> None:
    tally, _ = _tried(tmp_path, EVERYBODY, ["http_no_token"], 12)
    assert sum(tally.accepted.values()) > 0


# --- at the OPC UA door -----------------------------------------------------------------------------------------------


def test_a_dead_opcua_door_has_refused_nobody(tmp_path: Path) -> None:
    pytest.importorskip("asyncua")
    from benchmarks.opcua_intruder import OpcuaIntruder  # noqa: PLC0415 - asyncua is an extra

    guarded, tally = Guarded.in_folder(tmp_path), Tally()
    endpoint = f"opc.tcp://127.0.0.1:{free_port()}/cell"
    with closing(OpcuaIntruder(endpoint, guarded, tally, np.random.default_rng(1))) as intruder:
        for kind in intruder.kinds:
            intruder.attempt(kind)
        assert tally.crashes == len(intruder.kinds) + 1, "every kind, and the honest session"
    assert (tally.by_code, tally.figures()["accepted"]) == ({}, 0)

"""What `benchmarks intruder` tries, without its cell: the series of its tries, and what it forges."""

from __future__ import annotations

import numpy as np
import zenoh

from benchmarks.forging import FORGED, forged
from benchmarks.intruder import SHARES, series
from benchmarks.questions import PATTERNS
from benchmarks.tally import Tally
from bus import topics
from bus.codec import decode
from bus.commands import CellState
from bus.sensor_codec import arm_q_rad


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

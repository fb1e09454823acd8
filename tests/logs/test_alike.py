"""Cycles that are alike: neighbours, groups of failures, missing values, and a hundred thousand rows."""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np
import pytest

from benchmarks.grouped import adjusted_rand
from logs.alike.features import FAMILIES, SHOWN, Space, space_of
from logs.alike.groups import group_failures, label_failures, nearest

FEATURES = [feature for _, some in FAMILIES.values() for feature in some]
NAMES = list(dict.fromkeys([*SHOWN, *(feature.column for feature in FEATURES)]))
FAULTS: tuple[dict[str, Any], ...] = (
    {"code": "GRASP_MISSED", "failed_stage": "verify", "reason": "Nothing held: {} mm wide.", "closed_m": 0.001},
    {"code": "DROPPED", "failed_stage": "verify", "reason": "It slipped {} mm on the way.", "closed_m": 0.03},
    {"code": "NO_GRASP", "failed_stage": "detect", "reason": "The jaw opens 80 mm and the thing is {} mm wide.",
     "thing_width_m": 0.11},
    {"code": "COLLISION", "failed_stage": "plan", "reason": "No way is free.", "rejected_codes": '{"COLLISION": 9}',
     "in_the_way": '{"wall": 9}'},
    {"code": "COLLISION", "failed_stage": "plan", "reason": "The post is {} mm too near to every grasp of it.",
     "rejected_codes": '{"COLLISION": 2, "UNREACHABLE": 7}', "in_the_way": '{"post": 2}'},
    {"code": "MODEL_TIMEOUT", "failed_stage": "detect", "reason": "geometric: no answer within {} s.",
     "model_failures": 2},
)  # fmt: skip


def _cycles(count: int, seed: int, failed: float = 1.0) -> tuple[Space, list[int]]:
    """Cycles with one of the faults each, among noise and holes; and which fault: -1 = none."""
    rng = np.random.default_rng(seed)
    columns: dict[str, list[Any]] = {name: [] for name in NAMES}
    truth = rng.integers(len(FAULTS), size=count)
    truth[rng.random(count) >= failed] = -1
    for index, fault in enumerate(truth.tolist()):
        usual: dict[str, Any] = {
            "cycle_id": f"{index:09d}", "started_ns": index * 10**10, "object": "mug",
            "result": "SUCCESS", "code": "", "reason": f"Held {rng.integers(20, 60)}.1 mm wide.", "looks": 1,
            "thing_width_m": float(rng.normal(0.05, 0.01)), "thing_height_m": float(rng.normal(0.1, 0.03)),
            "score": float(rng.random()), "grasp_x_m": float(rng.normal(0.5, 0.1)), "load_n": float(rng.normal(2, 0.5)),
            "terms": json.dumps({"central": round(float(rng.random()), 1), "seen": 1.0}),
        }  # fmt: skip
        if fault >= 0:
            usual |= {"result": "FAILED"} | FAULTS[fault]
            usual["reason"] = usual["reason"].format(rng.integers(100))
        if rng.random() < 0.2:
            usual["thing_height_m"] = None
        for name, values in columns.items():
            values.append(usual.get(name))
    return space_of(columns), truth.tolist()


def test_faults_fall_into_their_own_groups() -> None:
    where, truth = _cycles(300, seed=1000)
    labels = label_failures(where, range(300)).tolist()
    assert adjusted_rand(truth, labels) > 0.95


def test_a_group_has_its_sentence_its_object_and_three_examples() -> None:
    where, truth = _cycles(120, seed=3, failed=0.5)
    groups = group_failures(where)
    assert sum(len(group.cycles) for group in groups) == sum(fault >= 0 for fault in truth)
    first = next(group for group in groups if "MODEL_TIMEOUT" in group.sentence)
    assert (
        f"{len(first.cycles)} cycles ended MODEL_TIMEOUT in detect on 1970-01-01: geometric: no answer"
        in first.sentence
    )
    assert len(set(first.examples)) == 3 and set(first.examples) <= set(first.cycles)
    assert groups == group_failures(where)


def test_the_nearest_cycle_failed_the_same_way_and_words_say_what_differs() -> None:
    where, truth = _cycles(200, seed=1001)
    for index in range(0, 200, 20):
        found = nearest(where, where.ids[index], 3)
        assert [truth[int(one.cycle_id)] for one in found] == [truth[index]] * 3
        assert found[0].distance <= found[1].distance and "the same: " in found[0].in_words()
    with pytest.raises(KeyError):
        nearest(where, "none", 3)


def test_a_distance_is_a_share_and_of_a_cycle_to_itself_nothing() -> None:
    where, _ = _cycles(60, seed=2, failed=0.5)
    apart = where.distances(range(60), range(60))
    assert np.allclose(np.diag(apart), 0.0) and np.allclose(apart, apart.T) and 0.3 < apart.max() <= 1.0
    one = where.by_family(0, 1)
    assert sum(FAMILIES[family][0] * value for family, value in one.items()) == pytest.approx(apart[0, 1], abs=1e-5)
    assert sum(weight for weight, _ in FAMILIES.values()) == pytest.approx(1.0)


def test_numbers_in_a_reason_do_not_part_cycles_but_a_missing_value_does() -> None:
    columns: dict[str, list[Any]] = {name: [None] * 3 for name in NAMES}
    columns |= {
        "cycle_id": ["a", "b", "c"],
        "reason": ["It is 7.5 mm wide.", "It is 60 mm wide."] * 1 + ["It is 1 mm wide."],
    }
    columns["load_n"] = [1.0, 1.0, None]
    apart = space_of(columns).distances([0], [1, 2])[0]
    assert apart[0] == 0.0 and apart[1] > 0.0


def test_failures_of_another_part_are_another_group_but_not_those_of_another_stage_or_with_a_note_behind() -> None:
    columns: dict[str, list[Any]] = {name: [None] * 4 for name in NAMES}
    columns |= {"cycle_id": list("abcd"), "code": ["DEVICE_LOST"] * 4, "started_ns": [0] * 4, "object": ["mug"] * 4}
    columns |= {"failed_stage": ["execute", "capture", "execute", "execute"], "load_n": [1.0, None, 1.0, 1.0]}
    columns["reason"] = [f"The {part} no longer answers." for part in ("arm", "arm", "hand")]
    columns["reason"].append("The arm no longer answers. This machine is too busy: load 7 on 2 cores.")
    labels = label_failures(space_of(columns), range(4)).tolist()
    assert labels[0] == labels[1] == labels[3] != labels[2]


def test_no_cycles_and_one_cycle_are_no_trouble() -> None:
    assert group_failures(space_of({name: [] for name in NAMES})) == []
    where, _ = _cycles(1, seed=1)
    assert nearest(where, where.ids[0], 5) == [] and len(group_failures(where)) == 1


@pytest.mark.thorough
def test_a_hundred_thousand_cycles_take_seconds() -> None:
    where, _ = _cycles(100_000, seed=5, failed=0.05)
    began_s = time.process_time()
    assert len(nearest(where, where.ids[0], 5)) == 5
    assert time.process_time() - began_s < 5.0

"""A whole cell that asks before it moves: what waits is seen in 3-D, passed over, approved, rejected, and recorded."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from bus.codes import Code
from bus.commands import CommandRequest
from bus.errors import Refused
from bus.messages import CycleResult, Proposal
from cell import client
from cell.client import Client
from cell.replay.replay import Request, replay
from config.schema import Station
from logs.mcap.reader import CycleRecord, read_cycle


@pytest.fixture(scope="module")
def pace() -> float:
    return 0.0


@pytest.fixture(scope="module")
def shared_options(shared_options: list[str]) -> list[str]:
    return [*shared_options, "--set", "execute.approve=client", "--set", "capture.views=1"]


def _asked(cell: Client, besides: Proposal | None = None) -> Proposal:
    """The proposal that waits, another than ``besides``."""
    give_up_s = time.monotonic() + 60
    while time.monotonic() < give_up_s:
        with suppress(Refused):
            asked = cell.proposal()
            if besides is None or asked.proposal_id != besides.proposal_id:
                return asked
        assert cell.state().state != "Complete", "the cycle is over"
        time.sleep(0.02)
    raise AssertionError("nothing was proposed")


def _answer(cell: Client, verb: str, asked: Proposal, reason: str = "") -> None:
    cell.send(verb, CommandRequest(proposal=asked.proposal_id, reason=reason))


def _joints_moved(record: CycleRecord) -> np.ndarray:
    """The joint positions (n, 7) that the arm reported before the cycle executed something."""
    began_ns = record.stages["execute"].started_ns if "execute" in record.stages else 2**63
    return np.array([[joint.position for joint in said.message.joints]
                     for said in record.arm if said.log_time_ns < began_ns])  # fmt: skip


def test_a_pick_waits_is_passed_over_approved_and_replays_equal(shared_cell: Station) -> None:
    with client.connect(shared_cell) as holder, client.connect(shared_cell) as person:
        with pytest.raises(Refused, match="No planned motion waits"):
            person.proposal()
        holder.command("reset")
        holder.wait_for_state({"Idle"}, 60)
        cycle_id = holder.command("pick", object_name="spatula").cycle_id
        first = _asked(person)
        state = person.state()
        assert (state.state, state.stage) == ("Execute", "approve")
        assert {"approve", "next_grasp", "reject", "stop"} <= set(state.available)
        _answer(person, "next_grasp", first, "too near to the wall")
        second = _asked(person, besides=first)
        with pytest.raises(Refused) as stale:
            _answer(person, "approve", first)
        assert stale.value.code == "OTHER_PROPOSAL"
        _sees_the_plan(person, second)
        _answer(person, "approve", second)
        result = holder.wait_for_result(cycle_id, 60)
        _answers_of(result, person.client_id)
        assert result.grasp is not None and np.array_equal(result.grasp.base_from_tcp, second.base_from_tcp)
        assert result.laid is not None and second.place_m is not None and second.place == ""
        assert np.linalg.norm(result.laid.position_m - second.place_m) < 0.001, "laid where it was said to be"
    record = read_cycle(Path(result.recording))
    assert np.ptp(_joints_moved(record), axis=0).max() < 1e-3, "the arm rested until it was approved"
    answered = record.stages["approve"].result
    assert len(record.passed_over) == 1 and answered is not None and answered.decision == "approve"
    again = replay(record, Request(only="plan"))
    assert again.equal


def _sees_the_plan(person: Client, asked: Proposal) -> None:
    """The picture shows what is asked about, and the arm on the way there."""
    view = person.plan_view()
    assert view.is_open and view.proposal.proposal_id == asked.proposal_id
    assert [path.name for path in view.segments][:2] == ["reach", "carry"]
    reach = view.segments[0]
    at_m = asked.base_from_tcp[:3, 3]
    assert np.linalg.norm(reach.tcp_m[-1] - at_m) < 0.005
    assert 0 < reach.nearest_m["table"] < 0.03, "the fingers come near to the table"
    assert reach.base_from_frame.shape == (len(reach.times_s), len(view.frames), 3, 4)
    assert 500 < len(view.cloud_m) <= 5000 and len(view.cloud_rgb) == len(view.cloud_m)
    assert np.linalg.norm(view.cloud_m - at_m, axis=1).min() < 0.05, "the cloud is where the thing is"
    assert len(view.model_dump_json()) < 1_000_000


def _answers_of(result: CycleResult, person: str) -> None:
    assert result.result == "SUCCESS", result.reason
    assert [(one.decision, one.client_id, one.reason) for one in result.approvals] == [
        ("next_grasp", person, "too near to the wall"),
        ("approve", person, ""),
    ]


def test_a_rejected_pick_moves_nothing_and_is_not_tried_again(shared_cell: Station) -> None:
    with client.connect(shared_cell) as cell:
        cell.command("reset")
        cell.wait_for_state({"Idle"}, 60)
        cycle_id = cell.command("pick").cycle_id
        _answer(cell, "reject", _asked(cell), "that is my cup")
        result = cell.wait_for_result(cycle_id, 60)
    assert (result.result, result.code, result.retried_as) == ("FAILED", Code.REJECTED, "")
    assert "that is my cup" in result.reason and result.advice and result.found is not None and result.grasp is None
    record = read_cycle(Path(result.recording))
    assert "execute" not in record.stages and np.ptp(_joints_moved(record), axis=0).max() < 1e-3


def test_a_lost_lease_holds_what_waits_and_a_stop_ends_it(shared_cell: Station) -> None:
    with client.connect(shared_cell) as person:
        with client.connect(shared_cell) as holder:
            holder.command("reset")
            holder.wait_for_state({"Idle"}, 60)
            holder.command("pick")
            asked = _asked(person)
        person.wait_for_state({"Held"}, 60)
        with pytest.raises(Refused) as held:
            _answer(person, "approve", asked)
        assert held.value.code == "WRONG_STATE"
        stopper = threading.Thread(target=lambda: person.command("stop"))
        stopper.start()
        assert person.wait_for_state({"Stopped"}, 60).state == "Stopped"
        stopper.join()

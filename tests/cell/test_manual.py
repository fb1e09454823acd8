"""Mode Manual in a whole cell: small steps while a button is held, through the gate; it picks nothing meanwhile."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from bus import topics
from bus.codec import decode
from bus.commands import CommandReply, CommandRequest, Event, Nothing
from bus.errors import Refused
from bus.messages import ArmState
from cell import client
from cell.client import Client
from config.load import load_station
from config.schema import Station
from planning.robot import Robot

ROBOT = Robot(load_station(None, []))
HOME_M = ROBOT.base_from_tcp(np.asarray(ROBOT.station.arm.capture_q_rad))[:3, 3]


@pytest.fixture(scope="module")
def shared_options(shared_options: list[str]) -> list[str]:
    """Slow enough that a busy machine asks and commands while a step is under way."""
    return [*shared_options, "--set", "manual.jog_m_s=0.0125", "--set", "manual.home_speed=0.05"]


@pytest.fixture
def hand(shared_cell: Station) -> Iterator[Client]:
    """A client of a cell in mode Manual."""
    with client.connect(shared_cell, (topics.EVENT,)) as cell:
        _send(cell, "mode", mode="Manual")
        yield cell
        _send(cell, "stop")


def _send(cell: Client, verb: str, **fields: Any) -> CommandReply:
    return cell.send(verb, CommandRequest(**fields))


def _refused(cell: Client, verb: str, **fields: Any) -> str:
    with pytest.raises(Refused) as refused:
        _send(cell, verb, **fields)
    assert refused.value.advice
    return refused.value.code


def _rests(cell: Client) -> None:
    give_up_s = time.monotonic() + 60
    while cell.state().stage:
        assert time.monotonic() < give_up_s
        time.sleep(0.01)


def _tcp_m(cell: Client) -> np.ndarray:
    state = cell._bus.request(topics.ARM_NOW, Nothing(), ArmState, timeout_s=10)
    return np.asarray(ROBOT.base_from_tcp(state.q_rad)[:3, 3])


def _said(cell: Client) -> list[Event]:
    return [decode(Event, sample.payload) for sample in cell.heard() if sample.key == topics.EVENT.key]


def test_outside_of_manual_nothing_is_jogged_and_in_it_nothing_is_picked(shared_cell: Station) -> None:
    with client.connect(shared_cell) as cell:
        assert _refused(cell, "jog", axis="z", direction=1) == "WRONG_MODE"
        _send(cell, "mode", mode="Manual")
        state = cell.state()
        assert state.mode == "Manual" and {"jog", "jog_home", "stop", "mode"} <= set(state.available)
        for verb in ("reset", "start", "pick"):
            assert _refused(cell, verb) == "WRONG_MODE"
        assert _refused(cell, "jog", axis="z") == "BAD_JOG"
        _send(cell, "mode", mode="Production")
        assert cell.state().available == ("reset", "abort")


def test_each_command_is_one_step_and_an_event_says_who_jogs(hand: Client) -> None:
    begin_m = _tcp_m(hand)
    for _ in range(2):
        _send(hand, "jog", axis="z", direction=-1)
        assert hand.state().stage == "jog"
        assert _refused(hand, "jog", axis="z", direction=-1) == "MOVING"
        _rests(hand)
    assert np.allclose(_tcp_m(hand) - begin_m, [0, 0, -0.010], atol=1e-3)
    jogs = [said.text for said in _said(hand) if said.code == "JOG"]
    assert jogs == [f"jog -z by {hand.client_id}."], "once for all steps that follow each other"


@pytest.mark.thorough
def test_a_way_home_ends_when_it_is_no_longer_asked_for_and_goes_on_while_it_is(hand: Client) -> None:
    for _ in range(6):
        _send(hand, "jog", axis="y", direction=1)
        _rests(hand)
    away_m = np.linalg.norm(_tcp_m(hand) - HOME_M)
    _send(hand, "jog_home")
    _rests(hand)  # nobody says it again
    _send(hand, "jog_home")
    while hand.state().stage == "jog_home":
        try:
            _send(hand, "jog_home")
        except Refused:
            break
        time.sleep(0.1)
    _rests(hand)
    assert np.linalg.norm(_tcp_m(hand) - HOME_M) < 2e-3 < away_m


def test_a_stop_ends_the_motion_and_the_mode(hand: Client) -> None:
    for _ in range(4):
        _send(hand, "jog", axis="z", direction=-1)
        _rests(hand)
    _send(hand, "jog_home")
    _send(hand, "stop")
    _rests(hand)
    assert np.linalg.norm(_tcp_m(hand) - HOME_M) > 2e-3, "it stays on its way"
    assert hand.state().mode == "Production"
    assert _refused(hand, "jog", axis="z", direction=1) == "WRONG_MODE"
    _send(hand, "mode", mode="Manual")
    _send(hand, "hand_close")
    _rests(hand)
    _send(hand, "hand_open")
    _rests(hand)


def test_from_idle_manual_stops_the_cell_so_that_a_reset_comes_before_the_next_pick(shared_cell: Station) -> None:
    with client.connect(shared_cell) as cell:
        cell.command("reset")
        cell.wait_for_state({"Idle"}, 60)
        _send(cell, "mode", mode="Manual")
        state = cell.wait_for_state({"Stopped"}, 60)
        assert state.mode == "Manual"
        _send(cell, "jog", axis="x", direction=1)
        _rests(cell)
        _send(cell, "mode", mode="Production")
        assert _refused(cell, "pick") == "WRONG_STATE"


def test_who_is_gone_leaves_no_motion_behind(shared_cell: Station) -> None:
    with client.connect(shared_cell) as person:
        with client.connect(shared_cell) as gone:
            _send(gone, "mode", mode="Manual")
            _send(gone, "jog", axis="z", direction=1)
            with pytest.raises(Refused) as other:
                _send(person, "jog", axis="z", direction=1)
            assert other.value.code == "LEASE_HELD"
        _rests(person)
        assert person.state().state == "Stopped"
        _send(person, "stop")

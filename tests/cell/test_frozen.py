"""Everyone who moves the arm is heard: a cell or a client that is frozen in mid-motion leaves the arm at rest.

How soon it rests is measured by `benchmarks stop`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus import topics
from bus.clock import StarvedClock
from bus.codec import decode
from bus.commands import Event
from bus.sample import Sample
from bus.starvation import StarvationMeter, counts_of
from cell import client
from cell.client import Client
from config.schema import Station
from logs.mcap.reader import CycleRecord, read_cycle

Daemon = tuple[subprocess.Popen[str], Station]

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "trigger.py"
FROZEN_S = 1.0
"""Longer than the 0.5 s of `bus.silence_s`, shorter than the slowed motion; by the clock of the node's deadlines."""
_MOVES_RAD_S, _RESTS_RAD_S = 0.2, 0.1


@pytest.fixture(scope="module")
def shared_options(shared_options: list[str]) -> list[str]:
    """The arm moves so slowly that no motion is over before a simulated cell's deadlines, however busy the machine.

    One look: the first motion that is seen is the pick's.
    """
    return [*shared_options, "--set", "arm.speed=0.12", "--set", "capture.views=1"]


@pytest.fixture
def example(shared_daemon: Daemon) -> Iterator[subprocess.Popen[str]]:
    """Our example for plain Zenoh clients, whose transport would keep its token for 10 s."""
    source = EXAMPLE.read_text().replace("tcp/127.0.0.1:7447", shared_daemon[1].bus.endpoint)
    process = subprocess.Popen([sys.executable, "-c", source], stdout=subprocess.PIPE, text=True)
    yield process
    process.kill()
    process.communicate()


def _await_motion(cell: Client) -> str:
    """Until the arm moves; the cycle's id."""
    give_up_s = time.monotonic() + 90
    speed_rad_s = 0.0
    while (state := cell.state()).stage != "execute" or speed_rad_s < _MOVES_RAD_S:
        assert time.monotonic() < give_up_s
        for heard in cell.heard():
            if heard.key == topics.ARM_STATE.key:
                speed_rad_s = _speed_rad_s(topics.ARM_STATE.says.FromString(heard.payload))
        time.sleep(0.01)
    return state.cycle_id


def _speed_rad_s(said: Any) -> float:
    """Of the fastest joint."""
    return float(np.abs([joint.velocity for joint in said.joints]).max())


@contextmanager
def frozen(pid: int) -> Iterator[int]:
    """The process stands still; gives since when (UTC)."""
    os.kill(pid, signal.SIGSTOP)
    try:
        yield time.time_ns()
    finally:
        os.kill(pid, signal.SIGCONT)


def _clock_of(pid: int) -> StarvedClock:
    """The clock of a process's deadlines: it runs slower by the factor by which that process is starved."""
    tasks = Path(f"/proc/{pid}/task")
    return StarvedClock(measure=StarvationMeter(lambda: counts_of(tasks)).measure).start()


def _await_event(cell: Client, code: str) -> None:
    """Until somebody publishes an event with this code."""
    give_up_s = time.monotonic() + 60
    while (heard := cell.next_heard(1.0)) is None or _code(heard) != code:
        assert time.monotonic() < give_up_s, f"no {code}"


def _code(heard: Sample) -> str:
    return decode(Event, heard.payload).code if heard.key == topics.EVENT.key else ""


def _fastest_rad_s(record: CycleRecord, since_ns: int) -> float:
    return max(
        (_speed_rad_s(timed.message) for timed in record.arm if timed.message.timestamp.ToNanoseconds() > since_ns),
        default=0.0,
    )


def test_an_arm_whose_cell_is_frozen_brakes_and_the_cell_says_so_when_it_goes_on(
    shared_daemon: Daemon, example: subprocess.Popen[str]
) -> None:
    process, station = shared_daemon
    with client.connect(station, also=(topics.ARM_STATE,)) as cell, client.connect(station, (topics.EVENT,)) as ears:
        cycle_id = _await_motion(cell)
        said = cell.health().nodes["sim"].said
        assert said is not None
        with frozen(process.pid):
            _clock_of(said.pid).wait_for(time.sleep, FROZEN_S)
        went_on_ns = time.time_ns()
        _await_event(ears, "CELL_SILENT")
        result = cell.wait_for_result(cycle_id, 60)
        assert result.result == "ABORTED"
        cell.wait_for_state({"Stopped", "Aborted"}, 60)
    record = read_cycle(Path(result.recording))
    assert _fastest_rad_s(record, went_on_ns) < _RESTS_RAD_S, "nothing moved again"


@pytest.mark.thorough
def test_a_plain_client_that_is_frozen_loses_its_lease_long_before_its_transport_notices(
    shared_daemon: Daemon, example: subprocess.Popen[str]
) -> None:
    with client.connect(shared_daemon[1], also=(topics.ARM_STATE,)) as cell:
        cycle_id = _await_motion(cell)
        with frozen(example.pid) as since_ns:
            state = cell.wait_for_state({"Held"}, 60)
            cell.command("stop")
            result = cell.wait_for_result(cycle_id, 60)
    assert state.since_ns - since_ns < 10e9 and "no heartbeat" in state.reason and "'trigger'" in state.reason
    assert _fastest_rad_s(read_cycle(Path(result.recording)), state.since_ns) < _RESTS_RAD_S

"""A node that dies or hangs: noticed with its name, brought back, and the cell with it - nothing else is restarted."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import time
from collections.abc import Callable

import pytest

from bus.codec import encode
from bus.commands import CellHealth, Health, LoopHealth
from bus.errors import CycleFailure
from bus.session import Heard
from cell import client
from cell.health import Watch
from config.load import load_station
from config.schema import Station

Daemon = tuple[subprocess.Popen[str], Station]


class Bench:
    """A watch with the simulated cell's one node, and what it told of."""

    def __init__(self, stale_s: float = 0.05) -> None:
        self.lost: queue.SimpleQueue[CycleFailure] = queue.SimpleQueue()
        station = load_station(None, [f"bus.stale_s={stale_s}"])
        self.watch = Watch(station, lambda name, failure: self.lost.put(failure), lambda name: 2)

    def hear(self, key: str, payload: bytes = b"") -> None:
        self.watch.hear(Heard(key, "", payload))


def _said(rate_hz: float) -> Health:
    loops = {"arm.state": LoopHealth(rate_hz=rate_hz, target_hz=100.0, missed=3)}
    return Health(name="sim", pid=1, uptime_s=60.0, answered=1, failed=0, loops=loops)


def test_a_node_is_healthy_while_its_token_is_there_and_its_streams_flow() -> None:
    bench = Bench(stale_s=5.0)
    bench.watch.change("sim", True)
    bench.hear("arm/state")
    bench.hear("node/sim/health", encode(_said(98.0)))
    bench.watch.look()
    health = bench.watch.health()
    assert health.is_healthy and bench.lost.empty()
    assert (health.nodes["sim"].restarts, health.nodes["sim"].said) == (2, _said(98.0))


def test_a_lost_token_is_told_at_once() -> None:
    bench = Bench()
    bench.watch.change("sim", True)
    bench.watch.change("sim", False)
    assert "'sim' is gone" in bench.lost.get(timeout=1).text
    assert bench.watch.health().nodes["sim"].problems == ("not up",)
    assert bench.watch.gone_for_s("sim") > 0


def test_a_silent_stream_is_told_once_until_it_flows_again() -> None:
    bench = Bench()
    bench.watch.change("sim", True)
    for _ in range(2):
        bench.hear("arm/state")
        time.sleep(0.06)
        bench.watch.look()
        bench.watch.look()
        failure = bench.lost.get(timeout=1)
        assert "'sim' hangs" in failure.text and "arm/state" in failure.text
        assert bench.lost.empty()
        assert bench.watch.health().nodes["sim"].problems == ("silent on arm/state",)
    bench.hear("arm/state")
    assert bench.watch.health().is_healthy


def test_a_loop_far_below_its_rate_is_a_problem_although_it_answers() -> None:
    bench = Bench(stale_s=5.0)
    bench.watch.change("sim", True)
    bench.hear("node/sim/health", encode(_said(41.0)))
    assert bench.watch.health().nodes["sim"].problems == ("arm.state at 41 of 100 Hz",)


def test_words_that_are_no_health_are_counted_and_are_no_sign_of_life() -> None:
    bench = Bench(stale_s=5.0)
    bench.watch.change("sim", True)
    bench.hear("node/sim/health", b'{"name": "sim", "pid": "many"}')
    bench.hear("node/stranger/health", b"[" * 5000)
    health = bench.watch.health()
    assert health.nodes["sim"].problems == ("1 malformed words about itself",)
    assert health.nodes["sim"].said is None and set(health.nodes) == {"sim"}


# --- real processes ---------------------------------------------------------------------------------------------------


def _until(ask: Callable[[], bool], patience_s: float) -> float:
    """Seconds until ``ask`` says yes."""
    started_s = time.monotonic()
    while not ask():
        assert time.monotonic() - started_s < patience_s
        time.sleep(0.02)
    return time.monotonic() - started_s


@pytest.mark.parametrize("blow", [signal.SIGKILL, signal.SIGSTOP])
def test_a_killed_or_frozen_node_aborts_the_cell_with_its_name_and_comes_back(
    daemon: Daemon, blow: signal.Signals
) -> None:
    _, station = daemon
    with client.connect(station) as cell:
        cell.command("reset")
        cell.wait_for_state({"Idle"}, 60)

        def health() -> CellHealth:
            return cell.health()

        _until(lambda: health().nodes["sim"].said is not None, 5)
        said = health().nodes["sim"].said
        assert said is not None
        os.kill(said.pid, blow)
        noticed_s = _until(lambda: cell.state().state in ("Aborting", "Aborted"), 5)
        assert noticed_s < 2.0  # 1 s is the promise; the figure is the benchmark's
        assert "'sim'" in cell.state().reason
        _until(lambda: health().nodes["sim"].restarts == 1 and health().nodes["sim"].is_alive, 60)
        cell.wait_for_state({"Aborted"}, 30)
        cell.command("clear")
        cell.wait_for_state({"Stopped"}, 30)
        cell.command("reset")
        assert cell.wait_for_state({"Idle", "Aborted"}, 60).state == "Idle"

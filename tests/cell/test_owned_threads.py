"""Every thread that owns something: when an exception that nobody foresaw ends it, the cell aborts and says so.

The table below has every role of `bus.threads`, and no thread starts without one (a lint rule sees to that).
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bus import topics
from bus.cancel import Cancel
from bus.clock import StarvedClock
from bus.commands import CommandRequest
from bus.messages import ArmMode, ArmState, View
from bus.session import Bus
from bus.starvation import Starvation
from bus.threads import OwnedThread, Role, handled_by
from cell.daemon.cataloguer import Cataloguer
from cell.daemon.daemon import Daemon
from cell.daemon.retention import Retention
from cell.daemon.robot_tf import RobotTf
from cell.doctor.network import answer_within
from cell.machine.gate import Gate
from cell.nodes.health import NodeMonitor
from cell.nodes.supervisor import Supervisor
from cell.nodes.watchdog import Watchdog
from cell.pick.detect import detect_unless_halted
from cell.pick.opening import Opening
from cell.pick.record import CycleLog
from cell.pick.stages import Stages
from config.hardware import FemtoMegaSettings, PandaHandSettings
from config.load import load_station
from config.schema import Station
from drivers.femto_mega.camera import FemtoMega
from drivers.interface import Devices
from drivers.node.loops import Loop
from drivers.panda_hand.hand import PandaHand
from logs.live import LiveView
from perception.models import open_models
from perception.models.calls import Call, GivenUp
from planning.robot import Robot
from stand_ins.franky import FakeHand
from stand_ins.orbbec import FakeOrbbec

OPERATOR = CommandRequest(client_id="op")


class Unforeseen(Exception):
    """No code of the product knows it."""


def broken(*_: Any, **__: Any) -> Any:
    raise Unforeseen("nobody foresaw this")


class Bench:
    """A daemon on a bus of its own, with devices that do nothing; ``ending``: what a start leaves running."""

    def __init__(self, station: Station, robot: Robot, ending: ExitStack, folder: Path) -> None:
        self.station, self.robot, self.ending, self.folder = station, robot, ending, folder
        still = SimpleNamespace(stop=lambda: None, recover=broken, state=lambda: SimpleNamespace(dq_rad_s=[0.0] * 7))
        devices = cast(Devices, SimpleNamespace(camera=still, arm=still, hand=still, presenter=None))
        self.bus = ending.enter_context(Bus.listen(station.cell_id, station.bus.endpoint))
        models = open_models(station, {})
        ending.callback(models.close)
        self.daemon = Daemon(station, self.bus, devices, robot, models, lambda topic, message: None)
        ending.enter_context(handled_by(self.daemon.on_defect))
        self.daemon.open()
        ending.callback(self.daemon.close)

    def until(self, state: str) -> None:
        give_up_s = time.monotonic() + 20
        while self.daemon.machine.state != state:
            assert time.monotonic() < give_up_s, f"still {self.daemon.machine.state}"
            time.sleep(0.005)

    def own(self, run: Callable[[], Any]) -> None:
        """As what an acting state does: what it raises is its own."""
        OwnedThread(Role.ACTION, run).start()


def _action(bench: Bench) -> None:
    bench.daemon.command("abort", OPERATOR)
    bench.until("Aborted")
    bench.daemon.command("clear", OPERATOR)  # recovers the arm, and meets what nobody foresaw


def _cycle_log(bench: Bench) -> None:
    CycleLog(broken, bench.folder / "c.mcap", 1.0)


def _model_call(bench: Bench) -> None:
    """It comes back when nobody waits any more, and cannot be booked."""
    goes_on = threading.Event()
    call = Call(goes_on.wait, broken, of="test")
    with suppress(GivenUp):
        call.wait(0.0, Cancel())
    goes_on.set()


def _record(_bench: Bench) -> None:
    log = cast(Any, SimpleNamespace(check=lambda: None))
    arm = ArmState(stamp_ns=1, mode=ArmMode.IDLE, q_rad=np.zeros(7), dq_rad_s=np.zeros(7), tau_ext_nm=np.zeros(7))
    view = View(stamp_ns=1, arm=arm, base_from_color=np.eye(4))
    Stages("c", broken, lambda _: None, log, Gate()).run("capture", topics.CAPTURE, lambda: view, meanwhile=True)


def _clock(bench: Bench) -> None:
    measures = iter([lambda: Starvation(1.0, 1.0, 2), broken])
    StarvedClock(measure=lambda: next(measures)()).start()


def _watchdog(bench: Bench) -> None:
    monitor = NodeMonitor(bench.station, lambda name, failure: None, lambda name: 0)
    watchdog = Watchdog(bench.station, monitor, broken, broken, broken, monitor.health)
    watchdog.start()
    bench.ending.callback(watchdog.close)


def _spawned(name: str, _station: Station) -> subprocess.Popen[str]:
    """A node's process that says it serves, and ends."""
    code = f"""print('{{"node": "{name}", "pid": 1}}')"""
    return subprocess.Popen(
        [sys.executable, "-S", "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def _supervisor(bench: Bench) -> None:
    supervisor = Supervisor(bench.station, on_exit=broken, spawn=_spawned)
    bench.ending.callback(supervisor.close)
    supervisor.start()


def _worker(bench: Bench) -> None:
    bench.bus.worker("broken").post(lambda: sys.exit("a library thought it was alone"))


def _hand(bench: Bench) -> None:
    fake = FakeHand()
    settings = PandaHandSettings(poll_s=0.005)
    hand = PandaHand(bench.station.model_copy(update={"panda_hand": settings}), fake.package, time.time_ns)
    hand.connect()
    bench.ending.callback(hand.close)
    fake.answers = broken


def _camera(bench: Bench) -> None:
    orbbec = FakeOrbbec()
    camera = FemtoMega(FemtoMegaSettings(address="127.0.0.1", settle_frames=1), orbbec.open)
    camera.connect()
    bench.ending.callback(camera.close)
    orbbec.odd.append(broken)


def _live_view(bench: Bench) -> None:
    view = LiveView(bench.bus, 0)
    bench.ending.callback(view.close)
    view._enqueue(cast(Any, object()))


def _robot_tf(bench: Bench) -> None:
    bus = SimpleNamespace(subscribe=lambda key, hear: None, publish=broken)
    tf = RobotTf(cast(Bus, bus), bench.robot, lambda heard: True)
    bench.ending.callback(tf.close)
    tf._arm = cast(Any, object())


def _retention(bench: Bench) -> None:
    settings = bench.station.recording.model_copy(update={"keep_days": 1.0})
    bench.ending.callback(Retention(settings, broken, clock_ns=broken).start().close)


def _catalogue(bench: Bench) -> None:
    """It cannot write, and cannot say so either."""
    (bench.folder / ".catalogue.lock").mkdir()
    bench.ending.callback(Cataloguer(bench.folder, broken).start().close)


STARTS: dict[Role, Callable[[Bench], Any]] = {
    Role.MACHINE: lambda bench: bench.daemon.machine.decide(broken),
    Role.ACTION: _action,
    Role.DETECT: lambda bench: bench.own(
        lambda: detect_unless_halted(cast(Any, None), bench.station, cast(Any, None), broken, lambda: False)
    ),
    Role.RECORD: _record,
    Role.MODEL_CALL: _model_call,
    Role.CYCLE_LOG: _cycle_log,
    Role.WATCHDOG: _watchdog,
    Role.SUPERVISOR: _supervisor,
    Role.WORKER: _worker,
    Role.LOOP: lambda bench: Loop("test", 0.01, broken, lambda error: None),
    Role.HAND: lambda bench: Opening(cast(Any, None), Gate(), broken).begin(),
    Role.HAND_POLL: _hand,
    Role.CAMERA_READ: _camera,
    Role.LIVE_VIEW: _live_view,
    Role.ROBOT_TF: _robot_tf,
    Role.RETENTION: _retention,
    Role.CATALOGUE: _catalogue,
    Role.CLOCK: _clock,
    Role.PROBE: lambda bench: answer_within(0.01, broken),
}


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(load_station())


@pytest.fixture
def bench(robot: Robot, endpoint: str, tmp_path: Path) -> Iterator[Bench]:
    station = load_station(None, [f"bus.endpoint={endpoint}", f"recording.folder={tmp_path}"])
    with ExitStack() as ending:
        yield Bench(station, robot, ending, tmp_path)


def test_every_role_of_the_cells_own_processes_is_here() -> None:
    """A door is a process beside the cell: what ends there ends the door, which is started again (test_doors).

    What closes at the end of a program that uses `vlad_cell` is no part of the cell either.
    """
    assert set(STARTS) == set(Role) - {Role.DOOR, Role.END}


@pytest.mark.parametrize("role", list(STARTS))
def test_an_unforeseen_end_aborts_the_cell_and_health_counts_it(bench: Bench, role: Role) -> None:
    with suppress(Unforeseen):  # who waits is told, too
        STARTS[role](bench)
    give_up_s = time.monotonic() + 20
    while not bench.daemon.health().defects and role is not Role.ACTION:
        assert time.monotonic() < give_up_s
        time.sleep(0.005)
    bench.until("Aborted")
    if role is not Role.ACTION:  # it ended as the machine's own work, which is the machine's to count
        assert not bench.daemon.health().is_healthy
    assert bench.daemon.command("clear", OPERATOR).code != "WRONG_STATE", "commands are answered all the same"


def test_a_cell_that_nobody_watches_any_more_does_not_reset(bench: Bench) -> None:
    bench.daemon._watchdog.close()
    bench.daemon.command("reset", OPERATOR)
    bench.until("Aborted")
    assert "watches the nodes" in bench.daemon.publisher.state.reason

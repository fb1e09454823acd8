"""The stages on the simulated devices, judged by MuJoCo's own truth and not by our verdict."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial

import numpy as np
import pytest

from bus.commands import PresentRequest
from bus.messages import Execution, Observation, Verdict
from cell.machine.gate import Gate
from cell.pick.capture import capture
from cell.pick.detect import detect
from cell.pick.execute import deliver, execute
from cell.pick.plan import plan
from cell.pick.verify import verify
from config.limits import check
from config.load import load_station
from drivers.node.guard import Guard
from drivers.node.registry import open_devices
from perception.models import open_models
from planning.robot import Robot

GATE = ("cup", "spatula")
OBJECTS = [*GATE, *(pytest.param(name, marks=pytest.mark.thorough) for name in ("bottle", "controller", "drone"))]
Pick = Callable[[str], "Outcome"]


class Outcome:
    """One pick, and where the object really was at each point of it (height [m])."""

    def __init__(self, name: str, friction: float, seed: int = 3) -> None:
        station = load_station(None, [f"sim.friction={friction}", f"sim.seed={seed}"])
        devices = open_devices("sim", station)
        camera, hand, presenter = devices.camera, devices.hand, devices.presenter
        assert camera is not None and devices.arm is not None and hand is not None and presenter is not None
        arm, robot = Guard(devices.arm, station), Robot(station)
        for device in (camera, arm, hand):
            device.connect()
        hand.home()
        presenter.present(PresentRequest(object=name, cycle=0, seed=seed))
        self.lay_m = presenter.truth().base_from_object[2, 3]
        before = capture(camera, arm, robot)
        found = detect([before], station, open_models(station, {}))
        chosen = plan(found, [before], robot, station)

        def look() -> Observation:
            self.held_m = presenter.truth().base_from_object[2, 3]
            return capture(camera, arm, robot)

        self.execution: Execution
        self.execution, after = execute(chosen, found.grasps[chosen.grasp], (arm, hand), look, robot, station, Gate())
        assert after is not None
        self.verdict: Verdict = verify(self.execution, found, found.grasps[chosen.grasp], before, after, robot, station)
        self.delivery = deliver(chosen, found.grasps[chosen.grasp], (arm, hand), station, Gate())
        self.place = presenter.truth().base_from_object[:3, 3]
        self.station = station
        camera.close()


@pytest.fixture(scope="module")
def picked() -> Pick:
    """One pick of each of the paper's objects with gripping fingers, made when it is first asked for."""
    return cache(partial(Outcome, friction=0.8))


@pytest.mark.parametrize("name", OBJECTS)
def test_the_object_really_rises_and_the_verdict_knows(picked: Pick, name: str) -> None:
    outcome = picked(name)
    assert outcome.held_m - outcome.lay_m > 0.10
    assert outcome.verdict.held and outcome.verdict.code is None
    assert outcome.verdict.hold_s == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize("name", OBJECTS)
def test_the_object_ends_in_the_tray(picked: Pick, name: str) -> None:
    outcome = picked(name)
    tray = outcome.station.scene.tray
    offset = np.abs(outcome.place[:2] - tray.center_m[:2])
    assert (offset < np.array(tray.size_m[:2]) / 2 + 0.05).all(), outcome.place


@pytest.mark.parametrize("name", OBJECTS)
def test_every_executed_trajectory_keeps_the_limits(picked: Pick, name: str) -> None:
    outcome = picked(name)
    runs = [*outcome.execution.runs, *outcome.delivery.runs]
    assert {run.name for run in runs} >= {"reach", "carry", "hold", "place", "home"}
    for run in runs:
        report = check(run.motion.commanded_q_rad)
        assert report.ok, f"{run.name}: {report.describe()}"


@pytest.mark.parametrize("name", OBJECTS)
def test_frictionless_fingers_lift_nothing_and_the_verdict_says_so(name: str) -> None:
    outcome = Outcome(name, friction=0.0)
    assert outcome.held_m - outcome.lay_m < 0.05
    assert not outcome.verdict.held and outcome.verdict.code in ("GRASP_MISSED", "DROPPED")

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

    def __init__(self, name: str, friction: float, seed: int = 3, settings: tuple[str, ...] = ()) -> None:
        station = load_station(None, [f"sim.friction={friction}", f"sim.seed={seed}", *settings])
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
            return capture(camera, arm, robot)

        self.execution: Execution
        self.execution, after = execute(chosen, found.grasps[chosen.grasp], (arm, hand), look, robot, station, Gate())
        self.held_m = presenter.truth().base_from_object[2, 3]
        self.verdict: Verdict = verify(self.execution, found, found.grasps[chosen.grasp], before, after, robot, station)
        self.delivery = deliver(chosen, found.grasps[chosen.grasp], (arm, hand), station, Gate())
        self.place = presenter.truth().base_from_object[:3, 3]
        self.station = station
        camera.close()


def _is_in_the_tray(outcome: Outcome) -> bool:
    tray = outcome.station.scene.tray
    offset = np.abs(outcome.place[:2] - tray.center_m[:2])
    return bool((offset < np.array(tray.size_m[:2]) / 2 + 0.05).all())


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
    assert _is_in_the_tray(picked(name)), picked(name).place


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


@pytest.mark.parametrize("name", OBJECTS)
def test_held_above_the_tray_it_is_clear_without_a_look_and_ends_there(name: str) -> None:
    outcome = Outcome(name, friction=0.8, settings=("verify.look=auto",))
    assert outcome.held_m - outcome.lay_m > 0.10
    assert outcome.verdict.held and outcome.verdict.cleared_fraction is None
    names = [run.name for run in (*outcome.execution.runs, *outcome.delivery.runs) if run.name != "hold"]
    assert names == ["reach", "carry", "place", "home"]
    assert _is_in_the_tray(outcome)


@pytest.mark.parametrize("name", OBJECTS)
def test_held_above_the_tray_it_is_taken_to_the_look_and_back_where_it_is_not_clear(name: str) -> None:
    outcome = Outcome(name, friction=0.8, settings=("verify.look=auto", "verify.clear_load_n=100"))
    assert outcome.verdict.held and (outcome.verdict.cleared_fraction or 0.0) > 0.9
    runs = [run for run in (*outcome.execution.runs, *outcome.delivery.runs) if run.name != "hold"]
    assert [run.name for run in runs] == ["reach", "carry", "aside", "return", "place", "home"]
    for run in runs:
        report = check(run.motion.commanded_q_rad)
        assert report.ok, f"{run.name}: {report.describe()}"
    assert _is_in_the_tray(outcome)


@pytest.mark.parametrize("name", OBJECTS)
def test_frictionless_fingers_are_found_out_above_the_tray_too(name: str) -> None:
    outcome = Outcome(name, friction=0.0, settings=("verify.look=auto",))
    assert outcome.held_m - outcome.lay_m < 0.05
    assert not outcome.verdict.held and outcome.verdict.code in ("GRASP_MISSED", "DROPPED")

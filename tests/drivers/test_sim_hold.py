"""What a held motion costs in simulation, and what ends it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from bus.errors import DriverError
from bus.messages import Motion
from bus.trajectory import Trajectory
from config.load import load_station
from drivers.sim.arm import SimArm
from drivers.sim.world import World


class Bench:
    """A long motion of the simulated arm, held at rest."""

    def __init__(self) -> None:
        self.world = World(load_station())
        self.arm = SimArm(self.world)
        self.arm.connect()
        q_rad = np.repeat(self.arm.state().q_rad[None], 20_000, axis=0)
        q_rad[:, 6] += 0.5 * (1 - np.cos(np.linspace(0, np.pi, len(q_rad))))
        self.trajectory = Trajectory(raw_q_rad=q_rad, window=64)
        self.ended: list[Motion] = []
        self.thread = threading.Thread(target=lambda: self.ended.append(self.arm.execute(self.trajectory)))
        started_s = self.time_s()
        self.thread.start()
        self._until(lambda: self.time_s() > started_s + 0.2)
        self.arm.hold()
        with self.world.turns.taken():
            pass  # the arm lends its turn to tick only while it is held at rest

    def _until(self, holds: Callable[[], bool]) -> None:
        give_up_s = time.monotonic() + 60
        while not holds():
            assert time.monotonic() < give_up_s
            time.sleep(0.001)

    def time_s(self) -> float:
        with self.world.lock:
            return float(self.world.data.time)

    def cpu_s(self) -> float:
        """What the motion's thread has computed so far."""
        assert self.thread.ident is not None
        return time.clock_gettime(time.pthread_getcpuclockid(self.thread.ident))

    def time_s_later(self) -> float:
        time.sleep(0.05)
        return self.time_s()

    def end(self) -> Motion:
        self.thread.join(timeout=60)
        (motion,) = self.ended
        return motion


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.arm.stop()
    bench.thread.join(timeout=60)


def test_while_held_no_time_passes_and_nothing_is_computed(bench: Bench) -> None:
    before_s, cpu_s = bench.time_s(), bench.cpu_s()
    assert bench.time_s_later() == before_s
    assert bench.cpu_s() - cpu_s < 0.04  # of the 0.05 s waited
    assert np.abs(bench.arm.state().dq_rad_s).max() < 1e-3


def test_the_samples_tell_the_motion_without_the_wait(bench: Bench) -> None:
    bench.arm.resume()
    motion = bench.end()
    assert motion.finished
    assert np.diff(motion.t_s).max() < 0.016
    assert motion.t_s[-1] == pytest.approx(len(motion.commanded_q_rad) / 1000)
    assert len(motion.commanded_q_rad) < 1.1 * len(bench.trajectory.filtered())


@pytest.mark.parametrize("how", ["stop", "close"])
def test_a_stop_or_a_close_ends_it(bench: Bench, how: str) -> None:
    getattr(bench.arm, how)()
    assert not bench.end().finished


def test_after_an_error_in_a_motion_the_arm_comes_to_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(load_station())
    arm = SimArm(world)
    arm.connect()
    start = arm.state().q_rad
    swing = start + 0.4 * (1 - np.cos(np.linspace(0, np.pi, 900)))[:, None] * np.eye(7)[0]
    readings = iter(range(1000))
    measure = world.arm

    def failing() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if next(readings) == 45:
            raise DriverError("The encoder was lost.", "Check it.")
        return measure()

    monkeypatch.setattr(world, "arm", failing)
    with pytest.raises(DriverError, match="encoder"):
        arm.execute(Trajectory(raw_q_rad=swing, window=64))
    q_rad, dq_rad_s, _ = measure()
    assert np.abs(dq_rad_s).max() < 1e-2
    assert 0.1 < q_rad[0] - start[0] < 0.8

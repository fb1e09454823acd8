"""How long a process waits for the machine is what the kernel counted of its threads, and how many want to run."""

from __future__ import annotations

import pytest

from bus.starvation import Starvation, StarvationMeter, load_now


class Kernel:
    """The counts of the kernel, as the test wants them."""

    def __init__(self) -> None:
        self.threads: dict[str, tuple[float, float]] = {}
        self.runnable = 0.0

    def meter(self, cores: int = 2) -> StarvationMeter:
        return StarvationMeter(lambda: dict(self.threads), lambda: self.runnable, cores)

    def grant(self, thread: str, ran_s: float, waited_s: float) -> None:
        before = self.threads.get(thread, (0.0, 0.0))
        self.threads[thread] = (before[0] + ran_s, before[1] + waited_s)


@pytest.fixture
def kernel() -> Kernel:
    return Kernel()


def test_who_never_waits_for_a_core_is_not_slowed_down(kernel: Kernel) -> None:
    meter = kernel.meter()
    kernel.grant("1", ran_s=0.2, waited_s=0.0)
    assert meter.measure().slowdown == 1.0


def test_who_waits_nine_tenths_of_the_time_takes_ten_times_as_long(kernel: Kernel) -> None:
    meter = kernel.meter()
    for _ in range(20):
        kernel.grant("1", ran_s=0.1, waited_s=0.9)
        kernel.grant("2", ran_s=0.1, waited_s=0.9)
        starvation = meter.measure()
    assert starvation.slowdown == pytest.approx(10.0, rel=0.05)


def test_what_was_before_the_first_measurement_does_not_count(kernel: Kernel) -> None:
    kernel.grant("1", ran_s=1.0, waited_s=60.0)
    meter = kernel.meter()
    kernel.grant("1", ran_s=0.2, waited_s=0.0)
    assert meter.measure().slowdown == 1.0


def test_a_starvation_that_is_over_is_soon_forgotten(kernel: Kernel) -> None:
    meter = kernel.meter()
    kernel.grant("1", ran_s=0.1, waited_s=2.0)
    slowdowns = []
    for _ in range(8):
        slowdowns.append(meter.measure().slowdown)
        kernel.grant("1", ran_s=0.1, waited_s=0.0)
    assert slowdowns[0] > 10.0 and slowdowns[-1] < 1.1
    assert slowdowns == sorted(slowdowns, reverse=True)


def test_threads_that_begin_and_end_meanwhile_are_no_riddle(kernel: Kernel) -> None:
    kernel.grant("1", ran_s=100.0, waited_s=100.0)
    meter = kernel.meter()
    kernel.threads = {}
    kernel.grant("2", ran_s=0.1, waited_s=0.1)
    assert meter.measure().slowdown == pytest.approx(2.0, rel=0.05)
    kernel.threads = {"2": (0.05, 0.0)}  # another one, that was given the number
    assert 1.0 <= meter.measure().slowdown < 2.0


def test_a_process_that_hardly_runs_does_not_cry_for_one_late_moment(kernel: Kernel) -> None:
    meter = kernel.meter()
    kernel.grant("1", ran_s=0.0001, waited_s=0.004)
    assert meter.measure().slowdown < 2.0


def test_more_that_want_to_run_than_cores_slow_everybody_down(kernel: Kernel) -> None:
    """Also those that wait for us on the other side, which we do not measure."""
    meter = kernel.meter(cores=2)
    kernel.runnable = 14.0
    for _ in range(10):
        starvation = meter.measure()
    assert starvation.slowdown == pytest.approx(7.0, rel=0.01)


def test_where_the_kernel_counts_nothing_nobody_is_slowed_down() -> None:
    assert StarvationMeter(dict, lambda: 0.0, 2).measure() == Starvation(1.0, 0.0, 2)


def test_this_process_can_be_measured() -> None:
    meter = StarvationMeter()
    assert sum(range(1_000_000)) > 0
    starvation = meter.measure()
    assert starvation.slowdown >= 1.0 and starvation.load > 0.0 and starvation.cores >= 1


@pytest.mark.parametrize(
    ("starvation", "words"),
    [
        (Starvation(1.4, 2.0, 2), ""),
        (Starvation(1.4, 12.0, 2), "This machine is too busy: load 12.0 on 2 cores."),
        (Starvation(27.4, 14.0, 2), "This machine is too busy: load 14.0 on 2 cores, and a second of work takes 27 s."),
        (Starvation(9.0, 0.5, 2), "This machine is too busy: load 0.5 on 2 cores, and a second of work takes 9 s."),
    ],
)
def test_a_busy_machine_is_called_that_with_its_figures(starvation: Starvation, words: str) -> None:
    assert starvation.in_words() == words


def test_of_a_real_cells_machine_only_the_load_is_looked_at() -> None:
    assert load_now().slowdown == 1.0

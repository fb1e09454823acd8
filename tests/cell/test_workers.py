"""Work on many items: in one process, in several, on a cluster; with workers that die."""

from __future__ import annotations

import json
import shutil
import signal
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from bus.errors import CellUnreachable, ConfigError
from cell.cli.commands import command_line
from cell.workers import ClusterWorkers, LocalWorkers, WorkerLost, Workers, here, in_order, workers_for
from cell.workers import cluster as cluster_
from cell.workers.local import _uninterrupted
from tests.cell.worker_bench import deadly, fails, on_interrupt, squared

PICK = Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap"


def test_workers_give_the_same_however_many_they_are() -> None:
    for count in (1, 2):
        assert dict(LocalWorkers(count).run(squared, range(6))) == {number: number**2 for number in range(6)}
    assert list(LocalWorkers(2).run(squared, [])) == []
    assert [number for number, _ in in_order([(2, "c"), (0, "a"), (1, "b")])] == [0, 1, 2]


def test_a_worker_that_dies_costs_a_try_and_what_kills_each_of_them_is_named(tmp_path: Path) -> None:
    done = dict(LocalWorkers(2).run(partial(deadly, marks=tmp_path), range(4)))
    assert isinstance(done.pop(2), WorkerLost) and done == {0: 0, 1: 1, 3: 9}


def test_a_defect_in_the_work_is_raised_where_it_was_asked_for() -> None:
    with pytest.raises(ZeroDivisionError):
        list(LocalWorkers(2).run(fails, range(2)))


def test_ctrl_c_reaches_no_worker_not_even_while_it_imports() -> None:
    """The terminal sends it to all of them; the caller dismisses them, and they leave no traceback."""
    assert dict(LocalWorkers(2).run(on_interrupt, range(2))) == dict.fromkeys(range(2), (False, True))
    with _uninterrupted():
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_few_items_are_not_worth_a_process() -> None:
    assert workers_for(3, None, "") == LocalWorkers(1)
    assert workers_for(1000, None, "") == LocalWorkers(max(1, here()))
    assert workers_for(1000, 7, "") == LocalWorkers(7)


def test_a_folder_replays_the_same_with_two_workers(tmp_path: Path) -> None:
    for name in ("one", "two"):
        shutil.copy(PICK, tmp_path / f"{name}.mcap")
    (tmp_path / "torn.mcap").write_bytes(PICK.read_bytes()[:9000])
    once = ["replay", str(tmp_path), "--only", "verify", "--set", "verify.min_width_m=0.079", "--json", "--workers"]
    alone, two = (CliRunner().invoke(command_line(), [*once, count]) for count in ("1", "2"))
    assert alone.stdout == two.stdout and alone.exit_code == two.exit_code == 1
    assert json.loads(two.stdout)["different"] == 2 and alone.stderr == two.stderr


# --- a cluster --------------------------------------------------------------------------------------------------------


def test_a_cluster_needs_dask_and_a_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"vlad-cell\[cluster\]"):
        workers_for(5, None, "tcp://127.0.0.1:1")


def test_a_cluster_gives_the_same_on_loopback_also_when_a_worker_dies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dask, distributed, psutil = (pytest.importorskip(name) for name in ("dask", "distributed", "psutil"))
    quick = {"distributed.worker.multiprocessing-method": "forkserver", "distributed.scheduler.allowed-failures": 1}
    with dask.config.set(quick), distributed.LocalCluster(**_ON_LOOPBACK) as cluster:
        assert {ip for process in _with_children(psutil) for ip in _listens_at(process)} == {"127.0.0.1"}
        workers: Workers = ClusterWorkers(cluster.scheduler_address)
        assert dict(workers.run(squared, range(4))) == dict(LocalWorkers(1).run(squared, range(4)))
        assert dict(workers.run(partial(deadly, marks=tmp_path), [0, 1, 3])) == {0: 0, 1: 1, 2: 9}
        assert (tmp_path / "0").exists(), "its worker died once"
        done = dict(workers.run(partial(deadly, marks=tmp_path), [0, 1, 2, 3]))
        assert isinstance(done.pop(2), WorkerLost) and done == {0: 0, 1: 1, 3: 9}
    monkeypatch.setattr(cluster_, "_PATIENCE_S", 0.5)
    with pytest.raises(CellUnreachable):
        list(workers.run(squared, range(2)))


_ON_LOOPBACK: dict[str, Any] = {
    "host": "127.0.0.1", "n_workers": 1, "threads_per_worker": 1,
    "dashboard_address": "127.0.0.1:0", "scheduler_kwargs": {"dashboard": False}, "worker_dashboard_address": None,
}  # fmt: skip
"""Without the dashboard a scheduler still says over HTTP that it lives; by its own default to everybody."""


def _with_children(psutil: Any) -> list[Any]:
    here = psutil.Process()
    return [here, *here.children(recursive=True)]


def _listens_at(process: Any) -> list[str]:
    return [one.laddr.ip for one in process.net_connections("tcp") if one.status == "LISTEN"]

"""Runs whole cells: each object alone, or a heap until it is empty; then asks the oracle about what was not held."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

import config
from benchmarks.heaps import oracle, sides
from benchmarks.held.figures import figures
from benchmarks.held.holdable import why_not
from benchmarks.held.operator import operated
from benchmarks.held.rounds import Pick
from benchmarks.held.watched import NODE
from bus.errors import ConfigError
from cell.workers import LocalWorkers, WorkerLost, Workers, ordered
from config.load import load_station
from config.schema import Station
from drivers.sim.mjcf import require_plausible
from drivers.sim.objects import object_file, object_names
from perception.detectors.registry import OURS

MOUNTING_ERROR = ("sim.mounting_error_mm=1.0", "sim.mounting_error_deg=0.3")
"""Of the camera, in a direction that the seed gives: what a good hand-eye calibration leaves."""
NETWORK = "onnx:"
_ALONE = LocalWorkers(1)
_BIN = Path(config.__file__).with_name("bin.toml")


@dataclass(frozen=True)
class Wanted:
    """The picks to be made.

    Attributes:
        objects: folder of objects; None = the paper's five.
        first: at most so many objects, of a folder in a seeded order; None = all of them.
        orientations: picks of each object alone. ``bin``: objects of a heap in a bin; 0 = each object alone.
        overrides: settings of the station, as ``key=value``. ``pace``: as ``sim.pace``.
        detector: ``vlad``: ours; ``onnx:PATH``: a grasp network's file in the role of the model; else the name of
            another package's detector.
    """

    objects: Path | None
    seeds: Sequence[int]
    endpoint: str
    first: int | None = None
    orientations: int = 1
    bin: int = 0
    pace: float = 0.0
    detector: str = OURS
    overrides: tuple[str, ...] = ()

    def station(self, seed: int, objects: Path | None, recordings: Path) -> Station:
        """Return the station of one seed."""
        own = [f"sim.seed={seed}", f"sim.pace={self.pace}", *MOUNTING_ERROR, f"nodes.{NODE}.run=elsewhere"]
        own += [f"bus.endpoint={self.endpoint}", f"recording.folder={recordings}"]
        own += [] if objects is None else [f"sim.objects={objects}"]
        own += [f"sim.clutter={self.bin}", "sim.heaped=true"] if self.bin else []
        if self.detector.startswith(NETWORK):
            own += ["perception.model=onnx", f"perception.onnx.path={self.detector.removeprefix(NETWORK)}"]
        else:
            own += [f"perception.detector={self.detector}"]
        return load_station(_BIN if self.bin else None, [*own, *self.overrides])


def beside(wanted: Wanted, tell: Callable[[str], None], workers: Workers = _ALONE) -> dict[str, Any]:
    """Return the figures of `run`; of another detector beside ours, with the same objects, seeds and judge."""
    if wanted.detector == OURS:
        return run(wanted, tell, workers)
    ours = run(replace(wanted, detector=OURS), partial(_named, OURS, tell), workers)
    peer = run(wanted, partial(_named, wanted.detector, tell), workers)
    return {"detector": wanted.detector, "ours": ours, "peer": peer}


def _named(detector: str, tell: Callable[[str], None], line: str) -> None:
    tell(f"{detector}: {line}")


def run(wanted: Wanted, tell: Callable[[str], None], workers: Workers = _ALONE) -> dict[str, Any]:
    """Return the figures of all picks of all seeds.

    Args:
        workers: each works on one seed at a time, with a cell of its own; the picks are the same whoever does.

    Raises: WorkerLost when one does not survive its seed.
    """
    picks: list[Pick] = []
    binned: list[tuple[int, int]] = []
    taken_away, refused = 0, list[str]()
    ports = [
        replace(wanted, endpoint=_apart(wanted.endpoint, at), seeds=(seed,)) for at, seed in enumerate(wanted.seeds)
    ]
    for of_seed in ordered(workers, partial(_of_seed, tell=tell), ports):
        if isinstance(of_seed, WorkerLost):
            raise of_seed
        picks += of_seed.picks
        binned += of_seed.binned
        taken_away += of_seed.taken_away
        refused = of_seed.refused
    return figures(picks, binned, is_paced=wanted.pace > 0) | {"taken_away": taken_away, "left_out": refused}


class _Done(NamedTuple):
    """The judged picks of one seed; of a heap, how many objects lay in the bin and how many were left."""

    picks: list[Pick]
    binned: list[tuple[int, int]]
    taken_away: int
    refused: list[str]


def _of_seed(wanted: Wanted, tell: Callable[[str], None]) -> _Done:
    (seed,) = wanted.seeds
    with TemporaryDirectory() as scratch:
        objects, refused = chosen(wanted, Path(scratch))
        for why in refused:
            tell(f"left out: {why}")
        binned = []
        with operated(wanted.station(seed, objects, Path(scratch) / "recordings")) as operator:
            if wanted.bin:
                done, left = operator.empty(seed, tell)
                binned.append((wanted.bin, left))
            else:
                names = object_names(objects)[: wanted.first] * wanted.orientations
                done = [operator.pick(name, seed, f"{at + 1}/{len(names)}", tell) for at, name in enumerate(names)]
            taken_away = operator.taken_away
        for pick in done:
            judge(pick)
        return _Done([replace(pick, scene=None) for pick in done], binned, taken_away, refused)


def _apart(endpoint: str, number: int) -> str:
    """The endpoint of one of several cells that run at once: each listens at a port of its own."""
    address, _, port = endpoint.rpartition(":")
    return f"{address}:{int(port) + number}"


def chosen(wanted: Wanted, scratch: Path) -> tuple[Path | None, list[str]]:
    """Return a folder of the objects to pick, and why others of the folder cannot be. Raises: ConfigError.

    Into a bin come only those that the jaw could hold: it is judged by how empty it gets.
    """
    if wanted.objects is None:
        return None, []
    station = load_station(_BIN if wanted.bin else None, wanted.overrides)
    names, refused, folder = object_names(wanted.objects), [], scratch / wanted.objects.name
    folder.mkdir()
    order = [names[index] for index in np.random.default_rng(0).permutation(len(names))]
    taken = 0
    for name in order:
        if taken == wanted.first:
            break
        try:
            require_plausible(file := object_file(wanted.objects, name), station.scene.pick_region_m)
        except ConfigError as error:
            refused.append(str(error))
            continue
        if wanted.bin and (why := why_not(file, station)):
            refused.append(f"{name}: {why}")
            continue
        own = file.parent if file.name == "object.xml" else file
        (folder / own.name).symlink_to(own.resolve())
        taken += 1
    for shared in wanted.objects.glob("*.xml"):  # what the objects' files include
        (folder / shared.name).symlink_to(shared.resolve())
    return folder, refused


def judge(pick: Pick) -> None:
    """Ask the oracle about a pick that held nothing: from above, then from every side."""
    if pick.is_held or pick.scene is None or not pick.scene.names:
        pick.feasible = pick.is_held
        return
    pick.feasible = any(search(pick.scene).base_from_tcp is not None for search in (oracle.search, sides.search))

"""More than one thing in the hand: how often the verdict misses it when it is provoked, and says it of a single thing.

The truth is the simulation's: the bodies that rose with the hand. Each execution is judged four times, because a
verdict is pure: with the look that is always taken; as ``verify.look = "auto"`` would (the look only where `is_clear`
asks for it); with the weight of one piece known (``verify.max_load_n``); and with the seam between colours asked, too,
as a station may whose objects have one colour each (``verify.several_by``).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import count, islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import config
from benchmarks.interfaces.pieces import KINDS, Jaw, Pair, drawn, lay
from bus.codes import Code
from bus.errors import CellError, CycleFailure
from bus.messages import Detections, Execution, Grasp, Observation, PickPlan, Verdict
from cell.machine.gate import Gate
from cell.pick.capture import capture
from cell.pick.detect import detect
from cell.pick.execute import execute
from cell.pick.plan import plan
from cell.pick.several import one_thing
from cell.pick.verify import is_clear, verify
from config.load import load_station
from config.schema import Station
from drivers.node.guard import Guard
from drivers.sim.arm import SimArm
from drivers.sim.camera import SimCamera
from drivers.sim.hand import SimHand
from drivers.sim.world import World
from perception.models import open_models
from perception.scene.change import points_of
from perception.scene.surroundings import surroundings
from planning.height_field import Sight
from planning.pick import plan_pick
from planning.robot import Robot
from planning.scene import Scene

WAYS = ("always", "auto", "weighed", "seam")
SINGLE_KINDS = ("alone", "beside", "heap")
"""The paper's objects; one of two touching blocks, by the product's own grasp; one of a heap in the bin."""
NEEDS_OBJECTS = ("binned", "heap")
RISEN_M = 0.05
_PAPER = ("cup", "spatula", "bottle", "controller", "drone")
_PARTS = dict(zip((*KINDS[:6], "beside", *KINDS[6:]), range(99), strict=False))
"""Tells the drawn numbers of one kind from those of the others."""
_HEAPED, _AMONG = 4, 3
_REACHES_M = 0.04
"""From the middle between the fingers: what lies so near is in between."""
_AS_MANY_MORE = 4
"""A kind that can often not be provoked is given up after so many times the scenes that were asked for."""
_G_M_S2 = 9.81


@dataclass(frozen=True)
class Judged:
    """One execution.

    Attributes:
        risen: how many bodies rose. ``things``: how many things perception told apart before.
        verdicts: by each of `WAYS`.
    """

    risen: int
    things: int
    verdicts: dict[str, Verdict]


class Bench:
    """One world with the simulated devices; the arm is where it looks from."""

    def __init__(self, settings: Sequence[str], base: Path | None = None) -> None:
        self.station: Station = load_station(base, ["verify.look=always", "verify.hold_s=0.3", *settings])
        self.robot, self.world = Robot(self.station), World(self.station)
        self.camera, self.hand = SimCamera(self.world), SimHand(self.world)
        self.arm = Guard(SimArm(self.world), self.station)
        for device in (self.camera, self.arm, self.hand):
            device.connect()
        self.hand.home()

    def look(self) -> Observation:
        """Capture from where the arm is."""
        return capture(self.camera, self.arm, self.robot)

    def judged(self, before: Observation, found: Detections, chosen: PickPlan) -> Judged | None:
        """Execute, and judge; None when it did not come to its hold."""
        grasp, lay_m = found.grasps[chosen.grasp], self._heights_m()
        execution, after = execute(
            chosen, grasp, (self.arm, self.hand), self.look, self.robot, self.station, Gate()
        )  # fmt: skip
        if execution.grasped is None or after is None:
            return None
        risen = int((self._heights_m() - lay_m > RISEN_M).sum())
        return Judged(risen, len(found.scene.instances), self._verdicts(execution, found, grasp, before, after))

    def _verdicts(
        self, execution: Execution, found: Detections, grasp: Grasp, before: Observation, after: Observation
    ) -> dict[str, Verdict]:
        def said(seen: Observation | None, station: Station) -> Verdict:
            return verify(execution, found, grasp, before, seen, self.robot, station)

        assert execution.grasped is not None
        clear = is_clear(
            grasp, execution.grasped, execution.runs, self.robot, self.station, lambda: one_thing(found, grasp, before)
        )

        def with_its(**settings: object) -> Station:
            return self.station.model_copy(update={"verify": self.station.verify.model_copy(update=settings)})

        return {
            "always": said(after, self.station),
            "auto": said(None if clear else after, self.station),
            "weighed": said(after, with_its(max_load_n=1.5 * self._heaviest_n())),
            "seam": said(after, with_its(several_by=(*self.station.verify.several_by, "seam"))),
        }

    def _heights_m(self) -> np.ndarray:
        return np.array([self.world.base_from_object(body)[2, 3] for body in self.world.objects])

    def _heaviest_n(self) -> float:
        return _G_M_S2 * max(float(self.world.model.body(body).subtreemass[0]) for body in self.world.objects)


@contextmanager
def bench(settings: Sequence[str], base: Path | None = None) -> Iterator[Bench]:
    """A world that closes its camera at the end. Raises: ConfigError, DriverError."""
    made = Bench(settings, base)
    try:
        yield made
    finally:
        made.camera.close()


# --- what is picked ---------------------------------------------------------------------------------------------------


def provoked(kind: str, seed: int, objects: Path | None = None) -> Judged | None:
    """Close on both pieces of a drawn pair; None when that could not be done.

    Args:
        objects: folder of what lies beside a pair that is ``binned``.
    """
    rng = np.random.default_rng([seed, _PARTS[kind]])
    with _pair(drawn(kind, rng), seed, objects if kind == "binned" else None) as (pair, here):
        jaw = lay(pair, here.world, rng)
        before = here.look()
        found = detect([before], here.station, open_models(here.station, {}))
        grasp = _on_both(found, jaw, before, seed, here.station.hand.max_width_m)
        labels = found.scene.labels
        is_pair = labels > 0 if kind != "binned" else np.isin(labels, _near(found, jaw, before))
        target = Sight(*surroundings(before, is_pair), before.view.q_rad)
        wide = grasp.model_copy(update={"width_m": jaw.width_m})
        chosen = plan_pick(Scene.of(here.robot, here.station, target), [wide], before.view.q_rad)
        # the first grasp stays: the evidence is of its thing
        found = found.model_copy(update={"grasps": (found.grasps[0], grasp)})
        return here.judged(before, found, chosen.model_copy(update={"grasp": 1}))


def _on_both(found: Detections, jaw: Jaw, before: Observation, seed: int, opening_m: float) -> Grasp:
    """The grasp of a pair, as that of the thing that lies nearest; every second one expects only that one's width."""
    middle_m = jaw.base_from_tcp[:2, 3]
    one = min(found.scene.instances, key=lambda thing: float(np.linalg.norm(thing.top_m[:2] - middle_m)))
    its = [grasp.width_m for grasp in found.grasps if grasp.instance == one.number]
    planned_m = jaw.width_m if seed % 2 else min([*its[:1], jaw.width_m])
    update = {"base_from_tcp": jaw.base_from_tcp, "width_m": planned_m, "opening_m": opening_m, "instance": one.number}
    return found.grasps[0].model_copy(update=update)


def _near(found: Detections, jaw: Jaw, before: Observation) -> list[int]:
    """The numbers of the things that reach between the fingers."""

    def away_m(number: int) -> float:
        points = points_of(found, number, before)
        return float(np.linalg.norm(points[:, :2] - jaw.base_from_tcp[:2, 3], axis=1).min()) if len(points) else np.inf

    return [one.number for one in found.scene.instances if away_m(one.number) < _REACHES_M]


def single(kind: str, seed: int, objects: Path | None) -> Judged | None:
    """Pick as the product does; None when it finds no way."""
    if kind == "alone":
        with bench([f"sim.seed={seed}"]) as here:
            here.world.present(_PAPER[seed % len(_PAPER)], seed)
            return _picked(here)
    if kind == "heap":
        with TemporaryDirectory() as scratch:
            _link_some(objects, Path(scratch), seed, _HEAPED)
            settings = [f"sim.seed={seed}", f"sim.clutter={_HEAPED}", "sim.heaped=true", f"sim.objects={scratch}"]
            with bench(settings, Path(config.__file__).with_name("bin.toml")) as here:
                return _picked(here)
    rng = np.random.default_rng([seed, _PARTS["beside"]])
    with _pair(drawn("touching", rng), seed) as (pair, here):
        lay(pair, here.world, rng)
        return _picked(here)


def _picked(here: Bench) -> Judged | None:
    before = here.look()
    found = detect([before], here.station, open_models(here.station, {}))
    return here.judged(before, found, plan(found, [before], here.robot, here.station))


@contextmanager
def _pair(pair: Pair, seed: int, among: Path | None = None) -> Iterator[tuple[Pair, Bench]]:
    """A world with a pair, alone on the table or in a bin ``among`` a few things of a folder of objects."""
    with TemporaryDirectory() as scratch:
        pair.write(Path(scratch))
        settings, base = [f"sim.seed={seed}", "sim.clutter=2", f"sim.objects={scratch}"], None
        if among is not None:
            _link_some(among, Path(scratch), seed, _AMONG)
            settings += [f"sim.clutter={2 + _AMONG}", "sim.heaped=true"]
            base = Path(config.__file__).with_name("bin.toml")
        with bench(settings, base) as here:
            yield pair, here


def _link_some(objects: Path | None, into: Path, seed: int, number: int) -> None:
    """Of a folder of objects link a seeded few, because every one of them is compiled when a world is made."""
    if objects is None:
        raise ValueError("a heap needs a folder of objects")
    names = sorted(path.parent.name for path in objects.glob("*/object.xml"))
    for name in np.random.default_rng([seed, 7]).choice(names, number, replace=False):
        (into / str(name)).symlink_to((objects / str(name)).resolve())


# --- the figures ------------------------------------------------------------------------------------------------------


def multi_pick(
    tries: int,
    singles: int,
    seed: int,
    tell: Callable[[str], None],
    objects: Path | None = None,
    kinds: Sequence[str] = (*KINDS, *SINGLE_KINDS),
) -> dict[str, Any]:
    """Return the figures of so many provoked picks of each of `KINDS`, and single ones of each of `SINGLE_KINDS`.

    Args:
        seed: the first one. ``objects``: folder of objects for the heap; None = no heap. ``kinds``: only these.
    """
    by_kind: dict[str, dict[str, Any]] = {}
    for kind in kinds:
        if kind in NEEDS_OBJECTS and objects is None:
            continue
        if kind in KINDS:
            made = _all(partial(provoked, kind, objects=objects), tries, seed, kind, tell, risen=2)
            by_kind[kind] = _unnoticed(list(islice(made, tries)))
        else:
            made = _all(partial(single, kind, objects=objects), singles, seed, kind, tell, risen=1)
            by_kind[kind] = _false_alarms(list(islice(made, singles)))
    return summed(by_kind)


def summed(by_kind: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of some kinds with their sums."""
    several, one = ([by_kind[kind] for kind in some if kind in by_kind] for some in (KINDS, SINGLE_KINDS))
    return {
        "provoked": sum(kind["n"] for kind in several),
        "unnoticed": {way: sum(kind["unnoticed"][way] for kind in several) for way in WAYS},
        "singles": sum(kind["n"] for kind in one),
        "false_alarms": {way: sum(kind["false_alarms"][way] for kind in one) for way in WAYS},
        "by_kind": by_kind,
    }


def _all(
    make: Callable[[int], Judged | None], wanted: int, seed: int, name: str, tell: Callable[[str], None], risen: int
) -> Iterator[Judged]:
    """Yield what rose as it should: two or more bodies, or one."""
    for at in islice(count(seed), _AS_MANY_MORE * wanted):
        try:
            judged = make(at)
        except (CycleFailure, CellError) as error:
            tell(f"{name} {at}: {error.text}")
            continue
        if judged is None:
            tell(f"{name} {at}: it did not come to its hold")
            continue
        codes = " ".join(f"{way}={one.code or 'held'}" for way, one in judged.verdicts.items())
        tell(f"{name} {at}: {judged.risen} rose, {codes} {judged.verdicts['always'].reason}")
        if min(judged.risen, 2) == risen:
            yield judged


def _unnoticed(some: Sequence[Judged]) -> dict[str, Any]:
    """Of picks with several: those that the cell takes for a success, and those with another failure's code."""
    missed = {way: sum(one.verdicts[way].held for one in some) for way in WAYS}
    named = {way: sum(one.verdicts[way].code is Code.MULTI_PICK for one in some) for way in WAYS}
    apart = [one for one in some if one.things > 1]
    told = {"n": len(apart), "unnoticed": {way: sum(one.verdicts[way].held for one in apart) for way in WAYS}}
    return {"n": len(some), "unnoticed": missed, "named": named, "by": _witnesses(some), "told_apart": told}


def _false_alarms(some: Sequence[Judged]) -> dict[str, Any]:
    alarms = {way: sum(one.verdicts[way].code is Code.MULTI_PICK for one in some) for way in WAYS}
    return {"n": len(some), "false_alarms": alarms, "by": _witnesses(some)}


def _witnesses(some: Sequence[Judged]) -> dict[str, int]:
    found: dict[str, int] = defaultdict(int)
    for one in some:
        for witness in {*one.verdicts["weighed"].several_by, *one.verdicts["seam"].several_by}:
            found[witness] += 1
    return dict(found)

"""Checks the judge against physics: how often a judged grasp is lifted, by verdict."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.heaps.candidates import Truth
from benchmarks.heaps.heap import Heap
from benchmarks.heaps.judge import COLLIDES, SEAM, TRUE, Judge, Verdict
from benchmarks.heaps.lift import lift
from benchmarks.heaps.oracle import is_robust

_ON_FACES, _ANYWHERE = 300, 4000
_JUDGED = 120

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Judged:
    """One grasp with its verdict."""

    heap: Heap
    base_from_tcp: Array
    opening_m: float
    verdict: Verdict

    def is_robust(self) -> bool:
        """Whether it is true under small errors, too."""
        return self.verdict.name == TRUE and is_robust(Judge.of(self.heap), self.base_from_tcp, self.opening_m)


def against_physics(heaps: Iterable[Heap], lifts: int) -> dict[str, Any]:
    """Lift judged grasps, two of each scene in turn: one that is true, and one of another verdict.

    Returns:
        Lifts by verdict, and how often judge and physics disagree. Held = the judged body, of a seam any, rose with
        the hand; for a collision it counts whether the hand was touched on its way down.
    """
    seen: dict[str, Counter[str]] = defaultdict(Counter)
    count = 0
    for one in _drawn(heaps):
        if count == lifts:
            break
        count += 1
        done = lift(one.heap, one.base_from_tcp, one.opening_m)
        tally = seen[one.verdict.name]
        tally["lifts"] += 1
        tally["unstable"] += done.unstable
        tally["touched"] += done.touched
        tally["held"] += bool(done.held) if one.verdict.body is None else one.verdict.body in done.held
        if one.is_robust():
            tally["robust"] += 1
            tally["robust_held"] += one.verdict.body in done.held
        tally["with_others"] += len(done.held) > 1
    return {"lifts": count, **_disagreements(seen), "by_verdict": {name: dict(seen[name]) for name in sorted(seen)}}


def _disagreements(seen: dict[str, Counter[str]]) -> dict[str, Any]:
    true = seen[TRUE]
    others = [name for name in seen if name not in (TRUE, COLLIDES, SEAM)]
    return {
        "true_but_lost": true["lifts"] - true["held"],
        "of_true": true["lifts"],
        "robust_but_lost": true["robust"] - true["robust_held"],
        "of_robust": true["robust"],
        "not_true_but_held": sum(seen[name]["held"] for name in others),
        "of_not_true": sum(seen[name]["lifts"] for name in others),
        "free_but_touched": sum(tally["touched"] for name, tally in seen.items() if name != COLLIDES),
        "collides_but_untouched": seen[COLLIDES]["lifts"] - seen[COLLIDES]["touched"],
    }


def _drawn(heaps: Iterable[Heap]) -> Iterator[Judged]:
    """Yield a true grasp of each scene, and one of the verdict that was drawn least so far."""
    drawn: Counter[str] = Counter()
    for heap in heaps:
        judged = _judged(heap)
        for wanted in (True, False):
            some = [one for one in judged if (one.verdict.name == TRUE) == wanted]
            if some:
                chosen = min(some, key=lambda one: drawn[one.verdict.name])
                drawn[chosen.verdict.name] += 1
                yield chosen


def _judged(heap: Heap) -> list[Judged]:
    """Some grasps of the scene, in random order."""
    truth, judge, rng = Truth(heap), Judge.of(heap), np.random.default_rng([heap.seed, heap.n, 5])
    drawn = truth.on_faces(_ON_FACES, rng).and_(truth.anywhere(_ANYWHERE, rng))
    judged = []
    poses = truth.poses(drawn)
    for index in rng.permutation(len(drawn))[:_JUDGED]:
        pose, opening_m = poses[int(index)]
        judged.append(Judged(heap, pose, opening_m, judge.judge(pose, opening_m)))
    return judged

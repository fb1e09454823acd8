"""Whether a scene can be picked from above: a search on the true shapes for a grasp that survives small errors.

It may miss one that exists: then the scene is left out of the share of true grasps, whatever the detector did there.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.heaps.candidates import Truth
from benchmarks.heaps.heap import Heap
from benchmarks.heaps.judge import TRUE, Judge
from bus.transforms import from_rotation

OFF_M, TURNED_DEG = 0.002, 3.0
"""A robust grasp stays true when off by so much along or across the closing axis, or turned about the approach."""
_ON_FACES, _ANYWHERE = 1200, 20_000
_ROUNDS, _MOST_JUDGED = 3, 3500

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Robust:
    """The result of the search.

    Attributes:
        base_from_tcp: (4, 4) of a robust grasp, with its ``opening_m``; None = none was found.
        judged: number of grasps tried.
    """

    base_from_tcp: Array | None
    opening_m: float
    judged: int

    def to_json(self) -> str:
        """Return it as one line of text."""
        pose = None if self.base_from_tcp is None else self.base_from_tcp.tolist()
        return json.dumps({"base_from_tcp": pose, "opening_m": self.opening_m, "judged": self.judged})

    @classmethod
    def from_json(cls, text: str) -> Robust:
        """Read what `to_json` wrote."""
        told: dict[str, Any] = json.loads(text)
        pose = told["base_from_tcp"]
        return cls(None if pose is None else np.array(pose), told["opening_m"], told["judged"])


def search(heap: Heap, rounds: int = _ROUNDS, anywhere: int = _ANYWHERE) -> Robust:
    """Try grasps square to faces, then ``anywhere`` drawn at random, ``rounds`` times, until one is robust or the tries
    are used up.
    """
    truth, judge = Truth(heap), Judge.of(heap)
    rng = np.random.default_rng([heap.seed, heap.n, 4])
    judged = 0
    for draw, count in ((truth.on_faces, _ON_FACES), (truth.anywhere, anywhere)) * rounds:
        for grasp, opening_m in truth.poses(draw(count, rng)):
            if judged == _MOST_JUDGED:
                break
            judged += 1
            if is_robust(judge, grasp, opening_m):
                return Robust(grasp, opening_m, judged)
    return Robust(None, float("nan"), judged)


def is_robust(judge: Judge, base_from_tcp: Array, opening_m: float) -> bool:
    """Whether the grasp is true, and stays so under every error alone."""
    return all(judge.judge(base_from_tcp @ error, opening_m).name == TRUE for error in _ERRORS)


def obtain(heap: Heap, path: Path | None, searched: Callable[[Heap], Robust] = search) -> Robust:
    """Return the kept answer of ``path``, or search and keep it there."""
    if path is not None and path.exists():
        return Robust.from_json(path.read_text())
    found = searched(heap)
    if path is not None:
        partial = path.with_suffix(".partial")
        partial.write_text(found.to_json())
        partial.replace(path)
    return found


def _errors() -> tuple[Array, ...]:
    """The identity, and each error alone, in the tcp frame."""
    shifts = [(0.0, 0.0, 0.0), *((x, y, 0.0) for x, y in ((OFF_M, 0), (-OFF_M, 0), (0, OFF_M), (0, -OFF_M)))]
    turns = []
    for angle in np.deg2rad([TURNED_DEG, -TURNED_DEG]):
        cosine, sine = np.cos(angle), np.sin(angle)
        turns.append(from_rotation(np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])))
    return (*(from_rotation(np.eye(3), shift) for shift in shifts), *turns)


_ERRORS = _errors()

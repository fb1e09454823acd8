"""The counts of picks, and the means of their times."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import fields
from statistics import mean
from typing import Any

from benchmarks.held.rounds import Attempt, Pick, Times

_CYCLE = ("motion", "hand", "hold", "capture", "compute_not_hidden", "log")


def figures(picks: Sequence[Pick], binned: Sequence[tuple[int, int]] = (), *, is_paced: bool) -> dict[str, Any]:
    """Return the figures as JSON has them.

    Args:
        picks: with ``feasible`` asked.
        binned: of every bin, how many objects lay in it, and how many of them are not in the tray at the end.
        is_paced: whether simulated time passed as real time does; otherwise picks an hour by the wall mean nothing.
    """
    presented = [pick for pick in picks if any(one.is_presented for one in pick.attempts)]
    attempts = [one for pick in presented for one in pick.attempts]
    executed = [one for one in attempts if one.is_executed]
    held = [pick for pick in presented if pick.is_held]
    success = [pick for pick in presented if pick.is_success]
    return {
        "picks": len(presented),
        "not_presented": len(picks) - len(presented),
        "feasible": sum(bool(pick.feasible) for pick in presented),
        "held_by_physics": len(held),
        "held_of_feasible": _share(len(held), sum(bool(pick.feasible) for pick in presented)),
        "verdict_success": len(success),
        "false_success": sum(not pick.last.risen for pick in success),
        "false_failure": sum(bool(pick.last.carried) and not pick.is_success for pick in presented),
        "lost_on_the_way": sum(bool(set(one.risen) - set(one.carried)) for one in attempts),
        "per_object": _per_object(picks),
        "by_code": Counter(code_of(pick) for pick in picks),
        "lost_at": Counter(where for pick in presented if (where := lost_at(pick))),
        "attempts_per_pick": _share(len(attempts), len(presented)),
        "success_per_attempt": _share(sum(bool(one.risen) for one in attempts), len(attempts)),
        "executed": len(executed),
        "missed": sum(not one.risen for one in executed),
        "infeasible": sum(not pick.feasible for pick in presented),
        "multi_pick": sum(len(one.risen) > 1 for one in attempts),
        "cleared": _share(sum(lay - lost for lay, lost in binned), sum(lay for lay, _ in binned)),
        "bins_emptied": sum(lost == 0 for _, lost in binned) if binned else None,
        "picks_per_hour": {
            "simulated": _an_hour(len(held), [one.times.simulated for one in attempts]),
            "wall": _an_hour(len(held), [one.times.wall for one in attempts]) if is_paced else None,
        },
        "cycle_s": _cycle_s(executed),
        "failures": [_failure(pick) for pick in picks if not (pick.is_held and pick.is_success)],
    }


def code_of(pick: Pick) -> str:
    """Return how the pick ended, in a word."""
    result = pick.last.result
    if not any(one.is_presented for one in pick.attempts):
        return "NOT_PRESENTED"
    return result.result if result.code is None or result.result == "EMPTY" else str(result.code)


def lost_at(pick: Pick) -> str:
    """In which part of its last attempt the pick was lost; "" when it was not."""
    last = pick.last
    if "execute" not in last.result.stages:
        return "before_motion"
    if not last.is_executed:
        return "reach_or_lift"
    if not last.risen:
        return "slipped"
    if not last.carried:
        return "on_the_way"
    return "" if pick.is_success else "verdict"


def _per_object(picks: Sequence[Pick]) -> dict[str, dict[str, Any]]:
    by_name: dict[str, list[Pick]] = defaultdict(list)
    for pick in picks:
        by_name[pick.name or "none"].append(pick)
    return {
        name: {
            "picks": len(some),
            "feasible": sum(bool(pick.feasible) for pick in some),
            "held": sum(pick.is_held for pick in some),
            "verdict_success": sum(pick.is_success for pick in some),
            "by_code": Counter(map(code_of, some)),
        }
        for name, some in sorted(by_name.items())
    }


def _cycle_s(executed: Sequence[Attempt]) -> dict[str, float | None]:
    """Means over the cycles that came to their hold."""
    assert set(_CYCLE) < {one.name for one in fields(Times)}
    return {name: round(mean(getattr(one.times, name) for one in executed), 3) if executed else None for name in _CYCLE}


def _failure(pick: Pick) -> dict[str, Any]:
    result = pick.last.result
    return {
        "object": pick.name,
        "seed": pick.seed,
        "code": code_of(pick),
        "lost_at": lost_at(pick),
        "held": pick.is_held,
        "feasible": pick.feasible,
        "reason": result.reason,
        "recording": result.recording,
    }


def _share(part: int, whole: int) -> float | None:
    return round(part / whole, 4) if whole else None


def _an_hour(held: int, times_s: Sequence[float]) -> float | None:
    return round(3600 * held / sum(times_s), 1) if sum(times_s) > 0 else None

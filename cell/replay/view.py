"""The output of a replay, for a person and for a program."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from bus.frozen import Message
from bus.messages import Detections, Failure, PickPlan, Verdict
from cell.replay.replay import Changed, Replay, StageReplay
from cell.terminal.printing import Printer

_SHOWN = 5
EMPTY = "empty"
"""Equal, without a grasp to compare; of a folder also: the cycle ended before the stages that are asked for."""
_LONGEST = 60
NO_GRASPS = "equal, but the recording holds no grasp to compare: that proves nothing"


def verdict(replay: Replay) -> str:
    """``equal``, ``different``, or ``empty``: equal, without a grasp to compare."""
    if not replay.equal:
        return "different"
    return "equal" if replay.grasps else EMPTY


def to_json(replay: Replay) -> dict[str, Any]:
    """A JSON object; ``first_difference`` only if there is one, ``consequence`` only for a chained replay."""
    said: dict[str, Any] = {
        "equal": replay.equal,
        "verdict": verdict(replay),
        "cycle_id": replay.record.cycle_id,
        "grasps": replay.grasps,
        "stages": {stage.stage: len(stage.differences) for stage in replay.stages},
        "not_reached": replay.not_reached,
    }
    for stage in replay.stages:
        if stage.differences:
            step, difference = stage.differences[0]
            said["first_difference"] = {"stage": stage.stage, "step": step, **difference.to_json()}
            break
    if replay.chained:
        said["consequence"] = list(consequence(replay))
    if replay.changed:
        said["settings"] = [{"key": one.key, "recorded": one.before, "given": one.now} for one in replay.changed]
    return said


def show(replay: Replay, out: Printer, *, details: bool = False) -> None:
    """Print a replay for a person. ``details``: of a "what if?", also each value that differs."""
    if replay.chained:
        show_what_if(replay, out)
    if details or not replay.chained:
        _show_stages(replay, out)
    if not replay.chained:
        out.line(f"{replay.record.cycle_id}: {_in_words(replay)}")
    elif not replay.equal and not details:
        count = sum(len(stage.differences) for stage in replay.stages)
        out.line(f"  {count} value{'s' if count > 1 else ''} differ{'' if count > 1 else 's'}: --details", style="dim")


def show_what_if(replay: Replay, out: Printer) -> None:
    """Print what came of a change: first that, then why where it is nothing."""
    given = ", ".join(_given(one) for one in replay.changed) or f"from {replay.stages[0].stage} on"
    out.line((f"{given}: {_in_words(replay)}", "green" if replay.equal else "bold"))
    for line in consequence(replay):
        out.line(f"  {line}")
    for text in why_it_ends(replay):
        out.line(f"  {text}")
    for name, why in replay.not_reached.items():
        out.line(f"  {name}: not replayed, {why}")
    if replay.changed and replay.equal:
        ran = ", ".join(stage.stage for stage in replay.stages)
        out.line(
            f"  Only {ran} ran again: a setting of what moves, records or listens changes nothing here.", style="dim"
        )


def _given(one: Changed) -> str:
    was = "as it was" if one.now == one.before else f"was {_shortened(one.before)}"
    return f"{one.key} = {_shortened(one.now)} ({was})"


def _shortened(value: object) -> str:
    text = value if isinstance(value, str) else "not set" if value is None else json.dumps(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 4]} ..."


def _in_words(replay: Replay) -> str:
    said = verdict(replay)
    if said == EMPTY:
        return NO_GRASPS
    return "equal, no decision changed" if replay.changed and said == "equal" else said


def _show_stages(replay: Replay, out: Printer) -> None:
    for stage in replay.stages:
        count = len(stage.differences)
        found = (f"{count} difference{'s' if count > 1 else ''}", "red") if count else ("equal", "green")
        out.line(f"{stage.stage:<8} ", found)
        for step, difference in stage.differences[:_SHOWN]:
            out.line(f"    {step:<8} {difference.describe()}")
        if count > _SHOWN:
            out.line(f"    and {count - _SHOWN} more")


def show_tally(said: dict[str, Any], out: Printer) -> None:
    """Print a folder's summary for a person: first differences first, failures before figures."""
    for path, why in said["unreadable"].items():
        out.line(("unreadable", "red"), f" {path}: {why}")
    for path, why in said["not_here"].items():
        out.line(("not replayed", "yellow"), f" {path}: {why}")
    for one in said["differences"]:
        first = one["first_difference"]
        where = f"{first['stage']}/{first['step']}, {first['field']}"
        out.line(("different", "red"), f" {one['cycle_id']}: first in {where}")
    for name, count in said["fields"].items():
        out.line(f"  {count:>5} x {name}")
    counts = ", ".join(
        f"{said[name]} {name}" for name in ("equal", "different", "empty", "trimmed") if name != "trimmed" or said[name]
    )
    counts += f", {len(said['not_here'])} not to be run here" if said["not_here"] else ""
    out.line(f"{said['cycles']} recordings: {counts}, {len(said['unreadable'])} unreadable")


def consequence(replay: Replay) -> Iterator[str]:
    """Yield what came of the change, a line a stage: "before -> after" if that differs, else its first difference."""
    for stage in replay.stages:
        before, after = _gist(stage.recorded), _gist(stage.replayed)
        moved = _moved(replay) if stage.stage == "plan" else ""
        first = stage.differences[0][1].describe() if stage.differences and before == after and not moved else ""
        yield f"{stage.stage}: {after if before == after else f'{before} -> {after}'}{moved}{first and f'; {first}'}"


def why_it_ends(replay: Replay) -> list[str]:
    """Return the reasons of the stages that fail now."""
    return [one.replayed.text for one in replay.stages if isinstance(one.replayed, Failure)]


def _gist(outcome: Message | None) -> str:
    """The outcome of a stage, in half a line."""
    if isinstance(outcome, Detections):
        best = outcome.grasps[0]
        return f"{len(outcome.grasps)} grasps, the best {best.width_m * 1e3:.1f} mm wide, score {best.score:.3f}"
    if isinstance(outcome, PickPlan):
        return f"grasp {outcome.grasp}, tilted {np.degrees(outcome.tilt_rad):.0f} deg, {len(outcome.rejected)} rejected"
    if isinstance(outcome, Verdict):
        return "held" if outcome.held else f"{outcome.code}"
    return f"{outcome.code}" if isinstance(outcome, Failure) else "not reached"


def _moved(replay: Replay) -> str:
    """The distance [mm] between the chosen grasps, in words; "" for none."""
    before, after = (_chosen(replay.stages, name) for name in ("recorded", "replayed"))
    if before is None or after is None or np.array_equal(before, after):
        return ""
    away_mm = float(np.linalg.norm(before[:3, 3] - after[:3, 3])) * 1e3
    return f" (the chosen grasp {away_mm:.1f} mm away)"


def _chosen(stages: tuple[StageReplay, ...], which: str) -> np.ndarray | None:
    outcomes = {stage.stage: getattr(stage, which) for stage in stages}
    found, plan = outcomes.get("detect"), outcomes.get("plan")
    if not isinstance(found, Detections) or not isinstance(plan, PickPlan):
        return None
    return found.grasps[plan.grasp].base_from_tcp

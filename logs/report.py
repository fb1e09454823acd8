"""One self-contained page that explains a cycle: what it saw, imagined, aligned, chose and did, and why it ended so."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from bus.messages import Delivery, Detections, Execution, Grasp, PickPlan, Rejection, SegmentRun, Verdict
from config.load import load_station
from logs import figures, images
from logs.clouds import clouds
from logs.page import Chart, Fact, Picture, packed_plotly, script_json, write_page
from logs.reader import CycleRecord
from logs.story import Story, tell

_THUMBNAIL_PX = 240


def write_report(record: CycleRecord, path: Path, *, index: str = "") -> Path:
    """Write the page to ``path`` and return it. Raises: RecordingError when it cannot be written.

    Args:
        index: file name of the day's page beside it, "" for none.
    """
    return write_page("report.html.j2", {**_content(record), "index": index}, path)


def _content(record: CycleRecord) -> dict[str, Any]:
    story, found, plan = tell(record), _result(record, "detect", Detections), _result(record, "plan", PickPlan)
    runs = _runs(record)
    view, motion = _clouds(record, found, plan), _motion(record, runs, story)
    thumbnail = _thumbnail(record, found, plan)
    return {
        "story": story,
        "cycle_id": record.cycle_id,
        "began": datetime.fromtimestamp(story.start_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC"),
        "result": record.result,
        "attempt": record.attempt,
        "thumbnail": thumbnail,
        "summary": script_json(_summary(record, story, thumbnail)),
        "seen": _seen(record, found),
        "imagined": _imagined(found),
        "replies": [{**dict(reply), "uri": images.file_uri(reply.image_png)} for reply in record.replies],
        "drift": _drift(record, found),
        "clouds": view,
        "charts": script_json(_all_charts(view, motion)),
        "rectangles": _rectangles(found, plan),
        "grasps": _grasps(found),
        "rejected": _rejections(plan),
        "plan": plan,
        "uses": figures.uses(runs),
        "motion": motion,
        "joint_colors": figures.JOINT_COLORS,
        "facts": _facts(record),
        "log": _log(record, story),
        "changes": configuration_changes(record.station),
        "metadata": record.metadata,
        "plotly": packed_plotly() if view or runs or record.hand else "",
    }


def _result(record: CycleRecord, stage: str, kind: type[Any]) -> Any:
    found = record.stages.get(stage)
    return found.result if found is not None and isinstance(found.result, kind) else None


def _summary(record: CycleRecord, story: Story, thumbnail: str) -> dict[str, Any]:
    """What the day's page shows of this one: kept in the page, so that the recording is not read again."""
    return {
        "cycle_id": record.cycle_id,
        "result": story.outcome,
        "code": story.code,
        "object": story.object,
        "why": story.why,
        "wall_s": record.result.wall_s if record.result is not None else None,
        "stages": {line.name: line.took_s for line in story.stages},
        "number": record.attempt.number,
        "retried_as": record.result.retried_as if record.result is not None else "",
        "thumbnail": thumbnail,
    }


# --- what it saw, imagined and found ----------------------------------------------------------------------------------


def _thumbnail(record: CycleRecord, found: Detections | None, plan: PickPlan | None) -> str:
    if found is not None:
        near = images.crop(images.annotated(found, plan), found.evidence.object_mask, margin_px=40)
        return images.data_uri(near, width_px=_THUMBNAIL_PX)
    seen = record.observation
    return images.data_uri(seen.frame.color, width_px=_THUMBNAIL_PX) if seen is not None else ""


def _seen(record: CycleRecord, found: Detections | None) -> list[Picture]:
    pictures = []
    if record.observation is not None:
        color = found.evidence.color if found is not None else record.observation.frame.color
        pictures.append(Picture("Colour", images.data_uri(color)))
        depth, meaning = images.colored_depth(record.observation.frame.depth_m)
        pictures.append(Picture(f"Depth: {meaning}", images.data_uri(depth, width_px=640)))
    if record.after is not None:
        pictures.append(Picture("Second look, while holding", images.data_uri(record.after.frame.color)))
    return pictures


def _imagined(found: Detections | None) -> list[Picture]:
    if found is None:
        return []
    evidence = found.evidence
    around = evidence.object_mask | evidence.goal_rod_mask
    return [
        Picture("Goal image: the imagined rod", images.data_uri(images.crop(evidence.goal_image, around))),
        Picture("Rod found in it", images.data_uri(images.crop(evidence.goal_rod_mask, around))),
        Picture("Object found in it", images.data_uri(images.crop(evidence.goal_object_mask, around))),
    ]


def _drift(record: CycleRecord, found: Detections | None) -> list[Fact]:
    """How far the goal image strayed, beside what it may."""
    if found is None:
        return []
    drift, limits = found.evidence.drift, record.station.get("perception", {}).get("drift", {})
    turn = f"{np.degrees(drift.turn_rad):.0f}°, {drift.shift_px:.0f} px, x {drift.scale:.2f}"
    return [
        Fact(
            "background changed", f"{drift.changed_outside:.1%}", f"at most {limits.get('max_changed_outside', 0):.0%}"
        ),
        Fact("outline overlaps", f"{drift.silhouette_iou:.0%}", f"at least {limits.get('min_silhouette_iou', 0):.0%}"),
        Fact("colour moved (CIE76)", f"{drift.color_shift:.0f}", f"at most {limits.get('max_color_shift', 0):.0f}"),
        Fact("turned, shifted, scaled by", turn, "carried back by the alignment"),
        Fact("proposals that agree", f"{found.evidence.agreement:.0%}", f"number {found.evidence.sample + 1} chosen"),
    ]


def _clouds(record: CycleRecord, found: Detections | None, plan: PickPlan | None) -> dict[str, Any] | None:
    if found is None or record.observation is None:
        return None
    grasp = found.grasps[plan.grasp if plan is not None else 0] if found.grasps else None
    view = clouds(found, grasp, np.asarray(record.observation.view.base_from_color))
    alignment = found.evidence.alignment
    title = (
        f"{alignment.method}: scale {alignment.scale:.3f}, residual {alignment.residual:.3f} of the object's radius, "
        f"Chamfer {alignment.chamfer_m2 * 1e6:.2f} mm², {alignment.hypotheses} orientations tried"
    )
    return {"chart": Chart(title, view.figure), "before": view.before, "after": view.after}


def _rectangles(found: Detections | None, plan: PickPlan | None) -> str:
    if found is None:
        return ""
    return images.data_uri(images.crop(images.annotated(found, plan), found.evidence.object_mask, margin_px=60))


def _grasps(found: Detections | None) -> list[dict[str, Any]]:
    if found is None:
        return []

    def moved_mm(grasp: Grasp) -> float:
        return float(np.linalg.norm(grasp.base_from_tcp[:3, 3] - grasp.imagined_base_from_tcp[:3, 3]) * 1e3)

    return [{**dict(grasp), "snapped_mm": moved_mm(grasp)} for grasp in found.grasps]


def _rejections(plan: PickPlan | None) -> dict[int, list[str]]:
    """Per grasp: each reason once, with the approach directions it was found for."""
    by_reason: dict[int, dict[tuple[str, str], list[Rejection]]] = defaultdict(lambda: defaultdict(list))
    for one in plan.rejected if plan is not None else ():
        by_reason[one.grasp][one.code.value, one.reason].append(one)
    return {
        grasp: [
            f"{code} at {', '.join(f'{np.degrees(one.tilt_rad):.0f}°' for one in same)}: {reason}"
            for (code, reason), same in reasons.items()
        ]
        for grasp, reasons in by_reason.items()
    }


# --- what it did ------------------------------------------------------------------------------------------------------


def _runs(record: CycleRecord) -> list[SegmentRun]:
    execution, delivery = _result(record, "execute", Execution), _result(record, "deliver", Delivery)
    runs = [*(execution.runs if execution else ()), *(delivery.runs if delivery else ())]
    return [run for run in runs if len(run.motion.commanded_q_rad) and len(run.motion.t_s)]


def _motion(record: CycleRecord, runs: list[SegmentRun], story: Story) -> dict[str, list[Chart]]:
    """Charts of the joints, and of the hand; either may be empty."""
    execution = _result(record, "execute", Execution)
    grasped = execution.grasped if execution is not None else None
    hand: list[Chart] = []
    if record.hand:
        least_m = record.station.get("verify", {}).get("min_width_m")
        figure = figures.hand_width(
            record.hand, story.start_ns, grasped.width_m * 1e3 if grasped else None, least_m * 1e3 if least_m else None
        )
        hand.append(Chart("Hand width", figure))
    if not runs:
        return {"joints": [], "hand": hand}
    uses = {use.kind: use for use in figures.uses(runs)}
    joints = [
        Chart(f"{kind.capitalize()}: at most {uses[kind].in_words} of its limit", figure)
        for kind, figure in figures.joint_use(runs).items()
    ]
    hand += [Chart("Load: torque from outside", figures.load(runs)), Chart("Tracking error", figures.tracking(runs))]
    return {"joints": joints, "hand": hand}


def _all_charts(view: dict[str, Any] | None, motion: dict[str, list[Chart]]) -> dict[str, Any]:
    """Every figure of the page by the name of its place."""
    named = {f"{kind}-{i}": one.figure for kind, charts in motion.items() for i, one in enumerate(charts)}
    return named if view is None else {"clouds": view["chart"].figure, **named}


def _facts(record: CycleRecord) -> list[Fact]:
    verdict = _result(record, "verify", Verdict)
    if verdict is None:
        return []
    need = record.station.get("verify", {})
    return [
        Fact("held for", f"{verdict.hold_s:.2f} s", f"{need.get('hold_s')} s"),
        Fact(
            "smallest width meanwhile",
            f"{verdict.width_min_m * 1e3:.1f} mm",
            f"≥ {need.get('min_width_m', 0) * 1e3:.1f} mm",
        ),
        Fact("load on the arm", f"{verdict.load_n:z.2f} N", f"≥ {need.get('min_load_n')} N"),
        Fact(
            "of the object's place is empty",
            f"{verdict.cleared_fraction * 100:.0f} %",
            f"≥ {need.get('min_cleared_fraction', 0) * 100:.0f} %",
        ),
    ]


# --- log and configuration --------------------------------------------------------------------------------------------


def _log(record: CycleRecord, story: Story) -> list[dict[str, Any]]:
    """States, stages, events and the nodes' faults in the order of time: {at_s, kind, text, bad}."""
    lines = [
        {"at_s": span.start_s, "kind": "state", "text": span.name, "bad": span.name == "Aborting"}
        for span in story.states
    ]
    lines += [
        {"at_s": line.start_s + line.took_s, "kind": line.name, "text": line.said or "done", "bad": line.failed}
        for line in story.stages
    ]
    said = {(one.message.name, one.message.last_fault): one for one in reversed(record.health)}  # each when first heard
    for (node, fault), one in said.items():
        if fault:
            at_s = (one.log_time_ns - story.start_ns) / 1e9
            lines.append({"at_s": at_s, "kind": f"node {node}", "text": f"newest fault: {fault}", "bad": True})
    for at_ns, event in record.events:
        text = f"{event.code}: {event.text} {event.advice}".strip()
        at_s = (at_ns - story.start_ns) / 1e9
        lines.append({"at_s": at_s, "kind": event.severity, "text": text, "bad": event.severity == "error"})
    return sorted(lines, key=lambda line: float(line["at_s"]))


def configuration_changes(station: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """(key, recorded, default) of every setting that is not the simulated cell's own; "-" where one side lacks it."""
    here, default = dict(_leaves(station)), dict(_leaves(load_station().model_dump(mode="json")))
    keys = [*here, *(key for key in default if key not in here)]
    missing = "-"
    return [
        (key, str(here.get(key, missing)), str(default.get(key, missing)))
        for key in keys
        if here.get(key, missing) != default.get(key, missing)
    ]


def _leaves(tree: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(tree, dict) and tree:
        for key, value in tree.items():
            yield from _leaves(value, f"{path}.{key}" if path else str(key))
    else:
        yield path, tree

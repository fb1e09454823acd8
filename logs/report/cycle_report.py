"""The report page of one cycle: observation, goal image, alignment, grasps, motion, and the reason of its end."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple, TypeVar

from bus.codec import Json
from bus.messages import Delivery, Detections, Execution, PickPlan, SegmentRun, Verdict
from config.load import load_station
from config.robot import recorded_limits
from logs.mcap.names import telling
from logs.mcap.reader import CycleRecord
from logs.recorded_settings import recorded_number, settings_in
from logs.report import evidence, figures, images
from logs.report.in_the_way import in_the_way
from logs.report.looks import Looks, looks_view
from logs.report.page import Chart, Fact, Figure, script_json, write_page
from logs.report.scene import scene_view
from logs.report.timeline import Timeline, summarize

_MOVING = {"execute", "deliver"}
"""The stages that move the arm."""

Result = TypeVar("Result")


class LogLine(NamedTuple):
    """One line of the cycle's log: when, from the cycle's start [s], what it is of, and whether it is trouble."""

    at_s: float
    kind: str
    text: str
    bad: bool


def write_report(record: CycleRecord, path: Path, *, index: str = "", embed: bool = False) -> Path:
    """Write the page to ``path`` and return it.

    Args:
        index: file name of the day's page beside it, "" for none.
        embed: the drawing library is in the page, not beside it: 5 MB more.

    Raises: RecordingError when the page cannot be drawn or written.
    """
    with telling(f"The cycle {record.cycle_id!r}"):
        content = {**_content(record), "index": index}
        return write_page("report.html.j2", content, path, library=bool(content["charts"]), embed=embed)


def _content(record: CycleRecord) -> Json:
    timeline, found, plan = summarize(record), _result(record, "detect", Detections), _result(record, "plan", PickPlan)
    runs = _runs(record)
    chosen = evidence.choice(record, found)
    view, motion = evidence.alignment_view(record, found, chosen), _motion(record, runs, timeline)
    scene = scene_view(record, found)
    looks = looks_view(record, found, chosen)
    thumbnail = evidence.thumbnail(record, found, chosen, scene)
    obstacles = in_the_way(record, found, chosen.rejected)
    charts = _all_charts(view, looks, motion)
    if obstacles is not None and obstacles.cloud is not None:
        charts["obstacles"] = obstacles.cloud
    limits = recorded_limits(record.station)
    return {
        "timeline": timeline,
        "cycle_id": record.cycle_id,
        "began": datetime.fromtimestamp(timeline.start_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC"),
        "result": record.result,
        "attempt": record.attempt,
        "trimmed": record.trimmed,
        "thumbnail": thumbnail,
        "summary": script_json(_summary(record, timeline, thumbnail)),
        "seen": evidence.seen(record, found),
        "scene": scene,
        "scene_uri": images.data_uri(scene.picture) if scene is not None else "",
        "looks": looks,
        "painted": evidence.is_painted(found),
        "detector": found.detector if found is not None else "",
        "imagined": evidence.imagined(found),
        "replies": [{**dict(reply), "uri": images.file_uri(reply.image_png)} for reply in record.replies],
        "drift": evidence.drift(record, found),
        "clouds": view,
        "charts": script_json(charts) if charts else "",
        "rectangles": evidence.rectangles(found, chosen),
        "grasps": evidence.grasps(found),
        "rejected": evidence.rejections(chosen),
        "obstacles": obstacles,
        "plan": plan,
        "uses": figures.uses(limits, runs),
        "motion": motion,
        "joint_colors": figures.JOINT_COLORS[: limits.joints],
        "facts": _facts(record),
        "log": _log(record, timeline),
        "changes": configuration_changes(record.station),
        "metadata": record.metadata,
    }


def _result(record: CycleRecord, stage: str, kind: type[Result]) -> Result | None:
    found = record.stages.get(stage)
    return found.result if found is not None and isinstance(found.result, kind) else None


def _summary(record: CycleRecord, timeline: Timeline, thumbnail: str) -> Json:
    """The summary for the day's page, stored in this page, so that the recording is not read again."""
    return {
        "cycle_id": record.cycle_id,
        "result": timeline.outcome,
        "code": timeline.code,
        "object": timeline.object,
        "why": timeline.why,
        "wall_s": record.result.wall_s if record.result is not None else None,
        "stages": timeline.took_s,
        "again": [seen.view.why for seen in record.looks if seen.view.why],
        "number": record.attempt.number,
        "retried_as": record.result.retried_as if record.result is not None else "",
        "thumbnail": thumbnail,
    }


# --- motion -----------------------------------------------------------------------------------------------------------


def _runs(record: CycleRecord) -> list[SegmentRun]:
    execution, delivery = _result(record, "execute", Execution), _result(record, "deliver", Delivery)
    runs = [*(execution.runs if execution else ()), *(delivery.runs if delivery else ())]
    return [run for run in runs if len(run.motion.commanded_q_rad) and len(run.motion.t_s)]


def _motion(record: CycleRecord, runs: list[SegmentRun], timeline: Timeline) -> dict[str, list[Chart]]:
    """Charts of the joints and of the hand; none of a cycle that ended before it moved."""
    if not runs and not _MOVING & {*record.stages, timeline.ended_in}:
        return {"joints": [], "hand": []}
    limits = recorded_limits(record.station)
    execution = _result(record, "execute", Execution)
    grasped = execution.grasped if execution is not None else None
    hand: list[Chart] = []
    if record.hand:
        least_m = recorded_number(record.station, "verify", "min_width_m")
        figure = figures.hand_width(
            record.hand,
            timeline.start_ns,
            grasped.width_m * 1e3 if grasped else None,
            least_m * 1e3 if least_m else None,
        )
        hand.append(Chart("Hand width", figure))
    if not runs:
        said = figures.as_said(limits, record.arm, timeline.start_ns) if record.arm else {}
        return {"joints": [], "hand": [*hand, *(Chart(title, figure) for title, figure in said.items())]}
    uses = {use.kind: use for use in figures.uses(limits, runs)}
    joints = [
        Chart(f"{kind.capitalize()}: at most {uses[kind].in_words} of its limit", figure)
        for kind, figure in figures.joint_use(limits, runs).items()
    ]
    hand += [Chart("Load: torque from outside", figures.load(runs)), Chart("Tracking error", figures.tracking(runs))]
    return {"joints": joints, "hand": hand}


def _all_charts(
    view: evidence.AlignmentView | None, looks: Looks | None, motion: dict[str, list[Chart]]
) -> dict[str, Figure]:
    """All figures of the page by the name of their place."""
    named = {f"{kind}-{i}": one.figure for kind, charts in motion.items() for i, one in enumerate(charts)}
    if looks is not None:
        named = {"looks": looks.cloud, **named}
    return named if view is None else {"clouds": view.chart.figure, **named}


def _facts(record: CycleRecord) -> list[Fact]:
    verdict = _result(record, "verify", Verdict)
    if verdict is None:
        return []

    def need(name: str, times: float, form: str) -> str:
        value = recorded_number(record.station, "verify", name)
        return "-" if value is None else f"{value * times:{form}}"

    unseen = "not seen" if record.after is not None else "not looked at"
    carried = [] if verdict.carried_n is None else [Fact("load on the way", f"{verdict.carried_n:z.2f} N", "-")]
    return [
        Fact("held for", f"{verdict.hold_s:.2f} s", f"{need('hold_s', 1, 'g')} s"),
        Fact(
            "smallest width meanwhile", f"{verdict.width_min_m * 1e3:.1f} mm", f"≥ {need('min_width_m', 1e3, '.1f')} mm"
        ),
        Fact("load on the arm", f"{verdict.load_n:z.2f} N", f"≥ {need('min_load_n', 1, 'g')} N"),
        *carried,
        Fact(
            "of the object's place is empty",
            f"{verdict.cleared_fraction * 100:.0f} %" if verdict.cleared_fraction is not None else unseen,
            f"≥ {need('min_cleared_fraction', 100, '.0f')} %",
        ),
    ]


# --- log and configuration --------------------------------------------------------------------------------------------


def _log(record: CycleRecord, timeline: Timeline) -> list[LogLine]:
    """States, stages, events and the nodes' faults in the order of time."""
    lines = [LogLine(span.start_s, "state", span.name, span.name == "Aborting") for span in timeline.states]
    lines += [
        LogLine(line.start_s + line.took_s, line.name, line.said or "done", line.failed) for line in timeline.stages
    ]
    said = {(one.message.name, one.message.last_fault): one for one in reversed(record.health)}  # at its first message
    for (node, fault), one in said.items():
        if fault:
            at_s = (one.log_time_ns - timeline.start_ns) / 1e9
            lines.append(LogLine(at_s, f"node {node}", f"newest fault: {fault}", True))
    for at_ns, event in record.events:
        text = f"{event.code}: {event.text} {event.advice}".strip()
        at_s = (at_ns - timeline.start_ns) / 1e9
        lines.append(LogLine(at_s, event.severity, text, event.severity == "error"))
    return sorted(lines, key=lambda line: line.at_s)


def configuration_changes(station: Mapping[str, object]) -> list[tuple[str, str, str]]:
    """Return (key, recorded, default) of every recorded setting that differs from the simulated cell's.

    "-": that one has no such setting. A station is recorded with its defaults: what is not there is younger than it.
    """
    default = dict(settings_in(load_station().model_dump(mode="json")))
    here = [(key, value, default.get(key, "-")) for key, value in settings_in(station)]
    return [(key, str(value), str(usual)) for key, value, usual in here if value != usual]

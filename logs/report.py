"""One self-contained page that explains a cycle: what it saw, imagined, aligned, chose and did, and why it ended so."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from bus.codes import ADVICE
from bus.errors import RecordingError
from bus.messages import Delivery, Detections, Execution, Grasp, PickPlan, SegmentRun, StageRecord, Verdict
from logs import figures
from logs.reader import CycleRecord

_TEMPLATE = Path(__file__).with_name("report.html.j2")


class Picture(NamedTuple):
    """An image with what it shows."""

    title: str
    uri: str


class Chart(NamedTuple):
    """A plotly figure with what it shows; ``json`` is its data and layout."""

    title: str
    json: Markup


class Fact(NamedTuple):
    """One measured value beside what was asked of it."""

    name: str
    value: str
    asked: str = ""


def write_report(record: CycleRecord, path: Path) -> Path:
    """Write the page to ``path`` and return it. Raises: RecordingError when it cannot be written."""
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    page = environment.from_string(_TEMPLATE.read_text()).render(**_content(record), plotly=Markup(get_plotlyjs()))
    try:
        path.write_text(page)
    except OSError as error:
        raise RecordingError(
            f"Cannot write {path}: {error.strerror}.", "Choose another place with --output."
        ) from error
    return path


def _content(record: CycleRecord) -> dict[str, Any]:
    found = _result(record, "detect", Detections)
    plan = _result(record, "plan", PickPlan)
    result = record.result
    code = result.code if result is not None else None
    return {
        "cycle_id": record.cycle_id,
        "result": result,
        "outcome": result.result if result is not None else "UNFINISHED",
        "advice": ADVICE[code] if code is not None else "",
        "stages": _stage_bars(record.stages),
        "seen": _seen(record, found),
        "imagined": _imagined(found),
        "clouds": _clouds(record, found, plan),
        "motion": _motion(record),
        "facts": _facts(record),
        "plan": plan,
        "rejected": plan.rejected if plan is not None else (),
        "grasps": _grasps(found),
        "drift": _drift(record, found),
        "replies": [{**dict(reply), "uri": figures.file_uri(reply.image_png)} for reply in record.replies],
        "states": [(time_ns, state) for time_ns, state in record.states],
        "events": [event for _, event in record.events],
        "station": json.dumps(record.station, indent=2),
        "metadata": record.metadata,
    }


def _result(record: CycleRecord, stage: str, kind: type[Any]) -> Any:
    found = record.stages.get(stage)
    return found.result if found is not None and isinstance(found.result, kind) else None


def _stage_bars(stages: Mapping[str, StageRecord[Any]]) -> list[dict[str, Any]]:
    """Name, seconds, share of the longest [%], and failure of every stage that ran."""
    longest_s = max((stage.duration_s for stage in stages.values()), default=1.0)
    return [
        {
            "name": name,
            "seconds": stage.duration_s,
            "share": 100 * stage.duration_s / longest_s,
            "failure": stage.failure.text if stage.failure is not None else "",
        }
        for name, stage in stages.items()
    ]


def _seen(record: CycleRecord, found: Detections | None) -> list[Picture]:
    pictures = []
    if found is not None:
        image = figures.annotated(found)
        pictures.append(Picture("Observed", figures.data_uri(image)))
        near = figures.crop(image, found.evidence.object_mask, margin_px=60)
        pictures.append(Picture("The object's outline and the grasp rectangles", figures.data_uri(near)))
    elif record.observation is not None:
        pictures.append(Picture("Observed", figures.data_uri(record.observation.frame.color)))
    if record.after is not None:
        pictures.append(Picture("Second look, while holding", figures.data_uri(record.after.frame.color)))
    return pictures


def _imagined(found: Detections | None) -> list[Picture]:
    if found is None:
        return []
    evidence = found.evidence
    around = evidence.object_mask | evidence.goal_rod_mask
    return [
        Picture("Goal image: the imagined rod", figures.data_uri(figures.crop(evidence.goal_image, around))),
        Picture("Rod found in it", figures.data_uri(figures.crop(evidence.goal_rod_mask, around))),
        Picture("Object found in it", figures.data_uri(figures.crop(evidence.goal_object_mask, around))),
    ]


def _grasps(found: Detections | None) -> list[dict[str, Any]]:
    if found is None:
        return []

    def moved_mm(grasp: Grasp) -> float:
        return float(np.linalg.norm(grasp.base_from_tcp[:3, 3] - grasp.imagined_base_from_tcp[:3, 3]) * 1e3)

    return [{**dict(grasp), "snapped_mm": moved_mm(grasp)} for grasp in found.grasps]


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


def _clouds(record: CycleRecord, found: Detections | None, plan: PickPlan | None) -> Chart | None:
    if found is None or record.observation is None:
        return None
    grasp = found.grasps[plan.grasp if plan is not None else 0]
    figure = figures.clouds(found, grasp, np.asarray(record.observation.view.base_from_color))
    alignment = found.evidence.alignment
    title = (
        f"{alignment.method}: scale {alignment.scale:.3f}, residual {alignment.residual:.3f}, "
        f"Chamfer {alignment.chamfer_m2 * 1e6:.2f} mm², {alignment.hypotheses} orientations tried"
    )
    return _chart(title, figure)


def _motion(record: CycleRecord) -> list[Chart]:
    execution, delivery = _result(record, "execute", Execution), _result(record, "deliver", Delivery)
    runs: list[SegmentRun] = [*(execution.runs if execution else ()), *(delivery.runs if delivery else ())]
    if not runs:
        return []
    grasped = execution.grasped.width_m if execution is not None and execution.grasped is not None else None
    charts = [_chart("Hand width", figures.hand_width(runs, grasped))]
    charts += [
        _chart(f"Commanded {name}, 1 kHz, as a share of the FR3's limit", figure)
        for name, figure in figures.joint_use(runs).items()
    ]
    return [*charts, _chart("Measured against commanded", figures.tracking(runs))]


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
        Fact("load on the arm", f"{verdict.load_n:.2f} N", f"≥ {need.get('min_load_n')} N"),
        Fact(
            "of the object's place is empty",
            f"{verdict.cleared_fraction * 100:.0f} %",
            f"≥ {need.get('min_cleared_fraction', 0) * 100:.0f} %",
        ),
    ]


def _chart(title: str, figure: go.Figure) -> Chart:
    # "</" must not end the script element that holds the data.
    return Chart(title, Markup(figure.to_json().replace("</", "<\\/")))

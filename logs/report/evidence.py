"""The evidence of a cycle as the images, figures and facts of its page."""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

import numpy as np

from bus.messages import Detections, Grasp, PickPlan
from bus.rejection import Rejection
from logs.mcap.reader import CycleRecord
from logs.recorded_settings import recorded_number
from logs.report import images
from logs.report.clouds import clouds
from logs.report.look_points import true_pose
from logs.report.page import Chart, Fact, Picture
from logs.report.scene import SceneView, css_color

_THUMBNAIL_PX = 240
_PAINTED = "painted"
"""The alignment's method where the model painted its rod into the observed image (`bus.messages.Alignment`)."""


class Choice(NamedTuple):
    """The outcome of plan for the grasps.

    Attributes:
        grasp: index of the chosen one; the best one when nothing was planned, None when all were rejected.
        rejected: the rejected ways to grasp.
    """

    grasp: int | None
    rejected: tuple[Rejection, ...]


class AlignmentView(NamedTuple):
    """The chart of the clouds, and which of its traces are seen before the alignment and after it."""

    chart: Chart
    before: list[bool]
    after: list[bool]


class ShownGrasp(NamedTuple):
    """A grasp as found, and how far it was moved from the imagined rod onto the observed surface [mm].

    Attributes:
        number, color: of the thing it holds; the colour in CSS.
    """

    found: Grasp
    snapped_mm: float
    number: int
    color: str


def choice(record: CycleRecord, found: Detections | None) -> Choice:
    """Return the chosen and the rejected grasps of a cycle."""
    best = 0 if found is not None and found.grasps else None
    stage = record.stages.get("plan")
    if stage is not None and isinstance(stage.result, PickPlan):
        return Choice(stage.result.grasp, stage.result.rejected)
    if stage is not None and stage.failure is not None and stage.failure.rejected:
        return Choice(None, stage.failure.rejected)
    return Choice(best, ())


def thumbnail(record: CycleRecord, found: Detections | None, chosen: Choice, scene: SceneView | None) -> str:
    """A small image of the cycle as a data URI; "" when nothing was captured."""
    if found is not None:
        near = images.crop(images.annotated(found, *chosen), found.evidence.object_mask, margin_px=40)
        return images.data_uri(near, width_px=_THUMBNAIL_PX)
    if scene is not None:
        return images.data_uri(scene.picture, width_px=_THUMBNAIL_PX)
    seen = record.observation
    return images.data_uri(seen.frame.color, width_px=_THUMBNAIL_PX) if seen is not None else ""


def seen(record: CycleRecord, found: Detections | None) -> list[Picture]:
    """Return the images of the observation: colour, depth and, when captured, the view while holding."""
    pictures = []
    if record.observation is not None:
        color = found.evidence.color if found is not None else record.observation.frame.color
        pictures.append(Picture("Colour", images.data_uri(color)))
        depth, meaning = images.colored_depth(record.observation.frame.depth_m)
        pictures.append(Picture(f"Depth: {meaning}", images.data_uri(depth, width_px=640)))
    if record.after is not None:
        pictures.append(Picture("After the lift, while holding", images.data_uri(record.after.frame.color)))
    return pictures


def imagined(found: Detections | None) -> list[Picture]:
    """Return the goal image and the masks of its parts; none without detections."""
    if found is None:
        return []
    evidence = found.evidence
    around = evidence.object_mask | evidence.goal_rod_mask
    origin = "as painted" if is_painted(found) else "found in it"
    title = "The best grasp's closing axis, drawn as a rod" if found.detector else "Goal image: the imagined rod"
    return [
        Picture(title, images.data_uri(images.crop(evidence.goal_image, around))),
        Picture(f"Rod {origin}", images.data_uri(images.crop(evidence.goal_rod_mask, around))),
        Picture(f"Object {origin}", images.data_uri(images.crop(evidence.goal_object_mask, around))),
    ]


def is_painted(found: Detections | None) -> bool:
    """Whether the rod was painted into the observed image: then nothing can have drifted, and nothing was aligned."""
    return found is not None and found.evidence.alignment.method == _PAINTED


def drift(record: CycleRecord, found: Detections | None) -> list[Fact]:
    """Return the drift of the goal image, beside its limits; none of a painted one."""
    if found is None or is_painted(found):
        return []
    drift = found.evidence.drift

    def limit(name: str, form: str) -> str:
        value = recorded_number(record.station, "perception", "drift", name)
        return "-" if value is None else f"{value:{form}}"

    turn = f"{np.degrees(drift.turn_rad):.0f}°, {drift.shift_px:.0f} px, x {drift.scale:.2f}"
    return [
        Fact("background changed", f"{drift.changed_outside:.1%}", f"at most {limit('max_changed_outside', '.0%')}"),
        Fact("outline overlaps", f"{drift.silhouette_iou:.0%}", f"at least {limit('min_silhouette_iou', '.0%')}"),
        Fact("colour moved (CIE76)", f"{drift.color_shift:.0f}", f"at most {limit('max_color_shift', '.0f')}"),
        Fact("turned, shifted, scaled by", turn, "carried back by the alignment"),
        Fact("proposals that agree", f"{found.evidence.agreement:.0%}", f"number {found.evidence.sample + 1} chosen"),
    ]


def alignment_view(record: CycleRecord, found: Detections | None, chosen: Choice) -> AlignmentView | None:
    """Return the 3-D figure of the alignment with its traces by view; None without detections."""
    if found is None or record.observation is None:
        return None
    grasp = found.grasps[chosen.grasp or 0] if found.grasps else None
    view = clouds(found, grasp, np.asarray(true_pose(record.observation, record.scene)), is_painted(found))
    if is_painted(found):
        return AlignmentView(Chart("The observed points, the rod, and the hand", view.figure), view.before, view.after)
    alignment = found.evidence.alignment
    title = (
        f"{alignment.method}: scale {alignment.scale:.3f}, residual {alignment.residual:.3f} of the object's radius, "
        f"Chamfer {alignment.chamfer_m2 * 1e6:.2f} mm², {alignment.hypotheses} orientations tried"
    )
    return AlignmentView(Chart(title, view.figure), view.before, view.after)


def rectangles(found: Detections | None, chosen: Choice) -> str:
    """Return the colour image around the object with the grasp rectangles, as a data URI; "" without detections."""
    if found is None:
        return ""
    return images.data_uri(images.crop(images.annotated(found, *chosen), found.evidence.object_mask, margin_px=60))


def grasps(found: Detections | None) -> list[ShownGrasp]:
    """Return the table of the grasps, each with its distance [mm] to the imagined one; none without detections."""
    if found is None:
        return []

    def moved_mm(grasp: Grasp) -> float:
        return float(np.linalg.norm(grasp.base_from_tcp[:3, 3] - grasp.imagined_base_from_tcp[:3, 3]) * 1e3)

    return [ShownGrasp(grasp, moved_mm(grasp), grasp.instance, css_color(grasp.instance)) for grasp in found.grasps]


def rejections(chosen: Choice) -> dict[int, list[str]]:
    """Per grasp: its distinct reasons, with the approach directions they apply to."""
    by_reason: dict[int, dict[tuple[str, str], list[Rejection]]] = defaultdict(lambda: defaultdict(list))
    for one in chosen.rejected:
        by_reason[one.grasp][one.code.value, one.reason].append(one)
    return {
        grasp: [
            f"{code} at {', '.join(f'{np.degrees(one.tilt_rad):.0f}°' for one in same)}: {reason}"
            for (code, reason), same in reasons.items()
        ]
        for grasp, reasons in by_reason.items()
    }

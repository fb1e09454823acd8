"""Grasps of another package's detector: it is asked, and its grasps take the form of ours.

What it gave is kept as it is: nothing is snapped to the surface, and no grasp is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from bus.arrays import Vector3
from bus.codes import DETECTOR_FOUND_NONE, Code
from bus.errors import CycleFailure
from bus.messages import Detections, Evidence, Grasp, ObservedScene, Tried
from bus.transforms import apply, inverse
from config.schema import Station
from perception.detectors.base import FoundGrasp, SeenLook, SeenScene
from perception.evidence import evidence_of
from perception.geometry.rod import rectangle
from perception.goal.imagine import Conversation, observed_object_of
from perception.goal.target import among, untried
from perception.grasps.rank import rank
from perception.models.detector_call import DetectorCall
from perception.models.painter import paint
from perception.models.sam import Sam
from perception.proposal import as_painted
from perception.scene.scene import Scene

_STICK_OUT_M = 0.035
_FROM_ABOVE = float(np.cos(np.deg2rad(5)))
"""As with ours, so much counts as from above."""
_TERM = "detector"

Array = npt.NDArray[np.float64]
ScalarT = TypeVar("ScalarT", bound=np.generic)


@dataclass(frozen=True)
class _Held:
    """A found grasp, the thing that it holds, and why it is left out ("" = it is not)."""

    grasp: FoundGrasp
    instance: int
    left_out: str


def found_by(
    detector: DetectorCall,
    scene: Scene,
    seen: ObservedScene,
    words: tuple[Conversation, Sam | None],
    station: Station,
    failed_at: Sequence[Vector3],
) -> Detections:
    """Return the detector's ranked grasps, with evidence.

    Args:
        words: who finds the target when the station names it, and hears of the call.
        failed_at: (3,) places in ``base``: the things there are no targets.

    Raises: CycleFailure: NO_GRASP without any; LEFT_OVER, TARGET_NOT_FOUND, OBSTRUCTED; as `DetectorCall.ask`.
    """
    talk, sam = words
    every = list(range(1, scene.count + 1))
    targets = untried(scene, among(scene, seen.instances, every, talk, station, sam), failed_at)
    given = detector.ask(_shown_to_it(scene, seen, targets, station), talk.on_reply, talk.cancel)
    held = [_held(one, scene, targets, station) for one in given]
    kept = sorted((one for one in held if not one.left_out), key=lambda one: -one.grasp.score)
    kept = kept[: station.perception.max_grasps]
    if not kept:
        raise _no_grasp(detector.name, held, targets)
    ends = [_ends(one.grasp, scene) for one in kept]
    return Detections(
        rectangles=tuple(rectangle(one, scene.rgbd.camera, station) for one in ends),
        grasps=rank([_as_ours(one, index, station) for index, one in enumerate(kept)], station),
        evidence=_evidence(kept[0], ends[0], scene, seen, station),
        scene=seen,
        tried=_tried(held),
        detector=detector.name,
    )


def _shown_to_it(scene: Scene, seen: ObservedScene, targets: Sequence[int], station: Station) -> SeenScene:
    looks = tuple(
        SeenLook(
            _locked(look.rgbd.color),
            _locked(look.rgbd.depth_m),
            look.rgbd.camera,
            _locked(look.base_from_color),
            _locked(labels),
        )
        for look, labels in zip(scene.looks, seen.look_labels, strict=True)
    )
    base_from_table = _locked(scene.table.base_from_table)
    return SeenScene(looks, scene.shown, seen.instances, tuple(targets), base_from_table, station.hand)


def _locked(array: npt.NDArray[ScalarT]) -> npt.NDArray[ScalarT]:
    """A view that cannot be written to: another package's code gets the very arrays that ours goes on with."""
    view = array.view()
    view.flags.writeable = False
    return view


def _held(grasp: FoundGrasp, scene: Scene, targets: Sequence[int], station: Station) -> _Held:
    """Return which thing the grasp holds: that of the seen point nearest to the tcp, unless the detector says it."""
    labels, points = scene.cloud_labels, scene.cloud.points_table
    on_things = np.flatnonzero(labels if grasp.instance is None else labels == grasp.instance)
    tcp = apply(scene.table.table_from_base, np.asarray(grasp.base_from_tcp)[None, :3, 3])
    away_m = np.linalg.norm(points[on_things] - tcp, axis=1)
    nearest = int(away_m.argmin()) if len(away_m) else -1
    instance = int(labels[on_things[nearest]]) if nearest >= 0 else (grasp.instance or 0)
    most_m = station.hand.max_width_m
    if nearest < 0 or away_m[nearest] > most_m:
        x_m, y_m, z_m = grasp.base_from_tcp[:3, 3]
        why = f"nothing was seen of it within {most_m * 1e3:.0f} mm of the tcp, ({x_m:.3f}, {y_m:.3f}, {z_m:.3f}) m"
    elif station.perception.from_above and _leans(grasp, scene):
        why = "it does not come from above"
    elif instance not in targets:
        why = "it is not to be picked"
    elif not (scene.color_labels == instance).any():
        why = "it is only in other looks than the one shown"
    else:
        why = ""
    return _Held(grasp, instance, why)


def _leans(grasp: FoundGrasp, scene: Scene) -> bool:
    return bool(-grasp.base_from_tcp[:3, 2] @ scene.table.base_from_table[:3, 2] < _FROM_ABOVE)


def _ends(grasp: FoundGrasp, scene: Scene) -> Array:
    """(2, 3) [m] the contacts in the ``color`` frame."""
    half_m = np.array([[0.0, -grasp.width_m / 2, 0.0], [0.0, grasp.width_m / 2, 0.0]])
    return apply(inverse(scene.base_from_color) @ grasp.base_from_tcp, half_m)


def _as_ours(one: _Held, index: int, station: Station) -> Grasp:
    grasp = one.grasp
    opening_m = grasp.width_m + 2 * station.perception.approach_clearance_m
    return Grasp(
        base_from_tcp=grasp.base_from_tcp,
        width_m=grasp.width_m,
        opening_m=min(station.hand.max_width_m, opening_m),
        score=grasp.score,
        rectangle=index,
        imagined_base_from_tcp=grasp.base_from_tcp,
        terms={_TERM: grasp.score},
        instance=one.instance,
    )


def _evidence(best: _Held, ends: Array, scene: Scene, seen: ObservedScene, station: Station) -> Evidence:
    """A rod drawn along the best grasp's closing axis: what the record shows of ours, it shows of this one."""
    outline = scene.outline(best.instance)
    observed_object, crop = observed_object_of(scene, seen.instances, best.instance, outline)
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    rod = ends + np.outer([-_STICK_OUT_M, _STICK_OUT_M], along)
    goal = paint(observed_object, rod, station.perception.rod_radius_m, ends)
    assert goal.painted is not None and goal.depth_m is not None, "painted here"
    proposal = as_painted(goal, goal.painted, goal.depth_m, observed_object, station)
    return evidence_of(scene.rgbd, crop, observed_object, proposal, sample=0, agreement=1.0)


def _tried(held: Sequence[_Held]) -> tuple[Tried, ...]:
    """Of each thing its best grasp, or why its grasps are left out."""
    tried: dict[int, Tried] = {}
    for one in sorted(held, key=lambda one: (one.instance, bool(one.left_out), -one.grasp.score)):
        if one.left_out:
            made = Tried(instance=one.instance, sample=0, code=Code.NO_GRASP, text=f"Left out: {one.left_out}.")
        else:
            made = Tried(instance=one.instance, sample=0, score=one.grasp.score)
        tried.setdefault(one.instance, made)
    return tuple(tried.values())


def _no_grasp(name: str, held: Sequence[_Held], targets: Sequence[int]) -> CycleFailure:
    things = f"the {len(targets)} things there" if len(targets) > 1 else "the thing there"
    if not held:
        text = f"The detector {name!r} finds no grasp on {things}."
        return CycleFailure(Code.NO_GRASP, text, advice=DETECTOR_FOUND_NONE)
    why = "; ".join(sorted({f"thing {one.instance}: {one.left_out}" for one in held}))
    text = f"The detector {name!r} finds no usable grasp on {things}: {why}."
    return CycleFailure(Code.NO_GRASP, text, advice=DETECTOR_FOUND_NONE)

"""VLAD-Grasp (paper, Algorithm 1): see the scene, imagine rods through its things, derive grasps.

The scene is seen once; then rods are imagined for one thing after another (`perception.proposal`). See docs/frames.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bus.arrays import Transform, Vector3
from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections, Grasp, ModelReply, Observation, ObservedScene, Rectangle, Tried
from config.schema import Station
from perception.evidence import evidence_of
from perception.fusion.agreed import agreed
from perception.geometry.crop import Crop, Mask
from perception.geometry.inputs import checked
from perception.geometry.rod import rectangle
from perception.goal.axes import axes_of
from perception.goal.imagine import Conversation, OnReply, observed_object_of
from perception.goal.target import by_best_grasp, choose, untried
from perception.grasps.closing import Closings
from perception.grasps.faces import across_faces
from perception.grasps.rank import among_others, graded, rank
from perception.grasps.refusal import why_none
from perception.grasps.search import CLOSE, USUAL, Density, search
from perception.grasps.sides import search_sides
from perception.grasps.squared import squared
from perception.models import Models
from perception.observed_object import Axis, ObservedObject
from perception.other_detector import found_by
from perception.proposal import Proposal, grasps_of, propose
from perception.rectangles.metric import matches
from perception.scene.look import Look
from perception.scene.scene import Scene, scene_of
from perception.scene.seen import RegionView, described, require_something
from perception.scene.table import require_where_configured

_GOOD_FROM_ABOVE, _GOOD_IN_A_HEAP, _SIDES_OF = 0.8, 0.6, 2
"""When the best grasp from above scores less, the first few things are looked at from their sides, too, and all of them
as long as nothing is found. In a heap others stand beside them: only when hardly anything is left."""

_AXES_EACH = 3
"""So many axes of each thing are tried at least, of several looks: planning may find no way to the best."""

OnScene = Callable[[ObservedScene], None]


@dataclass(frozen=True)
class _Found:
    """One proposal that yielded grasps, and where in the image its object is."""

    grasps: tuple[Grasp, ...]
    proposal: Proposal
    observed_object: ObservedObject
    crop: Crop
    sample: int


def detect(
    observation: Observation,
    station: Station,
    models: Models,
    on_reply: OnReply,
    cancel: Cancel | None = None,
    on_scene: OnScene | None = None,
    others: Sequence[Observation] = (),
    is_again: bool = False,
    failed_at: Sequence[Vector3] = (),
) -> Detections:
    """Detect ranked grasps in the pick region, with their evidence. Pure, except for the models and their time.

    Args:
        on_reply: called with the record of every call to the goal-image model, as soon as the call ends.
        cancel: a stop request; checked before each proposal and each call.
        on_scene: called with what was seen, before anything is looked for in it.
        others: observations of the same scene from other places.
        is_again: the cycle has detected before, in fewer looks: a hosted model's budget goes on.
        failed_at: (3,) places in ``base``: the things there are no targets.

    Raises:
        CycleFailure: BAD_FRAME, NO_TABLE, TABLE_MOVED, TOO_NEAR, NO_OBJECT, NOT_SEEN, NO_DEPTH, TARGET_NOT_FOUND,
            OBSTRUCTED, NO_GRASP, LEFT_OVER, MODEL_*, DETECTOR_*, SPEND_LIMIT or STOPPED. Of several proposals, one
            that succeeds is enough.
    """
    cancel = cancel or Cancel()
    cancel.raise_if_set("detect")
    talk = Conversation(models.imaginer, on_reply, cancel=cancel)
    if not (is_again and models.imaginer.is_hosted):
        talk.begin()
    scene, seen = _see([observation, *others], station, on_scene)
    if models.detector is not None:
        return found_by(models.detector, scene, seen, (talk, models.sam), station, failed_at)
    closings = _searched(scene, seen, station, USUAL)
    targets = untried(scene, choose(scene, seen.instances, closings, talk, station, models.sam), failed_at)
    tries = _Tries(scene, seen, closings, talk, models, station, targets)
    tries.make(targets[: station.perception.imagine.targets])
    if not tries.found and not models.imaginer.is_hosted:
        tries.make_closer()
    if not tries.found:
        raise why_none(tries.failures, closings, scene, seen, station)
    return _detections(tries, station)


def _searched(scene: Scene, seen: ObservedScene, station: Station, density: Density) -> Closings:
    """The closings from above, all over the scene."""
    closings = graded(search(scene.heights, station, density=density), seen.instances)
    return across_faces(closings, scene, scene.table.base_from_table)


def _see(
    observations: Sequence[Observation], station: Station, on_scene: OnScene | None
) -> tuple[Scene, ObservedScene]:
    """The model of the scene, also as a message. Raises: CycleFailure, when nothing can be grasped in it."""
    looks, mount = agreed([Look.of(checked(one), station) for one in observations], station)
    scene = scene_of(looks, station)
    region = RegionView.of(scene, station)
    seen = described(scene, region, mount)
    if on_scene is not None:
        on_scene(seen)
    require_where_configured(scene.table, station)
    require_something(scene, region, station)
    return scene, seen


@dataclass
class _Tries:
    """Rods imagined for one thing after another; what fails is kept with its reason, and the next one is tried."""

    scene: Scene
    seen: ObservedScene
    closings: Closings
    talk: Conversation
    models: Models
    station: Station
    targets: list[int]
    found: list[_Found] = field(default_factory=list)
    tried: list[Tried] = field(default_factory=list)
    failures: list[CycleFailure] = field(default_factory=list)
    _is_closer: bool = False
    _asked: dict[int, tuple[Axis, ...]] = field(default_factory=dict)
    _sides: dict[int, list[tuple[Closings, Transform]]] = field(default_factory=dict)

    def make(self, targets: list[int]) -> None:
        """Try the targets, until a hosted model succeeds or the time is over; an embedded one costs nothing."""
        settings, began_s = self.station.perception.imagine, self.talk.clock_s()
        samples = self._samples(len(targets))
        for number in targets:
            if self.found and self.models.imaginer.is_hosted:
                return
            if self.talk.clock_s() - began_s > settings.budget_s:
                return
            axes = self._axes(number)
            if self.found and not axes:
                return
            try:
                outline = self._outline(number)
            except CycleFailure as failure:
                self._failed(number, 0, failure)
                continue
            asked = self._asked.get(number, ())  # a model goes on behind the axes that it was asked for before
            one = observed_object_of(self.scene, self.seen.instances, number, outline, (*asked, *axes))
            self._asked[number] = (*asked, *axes[:samples])
            for sample in range(samples if self.models.imaginer.is_hosted else min(samples, max(len(axes), 1))):
                self._try(*one, len(asked) + sample)

    def make_closer(self) -> None:
        """Try every target again, of a closer search, and from its sides; for a model whose rods cost nothing."""
        self._is_closer = True
        self.closings = _searched(self.scene, self.seen, self.station, CLOSE)
        order = by_best_grasp(self.scene, self.closings)
        self.make(sorted(self.targets, key=order.index))

    def _samples(self, things: int) -> int:
        """Return how many rods are imagined for each of so many things."""
        settings = self.station.perception.imagine
        if settings.samples != "auto":
            return settings.samples
        if self.models.imaginer.is_hosted or len(self.scene.looks) == 1:
            return 1
        return max(_AXES_EACH, settings.targets // max(things, 1))

    def _outline(self, number: int) -> Mask:
        """The outline (H, W) of a thing in the look that is shown. Raises: CycleFailure(NO_DEPTH) without one there."""
        if not (self.scene.color_labels == number).any():
            raise CycleFailure(Code.NO_DEPTH, f"Thing {number} is only in other looks than the one shown.")
        outline = self.models.refined(self.scene.outline(number), self.scene.rgbd.color)
        _require_depth(self.scene, outline)
        return outline

    def _failed(self, number: int, sample: int, failure: CycleFailure) -> None:
        self.failures.append(failure)
        self.tried.append(Tried(instance=number, sample=sample, code=failure.failure, text=failure.text))

    def _axes(self, number: int) -> tuple[Axis, ...]:
        """Along which the jaw could close on a thing, the best first; from its sides when from above they are weak.

        Of several looks, the hand also leans as the faces do that it closes on.
        """
        scene, seen, station = self.scene, self.seen.instances, self.station
        found = [(self.closings, scene.table.base_from_table)]
        if not station.perception.from_above:
            if self._wants_sides():
                found += self._from_sides(number)
            found += squared(found, scene, seen, number, station)
        axes = [axis for closings, base_from_level in found for axis in axes_of(closings, number, base_from_level)]
        return tuple(sorted(axes, key=lambda axis: -axis.score))

    def _from_sides(self, number: int) -> list[tuple[Closings, Transform]]:
        if number not in self._sides:
            self._sides[number] = list(search_sides(self.scene, self.seen.instances, number, self.station))
        return self._sides[number]

    def _wants_sides(self) -> bool:
        good = _GOOD_FROM_ABOVE if self.scene.count == 1 else _GOOD_IN_A_HEAP
        looked_at = {tried.instance for tried in self.tried}
        best = self.closings.score[np.isin(self.closings.instance, self.targets)].max(initial=-np.inf)
        return best < good and (len(looked_at) < _SIDES_OF or (self._is_closer and self._is_last()))

    def _is_last(self) -> bool:
        """Whether the cell would not look again, which shows more than ten more directions of each thing."""
        capture = self.station.capture
        return capture.views != "auto" or len(self.scene.looks) >= capture.most_views

    def _try(self, observed_object: ObservedObject, crop: Crop, sample: int) -> None:
        self.talk.cancel.raise_if_set("detect")
        number = observed_object.instance.number
        try:
            proposal = propose(replace(self.talk, sample=sample), observed_object, self.models, self.station)
            grasps = grasps_of(proposal, observed_object, self.station)
            grasps = among_others(grasps, self.station) if self.scene.count > 1 else grasps
        except CycleFailure as failure:
            if failure.failure is Code.STOPPED:
                raise
            self._failed(number, sample, failure)
            return
        self.found.append(_Found(grasps, proposal, observed_object, crop, sample))
        self.tried.append(Tried(instance=number, sample=sample, score=grasps[0].score))


def _require_depth(scene: Scene, outline: Mask) -> None:
    """Raises: CycleFailure(NO_DEPTH) when no pixel of the outline, which a segmenter may have redrawn, has depth."""
    if not np.isfinite(scene.rgbd.depth_m[outline]).any():
        pixels = int(outline.sum())
        raise CycleFailure(
            Code.NO_DEPTH, f"The camera measures no depth on the object (outline of {pixels} pixels): glass, or black?"
        )


def _detections(tries: _Tries, station: Station) -> Detections:
    """Everything that survived, and the evidence of the proposal with the best grasp."""
    rgbd, found = tries.scene.rgbd, tries.found
    grasps: list[Grasp] = []
    rectangles: list[Rectangle] = []
    for one in found:
        before = len(rectangles)
        grasps += [grasp.model_copy(update={"rectangle": grasp.rectangle + before}) for grasp in one.grasps]
        rectangles += [rectangle(ends, rgbd.camera, station) for ends in one.proposal.ends]
    best = max(found, key=lambda one: one.grasps[0].score)
    alike = [one for one in found if one.observed_object.instance == best.observed_object.instance]
    tried = [one for one in tries.tried if one.instance == best.observed_object.instance.number]
    agree = sum(_same_place(best.proposal, one.proposal) for one in alike) / len(tried)
    return Detections(
        rectangles=tuple(rectangles),
        grasps=rank(grasps, station),
        evidence=evidence_of(rgbd, best.crop, best.observed_object, best.proposal, best.sample, agree),
        scene=tries.seen,
        tried=tuple(tries.tried),
    )


def _same_place(chosen: Proposal, other: Proposal) -> bool:
    return any(matches(one, another) for one in chosen.rectangles for another in other.rectangles)


def ignore_reply(_reply: ModelReply) -> None:
    """Discard a reply: an ``on_reply`` for callers that record nothing."""


unsaid = ignore_reply
"""The former name of `ignore_reply`, kept for programs that import it."""

"""The checks that every detector passes: scene in, 6-DoF grasps out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from config.plug_ins import Group
from config.schema import Station
from perception.detector import detect
from perception.detectors.base import FoundGrasp, GraspDetector, SeenScene
from perception.detectors.checked import checked
from perception.detectors.registry import GROUP
from perception.models import Models
from perception.models.detector_call import DetectorCall
from perception.models.geometric import GeometricModel
from vlad_cell.testing.plug_in import PlugInSuite
from vlad_cell.testing.scene import BAR, PLATE, REGION, seen

_HONEST = {Code.NO_GRASP, Code.NOT_SEEN, Code.NO_DEPTH, Code.TARGET_NOT_FOUND, Code.STOPPED}
"""Codes with which a detector may end a cycle when it finds nothing; any other exception is DETECTOR_FAILED."""
_PLATE, _BAR = 1, 2
"""The numbers of the two things: the cell numbers them by the table that they cover."""


class _Watching:
    """Finds nothing, and keeps the scene that it was shown."""

    is_deterministic = False

    def __init__(self) -> None:
        self.scenes: list[SeenScene] = []

    def detect(self, seen: SeenScene, cancel: Cancel) -> Sequence[FoundGrasp]:
        self.scenes.append(seen)
        return ()

    def close(self) -> None:
        """Do nothing."""


class DetectorSuite(PlugInSuite):
    """The checks of a detector, on a bar (127 x 30 x 30 mm) and a plate wider than the jaw, seen from above."""

    group: ClassVar[Group] = GROUP
    overrides: ClassVar[Sequence[str]] = (REGION,)

    @pytest.fixture(scope="class")
    @classmethod
    def detector(cls, station: Station) -> Iterator[GraspDetector]:
        """Yield the detector, opened."""
        detector: GraspDetector = GROUP.opened(cls.name, station, cls.settings, "perception.settings")
        yield detector
        detector.close()

    @pytest.fixture(scope="class")
    @classmethod
    def scene(cls, station: Station) -> SeenScene:
        """Return what the cell shows a detector of the bar and the plate."""
        watching = _Watching()
        models = Models(GeometricModel(station), detector=DetectorCall("watching", watching, None))
        with pytest.raises(CycleFailure, match="finds no grasp"):
            detect(seen([BAR, PLATE]), station, models, lambda _: None)
        return watching.scenes[0]

    def test_it_says_whether_it_is_deterministic(self, detector: GraspDetector) -> None:
        assert isinstance(detector.is_deterministic, bool)

    def test_it_finds_a_grasp_on_a_bar_and_each_is_one_that_the_cell_accepts(
        self, detector: GraspDetector, scene: SeenScene
    ) -> None:
        """Numbers, a rotation, a width within the jaw, a score from 0 to 1, a thing that is there."""
        grasps = checked(self.name, detector.detect(scene, Cancel()), scene)
        assert any(one.instance in (None, _BAR) for one in grasps)

    def test_its_grasps_are_in_base_where_the_things_are(self, detector: GraspDetector, scene: SeenScene) -> None:
        for one in checked(self.name, detector.detect(scene, Cancel()), scene):
            away_m = [float(np.linalg.norm(one.base_from_tcp[:3, 3] - thing.top_m)) for thing in scene.things]
            assert min(away_m) < 0.15, f"{one.base_from_tcp[:3, 3]} m is far from every thing"

    def test_its_grasps_move_with_the_scene(self, detector: GraspDetector, scene: SeenScene) -> None:
        """Move the whole scene 0.1 m along y of ``base``: its grasps move with it."""
        if not detector.is_deterministic:
            pytest.skip("not deterministic")
        moved = _moved(scene, np.array([0.0, 0.1, 0.0]))
        here, there = (checked(self.name, detector.detect(one, Cancel()), one) for one in (scene, moved))
        assert len(here) == len(there)
        middle = [np.mean([one.base_from_tcp[:3, 3] for one in grasps], axis=0) for grasps in (here, there)]
        np.testing.assert_allclose(middle[1] - middle[0], [0.0, 0.1, 0.0], atol=0.005)

    def test_a_deterministic_one_gives_the_same_bits_again(
        self, detector: GraspDetector, scene: SeenScene, station: Station
    ) -> None:
        """A replay opens it anew and compares."""
        if not detector.is_deterministic:
            pytest.skip("not deterministic: a replay gives back what was recorded")
        first = detector.detect(scene, Cancel())
        anew: GraspDetector = GROUP.opened(self.name, station, self.settings, "perception.settings")
        for other in (detector, anew):
            again = other.detect(scene, Cancel())
            assert [_exact(one) for one in again] == [_exact(one) for one in first]
        anew.close()

    def test_things_that_may_not_be_picked_do_not_make_it_fail(self, detector: GraspDetector, scene: SeenScene) -> None:
        only_plate = replace(scene, targets=(_PLATE,))
        checked(self.name, _found(detector, only_plate), only_plate)

    def test_without_depth_it_finds_nothing_and_says_so_without_a_defect(
        self, detector: GraspDetector, scene: SeenScene
    ) -> None:
        depth_m = np.full_like(scene.look.depth_m, np.nan)
        blind = replace(scene, looks=(replace(scene.look, depth_m=depth_m),))
        checked(self.name, _found(detector, blind), blind)

    def test_after_a_stop_it_ends_soon(self, detector: GraspDetector, scene: SeenScene) -> None:
        stopped = Cancel()
        stopped.set()
        _found(detector, scene, stopped)


def _found(detector: GraspDetector, scene: SeenScene, cancel: Cancel | None = None) -> Sequence[FoundGrasp]:
    """Its grasps; none where it ends with a code that says why there are none."""
    try:
        return detector.detect(scene, cancel or Cancel())
    except CycleFailure as failure:
        assert failure.failure in _HONEST, f"it may not end a cycle with {failure.failure}"
        return ()


def _moved(scene: SeenScene, by_m: np.ndarray) -> SeenScene:
    """The scene with everything in it elsewhere in ``base``."""
    shift = np.eye(4)
    shift[:3, 3] = by_m
    looks = tuple(replace(look, base_from_camera=shift @ look.base_from_camera) for look in scene.looks)
    things = tuple(one.model_copy(update={"top_m": one.top_m + by_m}) for one in scene.things)
    return replace(scene, looks=looks, things=things, base_from_table=shift @ scene.base_from_table)


def _exact(one: FoundGrasp) -> tuple[object, ...]:
    return np.asarray(one.base_from_tcp).tobytes(), one.width_m, one.score, one.instance

"""What drift does to a painted picture, measured in it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stand_ins.asked import Image, Mask
from stand_ins.drift import NONE, Drift, apply, hard, mild
from stand_ins.scenery import object_of

ROD = (255, 0, 200)


def before() -> Image:
    """A green bar with a darker end on white."""
    image = np.full((240, 240, 3), 255, dtype=np.uint8)
    cv2.ellipse(image, (120, 120), (24, 60), 0, 0, 360, (40, 160, 60), -1)
    image[150:][image[150:, :, 0] == 40] = 30, 90, 40
    return image


def painted(*, over: bool = False) -> Image:
    """A horizontal rod through it."""
    image = before()
    rod = np.zeros(image.shape[:2], dtype=bool)
    rod[116:124, 70:170] = True
    image[rod if over else rod & ~object_of(image, None)] = ROD
    return image


def drifted(drift: Drift, *, over: bool = False) -> Image:
    return apply(before(), painted(over=over), object_of(before(), None), drift)


def rod_of(image: Image) -> Mask:
    return np.asarray(np.abs(image.astype(np.int16) - ROD).max(axis=2) < 60)


def body_of(image: Image) -> Mask:
    return np.asarray((image[..., 1] > image[..., 0].astype(np.int16) + 30) & (image[..., 2] < 150))


def angle_deg(mask: Mask) -> float:
    """Of the longest direction, counter-clockwise as seen, 0-180."""
    points = np.argwhere(mask)[:, ::-1] - np.argwhere(mask)[:, ::-1].mean(axis=0)
    direction = np.linalg.svd(points, full_matrices=False)[2][0]
    return float(np.rad2deg(np.arctan2(-direction[1], direction[0])) % 180)


def parts(mask: Mask, smallest: int = 30) -> int:
    stats = cv2.connectedComponentsWithStats(mask.astype(np.uint8))[2]
    return int((stats[1:, cv2.CC_STAT_AREA] >= smallest).sum())


def apart_deg(first: float, second: float) -> float:
    return abs((first - second + 90) % 180 - 90)


def test_no_drift_is_the_painted_picture_itself() -> None:
    assert (drifted(NONE) == painted()).all()
    assert (drifted(Drift(seed=9)) == painted()).all()


@pytest.mark.parametrize("rotation_deg", [-150.0, -40.0, 15.0, 75.0, 180.0])
@pytest.mark.parametrize("over", [False, True])
def test_rod_and_object_turn_by_the_angle(rotation_deg: float, over: bool) -> None:
    image = drifted(Drift(rotation_deg), over=over)
    assert apart_deg(angle_deg(rod_of(image)), rotation_deg) < 1
    assert apart_deg(angle_deg(body_of(image)), 90 + rotation_deg) < 1


@pytest.mark.parametrize("scale", [0.6, 1.0 / 1.2, 1.25])
def test_rod_and_object_scale(scale: float) -> None:
    image, plain = drifted(Drift(scale=scale)), painted()
    assert np.sqrt(body_of(image).sum() / body_of(plain).sum()) == pytest.approx(scale, rel=0.04)
    assert np.ptp(np.argwhere(rod_of(image)), axis=0)[1] == pytest.approx(99 * scale, abs=3)


def test_both_shift() -> None:
    moved = np.argwhere(rod_of(drifted(Drift(shift_px=(20, -10))))).mean(axis=0)
    assert np.allclose(moved - np.argwhere(rod_of(painted())).mean(axis=0), (-10, 20), atol=0.7)


def test_an_object_that_would_leave_the_picture_is_drawn_smaller() -> None:
    body = body_of(drifted(Drift(30, 4.0)))
    assert body.sum() > body_of(painted()).sum()
    assert not np.concatenate([body[0], body[-1], body[:, 0], body[:, -1]]).any()


@pytest.mark.parametrize("seed", range(4))
def test_a_tilt_shows_another_side_and_keeps_the_rod_straight(seed: int) -> None:
    image = drifted(Drift(tilt_deg=20, seed=seed))
    rod, body = rod_of(image), body_of(image)
    assert (image != painted()).any(axis=2).sum() > 300
    assert body.sum() == pytest.approx(body_of(painted()).sum(), rel=0.15)
    assert parts(body) == 1
    assert parts(rod) == 2
    points = np.argwhere(rod) - np.argwhere(rod).mean(axis=0)
    assert np.linalg.svd(points, full_matrices=False)[1][1] / np.sqrt(len(points)) < 3, "px, a straight line's width"


def test_without_rod() -> None:
    assert not rod_of(drifted(Drift(rod="none"))).any()
    turned = drifted(Drift(30, rod="none"))
    assert not rod_of(turned).any()
    assert apart_deg(angle_deg(body_of(turned)), 120) < 1


def test_two_rods_cross() -> None:
    assert rod_of(drifted(Drift(rod="two", seed=3))).sum() > 1.5 * rod_of(painted()).sum()


def test_a_second_object_stands_apart() -> None:
    image = drifted(Drift(10, second_object=True))
    assert parts(body_of(painted())) == 1
    assert parts(body_of(image)) == 2
    assert parts(rod_of(image)) == 2


def test_recolored_objects_keep_the_rods_colour() -> None:
    image = drifted(Drift(recolor=0.7, seed=1))
    assert np.abs(image[100, 120].astype(int) - painted()[100, 120]).max() > 40
    assert (rod_of(image) == rod_of(painted())).mean() > 0.995


def test_another_shape() -> None:
    plain, image = body_of(painted()), body_of(drifted(Drift(shape=0.1, seed=2)))
    overlap = (plain & image).sum() / (plain | image).sum()
    assert 0.6 < overlap < 0.95


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("draw", [mild, hard])
def test_presets_are_seeded_and_keep_the_background(draw, seed: int) -> None:  # type: ignore[no-untyped-def]
    drift = draw(seed)
    image = drifted(drift)
    assert draw(seed) == drift != draw(seed + 1)
    assert (image == drifted(drift)).all()
    assert rod_of(image).any()
    assert body_of(image).any()
    assert (image[:4, :4] == 255).all(), "white stays white"


def test_ranges_of_the_presets() -> None:
    for seed in range(100):
        slight, strong = mild(seed), hard(seed)
        assert abs(slight.rotation_deg) <= 15
        assert 0 <= slight.tilt_deg <= 8
        assert 0.8 <= slight.scale <= 1.25
        assert abs(strong.rotation_deg) <= 180
        assert 0 <= strong.tilt_deg <= 25
        assert 0.6 <= strong.scale <= 1.6


def test_the_object_by_its_mask_or_by_its_background() -> None:
    found = object_of(before(), None)
    assert (found == body_of(before())).mean() > 0.999
    assert (object_of(before(), ~found) == found).all(), "what must not be edited"
    band = np.zeros_like(found)
    band[110:130] = True
    assert (object_of(before(), band) == found).all(), "a mask of where to draw tells nothing of the object"

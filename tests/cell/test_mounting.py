"""The camera's mounting from pick to pick: what is kept, what proves nothing, and what the operator is told, once."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bus.messages import SeenMount
from bus.transforms import angle_between_rad, from_rotation
from cell.pick.mounting import MountKeeper


def _seen(deg: float = 0.0, mm: float = 0.0, *, named: str = "", is_cut: bool = False) -> SeenMount:
    turn = Rotation.from_rotvec(np.deg2rad([deg, 0.0, 0.0])).as_matrix()
    return SeenMount.model_validate(
        {
            "color_from_corrected": from_rotation(turn, (mm / 1e3, 0.0, 0.0)),
            "turn_rad": np.deg2rad(abs(deg)),
            "turn_deviation_rad": 0.001,
            "shift_m": mm / 1e3,
            "shift_deviation_m": 0.001,
            "residual_before_m": 0.002,
            "residual_after_m": 0.001,
            "is_cut": is_cut,
            "named": named,
            "table_tilt_rad": np.deg2rad(2.0),
            "off_mounting": 1.0,
        }
    )


def _kept(keeper: MountKeeper) -> tuple[float, float]:
    """Turn [deg] and shift [mm] that are kept."""
    pose = keeper.color_from_corrected
    return float(np.degrees(angle_between_rad(np.eye(4), pose))), float(1e3 * np.linalg.norm(pose[:3, 3]))


def test_what_remains_wrong_is_taken_off_pick_by_pick() -> None:
    keeper, wrong_deg = MountKeeper(), 0.5
    for _ in range(5):
        keeper.take(_seen(wrong_deg - _kept(keeper)[0]))
    assert _kept(keeper)[0] == pytest.approx(wrong_deg, abs=0.01)


def test_one_odd_pick_among_many_hardly_counts() -> None:
    keeper = MountKeeper()
    for _ in range(10):
        keeper.take(_seen(0.0))
    keeper.take(_seen(0.6, 3.0))
    assert np.allclose(_kept(keeper), (0.06, 0.3), atol=1e-6)


def test_the_kept_correction_is_bounded() -> None:
    keeper = MountKeeper()
    for _ in range(200):
        keeper.take(_seen(1.0, 5.0))
    assert np.allclose(_kept(keeper), (1.5, 9.0), atol=1e-6)


def test_a_correction_that_was_cut_proves_nothing() -> None:
    keeper = MountKeeper()
    keeper.take(_seen(1.0, is_cut=True))
    assert keeper.picks == 0 and np.array_equal(keeper.color_from_corrected, np.eye(4))


def test_the_operator_is_told_once_when_something_begins_to_be_off() -> None:
    keeper = MountKeeper()
    told = [keeper.news(_seen(0.6, 3.0, named=named)) for named in ("mount", "", "mount", "table", "table")]
    assert [event.code if event is not None else "" for event in told] == ["MOUNT_MOVED", "", "", "TABLE_TILTED", ""]
    assert told[0] is not None and "0.60 +- 0.06 deg and 3.0 +- 1.0 mm from the station's" in told[0].text
    assert told[3] is not None and "2.0 deg" in told[3].text


def test_what_was_told_is_told_again_after_it_was_right_for_some_picks() -> None:
    keeper = MountKeeper()
    assert keeper.news(_seen(named="table")) is not None
    assert keeper.news(_seen()) is None and keeper.news(_seen(named="table")) is None, "one quiet pick proves nothing"
    for _ in range(5):
        assert keeper.news(_seen()) is None
    assert keeper.news(_seen(named="table")) is not None


def test_a_mounting_that_drifts_slowly_is_told_although_every_pick_takes_it_off() -> None:
    keeper, codes = MountKeeper(), []
    for pick in range(100):
        left = _seen(0.01 * pick - _kept(keeper)[0])
        event = keeper.news(left)
        codes += [event.code] if event is not None else []
        keeper.take(left)
    assert codes == ["MOUNT_MOVED"]

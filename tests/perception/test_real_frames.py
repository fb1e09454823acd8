"""Saved RGB-D frames as the benchmark reads, judges and draws them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks import real_frames
from benchmarks.datasets.rgbd import read_rgbd
from bus.errors import ConfigError

HIGH_M, TALL_M, FOCAL_PX, SIZE_PX = 0.6, 0.05, 400.0, (360, 480)


def _store(root: Path, name: str, box_px: tuple[slice, slice] | None) -> Path:
    """A frame from straight above (0.45, 0) with a blue box, seen flat from above, or an empty table."""
    color, depth_m = np.full((*SIZE_PX, 3), 190, np.uint8), np.full(SIZE_PX, HIGH_M)
    if box_px is not None:
        color[box_px], depth_m[box_px] = (30, 60, 200), HIGH_M - TALL_M
    base_from_color = np.array([[0, -1, 0, 0.45], [-1, 0, 0, 0], [0, 0, -1, HIGH_M], [0, 0, 0, 1.0]])
    inner, region_m = np.array((FOCAL_PX, FOCAL_PX, 240.0, 180.0)), np.array((0.33, 0.57, -0.15, 0.15))
    at = root / f"{name}.npz"
    np.savez(at, color=color, depth_m=depth_m, K=inner, base_from_color=base_from_color, region=region_m)
    return root


def test_what_is_found_and_what_is_refused_is_counted_and_drawn(tmp_path: Path) -> None:
    _store(tmp_path, "box", np.s_[160:200, 220:260])
    _store(tmp_path, "nothing", None)
    told: list[str] = []
    figures = real_frames.run(tmp_path, [], told.append, tmp_path / "sheet.png")
    assert (figures["frames"], figures["found"], sum(figures["by_code"].values())) == (2, 1, 1)
    assert 0 < figures["cpu_s_max"] < 60
    assert told[0].startswith("box") and "found" in told[0] and "NO_OBJECT" in told[1]
    sheet = cv2.imread(str(tmp_path / "sheet.png"))
    assert sheet is not None
    fingers, closing = (
        (np.abs(sheet.astype(int) - bgr).max(axis=2) < 60).sum() for bgr in ((30, 30, 230), (60, 255, 60))
    )
    assert fingers > 50 and closing > 50, "the jaw is drawn"


def test_overrides_reach_the_detection(tmp_path: Path) -> None:
    _store(tmp_path, "box", np.s_[160:200, 220:260])
    figures = real_frames.run(tmp_path, ["hand.max_width_m=0.03"], lambda line: None)
    assert figures["found"] == 0 and figures["by_code"] == {"NO_GRASP": 1}


def test_a_frame_that_is_not_whole_is_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "half.npz", color=np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(ConfigError, match=r"half\.npz"):
        list(read_rgbd(tmp_path))
    (tmp_path / "half.npz").write_bytes(b"no archive")
    with pytest.raises(ConfigError, match=r"half\.npz"):
        list(read_rgbd(tmp_path))


def test_a_folder_without_frames_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no \.npz"):
        list(read_rgbd(tmp_path))

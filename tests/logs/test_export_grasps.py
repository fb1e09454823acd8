"""`cell export grasps`: rectangles, poses and pictures that fit to each other, with what became of them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bus.messages import Detections
from logs.catalogue import open_catalogue
from logs.export import Done, export_grasps, select
from logs.export.grasps import CYCLE, FORMS, GRASP, PICTURES
from logs.mcap.reader import CycleRecord, read_cycle

parquet = pytest.importorskip("pyarrow.parquet")

GOLDEN = Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap"
WITHOUT = Path(__file__).parents[1] / "golden" / "cycle-schema3.mcap"


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Done]:
    """The grasps of a pick, and of a cycle whose plan failed."""
    recordings, target = tmp_path_factory.mktemp("recordings"), tmp_path_factory.mktemp("exported") / "grasps"
    for path in (GOLDEN, WITHOUT):
        shutil.copy(path, recordings)
    with open_catalogue(recordings) as catalogue:
        return target, export_grasps(select(catalogue), target, lambda paths, _total: paths)


def _detections(record: CycleRecord) -> Detections:
    found = record.stages["detect"].result
    assert isinstance(found, Detections)
    return found


def read_picture(path: Path) -> np.ndarray:
    """As it is in the file, blue first."""
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))


def rows(target: Path, name: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = parquet.read_table(target / f"{name}.parquet").to_pylist()
    return found


def test_every_grasp_is_a_row_with_all_columns(exported: tuple[Path, Done]) -> None:
    target, done = exported
    cycles, grasps = rows(target, "cycles"), rows(target, "grasps")
    found = _detections(read_cycle(GOLDEN))
    mine = [row for row in grasps if row["cycle_id"] == read_cycle(GOLDEN).cycle_id]
    assert done.counts == {"cycles": len(cycles), "grasps": len(grasps)} and not done.left_out
    assert list(cycles[0]) == list(CYCLE) and list(grasps[0]) == list(GRASP)
    assert [row["score"] for row in mine] == [grasp.score for grasp in found.grasps]
    assert [row["rank"] for row in mine] == list(range(len(found.grasps)))
    assert json.loads(mine[0]["terms"]) == found.grasps[0].terms
    assert sum(row["grasps"] for row in cycles) == len(grasps)


def test_only_what_was_executed_has_an_outcome(exported: tuple[Path, Done]) -> None:
    target, _ = exported
    cycles = {row["cycle_id"]: row for row in rows(target, "cycles")}
    grasps = rows(target, "grasps")
    planned = [row for row in grasps if row["is_planned"]]
    assert len(planned) == 1 and planned[0]["held"] is True and cycles[planned[0]["cycle_id"]]["result"] == "SUCCESS"
    assert all(row["held"] is None for row in grasps if not row["is_planned"])
    assert {row["code"]: row["executed"] for row in cycles.values()} == {"": True, "COLLISION": False}


def test_a_pose_lies_in_its_rectangle_on_the_thing_in_the_picture(exported: tuple[Path, Done]) -> None:
    target, _ = exported
    cycles = {row["cycle_id"]: row for row in rows(target, "cycles")}
    for row in rows(target, "grasps"):
        camera = json.loads(cycles[row["cycle_id"]]["image_camera"])
        x, y, z = np.reshape(row["color_from_tcp"], (4, 4))[:3, 3]
        tcp_px = np.array([camera["fx"] * x / z + camera["cx"], camera["fy"] * y / z + camera["cy"]])
        corners = np.reshape(row["corners_px"], (4, 2)).astype(np.float32)
        assert cv2.pointPolygonTest(corners, tcp_px.tolist(), True) > -5, "[px]"
        labels = read_picture(target / row["things_png"])
        assert labels[round(row["center_v_px"]), round(row["center_u_px"])] == row["instance"]
        base_from_color = np.reshape(cycles[row["cycle_id"]]["base_from_color"], (4, 4))
        base_from_tcp = base_from_color @ np.reshape(row["color_from_tcp"], (4, 4))
        assert base_from_tcp.ravel() == pytest.approx(row["base_from_tcp"])


def test_the_pictures_are_those_that_detect_saw(exported: tuple[Path, Done]) -> None:
    target, _ = exported
    record = read_cycle(GOLDEN)
    row = next(row for row in rows(target, "grasps") if row["cycle_id"] == record.cycle_id)
    found, look = _detections(record), record.looks[0]
    read = {name: read_picture(target / row[f"{name}_png"]) for name in PICTURES}
    assert (read["color"][..., ::-1] == found.evidence.color).all()
    assert ((read["mask"] == 255) == found.evidence.object_mask).all() and (read["things"] == found.scene.labels).all()
    assert read["depth"] == pytest.approx(np.nan_to_num(look.frame.depth_m) * 1000, abs=0.5)
    assert read["goal"].shape == read["color"].shape and read["rod"].max() == 255
    for name, picture in PICTURES.items():
        kind, channels = FORMS[picture.form]
        pixels = read[name]
        assert pixels.dtype == kind and pixels.ndim == (3 if channels > 1 else 2), name
        assert name == "depth" or pixels.shape[:2] == read["color"].shape[:2], name
        assert row[f"{name}_png"] == f"pictures/{record.cycle_id[:8]}/{record.cycle_id}.{name}.png"

"""Writes the grasps of recorded cycles with the pictures they were found in (docs/export.md)."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from bus.messages import Detections, Grasp, Observation
from bus.transforms import inverse
from logs.export.clock import Array
from logs.export.folder import new_folder
from logs.export.outcome import OUTCOME, as_json, outcome, planned_grasp
from logs.export.packages import column_type, parquet, pyarrow, require
from logs.export.selection import Done, NothingToExport, Progress, Runner, Selection, alone, readable
from logs.mcap.names import shown, telling
from logs.mcap.reader import CycleRecord, read_cycle

_POSE = "list<double>"
CYCLE: dict[str, tuple[str, str]] = {
    **OUTCOME,
    "grasps": ("int64", "How many grasps of it are in `grasps.parquet`."),
    "image_camera": ("string", "Pinhole of all pictures but the depth: the colour camera without distortion, as JSON."),
    "base_from_color": (_POSE, "Pose of the colour camera in `base` (4 x 4, by rows) [m], corrected where detect did."),
    "camera_utc_ns": ("int64", "When the picture was taken, UTC [ns]."),
}
"""The columns of `cycles.parquet`: type and meaning."""


class Picture(NamedTuple):
    """A PNG of a cycle. ``form``: of its pixels, of `FORMS`. ``what``: they mean."""

    of: Callable[[Detections, Observation], Array]
    form: str
    what: str


FORMS = {"RGB, 8 bits": (np.uint8, 3), "grey, 8 bits": (np.uint8, 1), "grey, 16 bits": (np.uint16, 1)}
"""Form of a PNG's pixels -> type and channels of the array that it is read as."""


PICTURES: dict[str, Picture] = {
    "color": Picture(
        lambda found, look: found.evidence.color,
        "RGB, 8 bits",
        "The colour image of the look that is shown, undistorted.",
    ),
    "mask": Picture(
        lambda found, look: _white(found.evidence.object_mask),
        "grey, 8 bits",
        "255 where the thing is that was gone for, else 0.",
    ),
    "things": Picture(
        lambda found, look: found.scene.labels,
        "grey, 8 bits",
        "The number of the thing in each pixel, as in `instance`; 0 = none. It looks black.",
    ),
    "goal": Picture(lambda found, look: found.evidence.goal_image, "RGB, 8 bits", "The imagined goal image."),
    "rod": Picture(
        lambda found, look: _white(found.evidence.goal_rod_mask),
        "grey, 8 bits",
        "255 where the rod is in the goal image, else 0.",
    ),
    "depth": Picture(
        lambda found, look: np.rint(np.nan_to_num(look.frame.depth_m * 1000, nan=0.0)).astype(np.uint16),
        "grey, 16 bits",
        "z-depth [mm], 0 = not measured: as the depth camera gave it, not registered to the colour image.",
    ),
}
"""The pictures of a cycle: `pictures/DAY/CYCLE_ID.NAME.png`."""

GRASP: dict[str, tuple[str, str]] = {
    "cycle_id": ("string", "Its cycle."),
    "rank": ("int64", "From 0, the best."),
    "is_planned": ("bool", "It is the one that plan chose."),
    "held": ("bool", "It was executed, and the object was held, or not; null for all others."),
    "instance": ("int64", "The number of the thing it holds."),
    "center_u_px": ("double", "Middle of its rectangle in the colour image."),
    "center_v_px": ("double", "As above."),
    "angle_rad": ("double", "Direction of the closing axis in the image, from u to v, in [0, pi)."),
    "jaw_width_px": ("double", "Jaw opening, along the closing axis."),
    "jaw_height_px": ("double", "Across it."),
    "corners_px": (_POSE, "The corners of the rectangle: u, v of four, one after the other."),
    "base_from_tcp": (_POSE, "4 x 4, by rows, in `base` [m]: z approaches, y closes; before any tilt of the plan."),
    "color_from_tcp": (_POSE, "The same in the colour camera."),
    "width_m": ("double", "Width of the object between the pads."),
    "opening_m": ("double", "Width to approach with."),
    "score": ("double", "Weighted mean of the terms."),
    "terms": ("string", "The terms of the score, as JSON."),
    **{f"{name}_png": ("string", f"Path of the picture `{name}`.") for name in PICTURES},
}
"""The columns of `grasps.parquet`: type and meaning."""


def export_grasps(selection: Selection, target: Path, progress: Progress, run: Runner = alone) -> Done:
    """Write every grasp that detect found in the selected recordings, with its pictures and its outcome.

    Args:
        target: the folder, which must not exist; it appears when it is complete.
        run: who reads the recordings and writes their pictures; all is the same whoever does.

    Raises: ConfigError without pyarrow, or for an existing folder; RecordingError when no recording has a grasp, or
        the folder cannot be written.
    """
    require("pyarrow")
    read_bytes = cycles = grasps = 0
    with (
        new_folder(target) as folder,
        _writer(folder, "cycles", CYCLE) as told,
        _writer(folder, "grasps", GRASP) as rows,
    ):
        work = partial(readable, partial(_exported, root=selection.root, folder=folder))
        for path, (about, found) in selection.done(work, run, progress):
            told.write_table(_table([about], CYCLE))
            rows.write_table(_table(found, GRASP))
            cycles, grasps = cycles + 1, grasps + len(found)
            read_bytes += path.stat().st_size
        if not cycles:
            raise selection.nothing()
    return Done(target, {"cycles": cycles, "grasps": grasps}, read_bytes, tuple(selection.left_out))


def _exported(path: Path, root: Path, folder: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Write the pictures of one recording; return its row of `CYCLE`, and those of `GRASP`."""
    found = _read(path, root)
    paths = _written(folder, found)
    return found.about(), [{**row, **paths} for row in found.grasps()]


class _Found(NamedTuple):
    """A cycle with grasps. ``look``: that its pictures belong to. ``recording``: its path below the recordings."""

    record: CycleRecord
    recording: str
    detections: Detections
    look: Observation

    def base_from_color(self) -> Array:
        """Pose (4, 4) of the camera, corrected by what the looks said of its mounting."""
        pose, mount = self.look.view.base_from_color, self.detections.scene.mount
        return np.asarray(pose @ mount.color_from_corrected if mount is not None else pose)

    def about(self) -> dict[str, Any]:
        """The values of `CYCLE`."""
        frame = self.look.frame
        return {
            **outcome(self.record, self.recording, frame),
            "grasps": len(self.detections.grasps),
            "image_camera": as_json(frame.color_camera.model_copy(update={"distortion": ()})),
            "base_from_color": self.base_from_color().ravel().tolist(),
            "camera_utc_ns": self.look.view.stamp_ns,
        }

    def grasps(self) -> Iterator[dict[str, Any]]:
        """The values of `GRASP`, grasp by grasp, without the pictures."""
        planned, _ = planned_grasp(self.record)
        about = self.about()
        color_from_base = inverse(self.base_from_color())
        for rank, grasp in enumerate(self.detections.grasps):
            is_planned = grasp is planned
            held = about["held"] if is_planned and about["executed"] else None
            yield {
                "cycle_id": self.record.cycle_id,
                "rank": rank,
                "is_planned": is_planned,
                "held": held,
                **_shape(self.detections, grasp),
                "color_from_tcp": (color_from_base @ grasp.base_from_tcp).ravel().tolist(),
            }


def _shape(found: Detections, grasp: Grasp) -> dict[str, Any]:
    rectangle = found.rectangles[grasp.rectangle]
    return {
        "instance": grasp.instance,
        "center_u_px": rectangle.center_px[0],
        "center_v_px": rectangle.center_px[1],
        "angle_rad": rectangle.angle_rad,
        "jaw_width_px": rectangle.width_px,
        "jaw_height_px": rectangle.height_px,
        "corners_px": rectangle.corners_px().ravel().tolist(),
        "base_from_tcp": grasp.base_from_tcp.ravel().tolist(),
        "width_m": grasp.width_m,
        "opening_m": grasp.opening_m,
        "score": grasp.score,
        "terms": json.dumps(grasp.terms),
    }


def _read(path: Path, root: Path) -> _Found:
    record = read_cycle(path)
    stage = record.stages.get("detect")
    if stage is None or stage.result is None:
        raise NothingToExport("Detect found no grasp.")
    if record.observation is None:
        raise NothingToExport("It has no picture.")
    with telling(shown(path)):
        found = _Found(record, os.path.relpath(path, root), stage.result, record.observation)
        list(found.grasps())  # what cannot be told is left out before anything of it is written
        return found


def _written(folder: Path, found: _Found) -> dict[str, str]:
    """Write the pictures; return their columns: paths below the folder."""
    cycle_id, paths = found.record.cycle_id, {}
    for name, picture in PICTURES.items():
        path = Path("pictures", cycle_id[:8], f"{cycle_id}.{name}.png")
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        pixels = picture.of(found.detections, found.look)
        _, png = cv2.imencode(
            ".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1]
        )
        (folder / path).write_bytes(png.tobytes())
        paths[f"{name}_png"] = str(path)
    return paths


def _white(mask: Array) -> Array:
    return np.asarray(mask.astype(np.uint8) * 255)


def _schema(columns: dict[str, tuple[str, str]]) -> Any:
    return pyarrow.schema([(name, column_type(kind)) for name, (kind, _) in columns.items()])


def _writer(folder: Path, name: str, columns: dict[str, tuple[str, str]]) -> Any:
    return parquet.ParquetWriter(folder / f"{name}.parquet", _schema(columns), compression="zstd")


def _table(rows: list[dict[str, Any]], columns: dict[str, tuple[str, str]]) -> Any:
    return pyarrow.Table.from_pylist(rows, schema=_schema(columns))

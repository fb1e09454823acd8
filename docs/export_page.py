"""Writes docs/export.md from the columns of the exports: ``uv run python -m docs.export_page``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from logs.export.features import CAMERAS, EPISODE, FEATURES, INDICES, Feature
from logs.export.grasps import CYCLE, GRASP, PICTURES
from logs.export.outcome import OUTCOME
from logs.export.rolling import MAX_VIDEO_S
from logs.export.video import DEPTH_MAX_M, DEPTH_MIN_M, DEPTH_SHIFT_M, GROUP

PAGE = Path(__file__).with_name("export.md")


def page() -> str:
    """The page's text."""
    lines = [
        _HEAD,
        *_features(FEATURES),
        "",
        "Every LeRobot data set has these, too:",
        "",
        *_features(INDICES),
        "",
        _VIDEOS,
        *(
            f"| `{key}` | {camera.form.codec}, {camera.form.pix_fmt} | {camera.what} |"
            for key, camera in CAMERAS.items()
        ),
        "",
        _DEPTH,
        *_columns(EPISODE),
        "",
        _GRASPS,
        *_columns(GRASP),
        "",
        _PICTURES,
        "| picture | pixels | what |",
        "|---|---|---|",
        *(f"| `{name}` | {picture.form} | {picture.what} |" for name, picture in PICTURES.items()),
        "",
        "`cycles.parquet` has a row a cycle, with the columns of an episode above, `task`, and:",
        "",
        *_columns({key: row for key, row in CYCLE.items() if key not in OUTCOME}),
    ]
    return "\n".join(lines) + "\n"


def _features(features: Mapping[str, Feature]) -> Iterator[str]:
    yield from ("| column | type | what |", "|---|---|---|")
    for key, one in features.items():
        yield f"| `{key}` | {one.dtype}{f'[{len(one.names)}]' if one.names else ''} | {one.what} |"


def _columns(columns: Mapping[str, tuple[str, str]]) -> Iterator[str]:
    yield from ("| column | type | what |", "|---|---|---|")
    yield from (
        f"| `{key}` | {kind.replace('<', ' of ').rstrip('>')} | {what} |" for key, (kind, what) in columns.items()
    )


_HEAD = """\
# Recordings as data sets

<!-- Written by docs/export_page.py from logs/export/; do not edit. -->

```
uv pip install 'vlad-cell[export]'          # pyarrow and av; this checkout's environment has them
uv run cell export lerobot recordings -o picks --where "result = 'SUCCESS'"
uv run cell export grasps recordings -o grasps --where "executed"
```

`--where` chooses cycles by the columns of the catalogue ([catalogue.md](catalogue.md)): their result, day, station,
labels. Without it all are taken, oldest first. The folder appears under its name when it is complete; until then it is
`NAME.part`, which the next export of that name replaces if this one was killed. A folder that exists is refused. What
cannot be read, is not finished, or lacks what is exported is named on stderr and left out; exit code 2 where something
cannot be read. The same recordings give the same bytes. A gigabyte of recordings takes about a minute of one processor
(`benchmarks export`), which `--workers` share (one a core, unless it is said) or a cluster ([cluster.md](cluster.md)).

## `cell export lerobot`

A [LeRobot](https://github.com/huggingface/lerobot) data set of version 3.0, written without that package. LeRobot 0.4.4
opens it (`tests/logs/test_lerobot_reader.py`; `just lerobot` installs it in an environment of its own, of 8 GB, for
`just test-all`):

```python
from lerobot.datasets.lerobot_dataset import LeRobotDataset

dataset = LeRobotDataset("local/picks", root="picks", video_backend="pyav")
dataset[0]["observation.state"], dataset[0]["action"], dataset[0]["task"]
```

One cycle is one episode, from its first picture to its end, at `--fps` frames a second (10). The task is the text of
the job's target (`pick the largest red one`), without one `pick the object`, with a named place `..., lay it at left`.

**Time.** Frames lie on the grid k / fps, which LeRobot requires; when something was really measured is in columns of
its own (`*_utc_ns`). While the arm plays a motion the grid is the arm's own time, and the wall's between two motions.
For a robot both are the same. A simulation without a pace (`sim.pace = 0`) runs ahead of the wall: its motions are as
slow as they would be, but its hand, which is published by the wall, changes in steps. Record with `sim.pace = 1` to
train on it.

**Pictures.** The cell takes few pictures a cycle: one a look, and one of what it holds. Every frame shows the last one
taken at that time; `camera_age_s` says how old it is, 0 where it is new. This is no video of the motion.
"""
_VIDEOS = """\
Videos have the size of the camera's pictures, which must be one size in all chosen recordings (the first one's; others
are left out and named). All that a frame holds beside them is float32 or a whole number.

| video | codec | what |
|---|---|---|"""
_DEPTH = f"""\
Depth is coded as LeRobot 0.6 does: code = round(4095 ln((z + {DEPTH_SHIFT_M:g}) / {DEPTH_MIN_M + DEPTH_SHIFT_M:g}) / \
ln({DEPTH_MAX_M + DEPTH_SHIFT_M:g} / {DEPTH_MIN_M + DEPTH_SHIFT_M:g})), z from {DEPTH_MIN_M:g} to {DEPTH_MAX_M:g} m, \
lossless after that: a step is 1.3 mm at 0.5 m.
LeRobot 0.4.4 gives these codes as a grey picture; in Python, `logs.export.video.depth_m` gives metres. Its statistics
are in mm. There is a key frame every {GROUP} frames. A video file takes no further episode after {MAX_VIDEO_S:g} s:
beyond 1024 s, float32 times are too coarse for LeRobot's tolerance.

Of an episode, `meta/episodes` says beside LeRobot's own columns:
"""
_GRASPS = """\
## `cell export grasps`

`grasps.parquet` has a row for every grasp that detect ranked, also those that were not executed: a rectangle in the
colour image (Jiang et al. 2011), the pose of the hand, score and outcome.
"""
_PICTURES = """\
**Pictures** are PNG files, `pictures/DAY/CYCLE_ID.NAME.png`: those of one cycle are beside each other, those of one
day in a folder. DAY is the UTC date in front of the cycle's id, as in `20261130`; NAME is one of the table below. A row
of `grasps.parquet` names each of them relative to the data set's folder: its grasp is in all of them.

```python
import cv2
import pyarrow.parquet as pq

row = pq.read_table("grasps/grasps.parquet").to_pylist()[0]
color = cv2.imread(f"grasps/{row['color_png']}")  # (height, width, 3), which OpenCV reads as BGR
things = cv2.imread(f"grasps/{row['things_png']}", cv2.IMREAD_UNCHANGED)  # (height, width), the numbers themselves
depth_m = cv2.imread(f"grasps/{row['depth_png']}", cv2.IMREAD_UNCHANGED) / 1000
```

All have the size of the colour image, pixel on pixel, and its pinhole (`image_camera` of `cycles.parquet`) - but
`depth`: that has the depth camera's own size and lens, still distorted (`depth_camera`, and `color_from_depth` for
where it is).
"""


if __name__ == "__main__":
    PAGE.write_text(page())

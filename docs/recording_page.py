"""Writes docs/recording.md from what the cell records: ``uv run python -m docs.recording_page``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bus.topics import CAMERA_CAPTURE, FRAME_PARTS, TOPICS, Topic, encoding_of
from cell.daemon.runinfo import run_info
from config.load import load_station
from docs.meanings import MEANINGS
from logs.mcap.migrate import MIGRATIONS, SCHEMA_VERSION

PAGE = Path(__file__).with_name("recording.md")
_RUN = {
    "schema": "Version of what the file holds, below.",
    "cycle_id": "UTC time at which it was asked for, to the millisecond: its start, unless it waited in the queue.",
    "began": "UTC time of its start, in the same form.",
    "cell_id": "Which cell.",
    "station_hash": "Of the whole station; the file `station.json` holds it.",
    "seed": "Of the simulation.",
    "robot_model_sha256": "Of the robot's description and its collision meshes.",
    "commit": 'Of the checkout; "unknown" without git.',
    "dirty": "Whether the checkout had changes.",
    "plug_ins": "The packages of other makers, by the setting that names what one brings: what a replay needs, too.",
    "python": "Version.",
}


def page() -> str:
    """The page's text."""
    return "\n".join([_HEAD, *_channels(), "", _FILES, *_run(), "", *_versions(), "", _READ])


def _channels() -> Iterator[str]:
    yield from ("| channel | schema | what |", "|---|---|---|")
    for topic in TOPICS:
        if topic.logged and topic.kind != "alive":
            yield from (f"| {shown} | {schemas} | {what} |" for shown, schemas, what in _rows(topic))


def _rows(topic: Topic) -> Iterator[tuple[str, str, str]]:
    """The channels on which a topic is recorded, their schemas, and what they hold."""
    meaning = MEANINGS[f"{topic.key} {topic.kind}"]
    if topic.kind == "publish":
        yield f"`/{topic.key}`", _schema(topic.says), meaning
    elif topic is CAMERA_CAPTURE:
        yield f"`/{topic.key}/query`", _schema(topic.asks), meaning
        yield from ((f"`/{part.key}`", _schema(part.says), MEANINGS[f"{part.key} {part.kind}"]) for part in FRAME_PARTS)
    else:
        yield f"`/{topic.key}/query`, `/{topic.key}/reply`", f"{_schema(topic.asks)}, {_schema(topic.says)}", meaning


def _schema(kind: object) -> str:
    return f"`{encoding_of(kind).partition(';')[2]}`"


def _run() -> Iterator[str]:
    yield from ("| key of `run` | what |", "|---|---|")
    keys = list(run_info(load_station(), ""))
    yield from (f"| `{key}` | {_RUN[key]} |" for key in keys if key in _RUN)
    yield f"| {', '.join(f'`{key}`' for key in keys if key not in _RUN)} | Versions of these packages. |"


def _versions() -> Iterator[str]:
    yield from ("## Versions", "", _VERSIONS, "", "| read as | what changed |", "|---|---|")
    yield from (f"| {one.since} → {one.since + 1} | {one.what} |" for one in MIGRATIONS)


_HEAD = """\
# What is in a recording

<!-- Written by docs/recording_page.py from the topics, the metadata and the migrations; do not edit. -->

One cycle is one [MCAP](https://mcap.dev): `recordings/DAY/CYCLE_ID.mcap` (`recording.folder`), some 3 MB. It opens in
Foxglove and Lichtblick without a plug-in ([foxglove](foxglove/README.md)). While it is written it is a `.mcap.part`,
flushed after every stage and state, and 100 ms after anything else at the latest; `cell recover` makes one whole whose
process was killed. Beside it lies `CYCLE_ID.html`, the report. An empty `CYCLE_ID.keep` keeps both from being deleted.
`plotly-VERSION.min.js` is the drawing library of all pages of a folder. Above the days lie `catalogue.sqlite`, made of
the recordings, `labels.jsonl`, what people say of them, and `deleted.jsonl`, which of them went, when and why
([catalogue.md](catalogue.md)); `spend.jsonl` is what calls of hosted models cost. A recording that was trimmed
([service.md](service.md#how-long-recordings-are-kept)) has no `/camera/color`, `/camera/depth`, `/view/color`,
`/view/goal`, `/view/cloud` and goal images, and its record of detect has grey pictures.

## Channels

What travels on the bus is recorded as it travelled, byte for byte. A channel is a key of the bus ([bus.md](bus.md))
with a slash before it. Questions are on `/KEY/query`, answers on `/KEY/reply`, refusals on `/KEY/error` as
`vlad.ErrorReply`. The log time is when the cell heard it (UTC).
"""
_FILES = """\
## Attachments

| name | what |
|---|---|
| `station.json` | The whole station, defaults included: a replay runs with it. |
| `calibration.json` | Where the camera sits in the hand. |
| `model/fr3.urdf` | The robot, for 3-D viewers; `model/robot.urdf` where the station has `[robot]`. |
| `prompts/NN-STEP.txt`, `replies/NN-STEP.txt` | What the goal-image model was asked and what it said, call by call. |
| `goal_images/NN-STEP.png` | What it drew, exactly as it came; hosted models only. |

A model's key is in none of them. Prompts, replies and pictures are: they show what stood on the table.

## Metadata

`run` is written first, `result` last: `result` (SUCCESS, FAILED, ABORTED or EMPTY), `code`, `reason`. A recording that
was made whole has `recovered`, too; one that was trimmed has `thinned_ns` (when, UTC), and `archived` and
`archived_sha256` where its whole copy is.
"""
_VERSIONS = f"""\
`schema` is {SCHEMA_VERSION} now. Older recordings are read as if they were written today; the files stay:"""
_READ = """\
## Read it

```
uv run cell show CYCLE            # result, stages, what was configured otherwise
uv run cell report CYCLE          # the page
uv run cell replay CYCLE          # do the pure stages still decide the same?
```

In Python ([api.md](api.md)):

```python
from vlad_cell import read_cycle

cycle = read_cycle("recordings/DAY/CYCLE_ID.mcap")
print(cycle.result, cycle.grasps[0].width_m, cycle.color.shape, cycle.joints.q_rad.shape)
```

`cycle.looks` are the captures before the pick, each with its reason in `why`; `cycle.record.stages` has of every stage
what was made of all looks, `cycle.record.superseded` what was made of fewer.

Without anything of ours, any MCAP reader (`pip install mcap`) gives the JSON of `/cycle/detect` and the rest.
"""

if __name__ == "__main__":
    PAGE.write_text(page())

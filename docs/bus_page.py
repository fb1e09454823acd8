"""Writes docs/bus.md from bus/topics.py and the messages' own docstrings: ``uv run python -m docs.bus_page``."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel

from bus.codes import ADVICE, Code
from bus.commands import ErrorReply
from bus.foxglove import FoxgloveType
from bus.messages import StageRecord
from bus.topics import TOPICS, Topic
from docs.fields import Row, lead, rows
from docs.meanings import MEANINGS

PAGE = Path(__file__).with_name("bus.md")
_FOXGLOVE = "https://docs.foxglove.dev/docs/sdk/schemas"

_GROUPS = {
    "The cell": ("command", "state", "heartbeat", "health", "schema", "event", "stranger"),
    "The cycle": ("cycle", "model"),
    "The cycle in pictures": ("view",),
    "Camera": ("camera",),
    "Arm": ("arm", "tf"),
    "Hand": ("hand",),
    "Nodes and clients": ("node", "lease", "fault"),
    "Simulation only": ("sim",),
}
_ASKED_BY = {"": "anyone may ask", "client": "acts; a client that names itself", "cell": "acts; the cell alone"}
_SAID_BY = {
    "cell": "by the cell",
    "node": "by its node",
    "both": "by the cell and its nodes",
    "client": "by the client",
}
_KIND = {"publish": "published", "query": "query", "alive": "token"}


def page() -> str:
    """The page's text."""
    return "\n".join(
        [_HEAD, *_topics(), _FOXGLOVE_HEAD, "", *_foxglove(), "", _TYPES_HEAD, "", *_types(), *_codes(), ""]
    )


def _topics() -> Iterator[str]:
    for title, chunks in _GROUPS.items():
        yield from (
            f"### {title}",
            "",
            "| key | kind | payload | who | in recordings | what |",
            "|---|---|---|---|---|---|",
        )
        yield from (_row(topic) for topic in TOPICS if topic.key.split("/")[0] in chunks)
        yield ""


def _row(topic: Topic) -> str:
    who = _ASKED_BY[topic.acts] if topic.kind == "query" else _SAID_BY[topic.speaker]
    who = who if topic.kind != "alive" else _SAID_BY["node" if topic.key.startswith("node") else "client"]
    recorded = "yes" if topic.logged and topic.kind != "alive" else "no"
    meaning = MEANINGS[f"{topic.key} {topic.kind}"]
    return f"| `{topic.key}` | {_KIND[topic.kind]} | {_payload(topic)} | {who} | {recorded} | {meaning} |"


def _payload(topic: Topic) -> str:
    if topic.kind == "alive":
        return "none"
    if topic.kind == "publish":
        return _shown(topic.says)
    return f"{_shown(topic.asks)} → {_shown(topic.says) if topic.says is not None else 'five replies'}"


def _shown(kind: Any) -> str:
    """A type as a link to what it holds."""
    if isinstance(kind, FoxgloveType):
        return f"[{kind.full_name}]({_FOXGLOVE}/{_kebab(kind.full_name)})"
    if kind is None:
        return "nothing"
    if isinstance(kind, TypeVar):  # of a generic message
        return "the stage's own"
    if kind is Code:
        return "[code](#codes-of-a-cycle)"
    if isinstance(kind, type) and issubclass(kind, Enum):
        return " or ".join(f"`{one.value}`" for one in kind)
    name = kind.__name__
    if name.startswith("StageRecord["):
        return f"[StageRecord](#stagerecord) of {_link(name[len('StageRecord[') : -1])}"
    return _link(name)


def _link(name: str) -> str:
    return f"[{name}](#{name.lower()})"


def _kebab(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", name.removeprefix("foxglove.")).lower()


# --- types ------------------------------------------------------------------------------------------------------------


def _foxglove() -> Iterator[str]:
    kinds = {one.full_name: one for topic in TOPICS for one in (topic.says,) if isinstance(one, FoxgloveType)}
    yield ", ".join(_shown(kinds[name]) for name in sorted(kinds)) + "."


def _types() -> Iterator[str]:
    for model in sorted(reachable(), key=lambda one: one.__name__):
        yield from (f"### {model.__name__}", "", lead(model), "")
        fields = list(rows(model, _shown))
        if fields:
            yield from ("| field | type | default | meaning |", "|---|---|---|---|", *map(_field, fields), "")


def _field(row: Row) -> str:
    kind = f"{row.type}, {row.limits}" if row.limits else row.type
    return f"| `{row.name}` | {kind} | {'required' if row.default is None else f'`{row.default}`'} | {row.text} |"


def reachable() -> set[type[BaseModel]]:
    """Every message that travels as JSON, whole or as a part of another; stage records count as one."""
    todo = [kind for topic in TOPICS for kind in (topic.says, topic.asks)] + [ErrorReply]
    found: set[type[BaseModel]] = set()
    while todo:
        kind = todo.pop()
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            shown = StageRecord if issubclass(kind, StageRecord) else kind
            new = kind not in found
            found.add(shown)
            todo += [field.annotation for field in kind.model_fields.values()] if new or shown is not kind else []
        else:
            todo += get_args(kind)
    return found


def _codes() -> Iterable[str]:
    return ("## Codes of a cycle", "", _CODES_HEAD, "", "| code | advice |", "|---|---|",
            *(f"| `{code}` | {advice} |" for code, advice in ADVICE.items()))  # fmt: skip


_HEAD = """\
# The bus

<!-- Written by docs/bus_page.py from bus/topics.py and the messages; do not edit. -->

The cell's processes, and programs of yours, talk over [Eclipse Zenoh](https://zenoh.io). This page is the whole API:
every key, what travels on it, who may use it. A running cell answers the query `schema` with the same, as JSON.
[docs/examples/trigger.py](examples/trigger.py) is a client in 60 lines of plain Zenoh;
[security.md](security.md) says how to reach a cell on another machine.

- **Keys** are below `cell/CELL_ID/`: `state` is `cell/sim/state` on the simulated cell. `{name}` and `{verb}` stand for
  one chunk. The cell listens on `tcp/127.0.0.1:7447` (`bus.endpoint`).
- **Payloads** are JSON of this project, or Foxglove's protobuf messages. The Zenoh encoding says which:
  `application/json;vlad.CellState`, `application/protobuf;foxglove.JointStates`.
- **A query that reads** answers anyone. **A query that acts** answers its exact key (no wildcards), needs a payload
  (at least `{}`), and answers only who is named in its row.
- **A refusal** comes as Zenoh's error reply, an [ErrorReply](#errorreply) with code, reason and advice. No query stays
  unanswered; no answer at all means that nobody serves the key, or that a certificate does not allow it.
- **Motion needs a lease.** A client that commands `reset`, `start` or `pick` holds the liveliness token
  `lease/CLIENT_ID`, puts `{}` on that key every 0.2 s, and sends that `client_id`. When token or heartbeat is gone, the
  cell holds. `unhold` and `unsuspend` need a token of any client; `stop`, `abort`, `hold`, `suspend` and `clear` none.
- **A pixel to pick**: `view/picture` answers, while the cell rests there (Idle, Complete), with what the camera sees
  from the capture pose; a pixel of it is the `target` of a [Job](#job). `uv run python docs/examples/trigger.py sim
  orange` does so without any other package, and only in the pick region: [pixel.py](examples/pixel.py). In simulation
  with `--set sim.clutter=3`: otherwise each pick puts another object on the table.
- **Units** are SI, angles in radians, times integer nanoseconds UTC; `a_from_b` is a 4 x 4 matrix that maps
  b-coordinates to a ([frames.md](frames.md)).

## Keys
"""
_FOXGLOVE_HEAD = """\
## Protobuf types

What any viewer of Foxglove's schemas understands:"""
_TYPES_HEAD = """\
## JSON types

An *array* of fewer than 64 finite numbers is a list, nested by its shape; any other is
`{"dtype": "<f8", "shape": [n, 7], "base64": "..."}`. Both are read, whatever the size. A *PNG image* is
`{"png": "BASE64"}`. Numbers that JSON does not have are the strings `"NaN"`, `"Infinity"`, `"-Infinity"`. Unknown
fields are refused. Where a meaning says None, JSON says `null`."""
_CODES_HEAD = "`code` of a [CycleResult](#cycleresult) or a [Failure](#failure), and what an operator can do:"

if __name__ == "__main__":
    PAGE.write_text(page())

"""Writes docs/api.md from the docstrings of `vlad_cell`: ``uv run python -m docs.api_page``."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Iterator
from dataclasses import is_dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import BaseModel

import vlad_cell
from config.field_docs import meanings
from docs.fields import markdown

PAGE = Path(__file__).with_name("api.md")
_ORDER = ("detect", "Detections", "Grasp", "Picture", "read_cycle", "Cycle", "Look", "JointTrack", "HandTrack",
          "simulated_cell", "Cell", "Pick")  # fmt: skip
_SECTION = re.compile(r"(Args|Attributes|Returns|Raises):(.*)")


def page() -> str:
    """The page's text."""
    parts = [_HEAD, *(_of(name) for name in _ORDER), _ARGUMENTS, _messages(), _errors()]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _of(name: str) -> str:
    """The section of one function or class, its members below it."""
    what = getattr(vlad_cell, name)
    if not inspect.isclass(what):
        return "\n\n".join([f"## {name}", _signature(name, what), *_told(what)])
    is_made_here = is_dataclass(what) or name == "Pick"
    signature = [] if is_made_here else [_signature(name, what)]
    sections = [one for one in _told(what) if not one.startswith("**Attributes**")]
    return "\n\n".join([f"## {name}", *signature, *sections, *_values(what), *_methods(what)])


def _values(of: type) -> list[str]:
    """The attributes and properties of a class, as a table; empty without any."""
    rows = [*_attributes(of)]
    for name, member in _members(of):
        if _is_property(member) and not name.startswith("_"):
            read = getattr(member, "fget", None) or member.func
            text = " ".join(" ".join(_told(member)).replace("**", "").split())
            rows.append(f"| `{name}` | {_cell(_type(inspect.signature(read).return_annotation))} | {text} |")
    return ["\n".join(["| value | type | what |", "|---|---|---|", *rows])] if rows else []


def _attributes(of: type) -> Iterator[str]:
    """A row for each attribute of which the class's docstring speaks."""
    kinds = inspect.get_annotations(of)
    for name, text in meanings(of).items():
        yield f"| `{name}` | {_cell(_type(kinds[name]))} | {markdown(_inline(text))} |"


def _methods(of: type) -> Iterator[str]:
    """The public methods of a class, those of its bases first, in the order of their text."""
    for name, member in _members(of):
        value = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        if not name.startswith("_") and inspect.isfunction(value):
            shown = f"{of.__name__}.{name}"
            yield "\n\n".join([f"### {shown}", _signature(shown, value), *_told(value)])


def _members(of: type) -> Iterator[tuple[str, Any]]:
    """Yield what a class, and the bases of ours before it, define."""
    for base in reversed(of.__mro__):
        if base.__module__.startswith("vlad_cell."):
            yield from vars(base).items()


def _is_property(value: Any) -> bool:
    return isinstance(value, property | cached_property)


# --- a signature ------------------------------------------------------------------------------------------------------


def _signature(name: str, what: Any) -> str:
    """As Python writes it, an argument a line when it is long."""
    signature = inspect.signature(what)
    shown = [_argument(one) for one in signature.parameters.values() if one.name not in ("self", "cls")]
    named = next((at for at, one in enumerate(signature.parameters.values()) if one.kind is one.KEYWORD_ONLY), None)
    if named is not None:
        skipped = sum(one in signature.parameters for one in ("self", "cls"))
        shown.insert(named - skipped, "*")
    gives = "" if inspect.isclass(what) else f" -> {_type(signature.return_annotation)}"
    line = f"{name}({', '.join(shown)}){gives}"
    if len(line) > 100:
        line = f"{name}(\n" + "".join(f"    {one},\n" for one in shown) + f"){gives}"
    return f"```python\n{line}\n```"


def _argument(one: inspect.Parameter) -> str:
    text = f"{one.name}: {_type(one.annotation)}" if one.annotation is not one.empty else one.name
    return text if one.default is one.empty else f"{text} = {one.default!r}"


def _type(annotation: Any) -> str:
    """An annotation as it is written, without the modules."""
    text = annotation if isinstance(annotation, str) else getattr(annotation, "__name__", str(annotation))
    return re.sub(r"\bnpt?\.", "", text)


def _cell(text: str) -> str:
    """A type in a cell of a table."""
    return f"`{text}`".replace("|", "\\|") if text else ""


# --- a docstring ------------------------------------------------------------------------------------------------------


def _told(what: Any) -> Iterator[str]:
    """Yield what a docstring says, as Markdown: its sentences, and each of its sections as a list."""
    for block in _blocks(what):
        section = _SECTION.match(block)
        yield _list(section[1], section[2], block) if section else _inline(" ".join(block.split()))


def _blocks(what: Any) -> list[str]:
    return inspect.cleandoc(what.__doc__ or "").split("\n\n")


def _list(title: str, rest: str, block: str) -> str:
    """``Args:`` and the like: an entry an item; a sentence on the same line stays one."""
    if rest.strip():
        return f"**{title}**: {_inline(' '.join(block.removeprefix(f'{title}:').split()))}"
    return f"**{title}**\n\n" + "\n".join(f"- {_entry(one)}" for one in _entries(block))


def _entries(block: str) -> list[str]:
    """The entries below the title of a section, each on one line."""
    entries: list[str] = []
    for line in textwrap.dedent(block.partition("\n")[2]).splitlines():
        if line[:1].isspace():
            entries[-1] += f" {line.strip()}"
        else:
            entries.append(line)
    return entries


def _entry(text: str) -> str:
    name, colon, rest = text.partition(": ")
    is_named = colon and re.fullmatch(r"[\w, ]+", name)
    return f"`{name}`: {_inline(rest)}" if is_named else _inline(text)


def _inline(text: str) -> str:
    """A docstring's backquotes as Markdown's; a name of this page becomes a link to it."""
    text = text.replace("``", "`").replace("|", "\\|")
    return re.sub(r"(?<!\[)`(\w+(?:\.\w+)?)`", _linked, text)


def _linked(found: re.Match[str]) -> str:
    name = found[1]
    return f"[`{name}`](#{name.lower()})" if name in _ORDER else found[0]


# --- what comes from elsewhere ----------------------------------------------------------------------------------------


def _messages() -> str:
    """The messages that the API gives and takes; the page of the bus has their fields."""
    named = {name: what for name in vlad_cell.__all__ if _is_message(what := getattr(vlad_cell, name))}
    rows = [f"| `{name}` | {_first(what)} | [{what.__name__}](bus.md#{what.__name__.lower()}) |"
            for name, what in named.items()]  # fmt: skip
    return "\n".join(["## Messages", "", "| name | what | fields |", "|---|---|---|", *rows])


def _errors() -> str:
    """The errors, with their place in the tree."""
    named = [what for name in vlad_cell.__all__ if _is_error(what := getattr(vlad_cell, name))]
    rows = [f"| `{what.__name__}` | `{what.__mro__[1].__name__}` | {_first(what)} |" for what in named]
    return "\n".join([_ERRORS, "", "| error | is a | when |", "|---|---|---|", *rows])


def _is_message(what: Any) -> bool:
    return inspect.isclass(what) and issubclass(what, BaseModel)


def _is_error(what: Any) -> bool:
    return inspect.isclass(what) and issubclass(what, Exception)


def _first(what: type) -> str:
    """The first sentence of a docstring."""
    text = " ".join(inspect.cleandoc(what.__doc__ or "").split("\n\n")[0].split())
    return _inline(text.partition(". ")[0].rstrip(".") + ".")


_HEAD = """\
# The Python API

<!-- Written by docs/api_page.py from the docstrings of vlad_cell; do not edit. -->

`import vlad_cell`, in the environment that the cell is installed in. It has types (`py.typed`) and is the only package
that stays as it is between releases. Shapes, units and frames are in every name: `depth_m` is in metres,
`base_from_camera` maps points of the camera to `base` ([frames.md](frames.md)). Every error says what happened and what
to do. A `config.py` or `logs.py` of yours beside the program hides packages of the cell: name it otherwise, or run
`python -P` ([install.md](install.md)).

**Grasps in a saved RGB-D image**, in five lines, without a robot, a cell or a network:

```python
import numpy as np
from vlad_cell import detect

image = np.load("image.npz")
found = detect(image["color"], image["depth_m"], image["K"], image["base_from_camera"])
print(found.grasps[0].base_from_grasp, found.grasps[0].width_m)
```

The objects lie on the plane z = 0 of `base`, in the station's pick region. For a camera of your own give
`region_m=(x_min, x_max, y_min, y_max)`, and `settings={"camera.least_range_m": 0}` unless you know how near it can
measure.

**From above, or aslant.** An image from above is best. One from aside hides the back of a thing, and what was not seen
is not free. When the camera leans by more than 17 degrees the back is taken for upright, the hand comes wider
(`opening_m`), so that its fingers come down where the camera saw, and it may lean towards the camera
(`settings={"perception.from_above": True}` keeps it upright). The term `deep` of a grasp is 1 where the fingers reach
as deep as pads and table let them; a shallow grasp scores up to half less. Where no room is left, `NOT_SEEN` names the
lean. One object alone, the paper's or one of object_sim, rendered at 640 x 480 with a sensor's noise; a grasp is *true*
when it holds on the true shape (`uv run python -m benchmarks aslant`; seeds 1000:1020, in italics those that it was
developed on, 0:30):

| the camera leans by | found | true | pads overlap, median | before: found, true, overlap |
|---|---|---|---|---|
| 0° | 39 of 40 | 35 of 40 | 15 mm | the same |
| 15° | 39 of 40 | 34 of 40 | 10 mm | the same |
| 30° | 38 of 40, *57 of 58* | 34 of 40, *54 of 58* | 12 mm, *12 mm* | 36, 31, 5 mm, *52, 45, 11 mm* |
| 45° | 39 of 40, *52 of 58* | 30 of 40, *48 of 58* | 10 mm, *12 mm* | 28, 20, 10 mm, *42, 35, 10 mm* |

What lies close behind a thing, unseen, is pinched with it; and the far half of a round thing bulges, so that its
`width_m` may read several millimetres too small. The cell looks from above first, then from aside, and joins its looks.

**A recording**, in five lines; `cycle.color`, `cycle.depth_m`, `cycle.K` and `cycle.base_from_camera` are what `detect`
takes. There the depth is resampled into the colour image's pixels, so its best grasp may be another than the cell's,
which works on the frames as they came: `cycle.grasps` are those, and `cell replay` decides them again.

```python
from vlad_cell import read_cycle

cycle = read_cycle("recordings/DAY/CYCLE_ID.mcap")
print(cycle.result, cycle.code, cycle.reason)
print(cycle.color.shape, cycle.depth_m.shape, cycle.joints.q_rad.shape)
cycle.picture().save("grasp.png")
```

**A pick.** While the program runs the arm moves for it; when the `with` ends, or the program does, motion that still
continues is held. This cell is simulated; `Cell("tcp/127.0.0.1:7447")` or `Cell(config="config/lab.toml")` is one that
runs:

```python
from vlad_cell import simulated_cell

with simulated_cell(seed=1) as cell:
    cell.reset()
    result = cell.pick("the largest one", progress=print)
print(result.result, result.reason, result.recording)
```

Whole programs: [detect_image.py](examples/detect_image.py), [read_cycle.py](examples/read_cycle.py),
[pick_from_python.py](examples/pick_from_python.py), and a notebook with its output,
[first_pick.ipynb](examples/first_pick.ipynb).
"""

_ARGUMENTS = """\
## Arguments

| type | what |
|---|---|
| `Config` | The path of a station file ([settings.md](settings.md)), or a `Station`; none = the simulated cell. |
| `Settings` | Settings by their full names: `{"scene.pick_region_m": [0.3, 0.6, -0.2, 0.2], "sim.pace": 1}`. |
| `ToPick` | The object in words ([use.md](use.md#ask-for-a-pick-jobs)), or a `Target` by `pixel`, `box` or `point_m`. |
| `ToLay` | The name of a place of the station; x, y, z [m] in `base` and perhaps a heading [rad]; or `Place(...)`. |
| `Progress` | A function that is called with a line for a person, as `print`. |
| `Said` | `CellState`, `Event` or `CycleResult`, as on the bus: [bus.md](bus.md). |"""

_ERRORS = """\
## Errors

Each has `code`, `text` (what happened) and `advice` (what to do); `str(error)` is both. A pick that fails is no error
of the program that asked for it: it is in the `CycleResult`. All codes: [faults.md](faults.md)."""

if __name__ == "__main__":
    PAGE.write_text(page())

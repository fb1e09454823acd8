"""HTML pages: nothing is fetched but the drawing library beside them, recorded text is escaped.

Every folder of pages holds one copy of the library, or a page has it inside, to be sent.
"""

from __future__ import annotations

import base64
import functools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, TypedDict

import numpy as np
import numpy.typing as npt
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs, get_plotlyjs_version

from bus.atomic import write_atomically
from bus.codec import Json
from bus.errors import RecordingError
from logs.mcap.names import shown
from logs.mcap.recorder import MODE

VERSION = "11"
"""Version of the pages: a page of another version is written anew."""


class Picture(NamedTuple):
    """An image with its title."""

    title: str
    uri: str


class Figure(TypedDict):
    """A figure in the words of plotly.js."""

    data: list[Json]
    layout: Json


class Chart(NamedTuple):
    """A plotly.js figure, {data, layout}, with its title."""

    title: str
    figure: Figure


class Fact(NamedTuple):
    """One measured value beside its required value."""

    name: str
    value: str
    asked: str = ""


def script_json(value: object) -> Markup:
    """``value`` as JSON that is safe inside a script element; arrays become plotly's typed ones."""
    return Markup(json.dumps(value, default=_typed_array).replace("<", "\\u003c"))


def _typed_array(values: npt.ArrayLike) -> dict[str, str]:
    return {"dtype": "f4", "bdata": base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()}


def library_name() -> str:
    """Return the file name of plotly.js beside the pages, its version included."""
    return f"plotly-{get_plotlyjs_version()}.min.js"


def write_page(
    template: str, content: Mapping[str, object], path: Path, *, library: bool = False, embed: bool = False
) -> Path:
    """Fill ``template`` of this package and write it to ``path``.

    Args:
        library: the page draws with plotly.js, which is put beside it where it is not yet. ``embed``: into it instead.

    Raises: RecordingError when it cannot be written.
    """
    name = library_name() if library and not embed else ""
    script = Markup(get_plotlyjs()) if library and embed else ""
    page = _environment().get_template(template).render(**content, version=VERSION, library=name, script=script)
    try:
        if name and not path.with_name(name).is_file():
            write_atomically(path.with_name(name), get_plotlyjs().encode(), mode=MODE)
        write_atomically(path, page.encode(errors="backslashreplace"), mode=MODE)
    except OSError as error:
        raise RecordingError(
            f"Cannot write {shown(path)}: {error.strerror}.", "Choose another place with --output."
        ) from error
    return path


@functools.cache
def _environment() -> Environment:
    loader = FileSystemLoader(Path(__file__).parent)
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)

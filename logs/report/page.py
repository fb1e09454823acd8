"""Self-contained HTML pages: nothing is fetched, recorded text is escaped, the drawing library is embedded."""

from __future__ import annotations

import base64
import functools
import gzip
import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, TypedDict

import numpy as np
import numpy.typing as npt
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from bus.atomic import write_atomically
from bus.codec import Json
from bus.errors import RecordingError
from logs.mcap.names import shown
from logs.mcap.recorder import MODE

VERSION = "7"
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


@functools.cache
def packed_plotly() -> str:
    """plotly.js, gzip and base64: 2 MB in a page instead of 5; every browser since 2023 can unpack it."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 6, mtime=0)).decode()


def write_page(template: str, content: Mapping[str, object], path: Path) -> Path:
    """Fill ``template`` of this package and write it to ``path``. Raises: RecordingError when it cannot be written."""
    page = _environment().get_template(template).render(**content, version=VERSION)
    try:
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

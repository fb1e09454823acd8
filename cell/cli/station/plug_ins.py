"""``cell drivers``, ``cell detectors``, ``cell goal-models``: what is installed of each, ours and other packages'."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.metadata import EntryPoint, version
from typing import Any, NamedTuple

from bus.distribution import OURS
from bus.errors import CellError
from bus.redaction import quoted
from cell.cli.options import Json
from cell.terminal.printing import out
from config.plug_ins import Group, model_of, packaged
from drivers.node.registry import GROUP as DRIVERS
from perception.detectors.registry import GROUP as DETECTORS
from perception.detectors.registry import OURS as OUR_DETECTOR
from perception.models.registry import EMBEDDED, PROVIDERS
from perception.models.registry import GROUP as GOAL_MODELS


class _Row(NamedTuple):
    """One plug-in. ``settings``: JSON schema by field. ``error``: why no station can use it; "" = it can."""

    name: str
    package: str
    object: str
    settings: dict[str, Any]
    error: str


def detectors(as_json: Json = False) -> None:
    """List the detectors that a station can name (perception.detector), the package of each, and its settings."""
    _show([_ours(OUR_DETECTOR, "perception.detector:detect"), *_rows(DETECTORS)], as_json=as_json)


def drivers(as_json: Json = False) -> None:
    """List the drivers that a station can name (nodes.NAME.driver), the package of each, and its settings."""
    _show(list(_rows(DRIVERS)), as_json=as_json)


def goal_models(as_json: Json = False) -> None:
    """List the goal-image models that a station can name (perception.model), the package of each, and its settings."""
    hosted = [_ours(name, f"{one.module}:{one.name}") for name, one in PROVIDERS.items()]
    embedded = [_ours(name, f"{one.__module__}:{one.__qualname__}") for name, one in EMBEDDED.items()]
    _show([*sorted([*hosted, *embedded]), *_rows(GOAL_MODELS)], as_json=as_json)


def _ours(name: str, what: str) -> _Row:
    return _Row(name, f"{OURS} {version(OURS)}", what, {}, "")


def _rows(group: Group) -> Iterator[_Row]:
    for point in group.points():
        settings, error = _looked_into(group, point)
        yield _Row(point.name, packaged(point), point.value, settings, error)


def _looked_into(group: Group, point: EntryPoint) -> tuple[dict[str, Any], str]:
    """The schema of its settings, and what is wrong with it. Its package is imported; nothing is opened."""
    if (taken := group.why_not(point)) is not None:
        return {}, taken
    try:
        model = model_of(group.loaded(point))
        return ({} if model is None else model.model_json_schema()["properties"]), ""
    except CellError as error:
        return {}, str(error)
    except Exception as error:  # noqa: BLE001 - of pydantic, for a field that JSON cannot describe
        return {}, f"Its settings cannot be described: {type(error).__name__}: {quoted(str(error))}."


def _show(rows: Sequence[_Row], *, as_json: bool) -> None:
    if as_json:
        out.json([row._asdict() for row in rows])
        return
    for row in rows:
        out.line(f"{row.name:<16} ", (row.package, "dim"), f"  {row.object}")
        if row.settings:
            out.line(" " * 17, f"settings: {', '.join(_in_words(*one) for one in row.settings.items())}")
        if row.error:
            out.line(" " * 17, (row.error, "red"))


def _in_words(name: str, schema: dict[str, Any]) -> str:
    return f"{name} = {schema['default']}" if "default" in schema else f"{name} (required)"

"""``cell detectors`` and ``cell drivers``: what this installation has of them, ours and other packages'."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import EntryPoint, entry_points

from cell.cli.options import Json
from cell.terminal.printing import out
from drivers.node import registry as node_registry
from perception.detectors import registry as detector_registry

_OURS = "vlad-cell"


def detectors(as_json: Json = False) -> None:
    """The detectors that a station can name (perception.detector), and the package that brings each."""
    ours = [(detector_registry.OURS, _OURS, "perception.detector:detect")]
    _show([*ours, *_rows(detector_registry.points())], as_json=as_json)


def drivers(as_json: Json = False) -> None:
    """The drivers that a station can name (nodes.NAME.driver), and the package that brings each."""
    _show(_rows(sorted(entry_points(group=node_registry.GROUP), key=lambda one: one.name)), as_json=as_json)


def _rows(points: Iterable[EntryPoint]) -> list[tuple[str, str, str]]:
    return [(one.name, f"{one.dist.name} {one.dist.version}" if one.dist else "", one.value) for one in points]


def _show(rows: list[tuple[str, str, str]], *, as_json: bool) -> None:
    if as_json:
        out.json([{"name": name, "package": package, "object": value} for name, package, value in rows])
        return
    for name, package, value in rows:
        out.line(f"{name:<16} ", (package, "dim"), f"  {value}")

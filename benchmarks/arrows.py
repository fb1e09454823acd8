"""The imports between the modules below a checkout, read by ``ast`` and never imported.

An arrow is a pair of modules (importing, imported), counted once. ``from a.b import c`` points to the module ``a.b.c``
if that exists, otherwise to ``a.b``; the implicit import of ``a`` does not count. There are three kinds: a plain
import; one for type checkers only; and a module's dotted name in a string, which is how it is imported late or run as a
process. Names that are composed at run time are not seen.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

LAYERS = (("bus",), ("config",), ("drivers", "perception", "planning", "logs"), ("cell",))
"""The packages from below to above: an arrow may only point to a lower layer, or stay in its package."""
PACKAGES = tuple(package for layer in LAYERS for package in layer)
_LAYER_OF = {package: height for height, layer in enumerate(LAYERS) for package in layer}

Arrow = tuple[str, str]
"""(importer, imported), both modules or both rooms."""


@dataclass(frozen=True)
class Module:
    """One Python file: its dotted name, its room (the folder it lies in, from the root) and its text."""

    name: str
    room: str
    text: str

    @property
    def package(self) -> str:
        """The top-level folder."""
        return top(self.name)

    @property
    def lines(self) -> int:
        """All of them, blank ones and comments too."""
        return len(self.text.splitlines())

    @cached_property
    def tree(self) -> ast.Module:
        """Raises: SyntaxError naming the file."""
        return ast.parse(self.text, filename=self.name)


def top(name: str) -> str:
    """The package of a module's dotted name, or of a room's path."""
    return re.split(r"[./]", name, maxsplit=1)[0]


def read_modules(root: Path, package: str) -> list[Module]:
    """Every Python file in the folder ``package`` of ``root``, sorted by name; none when there is no such folder."""
    modules = []
    for path in sorted((root / package).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        modules.append(Module(name, path.parent.relative_to(root).as_posix(), path.read_text("utf-8")))
    return modules


def imports(module: Module) -> Iterator[tuple[str, str | None, bool]]:
    """(module, name imported from it or None, whether only for type checkers) of every import, in functions too."""
    blocks = [node.body for node in ast.walk(module.tree) if isinstance(node, ast.If) and _is_for_types(node.test)]
    for_types = {id(node) for block in blocks for line in block for node in ast.walk(line)}
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, None, id(node) in for_types) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from ((_source(node, module), alias.name, id(node) in for_types) for alias in node.names)


@dataclass
class Arrows:
    """The arrows of one set of modules by kind, each in one kind only: the first in this order.

    Attributes:
        plain: imports that run.
        for_types: imports that only type checkers follow.
        by_string: dotted module names in strings.
        room_of: the room that every module counts to, by the module's name.
    """

    plain: set[Arrow] = field(default_factory=set)
    for_types: set[Arrow] = field(default_factory=set)
    by_string: set[Arrow] = field(default_factory=set)
    room_of: dict[str, str] = field(default_factory=dict)


def arrows(modules: Iterable[Module]) -> Arrows:
    """All arrows between ``modules``; an import from elsewhere makes none."""
    by_name = {module.name: module for module in modules}
    found = Arrows(room_of=_rooms(by_name.values()))
    for module in by_name.values():
        for source, name, is_for_types in imports(module):
            imported = f"{source}.{name}" if f"{source}.{name}" in by_name else source
            if imported in by_name and imported != module.name:
                (found.for_types if is_for_types else found.plain).add((module.name, imported))
        strings = {node.value for node in ast.walk(module.tree) if isinstance(node, ast.Constant)}
        named = {text for text in strings if isinstance(text, str) and "." in text and text in by_name}
        found.by_string |= {(module.name, text) for text in named - {module.name}}
    found.for_types -= found.plain
    found.by_string -= found.plain | found.for_types
    return found


def _rooms(modules: Iterable[Module]) -> dict[str, str]:
    """The room that each module counts to. Beside folders, a file of the package itself is a room of its own."""
    modules = list(modules)
    with_folders = {module.package for module in modules if "/" in module.room}
    return {
        module.name: module.name.replace(".", "/") if module.room in with_folders else module.room for module in modules
    }


def between_rooms(pairs: Iterable[Arrow], room_of: dict[str, str]) -> set[Arrow]:
    """Arrows between rooms, made from arrows between modules; an arrow that stays in its room makes none."""
    return {(room_of[a], room_of[b]) for a, b in pairs if room_of[a] != room_of[b]}


def circles(pairs: Iterable[Arrow]) -> list[list[str]]:
    """Strongly connected components of more than one member, sorted."""
    towards: dict[str, set[str]] = defaultdict(set)
    for a, b in pairs:
        towards[a].add(b)
    reached = {name: _reached(name, towards) for name in list(towards)}
    rings = {tuple(sorted(b for b in reached[a] if a in reached.get(b, ()))) for a in reached}
    return sorted(list(ring) for ring in rings if ring)


def against_layers(pairs: Iterable[Arrow]) -> dict[str, list[str]]:
    """Arrows that the layers forbid: ``up`` to a higher layer, and ``sideways`` to another package of its own."""
    wrong: dict[str, list[str]] = {"up": [], "sideways": []}
    for a, b in sorted(pairs):
        source, target = top(a), top(b)
        if _LAYER_OF[source] < _LAYER_OF[target]:
            wrong["up"].append(f"{a} -> {b}")
        elif _LAYER_OF[source] == _LAYER_OF[target] and source != target:
            wrong["sideways"].append(f"{a} -> {b}")
    return wrong


def _reached(start: str, towards: dict[str, set[str]]) -> set[str]:
    """Everything that arrows lead to from ``start``; ``start`` itself only if they lead back to it."""
    reached: set[str] = set()
    waiting = [start]
    while waiting:
        news = towards.get(waiting.pop(), set()) - reached
        reached |= news
        waiting.extend(news)
    return reached


def _is_for_types(test: ast.expr) -> bool:
    return ast.unparse(test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")


def _source(node: ast.ImportFrom, module: Module) -> str:
    """The absolute name of the module or package that an import takes its names from."""
    if not node.level:
        return node.module or ""
    folder = module.room.split("/")
    return ".".join([*folder[: len(folder) - node.level + 1], *([node.module] if node.module else [])])

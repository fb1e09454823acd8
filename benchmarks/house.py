"""The structure of the code in figures: rooms, imports, circles, lengths, docstrings. The code is read, never imported.

A room is a folder; the files directly in a package are the room of the package itself; for the imports between rooms
each of them is a room of its own where the package has folders. Lines of a module are all of its lines. Lines of a
function are those from its ``def`` to its end, without the lines of its docstring; decorators do not count; nested
functions count, and are counted once more by themselves. ``p90`` is the smallest length that 90 % do not exceed. A kLOC
is a thousand lines of modules.
"""

from __future__ import annotations

import ast
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.arrows import (
    PACKAGES,
    Arrow,
    Arrows,
    Module,
    against_layers,
    arrows,
    between_rooms,
    circles,
    imports,
    read_modules,
    top,
)
from benchmarks.wording import array_names, count_words, described, names, public

_VAGUE = re.compile(r"\b(whoever|somebody)\b", re.IGNORECASE)
_PRIVATE = re.compile(r"(.*\.)?_[A-Za-z0-9]\w*")
_BROAD = ("Exception", "BaseException")


def measure(root: Path, tell: Callable[[str], None]) -> dict[str, Any]:
    """Figures of every package in the folder ``root``, of all packages together, and of the tests beside them.

    Raises: FileNotFoundError when no package is there; SyntaxError naming a file that cannot be parsed.
    """
    modules = [module for package in PACKAGES for module in read_modules(root, package)]
    if not modules:
        raise FileNotFoundError(f"{root} holds none of {', '.join(PACKAGES)}: name a checkout's folder")
    every, arrays = arrows(modules), array_names(modules)
    figures = {}
    for package in PACKAGES:
        if own := [module for module in modules if module.package == package]:
            tell(f"{package}: {len(own)} files")
            figures[package] = _figures(own, every, arrays)
    return {"packages": figures, "total": _figures(modules, every, arrays), "tests": _tests(root)}


def _figures(own: list[Module], every: Arrows, arrays: frozenset[str]) -> dict[str, Any]:
    """Figures of the modules of one package, or of all packages."""
    lines = {module.name: module.lines for module in own}
    kloc = sum(lines.values()) / 1000
    rooms = Counter(module.room for module in own)
    docstrings = [ast.get_docstring(module.tree) or "" for module in own]
    found = {
        "broad_excepts": sum(map(broad_excepts, own)),
        "any_in_annotations": sum(map(any_in_annotations, own)),
    }
    return {
        "files": len(own),
        "lines": sum(lines.values()),
        "rooms": {"count": len(rooms), "most_files": max(rooms.values()), "files": dict(rooms.most_common())},
        **_structure(own, every),
        "module_lines": _spread(lines),
        "function_lines": _spread({name: length for module in own for name, length in function_lines(module)}),
        "docstrings": described([one for module in own for one in public(module, arrays)]),
        **found,
        **{f"{name}_per_kloc": round(count / kloc, 2) for name, count in found.items()},
        "module_docstrings": sum(bool(text) for text in docstrings),
        "module_docstrings_with_what": sum(bool(re.match(r"What\b", text)) for text in docstrings),
        "whoever_or_somebody": sum(count_words(module, _VAGUE) for module in own),
    }


def _structure(own: list[Module], every: Arrows) -> dict[str, Any]:
    """The arrows that begin in these modules, and the circles that lie in them."""
    names = {module.name for module in own}
    plain, for_types, by_string = (
        {arrow for arrow in kind if arrow[0] in names} for kind in (every.plain, every.for_types, every.by_string)
    )
    whole = plain | for_types | by_string
    within, whole_within = ({arrow for arrow in kind if arrow[1] in names} for kind in (plain, whole))
    return {
        "arrows": {
            "modules": _split(plain),
            "rooms": _split(between_rooms(plain, every.room_of)),
            "for_types_only": len(for_types),
            "by_string_only": len(by_string),
        },
        "circles": {
            "modules": circles(within),
            "rooms": circles(between_rooms(within, every.room_of)),
            "modules_by_any_arrow": circles(whole_within),
        },
        **against_layers(whole),
    }


def _split(pairs: set[Arrow]) -> dict[str, int]:
    """The number of arrows inside packages, and of those from one package to another."""
    inside = sum(top(a) == top(b) for a, b in pairs)
    return {"inside": inside, "between_packages": len(pairs) - inside}


def _spread(lengths: dict[str, int]) -> dict[str, Any]:
    """Count, median, p90 and maximum of lengths [lines], and the name of the longest."""
    ordered = sorted(lengths.values())
    if not ordered:
        return {"count": 0}
    return {
        "count": len(ordered),
        "median": median(ordered),
        "p90": ordered[math.ceil(0.9 * len(ordered)) - 1],
        "max": ordered[-1],
        "longest": max(lengths, key=lambda name: lengths[name]),
    }


def function_lines(module: Module) -> Iterator[tuple[str, int]]:
    """(place and name, lines without its docstring) of every function and method, also of those in functions."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            undescribed = _height(node) - (_height(node.body[0]) if ast.get_docstring(node) is not None else 0)
            yield f"{module.name}:{node.lineno} {node.name}", undescribed


def _height(node: ast.stmt) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def broad_excepts(module: Module) -> int:
    """``except Exception``, ``except BaseException``, alone or among others, and a bare ``except``."""
    handlers = [node for node in ast.walk(module.tree) if isinstance(node, ast.ExceptHandler)]
    return sum(
        any(one is None or ast.unparse(one) in _BROAD for one in _alternatives(handler.type)) for handler in handlers
    )


def _alternatives(caught: ast.expr | None) -> Iterable[ast.expr | None]:
    return caught.elts if isinstance(caught, ast.Tuple) else [caught]


def any_in_annotations(module: Module) -> int:
    """Count how often ``Any`` stands in the annotations of arguments, results and variables."""
    found: list[ast.expr | None] = []
    for node in ast.walk(module.tree):
        if isinstance(node, ast.arg | ast.AnnAssign):
            found.append(node.annotation)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            found.append(node.returns)
    return sum(names(annotation).count("Any") for annotation in found if annotation is not None)


def private_patches(module: Module) -> int:
    """Calls of ``setattr`` that name something private in a string: ``"_name"``, or at the end of ``"a.b._name"``."""
    calls = [node for node in ast.walk(module.tree) if isinstance(node, ast.Call)]
    return sum(
        any(isinstance(one, ast.Constant) and _PRIVATE.fullmatch(str(one.value)) is not None for one in call.args[:2])
        for call in calls
        if ast.unparse(call.func).split(".")[-1] == "setattr"
    )


def names_imported(modules: list[Module], package: str) -> int:
    """Count the names that the modules import from ``package``; a name counts once for every import."""
    return sum(top(source) == package for module in modules for source, _, _ in imports(module))


def _tests(root: Path) -> dict[str, int]:
    tests, benchmarks = read_modules(root, "tests"), read_modules(root, "benchmarks")
    return {
        "files": len(tests),
        "lines": sum(module.lines for module in tests),
        "private_patches": sum(map(private_patches, tests)),
        "names_from_benchmarks": names_imported(tests, "benchmarks"),
        "benchmarks_names_from_tests": names_imported(benchmarks, "tests"),
    }

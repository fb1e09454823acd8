"""The documentation of the code in figures: docstrings of public definitions, words in docstrings and comments.

A class, function or method is public when its name has no leading underscore and it stands at the top of a module or in
a public class. Setters, overloads and definitions within functions do not count. The text that describes it is its
docstring; for a class that has one, also its constructor's docstring and the strings below its fields. A class takes
the arguments of its constructor, or else its annotated fields; a section ``Attributes:`` counts as ``Args:``.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from benchmarks.arrows import Module

_Function = ast.FunctionDef | ast.AsyncFunctionDef
_Definition = _Function | ast.ClassDef

_UNIT = "nm|mm|m|ns|us|ms|s|rad|deg|px|hz|khz|n|kg|mb|gb|bytes|usd"
_NAME_WITH_UNIT = re.compile(rf"[a-z0-9]_({_UNIT})[23]?\b")
_ANY_UNIT = rf"(?i:{_UNIT}|h|min|%|°)"
_DIMENSION = r"(\.\.\.|\d+|[A-Za-z])"
_UNIT_OR_SHAPE = re.compile(
    rf"\({_DIMENSION}(,|(, ?{_DIMENSION})+,?)\)"  # (4,), (4, 4), (..., 3), (H, W), (u, v)
    r"|\b[0-9HNn] ?x ?([0-9]|W\b)"  # 4x4, HxWx3
    rf"|\[{_ANY_UNIT}(\^?[23])?([ /*].*?)?\]"  # [m], [rad/s], [m^2]
    rf"|\d ?{_ANY_UNIT}(?![A-Za-z])"  # 5 mm, 1 kHz
    rf"|\bin (mm|m|s|ms|ns|px|rad|deg|Hz|N|USD|UTC)\b"
    r"|\b(milli)?met(re|er)s?\b|\b(nano|micro|milli)?seconds?\b|\b(radian|degree|pixel|newton|byte|share)s?\b"
)
_ARGS = re.compile(r"^\s*(Args|Arguments|Parameters|Attributes):|:param\b", re.MULTILINE)
_RAISES = re.compile(r"\bRaises\b|:raises\b")
_NUMBERS = frozenset({"float", "int", "complex", "NDArray", "ndarray", "ArrayLike"})


@dataclass(frozen=True)
class Public:
    """One public definition: its dotted name, the text that describes it, and the number and array types it takes."""

    name: str
    text: str
    numbers: frozenset[str]

    def names_unit_or_shape(self) -> bool:
        """Whether the text does, be it by a name that ends in its unit, as ``width_m``."""
        return bool(_UNIT_OR_SHAPE.search(self.text) or _NAME_WITH_UNIT.search(self.text))


def array_names(modules: Iterable[Module]) -> frozenset[str]:
    """The names that modules give to array types, as in ``Array = NDArray[float64]``."""
    nodes = (node for module in modules for node in ast.walk(module.tree))
    aliases = [node for node in nodes if isinstance(node, ast.Assign) and "NDArray[" in ast.unparse(node.value)]
    return frozenset(target.id for node in aliases for target in node.targets if isinstance(target, ast.Name))


def public(module: Module, arrays: frozenset[str]) -> list[Public]:
    """The public definitions of a module, from top to bottom; ``arrays``: names of array types (`array_names`)."""
    numbers = _NUMBERS | arrays
    return [
        Public(dotted, _text(node), numbers.intersection(_argument_names(node)))
        for dotted, node in _definitions(module.tree.body, module.name)
    ]


def names(annotation: ast.expr) -> list[str]:
    """Every name and attribute in an annotation, as often as it stands there; strings are not looked into."""
    nodes = list(ast.walk(annotation))
    attributes = [node.attr for node in nodes if isinstance(node, ast.Attribute)]
    return [node.id for node in nodes if isinstance(node, ast.Name)] + attributes


def described(found: list[Public]) -> dict[str, Any]:
    """Count the public definitions; ``documented`` is a share of all of them, in 0..1.

    The other shares are of those that have a docstring. ``unit_or_shape`` is the share of those that take numbers or
    arrays, and is given once more without those that take only ``int``, which mostly counts or numbers things.
    """
    texts = [one.text for one in found if one.text]
    args, raises = ([bool(said.search(text)) for text in texts] for said in (_ARGS, _RAISES))
    counted = [one for one in found if one.text and one.numbers]
    measured = [one for one in counted if one.numbers != {"int"}]
    return {
        "public": len(found),
        "documented": share([bool(one.text) for one in found]),
        "args": share(args),
        "raises": share(raises),
        "args_or_raises": share([any(said) for said in zip(args, raises, strict=True)]),
        "with_numbers": len(counted),
        "unit_or_shape": share([one.names_unit_or_shape() for one in counted]),
        "with_floats_or_arrays": len(measured),
        "unit_or_shape_of_floats_or_arrays": share([one.names_unit_or_shape() for one in measured]),
    }


def share(hits: list[bool]) -> float | None:
    """The share of ``hits`` that are true, in 0..1; None when there are no hits."""
    return round(sum(hits) / len(hits), 3) if hits else None


def count_words(module: Module, pattern: re.Pattern[str]) -> int:
    """Count how often ``pattern`` stands in docstrings (every string that is a statement) and comments of a module."""
    texts = list(_strings(ast.walk(module.tree)))
    tokens = tokenize.generate_tokens(io.StringIO(module.text).readline)
    texts += [token.string for token in tokens if token.type == tokenize.COMMENT]
    return sum(len(pattern.findall(text)) for text in texts)


def _strings(nodes: Iterable[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.value.value


def _definitions(body: list[ast.stmt], owner: str) -> Iterator[tuple[str, _Definition]]:
    for node in body:
        if isinstance(node, ast.If | ast.Try):
            yield from _definitions([*node.body, *node.orelse], owner)
        elif isinstance(node, _Definition) and not node.name.startswith("_") and not _is_repeated(node):
            yield f"{owner}.{node.name}", node
            if isinstance(node, ast.ClassDef):
                yield from _definitions(node.body, f"{owner}.{node.name}")


def _is_repeated(node: _Definition) -> bool:
    """Whether it is a setter, deleter or overload, whose description stands at another definition."""
    return any(ast.unparse(one).split(".")[-1] in ("setter", "deleter", "overload") for one in node.decorator_list)


def _constructor(node: ast.ClassDef) -> _Function | None:
    return next((one for one in node.body if isinstance(one, _Function) and one.name == "__init__"), None)


def _text(node: _Definition) -> str:
    own = ast.get_docstring(node) or ""
    if not own or not isinstance(node, ast.ClassDef):
        return own
    constructor = _constructor(node)
    return "\n".join([*_strings(node.body), *_strings(constructor.body if constructor else [])])


def _argument_names(node: _Definition) -> list[str]:
    """The names in the annotations of what a function or class takes."""
    taking = _constructor(node) if isinstance(node, ast.ClassDef) else node
    annotated: list[ast.arg | ast.AnnAssign]
    if taking is None:
        annotated = [one for one in node.body if isinstance(one, ast.AnnAssign)]
    else:
        given = taking.args
        more = [one for one in (given.vararg, given.kwarg) if one is not None]
        annotated = [*given.posonlyargs, *given.args, *given.kwonlyargs, *more]
    return [name for one in annotated if one.annotation is not None for name in names(one.annotation)]

"""Command lines as pages and examples show them, parsed by the commands themselves; nothing is carried out."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from typer.main import get_command

from cell.cli.commands import COMMANDS, command, command_line
from config.keys import is_there

ROOT = Path(__file__).parents[2]
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_CODE = re.compile(r"(?<!`)`((?:[^`\n]|\n(?!\n))+)`(?!`)")
"""In running text, also across the end of a line."""
_PLACEHOLDER = re.compile(r"\b[A-Z][A-Z_]+\b|\.\.\.|…|\bN\b|\bX\b")
"""A value that whoever types the line puts in: FILE, CYCLE, N, and so on."""
_OUTPUT = re.compile(r"cell \S+ on \S+")
"""What `cell start` says first."""
_SET = re.compile(r"--set[ =][\"']?([A-Za-z][\w.]*)=")
_PROGRAM = re.compile(r"\b(cell|just|python[\d.]*)\b")
_NO_LINE = re.compile(r"\[OPTIONS\]|<TAB>")
"""The usage of the help, and what a shell completes."""
_BEFORE = re.compile(r"[A-Z_]+=\S*|uv|run|sudo|exec|time|nice|-u|vlad-cell|ExecStart=.*|\$|-e|--extra|\S*/\S+\.sh")
"""What stands before a program in a line."""
_JUST = re.compile(r"^([a-z][\w-]*)(?: [^:=]*)?:(?!=)", re.MULTILINE)
_ENDS = {"&&", "||", ";", "|", "&", ">", ">>", "2>&1", "<"}


class Line(NamedTuple):
    """One command as it is shown. ``is_named``: in running text, where a name alone is enough."""

    text: str
    is_named: bool = False


def lines_of(page: str) -> Iterator[Line]:
    """Everything on a Markdown page that is typed into a shell."""
    for language, block in _FENCE.findall(page):
        if language in ("", "sh", "bash", "console"):
            for line in block.replace("\\\n", " ").splitlines():
                if not _OUTPUT.match(line):
                    yield Line(line.strip())
    for text in _CODE.findall(_FENCE.sub("", page)):
        yield Line(" ".join(text.replace("\\|", "|").split()), is_named=True)
    for language, block in _FENCE.findall(page):
        if language == "text":  # what the cell says, in which it names commands
            yield from (Line(text, is_named=True) for text in _CODE.findall(block))


def named_in(source: str) -> Iterator[Line]:
    """The commands that a program's texts name, as in an advice: each within backticks."""
    joined = re.sub(r'"\s*\n\s*f?"', "", source)
    yield from (
        Line(text, is_named=True) for text in _CODE.findall(joined) if text.startswith("cell ") and "\n" not in text
    )


def problems(line: Line) -> list[str]:
    """What is wrong with a line's commands (`cell`, `just`, ``python -m``), and with the settings it names."""
    found = [setting_problem(key) for key in _SET.findall(line.text) if key != "key"]
    if _PROGRAM.search(line.text) and not _NO_LINE.search(line.text):
        found += [_problem(words, is_named=line.is_named) for words in _commands(line.text)]
    return [said for said in dict.fromkeys(found) if said]


def _commands(text: str) -> Iterator[list[str]]:
    """The words of each command of a line; none of what no shell could read."""
    lexer = shlex.shlex(text, posix=True, punctuation_chars=";&")
    lexer.whitespace_split, lexer.commenters = True, "#"
    try:
        words = list(lexer)
    except ValueError:  # an apostrophe in prose
        return
    some: list[str] = []
    for word in (*words, ";"):
        if word not in _ENDS:
            some.append(word)
            continue
        if some:
            yield some
        some = []


def _problem(words: list[str], *, is_named: bool) -> str:
    for place, word in enumerate(words):
        name, rest = word.rpartition("/")[2], words[place + 1 :]
        if word.startswith("ExecStart="):
            name = word.rpartition("/")[2]
        if name == "cell" and (word == "cell" or word.endswith("bin/cell")):
            return cell_problem(rest, is_named=is_named)
        if word == "just" and rest:
            return "" if rest[0] in recipes() or rest[0].startswith("-") else f"there is no recipe {rest[0]}"
        if re.fullmatch(r"python[\d.]*", name) and rest:
            return _module_problem(rest)
        if not _BEFORE.fullmatch(word):
            return ""
    return ""


@cache
def recipes() -> frozenset[str]:
    """The names of the recipes in the justfile."""
    return frozenset(_JUST.findall((ROOT / "justfile").read_text()))


def _module_problem(words: Sequence[str]) -> str:
    if words[0] != "-m" or len(words) == 1:
        return ""
    module, rest = words[1], words[2:]
    if module.partition(".")[0] in ("docs", "benchmarks", "stand_ins", "tests") and find_spec(module) is None:
        return f"there is no module {module}"
    if module == "benchmarks" and rest and not _is_given(rest[0]):
        return _benchmark_problem(rest)
    return ""


@cache
def benchmarks() -> dict[str, frozenset[str]]:
    """The options of each benchmark, read from the source: importing all of them takes two seconds."""
    tree = ast.parse((ROOT / "benchmarks" / "__main__.py").read_text())
    found = {}
    for one in tree.body:
        if not isinstance(one, ast.FunctionDef):
            continue
        for made in one.decorator_list:
            if isinstance(made, ast.Call) and ast.unparse(made.func) == "app.command":
                named = [word.value.value for word in made.keywords if isinstance(word.value, ast.Constant)]
                found[str(named[0]) if named else one.name.replace("_", "-")] = frozenset(_options_of(one))
    return found


def _options_of(function: ast.FunctionDef) -> Iterator[str]:
    for one in function.args.args:
        strings = (part.value for part in ast.walk(one) if isinstance(part, ast.Constant))
        named = [text for text in strings if isinstance(text, str) and re.fullmatch(r"--?[a-z-]+", text)]
        yield from named or [f"--{one.arg.replace('_', '-')}"]


def _benchmark_problem(words: Sequence[str]) -> str:
    known = benchmarks()
    if words[0].startswith("-"):
        return ""
    if words[0] not in known:
        return f"there is no benchmark {words[0]}"
    given = [word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)]
    return next((f"{words[0]} has no option {one}" for one in given if one not in {*known[words[0]], "--help"}), "")


_made = cache(command)


def cell_problem(words: Sequence[str], *, is_named: bool = False) -> str:
    """What is wrong with the words after `cell`; "" = nothing."""
    words = [one.strip("[]") for one in words]
    return next((said for one in _each(words) if (said := _cell_problem(one, is_named=is_named))), "")


def _each(words: Sequence[str]) -> Iterator[list[str]]:
    """The lines that ``show|check`` stands for; placeholders and quoted texts stay whole."""
    for place, word in enumerate(words):
        if re.fullmatch(r"[a-z-]+(\|[a-z-]+)+", word):
            for one in word.split("|"):
                yield from _each([*words[:place], one, *words[place + 1 :]])
            return
    yield list(words)


def _cell_problem(words: list[str], *, is_named: bool) -> str:
    if not words or words[0].startswith("-"):
        known = {option for one in get_command(command_line()).params for option in one.opts} | {"--help"}
        return next((f"cell has no option {one}" for one in words if one.startswith("-") and one not in known), "")
    if words[0] not in COMMANDS:
        return "" if _is_given(words[0]) else f"there is no command {words[0]}"
    made, rest = _made(words[0]), words[1:]
    if hasattr(made, "commands"):
        if not rest or rest[0].startswith("-") or _is_given(rest[0]):
            return ""
        if rest[0] not in made.commands:
            return f"{words[0]} has no command {rest[0]}"
        made, rest = made.commands[rest[0]], rest[1:]
    return _parsed(made, rest, is_named=is_named)


def _parsed(made: Any, words: list[str], *, is_named: bool) -> str:
    """What the command's own parser says; values that are placeholders are taken as they are."""
    names_only = is_named and all(word.startswith("-") for word in words)
    if "--help" in words:
        return ""
    context = made.context_class(made, info_name=made.name)
    if names_only and words and _lacks_value(made, words[-1]):
        words = [*words, "VALUE"]
    try:
        given, left, _ = made.make_parser(context).parse_args(list(words))
        for param in made.params:
            said = given.get(param.name)
            if said is None or _is_given(said):
                if said is None and param.required and not names_only:
                    return f"{made.name}: {param.name} is missing"
                continue
            param.process_value(context, said)
    except Exception as error:  # noqa: BLE001 - typer's own copy of click, and what the types raise
        return f"{made.name}: {getattr(error, 'message', error)}"
    left = [one for one in left if one not in ("...", "…")]
    return f"{made.name} takes no {' '.join(left)}" if left else ""


def _lacks_value(made: Any, word: str) -> bool:
    option = next((one for one in made.params if word in one.opts), None)
    return option is not None and not getattr(option, "is_flag", False)


def _is_given(said: Any) -> bool:
    """Whether a value is, or holds, a placeholder."""
    if isinstance(said, str):
        return bool(_PLACEHOLDER.search(said))
    return isinstance(said, (list, tuple)) and any(_is_given(one) for one in said)


def setting_problem(key: str) -> str:
    """Whether `--set` knows a key, of the station or of a plug-in's own table; "" = it does."""
    return "" if is_there(key.split(".")) or _is_given(key) else f"there is no setting {key}"

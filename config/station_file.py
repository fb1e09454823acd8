"""Writes a new camera mounting into a station file, and leaves every other byte unchanged."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable, Item, Key, Table

from bus.atomic import write_atomically
from bus.errors import ConfigError
from config.toml_file import BYTE_ORDER_MARK, parsed, read_text

_KEYS = ("hand_from_color_position_m", "hand_from_color_wxyz")
_Body = list[tuple[Key | None, Item]]


def mounting_lines(position_m: Sequence[float], wxyz: Sequence[float]) -> dict[str, str]:
    """Return the two settings of ``hand_from_color`` as lines of TOML, by key.

    Args:
        position_m: (3,). ``wxyz``: unit quaternion (4,).
    """
    values = (", ".join(f"{value:.7f}" for value in position_m), ", ".join(f"{value:.9f}" for value in wxyz))
    return {key: f"{key} = [{value}]" for key, value in zip(_KEYS, values, strict=True)}


def with_mounting(text: str, position_m: Sequence[float], wxyz: Sequence[float], note: str) -> str:
    """Return the station file's ``text`` with another camera mounting; the old one is kept as a comment.

    Args:
        position_m, wxyz: of ``hand_from_color``: (3,) [m] and a unit quaternion (4,).
        note: comment line above the new settings.

    Raises:
        ConfigError: the file's form does not allow a safe change.
    """
    new = mounting_lines(position_m, wxyz)
    plain = text.removeprefix(BYTE_ORDER_MARK)
    before = parsed(plain, "The station file")
    line_end = "\r\n" if "\r\n" in plain else "\n"
    added = "" if plain.endswith("\n") else line_end  # every line needs its end; removed again below
    try:
        document = tomlkit.parse(plain + added)
        _set(document.body, new, f"# {note}", line_end)
        written = tomlkit.dumps(document).removesuffix(added)
        changed = _only_the_mounting_changed(before, parsed(written, "The station file"), new)
    except (TOMLKitError, ConfigError) as error:
        raise ConfigError(f"The camera's table cannot be changed automatically: {error}") from error
    if not changed:
        raise ConfigError("The camera's table cannot be changed automatically.")
    return text[: len(text) - len(plain)] + written


def write_mounting(path: Path, position_m: Sequence[float], wxyz: Sequence[float], note: str) -> None:
    """Change the file atomically; a symbolic link stays one, mode and owner stay. Arguments: see `with_mounting`.

    Raises:
        ConfigError: says why not, with the lines to copy (position [m], quaternion wxyz).
    """
    try:
        require_writable(path)
        write_atomically(path, with_mounting(read_text(path), position_m, wxyz, note).encode())
    except (ConfigError, OSError) as error:
        text = error.text if isinstance(error, ConfigError) else f"The station file {path} cannot be written: {error}."
        lines = "\n".join(mounting_lines(position_m, wxyz).values())
        raise ConfigError(text, f"Copy these lines into your station file:\n[camera]\n{lines}") from error


def require_writable(path: Path) -> None:
    """Check, without changing anything, that `write_mounting` can succeed.

    Raises:
        ConfigError: it cannot.
    """
    target = os.path.realpath(path)
    try:
        found = os.stat(target)
        why = _why_not(target, found)
        if why is None:
            with_mounting(read_text(path), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), "a trial")
            with tempfile.TemporaryFile(dir=os.path.dirname(target)) as trial:
                os.fchown(trial.fileno(), found.st_uid, found.st_gid)
    except FileNotFoundError as error:
        raise ConfigError(f"There is no station file {path}.") from error
    except OSError as error:
        why = f"what is to replace it cannot be made in its folder, with its owner ({error.strerror})"
    if why is not None:
        raise ConfigError(
            f"The station file {path} cannot be written: {why}.", "With --dry-run the result is only shown."
        )


def _why_not(target: str, found: os.stat_result) -> str | None:
    if not stat.S_ISREG(found.st_mode):
        return "it is no regular file"
    if not found.st_mode & 0o222 or not os.access(target, os.W_OK):  # a read-only file stays unchanged for root, too
        return "it is read-only"
    if found.st_nlink > 1:
        return f"it has {found.st_nlink} names (hard links), and only one of them would get the new content"
    if os.path.ismount(target):
        return "it is a mount point, and cannot be replaced"
    return None


# --- the edit ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Place:
    """One entry of the file that sets something of the camera: entry ``index`` of ``body``.

    Attributes:
        settings: the keys that it sets; all of them, if ``is_inline``: ``camera = { ... }``.
        prefix: of its key, where the whole path stands in the line.
    """

    body: _Body
    index: int
    settings: tuple[str, ...]
    prefix: str = ""
    is_inline: bool = False


def _set(body: _Body, new: dict[str, str], note: str, line_end: str) -> None:
    """Put the lines of ``new`` in place of the old ones, or else below ``[camera]``, wherever that is."""
    places = list(_places(body))
    old = [place for place in places if place.is_inline or place.settings[0] in new]
    missing = [line for key, line in new.items() if not any(place.is_inline or key in place.settings for place in old)]
    for place in reversed(old):  # from the end, so that the earlier indices stay right
        _replace(place, new, note if place is old[0] and not missing else None, line_end)
    if missing:
        _insert(body, places, [note, *missing], line_end)


def _places(body: _Body) -> Iterator[_Place]:
    """Yield every entry that sets something of ``camera``, in the order of the file."""
    for index, (key, item) in enumerate(body):
        if key is None or key.key != "camera":
            continue
        if isinstance(item, InlineTable):
            yield _Place(body, index, tuple(item), is_inline=True)
        elif isinstance(item, Table) and key.is_dotted():
            yield _Place(body, index, tuple(item), prefix="camera.")
        elif isinstance(item, Table):
            inner = item.value.body
            yield from (_Place(inner, at, (each.key,)) for at, (each, _) in enumerate(inner) if each is not None)


def _replace(place: _Place, new: dict[str, str], note: str | None, line_end: str) -> None:
    """Write the new line, and the old ones below it as comments; indented as the old ones, and ended like them."""
    key, item = place.body[place.index]
    assert key is not None
    if place.prefix:
        ((inner, item),) = ((each, one) for each, one in item.value.body if each is not None)
        name = f"{key.as_string()}.{inner.as_string()}{inner.sep}"
    else:
        name = key.as_string() + key.sep
    trivia = item.trivia
    old = (name + item.as_string() + trivia.comment_ws + trivia.comment).replace("\r\n", "\n").split("\n")
    line = name + _inline(item, new) if place.is_inline else place.prefix + new[place.settings[0]]
    lines = [*([note] if note else []), line, *(f"# before: {each}".rstrip() for each in old)]
    text = line_end.join(trivia.indent + each for each in lines)
    place.body[place.index : place.index + 1] = _entries(text + trivia.trail)


def _inline(item: Item, new: dict[str, str]) -> str:
    """Return the inline table with other values."""
    assert isinstance(item, InlineTable)
    for key, line in new.items():
        item[key] = tomlkit.value(line.partition("=")[2].strip())
    return item.as_string()


def _insert(body: _Body, places: list[_Place], lines: list[str], line_end: str) -> None:
    """Insert settings that were missing: below ``[camera]``, beside its dotted keys, or in a table of their own."""
    for key, item in body:
        if key is not None and key.key == "camera" and isinstance(item, Table) and not key.is_dotted():
            item.value.body[:0] = _entries(_text(lines, line_end))
            return
    if places:
        at = places[0].index
        body[at:at] = _entries(_text([lines[0], *(f"camera.{line}" for line in lines[1:])], line_end))
    else:
        body += _entries(_text(["", "[camera]", *lines], line_end))


def _text(lines: Sequence[str], line_end: str) -> str:
    return "".join(line + line_end for line in lines)


def _entries(text: str) -> _Body:
    return tomlkit.parse(text).body


def _only_the_mounting_changed(old: dict[str, Any], new: dict[str, Any], lines: dict[str, str]) -> bool:
    """Whether the mounting is now as ``lines`` say, and the rest unchanged."""
    wanted = parsed("\n".join(lines.values()), "The mounting")
    got = {key: new.get("camera", {}).pop(key, None) for key in _KEYS}
    for key in _KEYS:
        old.setdefault("camera", {}).pop(key, None)
    return got == wanted and old == new

"""Base types of all settings: frozen, unknown keys refused; numbers finite and in range; paths usable."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import PydanticCustomError

from bus.transforms import unit_wxyz


def is_unicode(text: str) -> bool:
    """Whether ``text`` is valid Unicode: argument bytes that are not UTF-8 arrive as lone surrogates."""
    return not any("\ud800" <= letter <= "\udfff" for letter in text)


def _unit(wxyz: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """Check the quaternion's length but keep its digits, so that the station keeps its hash.

    `bus.transforms.from_wxyz` normalises it.
    """
    unit_wxyz(wxyz)
    return wxyz


def _not_true_or_false(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("must be a number, or a word in quotes")
    return value


def _not_empty(path: Any) -> Any:
    if path == "":
        raise ValueError("leave a path out instead of giving it empty")
    return path


def _usable(path: Path) -> Path:
    """Return the path with ``~`` and ``~user`` expanded. Raises: ValueError for NUL, non-Unicode or an unknown user."""
    if "\0" in str(path) or not is_unicode(str(path)):
        raise ValueError("a path is Unicode text without NUL")
    try:
        return path.expanduser()
    except RuntimeError as error:
        raise ValueError(f"there is no home folder {path.parts[0]!r} here") from error


def _usable_or_name(text: str) -> str:
    return str(_usable(Path(text))) if text.startswith("~") else text


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Seconds = Annotated[float, Field(gt=0, le=86_400, allow_inf_nan=False)]
Metres = Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False)]
"""A coordinate [m]. Nothing around an arm is farther: a value of 450 means millimetres."""
Size = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]
"""A length [m]."""
SizeOrNone = Annotated[float, Field(ge=0, le=10, allow_inf_nan=False)]
JawSize = Annotated[float, Field(gt=0, le=0.5, allow_inf_nan=False)]
"""A length [m] of a hand, or of what fits into one. No jaw opens half a metre: a value of 80 means millimetres."""
JawSizeOrNone = Annotated[float, Field(ge=0, le=0.5, allow_inf_nan=False)]
Vector = tuple[Metres, Metres, Metres]
JointVector = Annotated[tuple[Finite, ...], Field(min_length=6, max_length=7)]
"""One number a joint: seven of the FR3, six of another arm."""
UnitQuaternion = Annotated[tuple[Finite, Finite, Finite, Finite], AfterValidator(_unit)]
"""A rotation as a quaternion w, x, y, z."""
Chunk = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$")]
Address = Annotated[str, Field(min_length=1)]
SystemPath = Annotated[Path, BeforeValidator(_not_empty), AfterValidator(_usable)]
"""Path of a file or folder; ``~`` is expanded."""
NoBoolean = BeforeValidator(_not_true_or_false)
"""Of a choice between numbers, for Python takes true for 1."""
FolderOrName = Annotated[str, Field(min_length=1), AfterValidator(_usable_or_name)]


UNSHOWN: Final = "unshown"
"""Type of a validation error whose input may be a secret: no message shows it."""


TOGETHER: Final = "together"
"""Type of a validation error of several settings together."""


def wrong(setting: str, why: str) -> PydanticCustomError:
    """Return the error of several settings of a table that do not go together.

    Args:
        setting: the one to look at first, by its name inside of the table, e.g. ``arm.speed``.
        why: what is wrong, as the rest of a sentence that begins with its name.
    """
    return PydanticCustomError(TOGETHER, "{why}", {"setting": setting, "why": why})


def _with_strict_scalars(schema: Any) -> Any:
    """Make every number and boolean of a schema strict; the `strict` of pydantic would refuse lists and paths, too."""
    if isinstance(schema, dict):
        inner = {key: _with_strict_scalars(value) for key, value in schema.items()}
        return inner | {"strict": True} if schema.get("type") in ("bool", "int", "float") else inner
    return type(schema)(map(_with_strict_scalars, schema)) if type(schema) in (list, tuple) else schema


class Settings(BaseModel):
    """Base of all settings: frozen, unknown keys refused, a value of another kind refused.

    A number in quotes is no number, and true is none either; a whole number stands for one with decimals. Lists, paths
    and words are taken as TOML and JSON have them.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        return _with_strict_scalars(handler(source))

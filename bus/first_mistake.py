"""Says the first mistake that pydantic finds in a message, a setting or an argument, as part of a sentence."""

from __future__ import annotations

from pydantic import ValidationError
from pydantic_core import ErrorDetails


def first_mistake(error: ValidationError, *, inside: str = "", whole: str = "") -> str:
    """Return the first field that does not fit and why, as ``job.target.box: ...``, without a full stop.

    Args:
        inside: what the field's name begins with, e.g. ``job``.
        whole: the name of a mistake that is of no field in particular; "" = it is said without a name.
    """
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    name = ".".join(filter(None, (inside, field_name(first)))) or whole
    return f"{name}: {reason(first)}" if name else reason(first)


def field_name(mistake: ErrorDetails) -> str:
    """Return the full name of the field, as ``target.box.3``; "" where it is no field's mistake."""
    return ".".join(str(part) for part in mistake["loc"])


def reason(mistake: ErrorDetails) -> str:
    """Return what is wrong, as pydantic or one of our own checks says it, without a full stop."""
    return mistake["msg"].removeprefix("Value error, ")

"""Settings written as TOML."""

from __future__ import annotations

import json
import re
from enum import Enum
from pathlib import Path
from typing import Any

from pydantic import BaseModel


def toml_value(value: Any) -> str:
    """A value of a setting as a station file has it. None, which TOML lacks, is ``none``."""
    if value is None:
        return "none"
    if isinstance(value, BaseModel):
        value = {name: one for name, one in value if one is not None}
    if isinstance(value, dict):
        inside = ", ".join(f"{_key(name)} = {toml_value(one)}" for name, one in value.items())
        return f"{{ {inside} }}" if inside else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml_value(one) for one in value)}]"
    return json.dumps(str(value) if isinstance(value, Enum | Path) else value, ensure_ascii=False)


def _key(name: object) -> str:
    return str(name) if re.fullmatch(r"[\w-]+", str(name), re.ASCII) else json.dumps(str(name), ensure_ascii=False)

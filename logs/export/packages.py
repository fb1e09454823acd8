"""The packages of the extra ``vlad-cell[export]``; imported when they are needed, and named where they are missing."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from bus.errors import ConfigError
from bus.lazy import LazyModule

if TYPE_CHECKING:
    av: Any
    pyarrow: Any
    parquet: Any
else:
    av = LazyModule("av")
    pyarrow = LazyModule("pyarrow")
    parquet = LazyModule("pyarrow.parquet")


def require(*names: str) -> None:
    """Check that the packages are installed. Raises: ConfigError, which names the missing one and its extra."""
    for name in names:
        try:
            import_module(name)
        except ImportError as error:
            raise ConfigError(
                f"This export needs the package {name}.", "Install it: uv pip install 'vlad-cell[export]'."
            ) from error


def column_type(kind: str) -> Any:
    """A type of Arrow by its name: double, string, int64, bool, or ``list<...>`` of one."""
    if kind.startswith("list<"):
        return pyarrow.list_(column_type(kind[5:-1]))
    named = {"double": pyarrow.float64, "string": pyarrow.string, "int64": pyarrow.int64, "bool": pyarrow.bool_}
    return named[kind]()

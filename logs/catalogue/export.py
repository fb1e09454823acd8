"""Writes the answer to a query as CSV or Parquet."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bus.atomic import written_atomically
from bus.errors import CatalogueError, ConfigError
from bus.lazy import LazyModule
from logs.catalogue.ask import Answer

if TYPE_CHECKING:
    pyarrow: Any
    parquet: Any
else:
    pyarrow = LazyModule("pyarrow")
    parquet = LazyModule("pyarrow.parquet")


def csv_lines(answer: Answer) -> Iterator[str]:
    """Yield the answer as CSV, line by line, the names of its columns first."""
    for row in (answer.columns, *answer.rows):
        line = io.StringIO()
        csv.writer(line, lineterminator="").writerow(row)
        yield line.getvalue()


def write_parquet(answer: Answer, path: Path) -> None:
    """Write the answer as Parquet.

    Raises: ConfigError without pyarrow, or for two columns of one name; CatalogueError when it cannot be written.
    """
    require_pyarrow()
    if len(set(answer.columns)) < len(answer.columns):
        raise ConfigError("Parquet needs a name of its own for every column.", "Name them with AS.")
    columns = zip(*answer.rows, strict=True) if answer.rows else [()] * len(answer.columns)
    made = pyarrow.table([_array(column) for column in columns], names=list(answer.columns))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_atomically(path) as file:
            parquet.write_table(made, file, compression="zstd")
    except OSError as error:
        raise CatalogueError(f"{path} cannot be written: {error.strerror or error}.", "Name another file.") from error


def require_pyarrow() -> None:
    """Raises: ConfigError without pyarrow."""
    try:
        _ = pyarrow.table
    except ImportError as error:
        raise ConfigError(
            "Parquet needs the package pyarrow.", "Install it: uv pip install 'vlad-cell[export]'."
        ) from error


def _array(values: Sequence[Any]) -> Any:
    """A column; of several types, as texts."""
    with suppress(pyarrow.ArrowInvalid, pyarrow.ArrowTypeError):
        return pyarrow.array(values)
    return pyarrow.array([None if value is None else str(value) for value in values])

"""``cell``: see ``cell --help``. Exits: 0 done, 1 robot failed, 2 usage or config, 3 refused, 4 unreachable."""

from __future__ import annotations

import logging
import sys

import typer

from bus.errors import CellError
from cell import LOG_FORMAT
from cell.commands import command_line
from cell.options import print_json


def main() -> None:
    """Entry point: every known error becomes one clear line and its exit code, never a traceback."""
    logging.basicConfig(level=logging.WARNING, format=LOG_FORMAT)
    try:
        command_line(*sys.argv[1:2])()
    except CellError as error:
        if "--json" in sys.argv:
            print_json(
                {
                    "ok": False,
                    "code": error.code,
                    "reason": error.text,
                    "advice": error.advice,
                    "available": list(getattr(error, "available", ())),
                }
            )
        typer.echo(f"{error.code}: {error}", err=True)
        sys.exit(error.exit_code)


if __name__ == "__main__":
    main()

"""Carries out the command of this process; see ``cell --help``.

Exits: 0 done, 1 robot failed, 2 usage or config, 3 refused, 4 unreachable, 5 a defect of this program.
"""

from __future__ import annotations

import errno
import logging
import os
import sys
from contextlib import suppress
from typing import NoReturn

import typer

from bus.errors import CellError, ConfigError
from cell.cli.commands import command_line
from cell.installation import not_installed
from cell.terminal.printing import err, log_plainly, out

_log = logging.getLogger("cell")
_NOBODY_READS = (errno.EPIPE, errno.EIO)
"""The pipe (`| head`) or the terminal was closed: not an error."""
_USAGE, _DEFECT = 2, 5


def run() -> None:
    """Entry point: carry out the command of this process, and end at once.

    A native thread (Zenoh, MuJoCo) that entered Python while the interpreter shuts down would abort the process.
    """
    try:
        main()
    except SystemExit as end:
        code = int(end.code or 0)
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # nobody reads it any more, or it is closed
            stream.flush()
    os._exit(code)


def main() -> NoReturn:
    """Carry out the command of this process, and exit.

    Every error becomes one clear line and its exit code; only a defect gets a traceback, in the log.
    """
    log_plainly()
    code = _carry_out()
    if out.lost is not None and code == 0 and getattr(out.lost, "errno", None) not in _NOBODY_READS:
        err.line(f"OUTPUT: Cannot write the output: {out.lost}.")
        code = _USAGE
    sys.exit(code)


def _carry_out() -> int:
    """Run the command of this process; return its exit code."""
    try:
        _require_a_folder()
        return int(typer.main.get_command(command_line()).main(prog_name="cell", standalone_mode=False) or 0)
    except CellError as error:
        return _fail(error)
    except typer.TyperException as error:
        return _usage(error)
    except OSError as error:
        return _defect(error) if error.filename is None else _fail(_of_file(error))
    except ImportError as error:
        return _fail(_Installation(problem)) if (problem := not_installed(error)) else _defect(error)
    except Exception as error:  # noqa: BLE001 - the last handler: any other error is reported as a defect
        return _defect(error)


def _require_a_folder() -> None:
    try:
        os.getcwd()
    except FileNotFoundError as error:
        raise ConfigError("The folder that you are in does not exist any more.", "Go to another: cd DIR.") from error


def _fail(error: CellError) -> int:
    if "--json" in sys.argv:
        available = list(getattr(error, "available", ()))
        out.json(
            {"ok": False, "code": error.code, "reason": error.text, "advice": error.advice, "available": available}
        )
    err.line(f"{error.code}: {error}")
    return error.exit_code


def _usage(error: typer.TyperException) -> int:
    """Report a rejected option or argument; show the help when there were no arguments."""
    text = error.format_message() if hasattr(error, "format_message") else str(error)
    text = text.replace(": Value error, ", ": ")  # pydantic's own words, which say nothing
    if type(error).__name__ == "NoArgsIsHelpError":
        for line in text.splitlines():
            out.line(line)
        return _USAGE
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "cell"
    return _fail(_Usage(text if text.endswith((".", "?")) else f"{text}.", f"See `{command} --help`."))


class _Usage(ConfigError):
    code = "USAGE"


class _Installation(ConfigError):
    code = "INSTALLATION"


def _of_file(error: OSError) -> ConfigError:
    """The ConfigError for an operating system error of a given file."""
    return ConfigError(f"{error.filename}: {error.strerror or error}.", "Name another, or see to its rights.")


def _defect(error: Exception) -> int:
    _log.error("unforeseen", exc_info=error)
    err.line(
        f"DEFECT: {type(error).__name__}: {error}. This is a defect of `cell`, not of what you did;"
        " please report it with the traceback above, which is also in the log of a service."
    )
    return _DEFECT

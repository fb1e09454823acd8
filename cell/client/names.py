"""Names of clients: who holds a lease is shown by them."""

from __future__ import annotations

import itertools
import os
import re
import socket

from cell.terminal.user import user_name

_NOT_IN_A_NAME = re.compile(r"[^A-Za-z0-9._-]")
_numbers = itertools.count(1)


def client_name(what: str) -> str:
    """A client id that identifies its owner: program, user, machine and process, ``watch-ann-lab2-4711``.

    At most 100 characters, letters, digits, ``.``, ``_`` and ``-``; unique in this process.
    """
    parts = (what, user_name(), socket.gethostname().partition(".")[0])
    name = "-".join(_NOT_IN_A_NAME.sub("_", part)[:24] for part in parts)
    number = next(_numbers)
    return f"{name}-{os.getpid()}" + (f"-{number}" if number > 1 else "")

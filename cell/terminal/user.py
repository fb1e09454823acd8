"""The person at this terminal."""

from __future__ import annotations

import getpass
import os


def user_name() -> str:
    """Return the name of the user of this process; the number where it has no name, as in containers."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return str(os.getuid())

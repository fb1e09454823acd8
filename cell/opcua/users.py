"""The users who may connect: those of a file, by name and password; on loopback without one, everybody."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.user_managers import UserManager

from cell.opcua.passwords import fits, read_users


@dataclass
class Person(User):  # type: ignore[misc]
    """A user of this server. ``may_command``: an operator; a viewer may only look, and bring the cell to rest."""

    may_command: bool = False


ANYBODY = Person(UserRole.User, "", may_command=True)
"""On loopback, every program of this machine may command the cell, as on the bus."""


class Users(UserManager):  # type: ignore[misc]
    """The users of a file; without one, everybody is `ANYBODY`. Raises: ConfigError for a file that is not one."""

    def __init__(self, file: Path | None) -> None:
        self._hashes = read_users(file) if file is not None else None

    @property
    def are_named(self) -> bool:
        """Whether a client needs a name and a password."""
        return self._hashes is not None

    def get_user(
        self, iserver: Any, username: str | None = None, password: str | None = None, certificate: Any = None
    ) -> Person | None:
        """Return the user, None for a wrong name or password; called by asyncua."""
        if self._hashes is None:
            return ANYBODY
        role, expected = self._hashes.get(username or "", ("", ""))
        if not fits(password or "", expected):
            return None
        return Person(UserRole.User, username, may_command=role == "operator")

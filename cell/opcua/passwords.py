"""The file of OPC UA users: a line each, name, role, and the hash of a random password."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from pathlib import Path

from bus.errors import ConfigError
from bus.secrets import require_private

ROLES = ("operator", "viewer")
_FORM = "A line a user: NAME ROLE HASH, the role viewer or operator; `cell opcua --user NAME` makes such lines."


def new_user(name: str, role: str) -> tuple[str, str]:
    """A random password, and the line for the file of users, which does not hold it.

    The password has 160 random bits, so that a plain hash of it tells nothing.
    """
    password = secrets.token_urlsafe(20)
    return password, f"{name} {role} {_hash(password)}"


def fits(password: str, hashed: str) -> bool:
    """Whether this is the password of a line; it takes as long for every wrong one."""
    return hmac.compare_digest(_hash(password), hashed)


def read_users(file: Path) -> dict[str, tuple[str, str]]:
    """Name -> role and hash. Raises: ConfigError, whose text shows no line."""
    require_private(file, "file of OPC UA users")
    try:
        lines = [line.split() for line in file.read_text(encoding="utf-8").splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"Cannot read the file of OPC UA users {file}: {error}.") from error
    users: dict[str, tuple[str, str]] = {}
    for number, parts in enumerate(lines, 1):
        if not parts or parts[0].startswith("#"):
            continue
        if len(parts) != 3 or parts[1] not in ROLES or len(parts[2]) != 64:
            raise ConfigError(f"Line {number} of the OPC UA users {file} is none.", _FORM)
        users[parts[0]] = (parts[1], parts[2].lower())
    if not users:
        raise ConfigError(f"The file of OPC UA users {file} names nobody.", _FORM)
    return users


def _hash(password: str) -> str:
    return hashlib.sha256(password.encode("utf-8", "surrogatepass")).hexdigest()

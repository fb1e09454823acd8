"""Removes secrets from foreign texts: a reply of a server, a library or a proxy may contain the key it was given.

Code that reads a secret registers it once with `keep_secret`. Every foreign text that leaves this process (failures,
replies, logs) passes `redacted` or `quoted`.
"""

from __future__ import annotations

import base64
import html
import json
import re
import threading
from urllib.parse import quote, quote_plus, unquote

HIDDEN = "(secret)"
_MIN_LENGTH = 8
"""Shorter keys ("none", "x") are placeholders for a local server: no secrets, and common in any text."""

_known: dict[str, re.Pattern[str]] = {}
_changing = threading.Lock()


def keep_secret(secret: str) -> None:
    """Register ``secret``: from now on `redacted` hides it in every spelling."""
    if len(secret) < _MIN_LENGTH:
        return
    forms = sorted(_forms(secret), key=len, reverse=True)
    pattern = re.compile("|".join(re.escape(form) for form in forms), re.IGNORECASE)
    with _changing:
        _known[secret] = pattern


def keep_secrets_of(url: str) -> None:
    """Register the password of an address, alone and together with the user as a proxy receives them."""
    authority = url.rpartition("//")[2].partition("/")[0]
    user, _, password = (unquote(part) for part in authority.rpartition("@")[0].partition(":"))
    keep_secret(password)
    if user and password:
        keep_secret(f"{user}:{password}")
        keep_secret(base64.b64encode(f"{user}:{password}".encode()).decode())


def redacted(text: str) -> str:
    """Return ``text`` with every registered secret replaced."""
    with _changing:
        longest_first = sorted(_known, key=len, reverse=True)  # one may be a part of another
        patterns = [_known[secret] for secret in longest_first]
    for pattern in patterns:
        text = pattern.sub(HIDDEN, text)
    return text


def quoted(text: str, limit: int = 200) -> str:
    """Return a foreign text for use in a message: without secrets, one printable line, ``limit`` characters at most."""
    line = " ".join("".join(sign if sign.isprintable() else " " for sign in redacted(text)).split())
    return line if len(line) <= limit else line[:limit].rstrip() + " ..."


def raised(error: BaseException) -> str:
    """Return what foreign code raised, for use in a message: its type and text, without a full stop at the end."""
    text = quoted(str(error)).rstrip(".")
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def holds_secret(data: bytes) -> bool:
    """Whether a registered secret stands in ``data``, e.g. in a picture's comment."""
    with _changing:
        secrets = list(_known)
    return any(secret.encode() in data for secret in secrets)


def _forms(secret: str) -> set[str]:
    """Return the spellings of the secret in JSON, in an address, in HTML, in Python's repr and in a header."""
    in_json, in_python = json.dumps(secret)[1:-1], secret.replace("\\", "\\\\")
    escaped = {in_json, in_json.replace("/", "\\/"), in_python, in_python.replace("'", "\\'")}
    in_address = {quote(secret), quote(secret, safe=""), quote_plus(secret)}
    return {secret, *escaped, *in_address, html.escape(secret), base64.b64encode(secret.encode()).decode()}

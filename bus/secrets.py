"""Files that hold a secret: readable only by their owner (and group), and outside every git work tree."""

from __future__ import annotations

import stat
from pathlib import Path

from bus.errors import ConfigError

_PROJECT = Path(__file__).resolve().parent.parent


def require_private(path: Path, what: str) -> None:
    """Raises: ConfigError when others may read ``path``, or when it lies in the project or a git work tree.

    Args:
        what: name of the file's purpose, for the error text.
    """
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise ConfigError(f"Cannot read the {what} {path}: {error.strerror}.") from error
    if mode & stat.S_IRWXO:
        raise ConfigError(f"Everybody on this machine can read the {what} {path}.", f"chmod o= {path}")
    require_outside(path, what)


def require_outside(path: Path, what: str) -> None:
    """Raises: ConfigError when ``path`` lies in the project folder or a git work tree.

    Args:
        what: name of the file's purpose, for the error text.
    """
    for folder in path.resolve().parents:
        if folder == _PROJECT or (folder / ".git").exists():
            raise ConfigError(
                f"The {what} {path} lies in {folder}, from where it would be committed or copied.",
                "Keep it in a folder of its own, e.g. ~/.config/vlad-cell.",
            )


def read_secret(path: Path, what: str) -> str:
    """Return the one line of a private file. Raises: ConfigError, whose text never contains the secret."""
    require_private(path, what)
    try:
        secret = path.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError):
        secret = ""
    return checked_secret(secret, f"The {what} {path}")


def checked_secret(text: str, where: str) -> str:
    """Return ``text`` stripped of surrounding white space, checked to fit into an HTTP header.

    Args:
        where: the text's source, with its article, to begin an error's sentence.

    Raises:
        ConfigError: the text never contains the secret.
    """
    secret = text.strip()
    if not secret or not all("!" <= sign <= "~" for sign in secret):
        raise ConfigError(
            f"{where} does not hold one line of printable text.",
            "A key is one line of plain ASCII: no blanks or line breaks inside, no typographic quotes, no BOM.",
        )
    if secret[0] in "'\"`":
        raise ConfigError(f"{where} holds quotation marks as a part of the key.", "Write the key without them.")
    return secret

"""Access over HTTP: two roles, each with a token; on loopback without tokens everybody is the operator."""

from __future__ import annotations

import hmac
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from bus.errors import ConfigError, Refused
from bus.secrets import checked_secret, require_private
from cell.machine.states import ENDING
from config.http import HttpSettings
from config.toml_file import parsed, read_text

VARIABLES = {"operator": "VLAD_CELL_HTTP_OPERATOR", "viewer": "VLAD_CELL_HTTP_VIEWER"}
_SHORTEST = 16
_HELP = "docs/security.md says how to make them."


class HttpRole(StrEnum):
    """The rights of a client."""

    VIEWER = "viewer"
    """Look, and bring motion to rest."""
    OPERATOR = "operator"
    """Everything."""

    def may(self, verb: str) -> bool:
        """Whether this role may send the command ``verb``."""
        return self is HttpRole.OPERATOR or verb in ENDING


def require_right(role: HttpRole, verb: str) -> None:
    """Raises: Refused (NO_RIGHT) when ``role`` may not send the command ``verb``."""
    if not role.may(verb):
        raise Refused(
            f"A {role} may look, and bring motion to rest; not {verb!r}.", "Use an operator's token.", code="NO_RIGHT"
        )


@dataclass(frozen=True)
class Access:
    """The tokens of each role; without any, everybody is the operator."""

    tokens: Mapping[HttpRole, str]

    @classmethod
    def of(cls, settings: HttpSettings, environ: Mapping[str, str]) -> Access:
        """Read the tokens, and check that what is configured is safe.

        Raises: ConfigError beyond loopback without an operator's token, or for a bad token, certificate or key.
        """
        tokens = _from_file(settings.tokens) if settings.tokens is not None else _from(environ)
        if not settings.is_loopback and HttpRole.OPERATOR not in tokens:
            raise ConfigError(
                f"http.host = {settings.host} is beyond loopback, and there is no operator's token: anybody in the"
                " network could move the arm.",
                f"Name a file (http.tokens), or set {VARIABLES['operator']}; {_HELP}",
            )
        if settings.certificate is not None and settings.key is not None:
            _require_pair(settings.certificate, settings.key)
        return cls(tokens)

    def role_of(self, token: str) -> HttpRole | None:
        """Return the role of who sends ``token`` ("" for none); None when it has none."""
        if not self.tokens:
            return HttpRole.OPERATOR
        for role, known in self.tokens.items():
            if hmac.compare_digest(known.encode(), token.encode(errors="replace")):
                return role
        return None


def _from_file(file: Path) -> dict[HttpRole, str]:
    require_private(file, "token file")
    tree = parsed(read_text(file), "the token file")
    unknown = sorted(set(tree) - set(HttpRole))
    if unknown or not all(isinstance(token, str) for token in tree.values()):
        raise ConfigError(f'The token file {file} holds other things than operator = "..." and viewer = "...".', _HELP)
    return _checked({name: (str(token), f"{name} in the token file") for name, token in tree.items()})


def _from(environ: Mapping[str, str]) -> dict[HttpRole, str]:
    given = {name: environ[variable] for name, variable in VARIABLES.items() if environ.get(variable)}
    return _checked({name: (token, f"The environment variable {VARIABLES[name]}") for name, token in given.items()})


def _checked(found: Mapping[str, tuple[str, str]]) -> dict[HttpRole, str]:
    tokens = {HttpRole(name): checked_secret(token, where) for name, (token, where) in found.items()}
    if any(len(token) < _SHORTEST for token in tokens.values()):
        raise ConfigError(f"A token of the HTTP interface has fewer than {_SHORTEST} characters.", _HELP)
    if len(set(tokens.values())) != len(tokens):
        raise ConfigError("Operator and viewer have the same token.", _HELP)
    if tokens and HttpRole.OPERATOR not in tokens:
        raise ConfigError("There is a viewer's token, and none of an operator: nobody could command.", _HELP)
    return tokens


def _require_pair(certificate: Path, key: Path) -> None:
    require_private(key, "TLS key")
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key)
    except OSError as error:  # ssl.SSLError is one
        raise ConfigError(f"The certificate {certificate} and its key cannot be used: {error}.", _HELP) from error

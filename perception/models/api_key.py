"""Reads the API key of a hosted model: from a private file, or from the environment."""

from __future__ import annotations

from collections.abc import Mapping
from urllib.parse import unquote

from bus.errors import ConfigError
from bus.redaction import keep_secret, redacted
from bus.secrets import checked_secret, read_secret
from config.perception import HostedSettings
from config.schema import Station


def key_of(station: Station, variable: str, environ: Mapping[str, str]) -> str:
    """Return the hosted model's key: the configured file's, else the environment's. It is registered for redaction.

    Raises: ConfigError, never with the key, when there is no key, it does not fit a header, or a setting contains it.
    """
    key = _found_key(station.perception.model, station.perception.hosted, variable, environ)
    keep_secret(key)
    hosted = station.perception.hosted
    for name in ("base_url", "text_model", "image_model"):
        if redacted(value := unquote(getattr(hosted, name) or "")) != value:
            raise ConfigError(
                f"The model's key stands in perception.hosted.{name}, which every recording holds.",
                "Take it out; the key's place is the environment, or a key file.",
            )
    return key


def _found_key(name: str, settings: HostedSettings, variable: str, environ: Mapping[str, str]) -> str:
    if settings.key_file is not None:
        return read_secret(settings.key_file, "key file")
    variable = settings.key_variable or variable
    if not environ.get(variable, "").strip():
        raise ConfigError(
            f"The model {name!r} needs a key in the environment variable {variable}.",
            f"export {variable}=...; a server of your own takes any text. Or name a file: perception.hosted.key_file. "
            "Or use the embedded model: --set perception.model=geometric.",
        )
    return checked_secret(environ[variable], f"The environment variable {variable}")

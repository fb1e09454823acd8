"""Settings of the cell's OPC UA interface (docs/opcua.md)."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import urlsplit

from pydantic import Field, field_validator, model_validator

from config.base import Settings, SystemPath

_FORM = "opc.tcp://ADDRESS:PORT/PATH, like opc.tcp://127.0.0.1:4840/cell"
_LOOPBACK = ("127.0.0.1", "::1", "localhost")


class OpcuaSettings(Settings):
    """The cell over OPC UA: on loopback; beyond it, with certificates on both sides and users.

    Attributes:
        enabled: `cell start` opens it; otherwise only `cell start --opcua` and `cell opcua` do.
        endpoint: where it listens, e.g. ``opc.tcp://127.0.0.1:4840/cell``.
        certificate, key: PEM files of this server, relative to the station file; with them every connection is signed
            and encrypted.
        trusted: folder of the certificates (PEM, ``.pem``) of clients that may connect, or of their authority.
        users: file of the users, a line each, ``NAME ROLE HASH`` (``cell opcua --user NAME`` writes such lines).
            Without it, on loopback only, every client is an operator.
        session_timeout_s: a client that sends nothing for so long is gone: its session closes, and the cell holds what
            it commanded. A client that asks for less, 1 s at least, gets that.
    """

    enabled: bool = False
    endpoint: str = "opc.tcp://127.0.0.1:4840/cell"
    certificate: SystemPath | None = None
    key: SystemPath | None = None
    trusted: SystemPath | None = None
    users: SystemPath | None = None
    session_timeout_s: Annotated[float, Field(ge=1, le=600)] = 5.0

    @field_validator("endpoint")
    @classmethod
    def _an_endpoint(cls, endpoint: str) -> str:
        parts = urlsplit(endpoint)
        try:
            port = parts.port
        except ValueError as error:
            raise ValueError(f"an endpoint is {_FORM}") from error
        if parts.scheme != "opc.tcp" or not parts.hostname or not port:
            raise ValueError(f"an endpoint is {_FORM}")
        return endpoint

    @model_validator(mode="after")
    def _safe(self) -> OpcuaSettings:
        tls = {"certificate": self.certificate, "key": self.key, "trusted": self.trusted}
        missing = [f"opcua.{name}" for name, value in tls.items() if value is None]
        if len(missing) not in (0, len(tls)):
            raise ValueError(f"certificate, key and trusted go together; there is no {', '.join(missing)}")
        if not self.is_loopback and (missing or self.users is None):
            missing += ["opcua.users"] if self.users is None else []
            raise ValueError(
                f"{self.endpoint} is beyond loopback: anybody in the network could move the arm. It needs "
                f"{', '.join(missing)}: docs/opcua.md"
            )
        return self

    @property
    def is_loopback(self) -> bool:
        """Whether only programs of this machine can reach it."""
        return urlsplit(self.endpoint).hostname in _LOOPBACK

    @property
    def is_encrypted(self) -> bool:
        """Whether connections are signed and encrypted, and clients need a trusted certificate."""
        return self.certificate is not None

"""Settings of the cell's HTTP interface (docs/http.md)."""

from __future__ import annotations

import ipaddress
from typing import Annotated

from pydantic import Field, field_validator, model_validator

from config.base import Address, Seconds, Settings, SystemPath


class HttpSettings(Settings):
    """The cell over HTTP: on loopback; beyond it, with TLS and tokens.

    The tokens are in a file, or in the environment (VLAD_CELL_HTTP_OPERATOR, VLAD_CELL_HTTP_VIEWER): docs/security.md.

    Attributes:
        enabled: `cell start` opens it; otherwise only `cell start --http` and `cell http` do.
        host: the address where it listens; ``0.0.0.0`` = every one of this machine.
        port: 0 = any free one.
        names: further names or addresses by which clients call this machine; a request to any other is refused.
        certificate, key: PEM files of TLS, relative to the station file; needed beyond loopback.
        tokens: a TOML file with ``operator`` and ``viewer``, relative to the station file, readable by its owner only.
        silence_s: a client that holds the lease, and sends nothing for so long, loses it, and the cell holds.
        picture_s: while the cell rests or is held, and somebody listens to its events, a new picture is taken so often;
            0 = never.
        most_streams: the most event streams and waiting picks at a time.
    """

    enabled: bool = False
    host: Address = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8088
    names: tuple[Address, ...] = ()
    certificate: SystemPath | None = None
    key: SystemPath | None = None
    tokens: SystemPath | None = None
    silence_s: Seconds = 3.0
    picture_s: Annotated[float, Field(ge=0, le=60, allow_inf_nan=False)] = 1.0
    most_streams: Annotated[int, Field(ge=1, le=10_000)] = 64

    @field_validator("host")
    @classmethod
    def _an_address(cls, host: str) -> str:
        try:
            ipaddress.ip_address(host.strip("[]"))
        except ValueError as error:
            raise ValueError("an IP address of this machine, like 127.0.0.1, ::1 or 0.0.0.0") from error
        return host.strip("[]")

    @model_validator(mode="after")
    def _certificate_with_key(self) -> HttpSettings:
        if (self.certificate is None) is not (self.key is None):
            raise ValueError("certificate and key go together")
        if self.certificate is None and not self.is_loopback:
            raise ValueError(f"{self.host} is beyond loopback and needs TLS: http.certificate and http.key")
        return self

    @property
    def is_loopback(self) -> bool:
        """Whether only programs of this machine can reach it."""
        return ipaddress.ip_address(self.host).is_loopback

"""The form of a bus endpoint: ``tcp/127.0.0.1:7447``, ``tls/cell.lab:7448``, ``tls/[fe80::1]:7448``."""

from __future__ import annotations

import ipaddress
import re

_ENDPOINT = re.compile(r"(tcp|tls|quic)/(\[(?P<v6>[^\[\]/]+)\]|(?P<host>[A-Za-z0-9._-]+)):(?P<port>\d{1,5})", re.ASCII)
_FORM = "PROTOCOL/ADDRESS:PORT, like tcp/127.0.0.1:7447 or tls/192.168.1.10:7448"


def require_endpoint(endpoint: str) -> None:
    """Raises: ValueError unless ``endpoint`` names a protocol, a possible address, and a port."""
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None:
        raise ValueError(f"an endpoint is {_FORM}")
    if not 1 <= int(found["port"]) <= 65535:
        raise ValueError(f"port {int(found['port'])} is none: ports are 1 to 65535")
    address = found["v6"] or (found["host"] if re.fullmatch(r"[\d.]+", found["host"]) else None)
    if address is not None:
        try:
            ipaddress.ip_address(address)
        except ValueError as error:
            raise ValueError(f"{address!r} is no IP address; an endpoint is {_FORM}") from error

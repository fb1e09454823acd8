"""Rules for opening a session: loopback needs nothing; beyond it TLS, certificates and access control are required.

A client on the bus can move the arm, so a file alone is not trusted: the *parsed* configuration is checked, and our
own rules override it.
"""

from __future__ import annotations

import json
import re
import ssl
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import zenoh

from bus.errors import ConfigError
from bus.secrets import require_private

LEASE_MS = 1000
"""A frozen or unplugged peer is noticed after this time [ms]."""
MAX_PAYLOAD_BYTES = 64 * 1024 * 1024
_MAX_MESSAGE_BYTES = MAX_PAYLOAD_BYTES + 1024 * 1024
_LOOPBACK = re.compile(r"tcp/(127\.0\.0\.1|\[::1\]|localhost):\d{1,5}")
_ENCRYPTED = re.compile(r"(tls|quic)/.+:\d{1,5}")
_HELP = "`cell keys FOLDER` writes certificates and files that do; see docs/security.md."
_OUR_RULES: dict[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/link/tx/lease": LEASE_MS,
    "transport/link/rx/max_message_size": _MAX_MESSAGE_BYTES,
    # connections that are opened and stay silent must not keep real clients out
    "transport/unicast/accept_timeout": 1000,
    "transport/unicast/accept_pending": 4096,
    "transport/unicast/max_sessions": 4096,
    # shared memory loses queries when the machine is busy, and dead nodes leave their segments open
    "transport/shared_memory/enabled": False,
    "adminspace/enabled": False,
}
_STARVED_MS = 60_000
_STARVED_RULES: dict[str, Any] = {
    # Zenoh counts wall time, so it must not disconnect a process that is only starved. The connection of a dead process
    # ends at once all the same, and `cell.nodes.health` finds a frozen one.
    "transport/link/tx/lease": _STARVED_MS,
    "transport/unicast/accept_timeout": _STARVED_MS,
    "transport/unicast/open_timeout": 15_000,  # a program that is no cell may hold the port, and never answer
    "transport/link/tx/queue/congestion_control/block/wait_before_close": _STARVED_MS * 1000,
}
_HUB_RULES: dict[str, Any] = {
    # a frozen program whose link is full is disconnected; otherwise every session waits for it for 5 s
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,
}
_FILES = (
    "root_ca_certificate",
    "listen_certificate",
    "listen_private_key",
    "connect_certificate",
    "connect_private_key",
)


def is_loopback(endpoint: str) -> bool:
    """Whether only programs of this machine can reach ``endpoint``."""
    return _LOOPBACK.fullmatch(endpoint) is not None


def is_encrypted(endpoint: str) -> bool:
    """Whether traffic over ``endpoint`` is protected against reading and changing."""
    return _ENCRYPTED.fullmatch(endpoint) is not None


def needed_file(file: Path | None, endpoints: Iterable[str | None]) -> Path | None:
    """Return the Zenoh file where an endpoint is beyond loopback, else None.

    On loopback nobody needs it; it is read all the same, so that a wrong name shows on the day it is written, and not
    on the day the cell is to be reached. One that this user may not read stays unread there: it is the cell's own.

    Raises:
        ConfigError: it is not there, or is no Zenoh configuration.
    """
    if file is None or not all(is_loopback(one) for one in endpoints if one):
        return file
    try:
        _read(file)
    except ConfigError as refusal:
        if not isinstance(refusal.__cause__, PermissionError):
            raise
    return None


def session_config(
    mode: str,
    *,
    listen: Sequence[str] | None,
    connect: Sequence[str] | None,
    file: Path | None,
    is_slowed: bool = False,
) -> zenoh.Config:
    """Return the configuration of one session.

    Args:
        mode: of Zenoh: client, peer or router.
        listen, connect: endpoints that replace the file's; None = the file's.
        file: a Zenoh configuration (JSON5); paths in it are relative to its folder. None: loopback only.
        is_slowed: deadlines are not wall time (`bus.clock.DeadlineClock`).

    Raises:
        ConfigError: names everything that is missing for a safe session.
    """
    config = _read(file) if file is not None else zenoh.Config()
    rules = _OUR_RULES | (_STARVED_RULES if is_slowed else {}) | (_HUB_RULES if mode != "client" else {})
    for key, value in rules.items():
        config.insert_json5(key, json.dumps(value))
    config.insert_json5("mode", json.dumps(mode))
    for key, endpoints in (("listen/endpoints", listen), ("connect/endpoints", connect)):
        if endpoints is not None:
            config.insert_json5(key, json.dumps(list(endpoints)))
    _require_safe(config, file)
    return config


def _read(file: Path) -> zenoh.Config:
    """Read a Zenoh file and make its certificate paths absolute. Raises: ConfigError."""
    try:
        config = zenoh.Config.from_json5(file.read_text())
    except OSError as error:
        raise ConfigError(f"Cannot read the Zenoh file {file}: {error.strerror}.", _HELP) from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{file} is no Zenoh configuration: it is not UTF-8 text.", _HELP) from error
    except zenoh.ZError as error:
        raise ConfigError(f"{file} is no Zenoh configuration: {_first_line(error)}.", _HELP) from error
    for name in _FILES:
        path = _get(config, f"transport/link/tls/{name}")
        if path:
            config.insert_json5(f"transport/link/tls/{name}", json.dumps(str(file.absolute().parent / path)))
    return config


def _require_safe(config: zenoh.Config, file: Path | None) -> None:
    """Raises: ConfigError for an endpoint beyond loopback without encryption, certificates or access control."""
    listen = _away(config, "listen/endpoints")
    connect = _away(config, "connect/endpoints")
    plain = [endpoint for endpoint in (*listen, *connect) if not is_encrypted(endpoint)]
    if plain:
        raise ConfigError(
            f"{plain[0]} is neither loopback nor encrypted: anybody in the network could move the arm.",
            "Use tls/ADDRESS:PORT with a Zenoh file (bus.zenoh). " + _HELP,
        )
    if not listen and not connect:
        return
    if file is None:
        raise ConfigError(
            f"{(*listen, *connect)[0]} is beyond loopback, and no Zenoh file says who may do what there.",
            "Name one: bus.zenoh. " + _HELP,
        )
    missing = [*_missing_tls(config, bool(listen), bool(connect)), *(_missing_access(config) if listen else ())]
    if missing:
        raise ConfigError(f"{file} is not safe beyond loopback: {'; '.join(missing)}.", _HELP)
    _require_keys(config, file)


def _missing_tls(config: zenoh.Config, listens: bool, connects: bool) -> Iterator[str]:
    tls = _get(config, "transport/link/tls") or {}
    needed = ["root_ca_certificate"]
    needed += ["listen_certificate", "listen_private_key"] if listens else []
    needed += ["connect_certificate", "connect_private_key"] if connects else []
    yield from (f"transport.link.tls.{name} is not set" for name in needed if not tls.get(name))
    if listens and not tls.get("enable_mtls"):
        yield "transport.link.tls.enable_mtls is not true: it would let in clients without a certificate"
    if connects and tls.get("verify_name_on_connect") is False:
        yield "transport.link.tls.verify_name_on_connect is false: any certificate could pose as the cell"


def _missing_access(config: zenoh.Config) -> Iterator[str]:
    access = _get(config, "access_control") or {}
    if not access.get("enabled"):
        yield "access_control.enabled is not true"
    if access.get("default_permission") != "deny":
        yield 'access_control.default_permission is not "deny"'
    for subject in access.get("subjects") or ():
        who = [*(subject.get("cert_common_names") or ()), *(subject.get("usernames") or ())]
        if not who and subject.get("link_protocols") != ["tcp"]:
            yield f"the subject {subject['id']!r} of access_control names no certificate: it means everybody"
    if not access.get("policies"):
        yield "access_control.policies is empty: nobody could do anything"


def _require_keys(config: zenoh.Config, file: Path) -> None:
    """Raises: ConfigError unless every certificate can be read and its key matches and is private."""
    tls = _get(config, "transport/link/tls")
    try:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.load_verify_locations(tls["root_ca_certificate"])
        for kind in ("listen", "connect"):
            certificate, key = tls.get(f"{kind}_certificate"), tls.get(f"{kind}_private_key")
            if certificate and key:
                require_private(Path(key), "TLS key")
                context.load_cert_chain(certificate, key)
    except OSError as error:  # ssl.SSLError is one
        raise ConfigError(f"The certificates that {file} names cannot be used: {error}.", _HELP) from error


def _away(config: zenoh.Config, key: str) -> list[str]:
    """Return the endpoints beyond loopback under ``key``, of every mode."""
    value = _get(config, key) or []
    groups = value.values() if isinstance(value, dict) else [value]
    entries = [entry for group in groups for entry in (group if isinstance(group, list) else [group]) if entry]
    endpoints = [entry["endpoint"] if isinstance(entry, dict) else entry for entry in entries]
    return [endpoint for endpoint in endpoints if not is_loopback(endpoint)]


def _get(config: zenoh.Config, key: str) -> Any:
    return json.loads(config.get_json(key))


def _first_line(error: Exception) -> str:
    """Return Zenoh's error text without the file names of its build."""
    return re.split(r"\s+at /", str(error))[0].splitlines()[0].rstrip(".! ")

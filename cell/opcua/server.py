"""The OPC UA server: where it listens, with which certificates, for whom. Nothing is open that was not asked for."""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User
from asyncua.crypto.truststore import TrustStore
from asyncua.crypto.validator import CertificateValidator, CertificateValidatorOptions
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.uaprocessor import UaProcessor
from cryptography import x509

from bus.errors import ConfigError, PortOccupied
from bus.secrets import require_private
from cell.opcua.calls import Calls
from cell.opcua.sessions import CellProcessor, CellSession
from cell.opcua.users import ANYBODY, Users
from config.opcua import OpcuaSettings

_POLICIES = [
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
]
_CHECKS = (
    CertificateValidatorOptions.TIME_RANGE
    | CertificateValidatorOptions.URI
    | CertificateValidatorOptions.TRUSTED
    | CertificateValidatorOptions.PEER_CLIENT
)
_MOST_CONNECTIONS, _MOST_SUBSCRIPTIONS = 64, 256
_MAX_MESSAGE_BYTES, _CHUNK_BYTES = 1024 * 1024, 65535
_SHORTEST_TIMEOUT_MS = 1000.0
_ACTIVATION_S = 10.0
_HELP = "`cell keys FOLDER --opcua` makes certificates that fit: docs/opcua.md."


class _Protocol(OPCUAProtocol):  # type: ignore[misc]
    """A connection whose requests a `CellProcessor` answers."""

    processor: UaProcessor | None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if self.processor is not None:  # None: there are too many connections
            self.processor = CellProcessor(self.iserver, transport, self.limits)
            self.processor.set_policies(self.policies)


class _Listener(BinaryServer):  # type: ignore[misc]
    def _make_protocol(self) -> OPCUAProtocol:
        return _Protocol(self.iserver, self._policies, self.clients, self.closing_tasks, self.limits)


class _Internal(InternalServer):  # type: ignore[misc]
    """Makes `CellSession` of every client; registers no other servers."""

    def __init__(self, settings: OpcuaSettings, users: Users) -> None:
        super().__init__(user_manager=users)
        self.calls: Calls | None = None
        self._needs_certificate = settings.is_encrypted
        self.allow_remote_admin = False
        self.supported_tokens = (ua.UserNameIdentityToken,) if users.are_named else (ua.AnonymousIdentityToken,)
        self.min_session_timeout_ms = _SHORTEST_TIMEOUT_MS
        self.max_session_timeout_ms = settings.session_timeout_s * 1000
        self.max_connections, self.max_subscriptions = _MOST_CONNECTIONS, _MOST_SUBSCRIPTIONS
        self.max_pending_activation_seconds = _ACTIVATION_S

    def create_session(self, name: str, user: User = ANYBODY, external: bool = False) -> CellSession:
        if self.calls is None:
            raise ServiceError(ua.StatusCodes.BadServerHalted)
        return CellSession(self.calls, self._needs_certificate, self, name, User(), external)

    def register_server(self, server: Any, conf: Any = None) -> None:
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)


class CellServer(Server):  # type: ignore[misc]
    """asyncua's server with sessions of ours. `prepare` first, then add nodes, then `open`."""

    def __init__(self, settings: OpcuaSettings) -> None:
        self._internal = _Internal(settings, Users(settings.users))
        super().__init__(iserver=self._internal)
        self._settings = settings

    async def prepare(self, cell_id: str) -> None:
        """Load certificates and the standard's own nodes. Raises: ConfigError."""
        settings = self._settings
        self.name, self.product_uri, self.manufacturer_name = f"VLAD Cell {cell_id}", "urn:vlad-cell", "VLAD Cell"
        self.application_type = ua.ApplicationType.Server
        uri = f"urn:vlad-cell:{cell_id}"
        self.set_endpoint(settings.endpoint)
        if settings.certificate is not None and settings.key is not None and settings.trusted is not None:
            uri = await self._load_keys(settings.certificate, settings.key, settings.trusted)
        else:
            self.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        self.limits = TransportLimits(
            max_recv_buffer=_CHUNK_BYTES,
            max_send_buffer=_CHUNK_BYTES,
            max_chunk_count=_MAX_MESSAGE_BYTES // _CHUNK_BYTES + 1,
            max_message_size=_MAX_MESSAGE_BYTES,
        )
        await self.init()
        await self.set_application_uri(uri)

    async def _load_keys(self, certificate: Path, key: Path, trusted: Path) -> str:
        """Load our certificate and those we trust; return the application URI in ours. Raises: ConfigError."""
        require_private(key, "OPC UA key")
        store = TrustStore([trusted], [])
        try:
            found = x509.load_pem_x509_certificate(certificate.read_bytes())
            alternative = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
            (uri,) = alternative.get_values_for_type(x509.UniformResourceIdentifier)
            await self.load_certificate(certificate, "pem")
            await self.load_private_key(key, format="pem")
            if not any(trusted.glob("*.pem")):
                raise ConfigError(f"There is no certificate (*.pem) in {trusted}: nobody could connect.", _HELP)
            await store.load()
        except (OSError, ValueError, x509.ExtensionNotFound) as error:
            raise ConfigError(f"The OPC UA certificates cannot be used: {error}.", _HELP) from error
        self.set_security_policy(_POLICIES)
        self.set_certificate_validator(CertificateValidator(_CHECKS, store))
        return str(uri)

    async def open(self, calls: Calls) -> str:
        """Listen; return the endpoint. Raises: PortOccupied."""
        self._internal.calls = calls
        await self._setup_server_nodes()
        await self.iserver.start()
        self.bserver = _Listener(self.iserver, self.endpoint.hostname or "", self.endpoint.port or 0, self.limits)
        self.bserver.set_policies(self._policies)
        try:
            await self.bserver.start()
        except OSError as error:
            await self.iserver.stop()
            raise PortOccupied(
                f"Cannot listen on {self._settings.endpoint}: another program uses it, or it is not this machine's"
                f" address ({error.strerror}).",
                "Choose another: --set opcua.endpoint=...",
            ) from error
        return self._settings.endpoint


def quieten_logs() -> None:
    """Log asyncua's own troubles only, not every mistake of a client: any program may make as many as it likes."""
    logging.getLogger("asyncua").setLevel(logging.ERROR)
    for name in ("uaprocessor", "binary_server_asyncio", "address_space"):
        logging.getLogger(f"asyncua.server.{name}").setLevel(logging.CRITICAL)
    for name in ("asyncua.server.internal_session", "asyncuagds.validate"):  # the last names every foreign certificate
        logging.getLogger(name).setLevel(logging.CRITICAL)

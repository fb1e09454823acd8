"""Sessions of OPC UA clients, made safe: who called, who is gone, with which certificate and token.

asyncua gives sessions tokens that can be guessed, tells methods nothing of their caller, keeps the session of a dead
client with a subscription until its time-out, and believes a certificate that is not the channel's.
"""

from __future__ import annotations

import os
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import SessionState
from asyncua.server.uaprocessor import UaProcessor

from cell.opcua.calls import Attendant, Calls
from cell.opcua.subscriptions import OwnSubscriptions
from cell.opcua.users import Person

_TOKEN_BYTES = 32


class CellSession(OwnSubscriptions):
    """One session of a client.

    Args:
        calls: answers calls of the cell's methods.
        needs_certificate: a session without the certificate of its channel is refused.
    """

    def __init__(
        self, calls: Calls, needs_certificate: bool, server: InternalServer, name: str, user: Any, external: bool
    ) -> None:
        super().__init__(server, server.aspace, server.subscription_service, name, user=user)
        self.external = external
        self.auth_token = ua.NodeId(os.urandom(_TOKEN_BYTES), 0, ua.NodeIdType.ByteString)
        server.register_external_session(self)
        self._calls, self._needs_certificate = calls, needs_certificate
        self._attendant: Attendant | None = None
        self._certificate: bytes | None = None
        self.channel_certificate: bytes | None = None

    async def create_session(
        self, params: ua.CreateSessionParameters, sockname: tuple[str, int] | None = None
    ) -> ua.CreateSessionResult:
        """Create the session with the certificate of its channel. Raises: ServiceError."""
        try:
            if self._needs_certificate and (
                self.channel_certificate is None or params.ClientCertificate != self.channel_certificate
            ):
                raise ServiceError(ua.StatusCodes.BadSecurityChecksFailed)
            self._certificate = self.channel_certificate
            return await super().create_session(params, sockname)
        except ServiceError:
            self.iserver.unregister_external_session(self)
            self.state = SessionState.Closed
            raise

    def activate_session(
        self, params: ua.ActivateSessionParameters, peer_certificate: bytes | None
    ) -> ua.ActivateSessionResult:
        """Activate the session; over another channel only with the same certificate. Raises: ServiceError."""
        if peer_certificate != self._certificate:
            raise ServiceError(ua.StatusCodes.BadSecurityChecksFailed)
        before = self.user
        result = super().activate_session(params, peer_certificate)
        if self.user != before:
            self.leave()
            self._attendant = None
        return result

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        """Answer calls, one after the other: those of the cell's methods here, others as asyncua does."""
        results = []
        for request in params:
            method = self._calls.method_of(request)
            if method is None:
                results += await super().call([request])
                continue
            person = self.user if isinstance(self.user, Person) else Person()
            if self._attendant is None:
                self._attendant = Attendant(self._calls, person.name or "")
            given = request.InputArguments or []
            results.append(await self._calls.answer(method, given, person, self._attendant))
        return results

    def leave(self) -> None:
        """Give the lease back because nobody attends the motion: the client's connection is gone, or its session."""
        if self._attendant is not None:
            self._attendant.leave()

    async def close_session(self, delete_subs: bool = True) -> None:
        """Close the session; motion that it commanded is held. May run twice."""
        self.leave()
        await super().close_session(delete_subs)


class CellProcessor(UaProcessor):  # type: ignore[misc]
    """One connection; its session learns of its certificate and of its end."""

    @property
    def session(self) -> CellSession | None:
        """The session of this connection."""
        return self._session

    @session.setter
    def session(self, session: CellSession | None) -> None:
        self._session = session
        if session is not None:
            session.channel_certificate = self._connection.security_policy.peer_certificate

    async def close(self) -> None:
        """End with the connection: the lease is given back at once, whatever becomes of the session."""
        if self._session is not None:
            self._session.leave()
        await super().close()

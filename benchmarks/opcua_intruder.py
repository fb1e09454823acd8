"""An intruder's tries at the OPC UA door: other certificates and users, guessed session tokens, writes, calls.

A try is accepted when a session opens that should not, or when anything is answered with a good status. It is refused
when the door says so; a door that says nothing, or that something broke, counts as a crash. One honest session is the
control.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

from benchmarks.guarded import Guarded
from benchmarks.tally import Tally
from cell.machine.states import ENDING
from cell.opcua.address_space import NAMESPACE
from cell.opcua.methods import METHODS
from cell.opcua.variables import VARIABLES

_PATIENCE_S = 60.0
_TIMEOUT_S = 20.0
_NOT_A_VIEWERS = tuple(method for method in METHODS if method.verb not in ENDING and method.name != "Picture")
_BROKEN = {"BadInternalError", "BadUnexpectedError", "BadTimeout", "BadConnectionClosed", "BadNoCommunication"}
"""Statuses that are no refusal."""
_ZERO = {"String": "", "UInt32": ua.Variant(1, ua.VariantType.UInt32), "Boolean": False}


class OpcuaIntruder:
    """Tries, and counts what comes back. Its clients live on an event loop of their own, which keeps them alive.

    Args:
        endpoint: of the door. ``guarded``: what the intruder has: a viewer's password, and a certificate.
    """

    def __init__(self, endpoint: str, guarded: Guarded, tally: Tally, rng: np.random.Generator) -> None:
        self._endpoint, self._guarded, self._tally, self._rng = endpoint, guarded, tally, rng
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # it says every refusal
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever)
        self._thread.start()
        self._viewer: Client | None = None
        self._index, self._is_controlled = 0, False
        self.kinds: dict[str, Callable[[], Awaitable[str]]] = {
            "opcua_no_certificate": lambda: self._opened(None, "ann", self._guarded.passwords["ann"]),
            "opcua_wrong_certificate": self._wrong_certificate,
            "opcua_wrong_user": self._wrong_user,
            "opcua_token": self._guessed_token,
            "opcua_write": self._write,
            "opcua_call": self._call,
        }

    def attempt(self, kind: str) -> None:
        """One try of a kind; before the first, the honest session."""
        if not self._is_controlled:
            self._is_controlled = True
            self._count("an honest session", self._honest)
        self._count(kind, lambda: self._tried(kind))

    def _count(self, kind: str, ask: Callable[[], Awaitable[str]]) -> None:
        """Count what the door answers; anything but an answer is a crash."""

        async def answered() -> str:
            return await ask()

        try:
            code = asyncio.run_coroutine_threadsafe(answered(), self._loop).result(_PATIENCE_S)
        except Exception as error:  # noqa: BLE001 - whatever it is, the door has refused nothing
            self._tally.crash(f"{kind}: {error!r}")
            return
        if code in _BROKEN:
            self._tally.crash(f"{kind}: {code}")
        self._tally.by_code[f"OPC UA {code}"] += 1

    def close(self) -> None:
        """End the viewer's session, and the loop."""
        if self._viewer is not None:
            with suppress(Exception):  # it may have ended with the door
                asyncio.run_coroutine_threadsafe(self._viewer.disconnect(), self._loop).result(_PATIENCE_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _tried(self, kind: str) -> str:
        """The refusal's status, or the name of the error; "ACCEPTED" is counted here. Raises: without an answer."""
        try:
            what = await self.kinds[kind]()
        except ua.UaStatusCodeError as refusal:
            return str(ua.StatusCode(refusal.code).name)
        except ua.UaError as refusal:
            return type(refusal).__name__
        if what.startswith("Bad"):
            return what
        self._tally.accept(kind, what)
        return "ACCEPTED"

    async def _honest(self) -> str:
        """An operator looks: without this a door that lets in nobody at all would look perfect."""
        client = await self._client(self._guarded.keys, "ann", self._guarded.passwords["ann"])
        async with client:
            index = await client.get_namespace_index(NAMESPACE)
            await client.get_node(ua.NodeId("Cell.Status.StateName", index)).read_value()
        return "Good"

    # --- who comes in -------------------------------------------------------------------------------------------------

    async def _client(self, keys: Path | None, user: str, password: str) -> Client:
        """A client that is not connected yet."""
        client = Client(self._endpoint, timeout=_TIMEOUT_S)
        client.application_uri = "urn:vlad-cell:client"
        if keys is not None:
            await client.set_security(
                SecurityPolicyBasic256Sha256,
                certificate=str(keys / "client.pem"),
                private_key=str(keys / "client-key.pem"),
                server_certificate=str(self._guarded.keys / "cell.pem"),
            )
        if user:
            client.set_user(user)
            client.set_password(password)
        return client

    async def _opened(self, keys: Path | None, user: str, password: str) -> str:
        """Return what a client that opened was let in as. Raises: however asyncua says that it was not."""
        client = await self._client(keys, user, password)
        async with client:
            return f"a session of {user or 'nobody'}"

    async def _wrong_certificate(self) -> str:
        return await self._opened(self._guarded.strangers, "ann", self._guarded.passwords["ann"])

    async def _wrong_user(self) -> str:
        user = str(self._rng.choice(["ann", "vic", "admin", "root", ""]))
        near = self._guarded.passwords["ann"][:-1]
        return await self._opened(self._guarded.keys, user, str(self._rng.choice([near, "", "x", "admin"])))

    async def _guessed_token(self) -> str:
        """A session that is another's, over a channel of a trusted certificate."""
        client = await self._client(self._guarded.keys, "", "")
        await client.connect_socket()
        try:
            await client.send_hello()
            await client.open_secure_channel()
            counted = ua.NodeId(int(self._rng.integers(900, 1200)))
            drawn = ua.NodeId(self._rng.bytes(32), 0, ua.NodeIdType.ByteString)
            client.uaclient.protocol.authentication_token = (counted, drawn)[int(self._rng.integers(2))]
            params = ua.ActivateSessionParameters()
            params.UserIdentityToken = ua.AnonymousIdentityToken(PolicyId="anonymous")
            await client.uaclient.activate_session(params)
            return "another's session"
        finally:
            client.disconnect_socket()

    # --- what a viewer may not ----------------------------------------------------------------------------------------

    async def _as_viewer(self) -> Client:
        """The one session that the intruder really has."""
        if self._viewer is None:
            client = await self._client(self._guarded.keys, "vic", self._guarded.passwords["vic"])
            await client.connect()
            self._index = await client.get_namespace_index(NAMESPACE)
            self._viewer = client
        return self._viewer

    async def _write(self) -> str:
        """Write a variable, or add or delete a node."""
        viewer = await self._as_viewer()
        path = VARIABLES[int(self._rng.integers(len(VARIABLES)))].path
        node = viewer.get_node(ua.NodeId(f"Cell.{path}", self._index))
        way = int(self._rng.integers(3))
        if way == 0:
            await node.write_value("forged")
        elif way == 1:
            await viewer.get_node(ua.NodeId("Cell", self._index)).add_variable(self._index, "mine", 1)
        else:
            (status,) = await viewer.uaclient.delete_nodes(
                ua.DeleteNodesParameters(NodesToDelete=[ua.DeleteNodesItem(NodeId=node.nodeid)])
            )
            status.check()
        return f"{('write', 'add', 'delete')[way]} {path}"

    async def _call(self) -> str:
        """Call a method as its arguments are, or with others."""
        viewer = await self._as_viewer()
        method = _NOT_A_VIEWERS[int(self._rng.integers(len(_NOT_A_VIEWERS)))]
        given = [_ZERO[one.kind] for one in method.inputs]
        if self._rng.random() < 0.5:
            others: tuple[Any, ...] = (
                "",
                "x" * 3000,
                7,
                1.5,
                True,
                self._rng.bytes(8),
                [1, 2],
                '{"target": {"text": "red"}}',
            )
            given = [others[int(self._rng.integers(len(others)))] for _ in range(int(self._rng.integers(4)))]
        request = ua.CallMethodRequest(
            ObjectId=ua.NodeId("Cell", self._index),
            MethodId=ua.NodeId(f"Cell.{method.name}", self._index),
            InputArguments=[one if isinstance(one, ua.Variant) else ua.Variant(one) for one in given],
        )
        (result,) = await viewer.uaclient.call([request])
        return method.name if result.StatusCode.is_good() else str(result.StatusCode.name)

"""Stands before the application: what a request must be before anything reads it, and what every answer carries.

The server checks none of this: who is addressed (a foreign name would be DNS rebinding), where a page comes from
(CSRF), how large a body is and how long it takes, and who asks.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
from collections.abc import Collection
from http.cookies import CookieError, SimpleCookie
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from cell.http.access import Access
from cell.http.answers import JSON, refuse
from config.http import HttpSettings

MAX_BODY_BYTES = 64 * 1024
"""As on the bus: a command has some hundred bytes."""
COOKIE = "vlad_cell_token"
BODY_S, STALL_S = 10.0, 10.0
"""Longest time for a whole body, and for the client to take a part of an answer."""
_READ = ("GET", "HEAD")
_LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")
_log = logging.getLogger(__name__)

HEADERS = {
    "Content-Security-Policy": "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Guard:
    """The wrapper of an ASGI application; it adds the client's role as ``scope["state"]["role"]``.

    Args:
        open_paths: paths that need no token; each holds for what is below it, too, when it ends with ``/``, but
            for the root.
    """

    def __init__(self, app: ASGIApp, settings: HttpSettings, access: Access, open_paths: Collection[str] = ()) -> None:
        self._app, self._access, self._open = app, access, open_paths
        self._names = frozenset(name.strip("[]").lower() for name in (*_LOCAL_NAMES, settings.host, *settings.names))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check one request, and pass it on."""
        if scope["type"] != "http":
            return
        send = self._dressed(send)
        refusal = self._refusal(scope)
        if refusal is not None:
            await refusal(scope, receive, send)
            return
        body = await self._body(scope, receive)
        if isinstance(body, Response):
            await body(scope, receive, send)
        else:
            await self._run(scope, _replayed(body, receive), send)

    async def _run(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await self._app(scope, receive, send)
        except _Stalled:
            _log.info("a client takes nothing any more")

    def _refusal(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        host = headers.getlist("host")
        if len(host) != 1 or _name_in(host[0]) not in self._names:
            return refuse(403, "FOREIGN_HOST", "This is not who you ask for.", "Add the name to http.names.")
        origin = headers.get("origin")
        if origin is not None and origin.lower() != f"{scope['scheme']}://{host[0]}".lower():
            return refuse(403, "FOREIGN_ORIGIN", "Pages of other servers may not ask this cell.")
        if scope["method"] not in _READ and _media_type(headers) != JSON:
            what = f"A {scope['method']} needs the header Content-Type: {JSON}."
            return refuse(415, "CONTENT_TYPE", what, f"With curl: -H 'Content-Type: {JSON}'.")
        role = self._access.role_of(token_in(headers))
        if role is None and not self._is_open(scope["path"]):
            refusal = refuse(401, "NO_TOKEN", "A token is needed.", "Send the header Authorization: Bearer TOKEN.")
            refusal.headers["WWW-Authenticate"] = "Bearer"
            return refusal
        scope.setdefault("state", {})["role"] = role
        return None

    def _is_open(self, path: str) -> bool:
        return any(path == one or (one.endswith("/") and one != "/" and path.startswith(one)) for one in self._open)

    async def _body(self, scope: Scope, receive: Receive) -> bytes | Response:
        """The whole body; an answer when it is too large or too slow. A GET without one does not wait for it."""
        headers = Headers(scope=scope)
        length = headers.get("content-length", "0" if "transfer-encoding" not in headers else "")
        if length == "0":
            return b""
        too_large = refuse(413, "TOO_LARGE", f"A body has at most {MAX_BODY_BYTES} bytes.")
        too_large.headers["Connection"] = "close"
        if length.isdecimal() and len(length) < 20 and int(length) > MAX_BODY_BYTES:
            return too_large
        body = bytearray()
        try:
            async with asyncio.timeout(BODY_S):
                while True:
                    message = await receive()
                    body += message.get("body", b"")
                    if len(body) > MAX_BODY_BYTES:
                        return too_large
                    if not message.get("more_body", False):
                        return bytes(body)
        except TimeoutError:
            slow = refuse(408, "TOO_SLOW", f"The body took longer than {BODY_S:.0f} s.")
            slow.headers["Connection"] = "close"
            return slow

    def _dressed(self, send: Send) -> Send:
        """``send`` with our headers, and an end for a client that stalls."""

        async def dressed(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                headers.setdefault("Cache-Control", "no-store")
            try:
                async with asyncio.timeout(STALL_S):
                    await send(message)
            except TimeoutError as error:
                raise _Stalled from error

        return dressed


class _Stalled(Exception):
    """The client takes nothing of an answer."""


def token_in(headers: Headers) -> str:
    """Return the token of a request, of its header or its cookie; "" without one."""
    kind, _, token = headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer":
        return token.strip()
    try:
        cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return ""
    return cookie.value if cookie is not None else ""


def _media_type(headers: Headers) -> str:
    return headers.get("content-type", "").partition(";")[0].strip().lower()


def _name_in(host: str) -> str:
    """The name or address of a Host header, without its port."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
        return str(ipaddress.ip_address(name)) if ":" in name else name
    except ValueError:
        return ""


def _replayed(body: bytes, receive: Receive) -> Receive:
    """``receive`` that first gives the body that was read; afterwards only the client's disconnect is awaited."""
    is_given = False

    async def replayed() -> Message:
        nonlocal is_given
        if is_given:
            return await receive()
        is_given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return replayed

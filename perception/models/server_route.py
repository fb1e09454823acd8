"""The connection to a provider's server: direct, or through the environment's proxy; and the trusted certificates."""

from __future__ import annotations

import ipaddress
import ssl
from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib.util import find_spec
from urllib.parse import urlsplit

import httpcore2
import httpx2

from bus.errors import ConfigError
from bus.redaction import keep_secrets_of
from perception.models.deadline import Deadline, DeadlineBackend

_SOCKS = ("socks5", "socks5h")


class ServerRoute:
    """Opens connections to one server.

    Args:
        url: of the server.
        environ: proxies (``HTTPS_PROXY``, ``ALL_PROXY``, ``NO_PROXY``; upper or lower case).

    Raises: ConfigError for an unusable proxy, or certificates that cannot be read.
    """

    def __init__(self, url: str, environ: Mapping[str, str]) -> None:
        self.proxy = proxy_to(url, environ)
        self._is_plain = urlsplit(url).scheme == "http" and (self.proxy is None or self.proxy.url.scheme != "https")
        if not self._is_plain:
            _ = self._trust

    def transport(self, deadline: Deadline) -> httpx2.BaseTransport:
        """Return the transport of one connection; all its operations end by ``deadline``."""
        return _Transport(self._pool(DeadlineBackend(deadline)))

    @cached_property
    def _trust(self) -> ssl.SSLContext:
        try:
            return httpx2.create_ssl_context()
        except OSError as error:
            raise ConfigError(
                f"The certificates to trust cannot be read ({error.strerror or error}).",
                "Check SSL_CERT_FILE and SSL_CERT_DIR in the environment.",
            ) from error

    def _pool(self, backend: httpcore2.NetworkBackend) -> httpcore2.ConnectionPool:
        trust = None if self._is_plain else self._trust
        if self.proxy is None:
            return httpcore2.ConnectionPool(ssl_context=trust, network_backend=backend)
        url, auth = _core(self.proxy.url), self.proxy.raw_auth
        if self.proxy.url.scheme in _SOCKS:
            return httpcore2.SOCKSProxy(proxy_url=url, proxy_auth=auth, ssl_context=trust, network_backend=backend)
        return httpcore2.HTTPProxy(
            proxy_url=url,
            proxy_auth=auth,
            ssl_context=trust,
            proxy_ssl_context=trust if self.proxy.url.scheme == "https" else None,
            network_backend=backend,
        )


def proxy_to(url: str, environ: Mapping[str, str]) -> httpx2.Proxy | None:
    """Return the proxy for ``url``; None without one, and always for this machine itself.

    Raises: ConfigError for a proxy of an unknown kind, or SOCKS without its package.
    """
    address = urlsplit(url)
    host = address.hostname or ""
    set_as, value = _setting(environ, (f"{address.scheme}_proxy", "all_proxy"))
    _, spared = _setting(environ, ("no_proxy",))
    if not value or _is_here(host) or _is_spared(host, spared):
        return None
    keep_secrets_of(value)
    named = value if "://" in value else f"http://{value}"
    kind = named.partition("://")[0].lower()
    if kind in _SOCKS and find_spec("socksio") is None:
        raise ConfigError(
            f"The environment variable {set_as} asks for a SOCKS proxy to {host}, for which a package is missing.",
            f"Install it (uv pip install socksio), name an http:// proxy, or spare the server: NO_PROXY={host}.",
        )
    if kind not in ("http", "https", *_SOCKS):
        raise ConfigError(f"The environment variable {set_as} names a proxy of the unknown kind {kind!r}.", _KINDS)
    try:
        return httpx2.Proxy(named)
    except (httpx2.InvalidURL, ValueError):  # their texts contain the address and its secrets
        raise ConfigError(f"The environment variable {set_as} does not hold a proxy's address.", _KINDS) from None


_KINDS = "A proxy is named as http://HOST:PORT, https://..., socks5://... or socks5h://..."


def _setting(environ: Mapping[str, str], names: tuple[str, ...]) -> tuple[str, str]:
    """The first variable that is set, and its value; lower case before upper case, as with curl."""
    for name in names:
        for spelled in (name, name.upper()):
            if environ.get(spelled):
                return spelled, environ[spelled].strip()
    return "", ""


def _is_spared(host: str, spared: str) -> bool:
    """True when ``NO_PROXY`` names the host, a domain it belongs to, or a network of its address."""
    for entry in (one.strip().lower().removeprefix("*").removeprefix(".") for one in spared.split(",") if one.strip()):
        name = entry if entry.count(":") > 1 else entry.partition(":")[0]
        if not name or host == name or host.endswith(f".{name}") or _is_within(host, name):
            return True
    return False


def _is_within(host: str, network: str) -> bool:
    try:
        return ipaddress.ip_address(host) in ipaddress.ip_network(network, strict=False)
    except ValueError:
        return False


def _is_here(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _core(url: httpx2.URL) -> httpcore2.URL:
    return httpcore2.URL(scheme=url.raw_scheme, host=url.raw_host, port=url.port, target=url.raw_path)


class _Transport(httpx2.BaseTransport):
    """The pool as a transport of the HTTP client; the caller reads the reply's body."""

    def __init__(self, pool: httpcore2.ConnectionPool) -> None:
        self._pool = pool

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        assert isinstance(request.stream, httpx2.SyncByteStream)
        answer = self._pool.handle_request(
            httpcore2.Request(request.method, _core(request.url), headers=request.headers.raw, content=request.stream)
        )
        return httpx2.Response(answer.status, headers=answer.headers, stream=_Body(answer))

    def close(self) -> None:
        self._pool.close()


class _Body(httpx2.SyncByteStream):
    def __init__(self, answer: httpcore2.Response) -> None:
        self._answer = answer

    def __iter__(self) -> Iterator[bytes]:
        yield from self._answer.iter_stream()

    def close(self) -> None:
        self._answer.close()

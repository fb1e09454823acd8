"""A call's deadline holds for all of it, on real sockets; and which way a call goes."""

from __future__ import annotations

import gzip
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx2
import pytest

from bus.codes import Code
from bus.errors import ConfigError
from bus.redaction import redacted
from bus.threads import OwnedThread, Role
from config.perception import HostedSettings
from perception.models.errors import ModelError
from perception.models.exchange import Line
from perception.models.gemini import GeminiProvider
from perception.models.openai import OpenAIProvider
from perception.models.server_route import ServerRoute, proxy_to

SERVER = "https://models.example/v1"
HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 100000\r\n\r\n"
DRIP_S, DEADLINE_S = 0.05, 0.4
SLACK_S = 10.0
"""What a busy machine may take on top: a trickle never ends."""


@contextmanager
def listening(serve: Callable[[socket.socket], None]) -> Iterator[str]:
    """A server that handles its one connection with ``serve``; gives its address."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def accept() -> None:
            connection = server.accept()[0]
            with connection:
                try:
                    serve(connection)
                except OSError:  # the client left
                    return

        thread = OwnedThread(Role.PROBE, accept).start()
        yield f"http://127.0.0.1:{server.getsockname()[1]}/v1"
        thread.join(60)
        assert not thread.is_alive(), "the client hung up"


def drip(first: bytes, then: bytes) -> Callable[[socket.socket], None]:
    def serve(connection: socket.socket) -> None:
        connection.sendall(first)
        while True:
            connection.sendall(then)
            time.sleep(DRIP_S)

    return serve


def silence(connection: socket.socket) -> None:
    while connection.recv(65536):
        pass


LEFT = threading.Event()
"""Whether the client is gone: a server that takes slowly has much to take yet, and sees no end of it."""


def take_slowly(connection: socket.socket) -> None:
    while not LEFT.wait(DRIP_S):
        connection.recv(1024)


def fault_of(url: str, timeout_s: float = DEADLINE_S, prompt: str = "Say.") -> ModelError:
    how = HostedSettings(text_model="t", image_model="i", base_url=url)
    provider = OpenAIProvider(how, "key", Line(ServerRoute(url, {}).transport))
    with pytest.raises(ModelError) as caught:
        provider.complete(prompt, None, timeout_s)
    return caught.value


@pytest.mark.parametrize(
    ("serve", "prompt"),
    [
        (drip(HEAD, b" "), "Say."),
        (drip(b"HTTP/1.1 200 OK\r\n", b"X-A: b\r\n"), "Say."),
        (drip(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n", b"1\r\n \r\n"), "Say."),
        (drip(b"", b"HTTP/1.1 100 Continue\r\n\r\n"), "Say."),
        (silence, "Say."),
        (take_slowly, "x" * 20_000_000),
    ],
    ids=["body", "headers", "chunks", "interim", "silence", "slow reader"],
)
def test_no_trickle_outlasts_the_deadline(serve: Callable[[socket.socket], None], prompt: str) -> None:
    LEFT.clear()
    started_s = time.monotonic()
    with listening(serve) as url:
        fault = fault_of(url, prompt=prompt)
        took_s = time.monotonic() - started_s
        LEFT.set()
    assert fault.code is Code.MODEL_TIMEOUT
    assert took_s < DEADLINE_S + SLACK_S


def test_gemini_has_the_same_deadline() -> None:
    with listening(drip(HEAD, b" ")) as url:
        how = HostedSettings(text_model="t", image_model="i", base_url=url)
        with pytest.raises(ModelError) as caught:
            GeminiProvider(how, "key", Line(ServerRoute(url, {}).transport)).complete("Say.", None, DEADLINE_S)
    assert caught.value.code is Code.MODEL_TIMEOUT


def test_an_answer_without_end_is_cut_off() -> None:
    def flood(connection: socket.socket) -> None:
        connection.sendall(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n")
        while True:
            connection.sendall(b"100000\r\n" + bytes(1 << 20) + b"\r\n")

    with listening(flood) as url:
        fault = fault_of(url, timeout_s=60.0)
    assert fault.code is Code.MODEL_UNAVAILABLE and "larger than 64 MiB" in fault.text


@pytest.mark.parametrize(
    ("packing", "body", "says"),
    [
        ("gzip", gzip.compress(bytes(100 << 20)), "larger than 64 MiB"),
        ("gzip", b"not packed", "could not be read"),
        ("zstd", b"x", "zstd"),
        ("gzip, gzip", b"x", "gzip, gzip"),
    ],
)
def test_a_packed_answer_is_unpacked_within_bounds(packing: str, body: bytes, says: str) -> None:
    def serve(_: httpx2.Request) -> httpx2.Response:
        return httpx2.Response(200, headers={"Content-Encoding": packing}, stream=httpx2.ByteStream(body))

    line = Line(lambda _deadline: httpx2.MockTransport(serve))
    with pytest.raises(ModelError, match=says) as caught:
        line.exchange(10.0, lambda: line.client.get("http://models.example"))
    assert caught.value.code is Code.MODEL_UNAVAILABLE


def test_a_server_that_hangs_up_is_unavailable_and_worth_another_try() -> None:
    with listening(lambda connection: connection.sendall(HEAD + b"{")) as url:
        fault = fault_of(url, timeout_s=60.0)
    assert fault.code is Code.MODEL_UNAVAILABLE and fault.again


def test_calls_at_once_do_not_mix() -> None:
    line = Line(lambda _deadline: httpx2.MockTransport(lambda asked: httpx2.Response(200, content=asked.content)))
    heard: dict[int, bytes] = {}

    def ask(number: int) -> None:
        sent = str(number).encode()
        heard[number] = line.exchange(10.0, lambda: line.client.post(SERVER, content=sent)).body

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert heard == {number: str(number).encode() for number in range(8)}


# --- the way ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("environ", "proxy"),
    [
        ({}, None),
        ({"HTTPS_PROXY": "http://proxy.example:3128"}, "http://proxy.example:3128"),
        ({"https_proxy": "proxy.example:3128"}, "http://proxy.example:3128"),
        ({"HTTP_PROXY": "http://proxy.example:3128"}, None),
        ({"ALL_PROXY": "http://proxy.example:3128"}, "http://proxy.example:3128"),
        ({"ALL_PROXY": "http://proxy.example:3128", "NO_PROXY": "localhost, .example"}, None),
        ({"ALL_PROXY": "socks5://proxy.example:1080", "no_proxy": "*"}, None),
    ],
)
def test_the_environment_names_the_proxy(environ: dict[str, str], proxy: str | None) -> None:
    found = proxy_to(SERVER, environ)
    assert (str(found.url) if found is not None else None) == proxy


@pytest.mark.parametrize("url", ["http://127.0.0.1:8000/v1", "http://[::1]:8000/v1", "http://localhost:8000/v1"])
def test_no_proxy_is_asked_for_this_machine(url: str) -> None:
    assert proxy_to(url, {"ALL_PROXY": "socks5://proxy.example:1080", "HTTP_PROXY": "http://proxy.example"}) is None


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("socks5://anna:pass-word@proxy.example:1080", "ALL_PROXY asks for a SOCKS proxy to models.example"),
        ("socks4://anna:pass-word@proxy.example:1080", "unknown kind 'socks4'"),
        ("http://anna:pass-word@proxy.example:port", "does not hold a proxy's address"),
    ],
)
def test_a_proxy_that_cannot_be_used_is_told_at_the_start(value: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as refusal:
        ServerRoute(SERVER, {"ALL_PROXY": value})
    assert "pass-word" not in str(refusal.value) + redacted(value)


def test_certificates_that_are_not_there_are_told_at_the_start(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "none.pem"))
    with pytest.raises(ConfigError, match="certificates"):
        ServerRoute(SERVER, {})

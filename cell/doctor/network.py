"""Network probes of the doctor, with short timeouts; they leave no connection open."""

from __future__ import annotations

import ipaddress
import queue
import socket
import struct
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from bus.threads import OwnedThread, Role

AnswerT = TypeVar("AnswerT")

REACH_S = 1.0
"""Timeout of a TCP connection; a later answer counts as none."""
CONNECTIONS, ROUTES = Path("/proc/net/tcp"), Path("/proc/net/route")
_ESTABLISHED, _LISTEN = "01", "0A"


def answer_within(seconds: float, ask: Callable[[], AnswerT]) -> AnswerT | None:
    """Return the result of ``ask``; None for an OSError, or after ``seconds`` [s]: ``ask`` then ends by itself."""
    answers: queue.SimpleQueue[AnswerT | None] = queue.SimpleQueue()

    def work() -> None:
        try:
            answers.put(ask())
        except OSError:
            answers.put(None)

    OwnedThread(Role.PROBE, work).start()
    try:
        return answers.get(timeout=seconds)
    except queue.Empty:
        return None


def ip_of(address: str) -> str | None:
    """Return the IPv4 address of a name, or None when it cannot be resolved."""
    return answer_within(REACH_S, lambda: socket.gethostbyname(address))


def is_this_machine(ip: str) -> bool:
    """True for a loopback address, which belongs to a simulator."""
    return ipaddress.ip_address(ip).is_loopback


def obstacle(address: str, port: int) -> str:
    """Return why no TCP connection can be opened, or "" when one can; it is closed immediately."""
    try:
        with socket.create_connection((address, port), REACH_S):
            return ""
    except TimeoutError:
        return f"does not answer within {REACH_S:.0f} s"
    except ConnectionRefusedError:
        return "refuses the connection"
    except OSError as error:
        return f"cannot be reached ({error.strerror or error})"


def is_connected(ip: str, port: int, table: Path = CONNECTIONS) -> bool:
    """True when a program of this machine has a TCP connection to this address."""
    return (_hex(ip, port), _ESTABLISHED) in {(row[2], row[3]) for row in _rows(table)}


def is_listening(ip: str, port: int, table: Path = CONNECTIONS) -> bool:
    """True when a program of this machine accepts TCP connections at this address."""
    local = {(row[1], row[3]) for row in _rows(table)}
    return any((_hex(one, port), _LISTEN) in local for one in (ip, "0.0.0.0"))


def _rows(table: Path) -> list[list[str]]:
    return [line.split() for line in table.read_text().splitlines()[1:]]


def _hex(ip: str, port: int) -> str:
    return f"{socket.inet_aton(ip)[::-1].hex().upper()}:{port:04X}"


def way_to(ip: str, routes: Path = ROUTES) -> tuple[str, bool] | None:
    """Return the interface that leads there, and True for a router in between, by the kernel's most specific route."""
    if is_this_machine(ip):
        return "lo", False
    there = struct.unpack("<I", socket.inet_aton(ip))[0]
    rows = [line.split() for line in routes.read_text().splitlines()[1:]] if routes.exists() else []
    ways = [
        (int(row[7], 16), row[0], int(row[2], 16) != 0) for row in rows if there & int(row[7], 16) == int(row[1], 16)
    ]
    if not ways:
        return None
    _, interface, gateway = max(ways, key=lambda way: way[0].bit_count())
    return interface, gateway

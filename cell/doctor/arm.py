"""Checks of the arm and its hand: the network to them, their ports, and the round-trip time.

The arm and the hand accept one client each, and a simulator of them takes a probe for that client. So the port is not
probed while a program of this machine is connected; on loopback only the listening socket is looked up; and a real
robot sees one connection, closed immediately.
"""

from __future__ import annotations

import ipaddress
import statistics
import time
from pathlib import Path

from cell.doctor.finding import Finding, fix, not_needed, ok, skip, uses
from cell.doctor.network import ROUTES, ip_of, is_connected, is_listening, is_this_machine, obstacle, way_to
from config.schema import Station

FCI_PORT, HAND_PORT, DESK_PORT = 1337, 1338, 443
_ROUND_TRIPS = 20
_SLOWEST_S = 1e-3


def network(station: Station, routes: Path = ROUTES) -> Finding:
    """Check that the arm is on a network of this machine, without a router in between."""
    name, address = "arm network", station.fr3.address
    if not uses(station, "fr3"):
        return not_needed(name, "No node uses the driver fr3.")
    ip = ip_of(address)
    if ip is None:
        return fix(name, f"The name {address!r} has no IP address here.", "Set fr3.address to the arm's IP address.")
    if is_this_machine(ip):
        return ok(name, f"{address} is this machine: a simulator")
    way = way_to(ip, routes)
    if way is None:
        return fix(name, f"No network of this machine leads to {address}.", _own_address(ip))
    interface, gateway = way
    if gateway:
        found = f"This machine has no address in the arm's network: it would look for {address} beyond the router"
        return fix(name, f"{found} on {interface}.", _own_address(ip))
    return ok(name, f"{address} is in the network of {interface}, with no router in between")


def _own_address(ip: str) -> str:
    near = ipaddress.ip_interface(f"{ip}/24").network
    return f"Connect the control box by a cable of its own, and give that port a fixed address in {near} (not {ip})."


def _one_client(name: str, address: str, port: int, advice: str) -> Finding:
    """Check that a server that accepts one client is there; see the module."""
    ip, where = ip_of(address), f"{address}, port {port}"
    if ip is None:
        return fix(name, f"The name {address!r} has no IP address here.", "Set it in the station file.")
    if is_connected(ip, port):
        return ok(name, f"{where}: a program of this machine is connected")
    if is_this_machine(ip):
        if is_listening(ip, port):
            return ok(name, f"{where}: somebody listens")
        return fix(name, f"{where}: nobody listens.", "Start the simulator.")
    if _is_elsewhere(ip):
        return skip(name, f"{where}: not asked, because it is not on a network of this machine (see above).")
    trouble = obstacle(ip, port)
    return fix(name, f"{where} {trouble}.", advice) if trouble else ok(name, f"{where}: answers")


def _is_elsewhere(ip: str) -> bool:
    way = way_to(ip)
    return way is None or way[1]


def control(station: Station, port: int = FCI_PORT) -> Finding:
    """Check that the arm's control port answers."""
    name, address = "arm control (FCI)", station.fr3.address
    if not uses(station, "fr3"):
        return not_needed(name, "No node uses the driver fr3.")
    advice = f"Power on and cable? Then in Desk (https://{address}): unlock the joints, and Activate FCI."
    return _one_client(name, address, port, advice)


def latency(station: Station, port: int = DESK_PORT, slowest_s: float = _SLOWEST_S) -> Finding:
    """Measure round trips of TCP handshakes with Desk's port against ``slowest_s``; a refusal is just as fast."""
    name, ip = "arm latency", ip_of(station.fr3.address)
    if not uses(station, "fr3"):
        return not_needed(name, "No node uses the driver fr3.")
    if ip is None or is_this_machine(ip):
        return skip(name, "No network to be measured.")
    if _is_elsewhere(ip):
        return skip(name, f"Not measured: {ip} is not on a network of this machine (see above).")
    if is_connected(ip, FCI_PORT):
        return skip(name, "Not measured while a program of this machine drives the arm.")
    trips_s = _round_trips_s(ip, port)
    if not trips_s:
        return skip(name, f"{station.fr3.address} does not answer.")
    median_ms, most_ms = statistics.median(trips_s) * 1e3, max(trips_s) * 1e3
    found = f"{len(trips_s)} round trips: median {median_ms:.2f} ms, longest {most_ms:.2f} ms"
    if most_ms > slowest_s * 1e3:
        advice = (
            "Use a cable of its own from this machine's network card to the control box: no switch, no USB adapter."
        )
        return fix(name, f"{found}; the arm wants less than {slowest_s * 1e3:.0f} ms.", advice)
    return ok(name, found)


def _round_trips_s(ip: str, port: int) -> list[float]:
    """Durations of some TCP handshakes; the first, which includes ARP, is left out. Empty without an answer."""
    trips_s: list[float] = []
    for _ in range(_ROUND_TRIPS + 1):
        started_s = time.monotonic()
        if obstacle(ip, port) not in ("", "refuses the connection"):
            return []
        trips_s.append(time.monotonic() - started_s)
    return trips_s[1:]


def hand(station: Station, port: int = HAND_PORT) -> Finding:
    """Check that the hand's port answers."""
    name, address = "hand", station.panda_hand.address
    if not uses(station, "panda_hand"):
        return not_needed(name, "No node uses the driver panda_hand.")
    advice = "In Desk: Settings > End Effector: choose Franka Hand, initialise it; and Activate FCI."
    return _one_client(name, address, port, advice)

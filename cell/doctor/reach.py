"""Checks of the other connections: camera, hosted model, the bus, and nodes that run elsewhere."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from importlib import import_module
from typing import Any
from urllib.parse import urlsplit
from urllib.request import getproxies

from bus.errors import BusError, ConfigError
from bus.lazy import LazyModule
from bus.secrets import checked_secret, read_secret
from cell import client
from cell.doctor.finding import Finding, fix, not_needed, ok, skip, uses
from cell.doctor.network import answer_within, ip_of, is_connected, obstacle, way_to
from config.schema import Station

registry: Any = LazyModule("perception.models.registry")  # only `cell doctor` asks it; it brings OpenCV

CAMERA_PORT = 8090
_ASK_CELL_S = 3.0
_SERVERS = {"openai": "https://api.openai.com", "gemini": "https://generativelanguage.googleapis.com"}


# --- the camera -------------------------------------------------------------------------------------------------------


def camera(station: Station, port: int = CAMERA_PORT) -> Finding:
    """Check that the camera's port answers."""
    name, address = "camera", station.femto_mega.address
    if not uses(station, "femto_mega"):
        return not_needed(name, "No node uses the driver femto_mega.")
    if address is None:
        return skip(name, "It has no fixed address: its node looks for it by its serial number.")
    ip = ip_of(address)
    if ip is None:
        return fix(name, f"The name {address!r} has no IP address here.", "Set femto_mega.address.")
    if trouble := "" if is_connected(ip, port) else obstacle(ip, port):
        advice = (
            "Power on and cable? Is this machine's address in the same network (as delivered the camera has"
            " 192.168.1.10)? Else set femto_mega.address."
        )
        return fix(name, f"{address}, port {port} {trouble}.", advice)
    way = way_to(ip)
    if way and way[1]:
        found = f"Something answers at {address}, port {port}, but beyond the router on {way[0]}"
        return skip(name, f"{found}: is it the camera? This machine has no address in that network.")
    return ok(name, f"{address}, port {port}: answers")


# --- the hosted model -------------------------------------------------------------------------------------------------


def model_key(station: Station, environ: Mapping[str, str] = os.environ) -> Finding:
    """Check that the model's key is set; the key is never shown."""
    name, model, hosted = "model key", station.perception.model, station.perception.hosted
    if model not in _SERVERS:
        if model not in registry.GROUP.names():
            return fix(name, f"No such goal-image model: {model}.", f"There are: {', '.join(registry.GROUP.names())}.")
        return not_needed(name, f"The model {model!r} runs on this machine and needs none.")
    unnamed = [role for role in ("text_model", "image_model") if not getattr(hosted, role)]
    if unnamed:
        return fix(name, f"perception.hosted.{unnamed[0]} is not set.", f"Name a model as in config/{model}.toml.")
    if hosted.key_file is not None:
        try:
            read_secret(hosted.key_file, "key file")
        except ConfigError as error:
            return fix(name, error.text, error.advice)
        return ok(name, f"in {hosted.key_file}; models {hosted.text_model} and {hosted.image_model}")
    variable = hosted.key_variable or str(import_module(f"perception.models.{model}").KEY_VARIABLE)
    if not environ.get(variable):
        advice = f"export {variable}=...   (a server of your own takes any text)"
        return fix(name, f"The environment variable {variable} is not set.", advice)
    try:
        checked_secret(environ[variable], f"The environment variable {variable}")
    except ConfigError as error:
        return fix(name, error.text, error.advice)
    return ok(name, f"{variable} is set; models {hosted.text_model} and {hosted.image_model}")


def model_server(station: Station, proxies: Mapping[str, str] | None = None) -> Finding:
    """Check that the hosted model's server answers."""
    name, model = "model server", station.perception.model
    if model not in _SERVERS:
        return not_needed(name, f"The model {model!r} runs on this machine.")
    url = urlsplit(station.perception.hosted.base_url or _SERVERS[model])
    host, port = url.hostname or "", url.port or (80 if url.scheme == "http" else 443)
    if url.scheme in (getproxies() if proxies is None else proxies):
        return skip(name, f"{host} is reached through a proxy.")
    trouble = "has no IP address here" if ip_of(host) is None else obstacle(host, port)
    if trouble:
        advice = "Check this machine's network and perception.hosted.base_url; the embedded model needs no server."
        return fix(name, f"{host}, port {port} {trouble}.", advice)
    return ok(name, f"{host}, port {port}: answers")


# --- the bus and its participants -------------------------------------------------------------------------------------


def running(station: Station) -> tuple[str, list[str]] | None:
    """Return the state and the live nodes of the cell at the station's endpoint; None when no cell answers."""

    def ask() -> tuple[str, list[str]] | None:
        try:
            with client.connect(station) as cell:
                nodes = cell.health().nodes
                return str(cell.state().state), [name for name, node in nodes.items() if node.is_alive]
        except BusError:
            return None

    return answer_within(_ASK_CELL_S, ask)


def _is_free(endpoint: str) -> str:
    """Return why no socket can listen at ``endpoint``, or ""."""
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    host = host.strip("[]")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(family) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, int(port)))
    except (OSError, OverflowError) as error:
        return str(getattr(error, "strerror", None) or error)
    return ""


def bus(station: Station) -> Finding:
    """Check that the endpoint is free, or used by this very cell."""
    name, endpoint = "bus", station.bus.endpoint
    taken = _is_free(endpoint)
    if not taken:
        return ok(name, f"{endpoint} is free for this cell")
    found = running(station)
    if found is not None:
        return ok(name, f"The cell {station.cell_id!r} is running at {endpoint}: {found[0]}")
    advice = "Set bus.endpoint to a free port, e.g. tcp/127.0.0.1:7448, or end the program (ss -ltnp names it)."
    return fix(name, f"{endpoint} cannot be used ({taken}), and no cell {station.cell_id!r} answers there.", advice)


def nodes(station: Station) -> Finding:
    """Check that the nodes that run elsewhere are up."""
    name, outside = "nodes elsewhere", [one for one, node in station.nodes.items() if node.run == "elsewhere"]
    if not outside:
        return not_needed(name, "All nodes are started by the cell itself.")
    if not _is_free(station.bus.endpoint):
        return skip(name, f"No cell is running; once it is, start {', '.join(outside)} with `cell node`.")
    found = running(station)
    missing = [one for one in outside if found is None or one not in found[1]]
    if missing:
        advice = "; ".join(f"cell node {one} --config ..." for one in missing)
        return fix(name, f"Not up: {', '.join(missing)}.", advice)
    return ok(name, f"Up: {', '.join(outside)}")

"""A cell's doors with everything that guards them: tokens, certificates, users; and what an intruder has of these."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from bus.free_port import free_port
from cell.cli.network.opcua_keys import make_opcua_keys
from cell.cli.serving.doors import open_doors
from cell.opcua.passwords import new_user
from config.schema import Station

_OPEN_S = 180.0
VIEWER_TOKEN, OPERATOR_TOKEN = "a-viewer-of-the-benchmark", "an-operator-of-the-benchmark"


@dataclass(frozen=True)
class Guarded:
    """Keys, passwords and settings of a cell whose doors are guarded.

    Attributes:
        keys: folder of the certificates that the cell trusts, ``strangers`` of some that it does not.
        passwords: of the OPC UA users ``ann`` (operator) and ``vic`` (viewer).
        settings: of the station, as ``key=value``.
    """

    keys: Path
    strangers: Path
    passwords: dict[str, str]
    settings: tuple[str, ...]

    @classmethod
    def in_folder(cls, folder: Path) -> Guarded:
        """Write tokens, certificates and users into a folder."""
        keys, strangers, passwords, lines = folder / "keys", folder / "strangers", {}, []
        for one in (keys, strangers):
            make_opcua_keys(one, [])
        for name, role in (("ann", "operator"), ("vic", "viewer")):
            passwords[name], line = new_user(name, role)
            lines.append(line)
        tokens = f'operator = "{OPERATOR_TOKEN}"\nviewer = "{VIEWER_TOKEN}"\n'
        for name, text in (("users", "\n".join(lines)), ("tokens.toml", tokens)):
            (folder / name).write_text(text)
            (folder / name).chmod(0o600)
        files = {"certificate": keys / "cell.pem", "key": keys / "cell-key.pem", "trusted": keys / "trusted",
                 "users": folder / "users"}  # fmt: skip
        settings = (
            "http.port=0",
            f"http.tokens={folder / 'tokens.toml'}",
            f"opcua.endpoint=opc.tcp://127.0.0.1:{free_port()}/cell",
            *(f"opcua.{name}={path}" for name, path in files.items()),
        )
        return cls(keys, strangers, passwords, settings)


@contextmanager
def opened(station: Station, names: list[str]) -> Iterator[dict[str, str]]:
    """Context with these doors of a running cell, each in a process of its own: name -> address."""
    news: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()

    def hear(code: str, _severity: str, text: str, _advice: str) -> None:
        news.put((code, text))

    with open_doors(station, names, hear):
        where: dict[str, str] = {}
        while len(where) < len(names):
            code, text = news.get(timeout=_OPEN_S)
            if code != "DOOR_OPEN":
                raise RuntimeError(text)
            name = next(one for one in names if f"'{one}'" in text)
            where[name] = text.removesuffix(".").rpartition(" ")[2]
        yield where

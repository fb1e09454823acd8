"""A cell over four machines, made of network namespaces: router, cell, node and operator, over TLS; and a cut cable."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from cell.cli.network.tls_keys import make_keys

ROUTER = "10.213.0.1"
PLACES = ("cell", "node", "desk")
NODES = 'nodes={sim = {driver = "sim", run = "elsewhere", serves = ["camera", "arm", "hand"]}}'


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, timeout=10)


class Net:
    """The router's machine in the middle, one cable to each of the others."""

    def __init__(self) -> None:
        self._prefix = f"vlad{os.getpid()}"

    def lay(self) -> None:
        """Raises: CalledProcessError, OSError where namespaces are not allowed."""
        for name in ("router", *PLACES):
            _ip("netns", "add", self.name(name))
            _ip("-n", self.name(name), "link", "set", "lo", "up")
        _ip("-n", self.name("router"), "address", "add", f"{ROUTER}/32", "dev", "lo")
        for number, name in enumerate(PLACES, start=1):
            here, there = ("-n", self.name("router")), ("-n", self.name(name))
            _ip(*here, "link", "add", name, "type", "veth", "peer", "name", "up0", "netns", self.name(name))
            _ip(*here, "address", "add", f"10.213.{number}.1/24", "dev", name)
            _ip(*here, "link", "set", name, "up")
            _ip(*there, "address", "add", f"10.213.{number}.2/24", "dev", "up0")
            self.plug(name)

    def plug(self, name: str) -> None:
        """Put the cable in."""
        _ip("-n", self.name(name), "link", "set", "up0", "up")
        _ip("-n", self.name(name), "route", "replace", "default", "dev", "up0", "via", self._gateway(name))

    def cut(self, name: str) -> None:
        """Pull the cable out."""
        _ip("-n", self.name(name), "link", "set", "up0", "down")

    def clear(self) -> None:
        for name in ("router", *PLACES):
            subprocess.run(["ip", "netns", "del", self.name(name)], check=False, capture_output=True, timeout=10)

    def name(self, place: str) -> str:
        return f"{self._prefix}-{place}"

    @staticmethod
    def _gateway(name: str) -> str:
        return f"10.213.{PLACES.index(name) + 1}.1"


class Program:
    """A process at a place, and the lines it says, each with the time it came."""

    def __init__(self, net: Net, place: str, *words: str) -> None:
        self._process = subprocess.Popen(
            ["ip", "netns", "exec", net.name(place), sys.executable, "-m", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        self._said: queue.SimpleQueue[tuple[float, str]] = queue.SimpleQueue()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._said.put((time.monotonic(), line.strip()))

    def await_line(self, *starts: str) -> float:
        """When a line came that begins with one of ``starts``."""
        while True:
            at_s, line = self._said.get(timeout=60)
            if line.startswith(starts):
                return at_s

    def ask(self, verb: str) -> dict[str, Any]:
        self.tell(verb)
        return self.answer()

    def tell(self, verb: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(verb + "\n")

    def answer(self) -> dict[str, Any]:
        said: dict[str, Any] = json.loads(self._said.get(timeout=60)[1])
        return said

    def close(self) -> None:
        self._process.terminate()
        self._process.wait(60)
        self._listener.join(60)  # it ends with the pipe
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.stdout.close()


@pytest.fixture
def net() -> Iterator[Net]:
    net = Net()
    try:
        net.lay()
    except (OSError, subprocess.CalledProcessError) as error:
        net.clear()
        pytest.skip(f"network namespaces are not allowed here (they need root and iproute2): {error}")
    yield net
    net.clear()


@pytest.mark.realtime  # deadlines over a network are wall time, whatever the load
def test_a_pick_over_four_machines_and_a_cut_cable(net: Net, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    make_keys(keys, [ROUTER])

    def as_(role: str, **more: object) -> list[str]:
        settings = {
            "bus.zenoh": keys / f"{role}.json5",
            "bus.stale_s": 10,  # a busy machine starves the node; the cut is noticed by the token, whatever this is
            "bus.ask_timeout_s": 20,  # so does opening its graphics
            "verify.hold_s": 0.5,
            "recording.folder": tmp_path / "recordings",
            **more,
        }
        return [word for key, value in settings.items() for word in ("--set", f"{key}={value}")] + ["--set", NODES]

    door = f"tls/{ROUTER}:7447"
    far = {"bus.endpoint": door}
    with ExitStack() as stack:

        def run(place: str, *words: str) -> Program:
            program = Program(net, place, *words)
            stack.callback(program.close)
            return program

        run("router", "cell", "router", "--config", str(keys / "router.json5")).await_line("router on")
        run("node", "cell", "node", "sim", *as_("node", **far))
        cell = run("cell", "cell", "start", "--no-report", *as_("cell", **{"bus.router": door}))
        operator = run("desk", "stand_ins.desk", *as_("operator", **far))
        cell.await_line("ready")
        _await_node(operator)

        _reset(operator)
        assert operator.ask("pick")["result"] == "SUCCESS"
        (member,) = operator.ask("fleet")["fleet"]
        assert (member["cell_id"], member["state"]["state"], member["is_healthy"]) == ("sim", "Complete", True)

        _reset(operator)
        operator.tell("pick")
        cell.await_line("SUCCESS")  # the first pick's
        cell.await_line("detect ")
        cut_s = time.monotonic()
        net.cut("node")
        noticed_s = cell.await_line("Aborting") - cut_s
        assert noticed_s < 8.0  # by the lease of 1 s, and not by the silence; the rest is a busy machine
        assert operator.answer()["result"] == "ABORTED"
        cell.await_line("Aborted")

        net.plug("node")
        _await_node(operator)
        aborted = operator.ask("state")
        assert (aborted["state"], "'sim'" in aborted["reason"]) == ("Aborted", True), aborted
        assert operator.ask("clear")["state"] == "Stopped"
        _reset(operator)


def _reset(operator: Program) -> None:
    """Until the cell is Idle. A node that a busy machine starves beyond its lease of 1 s is lost, and comes back."""
    said: dict[str, Any] = {}
    for _ in range(3):
        said = operator.ask("reset")
        if said.get("state") == "Idle":
            return
        _await_node(operator)
        operator.ask("clear")
    pytest.fail(f"not Idle after three resets: {said}")


def _await_node(operator: Program) -> None:
    give_up_s = time.monotonic() + 60
    while "error" in (said := operator.ask("health")) or not said["is_healthy"]:
        assert time.monotonic() < give_up_s, said
        time.sleep(0.1)

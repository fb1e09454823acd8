"""An FR3 with its hand, simulated by franka-sim in strict mode: every limit and the 1 kHz deadline are enforced.

``python -m stand_ins.franka`` runs one until Ctrl-C. It listens on libfranka's ports: 1337 (arm), 1338 (hand).
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from config.hardware import Fr3Settings, PandaHandSettings
from config.schema import Station

ADDRESS = "127.0.0.1"
_ROOT = Path(__file__).parents[1]
PYTHON = _ROOT / ".venv-franka-sim" / "bin" / "python"
_PORTS = (1337, 1338)
_START_S = 60.0
_STOP_S = 8.0


def missing() -> str | None:
    """Return why no FR3 can be simulated and driven here, or None."""
    if not PYTHON.exists():
        return f"{PYTHON.parent.parent.name} is missing: `just stand-ins` makes it"
    absent = [name for name in ("pylibfranka", "franky") if find_spec(name) is None]
    return f"{', '.join(absent)} is not installed: `just stand-ins` does it (Python 3.11 or 3.12)" if absent else None


def franka_station(station: Station, stack: ExitStack, **simulated: Any) -> Station:
    """``station`` with its arm and hand at a simulator that runs as long as ``stack``; skips the test without one."""
    why = missing()
    if why is not None:
        pytest.skip(f"no FR3: {why}")
    stack.enter_context(FrankaSim(**simulated))
    arm = Fr3Settings(address=ADDRESS, realtime="ignore")
    return station.model_copy(update={"fr3": arm, "panda_hand": PandaHandSettings(address=ADDRESS)})


class FrankaSim:
    """The simulator as a process; a context manager. Its log is kept in ``log``.

    Args:
        object_width_m: of a virtual object between the fingers; None = they close on nothing.
    """

    def __init__(self, object_width_m: float | None = None) -> None:
        self._object_width_m = object_width_m
        self._folder = tempfile.TemporaryDirectory(prefix="franka-sim-")
        self.log = Path(self._folder.name) / "log.txt"
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> FrankaSim:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._folder.cleanup()

    def start(self) -> None:
        """Start, and wait until arm and hand can be connected to."""
        assert not any(_listening(port) for port in _PORTS), f"another FR3 already listens on {_PORTS}"
        arm, hand = _model_files(Path(self._folder.name))
        command = [str(PYTHON), str(Path(__file__).with_name("franka_server.py"))]
        if self._object_width_m is not None:
            command += ["--object-width-m", str(self._object_width_m)]
        environment = {**os.environ, "FR3_MJCF": str(arm), "FRANKA_HAND_MJCF": str(hand), "MUJOCO_GL": "disabled"}
        environment["PYTHONDONTWRITEBYTECODE"] = ""  # what it imports is compiled by the first start only
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                command, env=environment, stdout=log, stderr=log, cwd=self._folder.name, start_new_session=True
            )
        give_up_s = time.monotonic() + _START_S
        while not all(_listening(port) for port in _PORTS):
            if self._process.poll() is not None or time.monotonic() > give_up_s:
                raise RuntimeError(f"franka-sim did not start:\n{self.log.read_text()[-2000:]}")
            time.sleep(0.05)

    def stop(self) -> None:
        """End it in order."""
        self._end(signal.SIGINT)

    def kill(self) -> None:
        """End it as a power cut would."""
        self._end(signal.SIGKILL)

    def _end(self, how: signal.Signals) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        process.send_signal(how)
        try:
            process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _listening(port: int) -> bool:
    """Looked up, not tried: the server takes one client at a time, and a probe would be it."""
    entries = (line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:])
    return any(entry[1].endswith(f":{port:04X}") and entry[3] == "0A" for entry in entries)


def _model_files(folder: Path) -> tuple[Path, Path]:
    """The arm alone, and the hand alone, as franka-sim wants them."""
    assets = Path(str(files("franky_sim"))) / "assets"
    arm, hand = folder / "arm.xml", folder / "hand.xml"
    for path, write in ((arm, _arm_alone), (hand, _hand_alone)):
        tree = ElementTree.parse(assets / "fr3.xml")
        root = tree.getroot()
        compiler = root.find("compiler")
        assert compiler is not None
        compiler.set("meshdir", str(assets / "meshes"))
        write(root)
        _drop_looks(root)
        tree.write(path)
    return arm, hand


def _arm_alone(root: ElementTree.Element) -> None:
    link7 = _only(root, ".//body[@name='fr3_link7']")
    link7.remove(_only(link7, "body[@name='hand']"))
    ElementTree.SubElement(link7, "site", name="attachment_site", pos="0 0 0.107")
    _drop(root, "tendon", "equality", "keyframe")
    _drop_meshes(root, ("hand_", "finger_"))
    actuators = _only(root, "actuator")
    actuators.remove(_only(actuators, "*[@name='hand']"))


def _hand_alone(root: ElementTree.Element) -> None:
    world, hand = _only(root, "worldbody"), _only(root, ".//body[@name='hand']")
    for child in list(world):
        world.remove(child)
    hand.attrib.pop("pos")
    hand.set("quat", "0 0 0 1")
    hand.set("childclass", "fr3")
    world.append(hand)
    _drop(root, "contact", "keyframe")
    _drop_meshes(root, ("link",))
    actuators = _only(root, "actuator")
    for actuator in list(actuators):
        if actuator.get("name") != "hand":
            actuators.remove(actuator)


def _only(root: ElementTree.Element, path: str) -> ElementTree.Element:
    (found,) = root.findall(path)
    return found


def _drop(root: ElementTree.Element, *names: str) -> None:
    for name in names:
        for element in root.findall(name):
            root.remove(element)


def _drop_looks(root: ElementTree.Element) -> None:
    """Nobody looks at it: without the meshes of its looks it starts a second sooner."""
    for body in root.iter("body"):
        for geom in body.findall("geom[@class='visual']"):
            body.remove(geom)
    touched = {geom.get("mesh") for geom in root.iter("geom")}
    assets = _only(root, "asset")
    for mesh in assets.findall("mesh"):
        if mesh.get("name", Path(mesh.get("file", "")).stem) not in touched:
            assets.remove(mesh)


def _drop_meshes(root: ElementTree.Element, prefixes: tuple[str, ...]) -> None:
    assets = _only(root, "asset")
    for mesh in assets.findall("mesh"):
        if mesh.get("name", mesh.get("file", "")).startswith(prefixes):
            assets.remove(mesh)


if __name__ == "__main__":
    with FrankaSim() as sim:
        print(f"FR3 and hand on {ADDRESS}, ports {_PORTS}; log {sim.log}; Ctrl-C ends", file=sys.stderr)  # noqa: T201
        signal.sigwait({signal.SIGINT, signal.SIGTERM})

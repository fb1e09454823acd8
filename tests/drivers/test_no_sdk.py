"""Nobody needs the SDK of a device that they do not own."""

from __future__ import annotations

import subprocess
import sys

SDKS = ("pylibfranka", "franky", "pyorbbecsdk")


def test_importing_every_driver_imports_no_vendor_s_sdk() -> None:
    imports = (
        "import drivers.fr3.arm, drivers.fr3.loop, drivers.panda_hand.hand, "
        "drivers.femto_mega.camera, drivers.node.registry"
    )
    found = f"import sys; print(sorted(set(sys.modules) & set({SDKS!r})))"
    said = subprocess.run([sys.executable, "-c", f"{imports}\n{found}"], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


def test_without_an_sdk_connecting_says_how_to_install_it() -> None:
    script = """
import sys
for name in ("pylibfranka", "franky", "pyorbbecsdk"):
    sys.modules[name] = None
from bus.errors import DriverUnavailable
from config.load import load_station
from drivers.femto_mega.camera import FemtoMega
from drivers.fr3.loop import open_loop
from drivers.panda_hand.hand import PandaHand
station = load_station(overrides=["femto_mega.address=127.0.0.1", "fr3.realtime=ignore"])
for connect in (FemtoMega(station.femto_mega).connect, PandaHand(station).connect,
                lambda: open_loop(station.fr3, None, lambda: False)):
    try:
        connect()
    except DriverUnavailable as error:
        print(error.advice)
"""
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert said.stdout.count("uv pip install 'vlad-cell[femto]'") == 1
    assert said.stdout.count("uv pip install 'vlad-cell[fr3]'") == 2

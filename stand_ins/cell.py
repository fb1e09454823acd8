"""The lab's whole cell against stand-ins: ``python -m stand_ins.cell [arguments of cell start]``.

Starts the strict FR3 with its hand and the camera that sees the simulated table, then the cell of
``config/stand_in.toml``. Ctrl-C ends all of it.
"""

from __future__ import annotations

import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

from config.load import load_station
from stand_ins.femto_mega.process import FakeFemtoMega
from stand_ins.franka import FrankaSim, missing

STATION = Path("config/stand_in.toml")


def stand_ins(stack: ExitStack, endpoint: str) -> None:
    """Start what the cell at ``endpoint`` will talk to; it ends with ``stack``."""
    station = load_station(STATION)
    assert station.femto_mega.address is not None
    stack.enter_context(FrankaSim())
    arguments = (endpoint, station.cell_id)
    stack.enter_context(FakeFemtoMega(station.femto_mega.address, "stand_ins.mirror", *arguments))


def main(arguments: list[str]) -> int:
    why = missing()
    if why is not None:
        print(why, file=sys.stderr)  # noqa: T201
        return 2
    with ExitStack() as stack:
        stand_ins(stack, load_station(STATION).bus.endpoint)
        command = [sys.executable, "-m", "cell", "start", "--config", str(STATION), *arguments]
        try:
            return subprocess.run(command, check=False).returncode
        except KeyboardInterrupt:
            return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

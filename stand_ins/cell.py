"""The lab's whole cell against stand-ins: ``python -m stand_ins.cell [arguments of cell start]``.

Starts the strict FR3 with its hand and the camera that sees the simulated table, then the cell of
``config/stand_in.toml``. Ctrl-C ends all of it. The fingers close on air: a cycle that ends GRASP_MISSED is right.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

from bus.codes import Code
from config.load import load_station
from logs.mcap.index import read_entry, recordings
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
        known, command = recorded(arguments), [sys.executable, "-m", "cell", "start", "--config", str(STATION)]
        try:
            status = subprocess.run([*command, *arguments], check=False).returncode
        except KeyboardInterrupt:
            return 130
        return judged(status, [read_entry(path).code for path in recorded(arguments) - known])


def recorded(arguments: list[str]) -> set[Path]:
    """The recordings that are there, in the folder that the arguments of `cell start` may name."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--set", action="append", default=[])
    folder = load_station(STATION, parser.parse_known_args(arguments)[0].set).recording.folder
    return set(recordings(folder)) if folder.is_dir() else set()


def judged(status: int, codes: list[str]) -> int:
    """The exit status, from that of `cell start` and the codes of its cycles: 0 where each closed on air."""
    if status != 1 or set(codes) != {Code.GRASP_MISSED}:
        return status
    print(f"{Code.GRASP_MISSED} is right here: the fingers of a stand-in close on air. All the rest has worked.")  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

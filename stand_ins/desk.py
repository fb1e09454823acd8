"""An operator's program: each line on stdin is a command; each line on stdout is the cell's state or the refusal.

``fleet`` uses the viewer's certificate.

Usage: python -m stand_ins.desk --set key=value ...
"""

from __future__ import annotations

import json
import sys
from typing import Any

from bus.errors import CellError
from cell import client
from cell.cli.network.fleet import fleet
from cell.client import Client
from cell.machine.states import SETTLED
from config.load import load_station
from config.schema import Station


def _obey(cell: Client, station: Station, verb: str) -> dict[str, Any]:
    if verb == "fleet":
        assert station.bus.zenoh is not None
        bus = station.bus.model_copy(update={"zenoh": station.bus.zenoh.with_name("viewer.json5")})
        return {"fleet": [member.to_json() for member in fleet(station.model_copy(update={"bus": bus}))]}
    if verb in ("health", "state"):
        return (cell.health() if verb == "health" else cell.state()).model_dump(mode="json")
    reply = cell.command(verb)
    if verb == "pick":
        return cell.wait_for_result(reply.cycle_id, 60.0).model_dump(mode="json")
    return cell.wait_for_state(set(SETTLED), 60.0).model_dump(mode="json")


def main() -> None:
    station = load_station(None, sys.argv[2::2])
    with client.connect(station) as cell:
        for line in sys.stdin:
            try:
                said = _obey(cell, station, line.strip())
            except CellError as error:
                said = {"error": error.code, "text": str(error)}
            sys.stdout.write(json.dumps(said) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()

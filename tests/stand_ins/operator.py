"""An operator's program: each line on stdin is a verb; each line on stdout how the cell then is, or why it refused.

Usage: python -m tests.stand_ins.operator --set key=value ...
"""

from __future__ import annotations

import json
import sys
from typing import Any

from bus.errors import CellError
from cell import client
from cell.client import Client
from config.load import load_station

_SETTLED = {"Stopped", "Idle", "Complete", "Aborted"}


def _obey(cell: Client, verb: str) -> dict[str, Any]:
    if verb in ("health", "state"):
        return (cell.health() if verb == "health" else cell.state()).model_dump(mode="json")
    reply = cell.command(verb)
    if verb == "pick":
        return cell.wait_for_result(reply.cycle_id, 60.0).model_dump(mode="json")
    return cell.wait_for_state(_SETTLED, 60.0).model_dump(mode="json")


def main() -> None:
    with client.connect(load_station(None, sys.argv[2::2])) as cell:
        for line in sys.stdin:
            try:
                said = _obey(cell, line.strip())
            except CellError as error:
                said = {"error": error.code, "text": str(error)}
            sys.stdout.write(json.dumps(said) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()

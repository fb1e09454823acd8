"""Picks from Python. Usage: python pick_from_python.py [ENDPOINT [TARGET]]; without any, in a simulated cell."""

import sys

from vlad_cell import Cell, CellError, simulated_cell

endpoint, target = [*sys.argv[1:], "", ""][:2]
try:
    with Cell(endpoint) if endpoint else simulated_cell() as cell:
        if cell.state().state != "Idle":
            cell.reset()
        # While this program runs, the arm moves for it; when it ends, or the `with` does, motion is held.
        result = cell.pick(target or None, job_id="from-python", progress=print)
except CellError as error:  # refused, or nobody listens
    sys.exit(f"{error.code}: {error}")
print(result.result, result.code or "", result.reason, result.advice)
print(result.recording)

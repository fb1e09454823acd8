"""Writes docs/faults.md from the table in cell/daemon/fault_table.py: ``uv run python -m docs.faults_page``."""

from __future__ import annotations

from pathlib import Path

from bus.codes import ADVICE, Code
from bus.fault_injection import PARTS
from cell.daemon.fault_table import ROWS, Row

PAGE = Path(__file__).with_name("faults.md")


def page() -> str:
    """The page's text."""
    return "\n".join(
        [
            "# Faults",
            "",
            "<!-- Written by docs/faults_page.py from cell/daemon/fault_table.py; do not edit. -->",
            "",
            "What the cell does when a part of it misbehaves. Each row is a test, and `benchmarks soak` injects them",
            "at random. `off`: not there; `stuck`: nothing comes of what is asked; `garbage`: impossible values;",
            "`wrong`: plausible but wrong values; `slow`: everything late. `node` is a driver node's process;",
            "`http` and `opcua` are doors, of cycles that a client attends through them: `client`: that program is",
            "killed, `taken`: the door is killed, and another program takes its port. Without such a client a cycle",
            "goes on, whatever becomes of a door.",
            "",
            "The times of `[bus]` are wall time where anything is real. A cell that is simulated on one machine waits",
            "for that machine: where a second of work takes 20 s, because much else runs, so does a second of",
            "`stale_s`. A process that a signal has halted is lost after 1 s all the same. A deadline that ends a",
            "cycle says how busy the machine was: `This machine is too busy: load 14.0 on 2 cores, and a second of",
            "work takes 20 s.`",
            "",
            "To see it yourself, on the simulated cell: `cell start --set faults.allowed=true`, then",
            f"`cell fault PART WORD` (and `cell fault PART none`), of {', '.join(PARTS)}. `node`, `http` and",
            "`opcua` are processes: end or halt one with `kill`. Where faults are not allowed, the default, nothing",
            "is wrapped and nobody listens. `[faults]` of a station sets a part's word from the start. **An arm that",
            "is `wrong` moves elsewhere than planned**: never with anybody or anything in a real arm's reach.",
            "",
            "After a fault nothing moves by itself. What is Aborted becomes ready by `cell clear` and `cell reset`,",
            "once the part is well again; nothing else needs to be restarted.",
            "",
            "What is not where the cell believes it to be - a table that is higher, a thing under the hand that was",
            "hidden - is no fault of a part: the arm feels it on its approach, and the pick goes on or ends FAILED",
            f"`{Code.CONTACT}` ([planning.md](planning.md#choosing)). {ADVICE[Code.CONTACT]}",
            "",
            "| part | is | sets in at | cycle | the cell | advice to the operator |",
            "|---|---|---|---|---|---|",
            *(_row(row) for row in ROWS),
            "",
        ]
    )


def _row(row: Row) -> str:
    outcome = row.result if row.code is None else f"{row.result} `{row.code}`"
    does = f"{row.does} {row.then}".strip()
    return f"| {row.part} | {row.word} | {row.sets_in} | {outcome} | {does} | {row.advice} |"


if __name__ == "__main__":
    PAGE.write_text(page())

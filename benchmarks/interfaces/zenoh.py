"""The time from a command to its acceptance, over the bus: jobs that wait for their turn, and are cancelled again."""

from __future__ import annotations

import time
from typing import Any

from benchmarks.interfaces.spread import spread_ms
from bus.messages import Job
from cell.client import Client


def accept_ms(cell: Client, commands: int) -> dict[str, Any]:
    """Return the spread of the acceptance of so many jobs by a cell that works meanwhile [ms].

    Raises: Refused when the cell does not work, or its queue is full.
    """
    took_s: list[float] = []
    for number in range(commands):
        job = Job(job_id=f"measured-{number}", queue=True)
        asked_s = time.perf_counter()
        cell.command("pick", job=job)
        took_s.append(time.perf_counter() - asked_s)
        cell.command("cancel", job=job)
    return spread_ms(took_s)

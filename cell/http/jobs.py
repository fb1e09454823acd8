"""The jobs of the cell: those sent through this interface, and the one that it works at."""

from __future__ import annotations

import json
from typing import Any

from bus.commands import CellState, CommandReply, CommandRequest
from bus.messages import Attempt, Job

_KEPT = 256
"""Jobs whose content is remembered."""


class Jobs:
    """Knows jobs by their ids. Its members are called on one thread."""

    # The state names ids only; the cell says what a job is about when it begins (`topics.ATTEMPT`).

    def __init__(self) -> None:
        self._about: dict[str, dict[str, Any]] = {}

    def sent(self, verb: str, request: CommandRequest, reply: CommandReply) -> None:
        """A ``pick`` or ``start`` was accepted."""
        if verb not in ("pick", "start"):
            return
        many = {"cycles": request.cycles, "until_empty": request.until_empty} if verb == "start" else {}
        self._keep(reply.job_id, _about(request.job) | many)

    def begun(self, attempt: Attempt) -> None:
        """A cycle began, of this job."""
        self._keep(attempt.job.job_id, self._about.get(attempt.job.job_id, {}) | _about(attempt.job))

    def of(self, state: CellState) -> str:
        """Return the jobs of a state as JSON: by id, what is known of the one under way and of those that wait."""
        ids = filter(None, (state.job_id, *state.queue))
        return json.dumps({job_id: self._about[job_id] for job_id in ids if job_id in self._about})

    def _keep(self, job_id: str, about: dict[str, Any]) -> None:
        self._about.pop(job_id, None)
        self._about[job_id] = about
        while len(self._about) > _KEPT:
            del self._about[next(iter(self._about))]


def _about(job: Job) -> dict[str, Any]:
    return job.model_dump(mode="json", include={"target", "place"})

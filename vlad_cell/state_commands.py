"""The commands that change a cell's state, each with a wait until it has: reset, stop, abort, clear, hold, unhold."""

from __future__ import annotations

from bus.commands import CellState
from bus.errors import NotReached
from bus.messages import Job
from cell.client import LEADS_TO
from cell.machine.states import ENDED, told
from vlad_cell.connection import Connection
from vlad_cell.said import attended


class StateCommands(Connection):
    """The part of a `Cell` that commands states."""

    def reset(self, timeout_s: float = 60.0) -> CellState:
        """Check the cell, and move the arm to the capture pose; returns when it is Idle.

        Raises: Refused in another state than Stopped or Complete; NotReached when it ended elsewhere; BusError.
        """
        return self._carry_out("reset", timeout_s, "Idle")

    def stop(self, timeout_s: float = 60.0) -> CellState:
        """Brake on the path, and confirm the rest; returns when the cell is Stopped. Raises: Refused, BusError."""
        return self._carry_out("stop", timeout_s, "Stopped")

    def abort(self, timeout_s: float = 60.0) -> CellState:
        """Brake now; returns when the cell is Aborted. Then `clear` and `reset`. Raises: Refused, BusError."""
        return self._carry_out("abort", timeout_s, "Aborted")

    def clear(self, timeout_s: float = 60.0) -> CellState:
        """Acknowledge an abort; returns when the cell is Stopped. Raises: Refused, NotReached, BusError."""
        return self._carry_out("clear", timeout_s, "Stopped")

    def hold(self, timeout_s: float = 60.0) -> CellState:
        """Pause a running cycle; returns when it is Held. Raises: Refused, NotReached, BusError."""
        return self._carry_out("hold", timeout_s)

    def unhold(self, timeout_s: float = 60.0) -> CellState:
        """Go on with a held cycle; returns when it runs. Raises: Refused, NotReached, BusError."""
        return self._carry_out("unhold", timeout_s)

    def cancel(self, job_id: str) -> None:
        """Cancel the job ``job_id``, as long as the arm has not set out for its grasp. Raises: Refused, BusError."""
        self._client.command("cancel", job=Job(job_id=job_id))

    def _carry_out(self, verb: str, timeout_s: float, wanted: str = "") -> CellState:
        with attended(self._client):
            self._client.command(verb)
            state = self._client.wait_for_state({*LEADS_TO[verb], *ENDED}, timeout_s)
        if state.state != wanted if wanted else state.state not in LEADS_TO[verb]:
            why = told(state.state, state.reason)
            raise NotReached(f"After {verb} the cell is {state.state}: {why}", "See `cell status`.")
        return state

    def release(self) -> None:
        """Give the lease back, so that others may command; motion that still continues is held. Idempotent."""
        self._client.release()

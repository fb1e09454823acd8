"""Answers what is asked over the bus: commands, and questions about the state, a result, a plan, a picture."""

from __future__ import annotations

from collections.abc import Callable

from bus import topics
from bus.codec import bus_schema, decode
from bus.commands import CellHealth, CommandRequest, ResultRequest
from bus.errors import BadPayload, Refused
from bus.frozen import Message
from bus.messages import PictureRequest
from bus.sample import Asked
from bus.session import Bus
from cell.daemon.unit import Unit
from cell.machine.leases import CELL_CLIENT, Leases
from cell.machine.owner import refuse
from cell.machine.states import MANUAL_MOTIONS
from cell.pick.plan_view import PlanViews

_ANYONES = ("stop", "abort", "hold", "suspend")
_LONGEST_COMMAND = 64 * 1024


class Answers:
    """Answers for a unit.

    Args:
        leases: who may command motion. ``plan_views``: draws the last plan. ``health``: gives the cell's health.
    """

    def __init__(
        self, bus: Bus, unit: Unit, leases: Leases, plan_views: PlanViews, health: Callable[[], CellHealth]
    ) -> None:
        self._bus, self._unit, self._leases, self._plan_views, self._health = bus, unit, leases, plan_views, health

    def begin(self) -> None:
        """Begin to answer."""
        bus = self._bus
        # first, so that whoever has the state reaches the commands, too: `Client.send` relies on it
        bus.answer(topics.COMMAND, self._on_command, worker=self._worker_of, verb="*")
        bus.answer(topics.STATE_NOW, lambda _payload, _asked: self._unit.publisher.state, worker="state")
        bus.answer(topics.HEALTH_NOW, lambda _payload, _asked: self._health(), worker="state")
        bus.answer(topics.RESULT_NOW, self._on_result_asked, worker="state")
        bus.answer(topics.PROPOSAL_NOW, self._on_proposal_asked, worker="state")
        bus.answer(topics.PLAN_NOW, lambda _payload, _asked: self._plan_views.now(), worker="plan")
        bus.answer(topics.PICTURE_NOW, self._on_picture_asked, worker="picture")
        bus.answer(topics.SCHEMA_NOW, lambda _payload, _asked: bus_schema(), worker="schema")

    def _on_command(self, payload: bytes, asked: Asked) -> Message:
        request, verb = decode(CommandRequest, payload), asked.verb
        if request.client_id == CELL_CLIENT:
            raise Refused(f"The client id {CELL_CLIENT!r} is the cell's own.", "Send another.", code="BAD_CLIENT")
        self._leases.require(verb, request.client_id, asked.received_s)
        reply = self._unit.machine.command(verb, request)
        refuse(reply)
        if verb in MANUAL_MOTIONS:
            self._unit.manual.run(verb, request)
        lease = self._leases.take(verb, request.client_id, asked.source)
        return reply.model_copy(update={"lease": lease, "since_ns": self._unit.publisher.state.since_ns})

    def _worker_of(self, asked: Asked, payload: bytes) -> str:
        """Return the worker for a command, so that a stop waits for no other command.

        Commands whose token is still awaited have a worker of their own, so that no other command waits for them.
        """
        if asked.verb in _ANYONES:
            return "command-stop"
        try:
            client_id = decode(CommandRequest, payload).client_id if len(payload) < _LONGEST_COMMAND else ""
        except BadPayload:
            return "command-refused"
        return "command-awaited" if self._leases.must_wait(asked.verb, client_id) else "command"

    def _on_result_asked(self, payload: bytes, _asked: Asked) -> Message:
        cycle_id = decode(ResultRequest, payload).cycle_id
        result = self._unit.result(cycle_id)
        if result is None:
            text = f"There is no result of a cycle {cycle_id!r}: it is not over, or was not one of the last."
            raise Refused(text, "Recorded ones: `cell cycles`.", code="NO_RESULT")
        return result

    def _on_picture_asked(self, payload: bytes, _asked: Asked) -> Message:
        return self._unit.pictures.now(decode(PictureRequest, payload))

    def _on_proposal_asked(self, _payload: bytes, _asked: Asked) -> Message:
        waiting = self._unit.actions.approvals.waiting
        if waiting is None:
            raise Refused(
                "No planned motion waits for an answer.",
                "A cycle asks in its stage `approve`, where execute.approve is not 'no'.",
                code="NO_PROPOSAL",
            )
        return waiting

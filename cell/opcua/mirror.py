"""Writes what the cell says into the variables, and sends it as events."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

from bus import topics
from bus.codec import decode
from bus.codes import Code
from bus.commands import CellHealth, CellState, Event
from bus.errors import BadPayload, BusError, Refused
from bus.frozen import Message
from bus.messages import CycleResult, Proposal
from bus.sample import Sample
from cell.client import Client
from cell.machine.states import NEXT, State
from cell.opcua import packml
from cell.opcua.address_space import AddressSpace
from cell.opcua.structures import PackMLAlarmDataType, alarm, count, utc_of

_log = logging.getLogger(__name__)
HEARS = (topics.EVENT, topics.HEALTH, topics.PROPOSAL)
"""Topics that the client of a mirror must subscribe to besides states and results."""
_TYPES: dict[str, type[Message]] = {
    topics.STATE.key: CellState,
    topics.RESULT.key: CycleResult,
    topics.EVENT.key: Event,
    topics.HEALTH.key: CellHealth,
    topics.PROPOSAL.key: Proposal,
}
_LOOK_S = 0.5
_KEPT_ALARMS = 20
_SEVERITIES = {"info": 0, "warning": 1, "error": 2}
_OPCUA_SEVERITIES = (100, 500, 800)
_AT_REST_FOR_A_REASON = {State.STOPPING, State.ABORTING, State.HOLDING, State.SUSPENDING}


class Mirror:
    """The cell's last words. Everything here runs on the server's event loop; only the waiting is in a thread."""

    def __init__(self, space: AddressSpace, viewer: Client) -> None:
        self._space, self._viewer = space, viewer
        self._waiting = ThreadPoolExecutor(1, "opcua-mirror")
        self._processed = self._defective = 0
        self._history: deque[PackMLAlarmDataType] = deque(maxlen=_KEPT_ALARMS)
        self._state = ""

    async def begin(self) -> None:
        """Show the state and health of now. Raises: BusError."""
        await self._space.write({"Admin.AlarmExtent": 1, "Admin.AlarmHistoryExtent": _KEPT_ALARMS})
        await self._space.write({"Admin.Alarm": [], "Admin.AlarmHistory": []})
        await self._count()
        await self._show_health(await self._ask(self._viewer.health))
        with suppress(Refused):  # none waits
            await self._show_proposal(await self._ask(self._viewer.proposal))
        await self._show_state(await self._ask(self._viewer.state))

    async def run(self) -> None:
        """Show everything that comes, until cancelled; a cell that is silent is asked."""
        while True:
            sample = await self._ask(self._viewer.next_heard, _LOOK_S)
            if sample is not None:
                await self._hear(sample)
            elif self._viewer.is_gone:
                await self._space.write({"Connected": False})
            else:
                await self._look()

    def close(self) -> None:
        """End the thread that waits."""
        self._waiting.shutdown(wait=False, cancel_futures=True)

    async def _ask(self, what: Any, *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._waiting, what, *arguments)

    async def _look(self) -> None:
        """Ask for the state, and what waits for approval: a message may be lost, or the cell was started again.

        Messages that came meanwhile are shown instead: an answer may overtake what was said before it.
        """
        proposal = None
        try:
            state = await self._ask(self._viewer.state)
            if state.stage == "approve":
                with suppress(Refused):  # it was answered meanwhile
                    proposal = await self._ask(self._viewer.proposal)
        except BusError:
            await self._space.write({"Connected": False})
            return
        if (sample := await self._ask(self._viewer.next_heard, 0)) is not None:
            await self._hear(sample)
            return
        if proposal is not None:
            await self._show_proposal(proposal)
        await self._show_state(state)

    async def _hear(self, sample: Sample) -> None:
        said = None
        with suppress(BadPayload):  # of a stranger, or of another version
            said = decode(_TYPES[sample.key], sample.payload) if sample.key in _TYPES else None
        if isinstance(said, CellState):
            await self._show_state(said)
        elif isinstance(said, CycleResult):
            await self._show_result(said)
        elif isinstance(said, Event):
            await self._show_event(said)
        elif isinstance(said, CellHealth):
            await self._show_health(said)
        elif isinstance(said, Proposal):
            await self._show_proposal(said)

    async def _show_state(self, said: CellState) -> None:
        if said.state not in packml.STATES:
            _log.warning("not shown: %.40r is no state", said.state)
            return
        state = State(said.state)
        is_new, self._state = self._state != said.state, said.state
        since = utc_of(said.since_ns)
        if is_new and said.reason and state in _AT_REST_FOR_A_REASON:
            reason = alarm(state.upper(), said.reason, 2, is_active=False, when=since)
            await self._space.write({"Admin.StopReason": reason, "Admin.StopReasonText": said.reason})
        if is_new:
            aborted = [alarm("ABORTED", said.reason, 2, is_active=True, when=since)]
            await self._space.write({"Admin.Alarm": aborted if state is State.ABORTED else []})
        if said.stage != "approve":
            await self._space.write({"Proposal.Id": "", "Proposal.Json": ""})
        if state is State.STARTING:
            await self._space.write({"Status.EquipmentStarved": False})
        requested = State(NEXT.get(state, state))
        await self._space.write(
            {
                "Status.Stage": said.stage,
                "Status.Reason": said.reason,
                "Status.Since": since,
                "Status.Available": list(said.available),
                "Status.CycleId": said.cycle_id,
                "Status.JobId": said.job_id,
                "Status.Queue": list(said.queue),
                "Status.StateRequested": packml.STATES[requested].number,
                "Status.StateChangeInProcess": state in NEXT and state is not State.EXECUTE,
            }
        )
        if is_new:
            await self._space.write_current_states(packml.current_states(state))
        # last: who sees the state sees the rest of it, too
        await self._space.write({"Status.StateName": said.state, "Status.StateCurrent": packml.STATES[state].number})
        await self._space.write({"Connected": True})

    async def _show_result(self, result: CycleResult) -> None:
        code = result.code.value if result.code is not None else ""
        if not result.retried_as and result.result != "EMPTY":
            self._processed += 1
            self._defective += result.result != "SUCCESS"
            await self._count()
        is_starved = result.result == "EMPTY" or result.code is Code.NO_OBJECT
        speed = 60 / result.wall_s if result.wall_s > 0 else 0.0
        shown = {
            "CycleId": result.cycle_id,
            "JobId": result.job.job_id,
            "Result": result.result,
            "Code": code,
            "Reason": result.reason,
            "Json": result.model_dump_json(),
        }
        await self._space.write({"Status.EquipmentStarved": is_starved, "Status.CurMachSpeed": speed})
        await self._space.write({f"Result.{name}": value for name, value in shown.items()})
        await self._space.write(
            {
                "Result.Advice": result.advice,
                "Result.RetriedAs": result.retried_as,
                "Result.Object": result.object,
                "Result.Found": result.found.text if result.found is not None else "",
                "Result.Place": result.laid.place if result.laid is not None else "",
                "Result.WallS": result.wall_s,
                "Result.Recording": result.recording,
            }
        )
        severity = _OPCUA_SEVERITIES[0 if result.result in ("SUCCESS", "EMPTY") else 1]
        text = " ".join(filter(None, (result.result, code, result.reason)))
        await self._space.tell("ResultEvent", text, severity, shown)

    async def _show_event(self, event: Event) -> None:
        severity = _SEVERITIES[event.severity]
        if severity > 0:
            self._history.appendleft(alarm(event.code, event.text, severity, is_active=False, when=datetime.now(UTC)))
            await self._space.write({"Admin.AlarmHistory": list(self._history)})
        fields = {"Code": event.code, "Advice": event.advice}
        await self._space.tell("CellEvent", event.text, _OPCUA_SEVERITIES[severity], fields)

    async def _show_health(self, health: CellHealth) -> None:
        await self._space.write({"Status.Healthy": health.is_healthy, "Status.Problems": health.problems})

    async def _show_proposal(self, proposal: Proposal) -> None:
        # the id last: who sees it sees the rest of it, too
        await self._space.write({"Proposal.Json": proposal.model_dump_json(), "Proposal.Id": proposal.proposal_id})

    async def _count(self) -> None:
        await self._space.write(
            {
                "Admin.Processed": self._processed,
                "Admin.Defective": self._defective,
                "Admin.ProdProcessedCount": [count("picks", self._processed)],
                "Admin.ProdDefectiveCount": [count("failed picks", self._defective)],
            }
        )

"""The questions of a client that command no motion: state, health, proposal, plan, picture; and faults to inject."""

from __future__ import annotations

from bus import topics
from bus.commands import CellHealth, CellState, Nothing
from bus.errors import CellUnreachable, NoReply, Refused, ReplyTimeout
from bus.fault_injection import Fault, FaultRequest, Part
from bus.messages import LivePicture, PictureRequest, PlanView, Proposal
from bus.session import Bus
from cell.machine.leases import CELL_CLIENT


class Questions:
    """The questions that a cell answers to anybody, each within the time it is given.

    Args:
        ask_timeout_s: longest wait for a reply.
    """

    def __init__(self, bus: Bus, ask_timeout_s: float) -> None:
        self._bus, self._timeout_s = bus, ask_timeout_s

    def state(self) -> CellState:
        """Return the machine's state now; what the cell said before it has been heard then.

        Raises: CellUnreachable where no cell of this name is; BusError.
        """
        try:
            state = self._bus.request(topics.STATE_NOW, Nothing(), CellState, timeout_s=self._timeout_s)
        except NoReply as error:
            if self._is_there():
                raise  # and it does not answer
            if self._bus.is_secured:  # its rules may hide it
                raise NoReply(
                    f"No cell {self._bus.cell_id!r} answers here.{self._bus.clock.busy_note()}",
                    "`cell fleet` with the same bus.endpoint and bus.zenoh lists those that do: name one with --set "
                    "cell_id. Where it lists none, none is there, or may not be asked with this certificate: "
                    "docs/security.md.",
                ) from error
            raise CellUnreachable(
                f"The cell {self._bus.cell_id!r} does not answer at this address: it still starts, or another runs "
                "there.",
                "Try again when it says `ready`; `cell fleet` lists the cells there: name the --config of one of them.",
            ) from error
        self._bus.await_heard()
        return state

    def _is_there(self) -> bool:
        """Whether a cell of this name is there; also where nobody says in time whether it is."""
        try:
            return CELL_CLIENT in self._bus.alive(topics.LEASE)
        except ReplyTimeout:
            return True

    def health(self) -> CellHealth:
        """Return the cell's health now, node by node. Raises: BusError."""
        return self._bus.request(topics.HEALTH_NOW, Nothing(), CellHealth, timeout_s=self._timeout_s)

    def proposal(self) -> Proposal:
        """Return the planned motion that waits for an answer. Raises: Refused (NO_PROPOSAL); BusError."""
        return self._bus.request(topics.PROPOSAL_NOW, Nothing(), Proposal, timeout_s=self._timeout_s)

    def plan_view(self) -> PlanView:
        """Return the last plan, to look at in 3-D. Raises: Refused (NO_PLAN); BusError."""
        return self._bus.request(topics.PLAN_NOW, Nothing(), PlanView, timeout_s=self._timeout_s)

    def picture(self, request: PictureRequest | None = None) -> LivePicture:
        """Return a picture of now. Raises: Refused (NOT_AT_REST, PICTURE_ELSEWHERE), StaleFrame; BusError."""
        request = request or PictureRequest()
        return self._bus.request(topics.PICTURE_NOW, request, LivePicture, timeout_s=self._timeout_s)

    def fault(self, part: Part, fault: Fault, delay_s: float | None = None) -> None:
        """Inject a fault into a part of the cell.

        Args:
            delay_s: lateness of a slow part; None = its default.

        Raises: Refused when fault injection is not allowed.
        """
        request = FaultRequest(fault=fault, delay_s=delay_s)
        try:
            self._bus.ask(topics.FAULT, request, timeout_s=self._timeout_s, part=part)
        except NoReply as error:
            raise Refused(
                f"Nobody lets the {part} be spoiled.",
                "Start the cell with --set faults.allowed=true; a node that is not up cannot be told either.",
                code="FAULTS_NOT_ALLOWED",
            ) from error

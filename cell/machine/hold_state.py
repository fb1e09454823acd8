"""The single owner of "is this cell held, and why?": the reason, and the gate that closes with it."""

from __future__ import annotations

from cell.machine.gate import Gate
from cell.machine.states import COMMANDS, State

_ENDING_ALL = ("stop", "abort")
_PAUSING = ("hold", "suspend")
_AFRESH = ("reset", "clear", "start", "pick")


class HoldState:
    """The hold state. Only the machine's owner thread changes it; any thread may read it.

    Attributes:
        gate: every motion passes it. A hold closes it, a stop halts it, an operator's new beginning clears it.
        reason: why the cell is held, or is to be held as soon as its state allows it; "" when it is not.
    """

    def __init__(self) -> None:
        self.gate = Gate()
        self.reason = ""

    def accept(self, verb: str, reason: str, *, is_own: bool) -> None:
        """Follow an accepted command; the cell's own commands between two picks (``is_own``) change nothing."""
        if verb in _ENDING_ALL:
            self.reason = ""
            self.gate.halt()
        elif verb in _PAUSING:
            self.close(reason)
        elif not is_own:
            self.reason = ""
            if verb in _AFRESH:
                self.gate.clear()

    def close(self, reason: str) -> None:
        """Let no further motion begin; the action of the state that follows holds the one under way."""
        self.reason = reason
        self.gate.hold()

    def is_due(self, state: State) -> bool:
        """True when the cell is to be held, is not yet held, and ``state`` allows it."""
        return self.reason != "" and not self.gate.held and state in COMMANDS["hold"]

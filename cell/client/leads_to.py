"""The states that each command leads to: a client waits for one of them."""

from __future__ import annotations

from collections.abc import Mapping

from cell.machine.states import SETTLED

RUNS_AGAIN = frozenset({"Execute", "Completing", "Complete", "Idle"})
"""States after a held cycle goes on; in the last two it ended shortly after."""
LEADS_TO: Mapping[str, frozenset[str]] = {
    "reset": SETTLED,
    "stop": SETTLED,
    "abort": SETTLED,
    "clear": SETTLED,
    "hold": frozenset({"Held"}),
    "unhold": RUNS_AGAIN,
    "suspend": frozenset({"Suspended"}),
    "unsuspend": RUNS_AGAIN,
}
"""Of each command without arguments, the states that it leads to; a client waits for one of them, or for an end."""

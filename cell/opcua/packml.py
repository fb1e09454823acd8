"""The PackML companion specification as tables: the names and node ids that we use of its namespace.

They are those of ``Opc.Ua.PackML.NodeSet2.xml`` 1.01 of the OPC Foundation (checked against that file by a test).
"""

from __future__ import annotations

from typing import NamedTuple

from cell.machine.states import State

NAMESPACE = "http://opcfoundation.org/UA/PackML/"
BASE_STATE_MACHINE, MACHINE_STATE, EXECUTE_STATE = "BaseStateMachine", "MachineState", "ExecuteState"

OBJECT_TYPES = {
    "PackMLBaseObjectType": 6,
    "PackMLStatusObjectType": 4,
    "PackMLAdminObjectType": 5,
    "PackMLBaseStateMachineType": 3,
    "PackMLMachineStateMachineType": 2,
    "PackMLExecuteStateMachineType": 1,
}
MODES, COUNT, ALARM = 11, 14, 15
DATA_TYPES = {"ProductionMaintenanceModeEnum": MODES, "PackMLCountDataType": COUNT, "PackMLAlarmDataType": ALARM}
BINARY_ENCODINGS = {COUNT: 69, ALARM: 74}
"""Data type -> its object "Default Binary"."""
PRODUCE = 1
"""Of `ProductionMaintenanceModeEnum`."""


class StateNode(NamedTuple):
    """A state of the specification.

    Attributes:
        number: PackML's. ``node``: of its object. ``number_node``: of its property ``StateNumber``.
        machine: the state machine that it is in.
    """

    number: int
    node: int
    number_node: int
    machine: str


STATES: dict[State, StateNode] = {
    State.CLEARING: StateNode(1, 55, 157, MACHINE_STATE),
    State.STOPPED: StateNode(2, 53, 155, MACHINE_STATE),
    State.STARTING: StateNode(3, 29, 129, EXECUTE_STATE),
    State.IDLE: StateNode(4, 28, 128, EXECUTE_STATE),
    State.SUSPENDED: StateNode(5, 31, 131, EXECUTE_STATE),
    State.EXECUTE: StateNode(6, 36, 136, EXECUTE_STATE),
    State.STOPPING: StateNode(7, 54, 156, MACHINE_STATE),
    State.ABORTING: StateNode(8, 61, 168, BASE_STATE_MACHINE),
    State.ABORTED: StateNode(9, 62, 169, BASE_STATE_MACHINE),
    State.HOLDING: StateNode(10, 33, 133, EXECUTE_STATE),
    State.HELD: StateNode(11, 34, 134, EXECUTE_STATE),
    State.UNHOLDING: StateNode(12, 35, 135, EXECUTE_STATE),
    State.SUSPENDING: StateNode(13, 30, 130, EXECUTE_STATE),
    State.UNSUSPENDING: StateNode(14, 32, 132, EXECUTE_STATE),
    State.RESETTING: StateNode(15, 27, 127, EXECUTE_STATE),
    State.COMPLETING: StateNode(16, 37, 137, EXECUTE_STATE),
    State.COMPLETE: StateNode(17, 38, 138, EXECUTE_STATE),
}
OUTER_STATES = {
    "Running": StateNode(18, 75, 171, MACHINE_STATE),
    "Cleared": StateNode(19, 71, 178, BASE_STATE_MACHINE),
}
"""The states of the outer machines while an inner one is in a state of its own."""

MACHINE_TYPES = {
    BASE_STATE_MACHINE: "PackMLBaseStateMachineType",
    MACHINE_STATE: "PackMLMachineStateMachineType",
    EXECUTE_STATE: "PackMLExecuteStateMachineType",
}

METHODS = {
    "Abort": (BASE_STATE_MACHINE, 364),
    "Clear": (BASE_STATE_MACHINE, 363),
    "Stop": (MACHINE_STATE, 375),
    "Reset": (EXECUTE_STATE, 361),
    "Start": (EXECUTE_STATE, 369),
    "Hold": (EXECUTE_STATE, 366),
    "Unhold": (EXECUTE_STATE, 368),
    "Suspend": (EXECUTE_STATE, 367),
    "Unsuspend": (EXECUTE_STATE, 372),
}
"""Method -> the state machine whose type declares it, and its node there. The type of MachineState declares Reset,
too: `RESET_OF_MACHINE_STATE`."""
RESET_OF_MACHINE_STATE = 376


def current_states(state: State) -> dict[str, str | None]:
    """Return the state of each of the three nested machines, by its object's name; None for one that does not run."""
    inner = STATES[state].machine
    return {
        BASE_STATE_MACHINE: state if inner == BASE_STATE_MACHINE else "Cleared",
        MACHINE_STATE: {BASE_STATE_MACHINE: None, MACHINE_STATE: state.value, EXECUTE_STATE: "Running"}[inner],
        EXECUTE_STATE: state if inner == EXECUTE_STATE else None,
    }


def node_of(state: str) -> int:
    """Return the node of a state by its name."""
    return (OUTER_STATES.get(state) or STATES[State(state)]).node

"""The variables of the cell's object: path below it, type, and whether the name is PackML's or ours.

Every variable is read-only. ``Count`` and ``Alarm`` are PackML's structures, ``[]`` marks arrays.
"""

from __future__ import annotations

from typing import NamedTuple


class Variable(NamedTuple):
    """One variable. ``path``: below the cell's object. ``is_packml``: its name is the specification's."""

    path: str
    kind: str
    is_packml: bool
    meaning: str


VARIABLES = (
    Variable("PackMLVersion", "String", True, "The edition of PackML."),
    Variable("TagID", "String", True, "The cell's id."),
    Variable("Connected", "Boolean", False, "This server hears the cell. Without it the values below are old."),
    Variable("Status.StateCurrent", "Int32", False, "PackML's number of the state."),
    Variable("Status.StateName", "String", False, "Its name."),
    Variable("Status.StateRequested", "Int32", True, "Number of the state that the present one leads to by itself."),
    Variable("Status.StateChangeInProcess", "Boolean", True, "The state ends by itself; Execute not counted."),
    Variable("Status.UnitModeCurrent", "Enumeration", True, "Always 1, Produce."),
    Variable("Status.UnitModeChangeInProcess", "Boolean", True, "Always false."),
    Variable("Status.UnitSupportedModes", "NodeId", True, "The enumeration of the modes."),
    Variable("Status.EquipmentStarved", "Boolean", True, "The last cycle found nothing to pick."),
    Variable("Status.EquipmentBlocked", "Boolean", True, "A pick was refused because its place is full."),
    Variable("Status.CurMachSpeed", "Float", True, "Picks a minute, by the time of the last cycle."),
    Variable("Status.MachSpeed", "Float", True, "Always 0: there is no set point."),
    Variable("Status.Stage", "String", False, "The stage of the running cycle."),
    Variable(
        "Status.Reason",
        "String",
        False,
        "Why the cell is in this state; at rest also what may be in the hand.",
    ),
    Variable("Status.Since", "DateTime", False, "When this state or stage began."),
    Variable("Status.Available", "String[]", False, "The commands that the cell accepts now."),
    Variable("Status.CycleId", "String", False, "The open cycle."),
    Variable("Status.JobId", "String", False, "The job that the cell works at."),
    Variable("Status.Queue", "String[]", False, "The jobs that wait, the next one first."),
    Variable("Status.Healthy", "Boolean", False, "Neither the cell nor a node of it has a problem."),
    Variable("Status.Problems", "String[]", False, "What is wrong, else."),
    Variable("Admin.ProdProcessedCount", "Count[]", True, "Picks that ended, since this server began."),
    Variable("Admin.ProdDefectiveCount", "Count[]", True, "Those of them that failed."),
    Variable("Admin.Processed", "Int32", False, "The same, as a number."),
    Variable("Admin.Defective", "Int32", False, "The same, as a number."),
    Variable("Admin.StopReason", "Alarm", True, "Why the cell last stopped, aborted or was held."),
    Variable("Admin.StopReasonExtent", "Int32", True, "Always 1."),
    Variable("Admin.StopReasonText", "String", False, "The same in words."),
    Variable("Admin.Alarm", "Alarm[]", True, "Why the cell is aborted, while it is."),
    Variable("Admin.AlarmExtent", "Int32", True, "Number of alarms that can be shown."),
    Variable("Admin.AlarmHistory", "Alarm[]", True, "The last warnings and errors, the newest first."),
    Variable("Admin.AlarmHistoryExtent", "Int32", True, "Number of them that are kept."),
    Variable("Proposal.Id", "String", False, "Of the planned pick that waits for an answer; empty = none does."),
    Variable("Proposal.Json", "String", False, "That Proposal, as on the bus (bus.md)."),
    Variable("Result.Json", "String", False, "The last CycleResult, as on the bus (bus.md)."),
    Variable("Result.CycleId", "String", False, "Of it, as the following."),
    Variable("Result.JobId", "String", False, "The client's name of the job."),
    Variable("Result.Result", "String", False, "SUCCESS, FAILED, ABORTED or EMPTY."),
    Variable("Result.Code", "String", False, "Why not SUCCESS."),
    Variable("Result.Reason", "String", False, "The same in words."),
    Variable("Result.Advice", "String", False, "What to do about it."),
    Variable("Result.RetriedAs", "String", False, "The cycle that tries again; empty = this one was the last."),
    Variable("Result.Object", "String", False, "In simulation, the object."),
    Variable("Result.Found", "String", False, "What the cycle went for, in words."),
    Variable("Result.Place", "String", False, "The station's place where it was laid."),
    Variable("Result.WallS", "Double", False, "How long the cycle took [s]."),
    Variable("Result.Recording", "String", False, "Path of its recording."),
    Variable("LastRefusal.Code", "String", False, "Of the last call that was refused, whoever made it."),
    Variable("LastRefusal.Reason", "String", False, "What was wrong."),
    Variable("LastRefusal.Advice", "String", False, "What to do about it."),
    Variable("LastRefusal.Method", "String", False, "The method."),
    Variable("LastRefusal.Client", "String", False, "Who called it."),
)
OBJECTS = {"Status": "PackMLStatusObjectType", "Admin": "PackMLAdminObjectType", "Proposal": "", "Result": "",
           "LastRefusal": ""}  # fmt: skip
"""Objects below the cell's, and their type in PackML's namespace; "" = plain ones of ours."""
PROPERTIES = ("PackMLVersion", "TagID", "Status.UnitSupportedModes")

EVENTS = {
    "RefusalEvent": ("Code", "Reason", "Advice", "Method", "Client"),
    "ResultEvent": ("CycleId", "JobId", "Result", "Code", "Reason", "Json"),
    "CellEvent": ("Code", "Advice"),
}
"""Types of events, and their own fields, all strings; the words for a person are in ``Message``."""

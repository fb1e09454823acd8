"""The methods of the cell's object: their arguments, and the command that each sends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

from pydantic import ValidationError

from bus.commands import CommandRequest
from bus.errors import Refused
from bus.first_mistake import first_mistake
from bus.frozen import Message
from bus.messages import Job, Place, Target

_LONGEST_TEXT = 64 * 1024
MessageT = TypeVar("MessageT", bound=Message)


class Argument(NamedTuple):
    """One argument of a method. ``kind``: String, UInt32 or Boolean; of outputs also ByteString or DateTime."""

    name: str
    kind: str
    meaning: str


class Method(NamedTuple):
    """One method.

    Attributes:
        verb: the command that it sends; "" for Picture and Release, which send none.
        request: makes the command of the arguments. Raises: Refused (BAD_JOB, BAD_ARGUMENT).
    """

    name: str
    verb: str
    inputs: tuple[Argument, ...]
    outputs: tuple[Argument, ...]
    request: Callable[..., CommandRequest]
    meaning: str


def _nothing() -> CommandRequest:
    return CommandRequest()


def _run(cycles: int, until_empty: bool, job: str) -> CommandRequest:
    return _checked(
        lambda: CommandRequest(cycles=1 if until_empty else cycles, until_empty=until_empty, job=_job(job)), "cycles"
    )


def _pick(target: str, place: str, job_id: str) -> CommandRequest:
    named = Target.model_validate_json if _is_json(target) else lambda text: Target(text=text)
    at = Place.model_validate_json if _is_json(place) else lambda text: Place(name=text)
    return _checked(
        lambda: CommandRequest(
            job=Job(
                job_id=job_id,
                target=_checked(lambda: named(target), "target") if target else None,
                place=_checked(lambda: at(place), "place") if place else None,
            )
        ),
        "job",
    )


def _pick_job(job: str) -> CommandRequest:
    return CommandRequest(job=_job(job))


def _cancel(job_id: str) -> CommandRequest:
    return _checked(lambda: CommandRequest(job=Job(job_id=job_id)), "job")


def _answer(proposal: str, reason: str = "") -> CommandRequest:
    return _checked(lambda: CommandRequest(proposal=proposal, reason=reason), "answer")


def _job(text: str) -> Job:
    return _checked(lambda: Job.model_validate_json(text), "job") if text else Job()


def _is_json(text: str) -> bool:
    return text.lstrip().startswith("{")


def _checked(make: Callable[[], MessageT], what: str) -> MessageT:
    """Return what ``make`` returns. Raises: Refused (BAD_JOB) that names the field."""
    try:
        return make()
    except ValidationError as error:
        text = f"{first_mistake(error, inside=what)}."
        raise Refused(text, "Correct that argument and call again: docs/opcua.md.", code="BAD_JOB") from error


_CYCLE = (
    Argument("CycleId", "String", "The cycle that begins, now or when it is its turn."),
    Argument("JobId", "String", "The job: the caller's name of it, or else the cycle's id."),
    Argument("Position", "UInt32", "In the queue, from 1 on; 0 = it begins now."),
)
_PROPOSAL = Argument("Proposal", "String", "`Proposal.Id`: what is answered.")
_WHY = Argument("Reason", "String", "Why, in words; may be empty.")
_JOB = Argument("Job", "String", "A Job as JSON (bus.md); empty = none.")

METHODS = (
    Method("Reset", "reset", (), (), _nothing, "Self-check, arm to the capture pose; ends in Idle."),
    Method("Start", "start", (), _CYCLE, _nothing, "One pick of the station's own target."),
    Method("Stop", "stop", (), (), _nothing, "Brake on the path; ends in Stopped."),
    Method("Hold", "hold", (), (), _nothing, "Brake on the path and wait there; ends in Held."),
    Method("Unhold", "unhold", (), (), _nothing, "Go on with a held cycle."),
    Method("Suspend", "suspend", (), (), _nothing, "As Hold, for a reason outside of the cell; ends in Suspended."),
    Method("Unsuspend", "unsuspend", (), (), _nothing, "Go on with a suspended cycle."),
    Method("Abort", "abort", (), (), _nothing, "Brake now; ends in Aborted."),
    Method("Clear", "clear", (), (), _nothing, "Clear an abort; ends in Stopped."),
    Method(
        "Pick",
        "pick",
        (
            Argument("Target", "String", "The object in words, or a Target as JSON; empty = the best one."),
            Argument("Place", "String", "A place of the station, or a Place as JSON; empty = the tray."),
            Argument("JobId", "String", "The caller's name of the job; may be empty."),
        ),
        _CYCLE,
        _pick,
        "Pick one object and lay it down.",
    ),
    Method("PickJob", "pick", (_JOB,), _CYCLE, _pick_job, "The same with every field of a job."),
    Method(
        "Run",
        "start",
        (
            Argument("Cycles", "UInt32", "Number of picks."),
            Argument("UntilEmpty", "Boolean", "Instead: until nothing is left, or three in a row failed."),
            _JOB,
        ),
        _CYCLE,
        _run,
        "Several picks.",
    ),
    Method(
        "Cancel",
        "cancel",
        (Argument("JobId", "String", "The job."),),
        (),
        _cancel,
        "Cancel a job that waits, or whose grasp has not begun.",
    ),
    Method("Approve", "approve", (_PROPOSAL,), (), _answer, "The arm moves as proposed."),
    Method("NextGrasp", "next_grasp", (_PROPOSAL, _WHY), (), _answer, "Plan the next grasp, and propose that."),
    Method("Reject", "reject", (_PROPOSAL, _WHY), (), _answer, "End the cycle: nothing moves."),
    Method(
        "Picture",
        "",
        (),
        (
            Argument("Png", "ByteString", "The picture, a PNG file."),
            Argument("TakenAt", "DateTime", "When."),
            Argument("Stamp", "String", "The same in whole nanoseconds: `picture_ns` of a target."),
        ),
        _nothing,
        "What the camera sees now, from the capture pose: a pixel of it is a target.",
    ),
    Method("Release", "", (), (), _nothing, "Give the lease back: others may command; motion of this session is held."),
)
BY_NAME = {method.name: method for method in METHODS}
_CHECKS: dict[str, Callable[[Any], bool]] = {
    "String": lambda value: value is None or (isinstance(value, str) and len(value) <= _LONGEST_TEXT),
    "UInt32": lambda value: isinstance(value, int) and not isinstance(value, bool),
    "Boolean": lambda value: isinstance(value, bool),
}


class Given(NamedTuple):
    """One argument as it came: the name of its OPC UA type, "" for an array, and its value."""

    kind: str
    value: Any


def fitting(wanted: Sequence[Argument], given: Sequence[Given]) -> list[bool]:
    """For each argument given, whether its type and size are right. Their number is the caller's to check."""
    return [
        one.kind == argument.kind and _CHECKS[argument.kind](one.value)
        for argument, one in zip(wanted, given, strict=False)
    ]


def request_of(method: Method, values: Sequence[Any]) -> CommandRequest:
    """Return the command of a call with these values. Raises: Refused (BAD_JOB)."""
    texts = ["" if value is None else value for value in values]
    return method.request(*texts)

"""The timeline of a cycle in words - outcome, cause, advice, result of each stage - for the page and `cell show`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from bus.codes import ADVICE, title_of, went_for
from bus.commands import Event
from bus.frozen import Message
from bus.messages import Detections, Execution, PickPlan, Verdict, View
from bus.messages.plan import ONLY_TO_LOOK
from logs.direction import direction_in_words
from logs.mcap.names import telling
from logs.mcap.reader import CycleRecord, Stage

UNFINISHED = "UNFINISHED"


@dataclass(frozen=True)
class StageLine:
    """One stage in the timeline.

    Attributes:
        start_s: from the cycle's start. ``took_s``: duration.
        said: its result, or its failure. ``failed``: True for a failure that no further look superseded.
    """

    name: str
    start_s: float
    took_s: float
    said: str
    failed: bool


@dataclass(frozen=True)
class Span:
    """A state of the machine, with times from the cycle's start [s]."""

    name: str
    start_s: float
    end_s: float


@dataclass(frozen=True)
class Timeline:
    """The timeline of a cycle, with the reason of its end.

    Attributes:
        outcome: its result, or ``UNFINISHED``. ``code``: of `bus.codes`, or "".
        object: name of the object, "" when unknown.
        why: one or two sentences. ``advice``: the action to take, "" for none.
        stages, states: in order; a stage that ran again after another look has a line for each run.
        start_ns: UTC. ``length_s``: of the whole recording.
        ended_in: the last stage that began, "" for none.
    """

    outcome: str
    code: str
    object: str
    why: str
    advice: str
    stages: tuple[StageLine, ...]
    states: tuple[Span, ...]
    start_ns: int
    length_s: float
    ended_in: str

    @property
    def title(self) -> str:
        """Outcome, code and object: ``FAILED DROPPED spatula``."""
        return title_of(self.outcome, self.code, self.object)

    @property
    def went_for(self) -> str:
        """What the cycle went for, for a person."""
        return went_for(self.code, self.object, self.why)

    @property
    def took_s(self) -> dict[str, float]:
        """The duration of every stage [s], of all its runs together."""
        total: dict[str, float] = {}
        for line in self.stages:
            total[line.name] = total.get(line.name, 0.0) + line.took_s
        return total


def summarize(record: CycleRecord) -> Timeline:
    """Return the timeline of one recorded cycle, complete or not. Raises: RecordingError for inconsistent values."""
    with telling(f"The cycle {record.cycle_id!r}"):
        return _told(record)


def _told(record: CycleRecord) -> Timeline:
    why, advice = _why(record)
    result = record.result
    stages, states = [*record.superseded, *record.stages.values()], record.states
    start_ns = min([stage.started_ns for stage in stages] + [said.log_time_ns for said in states], default=0)
    ends_ns = [stage.started_ns + round(stage.duration_s * 1e9) for stage in stages]
    said_ns = [said.log_time_ns for said in states] + [said.log_time_ns for said in record.events]
    length_s = (max(ends_ns + said_ns, default=0) - start_ns) / 1e9
    begun = [said.message.stage for said in states if said.message.stage]
    return Timeline(
        outcome=result.result if result is not None else record.metadata.get("result", UNFINISHED),
        code=result.code.value if result is not None and result.code is not None else "",
        object=result.object if result is not None else "",
        why=why,
        advice=advice,
        stages=tuple(_lines(record, start_ns)),
        states=tuple(_spans(record, start_ns, length_s)),
        start_ns=start_ns,
        length_s=length_s,
        ended_in=begun[-1] if begun else next(reversed(record.stages), ""),
    )


def _why(record: CycleRecord) -> tuple[str, str]:
    """The reason and the advice; for a mere stop, a fault that the cell reported is given as the cause."""
    result = record.result
    if result is None:
        nothing = "The recording holds no result: the cycle was not finished."
        why, advice = record.metadata.get("reason") or nothing, ""
    else:
        why = result.reason
        advice = result.advice or (ADVICE[result.code] if result.code is not None else "")
    faults = [said.message for said in record.events if said.message.severity == "error"]
    cause, remedy = _parted(faults[-1]) if faults else ("", "")
    if cause in why:
        return why, advice
    return f"{why} {cause}", remedy or advice


def _parted(fault: Event) -> tuple[str, str]:
    """The text and the advice of a fault, also of one that has both in its text."""
    advices = (fault.advice, *ADVICE.values())
    advice = next((advice for advice in advices if advice and fault.text.endswith(advice)), fault.advice)
    return fault.text.removesuffix(advice).strip(), advice


def _lines(record: CycleRecord, start_ns: int) -> Iterator[StageLine]:
    for stage in record.superseded:
        yield _line(stage, start_ns, failed=False)
    for stage in record.stages.values():
        yield _line(stage, start_ns, failed=stage.failure is not None)


def _line(stage: Stage, start_ns: int, *, failed: bool) -> StageLine:
    said = stage.failure.text if stage.failure is not None else in_words(stage.result)
    return StageLine(stage.stage, (stage.started_ns - start_ns) / 1e9, stage.duration_s, said, failed)


def _spans(record: CycleRecord, start_ns: int, length_s: float) -> Iterator[Span]:
    """The machine's states, one span each, however often the state was published."""
    said = [(said.message.state, (said.log_time_ns - start_ns) / 1e9) for said in record.states]
    changes = [one for before, one in zip([("", 0.0), *said], said, strict=False) if before[0] != one[0]]
    ends_s = [*(begin_s for _, begin_s in changes[1:]), length_s]
    for (name, begin_s), end_s in zip(changes, ends_s, strict=False):
        yield Span(name, begin_s, end_s)


def in_words(result: Message | None) -> str:
    """Return the result of a stage, in half a line; "" where there is none to report."""
    if isinstance(result, View) and result.why:
        return f"another look, {direction_in_words(result.base_from_color)}: {result.why}"
    if isinstance(result, Detections) and result.grasps:
        best = result.grasps[0]
        return f"{len(result.grasps)} grasps, the best {best.width_m * 1e3:.0f} mm wide"
    if isinstance(result, PickPlan):
        motion_s = sum(part.trajectory.duration_s for part in result.segments if part.name not in ONLY_TO_LOOK)
        return f"grasp {result.grasp}, {motion_s:.1f} s of motion, {len(result.rejected)} grasps rejected"
    if isinstance(result, Execution):
        return _done_in_words(result)
    if isinstance(result, Verdict):
        return result.reason
    return ""


def _done_in_words(result: Execution) -> str:
    """Say where the fingers closed, and what the arm met before that."""
    met = f"{result.contact.in_words}; " if result.contact is not None else ""
    if result.grasped is not None:
        return f"{met}closed at {result.grasped.width_m * 1e3:.1f} mm"
    return f"{met}went back" if met else ""

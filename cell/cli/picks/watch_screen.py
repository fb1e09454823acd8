"""The view of ``cell watch``, drawn only from the messages that were received."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from rich.console import Group, RenderableType
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from bus.codes import went_for
from bus.commands import CellState, Event, Health
from bus.frozen import Message
from bus.messages import CycleResult, StageRecord, View
from cell.machine.states import told
from cell.terminal.drawing import table, words
from cell.terminal.printing import Part

HISTORY = 8
"""Number of cycles shown."""
STALE_S = 3.0
"""A node publishes its health once a second; after this silence it is shown in red."""
KEYS = {"r": "reset", "p": "pick", "s": "stop", "h": "hold", "u": "unhold", "a": "abort", "c": "clear"}
QUIT = "q"

_STATE_STYLE = {
    "Stopped": "bold yellow", "Idle": "bold green", "Complete": "bold green", "Holding": "bold magenta",
    "Held": "bold magenta", "Unholding": "bold magenta", "Suspending": "bold magenta", "Suspended": "bold magenta",
    "Unsuspending": "bold magenta", "Aborting": "bold red", "Aborted": "bold red",
}  # fmt: skip
_ACTING_STYLE = "bold cyan"
_RESULT_STYLE = {"SUCCESS": "green", "EMPTY": "yellow"}
_BAD = "bold red"
_LONGEST_NS = 10**18


@dataclass(frozen=True)
class Heartbeat:
    """The last health message of a node.

    Attributes:
        heard_s: time of its arrival, monotonic.
    """

    health: Health
    heard_s: float


@dataclass(frozen=True)
class Model:
    """The content of the view.

    Attributes:
        cell_id, nodes: of the station file. ``takes_keys``: False hides the keys.
        beats: by node name. ``results``: newest first.
        lost: why the cell does not answer, "" while it does; ``state`` is then its last one.
        note: the last reply, refusal, event or further look, received at ``noted_s`` (monotonic). ``is_bad``: it was a
            refusal or trouble.
        unread: number of undecodable messages. ``last_unread``: key and reason of the last one.
    """

    cell_id: str
    nodes: tuple[str, ...]
    takes_keys: bool
    state: CellState | None = None
    beats: Mapping[str, Heartbeat] = field(default_factory=dict)
    results: tuple[CycleResult, ...] = ()
    lost: str = ""
    note: str = ""
    noted_s: float = 0.0
    is_bad: bool = False
    unread: int = 0
    last_unread: str = ""

    def hear(self, said: Message, now_s: float) -> Model:
        """Return the model after message ``said`` at ``now_s`` (monotonic).

        A state older than the present one changes nothing, unless the cell was lost.
        """
        if isinstance(said, CellState):
            is_old = self.state is not None and said.since_ns < self.state.since_ns
            return self if is_old and not self.lost else replace(self, state=self._with_cause(said), lost="")
        if isinstance(said, CycleResult):
            others = (one for one in self.results if one.cycle_id != said.cycle_id)
            return replace(self, results=(said, *others)[:HISTORY])
        if isinstance(said, Health):
            return replace(self, beats={**self.beats, said.name: Heartbeat(said, now_s)})
        if isinstance(said, Event):
            text = f"{said.code} {said.text} {said.advice}".rstrip()
            return self.noting(text, now_s, is_bad=said.severity != "info")
        if isinstance(said, StageRecord) and isinstance(said.result, View) and said.result.why:
            return self.noting(f"looked again: {said.result.why}", now_s)
        return self

    def _with_cause(self, said: CellState) -> CellState:
        """The Stopped state with the reason of the preceding Stopping."""
        before = self.state
        if before is None or said.reason or said.state != "Stopped" or before.state not in ("Stopping", "Stopped"):
            return said
        return said.model_copy(update={"reason": before.reason})

    def missing(self, key: str, why: str) -> Model:
        """Return the model after an undecodable message on ``key``."""
        return replace(self, unread=self.unread + 1, last_unread=f"{key}: {why}")

    def noting(self, note: str, now_s: float, *, is_bad: bool = False) -> Model:
        """Return the model with another note, received at ``now_s`` (monotonic)."""
        return replace(self, note=note, noted_s=now_s, is_bad=is_bad)


def view(model: Model, now_s: float, now_ns: int) -> RenderableType:
    """Draw the model at ``now_s`` (monotonic, ages of heartbeats) and ``now_ns`` (UTC, the age of the state)."""
    parts: list[RenderableType] = [_headline(model, now_ns)]
    reason = told(model.state.state, model.state.reason) if model.state is not None else ""
    parts.append(words(model.lost, style=_BAD) if model.lost else words(f"  {reason}"))
    parts += [Rule("cycles", style="dim"), _cycles(model.results)]
    parts += [Rule("nodes", style="dim"), _nodes(model, now_s), Rule(style="dim")]
    parts.append(_keys(model))
    if model.unread:
        parts.append(words(f"{model.unread} messages could not be read, the last on {model.last_unread}", style=_BAD))
    if model.note:
        age = (f"  {duration(now_s - model.noted_s)} ago", "dim")
        parts.append(words((model.note, _BAD if model.is_bad else "green"), age))
    return Group(*parts)


def _headline(model: Model, now_ns: int) -> Text:
    parts: list[Part] = [("cell ", "dim"), (model.cell_id, "bold"), "  "]
    state = model.state
    if state is None:
        return words(*parts, ("no word yet", _BAD))
    parts.append((state.state, "dim" if model.lost else _STATE_STYLE.get(state.state, _ACTING_STYLE)))
    if state.stage:
        parts.append((f"  {state.stage}", "cyan"))
    if state.cycle_id:
        parts.append(f"  cycle {state.cycle_id}")
    return words(*parts, (f"  for {duration(seconds_between(state.since_ns, now_ns))}", "dim"))


def _cycles(results: Iterable[CycleResult]) -> RenderableType:
    rows = table(("cycle", "result", "code", "object", "time", "why"), expand=True)
    rows.columns[-1].ratio = 1
    for one in results:
        style = _RESULT_STYLE.get(one.result, _BAD)
        code = one.code.value if one.code is not None else ""
        what, took = went_for(code, one.object, one.reason), f"{one.wall_s:.1f} s"
        texts = (one.result, style), (code, style), (what, ""), (took, ""), (one.reason, "dim")
        rows.add_row(words(one.cycle_id), *map(words, texts))
    return rows if rows.rows else words("none yet", style="dim")


def _nodes(model: Model, now_s: float) -> Table:
    rows = table(("node", "heard", "up", "answered", "failed", "readings"), expand=True)
    rows.columns[-1].ratio = 1
    rows.columns[-1].no_wrap = False
    for name in dict.fromkeys((*model.nodes, *model.beats)):
        beat = model.beats.get(name)
        if beat is None:
            rows.add_row(words(name), words("not yet", style=_BAD), *[words("-", style="dim")] * 4)
            continue
        age_s, health = now_s - beat.heard_s, beat.health
        readings = "  ".join(f"{key} {value:.4g}" for key, value in sorted(health.readings.items()))
        rows.add_row(
            words(name),
            words(f"{duration(age_s)} ago", style=_BAD if age_s > STALE_S else "green"),
            words(duration(health.uptime_s)),
            words(str(health.answered)),
            words(str(health.failed), style=_BAD if health.failed else ""),
            words(readings, style="dim"),
        )
    return rows


def _keys(model: Model) -> Text:
    """The keys, those of available commands highlighted; only the available commands when keys are not accepted."""
    lit = model.state.available if model.state is not None and not model.lost else ()
    if not model.takes_keys:
        return words(f"available: {', '.join(lit) or '-'}", style="dim")
    keys: list[Part] = []
    for key, verb in KEYS.items():
        keys += [(f"{key} {verb}", "bold" if verb in lit else "dim"), "   "]
    return words(*keys, (f"{QUIT} quit", "bold"))


def seconds_between(earlier_ns: int, later_ns: int) -> float:
    """Time between two stamps [s], 0 if the second is earlier; stamps of other programs may have any size."""
    return min(max(0, later_ns - earlier_ns), _LONGEST_NS) / 1e9


def duration(seconds: float) -> str:
    """A duration for a person: ``7 s``, ``3 min``, ``26 h``."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"

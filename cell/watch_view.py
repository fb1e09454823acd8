"""What ``cell watch`` shows: one view of the cell, drawn from what was heard of it and nothing else."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from rich.console import Group, RenderableType
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from bus.commands import CellState, Event, Health
from bus.frozen import Message
from bus.messages import CycleResult

HISTORY = 8
"""How many cycles are shown."""
STALE_S = 3.0
"""A node says how it is once a second; after this silence it is shown in red."""
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


@dataclass(frozen=True)
class Heartbeat:
    """What a node last said of itself, and when that was heard [s, monotonic]."""

    health: Health
    heard_s: float


@dataclass(frozen=True)
class Model:
    """Everything the view shows.

    Attributes:
        cell_id, nodes: of the station file. ``takes_keys``: False shows no keys.
        beats: by node name. ``results``: newest first.
        lost: why the cell does not answer, "" while it does; ``state`` is then its last one.
        note: the last answer, refusal or event, of ``noted_s`` [monotonic]. ``is_bad``: it was no acceptance.
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

    def hear(self, said: Message, now_s: float) -> Model:
        """The model after ``said``; a state older than the present one changes nothing, unless the cell was away."""
        if isinstance(said, CellState):
            is_old = self.state is not None and said.since_ns < self.state.since_ns
            return self if is_old and not self.lost else replace(self, state=said, lost="")
        if isinstance(said, CycleResult):
            others = (one for one in self.results if one.cycle_id != said.cycle_id)
            return replace(self, results=(said, *others)[:HISTORY])
        if isinstance(said, Health):
            return replace(self, beats={**self.beats, said.name: Heartbeat(said, now_s)})
        if isinstance(said, Event):
            text = f"{said.code} {said.text} {said.advice}".rstrip()
            return self.noting(text, now_s, is_bad=said.severity != "info")
        return self

    def noting(self, note: str, now_s: float, *, is_bad: bool = False) -> Model:
        """The model with another note."""
        return replace(self, note=note, noted_s=now_s, is_bad=is_bad)


def view(model: Model, now_s: float, now_ns: int) -> RenderableType:
    """The model at ``now_s`` (monotonic, ages of heartbeats) and ``now_ns`` (UTC, how long the state has lasted)."""
    parts: list[RenderableType] = [_headline(model, now_ns)]
    reason = model.state.reason if model.state is not None else ""
    parts.append(Text(model.lost, style=_BAD) if model.lost else Text(f"  {reason}"))
    parts += [Rule("cycles", style="dim"), _cycles(model.results)]
    parts += [Rule("nodes", style="dim"), _nodes(model, now_s), Rule(style="dim")]
    parts.append(_keys(model))
    if model.note:
        age = (f"  {duration(now_s - model.noted_s)} ago", "dim")
        parts.append(Text.assemble((model.note, _BAD if model.is_bad else "green"), age))
    return Group(*parts)


def _headline(model: Model, now_ns: int) -> Text:
    line = Text.assemble(("cell ", "dim"), (model.cell_id, "bold"), "  ")
    state = model.state
    if state is None:
        return line.append("no word yet", _BAD)
    line.append(state.state, "dim" if model.lost else _STATE_STYLE.get(state.state, _ACTING_STYLE))
    if state.stage:
        line.append(f"  {state.stage}", "cyan")
    if state.cycle_id:
        line.append(f"  cycle {state.cycle_id}")
    return line.append(f"  for {duration(max(0.0, (now_ns - state.since_ns) / 1e9))}", "dim")


def _cycles(results: Iterable[CycleResult]) -> RenderableType:
    table = _table("cycle", "result", "code", "object", "time", "why")
    table.columns[-1].ratio = 1
    for one in results:
        style = _RESULT_STYLE.get(one.result, _BAD)
        code = one.code.value if one.code is not None else ""
        texts = (one.result, style), (code, style), (one.object, ""), (f"{one.wall_s:.1f} s", ""), (one.reason, "dim")
        table.add_row(Text(one.cycle_id), *(Text(text, style=style) for text, style in texts))
    return table if table.rows else Text("none yet", style="dim")


def _nodes(model: Model, now_s: float) -> Table:
    table = _table("node", "heard", "up", "answered", "failed", "readings")
    table.columns[-1].ratio = 1
    table.columns[-1].no_wrap = False
    for name in dict.fromkeys((*model.nodes, *model.beats)):
        beat = model.beats.get(name)
        if beat is None:
            table.add_row(Text(name), Text("not yet", style=_BAD), *[Text("-", style="dim")] * 4)
            continue
        age_s, health = now_s - beat.heard_s, beat.health
        readings = "  ".join(f"{key} {value:.4g}" for key, value in sorted(health.readings.items()))
        table.add_row(
            Text(name),
            Text(f"{duration(age_s)} ago", style=_BAD if age_s > STALE_S else "green"),
            Text(duration(health.uptime_s)),
            Text(str(health.answered)),
            Text(str(health.failed), style=_BAD if health.failed else ""),
            Text(readings, style="dim"),
        )
    return table


def _keys(model: Model) -> Text:
    """The available commands lit, the others dim; none at all where no keys can be pressed."""
    line = Text()
    lit = model.state.available if model.state is not None and not model.lost else ()
    if not model.takes_keys:
        return line.append(f"available: {', '.join(lit) or '-'}", "dim")
    for key, verb in KEYS.items():
        line.append(f"{key} {verb}", "bold" if verb in lit else "dim").append("   ")
    return line.append(f"{QUIT} quit", "bold")


def _table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, expand=True, header_style="dim")
    for column in columns:
        table.add_column(column, no_wrap=True, overflow="ellipsis")
    return table


def duration(seconds: float) -> str:
    """For a person: ``7 s``, ``3 min``, ``26 h``."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"

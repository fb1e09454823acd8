"""The operator's screen while cycles run: one line per stage, then the verdict; or one JSON object per cycle."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from bus.codes import ADVICE, title_of
from bus.commands import CellState, Event
from bus.errors import RecordingError
from bus.frozen import Message
from bus.messages import CycleResult, StageRecord
from bus.topics import Topic
from cell.cli.serving.day_page import DayPage
from cell.daemon.batch import Summary
from cell.machine.states import PAUSING, told
from cell.terminal.printing import out
from logs.mcap.reader import read_cycle
from logs.report.cycle_report import write_report
from logs.report.day_report import INDEX
from logs.report.timeline import in_words

_RESULT_STYLE = {"SUCCESS": "bold green", "EMPTY": "bold yellow"}
_EVENT_STYLE = {"info": "dim", "warning": "bold yellow", "error": "bold red"}


class Screen:
    """Prints the daemon's messages. `observe` is called on the daemon's threads and only enqueues.

    Args:
        json_lines: print JSON instead of lines for a person. ``report``: write a page for every cycle.
        each_turn: called by `follow` with every message, and with None several times a second.
    """

    def __init__(
        self, *, json_lines: bool, report: bool, each_turn: Callable[[Message | bytes | None], None] = lambda _: None
    ) -> None:
        self._json, self._report, self._each_turn = json_lines, report, each_turn
        self._heard: queue.SimpleQueue[tuple[Topic, Message | bytes]] = queue.SimpleQueue()
        self._state = ""
        self._day = DayPage()
        self.interrupted = threading.Event()

    def observe(self, topic: Topic, message: Message | bytes) -> None:
        """Queue one message of the daemon."""
        self._heard.put((topic, message))

    def line(self, text: str, style: str = "") -> None:
        """Print one line for a person; nothing in JSON mode."""
        if not self._json:
            out.line(text, style=style)

    def summary(self, summary: Summary) -> None:
        """Print the end of a batch until empty: one line, or one JSON object after the results."""
        if self._json:
            out.json(summary.model_dump_json())
        else:
            out.line(summary.line(), style="bold green" if summary.is_empty else "bold red")

    def follow(self, *, quiet: bool = False) -> Iterator[CellState | CycleResult]:
        """Print messages (unless ``quiet``), and yield states and results, until interrupted."""
        try:
            while not self.interrupted.is_set():
                try:
                    _, message = self._heard.get(timeout=0.1)
                except queue.Empty:
                    self._each_turn(None)
                    self._day.turn()
                    continue
                self._each_turn(message)
                if not quiet:
                    self._show(message)
                if isinstance(message, CellState | CycleResult):
                    yield message
        finally:
            self._day.close()

    @contextmanager
    def to_the_end(self) -> Iterator[None]:
        """Context of a cell; then shows what became of a cycle that was interrupted, and what it left in the hand."""
        yield
        while not self._heard.empty():
            _, message = self._heard.get()
            if isinstance(message, CycleResult) or getattr(message, "code", "") == "HAND_NOT_EMPTY":
                self._show(message)

    def _show(self, message: Message | bytes) -> None:
        if isinstance(message, CycleResult):
            self._show_result(message)
        elif self._json:
            return
        elif isinstance(message, CellState):
            if message.state in ("Starting", "Aborted") and message.cycle_id:
                out.line("cycle ", (message.cycle_id, "bold"))
            elif (message.stage == "" and message.mode == "Production") or message.state != self._state:
                self._show_state(message)
            self._state = message.state
        elif isinstance(message, StageRecord):
            said = message.failure.text if message.failure else in_words(message.result)
            out.line(f"  {message.stage:<8} {message.duration_s:6.2f} s  {said}".rstrip())
        elif isinstance(message, Event):
            out.line("  ", (message.code, _EVENT_STYLE[message.severity]), f" {message.text} {message.advice}".rstrip())

    def _show_state(self, state: CellState) -> None:
        why = told(state.state, state.reason)
        is_command = why != state.reason
        out.line("  ", (why if is_command else state.state, "dim"))
        if state.state in PAUSING and why and not is_command:  # no other message gives the reason
            out.line("  ", why)

    def _show_result(self, result: CycleResult) -> None:
        if self._json:
            out.json(result.model_dump_json())
            return
        style = _RESULT_STYLE.get(result.result, "bold red")
        ended = f"{result.result} {result.code.value}" if result.code else result.result
        name = title_of(result.result, result.code or "", result.object).removeprefix(ended)
        out.line((ended, style), f"{name}: {result.reason} ({result.wall_s:.1f} s)")
        if result.code:
            out.line(f"  {result.advice or ADVICE[result.code]}")
        out.line(f"  recording {result.recording}")
        if result.retried_as:
            out.line(f"  tried again as {result.retried_as}")
        if self._report:
            self._write_report(Path(result.recording))

    def _write_report(self, recording: Path) -> None:
        """Write the page beside the recording; disk errors are reported, and the cell goes on."""
        started_s = time.monotonic()
        try:
            page = write_report(read_cycle(recording), recording.with_suffix(".html"), index=INDEX)
            self._day.written(recording)
        except RecordingError as error:
            out.line("  ", ("no report", "bold red"), f" {error}")
        else:
            out.line(f"  report    {page} ({time.monotonic() - started_s:.1f} s)")

"""What an operator sees while cycles run: one line a stage, then the verdict; or one JSON object a cycle."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console

from bus.codes import ADVICE
from bus.commands import CellState, Event
from bus.errors import RecordingError
from bus.frozen import Message
from bus.messages import CycleResult, StageRecord
from bus.topics import Topic
from cell.batch import Summary
from logs.reader import read_cycle
from logs.report import write_report
from logs.story import in_words

_RESULT_STYLE = {"SUCCESS": "bold green", "EMPTY": "bold yellow"}


class Screen:
    """Prints what the daemon says. `observe` is called on the daemon's threads and only enqueues.

    ``each_turn`` is called by `follow` with everything that was said, and with None several times a second.
    """

    def __init__(
        self, *, json_lines: bool, report: bool, each_turn: Callable[[Message | bytes | None], None] = lambda _: None
    ) -> None:
        self._json, self._report, self._each_turn = json_lines, report, each_turn
        self._out = Console(highlight=False, soft_wrap=True)
        self._heard: queue.SimpleQueue[tuple[Topic, Message | bytes]] = queue.SimpleQueue()
        self._state = ""
        self.interrupted = threading.Event()

    def observe(self, topic: Topic, message: Message | bytes) -> None:
        """Queue one thing the daemon said."""
        self._heard.put((topic, message))

    def line(self, text: str, style: str = "") -> None:
        """One line for a person; nothing in JSON mode."""
        if not self._json:
            self._out.print(text, style=style)

    def summary(self, summary: Summary) -> None:
        """How a batch until empty ended: one line, or one JSON object after the results."""
        if self._json:
            self._out.out(summary.model_dump_json(), highlight=False)
        else:
            self._out.print(summary.line(), style="bold green" if summary.is_empty else "bold red")

    def follow(self, *, quiet: bool = False) -> Iterator[CellState | CycleResult]:
        """Print what is said (unless ``quiet``), and yield states and results, until interrupted."""
        while not self.interrupted.is_set():
            try:
                _, message = self._heard.get(timeout=0.1)
            except queue.Empty:
                self._each_turn(None)
                continue
            self._each_turn(message)
            if not quiet:
                self._show(message)
            if isinstance(message, CellState | CycleResult):
                yield message

    def _show(self, message: Message | bytes) -> None:
        if isinstance(message, CycleResult):
            self._show_result(message)
        elif self._json:
            return
        elif isinstance(message, CellState):
            if message.state in ("Starting", "Aborted") and message.cycle_id:
                self._out.print(f"cycle [bold]{message.cycle_id}[/]")
            elif message.stage == "" or message.state != self._state:
                self._out.print(f"  [dim]{message.state}[/]")
            self._state = message.state
        elif isinstance(message, StageRecord):
            said = message.failure.text if message.failure else in_words(message.result)
            self._out.print(f"  {message.stage:<8} {message.duration_s:6.2f} s  {said}")
        elif isinstance(message, Event):
            self._out.print(f"  [bold red]{message.code}[/] {message.text} {message.advice}")

    def _show_result(self, result: CycleResult) -> None:
        if self._json:
            self._out.out(result.model_dump_json(), highlight=False)
            return
        style = _RESULT_STYLE.get(result.result, "bold red")
        code = f" {result.code.value}" if result.code else ""
        name = f" {result.object}" if result.object else ""
        self._out.print(f"[{style}]{result.result}{code}[/]{name}: {result.reason} ({result.wall_s:.1f} s)")
        if result.code:
            self._out.print(f"  {ADVICE[result.code]}")
        self._out.print(f"  recording {result.recording}")
        if result.retried_as:
            self._out.print(f"  tried again as {result.retried_as}")
        if self._report:
            self._write_report(Path(result.recording))

    def _write_report(self, recording: Path) -> None:
        """A page beside the recording; the cell goes on when the disk does not."""
        started_s = time.monotonic()
        try:
            page = write_report(read_cycle(recording), recording.with_suffix(".html"))
        except RecordingError as error:
            self._out.print(f"  [bold red]no report[/] {error}")
        else:
            self._out.print(f"  report    {page} ({time.monotonic() - started_s:.1f} s)")

"""The operator of one cell: commands it, hears it, and puts the picks together with what was noted of its devices."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from queue import Empty, SimpleQueue

from benchmarks.held.figures import code_of
from benchmarks.held.rounds import Pick, Window, attempt_of, seen_first
from benchmarks.held.solids import in_tray, scene_of
from benchmarks.held.watched import Deed, Notes, Watched, watched_node
from bus.codes import Code
from bus.commands import CellState, CommandRequest
from bus.errors import CellUnreachable
from bus.frozen import Message
from bus.messages import CycleResult, StageRecord
from bus.topics import Topic
from cell.build import running_cell
from cell.daemon.batch import Batch
from cell.daemon.daemon import Daemon
from cell.machine.owner import refuse
from config.schema import Station

_WAY_TO_IDLE = {"Aborted": "clear", "Stopped": "reset", "Complete": "reset"}
_RESTS = ("Idle", *_WAY_TO_IDLE)
_PATIENCE_S = 600.0
_CLIENT = "benchmark"
_TRIES = 10
_STARTS_A_BIN = 4
"""An operator starts a bin anew after an abort, but not for ever."""


@contextmanager
def operated(station: Station) -> Iterator[Operator]:
    """Run the whole cell of ``station``. Raises: as `cell.build.running_cell` and `watched_node`."""
    heard: SimpleQueue[tuple[float, Message]] = SimpleQueue()

    def observe(_topic: Topic, message: Message | bytes) -> None:
        if isinstance(message, CellState | CycleResult | StageRecord):
            heard.put((time.monotonic(), message))

    with ExitStack() as stack:
        daemon = stack.enter_context(running_cell(station, observe))
        watched = stack.enter_context(watched_node(station))
        operator = Operator(station, daemon, watched, heard)
        yield operator
        operator.stop()


class Operator:
    """Commands one cell, and puts together what was heard of it and noted of its devices.

    Attributes:
        taken_away: objects that touched the robot when the cell had aborted, and were taken away for it to go on.
    """

    def __init__(
        self, station: Station, daemon: Daemon, watched: Watched, heard: SimpleQueue[tuple[float, Message]]
    ) -> None:
        self._station, self._daemon, self._watched, self._heard = station, daemon, watched, heard
        self.taken_away = 0
        self._state = ""
        self._open: Window | None = None
        self._ended: list[Window] = []
        self._batch = Batch(CommandRequest())
        self._on_result: Callable[[Window], None] = lambda _: None
        self._hear_until(lambda state: state == "Stopped")

    def stop(self) -> None:
        """Stop the cell, which then does not miss its node; one that does not become Idle again is left as it is."""
        if self._state != "Idle":
            return
        self._command("stop", CommandRequest(client_id=_CLIENT))
        self._hear_until(lambda state: state == "Stopped")

    def pick(self, name: str, seed: int, which: str, tell: Callable[[str], None]) -> Pick:
        """Pick one object, presented alone. Raises: CellUnreachable when the cell does not become Idle for it."""
        if not self._make_idle():
            raise CellUnreachable(f"The cell does not become Idle: it is {self._state}.", "See its own messages above.")
        self._watched.take()
        request = CommandRequest(client_id=_CLIENT, object=name)
        self._command("pick", request)
        windows = self._follow(request.model_copy(update={"cycles": 1}))
        pick = self._picks(windows, self._watched.take(), seed, name)[0]
        tell(f"{which} seed={seed} {_line(pick)}")
        return pick

    def empty(self, seed: int, tell: Callable[[str], None]) -> tuple[list[Pick], int]:
        """Pick until nothing is left, or the cell gives up; return the picks and how many are not in the tray then."""
        windows: list[Window] = []
        deeds: list[Deed] = []
        notes = self._watched.take()
        for _ in range(_STARTS_A_BIN):
            if not self._make_idle():
                tell(f"seed={seed} does not become Idle again: {self._state}")
                break
            request = CommandRequest(client_id=_CLIENT, until_empty=True)
            self._command("start", request)
            windows += self._follow(request, lambda window: tell(f"seed={seed} {_said(window)}"))
            notes = self._watched.take()
            deeds += notes.deeds
            last = windows[-1].result
            if last is None or last.result != "ABORTED":
                break
        left = self._daemon.objects_left()
        picks = self._picks(windows, Notes(tuple(deeds), notes.things), seed)
        picks = [pick for pick in picks if not _is_end(pick, left)]
        lost = len(notes.things) - in_tray(self._station, deeds[-1].base_from_body)
        tell(f"seed={seed} left in the bin {left}, not in the tray {lost}")
        return picks, lost

    def _picks(self, windows: Sequence[Window], notes: Notes, seed: int, name: str = "") -> list[Pick]:
        """Group the cycles by what was tried again."""
        picks: list[Pick] = []
        is_again = False
        for window in windows:
            window.deeds += [deed for deed in notes.deeds if window.began_s <= deed.began_s < window.ended_s]
            attempt = attempt_of(window)
            if is_again:
                picks[-1].attempts.append(attempt)
            else:
                seen = seen_first(window)
                scene = None if seen is None else scene_of(self._station, notes.things, seen.base_from_body, seed)
                picks.append(Pick(name, seed, [attempt], scene))
            is_again = bool(attempt.result.retried_as)
            if not name and attempt.risen:
                picks[-1].name = ", ".join(notes.things[body].name for body in attempt.risen)
        return picks

    # --- commanding and hearing ---------------------------------------------------------------------------------------

    def _command(self, verb: str, request: CommandRequest) -> None:
        refuse(self._daemon.command(verb, request))

    def _make_idle(self) -> bool:
        """Clear and reset, as often as an operator would; return whether the cell is Idle now."""
        for _ in range(_TRIES):
            if self._state == "Idle":
                return True
            if self._state == "Aborted":
                self.taken_away += self._watched.free_the_arm()
            self._command(_WAY_TO_IDLE[self._state], CommandRequest(client_id=_CLIENT))
            self._hear_until(lambda state: state in _RESTS)
        return self._state == "Idle"

    def _follow(self, request: CommandRequest, on_result: Callable[[Window], None] = lambda _: None) -> list[Window]:
        """Hear the cycles of a command until the cell begins no other, and bring it back to Idle; return them."""
        self._ended, self._batch = [], Batch(request, self._station.retry)
        self._on_result = on_result
        self._hear_until(lambda state: state in ("Aborted", "Stopped") or (state == "Complete" and self._batch.is_over))
        if not self._make_idle() and self._open is not None and self._open.result is not None:
            self._end(self._open, time.monotonic())
        return self._ended

    def _hear_until(self, is_over: Callable[[str], bool]) -> None:
        give_up_s = time.monotonic() + _PATIENCE_S
        while True:
            try:
                at_s, message = self._heard.get(timeout=max(0.0, give_up_s - time.monotonic()))
            except Empty as error:
                raise CellUnreachable("The cell says nothing any more.", "See its own messages above.") from error
            self._hear(at_s, message)
            if isinstance(message, CellState) and is_over(message.state):
                return

    def _hear(self, at_s: float, message: Message) -> None:
        window = self._open
        if isinstance(message, CellState):
            if message.state == "Starting" and self._state != "Starting":
                self._open = Window(at_s, staged_s=at_s)
            elif message.state == "Idle" and window is not None and window.result is not None:
                self._end(window, at_s)
            self._state = message.state
        elif window is not None and isinstance(message, StageRecord):
            window.staged_s = at_s
        elif window is not None and isinstance(message, CycleResult):
            window.result, window.said_s = message, at_s
            self._batch.hear(message)
            self._on_result(window)

    def _end(self, window: Window, at_s: float) -> None:
        window.ended_s = at_s
        self._ended.append(window)
        self._open = None


def _is_end(pick: Pick, left: int | None) -> bool:
    """Whether it is no pick but the look that ends a batch: nothing is there, or only what has failed before."""
    result = pick.last.result
    return result.code is Code.LEFT_OVER or (left == 0 and result.result == "EMPTY")


def _line(pick: Pick) -> str:
    last = pick.last
    truth = "held" if pick.is_held else "not held"
    return f"{pick.name} {code_of(pick)} {truth} {last.times.simulated:.1f} s simulated: {last.result.reason}"


def _said(window: Window) -> str:
    result = window.result
    return "" if result is None else f"{result.object} {result.result} {result.code or ''} {result.reason}"

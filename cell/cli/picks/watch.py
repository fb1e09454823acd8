"""``cell watch``: the running cell on one screen, with one key per command."""

from __future__ import annotations

import re
import sys
import termios
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

from rich.console import Console, RenderableType
from rich.live import Live

from bus import topics
from bus.codec import decode
from bus.commands import CellState, CommandReply, Event, Health
from bus.errors import BadPayload, BusError, CellError
from bus.frozen import Message
from bus.messages import CycleResult
from bus.sample import Sample
from bus.topics import encoding_of
from cell import client
from cell.cli.picks.watch_screen import HISTORY, KEYS, QUIT, Model, view
from cell.client import Client
from cell.commander import Commander
from cell.machine.states import ENDING
from cell.terminal.drawing import console
from cell.terminal.keyboard import Keyboard
from cell.terminal.printing import out
from cell.terminal.signals import on_end
from config.schema import Station
from logs.mcap.index import read_result

_TURN_S = 0.1
_WIDTH = 120
"""Columns when no terminal reports its width."""
_REDRAW_S = 0.5
_ASK_STATE_S = 1.0
_SILENCE_S = 2.0
"""A cell answers immediately; after this time the view reports it as silent, while the request is still pending."""
_NODES_PATIENCE_S = 2.5
_ENDED = "The cell has ended, or the link to it. It is shown again once it is back."
_TYPES: dict[str, type[Message]] = {
    topics.STATE.key: CellState,
    topics.RESULT.key: CycleResult,
    topics.EVENT.key: Event,
    topics.CAPTURE.key: topics.CAPTURE.says,
}
_NODE_HEALTH = re.compile(topics.NODE_HEALTH.key.format(name="[^/]+"))


class Watcher:
    """Keeps a `Model` up to date and sends commands. Requests run in threads: a silent cell never blocks the view."""

    def __init__(
        self, cell: Client, commander: Commander, station: Station, pool: ThreadPoolExecutor, *, takes_keys: bool
    ) -> None:
        self._cell, self._commander, self._pool = cell, commander, pool
        results = tuple(islice(recorded_results(station.recording.folder), HISTORY))
        self.model = Model(station.cell_id, tuple(station.nodes), takes_keys, results=results)
        self.model = self.model.hear(cell.state(), time.monotonic())
        self._asked_s = time.monotonic()
        self._asking: Future[CellState] | None = None
        self._commands: list[tuple[str, Future[CommandReply]]] = []
        self._releasing: Future[None] | None = None

    def press(self, key: str) -> None:
        """Send the key's command, even if it will be refused: the reply gives the reason."""
        verb = KEYS.get(key)
        if verb is not None:
            self.model = self.model.noting(f"{verb} ...", time.monotonic())
            # commands that stop motion do not wait for others
            send = self._cell.command if verb in ENDING else self._commander.command
            self._commands.append((verb, self._pool.submit(send, verb)))

    def turn(self) -> None:
        """Process all messages and replies since the last turn. Never raises for anything the cell does."""
        for sample in self._cell.heard():
            self.hear(sample)
        for verb, future in [command for command in self._commands if command[1].done()]:
            self._commands.remove((verb, future))
            self._take_answer(verb, future)
        self._ask_state()
        self._give_back()

    def hear(self, sample: Sample) -> None:
        """Process one message; an undecodable one is counted, and its reason shown."""
        try:
            said = _decoded(sample)
        except BadPayload as error:
            self.model = self.model.missing(sample.key, error.text)
        else:
            self.model = self.model.hear(said, time.monotonic())

    def _take_answer(self, verb: str, future: Future[CommandReply]) -> None:
        try:
            cycle_id = future.result().cycle_id
        except CellError as error:
            self.model = self.model.noting(f"{verb}: {error.code}: {error}", time.monotonic(), is_bad=True)
        else:
            begun = f", cycle {cycle_id}" if cycle_id else ""
            self.model = self.model.noting(f"{verb}: accepted{begun}", time.monotonic())

    def _ask_state(self) -> None:
        """Request the state once a second, too, to detect a cell that fell silent or came back."""
        if self._asking is None:
            if time.monotonic() - self._asked_s > _ASK_STATE_S:
                self._asked_s, self._asking = time.monotonic(), self._pool.submit(self._cell.state)
        elif self._asking.done():
            try:
                self.model = self.model.hear(self._asking.result(), time.monotonic())
            except BusError as error:
                self.model = replace(self.model, lost=_ENDED if self._cell.is_gone else str(error))
            self._asking = None
        elif self._cell.is_gone:
            self.model = replace(self.model, lost=_ENDED)
        elif time.monotonic() - self._asked_s > _SILENCE_S and not self.model.lost:
            self.model = replace(self.model, lost=f"The cell has not answered for {_SILENCE_S:.0f} s.")

    def _give_back(self) -> None:
        """Release the lease when its motion is over, so that another client may command."""
        is_due = not self._commands and self._commander.is_over(self.model.state, is_gone=self._cell.is_gone)
        if is_due and (self._releasing is None or self._releasing.done()):
            over = partial(self._commander.release_if_over, self.model.state, is_gone=self._cell.is_gone)
            self._releasing = self._pool.submit(over)

    def wait_for_nodes(self) -> None:
        """Wait until all nodes were received, or for `_NODES_PATIENCE_S`."""
        give_up_s = time.monotonic() + _NODES_PATIENCE_S
        while set(self.model.nodes) - self.model.beats.keys() and time.monotonic() < give_up_s:
            time.sleep(_TURN_S)
            self.turn()


def watch(station: Station, *, once: bool) -> None:
    """Show the station's cell until q or Ctrl-C; only once if asked for, or without a terminal to draw on.

    Raises: CellUnreachable when no cell runs at the beginning; a cell that disappears later is shown as lost.
    """
    canvas = console(out, None if out.isatty() else _WIDTH)
    once = once or not out.isatty()
    keyboard = Keyboard(sys.stdin)
    name = client.client_name("watch")
    commander = Commander(lambda: client.connect(station, client_id=name))
    also = (topics.NODE_HEALTH, topics.EVENT, topics.CAPTURE)
    with client.connect(station, also, client_id=name) as cell, _released_last(commander), _asking() as pool:
        watcher = Watcher(cell, commander, station, pool, takes_keys=keyboard.is_there and not once)
        if once:
            watcher.wait_for_nodes()
            canvas.print(_draw(watcher))
        else:
            _loop(watcher, keyboard, canvas, _end_on_signals())


def _loop(watcher: Watcher, keyboard: Keyboard, canvas: Console, ended: threading.Event) -> None:
    """Draw until q, ``ended``, or the terminal is gone; only errors of the terminal are caught here."""
    try:
        with keyboard, Live(_draw(watcher), console=canvas, screen=True, auto_refresh=False) as live:
            drawn_s, drawn = 0.0, watcher.model
            while not ended.is_set() and out.lost is None and QUIT not in (keys := keyboard.pressed(_TURN_S)):
                for key in keys:
                    watcher.press(key)
                watcher.turn()
                if watcher.model is not drawn or time.monotonic() - drawn_s > _REDRAW_S:
                    drawn_s, drawn = time.monotonic(), watcher.model
                    live.update(_draw(watcher), refresh=True)
    except (EOFError, OSError, termios.error):
        return


def _draw(watcher: Watcher) -> RenderableType:
    return view(watcher.model, time.monotonic(), time.time_ns())


def _decoded(sample: Sample) -> Message:
    """The message of a sample, in the type of its key. Raises: BadPayload."""
    kind = Health if _NODE_HEALTH.fullmatch(sample.key) else _TYPES.get(sample.key)
    if kind is None or sample.encoding != encoding_of(kind):
        raise BadPayload(f"{sample.key!r} does not carry {sample.encoding!r}.")
    return decode(kind, sample.payload)


def _end_on_signals() -> threading.Event:
    """An event set by Ctrl-C, SIGTERM and a closed terminal; none of them interrupts a line that is being drawn."""
    ended = threading.Event()
    on_end(ended.set)
    return ended


@contextmanager
def _released_last(commander: Commander) -> Iterator[None]:
    """Context that releases the lease at the end of the view: unattended motion is then held by the cell."""
    try:
        yield
    finally:
        commander.release()


@contextmanager
def _asking() -> Iterator[ThreadPoolExecutor]:
    """A pool of threads for requests; leaving the context does not wait for replies."""
    pool = ThreadPoolExecutor(max_workers=4, thread_name_prefix="asking")
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def recorded_results(folder: Path) -> Iterator[CycleResult]:
    """Results of the closed recordings below ``folder``, newest first; unreadable ones are left out.

    `cell cycles` lists unreadable recordings, too, with the reason.
    """
    for path in sorted(folder.rglob("*.mcap"), key=lambda path: path.name, reverse=True):
        try:
            result = read_result(path)
        except CellError:
            continue
        if result is not None:
            yield result

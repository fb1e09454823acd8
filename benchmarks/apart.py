"""A cell whose daemon is a process of its own, so that its resources are measured without those of the benchmark.

The benchmark commands it over a pipe, and receives its results over another. At a named moment (a stage that begins)
the daemon's publishing thread waits until the action due at that moment has been taken.
"""

from __future__ import annotations

import multiprocessing as mp
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any

from bus.commands import CellState, CommandReply, CommandRequest
from bus.errors import CellUnreachable
from bus.frozen import Message
from bus.messages import CycleResult
from bus.topics import Topic
from cell.build import running_cell
from config.schema import Station

_START_S, _END_S = 120.0, 60.0
BEGIN = "begin"
"""The moment before a cycle's first stage."""


class Apart:
    """The benchmark's side; use `cell_apart`. One thread commands.

    Args:
        pid: of the daemon. ``on_result``: told every result, on a thread of its own.
    """

    def __init__(self, pid: int, asking: Connection, hearing: Connection, on_result: Callable[[CycleResult], None]):
        self.pid = pid
        self._asking, self._hearing = asking, hearing
        self._on_result = on_result
        self._due: Callable[[], None] = _nothing

    def command(self, verb: str, request: CommandRequest) -> CommandReply:
        """As the cell's own terminal would."""
        reply: CommandReply = self._ask("command", verb, request)
        return reply

    def objects_left(self) -> int | None:
        """As `cell.daemon.daemon.Daemon.objects_left`."""
        left: int | None = self._ask("objects_left")
        return left

    def expect(self, moment: str, act: Callable[[], None]) -> None:
        """Have ``act`` done, once, when ``moment`` comes; the daemon waits for it."""
        self._due = act
        self._ask("expect", moment)

    def give_up(self) -> bool:
        """Whether what was expected last has come; it will not come any more."""
        return bool(self._ask("give_up"))

    def hear(self) -> None:
        """Hear the daemon until it ends."""
        while True:
            try:
                said = self._hearing.recv()
            except (EOFError, OSError):
                return
            if isinstance(said, CycleResult):
                self._on_result(said)
            else:
                self._due()
                self._hearing.send(None)

    def _ask(self, *question: Any) -> Any:
        """Raises: CellUnreachable when its process has ended."""
        try:
            self._asking.send(question)
            return self._asking.recv()
        except (EOFError, OSError) as error:
            raise CellUnreachable("The cell's process has ended.", "See its own message above.") from error


def _nothing() -> None: ...


@contextmanager
def cell_apart(station: Station, on_result: Callable[[CycleResult], None]) -> Iterator[Apart]:
    """A running cell. Raises: CellUnreachable when it does not start."""
    context = mp.get_context("spawn")  # zenoh does not survive a fork
    (asking, asked), (hearing, saying) = context.Pipe(), context.Pipe()
    process = context.Process(target=_run, args=(station, asked, saying))
    process.start()
    asked.close()
    saying.close()
    assert process.pid is not None
    apart = Apart(process.pid, asking, hearing, on_result)
    ear = threading.Thread(target=apart.hear)
    try:
        _await_ready(asking)
        ear.start()
        yield apart
    finally:
        asking.close()
        process.join(_END_S)
        process.kill()
        process.join()
        if ear.ident is not None:
            ear.join()
        hearing.close()


def _await_ready(asking: Connection) -> None:
    try:
        if asking.poll(_START_S):
            asking.recv()
            return
    except EOFError:
        pass
    raise CellUnreachable("The cell does not start.", "See its own message above.")


# --- the daemon's process ---------------------------------------------------------------------------------------------


class _Moment:
    """The moment that the daemon waits for; `observe` is called on the daemon's own threads."""

    def __init__(self, saying: Connection) -> None:
        self._saying = saying
        self._turn = threading.Lock()
        self._due = ""

    def expect(self, moment: str) -> None:
        self._due = moment

    def give_up(self) -> bool:
        with self._turn:
            has_come, self._due = not self._due, ""
        return has_come

    def observe(self, _topic: Topic, message: Message | bytes) -> None:
        if isinstance(message, CycleResult):
            with self._turn:
                self._saying.send(message)
        elif isinstance(message, CellState):
            now = BEGIN if message.state == "Starting" else message.stage
            with self._turn:
                if now and now == self._due:
                    self._due = ""
                    self._saying.send(None)
                    self._saying.recv()


def _run(station: Station, asked: Connection, saying: Connection) -> None:
    """Until the other side closes its pipe."""
    moment = _Moment(saying)
    with running_cell(station, moment.observe) as daemon:
        answers: dict[str, Callable[..., Any]] = {
            "command": daemon.command,
            "objects_left": daemon.objects_left,
            "expect": moment.expect,
            "give_up": moment.give_up,
        }
        asked.send("ready")
        while True:
            try:
                verb, *arguments = asked.recv()
            except (EOFError, OSError):
                return
            asked.send(answers[verb](*arguments))

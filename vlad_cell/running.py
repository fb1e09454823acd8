"""A running cell, commanded from Python: ``Cell``, and a simulated one: ``simulated_cell``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from bus import topics
from bus.at_end import cancel_close_at_end, close_at_end
from bus.commands import CellHealth, CellState, CommandRequest
from bus.errors import CellUnreachable, ConfigError, NotReached, ReplyTimeout
from bus.messages import CycleResult, Job
from cell.cli.fleet import fleet
from cell.client import LEADS_TO, Client, client_name, connect
from cell.daemon.batch import Batch
from cell.machine.states import ENDED, SETTLED, told
from config.schema import Station
from vlad_cell.job import ToLay, ToPick, job_of
from vlad_cell.pick import Pick, Progress
from vlad_cell.picks import Picks
from vlad_cell.said import Said, attended, next_message
from vlad_cell.simulation import running
from vlad_cell.station import Config, Settings, station_of


class Cell:
    """A connection to one running cell. Use it in a ``with``, or call `close`; from one thread at a time.

    With its first command that moves the arm it takes the lease: the arm moves while this program runs. When the
    ``with`` ends, or the program does, the lease is given back, and motion that still continues is held. A cell that
    was started by `simulated` ends then, too.

    Args:
        endpoint: where the cell answers, as ``tcp/127.0.0.1:7447``; "" = the station's.
        cell_id: its id; "" = the station's, or without a ``config`` the only cell that answers at the endpoint.
        config: the station, or the path of its file: endpoint, id and certificates of the cell.
        settings: single settings of it by their full names (docs/settings.md).
        name: of this program, as the cell shows who holds the lease.

    Raises:
        CellUnreachable: no cell answers there.
        ConfigError: the station is wrong, or several cells answer and none was named.
    """

    def __init__(
        self,
        endpoint: str = "",
        *,
        cell_id: str = "",
        config: Config = None,
        settings: Settings | None = None,
        name: str = "python",
    ) -> None:
        named = {"endpoint": ("bus.endpoint", endpoint or None), "cell_id": ("cell_id", cell_id or None)}
        station = station_of(config, settings, named)
        if config is None and not cell_id and "cell_id" not in (settings or {}):
            station = station.model_copy(update={"cell_id": _only_cell(station)})
        with ExitStack() as stack:
            self._open(station, name, stack)

    def _open(self, station: Station, name: str, stack: ExitStack) -> None:
        """Connect; what ``stack`` holds then belongs to this cell."""
        self._station = station
        self._client: Client = stack.enter_context(connect(station, (topics.EVENT,), client_id=client_name(name)))
        self._stack = stack.pop_all()
        close_at_end(self.close)

    @classmethod
    def simulated(
        cls,
        *,
        seed: int | None = None,
        objects: str | Path | None = None,
        folder: str | Path | None = None,
        config: Config = None,
        settings: Settings | None = None,
    ) -> Cell:
        """Start a simulated cell beside this program, on a free port, and connect to it.

        It ends with the ``with``, with `close`, and with this program, however that ends.

        Args:
            seed: of the objects' order and poses, and of the camera's noise.
            objects: folder of ``NAME/object.xml`` objects or of meshes; None = the paper's five.
            folder: of the recordings; None = the station's, ``recordings`` in the working folder.
            config: a simulated station, or the path of its file.
            settings: single settings of it, as ``{"sim.pace": 1}`` for a cell at real-time pace.

        Raises: ConfigError for a wrong setting, or a station with real devices; what keeps the cell from starting.
        """
        named = {
            "seed": ("sim.seed", seed),
            "objects": ("sim.objects", objects),
            "folder": ("recording.folder", folder),
        }
        cell = cls.__new__(cls)
        with ExitStack() as stack:
            station = stack.enter_context(running(station_of(config, settings, named)))
            cell._open(station, "python", stack)
        return cell

    def __enter__(self) -> Cell:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the lease back and end the connection; a simulated cell ends, too. Idempotent."""
        cancel_close_at_end(self.close)
        self._stack.close()

    @property
    def endpoint(self) -> str:
        """Where the cell answers: for `Cell` in another program, or ``--set bus.endpoint=...`` of a command."""
        return self._station.bus.endpoint

    @property
    def station(self) -> Station:
        """The station that this program knows the cell by; that of a running cell is in its recordings."""
        return self._station

    # --- ask ----------------------------------------------------------------------------------------------------------

    def state(self) -> CellState:
        """What the cell does now: ``state``, ``stage``, ``available`` commands, ``reason``. Raises: BusError."""
        return self._client.state()

    def health(self) -> CellHealth:
        """How the cell and its nodes are. Raises: BusError."""
        return self._client.health()

    # --- command ------------------------------------------------------------------------------------------------------

    def reset(self, timeout_s: float = 60.0) -> CellState:
        """Check the cell, and move the arm to the capture pose; returns when it is Idle.

        Raises: Refused in another state than Stopped or Complete; NotReached when it ended elsewhere; BusError.
        """
        return self._carry_out("reset", timeout_s, "Idle")

    def stop(self, timeout_s: float = 60.0) -> CellState:
        """Brake on the path, and confirm the rest; returns when the cell is Stopped. Raises: Refused, BusError."""
        return self._carry_out("stop", timeout_s, "Stopped")

    def abort(self, timeout_s: float = 60.0) -> CellState:
        """Brake now; returns when the cell is Aborted. Then `clear` and `reset`. Raises: Refused, BusError."""
        return self._carry_out("abort", timeout_s, "Aborted")

    def clear(self, timeout_s: float = 60.0) -> CellState:
        """Acknowledge an abort; returns when the cell is Stopped. Raises: Refused, NotReached, BusError."""
        return self._carry_out("clear", timeout_s, "Stopped")

    def hold(self, timeout_s: float = 60.0) -> CellState:
        """Pause a running cycle; returns when it is Held. Raises: Refused, NotReached, BusError."""
        return self._carry_out("hold", timeout_s)

    def unhold(self, timeout_s: float = 60.0) -> CellState:
        """Go on with a held cycle; returns when it runs. Raises: Refused, NotReached, BusError."""
        return self._carry_out("unhold", timeout_s)

    def cancel(self, job_id: str) -> None:
        """Cancel the job ``job_id``, as long as the arm has not set out for its grasp. Raises: Refused, BusError."""
        self._client.command("cancel", job=Job(job_id=job_id))

    def _carry_out(self, verb: str, timeout_s: float, wanted: str = "") -> CellState:
        with attended(self._client):
            self._client.command(verb)
            state = self._client.wait_for_state({*LEADS_TO[verb], *ENDED}, timeout_s)
        if state.state != wanted if wanted else state.state not in LEADS_TO[verb]:
            why = told(state.state, state.reason)
            raise NotReached(f"After {verb} the cell is {state.state}: {why}", "See `cell status`.")
        return state

    def release(self) -> None:
        """Give the lease back, so that others may command; motion that still continues is held. Idempotent."""
        self._client.release()

    # --- pick ---------------------------------------------------------------------------------------------------------

    def pick(
        self,
        target: ToPick = None,
        place: ToLay = None,
        *,
        job_id: str = "",
        deadline_s: float | None = None,
        max_force_n: float | None = None,
        from_above: bool = False,
        clear_way: bool = False,
        queue: bool = False,
        object_name: str | None = None,
        progress: Progress | None = None,
        timeout_s: float = 600.0,
    ) -> CycleResult:
        """Pick one object, and wait for the result. The cell must be Idle or Complete.

        A pick that fails is no error of this program: look at ``result`` (SUCCESS, FAILED, ABORTED, EMPTY), ``code``,
        ``reason`` and ``advice``. After Ctrl-C nobody attends the motion, so the cell holds it; `unhold` goes on.

        Args:
            target: the object in words, as ``"the largest red one"``, or a `Target` by ``pixel``, ``box`` or
                ``point_m``; None = the one with the best grasp.
            place: where it is laid: the name of a place of the station; x, y, z [m] in ``base`` and perhaps a heading
                [rad]; or a `Place`. None = the tray.
            job_id: your own name for it; it comes back in the result and the recording.
            deadline_s: no grasp begins after so many seconds.
            max_force_n: largest grasping force.
            from_above: only grasps that come from above.
            clear_way: what lies on the target is picked first, in cycles of its own.
            queue: while the cell works, wait for the turn instead of being refused.
            object_name: simulation only: the object to present; None = the next one.
            progress: called with a line at every state, stage and event, as ``print``.
            timeout_s: how long to wait for the result.

        Raises:
            Refused: the cell does not accept it now, or cannot do it at all; nothing moved for it.
            ReplyTimeout: there is no result yet; the lease is kept, and the motion continues.
            ConfigError, BusError.
        """
        begun = self.begin_pick(
            target,
            place,
            job_id=job_id,
            deadline_s=deadline_s,
            max_force_n=max_force_n,
            from_above=from_above,
            clear_way=clear_way,
            queue=queue,
            object_name=object_name,
        )
        return begun.wait(timeout_s, progress)

    def begin_pick(
        self,
        target: ToPick = None,
        place: ToLay = None,
        *,
        job_id: str = "",
        deadline_s: float | None = None,
        max_force_n: float | None = None,
        from_above: bool = False,
        clear_way: bool = False,
        queue: bool = False,
        object_name: str | None = None,
    ) -> Pick:
        """Begin a pick, and return at once; the arguments and errors are those of `pick`."""
        job = job_of(target, place, job_id, deadline_s, max_force_n, from_above, clear_way, queue)
        self._forget()
        reply = self._client.command("pick", object_name=object_name, job=job)
        return Pick(self._client, reply.cycle_id, reply.job_id, reply.position)

    def picks(self, cycles: int = 1, *, until_empty: bool = False, target: ToPick = None) -> Iterator[CycleResult]:
        """Pick several times; the result of each cycle is given as soon as it is there. The cell must be Idle.

        Args:
            cycles: how many picks.
            until_empty: instead, until nothing is left or picks fail in a row.
            target: as of `pick`, of every pick.

        Raises: as `pick`; NotReached when the cell is stopped, aborts, or ends the job (a full place) before the end.
        """
        if until_empty and cycles != 1:
            raise ConfigError("cycles and until_empty exclude each other.", "Give a number of picks, or until_empty.")
        batch = Batch(CommandRequest(cycles=cycles, until_empty=until_empty), self._station.retry)
        job = job_of(target, None, "", None, None, False, False, False)
        self._forget()
        reply = self._client.command("start", cycles=cycles, until_empty=until_empty, job=job)
        yield from Picks(self._client, batch, reply)

    def events(self, timeout_s: float = 600.0) -> Iterator[Said]:
        """What the cell says from now on, until it settles after something moved; who commanded it does not matter.

        Args:
            timeout_s: longest silence.

        Raises: ReplyTimeout after so long a silence; CellUnreachable when the cell is gone.
        """
        self._forget()
        moved = self.state().state not in SETTLED
        while (said := next_message(self._client, timeout_s)) is not None:
            yield said
            if isinstance(said, CellState):
                if moved and said.state in SETTLED:
                    return
                moved = moved or said.state not in SETTLED
        raise ReplyTimeout(f"The cell has said nothing for {timeout_s:.0f} s.", "See `cell status`.")

    def _forget(self) -> None:
        """Drop what was heard before now."""
        for _ in self._client.heard():
            pass


def simulated_cell(
    *,
    seed: int | None = None,
    objects: str | Path | None = None,
    folder: str | Path | None = None,
    config: Config = None,
    settings: Settings | None = None,
) -> Cell:
    """A simulated cell for a ``with``; the same as `Cell.simulated`, with its arguments and errors."""
    return Cell.simulated(seed=seed, objects=objects, folder=folder, config=config, settings=settings)


def _only_cell(station: Station) -> str:
    """The id of the only cell at the station's endpoint. Raises: CellUnreachable, ConfigError, BusError."""
    names = [member.cell_id for member in fleet(station)]
    if not names:
        raise CellUnreachable(f"No cell answers at {station.bus.endpoint}.", "Start it with `cell start`.")
    if len(names) > 1:
        raise ConfigError(
            f"Several cells answer at {station.bus.endpoint}.", f"Name one: cell_id, of {', '.join(names)}."
        )
    return names[0]

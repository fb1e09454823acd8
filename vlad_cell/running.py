"""A running cell, commanded from Python: ``Cell``, and a simulated one: ``simulated_cell``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from bus.commands import CommandRequest
from bus.errors import ConfigError
from bus.messages import CycleResult, Job
from bus.messages.job import job_of
from cell.daemon.batch import Batch
from vlad_cell.job import ToLay, ToPick, place_of, target_of, wrong_argument_named
from vlad_cell.pick import Pick, Progress
from vlad_cell.picks import Picks
from vlad_cell.simulation import running
from vlad_cell.state_commands import StateCommands
from vlad_cell.station import Config, Settings, station_of


class Cell(StateCommands):
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
        ``reason`` and ``advice``. After Ctrl-C, or an error that ``progress`` raises, nobody attends the motion, so the
        cell holds it; `unhold` goes on.

        Args:
            target: the object in words, as ``"the largest red one"``; x, y, z [m] in ``base`` of a point on it; or a
                `Target` by ``pixel``, ``box`` or ``point_m``; None = the one with the best grasp.
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
        with wrong_argument_named():
            job = job_of(
                target_of(target),
                place_of(place),
                job_id=job_id,
                deadline_s=deadline_s,
                max_force_n=max_force_n,
                from_above=from_above,
                clear_way=clear_way,
                queue=queue,
            )
        self._forget()
        reply = self._client.command("pick", object_name=object_name, job=job)
        return Pick(self._client, reply.cycle_id, reply.job_id, reply.position)

    def picks(self, cycles: int = 1, *, until_empty: bool = False, target: ToPick = None) -> Iterator[CycleResult]:
        """Pick several times; the result of each cycle is given as soon as it is there. The cell must be Idle.

        They begin with the first result that is asked for. Who leaves the loop before the end (``break``) attends them
        no more: the cell holds the motion that continues, and begins no further pick.

        Args:
            cycles: how many picks.
            until_empty: instead, until nothing is left or picks fail in a row.
            target: as of `pick`, of every pick.

        Raises: as `pick`; NotReached when the cell is stopped, aborts, or ends the job (a full place) before the end.
        """
        if until_empty and cycles != 1:
            raise ConfigError("cycles and until_empty exclude each other.", "Give a number of picks, or until_empty.")
        with wrong_argument_named():
            batch = Batch(CommandRequest(cycles=cycles, until_empty=until_empty), self._station.retry)
            job = Job(target=target_of(target))
        self._forget()
        reply = self._client.command("start", cycles=cycles, until_empty=until_empty, job=job)
        yield from Picks(self._client, batch, reply)


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

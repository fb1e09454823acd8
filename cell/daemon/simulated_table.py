"""The objects on the simulated table: presented for a cycle, and read back after it. Unknown on hardware."""

from __future__ import annotations

from bus.commands import CommandRequest, Presented, PresentRequest
from bus.errors import Refused
from config.schema import Station
from drivers.interface import ObjectPresenter


class SimulatedTable:
    """The simulated table, as the actions use it.

    Args:
        presenter: puts objects on the simulated table; None on hardware.
    """

    def __init__(self, presenter: ObjectPresenter | None, station: Station) -> None:
        self._presenter, self._station = presenter, station
        self._is_filled = station.sim.clutter > 0
        self._before: Presented | None = None
        self._names: tuple[str, ...] = ()

    def look(self) -> None:
        """Ask for the available objects; at every reset, because a node may have restarted.

        Raises: DriverError, BusError.
        """
        if self._presenter is not None:
            self._names = self._presenter.truth().names

    def require_possible(self, request: CommandRequest) -> None:
        """Refuse a request that the simulated, or the real, table cannot fulfil. Raises: Refused."""
        if self._presenter is None:
            if request.object is not None:
                raise Refused(
                    f"Only a simulated cell presents an object: {request.object!r} cannot be.",
                    "Pick without naming one. To choose what is picked, set perception.target.",
                    code="NOT_SIMULATED",
                )
            return
        if request.until_empty and not self._is_filled:
            raise Refused(
                "Every cycle brings a new object: the table is never empty.",
                "Use config/bin.toml, or set sim.clutter.",
                code="NEVER_EMPTY",
            )
        if request.object is not None and self._is_filled:
            raise Refused(
                f"The table was filled at the start: {request.object!r} cannot be presented.",
                "Pick without naming an object, or set sim.clutter = 0.",
                code="TABLE_FILLED",
            )
        if request.object is not None and self._names and request.object not in self._names:
            advice = f"There are: {', '.join(self._names)}."
            raise Refused(f"There is no object {request.object!r}.", advice, code="UNKNOWN_OBJECT")

    def present(self, number: int, name: str | None, *, again: bool = False) -> str:
        """Put the cycle's object on the table; return its name, or "" when several objects are there.

        Args:
            number: of the pick. ``name``: None = the next of the seeded order.
            again: the table stays unchanged: a further attempt of the pick, or somebody has pointed at what lies there.

        Raises: DriverError, BusError.
        """
        if self._presenter is None:
            return ""
        request = PresentRequest(object=name, cycle=number, seed=self._station.sim.seed)
        self._before = self._presenter.truth() if again else self._presenter.present(request)
        return "" if self._is_filled else self._before.object

    def taken(self, presented: str) -> str:
        """Return the object that the cycle took: ``presented``; of several, those that left the pick region, or ""."""
        if not self._is_filled or self._presenter is None or self._before is None:
            return presented
        pairs = zip(
            self._before.objects, self._inside(self._before), self._inside(self._presenter.truth()), strict=True
        )
        return ", ".join(one.name for one, was_inside, is_inside in pairs if was_inside and not is_inside)

    def left(self) -> int | None:
        """Number of objects really in the pick region; None on hardware. Raises: DriverError, BusError."""
        return None if self._presenter is None else sum(self._inside(self._presenter.truth()))

    def _inside(self, truth: Presented) -> list[bool]:
        x_min, x_max, y_min, y_max = self._station.scene.pick_region_m
        places = [one.base_from_object[:2, 3] for one in truth.objects]
        return [bool(x_min < x < x_max and y_min < y < y_max) for x, y in places]

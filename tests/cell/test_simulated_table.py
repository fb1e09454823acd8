"""What a cycle took, by the presenter's truth before and after it."""

from __future__ import annotations

import numpy as np
import pytest

from bus.commands import CommandRequest, Presented, PresentedObject, PresentRequest
from bus.errors import Refused
from cell.daemon.simulated_table import SimulatedTable
from config.load import DEFAULT_STATION, load_station

FILLED = load_station(DEFAULT_STATION.with_name("bin.toml"))
INSIDE, TRAY = (0.45, 0.0), (0.37, 0.48)


class MovedObjects:
    """An object presenter whose objects are moved by the test."""

    def __init__(self, **places: tuple[float, float]) -> None:
        self.places = places

    def present(self, request: PresentRequest) -> Presented:
        return self.truth()

    def truth(self) -> Presented:
        return Presented(
            objects=tuple(PresentedObject(name=n, base_from_object=_at(p)) for n, p in self.places.items()),
            names=("cup", "drone", "spatula"),
        )


def _at(place_m: tuple[float, float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:2, 3] = place_m
    return pose


@pytest.mark.parametrize(
    ("after", "taken"),
    [
        ({"cup": INSIDE, "drone": INSIDE}, ""),
        ({"cup": TRAY, "drone": INSIDE}, "cup"),
        ({"cup": TRAY, "drone": (0.9, 0.9)}, "cup, drone"),
    ],
)
def test_of_several_it_is_what_left_the_pick_region(after: dict[str, tuple[float, float]], taken: str) -> None:
    presenter = MovedObjects(cup=INSIDE, drone=INSIDE)
    table = SimulatedTable(presenter, FILLED)
    presented = table.present(0, None)
    presenter.places = after
    assert (presented, table.taken(presented)) == ("", taken)


def test_what_lay_in_the_tray_before_was_not_taken_now() -> None:
    table = SimulatedTable(MovedObjects(cup=TRAY, drone=INSIDE), FILLED)
    table.present(0, None)
    assert table.taken("") == "" and table.left() == 1


def test_the_only_object_is_the_cycles_wherever_it_ended() -> None:
    table = SimulatedTable(MovedObjects(cup=INSIDE), load_station())
    assert table.taken(table.present(0, "cup")) == "cup"


def test_on_hardware_nobody_knows() -> None:
    table = SimulatedTable(None, load_station())
    assert (table.present(0, None), table.taken(""), table.left()) == ("", "", None)


def test_an_unknown_object_is_refused_with_those_there_are() -> None:
    table = SimulatedTable(MovedObjects(cup=INSIDE), load_station())
    table.look()
    table.require_possible(CommandRequest(object="drone"))
    with pytest.raises(Refused, match=r"no object 'unicorn'\. There are: cup, drone, spatula\.") as refusal:
        table.require_possible(CommandRequest(object="unicorn"))
    assert refusal.value.code == "UNKNOWN_OBJECT"


def test_a_real_table_cannot_present_an_object_by_name() -> None:
    table = SimulatedTable(None, load_station())
    table.require_possible(CommandRequest())
    with pytest.raises(Refused, match=r"Only a simulated cell .*perception\.target") as refusal:
        table.require_possible(CommandRequest(object="cup"))
    assert refusal.value.code == "NOT_SIMULATED"

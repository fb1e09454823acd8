"""What a cycle took, by the feeder's truth before and after it."""

from __future__ import annotations

import numpy as np
import pytest

from bus.commands import CommandRequest, Presented, PresentedObject, PresentRequest
from bus.errors import Refused
from cell.daemon.presenter import Feed
from config.load import DEFAULT_STATION, load_station

FILLED = load_station(DEFAULT_STATION.with_name("bin.toml"))
INSIDE, TRAY = (0.45, 0.0), (0.37, 0.48)


class Table:
    """A feeder whose objects are moved by the test."""

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
    table = Table(cup=INSIDE, drone=INSIDE)
    feed = Feed(table, FILLED)
    presented = feed.present(0, None)
    table.places = after
    assert (presented, feed.taken(presented)) == ("", taken)


def test_what_lay_in_the_tray_before_was_not_taken_now() -> None:
    table = Table(cup=TRAY, drone=INSIDE)
    feed = Feed(table, FILLED)
    feed.present(0, None)
    assert feed.taken("") == "" and feed.left() == 1


def test_the_only_object_is_the_cycles_wherever_it_ended() -> None:
    feed = Feed(Table(cup=INSIDE), load_station())
    assert feed.taken(feed.present(0, "cup")) == "cup"


def test_on_hardware_nobody_knows() -> None:
    feed = Feed(None, load_station())
    assert (feed.present(0, None), feed.taken(""), feed.left()) == ("", "", None)


def test_an_unknown_object_is_refused_with_those_there_are() -> None:
    feed = Feed(Table(cup=INSIDE), load_station())
    feed.look()
    feed.require_possible(CommandRequest(object="drone"))
    with pytest.raises(Refused, match=r"no object 'unicorn'\. There are: cup, drone, spatula\.") as refusal:
        feed.require_possible(CommandRequest(object="unicorn"))
    assert refusal.value.code == "UNKNOWN_OBJECT"


def test_a_real_table_cannot_present_an_object_by_name() -> None:
    feed = Feed(None, load_station())
    feed.require_possible(CommandRequest())
    with pytest.raises(Refused, match=r"Only a simulated cell .*perception\.target") as refusal:
        feed.require_possible(CommandRequest(object="cup"))
    assert refusal.value.code == "NOT_SIMULATED"

"""The doors that `cell start` opens beside the cell: checked before anything starts, closed before the cell is."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager

from cell.http.access import Access
from cell.http.needs import require_packages
from cell.nodes.doors import Door, News
from config.schema import Station


def wanted(station: Station, *, http: bool) -> list[str]:
    """The names of the doors to open: those of the station, and those that an option asks for.

    Raises: ConfigError when one of them cannot be opened so.
    """
    asked = {"http": (http or station.http.enabled, _require_http)}
    names = [name for name, (is_wanted, _) in asked.items() if is_wanted]
    for name in names:
        asked[name][1](station)
    return names


def _require_http(station: Station) -> None:
    require_packages()
    Access.of(station.http, os.environ)


@contextmanager
def opened(
    names: Sequence[str], station: Station, on_news: News, door: Callable[[str, Station, News], Door] = Door
) -> Iterator[None]:
    """Context in which the doors are open; what becomes of them is told as events."""
    with ExitStack() as stack:
        for name in names:
            stack.enter_context(closing(door(name, station, on_news).start()))
        yield

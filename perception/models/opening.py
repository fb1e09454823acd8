"""Opens another package's detector or goal-image model: who waits is told for what, and not for ever."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TypeVar

from bus.cancel import Cancel
from config.plug_ins import Group
from perception.models.calls import Call, GivenUp

_log = logging.getLogger(__name__)
PlugInT = TypeVar("PlugInT")
SLOW_S = 10.0
"""Who waits longer is told for whom."""
LIMIT_S = 600.0
"""Most time for a start; weights may take minutes to load, and longer to download."""


def opened_in_time(group: Group, name: str, open_plug_in: Callable[[], PlugInT]) -> PlugInT:
    """Return what ``open_plug_in`` returns; one of another package runs on a thread, as each of its calls does.

    Raises: as ``open_plug_in``; the group's failure when it takes longer than `LIMIT_S`: it is left behind then.
    """
    package = group.package_of(name)
    if not package:
        return open_plug_in()
    whose = f"{group.kind} {name!r} of {package}"
    call = Call(open_plug_in, lambda _: None, name)
    if call.lasts(SLOW_S):
        _log.warning("waiting for the %s to start, up to %g s", whose, LIMIT_S)
    try:
        return call.wait(LIMIT_S, Cancel())
    except GivenUp:
        what = f"The {whose} has not started within {LIMIT_S:g} s."
        raise group.failure(what, "Its own documentation says what it needs.") from None

"""Name -> the detector that finds the grasps.

Ours is ``vlad`` (`perception.detector`). Another package brings one as an entry point of the group
``vlad_cell.detectors``: a class or function that is given the station, and its checked settings if it has any.
"""

from __future__ import annotations

from bus.errors import ConfigError
from config.plug_ins import Group
from config.schema import Station
from perception.detectors.base import GraspDetector

OURS = "vlad"
GROUP = Group("vlad_cell.detectors", kind="detector", key="perception.detector", reserved=(OURS,))


def open_detector(station: Station) -> GraspDetector | None:
    """Return the detector that the station names; None = ours.

    Raises: ConfigError for an unknown name, for a package that cannot be imported, and for a setting, which it names.
    """
    name = station.perception.detector
    if name == OURS:
        return None
    detector: GraspDetector = GROUP.opened(name, station, station.perception.settings, "perception.settings")
    if lacking := [what for what in ("is_deterministic", "detect", "close") if not hasattr(detector, what)]:
        raise ConfigError(f"The detector {name!r} has no {lacking[0]!r}.", "See docs/extend.md.")
    if not isinstance(detector.is_deterministic, bool):
        what = f"is_deterministic of the detector {name!r} is {detector.is_deterministic!r}, and no True or False."
        raise ConfigError(what, "Correct it there: a replay asks a deterministic one again.")
    return detector

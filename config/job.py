"""The settings of the station as a job changes them for its cycles, and whether it can be done at all.

A cycle runs with, records and replays the station that its job makes: no stage reads the job itself.
"""

from __future__ import annotations

from bus.errors import Refused
from bus.messages.job import GraspHints, Job, Place, Target
from config.scene import SceneSettings, floor_m
from config.schema import Station
from config.target import TargetSettings, outside_picture
from config.words import understood

_PLACE_KEYS = ("scene.place_m", "scene.place_pattern_m", "scene.place_higher_m", "scene.place_yaw_rad")
_MAX_DROP_M = 0.25
"""Highest place above what is below it: nothing needs more, since what hangs far below the hand is let go higher."""


def station_for(station: Station, job: Job, laid: int) -> Station:
    """Return the station with the job's target, place and grasp in place of its own.

    Args:
        laid: number of objects laid at that place before, which chooses from its pattern.
    """
    update = {
        "scene": _placing(station.scene, job.place, laid),
        "perception": station.perception.model_copy(update=_perceiving(station, job)),
        "hand": station.hand.model_copy(update=_holding(station, job.grasp)),
    }
    return station.model_copy(update=update)


def set_by(job: Job, key: str) -> bool:
    """Return whether the setting ``key`` of a cycle's station is the job's own, and not the station's."""
    is_set = {
        "perception.target": job.target is not None,
        "perception.from_above": job.grasp.from_above,
        "hand.grasp_force_n": job.grasp.max_force_n is not None,
        **dict.fromkeys(_PLACE_KEYS, job.place is not None),
    }
    return any(given and (key == name or key.startswith(f"{name}.")) for name, given in is_set.items())


def place_of(job: Job) -> str:
    """Return the name of the place that a job uses; "" for the station's tray, or a position."""
    return job.place.name or "" if job.place is not None else ""


def capacity_of(station: Station, name: str) -> int:
    """Return how many objects a place takes; 0 = any number."""
    return next((place.capacity for place in station.scene.places if place.name == name), 0)


def require_possible(
    station: Station, job: Job, *, reads_text: bool, picture_px: tuple[int, int] | None = None
) -> None:
    """Refuse a job that this station cannot do; the refusal names the field.

    Args:
        reads_text: a model finds targets by any words.
        picture_px: width and height of the camera's pictures; None = not known yet: detect looks then.

    Raises: Refused (BAD_JOB).
    """
    target, place, force_n = job.target, job.place, job.grasp.max_force_n
    if target is not None:
        _require_target(station, target, reads_text)
        if picture_px is not None and (why := outside_picture(target.pixel, target.box, picture_px)):
            raise _bad("target.pixel" if target.box is None else "target.box", why)
    if place is not None and place.name is not None:
        _require_known(place.name, station.scene)
    if place is not None and place.position_m is not None:
        _require_just_above(place.position_m, station.scene)
    if force_n is not None and force_n > station.hand.max_force_n:
        raise _bad("grasp.max_force_n", f"the hand presses with at most {station.hand.max_force_n:.0f} N")


def _require_target(station: Station, target: Target, reads_text: bool) -> None:
    if target.text is not None and not reads_text:
        try:
            understood(target.text, station.perception.labels)
        except ValueError as why:
            raise _bad("target.text", str(why)) from why
    if target.box is not None and not (target.box[0] < target.box[2] and target.box[1] < target.box[3]):
        raise _bad("target.box", "it is (u_min, v_min, u_max, v_max), from its upper left to its lower right corner")
    if target.point_m is not None:
        x_min, x_max, y_min, y_max = station.scene.pick_region_m
        x, y, _ = target.point_m
        if not (x_min <= x <= x_max and y_min <= y <= y_max):
            raise _bad("target.point_m", f"it is outside the pick region, x {x_min}..{x_max}, y {y_min}..{y_max} m")


def _require_known(name: str, scene: SceneSettings) -> None:
    names = [place.name for place in scene.places]
    if name not in names:
        there = f"there are {', '.join(names)}" if names else "this station has none (scene.places)"
        raise _bad("place.name", f"there is no place {name!r}; {there}")


def _require_just_above(position_m: tuple[float, float, float], scene: SceneSettings) -> None:
    x, y, z = position_m
    top_m = floor_m(scene, x, y)
    if top_m is None:
        raise _bad("place.position_m", f"below ({x:.3f}, {y:.3f}) there is no table, tray or box to lay anything on")
    if z < top_m:
        raise _bad("place.position_m", f"z = {z:.3f} m is below what is there, whose top is at {top_m:.3f} m")
    if z > top_m + _MAX_DROP_M:
        why = f"z = {z:.3f} m is {z - top_m:.2f} m above what is there, and what is let go falls"
        raise _bad("place.position_m", f"{why}; at most {top_m + _MAX_DROP_M:.3f} m")


def _bad(field: str, why: str) -> Refused:
    return Refused(f"{field}: {why}.", "Correct that field of the job and send it again: docs/use.md.", code="BAD_JOB")


def _placing(scene: SceneSettings, place: Place | None, laid: int) -> SceneSettings:
    """Return the scene whose place is the job's ``laid``-th; the others of its pattern follow in turn."""
    position_m, pattern_m, yaw_rad = scene.place_m, scene.place_pattern_m, scene.place_yaw_rad
    if place is not None and place.position_m is not None:
        position_m, pattern_m, yaw_rad = place.position_m, ((0.0, 0.0),), place.yaw_rad
    elif place is not None:
        named = next(one for one in scene.places if one.name == place.name)
        position_m, pattern_m, yaw_rad = named.position_m, named.pattern_m, named.yaw_rad
    turn = laid % len(pattern_m)
    (dx, dy), (x, y, z) = pattern_m[turn], position_m
    from_it_m = tuple((u - dx, v - dy) for u, v in (*pattern_m[turn:], *pattern_m[:turn]))
    update: dict[str, object] = {"place_m": (x + dx, y + dy, z), "place_pattern_m": from_it_m, "place_yaw_rad": yaw_rad}
    if place is not None:
        update["place_higher_m"] = 0.0  # where a job says, and nowhere else
    return scene.model_copy(update=update)


def _perceiving(station: Station, job: Job) -> dict[str, object]:
    changed: dict[str, object] = {}
    if job.target is not None:
        changed["target"] = TargetSettings(**job.target.model_dump(exclude={"picture_ns"}))
    if job.grasp.from_above:
        changed["from_above"] = True
    return changed


def _holding(station: Station, grasp: GraspHints) -> dict[str, object]:
    if grasp.max_force_n is None:
        return {}
    return {"grasp_force_n": min(grasp.max_force_n, station.hand.grasp_force_n)}

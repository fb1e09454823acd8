"""Is it more than one thing that hangs in the hand? By load, width and place, above what one thing explains. Pure."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus.messages import Detections, Grasp, HandState, Observation
from bus.messages.execution import Witness
from bus.transforms import apply, inverse
from config.schema import Station
from perception.geometry.depth import registered, without_flying_pixels
from perception.scene.change import points_of
from perception.scene.depth_view import DepthView
from perception.scene.gone import Others, others_gone
from perception.scene.jaw import in_jaw

_G_M_S2 = 9.81
_CELL_M = 0.004
_BESIDE_M, _PAD_M, _ABOVE_M, _BELOW_M = 0.004, 0.012, 0.05, 0.02
"""Between the opened fingers, and so far beyond either; to either side across them; above and below the tcp."""
_FEWEST = 8


class OneThing(NamedTuple):
    """The thing that a grasp is for, as it was seen: what it can explain by itself.

    Attributes:
        volume_m3: of all below its seen surface down to the table: no less than its own, where nothing hides it.
        longest_m: the diagonal of the box around it; no width of it is more. NaN in a scene that does not number it.
        has_neighbour: another thing lies where the fingers close, or on it.
    """

    volume_m3: float
    longest_m: float
    has_neighbour: bool

    def weighs_n(self, density_kg_m3: float) -> float:
        """Its weight [N] if it is nowhere denser than that."""
        return self.volume_m3 * density_kg_m3 * _G_M_S2


class Several(NamedTuple):
    """The signs that more than one thing was picked: the ``witnesses``, the other things gone, and it all in words."""

    witnesses: tuple[Witness, ...]
    also_gone: tuple[int, ...]
    reason: str


def one_thing(detections: Detections, grasp: Grasp, before: Observation) -> OneThing:
    """Measure what the thing of a grasp can explain.

    Args:
        before: the look that is shown in ``detections``.
    """
    sizes_m = [one.size_m for one in detections.scene.instances if one.number == grasp.instance]
    volume_m3 = _volume_m3(detections, grasp.instance, before)
    longest_m = float(np.linalg.norm(sizes_m[0])) if sizes_m else float("nan")
    return OneThing(volume_m3, longest_m, _has_neighbour(detections, grasp, before))


def may_be_several(one: OneThing, load_n: float, station: Station) -> bool:
    """Whether the load, or what lies beside the thing, leaves it open that more than one was picked."""
    need = station.verify
    is_heavy = load_n > one.weighs_n(need.clear_density_kg_m3) or _is_over(load_n, need.max_load_n)
    return is_heavy or one.has_neighbour


def several(
    detections: Detections,
    grasp: Grasp,
    grasped: HandState,
    load_n: float,
    looks: tuple[Observation, Observation | None],
    station: Station,
) -> Several | None:
    """Return what tells that more than one thing was picked; None when all that was measured can be one.

    Args:
        load_n: in the hold. ``looks``: the one that is shown in ``detections``, and the second capture, if any.
    """
    before, after = looks
    others = Others() if after is None else others_gone(detections, grasp.instance, before, after, station)
    volume_m3 = _volume_m3(detections, grasp.instance, before)
    jaw = in_jaw(detections, grasp, grasped.width_m, before, station)
    in_reach = {*jaw.others, *(number for number in others.apart if number in jaw.swept)}
    also = tuple(number for number in others.gone if number in in_reach)
    found: list[tuple[Witness, str]] = []
    if also:
        which = "the place of another thing is" if len(also) == 1 else f"the places of {len(also)} other things are"
        found.append(("place", f"{which} empty, too"))
    if jaw.has_seam:
        found.append(("seam", "two patches of different colours lay side by side between the fingers"))
    if load := _too_heavy(load_n, volume_m3, station):
        found.append(("load", load))
    if width := _too_wide(detections, grasp, grasped.width_m, station, is_seen=after is not None and not others.unseen):
        found.append(("width", width))
    found = [one for one in found if one[0] in station.verify.several_by]
    if not found:
        return None
    told = "; ".join(text for _, text in found)
    return Several(tuple(name for name, _ in found), also, f"More than one thing was picked: {told}.")


def _too_heavy(load_n: float, volume_m3: float, station: Station) -> str:
    need = station.verify
    if _is_over(load_n, need.max_load_n):
        return f"the arm carries {load_n:.2f} N, one object weighs at most {need.max_load_n:.2f} N"
    most_n = OneThing(volume_m3, 0.0, False).weighs_n(need.max_density_kg_m3) + need.clear_load_n
    if load_n > most_n:
        return f"the arm carries {load_n:.2f} N, what was seen of the thing explains at most {most_n:.2f} N"
    return ""


def _is_over(load_n: float, max_load_n: float | None) -> bool:
    return max_load_n is not None and load_n > max_load_n


def _too_wide(detections: Detections, grasp: Grasp, width_m: float, station: Station, *, is_seen: bool) -> str:
    """In words; "" when the thing can be so wide, or every other thing was seen where it lay: then it was half hidden.

    Args:
        is_seen: the second capture saw the places of all other things. What is gone speaks for itself.
    """
    sizes_m = [one.size_m for one in detections.scene.instances if one.number == grasp.instance]
    if is_seen or not sizes_m:
        return ""
    most_m = float(np.linalg.norm(sizes_m[0])) + station.verify.max_width_loss_m
    if width_m <= most_m:
        return ""
    return f"the fingers stand {width_m * 1e3:.0f} mm apart, the thing is nowhere wider than {most_m * 1e3:.0f} mm"


def _volume_m3(detections: Detections, instance: int, before: Observation) -> float:
    """Of all below what was seen of a thing, in cells of 4 mm."""
    points = points_of(detections, instance, before)
    if not len(points):
        return float("inf")  # of nothing seen, nothing follows
    height_m = apply(inverse(detections.scene.table.base_from_table), points)[:, 2].clip(min=0.0)
    _, cell = np.unique(np.floor(points[:, :2] / _CELL_M).astype(int), axis=0, return_inverse=True)
    top_m = np.zeros(int(cell.max()) + 1)
    np.maximum.at(top_m, cell.ravel(), height_m)
    return float(top_m.sum()) * _CELL_M**2


def _has_neighbour(detections: Detections, grasp: Grasp, before: Observation) -> bool:
    """Whether points of another thing lie between the opened fingers of a grasp."""
    depth_m = without_flying_pixels(before.frame.depth_m)
    _, source = registered(before.frame, depth_m)
    is_other = (detections.scene.labels > 0) & (detections.scene.labels != grasp.instance) & (source >= 0)
    points = DepthView.of(before, depth_m).points_base.reshape(-1, 3)[source[is_other]]
    x, y, z = apply(inverse(np.asarray(grasp.base_from_tcp)), points.astype(float)).T
    inside = (abs(x) < _PAD_M) & (abs(y) < grasp.opening_m / 2 + _BESIDE_M) & (z < _BELOW_M) & (z > -_ABOVE_M)
    return int(inside.sum()) >= _FEWEST

"""Columns of the motion, the verdict and the delivery."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from bus.messages import SegmentRun
from bus.trajectory import TICK_S
from logs.catalogue.column import Column, Told, Value, attribute

Array = npt.NDArray[np.float64]


# --- the motion -------------------------------------------------------------------------------------------------------


def _played(told: Told) -> Iterator[SegmentRun]:
    yield from told.execution.runs if told.execution is not None else ()
    yield from told.delivery.runs if told.delivery is not None else ()


def _segment_s(name: str) -> Callable[[Told], Value]:
    def take(told: Told) -> Value:
        lengths = [len(run.motion.commanded_q_rad) * TICK_S for run in _played(told) if run.name == name]
        return sum(lengths) if lengths else None

    return take


def _most(of: Callable[[SegmentRun], Array]) -> Callable[[Told], Value]:
    """The largest value over all segments; None without any."""

    def take(told: Told) -> Value:
        values = [float(np.max(found)) for run in _played(told) if (found := of(run)).size]
        return max(values) if values else None

    return take


def _torque_nm(run: SegmentRun) -> Array:
    return np.abs(run.motion.tau_ext_nm)


def _tracking_rad(run: SegmentRun) -> Array:
    motion = run.motion
    if not len(motion.commanded_q_rad) or len(motion.t_s) != len(motion.q_rad):
        return np.empty(0)
    tick = np.clip(np.rint(motion.t_s / TICK_S).astype(int), 0, len(motion.commanded_q_rad) - 1)
    error_rad: Array = np.abs(motion.q_rad - motion.commanded_q_rad[tick])
    return error_rad


def _is_closed(told: Told) -> bool:
    return told.execution is not None and told.execution.grasped is not None


def _grasped_m(told: Told) -> Value:
    grasped = told.execution.grasped if told.execution is not None else None
    return grasped.width_m if grasped is not None else None


def _contact(name: str) -> Callable[[Told], Value]:
    def take(told: Told) -> Value:
        met = told.execution.contact if told.execution is not None else None
        value: Value = getattr(met, name) if met is not None else None
        return value

    return take


def _released(told: Told) -> Value:
    return told.delivery is not None and told.delivery.released is not None


def _released_m(told: Told) -> Value:
    released = told.delivery.released if told.delivery is not None else None
    return released.width_m if released is not None else None


def _laid(told: Told) -> Value:
    laid = told.record.result.laid if told.record.result is not None else None
    return laid.place if laid is not None else None


def _laid_m(axis: int) -> Callable[[Told], Value]:
    def take(told: Told) -> Value:
        laid = told.record.result.laid if told.record.result is not None else None
        return float(laid.position_m[axis]) if laid is not None else None

    return take


MOTION = (
    Column("executed", "INTEGER", "", "1: the fingers closed.", _is_closed),
    *(
        Column(f"{name}_s", "REAL", "s", f"Commanded duration of the segment `{name}`.", _segment_s(name))
        for name in ("reach", "carry", "hold", "place", "home", "retreat")
    ),
    Column("stopped_in", "TEXT", "", "The segment or hand action that a stop ended.",
           attribute("execution", "stopped_in")),
    Column("contact_n", "REAL", "N", "Force at which the approach met something; NULL: nothing.", _contact("force_n")),
    Column("contact_remaining_m", "REAL", "m", "From there to the grasp.", _contact("remaining_m")),
    Column("closed_m", "REAL", "m", "Hand width right after closing.", _grasped_m),
    Column("torque_max_nm", "REAL", "Nm", "Largest torque from outside on a joint.", _most(_torque_nm)),
    Column("tracking_max_rad", "REAL", "rad", "Largest distance of a joint from where it was commanded.",
           _most(_tracking_rad)),
)  # fmt: skip

VERDICT = (
    Column("held", "INTEGER", "", "1: it was held at the end of the hold; NULL: no verdict.",
           attribute("verdict", "held")),
    Column("hold_observed_s", "REAL", "s", "How long the hold was observed.", attribute("verdict", "hold_s")),
    Column("width_min_m", "REAL", "m", "Smallest hand width on the way and meanwhile.",
           attribute("verdict", "width_min_m")),
    Column("load_n", "REAL", "N", "Vertical force of the load in the hold.", attribute("verdict", "load_n")),
    Column("carried_n", "REAL", "N", "The same on the way there.", attribute("verdict", "carried_n")),
    Column("cleared_fraction", "REAL", "", "Share of the object's place that was seen empty.",
           attribute("verdict", "cleared_fraction")),
    Column("released", "INTEGER", "", "1: the hand opened to lay it.", _released),
    Column("released_m", "REAL", "m", "Hand width after it.", _released_m),
    Column("laid_place", "TEXT", "", "Place it was laid at; empty: the tray or a position.", _laid),
    Column("laid_x_m", "REAL", "m", "Where the tcp let go, in `base`.", _laid_m(0)),
    Column("laid_y_m", "REAL", "m", "Where the tcp let go, in `base`.", _laid_m(1)),
    Column("laid_z_m", "REAL", "m", "Where the tcp let go, in `base`.", _laid_m(2)),
)  # fmt: skip

"""Rounds the corners of a joint path: straight lines and tcp lines become one curve with continuous acceleration.

The curve at arc length s is the average of the path over [s - w, s + w] with triangular weights (two boxes), so each
corner is cut inside its own triangle and never overshot. The half width w(s) grows smoothly from 0 at the ends, so
that these are exact, to its largest value at each corner.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from bus.arrays import JointSamples

Array = npt.NDArray[np.float64]

CORNER_SHARE = 0.45
"""Share of the shorter neighbour that a corner may take; below 0.5, so that neighbouring corners stay apart."""
_DENSE_RAD = 0.002
_SAMPLES = 301
_SHORT_RAD = 1e-9


@dataclass(frozen=True)
class Curve:
    """A smooth joint path.

    Attributes:
        at_rad: arc lengths (n,), evenly spaced. ``points_rad``: (n, joints); its ends are the path's ends exactly.
        bends: first and last row of every rounded corner; outside of them the curve is the path itself.
    """

    at_rad: Array
    points_rad: JointSamples
    bends: tuple[tuple[int, int], ...]


def blended(pieces: Sequence[JointSamples], share: float = CORNER_SHARE) -> Curve:
    """Return the path through ``pieces`` with its corners rounded.

    Args:
        pieces: each (m, joints), beginning where the one before ends; 2 rows are a straight joint line, more lie on a
            smooth curve.
        share: of the shorter neighbour of each corner; 0 leaves the corners unchanged.
    """
    curves = [_dense(piece) for piece in pieces]
    lengths = np.array([curve[0][-1] for curve in curves])
    curves = [curve for curve, length in zip(curves, lengths, strict=True) if length > _SHORT_RAD]
    lengths = lengths[lengths > _SHORT_RAD]
    if not curves:
        return Curve(np.zeros(1), np.array(pieces[0][:1]), ())
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    s = np.concatenate([[0.0], *[end + at[1:] for end, (at, _) in zip(ends, curves, strict=False)]])
    q = np.concatenate([curves[0][1][:1], *[points[1:] for _, points in curves]])
    at = np.linspace(0.0, ends[-1], _SAMPLES)
    width = _half_width(at, ends, share)
    points_rad = _averaged(s, q, at, width)
    points_rad[0], points_rad[-1] = pieces[0][0], pieces[-1][-1]
    bends = [(np.searchsorted(at + width, end) - 1, np.searchsorted(at - width, end)) for end in ends[1:-1]]
    return Curve(at, points_rad, tuple((max(0, int(a)), min(len(at) - 1, int(b))) for a, b in bends))


def _dense(piece: JointSamples) -> tuple[Array, JointSamples]:
    """Return arc lengths and points along one piece, close enough to integrate."""
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(piece, axis=0), axis=1))])
    if len(piece) == 2 or at[-1] <= _SHORT_RAD:
        return at[[0, -1]], piece[[0, -1]]
    fine = np.linspace(0.0, at[-1], int(np.ceil(at[-1] / _DENSE_RAD)) + 2)
    return fine, np.asarray(CubicSpline(at, piece, bc_type="not-a-knot")(fine))


def _half_width(at: Array, ends: Array, share: float) -> Array:
    """Return w(s) (n,): ``share`` of the shorter neighbour at each corner, 0 at both ends, a smooth step between."""
    lengths = np.diff(ends)
    at_ends = np.concatenate([[0.0], share * np.minimum(lengths[:-1], lengths[1:]), [0.0]])
    piece = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, len(lengths) - 1)
    t = (at - ends[piece]) / lengths[piece]
    step = t**3 * (10 - 15 * t + 6 * t**2)
    return np.asarray(at_ends[piece] * (1 - step) + at_ends[piece + 1] * step)


def _averaged(s: Array, q: JointSamples, at: Array, width: Array) -> JointSamples:
    """Return triangular averages of the polyline ``q(s)`` over ``at`` +- ``width``, from its second antiderivative."""
    ds = np.diff(s)[:, None]
    none = np.zeros((1, q.shape[1]))
    first = np.concatenate([none, np.cumsum(ds * (q[1:] + q[:-1]) / 2, axis=0)])
    second = np.concatenate([none, np.cumsum(ds * first[:-1] + ds**2 * (2 * q[:-1] + q[1:]) / 6, axis=0)])
    slope = np.diff(q, axis=0) / ds

    def antiderivative(x: Array) -> Array:
        row = np.clip(np.searchsorted(s, x, side="right") - 1, 0, len(s) - 2)
        d = (x - s[row])[:, None]
        return np.asarray(second[row] + first[row] * d + q[row] * d**2 / 2 + slope[row] * d**3 / 6)

    plain = np.stack([np.interp(at, s, column) for column in q.T], axis=1)
    wide = width > 1e-3 * s[-1]  # narrower ones would only lose digits
    w, x = width[wide], at[wide]
    total = antiderivative(x + w) - 2 * antiderivative(x) + antiderivative(x - w)
    plain[wide] = total / w[:, None] ** 2
    return np.asarray(plain)

"""Shapes that cross the meridian of 180° are cut there, as RFC 7946 (3.1.9) asks for."""

from __future__ import annotations

import numpy as np

from ..types import Array

TURN, HALF = 360.0, 180.0
"""The circle and its half, degrees."""


def parts_of_line(shape: Array) -> list[Array]:
    """Return the parts of a line (m, 3) on either side of the meridian of 180°.

    Neighbouring vertices that are more than 180° apart are joined across it. A part begins at +180
    or −180 with the height of the crossing.
    """
    x = _continued(shape)
    side = np.floor((x[:, 0] + HALF) / TURN)
    parts, current = [], [x[0]]
    for a, b, sa, sb in zip(x, x[1:], side, side[1:], strict=False):
        if sa != sb:
            at = HALF + TURN * min(sa, sb)
            crossing = a + (at - a[0]) / (b[0] - a[0]) * (b - a)
            parts.append(_back([*current, crossing], sa))
            current = [crossing]
        current.append(b)
    parts.append(_back(current, side[-1]))
    return [p for p in parts if len(p) > 1]


def parts_of_ring(ring: Array) -> list[Array]:
    """Return the parts of a convex or simple closed ring (m, 3) on either side of 180°.

    The order of the vertices, and so the side on which the area is, stays.
    """
    x = _continued(ring)
    sides = np.unique(np.floor((x[:, 0] + HALF) / TURN))
    if len(sides) == 1:
        return [_back(list(x), sides[0])]
    out = []
    for side in sides:
        part = list(x[:-1])
        for edge, sign in ((TURN * side - HALF, 1.0), (TURN * side + HALF, -1.0)):
            part = _clipped(part, edge, sign)
        if len(part) > 2:
            out.append(_back([*part, part[0]], side))
    return out


def _continued(shape: Array) -> Array:
    """Return vertices whose longitudes go on beyond 180° instead of jumping."""
    out = np.array(shape, dtype=float)
    out[:, 0] = np.unwrap(out[:, 0], period=TURN)
    return out


def _back(part: list[Array], side: float) -> Array:
    out = np.array(part)
    out[:, 0] -= TURN * side
    return out


def _clipped(ring: list[Array], edge: float, sign: float) -> list[Array]:
    """Return the part of an open ring where sign (x − edge) ≥ 0 (Sutherland and Hodgman)."""
    out: list[Array] = []
    for a, b in zip([*ring[-1:], *ring[:-1]], ring, strict=True):
        da, db = sign * (a[0] - edge), sign * (b[0] - edge)
        if (da < 0) != (db < 0):
            out.append(a + (edge - a[0]) / (b[0] - a[0]) * (b - a))
        if db >= 0:
            out.append(b)
    return out

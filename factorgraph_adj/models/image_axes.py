"""Image coordinates with other axes: what a wrong axis makes of coordinates that are right.

All of these mirror the image. Each undoes itself, so that the same function makes the mistake and
puts it right.
"""

from __future__ import annotations

from collections.abc import Callable

from ..types import Array

EXCHANGED = "x and y, exchanged,"
ALONG_X, ALONG_Y = "the direction of x", "the direction of y"
MIRRORED = "the axes, mirrored (x and y exchanged, or one the wrong way),"

Axes = Callable[[Array, Array], Array]
"""Coordinates with other axes, from coordinates (n, 2) and the principal point (2,)."""
OTHER: tuple[tuple[str, Axes], ...] = (
    (EXCHANGED, lambda xy, _: xy[:, ::-1]),
    (EXCHANGED, lambda xy, _: -xy[:, ::-1]),  # with rows that count down
    (ALONG_Y, lambda xy, _: xy * [1.0, -1.0]),
    (ALONG_Y, lambda xy, at: xy * [1.0, -1.0] + at * [0.0, 2.0]),  # counted from the other edge
    (ALONG_X, lambda xy, _: xy * [-1.0, 1.0]),
    (ALONG_X, lambda xy, at: xy * [-1.0, 1.0] + at * [2.0, 0.0]),
)
"""Causes, and what they make of coordinates that are right; each undoes itself."""

"""Coordinates of the points of a field book: the first that are stated count, others are said.

An instrument states coordinates of a point again and again, as results that differ by what it
measures. A place metres away is another point, whose number was given twice.
"""

from __future__ import annotations

import math

from ...errors import Doubt, known
from ..source import Source

Place = tuple[float, float, float]
UNKNOWN_COORDINATES: Place = (math.nan, math.nan, math.nan)
MAX_COORDINATE_DIFFERENCE_M = 1e-4
"""Coordinates of a point that is stated twice differ by less, metres."""
MAX_DISTANCE_OF_ONE_POINT_M = 1.0
"""Distance in plan beyond which coordinates are of another point: results of instruments differ by
centimetres, heights by those of prisms."""


class StatedCoordinates:
    """Names of points with the coordinates that count, NaN where one is unknown."""

    def __init__(self) -> None:
        """Start without points."""
        self.points: dict[str, Place] = {}
        self._lines: dict[str, int] = {}
        self._repeated: dict[str, tuple[float, str]] = {}
        """Largest difference of coordinates that do not count, and its place, by point."""
        self._elsewhere: dict[str, tuple[float, str]] = {}
        """Distance in plan of the same number at another place, and its place in the file."""

    def state(self, source: Source, line: int, name: str, new: Place, *, agree: bool) -> None:
        """Note the coordinates of a point.

        Args:
            source: the file.
            line: its line.
            name: the point.
            new: the coordinates; NaN: unknown.
            agree: whether it is a problem that they differ from those before.
        """
        given = self.points.get(name)
        if given is None:
            self.points[name], self._lines[name] = new, line
            return
        e, n, _ = differences = [abs(a - b) for a, b in zip(given, new, strict=True)]
        difference = max((d for d in differences if d == d), default=0.0)
        if difference > MAX_COORDINATE_DIFFERENCE_M and agree:
            first = self._lines[name]
            what = f"coordinates of point {name!r} differ from those of line {first}"
            source.wrong(line, what)
        elif difference > MAX_COORDINATE_DIFFERENCE_M:
            table, size = self._repeated, difference
            if math.hypot(e, n) > MAX_DISTANCE_OF_ONE_POINT_M:
                table, size = self._elsewhere, math.hypot(e, n)
            if size > table.get(name, (0.0, ""))[0]:
                table[name] = size, source.place(line)
        e, n, u = (b if math.isnan(a) else a for a, b in zip(given, new, strict=True))
        self.points[name] = (e, n, u)
        self._lines[name] = self._lines[name] if given != UNKNOWN_COORDINATES else line

    def remarks(self) -> list[str]:
        """Say which points have other coordinates, too, and by how much."""
        if not self._repeated:
            return []
        n = "1 point" if len(self._repeated) == 1 else f"{len(self._repeated)} points"
        what = f"coordinates of {n} are stated again with other values, of which the first count"
        return [f"{what}; they differ in {_largest(self._repeated)}"]

    def doubts(self) -> list[Doubt]:
        """Doubt points whose coordinates are those of another place."""
        if not self._elsewhere:
            return []
        where = next(iter(self._elsewhere.values()))[1]
        n = "1 point has" if len(self._elsewhere) == 1 else f"{len(self._elsewhere)} points have"
        what = f"{n} coordinates of another place, too: {_largest(self._elsewhere)}; points that "
        return [Doubt(f"{what}have one number are one point here: give each its own", where)]


def _largest(found: dict[str, tuple[float, str]]) -> str:
    """Return points with their differences, the largest first."""
    ordered = sorted(found.items(), key=lambda item: -item[1][0])
    return known([f"{name} by {size:.4f} m ({place})" for name, (size, place) in ordered], most=5)

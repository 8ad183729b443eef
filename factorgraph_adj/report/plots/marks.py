"""Points of a plan: their status, their markers, and the area that they fill."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...solve.solution import Solution
from ...types import Array, Mask
from .in_frames import instrument_of
from .style import BLACK, BLUE, GREEN, VERMILLION, wrapped

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Status:
    """Status of the points of a network, masks (n,); a point may have several."""

    held: Mask
    """Held in all components that are free at some point of the network."""
    part: Mask
    """Held in some of these components."""
    known: Mask
    """Weighted, or observed as control or by GNSS."""
    station: Mask
    """Station of an instrument that was set up over it."""
    check: Mask
    """Check point: with known coordinates for comparison."""
    datum: Mask
    """Datum point of a free network; false everywhere if all points carry the datum."""
    side_shot: Mask
    """Side shot: a point that one sight without a check gives."""

    @property
    def important(self) -> Mask:
        """Points that are labelled first."""
        return np.asarray(self.held | self.part | self.known | self.station | self.check)


def status_of(solution: Solution) -> Status:
    """Return the status of the points of a network."""
    table = solution.equations.unknowns["point"]
    points = list(solution.network.points.values())
    n = len(points)
    asked = table.free.any(axis=0)
    free = table.free[:, asked]
    known, station = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    for block in solution.equations.blocks:
        if block.by_axis:
            known[block.variables[0][1]] = True
        where = instrument_of(block)
        if where is not None and where[0] == "point":
            station[where[1]] = True
    held: Mask = np.asarray(~free.any(axis=1))
    part: Mask = np.asarray(~free.all(axis=1) & ~held)
    datum = np.array([p.datum for p in points], dtype=bool).reshape(n)
    if solution.datum is None or datum.all():
        datum = np.zeros(n, dtype=bool)
    check = np.array([p.check is not None for p in points], dtype=bool).reshape(n)
    side_shot = np.array([p.side_shot for p in points], dtype=bool).reshape(n)
    return Status(held, part, known & ~held, station, check, datum, side_shot)


def draw_points(axes: Axes, at: Array, status: Status) -> list[Artist]:
    """Draw markers of points (n, 2); return the entries of the legend."""
    size = 30.0 if len(at) <= 60 else 18.0 if len(at) <= 300 else 9.0
    plain = ~(status.held | status.part | status.known | status.side_shot)
    dot = size * (0.4 if len(at) <= 300 else 0.15)
    solid = (
        (plain, "o", dot, BLACK, "free point"),
        (status.side_shot, "+", 1.4 * size, BLACK, "side shot"),
        (status.known & ~status.part, "^", size, BLUE, "control or weighted point"),
        (status.part, "v", size, GREEN, "point held in part"),
        (status.held, "^", 1.4 * size, BLACK, "held point"),
    )
    rings = (
        (status.station, "o", 3.2 * size, BLACK, "instrument station"),
        (status.datum, "s", 3.0 * size, BLUE, "datum point"),
        (status.check, "D", 2.6 * size, VERMILLION, "check point"),
    )
    found: list[Artist] = []
    for mask, marker, area, colour, name in solid:
        if mask.any():
            found.append(
                axes.scatter(
                    at[mask, 0],
                    at[mask, 1],
                    s=area,
                    marker=marker,
                    c=colour,
                    lw=0,
                    zorder=4,
                    label=f"{name} ({int(mask.sum())})",
                )
            )
    for mask, marker, area, colour, name in rings:
        if mask.any():
            found.append(
                axes.scatter(
                    at[mask, 0],
                    at[mask, 1],
                    s=area,
                    marker=marker,
                    facecolors="none",
                    edgecolors=colour,
                    lw=0.9,
                    zorder=4,
                    label=f"{name} ({int(mask.sum())})",
                )
            )
    return found


def draw_instruments(axes: Axes, at: Array) -> list[Artist]:
    """Draw instruments (f, 2) that stand over no point; return the entries of the legend."""
    if not len(at):
        return []
    label = wrapped(f"instrument in a frame of its own ({len(at)})")
    look: dict[str, Any] = {"marker": "h", "c": GREEN, "edgecolors": BLACK, "lw": 0.8}
    look |= {"s": 60.0 if len(at) <= 40 else 25.0, "zorder": 4, "gid": "instruments"}
    return [axes.scatter(at[:, 0], at[:, 1], label=label, **look)]


def window(at: Array) -> tuple[Array, Array, int]:
    """Return lower left and upper right corner of the shown area, and the number outside.

    A few positions far away from all others, such as points with nearly parallel rays, would
    shrink the rest of ``at`` (n, 2) to a dot; they stay outside and are counted.
    """
    low, high = at.min(axis=0), at.max(axis=0)
    if len(at) >= 50:
        a, b = np.quantile(at, (0.01, 0.99), axis=0)
        near_low, near_high = a - (b - a), b + (b - a)
        if np.max(high - low) > 4 * np.max(b - a):
            inside = np.all((at >= near_low) & (at <= near_high), axis=1)
            low, high = at[inside].min(axis=0), at[inside].max(axis=0)
    outside = int(np.sum(np.any((at < low) | (at > high), axis=1)))
    half = max(float(np.max(high - low)) / 2, 1e-9)
    margin = 0.06 * 2 * half
    return low - margin, high + margin, outside


def spacing(at: Array, low: Array, high: Array) -> float:
    """Return the mean distance of neighbours, metres, as if the points filled the window evenly."""
    width, height = np.maximum(high - low, 0.1 * np.max(high - low))
    return float(np.sqrt(width * height / max(len(at), 4)))

"""Points and instruments of a plan: status, symbols, window, names without overlap, legend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...solve.solution import Solution
from ...types import Array, Index, Mask
from .drawing_plane import instrument_place
from .style import BLACK, BLUE, GREEN, VERMILLION, wrapped, write_doubts

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

MAX_POINTS_ALL_NAMED = 1000
"""Largest number of points of which all are named; otherwise only important points are."""
MAX_NAMES_TRIED = 300
"""Number of names that are tried; important points are tried in any number."""
MAX_IMPORTANT_POINTS_NAMED = 60
"""Largest number of important points named in a plan of more than `MAX_POINTS_ALL_NAMED` points."""
MIN_LEGEND_LINE_WIDTH = 1.2
"""Smallest width of a line in the legend; lines of large networks are thinner in the plan."""
PHOTO_NAME_COLOUR = "#8f3f6b"
"""Colour of names of photos: that of the photos, but dark enough for letters."""
INSTRUMENT_NAME_COLOUR = "#00664a"
"""Colour of names of instruments: theirs, but dark enough for letters."""


@dataclass(frozen=True)
class PointStatus:
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


def point_status(solution: Solution) -> PointStatus:
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
        where = instrument_place(block)
        if where is not None and where[0] == "point":
            station[where[1]] = True
    held: Mask = np.asarray(~free.any(axis=1))
    part: Mask = np.asarray(~free.all(axis=1) & ~held)
    datum = np.array([p.datum for p in points], dtype=bool).reshape(n)
    if solution.datum is None or datum.all():
        datum = np.zeros(n, dtype=bool)
    check = np.array([p.check is not None for p in points], dtype=bool).reshape(n)
    side_shot = np.array([p.side_shot for p in points], dtype=bool).reshape(n)
    return PointStatus(held, part, known & ~held, station, check, datum, side_shot)


def draw_points(axes: Axes, at: Array, status: PointStatus) -> list[Artist]:
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


def plan_window(at: Array) -> tuple[Array, Array, int]:
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


def mean_spacing(at: Array, low: Array, high: Array) -> float:
    """Return the mean distance of neighbours, metres, as if the points filled the window evenly."""
    width, height = np.maximum(high - low, 0.1 * np.max(high - low))
    return float(np.sqrt(width * height / max(len(at), 4)))


@dataclass(frozen=True, eq=False)
class PlanNames:
    """What a plan names: n points, m photos and f instruments."""

    points: Sequence[str]
    """Names of the points."""
    at: Array
    """Positions of the points, data units, (n, 2)."""
    first: Mask
    """Points that are named first, (n,)."""
    photos: Sequence[str] = ()
    """Names of the photos."""
    centres: Array | None = None
    """Positions of the photos, data units, (m, 2)."""
    instruments: Sequence[str] = ()
    """Names of instruments that stand over no point."""
    instruments_at: Array | None = None
    """Positions of these instruments, data units, (f, 2)."""

    @property
    def everything(self) -> Array:
        """Positions of points, photos and instruments, (n + m + f, 2)."""
        none = np.zeros((0, 2))
        return np.concatenate(
            [self.at, *(none if a is None else a for a in (self.centres, self.instruments_at))]
        )

    def is_large(self, i: int) -> bool:
        """Return whether the marker of i is larger than a dot."""
        if i < len(self.at):
            return bool(self.first[i]) and len(self.at) <= 60
        return i >= len(self.at) + len(self.photos)

    def look(self, i: int) -> tuple[str, str]:
        """Return the colour of the name of i, and what it names."""
        if i < len(self.at):
            return BLACK, "point"
        if i < len(self.at) + len(self.photos):
            return PHOTO_NAME_COLOUR, "photo"
        return INSTRUMENT_NAME_COLOUR, "instrument"

    def order(self) -> Index:
        """Return what is tried: important points, instruments, photos, then other points."""
        first, n = np.flatnonzero(self.first), len(self.at)
        many = n > MAX_POINTS_ALL_NAMED
        if many and len(first) > MAX_IMPORTANT_POINTS_NAMED:
            first = first[:0]
        photos = n + np.arange(len(self.photos))
        photos = photos if len(photos) <= MAX_NAMES_TRIED else photos[:0]
        others = n + len(self.photos) + np.arange(len(self.instruments))
        photos = np.concatenate([others[:MAX_NAMES_TRIED], photos])
        room = 0 if many else max(MAX_NAMES_TRIED - len(first) - len(photos), 0)
        rest = np.flatnonzero(~self.first)[:room]
        return np.concatenate([first, photos, rest])


def legend_with_names(
    figure: Figure,
    axes: Axes,
    legend: Sequence[Artist],
    named: PlanNames | None,
    doubts: Sequence[str],
) -> None:
    """Draw the legend and the names; the legend says how many names found no room.

    Args:
        figure: the figure.
        axes: the axes for the names.
        legend: entries of the legend.
        named: what is to be named; None: nothing, and the legend says nothing of it.
        doubts: why the result is doubtful; they are written first, since they take room.
    """
    from matplotlib.lines import Line2D

    line = Line2D([], [], lw=0, label=_left_out(0))
    drawn = _legend(figure, [*legend, line] if named is not None else legend)
    write_doubts(figure, doubts)
    if named is None:
        return
    # Names are placed beside the final legend, which the number itself does not make wider.
    missing = label_points(figure, axes, named)
    if missing:
        drawn.get_texts()[-1].set_text(_left_out(missing))
    else:
        drawn.remove()
        _legend(figure, legend)


def _left_out(n: int) -> str:
    return f"{n} name{'s' * (n != 1)} left out for want of room"


def _legend(figure: Figure, handles: Sequence[Artist]) -> Legend:
    """Draw a legend beside the axes, with lines that are wide enough to be distinguished."""
    from matplotlib.lines import Line2D

    drawn = figure.legend(handles=handles, loc="outside right upper")
    for line in (h for h in drawn.legend_handles if isinstance(h, Line2D)):
        if 0 < line.get_linewidth() < MIN_LEGEND_LINE_WIDTH and line.get_linestyle() != "None":
            line.set_linewidth(MIN_LEGEND_LINE_WIDTH)
            line.set_alpha(1.0)
    return drawn


def label_points(figure: Figure, axes: Axes, named: PlanNames) -> int:
    """Write names beside points and photos where there is room, without overlap.

    Args:
        figure: the figure; it is laid out first, so that limits and sizes are final.
        axes: the axes for the names.
        named: the names and their places.

    Returns:
        Number of points and photos inside the axes that have no name.
    """
    from matplotlib.patheffects import withStroke

    figure.draw_without_rendering()
    point = figure.dpi / 72.0
    at = named.everything
    names = [*named.points, *named.photos, *named.instruments]
    pixels = axes.transData.transform(at)
    inside = axes.bbox.padded(1.0)
    edges = np.array(inside.extents)
    taken = np.zeros((0, 4))
    height = 9.0 * point
    outline = [withStroke(linewidth=2.0, foreground="white")]
    visible = np.array([inside.contains(x, y) for x, y in pixels], dtype=bool)
    for i in named.order().tolist():
        x, y = pixels[i]
        if not visible[i]:
            continue
        gap = (7.0 if named.is_large(i) else 4.5) * point
        colour, what = named.look(i)
        name = names[i] if len(names[i]) <= 16 else names[i][:15] + "…"
        width = 5.2 * point * len(name)
        for dx, dy in ((1, 0.0), (-1, 0.0), (1, 0.8), (-1, 0.8), (1, -0.8), (-1, -0.8)):
            left = x + gap if dx > 0 else x - gap - width
            box = np.array([left, y + dy * height - height / 2, left + width, 0.0])
            box[3] = box[1] + height
            if _overlaps(box, taken) or _covers(box, pixels) or not _within(box, edges):
                continue
            taken = np.concatenate([taken, box[None]])
            axes.annotate(
                name,
                at[i],
                (dx * gap / point, dy * height / point),
                textcoords="offset points",
                ha="left" if dx > 0 else "right",
                va="center",
                fontsize=7.5,
                color=colour,
                path_effects=outline,
                zorder=5,
                gid=f"name of a{'n' * (what[0] in 'aeiou')} {what}",
                in_layout=False,
            )
            break
    return int(visible.sum()) - len(taken)


def _overlaps(box: Array, taken: Array) -> bool:
    return bool(
        np.any(
            (box[0] < taken[:, 2])
            & (box[2] > taken[:, 0])
            & (box[1] < taken[:, 3])
            & (box[3] > taken[:, 1])
        )
    )


def _covers(box: Array, pixels: Array) -> bool:
    x, y = pixels.T
    return bool(np.any((x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3])))


def _within(box: Array, extents: Array) -> bool:
    return bool(
        box[0] >= extents[0]
        and box[1] >= extents[1]
        and box[2] <= extents[2]
        and box[3] <= extents[3]
    )

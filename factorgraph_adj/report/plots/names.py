"""Names of points and photos in a plan, where there is room, and a legend that counts the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...types import Array, Index, Mask
from .style import BLACK, write_doubts

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

LABELLED = 1000
"""Largest number of points of which all are named; otherwise only important points are."""
MOST_NAMES = 300
"""Number of names that are tried; important points are tried in any number."""
IMPORTANT = 60
"""Largest number of important points that are named in a plan of more than `LABELLED` points."""
THIN = 1.2
"""Smallest width of a line in the legend; lines of large networks are thinner in the plan."""


PHOTO = "#8f3f6b"
"""Colour of names of photos: that of the photos, but dark enough for letters."""
DARK_GREEN = "#00664a"
"""Colour of names of instruments: theirs, but dark enough for letters."""


@dataclass(frozen=True, eq=False)
class Named:
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
            return PHOTO, "photo"
        return DARK_GREEN, "instrument"

    def order(self) -> Index:
        """Return what is tried: important points, instruments, photos, then other points."""
        first, n = np.flatnonzero(self.first), len(self.at)
        many = n > LABELLED
        if many and len(first) > IMPORTANT:
            first = first[:0]
        photos = n + np.arange(len(self.photos))
        photos = photos if len(photos) <= MOST_NAMES else photos[:0]
        others = n + len(self.photos) + np.arange(len(self.instruments))
        photos = np.concatenate([others[:MOST_NAMES], photos])
        room = 0 if many else max(MOST_NAMES - len(first) - len(photos), 0)
        rest = np.flatnonzero(~self.first)[:room]
        return np.concatenate([first, photos, rest])


def legend_with_names(
    figure: Figure,
    axes: Axes,
    legend: Sequence[Artist],
    named: Named | None,
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
    """Draw a legend beside the axes, with lines that are wide enough to be told apart."""
    from matplotlib.lines import Line2D

    drawn = figure.legend(handles=handles, loc="outside right upper")
    for line in (h for h in drawn.legend_handles if isinstance(h, Line2D)):
        if 0 < line.get_linewidth() < THIN and line.get_linestyle() != "None":
            line.set_linewidth(THIN)
            line.set_alpha(1.0)
    return drawn


def label_points(figure: Figure, axes: Axes, named: Named) -> int:
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

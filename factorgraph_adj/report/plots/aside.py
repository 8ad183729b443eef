"""Observations that were set aside, or are suspect, at their places in plans and photos."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...graph.blocks import Block
from ...graph.equations import Equations
from ...models.variables import VariableKind
from ...quality.reliability import Reliability
from ...solve.solution import Solution
from ...types import Array, Index
from ..set_aside import SetAside
from .sights import ends_of
from .style import BLACK, ORANGE

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

MANY = 60
"""Number of lines from which they are drawn thin."""
CROSS: dict[str, Any] = {"marker": "x", "color": BLACK, "ls": ""}
"""Look of what was set aside, in plans and in photos."""


# -- plans ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Places:
    """Where observations are in a drawing."""

    lines: Array
    """Both ends of the lines of sight, (m, 2, 2) data units."""
    points: Array
    """Places of observations at one point or photo only, (k, 2) data units."""
    lost: int
    """Number of observations without a place: of a calibration, or of a point that is gone."""


def places_of(
    equations: Equations, rows: Index, solution: Solution, drawn: Mapping[VariableKind, Array]
) -> Places:
    """Return the places of observations.

    Args:
        equations: equations with the observations; they may have more than the solution.
        rows: scalar rows of the observations.
        solution: the solution that is drawn.
        drawn: positions in the drawing of its points, photos and frames with an instrument, by
            kind, (n, 2) data units.
    """
    lines, points = [np.zeros((0, 2, 2))], [np.zeros((0, 2))]
    placed: set[int] = set()
    for block, which in _parts(equations, rows):
        ends = [
            _positions(equations, solution, drawn[kind], kind, numbers[which])
            for kind, numbers in ends_of(block)
            if kind in drawn
        ]
        numbers = equations.observation_of_row[block.first_row + block.dimension * which]
        if len(ends) == 1:
            found = np.isfinite(ends[0]).all(axis=1)
            points.append(ends[0][found])
            placed.update(numbers[found].tolist())
        for end in ends[1:]:
            sights = np.stack([ends[0], end], 1)
            found = np.isfinite(sights).all(axis=(1, 2))
            lines.append(sights[found])
            placed.update(numbers[found].tolist())
    lost = len(np.setdiff1d(equations.observation_of_row[rows], list(placed)))
    return Places(np.concatenate(lines), np.concatenate(points), lost)


def _parts(equations: Equations, rows: Index) -> Iterator[tuple[Block, Index]]:
    """Iterate over the blocks with any of the rows, and the numbers of their observations."""
    for block in equations.blocks:
        own = rows[(rows >= block.rows.start) & (rows < block.rows.stop)]
        if len(own):
            yield block, np.unique((own - block.first_row) // block.dimension)


def _positions(
    equations: Equations, solution: Solution, at: Array, kind: VariableKind, numbers: Index
) -> Array:
    """Return positions (n, 2) of variables of equations; NaN if the solution has none."""
    number, names = solution.equations.unknowns[kind].number, equations.unknowns[kind].names
    own = np.array([number.get(names[i], -1) for i in numbers.tolist()], dtype=np.intp)
    return np.asarray(np.append(at, [[np.nan, np.nan]], axis=0)[own])


def draw_places(
    axes: Axes,
    solution: Solution,
    drawn: Mapping[VariableKind, Array],
    aside: SetAside | None,
    reliability: Reliability | None,
) -> list[Artist]:
    """Draw what was set aside, and suspects; return the entries of the legend.

    Args:
        axes: the axes.
        solution: the solution that is drawn.
        drawn: positions of its points, photos and frames with an instrument, by kind, (n, 2) data
            units.
        aside: what was set aside.
        reliability: its test values tell the suspects.
    """
    out: list[Artist] = []
    if reliability is not None:
        with np.errstate(invalid="ignore"):
            rows = np.flatnonzero(np.abs(reliability.w) > reliability.critical_w)
        n = len(np.unique(solution.equations.observation_of_row[rows]))
        places = places_of(solution.equations, rows, solution, drawn)
        look = {"color": ORANGE, "ls": "-", "marker": "", "alpha": 0.45}
        out += _draw(axes, places, look, f"|w| > {reliability.critical_w:.2f}", n, 4.0)
    if aside is not None:
        places = places_of(aside.rows.equations, aside.numbers, solution, drawn)
        out += _draw(axes, places, CROSS | {"ls": ":"}, "set aside", aside.count, 1.5)
    return out


def _draw(
    axes: Axes, places: Places, look: dict[str, Any], label: str, count: int, width: float
) -> list[Artist]:
    """Draw lines with a marker in their middle, and places with the marker alone.

    Suspects are broad lines below all others; what was set aside lies above them.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    if not count:
        return []
    colour, dashes, marker, alpha = (look.get(k) for k in ("color", "ls", "marker", "alpha"))
    width = width if len(places.lines) <= MANY else 0.6 * width
    level = 0.5 if alpha else 2.0
    lines = LineCollection(list(places.lines), linestyles=dashes, linewidths=width, gid=label)
    lines.set(color=colour, alpha=alpha, zorder=level)
    axes.add_collection(lines)
    at = np.concatenate([places.lines.mean(axis=1), places.points]) if marker else places.points
    size = 5.0 if len(at) <= MANY else 3.0
    dot: dict[str, Any] = {
        "marker": marker or "o",
        "ls": "",
        "color": colour,
        "alpha": alpha,
        "gid": label,
    }
    size = size if marker else 3 * size
    axes.plot(*at.T, **dot, ms=size, mew=1.2 if marker else 0.0, zorder=level + 2.5)
    text = f"{label} ({count})"
    if places.lost:
        text += f",\n  {places.lost} of them without a place here"
    entry: dict[str, Any] = {
        "color": colour,
        "ls": dashes,
        "marker": marker,
        "alpha": alpha,
        "label": text,
    }
    return [Line2D([], [], lw=width, ms=5.0, **entry)]


# -- photos ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ImagesAside:
    """Image points of one photo that were set aside, k of them."""

    points: tuple[str, ...]
    """Names of the points."""
    xy: Array
    """Measured coordinates (k, 2), image units."""
    innovation: Array
    """Computed − observed (k, 2), image units; NaN where no prediction is possible."""


def images_aside(aside: SetAside | None) -> dict[str, ImagesAside]:
    """Return the image points that were set aside, by photo."""
    out: dict[str, ImagesAside] = {}
    if aside is None:
        return out
    equations = aside.rows.equations
    photos, points = (equations.unknowns[kind].names for kind in ("pose", "point"))
    innovation = np.full(equations.n_rows, np.nan)
    innovation[aside.numbers] = aside.innovation
    for block, which in _parts(equations, aside.numbers):
        if block.kind != "image":
            continue
        photo, point = (block.variables[k][1][which] for k in (0, 2))
        v = innovation[block.rows].reshape(-1, 2)[which]
        for i in np.unique(photo).tolist():
            own = photo == i
            names = tuple(points[p] for p in point[own].tolist())
            before = out.get(photos[i], ImagesAside((), np.zeros((0, 2)), np.zeros((0, 2))))
            out[photos[i]] = ImagesAside(
                before.points + names,
                np.concatenate([before.xy, block.observed[which][own]]),
                np.concatenate([before.innovation, v[own]]),
            )
    return out


def draw_images_aside(axes: Axes, own: ImagesAside, factor: float, *, fine: bool) -> None:
    """Draw a cross at each image point that was set aside, and its vector by a dotted line.

    Gross errors are large: lines that leave the photo are cut off at its edge.
    """
    from matplotlib.collections import LineCollection

    axes.plot(*own.xy.T, **CROSS, ms=4.0 if fine else 6.0, mew=1.0, zorder=4, gid="set aside")
    ends = np.stack([own.xy, own.xy + factor * own.innovation], 1)
    axes.add_collection(
        LineCollection(
            list(ends[np.isfinite(ends).all(axis=(1, 2))]),
            colors=BLACK,
            linestyles=":",
            linewidths=0.8 if fine else 1.2,
            zorder=2.5,
            gid="set aside",
        ),
        autolim=False,
    )

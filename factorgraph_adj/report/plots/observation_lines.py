"""Drawing of observed lines, photos, suspects and rejected in plans; rejected ones on photos."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...graph.blocks import Block
from ...graph.equations import Equations
from ...models.unknown_registry import VariableKind
from ...quality.reliability import Reliability
from ...solve.solution import Solution
from ...types import Array, Index
from ..observation_rows import kind_name
from ..rejected_observations import RejectedObservations
from .drawing_plane import instrument_place
from .image_residuals import ImageRows
from .style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, wrapped

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

NO_INSTRUMENTS: Index = np.zeros(0, dtype=np.intp)
LINE_LOOKS = (
    (BLUE, "-"),
    (GREEN, "--"),
    (ORANGE, "-."),
    (SKY, "-"),
    (GREY, "--"),
    (ORANGE, ":"),
)
"""Colours and line styles of the most frequent sets of kinds."""
MAX_LINES_DRAWN_BROAD = 60
"""Number of lines from which they are drawn thin."""
REJECTED_LOOK: dict[str, Any] = {"marker": "x", "color": BLACK, "ls": ""}
"""Look of what was rejected, in plans and in photos."""


def observation_ends(block: Block) -> list[tuple[VariableKind, Index]]:
    """Return points, photos and instruments of observations: kind and numbers of each.

    The first is where they were made. A frame is one of them where an instrument stands in it.
    """
    found = [(k, i) for k, i in block.variables if k in ("point", "pose")]
    where = instrument_place(block)
    return [where, *found] if where is not None and where[0] == "frame" else found


def lines_by_kinds(
    solution: Solution, instruments: Index = NO_INSTRUMENTS
) -> list[tuple[tuple[str, ...], Index]]:
    """Return the lines between points by the kinds that are observed on them.

    A line with directions, zenith angles and distances is drawn once, in the style of this set of
    kinds.

    Args:
        solution: the solution.
        instruments: numbers of frames whose instruments stand over no point, (f,); they are
            counted behind the points. Lines of other frames have no first end.

    Returns:
        Sets of kinds, each with the end points (n, 2) of its lines; the most frequent set is first.
    """
    n_points = len(solution.equations.unknowns["point"].names)
    n = n_points + len(instruments)
    place = np.full(len(solution.state["frame"]), -1, dtype=np.intp)
    place[instruments] = n_points + np.arange(len(instruments))
    kinds: list[str] = []
    codes: list[Index] = []
    for block in solution.equations.blocks:
        every = [(k, i) for k, i in observation_ends(block) if k != "pose"]
        ends = [place[i] if k == "frame" else i for k, i in every]
        if len(ends) < 2:
            continue
        for end in ends[1:]:
            known = (ends[0] >= 0) & (end >= 0)
            a, b = ends[0][known], end[known]
            if len(a):
                kinds.append(block.kind)
                codes.append(np.unique(np.minimum(a, b) * n + np.maximum(a, b)))
    if not codes:
        return []
    names = list(dict.fromkeys(kinds))
    lines = np.unique(np.concatenate(codes))
    mask = np.zeros(len(lines), dtype=np.int64)
    for kind, code in zip(kinds, codes, strict=True):
        mask[np.searchsorted(lines, code)] |= 1 << names.index(kind)
    out = []
    for value in np.unique(mask).tolist():
        chosen = lines[mask == value]
        which = tuple(name for i, name in enumerate(names) if value >> i & 1)
        out.append((which, np.stack([chosen // n, chosen % n], 1).astype(np.intp)))
    return sorted(out, key=lambda found: -len(found[1]))


def draw_observation_lines(
    axes: Axes, at: Array, solution: Solution, instruments: Index = NO_INSTRUMENTS
) -> list[Artist]:
    """Draw the lines between points and instruments; return the entries of the legend.

    Args:
        axes: the axes.
        at: places of the points and, behind them, of the instruments, (n + f, 2).
        solution: the solution.
        instruments: numbers of their frames, (f,).
    """
    from matplotlib.collections import LineCollection

    groups = lines_by_kinds(solution, instruments)
    total = sum(len(ends) for _, ends in groups)
    width = 0.8 if total <= 100 else 0.5 if total <= 3000 else 0.25
    shown = [(", ".join(map(kind_name, kinds)), ends) for kinds, ends in groups[: len(LINE_LOOKS)]]
    if len(groups) > len(LINE_LOOKS):
        rest = groups[len(LINE_LOOKS) - 1 :]
        label = f"{len(rest)} other sets of kinds"
        shown[-1] = (label, np.concatenate([ends for _, ends in rest]))
    found: list[Artist] = []
    for (label, ends), (colour, dashes) in zip(shown, LINE_LOOKS, strict=False):
        lines = LineCollection(
            list(at[ends]),
            colors=colour,
            linestyles=dashes,
            linewidths=width,
            alpha=0.85 if total <= 100 else 0.5,
            zorder=1,
            label=wrapped(f"{label} ({len(ends)})"),
        )
        axes.add_collection(lines)
        found.append(lines)
    return found


def photo_outlines(solution: Solution, images: ImageRows, size: float) -> Array:
    """Return the outline of each photo's field of view as one line (n, 11, 3), metres.

    The outline follows the rays, up to ``size`` metres long, to the corners of the sensor, or of
    the measured part of the image where the camera states no format. From above, a vertical photo
    is a rectangle with its diagonals and a horizontal photo is a fan.
    """
    network, state = solution.network, solution.state
    out = np.empty((len(network.photos), 11, 3))
    for i, photo in enumerate(network.photos.values()):
        stored = state["pose"][i]
        rays = images.corner_rays(photo.camera)
        depth = size / np.sqrt(np.max(np.sum(rays**2, axis=1)))
        a, b, c, d = stored[9:] + depth * rays @ stored[:9].reshape(3, 3).T
        o = stored[9:]
        out[i] = (o, a, b, c, d, a, b, o, c, o, d)
    return out


def draw_photos(axes: Axes, centres: Array, shapes: Array) -> list[Artist]:
    """Draw photos: centres (n, 2) and outlines (n, m, 2); return the entries of the legend."""
    from matplotlib.collections import LineCollection

    fine = 0.8 if len(centres) <= 40 else 0.4
    axes.add_collection(
        LineCollection(list(shapes), colors=PURPLE, linewidths=fine, zorder=2.5, gid="photos")
    )
    return [
        axes.scatter(
            centres[:, 0],
            centres[:, 1],
            s=14.0 if len(centres) <= 40 else 6.0,
            marker="s",
            c=PURPLE,
            lw=0,
            zorder=3,
            label=f"photo and what it looks at ({len(centres)})",
        )
    ]


# -- plans ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ObservationPlaces:
    """Where observations are in a drawing."""

    lines: Array
    """Both ends of the lines of sight, (m, 2, 2) data units."""
    points: Array
    """Places of observations at one point or photo only, (k, 2) data units."""
    lost: int
    """Number of observations without a place: of a calibration, or of a point that is gone."""


def observation_places(
    equations: Equations, rows: Index, solution: Solution, drawn: Mapping[VariableKind, Array]
) -> ObservationPlaces:
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
            for kind, numbers in observation_ends(block)
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
    return ObservationPlaces(np.concatenate(lines), np.concatenate(points), lost)


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


def draw_rejected_and_suspects(
    axes: Axes,
    solution: Solution,
    drawn: Mapping[VariableKind, Array],
    aside: RejectedObservations | None,
    reliability: Reliability | None,
) -> list[Artist]:
    """Draw what was rejected, and suspects; return the entries of the legend.

    Args:
        axes: the axes.
        solution: the solution that is drawn.
        drawn: positions of its points, photos and frames with an instrument, by kind, (n, 2) data
            units.
        aside: what was rejected.
        reliability: its test values tell the suspects.
    """
    out: list[Artist] = []
    if reliability is not None:
        with np.errstate(invalid="ignore"):
            rows = np.flatnonzero(np.abs(reliability.w) > reliability.critical_w)
        n = len(np.unique(solution.equations.observation_of_row[rows]))
        places = observation_places(solution.equations, rows, solution, drawn)
        look = {"color": ORANGE, "ls": "-", "marker": "", "alpha": 0.45}
        out += _draw(axes, places, look, f"|w| > {reliability.critical_w:.2f}", n, 4.0)
    if aside is not None:
        places = observation_places(aside.rows.equations, aside.numbers, solution, drawn)
        out += _draw(axes, places, REJECTED_LOOK | {"ls": ":"}, "rejected", aside.count, 1.5)
    return out


def _draw(
    axes: Axes,
    places: ObservationPlaces,
    look: dict[str, Any],
    label: str,
    count: int,
    width: float,
) -> list[Artist]:
    """Draw lines with a marker in their middle, and places with the marker alone.

    Suspects are broad lines below all others; what was rejected lies above them.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    if not count:
        return []
    colour, dashes, marker, alpha = (look.get(k) for k in ("color", "ls", "marker", "alpha"))
    width = width if len(places.lines) <= MAX_LINES_DRAWN_BROAD else 0.6 * width
    level = 0.5 if alpha else 2.0
    lines = LineCollection(list(places.lines), linestyles=dashes, linewidths=width, gid=label)
    lines.set(color=colour, alpha=alpha, zorder=level)
    axes.add_collection(lines)
    at = np.concatenate([places.lines.mean(axis=1), places.points]) if marker else places.points
    size = 5.0 if len(at) <= MAX_LINES_DRAWN_BROAD else 3.0
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
class RejectedImagePoints:
    """Image points of one photo that were rejected, k of them."""

    points: tuple[str, ...]
    """Names of the points."""
    xy: Array
    """Measured coordinates (k, 2), image units."""
    innovation: Array
    """Computed − observed (k, 2), image units; NaN where no prediction is possible."""


def rejected_image_points(aside: RejectedObservations | None) -> dict[str, RejectedImagePoints]:
    """Return the image points that were rejected, by photo."""
    out: dict[str, RejectedImagePoints] = {}
    if aside is None:
        return out
    equations = aside.rows.equations
    photos, points = (equations.unknowns[kind].names for kind in ("pose", "point"))
    innovation = np.full(equations.n_rows, np.nan)
    innovation[aside.numbers] = aside.innovation
    for block, which in _parts(equations, aside.numbers):
        if not block.image:
            continue
        photo, point = (block.variables[k][1][which] for k in (0, 2))
        v = innovation[block.rows].reshape(-1, 2)[which]
        for i in np.unique(photo).tolist():
            own = photo == i
            names = tuple(points[p] for p in point[own].tolist())
            before = out.get(photos[i], RejectedImagePoints((), np.zeros((0, 2)), np.zeros((0, 2))))
            out[photos[i]] = RejectedImagePoints(
                before.points + names,
                np.concatenate([before.xy, block.observed[which][own]]),
                np.concatenate([before.innovation, v[own]]),
            )
    return out


def draw_rejected_image_points(
    axes: Axes, own: RejectedImagePoints, factor: float, *, fine: bool
) -> None:
    """Draw a cross at each image point that was rejected, and its vector by a dotted line.

    Gross errors are large: lines that leave the photo are cut off at its edge.
    """
    from matplotlib.collections import LineCollection

    axes.plot(
        *own.xy.T, **REJECTED_LOOK, ms=4.0 if fine else 6.0, mew=1.0, zorder=4, gid="rejected"
    )
    ends = np.stack([own.xy, own.xy + factor * own.innovation], 1)
    axes.add_collection(
        LineCollection(
            list(ends[np.isfinite(ends).all(axis=(1, 2))]),
            colors=BLACK,
            linestyles=":",
            linewidths=0.8 if fine else 1.2,
            zorder=2.5,
            gid="rejected",
        ),
        autolim=False,
    )

"""Lines of terrestrial observations in a plan, and photos with their fields of view."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...graph.blocks import Block
from ...models.variables import VariableKind
from ...solve.solution import Solution
from ...types import Array, Index
from ..rows import kind_name
from .image_rows import ImageRows
from .in_frames import instrument_of
from .style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, wrapped

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

NO_INSTRUMENTS: Index = np.zeros(0, dtype=np.intp)
LOOKS = (
    (BLUE, "-"),
    (GREEN, "--"),
    (ORANGE, "-."),
    (SKY, "-"),
    (GREY, "--"),
    (ORANGE, ":"),
)
"""Colours and line styles of the most frequent sets of kinds."""


def ends_of(block: Block) -> list[tuple[VariableKind, Index]]:
    """Return points, photos and instruments of observations: kind and numbers of each.

    The first is where they were made. A frame is one of them where an instrument stands in it.
    """
    found = [(k, i) for k, i in block.variables if k in ("point", "pose")]
    where = instrument_of(block)
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
        every = [(k, i) for k, i in ends_of(block) if k != "pose"]
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


def draw_lines(
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
    shown = [(", ".join(map(kind_name, kinds)), ends) for kinds, ends in groups[: len(LOOKS)]]
    if len(groups) > len(LOOKS):
        rest = groups[len(LOOKS) - 1 :]
        label = f"{len(rest)} other sets of kinds"
        shown[-1] = (label, np.concatenate([ends for _, ends in rest]))
    found: list[Artist] = []
    for (label, ends), (colour, dashes) in zip(shown, LOOKS, strict=False):
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


def photo_shapes(solution: Solution, images: ImageRows, size: float) -> Array:
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

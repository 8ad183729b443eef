"""Lines of terrestrial observations in a plan, and photos with their fields of view."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...solve.solution import Solution
from ...types import Array, Index
from ..rows import kind_name
from .image_rows import ImageRows
from .style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, wrapped

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

LOOKS = (
    (BLUE, "-"),
    (GREEN, "--"),
    (ORANGE, "-."),
    (SKY, "-"),
    (GREY, "--"),
    (ORANGE, ":"),
)
"""Colours and line styles of the most frequent sets of kinds."""


def lines_by_kinds(solution: Solution) -> list[tuple[tuple[str, ...], Index]]:
    """Return the lines between points by the kinds that are observed on them.

    A line with directions, zenith angles and distances is drawn once, in the style of this set of
    kinds.

    Returns:
        Sets of kinds, each with the end points (n, 2) of its lines; the most frequent set is first.
    """
    n = len(solution.equations.unknowns["point"].names)
    kinds: list[str] = []
    codes: list[Index] = []
    for block in solution.equations.blocks:
        ends = [index for what, index in block.variables if what == "point"]
        if block.kind == "image" or len(ends) < 2:
            continue
        for end in ends[1:]:
            kinds.append(block.kind)
            codes.append(np.unique(np.minimum(ends[0], end) * n + np.maximum(ends[0], end)))
    if not codes:
        return []
    names = list(dict.fromkeys(kinds))
    every = np.unique(np.concatenate(codes))
    mask = np.zeros(len(every), dtype=np.int64)
    for kind, code in zip(kinds, codes, strict=True):
        mask[np.searchsorted(every, code)] |= 1 << names.index(kind)
    out = []
    for value in np.unique(mask).tolist():
        chosen = every[mask == value]
        which = tuple(name for i, name in enumerate(names) if value >> i & 1)
        out.append((which, np.stack([chosen // n, chosen % n], 1).astype(np.intp)))
    return sorted(out, key=lambda found: -len(found[1]))


def draw_lines(axes: Axes, at: Array, solution: Solution) -> list[Artist]:
    """Draw the lines between points (n, 2); return the entries of the legend."""
    from matplotlib.collections import LineCollection

    groups = lines_by_kinds(solution)
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
        low, high = images.tangents(photo.camera)
        corners = np.array(
            [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]
        )
        depth = size / np.sqrt(1.0 + np.max(np.sum(corners**2, axis=1)))
        # y of image coordinates points up, y of the camera's axes points down.
        rays = np.column_stack([corners[:, 0], -corners[:, 1], np.ones(4)])
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

"""Error ellipses and intervals of heights, exaggerated in a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...quality.ellipses import factor_of, factors_of
from ...solve.solution import Solution
from ...types import Array, Mask
from .marks import spacing
from .plan import DrawingPlane, covariances, ellipses
from .style import (
    PURPLE,
    VERMILLION,
    exaggeration,
    has_computed_readings,
    length,
    readable,
    scale_key,
    wrapped,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

LARGEST = 0.35
"""Largest semi-major axis that is drawn, as a fraction of the extent of the plan."""
COVERED = 0.25
"""Largest fraction of the plan that the ellipses of projection centres may cover together."""
_SIGMA0 = {"a-priori": "σ0 a priori", "a-posteriori": "σ̂0 a posteriori"}


@dataclass(frozen=True, eq=False)
class Precision:
    """Confidence regions of points in true size, metres."""

    solution: Solution
    """Solution of the regions."""
    semi: Array
    """Semi-axes of ellipses of points, largest first, (n, 2)."""
    direction: Array
    """Direction of the first semi-axis from east to north, radians, (n,)."""
    centre_semi: Array
    """Semi-axes of ellipses of projection centres, largest first, (m, 2)."""
    centre_direction: Array
    """Direction of their first semi-axis from east to north, radians, (m,)."""
    height: Array
    """Half intervals of heights, (n,); zero if they are not drawn."""
    title: str
    """Line with the confidence and the scale of the covariances."""
    factor: float | None
    """Exaggeration chosen by the caller; None for an automatic one."""
    doubtful: bool
    """Whether the result is doubtful: its regions are drawn by dashes, and the legend says so."""

    @property
    def look(self) -> tuple[str, str]:
        """Line style of the regions, and what the legend adds to their names."""
        return ("--", ", of a doubtful result") if self.doubtful else ("-", "")

    @property
    def sizes(self) -> Array:
        """Largest extent of each point's region, (n,)."""
        return np.maximum(self.semi[:, 0], self.height)


def precision_of(
    solution: Solution,
    plan: DrawingPlane,
    confidence: float,
    factor: float | None,
    heights: bool,
    doubtful: bool,
) -> Precision | None:
    """Return the confidence regions in a plan; None without covariances."""
    found = covariances(solution)
    if found is None:
        return None
    points, centres = (plan.covariance(each) for each in found)
    k1 = factor_of(solution, 1, confidence)
    semi, direction = ellipses(points[:, :2, :2])
    centre_semi, centre_direction = ellipses(centres[:, :2, :2])
    up = np.sqrt(np.maximum(points[:, 2, 2], 0.0))
    return Precision(
        solution,
        factors_of(solution, semi**2, confidence)[:, None] * semi,
        direction,
        factors_of(solution, centre_semi**2, confidence)[:, None] * centre_semi,
        centre_direction,
        k1 * up if heights else np.zeros(len(up)),
        f"confidence {100 * confidence:g} %, {_SIGMA0[solution.variance]}"
        + (", free network" if solution.datum is not None else "")
        + (", computed readings" if has_computed_readings(solution) else ""),
        factor,
        doubtful,
    )


@dataclass(frozen=True)
class Shown:
    """Texts and legend of the drawn regions."""

    title: str
    """Line below the title."""
    legend: list[Artist]
    """Entries of the legend."""
    notes: list[str]
    """Notes below the figure."""


def draw_precision(
    axes: Axes, precision: Precision, at: Array, centres: Array, limits: tuple[Array, Array]
) -> Shown:
    """Draw ellipses and intervals at points (n, 2) and projection centres (m, 2), with a key."""
    from matplotlib.collections import LineCollection

    sizes = precision.sizes
    positive = np.concatenate([sizes, precision.centre_semi[:, 0]])
    positive = sizes[sizes > 0] if np.any(sizes > 0) else positive[positive > 0]
    if not len(positive):
        return Shown("every point is held: there are no error ellipses", [], [])
    extent = float(np.max(limits[1] - limits[0]))
    typical = float(np.median(positive))
    factor = precision.factor
    if factor is None:
        room = min(0.45 * spacing(at, *limits), 0.05 * extent)
        factor = readable(room / typical)
    fits = sizes * factor <= LARGEST * extent
    found: list[Artist] = []
    line = 1.0 if len(at) <= 300 else 0.5
    dashes, more = precision.look
    oval = fits & (precision.semi[:, 0] > 0)
    if oval.any():
        which = (precision.semi, precision.direction, oval, factor, VERMILLION, line, dashes)
        found.append(_ellipses(axes, at, *which, f"error ellipse of a point{more}"))
    tall = fits & (precision.height > 0)
    if tall.any():
        ends = np.repeat(at[tall, None], 2, axis=1)
        ends[:, :, 1] += factor * precision.height[tall, None] * [-1.0, 1.0]
        bars = LineCollection(
            list(ends),
            colors=VERMILLION,
            linewidths=1.5 * line,
            linestyles=dashes,
            zorder=3.5,
            label=f"interval of a height (±){more}",
        )
        axes.add_collection(bars)
        found.append(bars)
    ovals = (precision.centre_semi[:, 0] > 0) & (
        precision.centre_semi[:, 0] * factor <= LARGEST * extent
    )
    notes = _too_large(precision, ~fits)
    area = np.pi * factor**2 * np.sum(np.prod(precision.centre_semi[ovals], axis=1))
    if area > COVERED * float(np.prod(limits[1] - limits[0])):
        notes.append("error ellipses of projection centres are left out: they would cover the rest")
        ovals[:] = False
    if ovals.any():
        whose = (precision.centre_semi, precision.centre_direction, ovals, factor, PURPLE)
        label = f"error ellipse of a projection centre{more}"
        found.append(_ellipses(axes, centres, *whose, 0.8 * line, dashes, label))
    _enlarge(axes, at[fits], factor * precision.sizes[fits])
    _enlarge(axes, centres[ovals], factor * precision.centre_semi[ovals, 0])
    key = readable(typical)
    while key * factor < 0.04 * extent:
        key = readable(2.6 * key)
    scale_key(axes, key * factor, f"{length(key)}, {exaggeration(factor)}")
    return Shown(precision.title, found, notes)


def _ellipses(
    axes: Axes,
    at: Array,
    semi: Array,
    direction: Array,
    shown: Mask,
    factor: float,
    colour: str,
    line: float,
    dashes: str,
    label: str,
) -> Artist:
    """Draw ellipses; return their entry of the legend."""
    from matplotlib.collections import EllipseCollection
    from matplotlib.lines import Line2D

    axes.add_collection(
        EllipseCollection(
            2 * factor * semi[shown, 0],
            2 * factor * semi[shown, 1],
            np.degrees(direction[shown]),
            units="xy",
            offsets=at[shown],
            offset_transform=axes.transData,
            facecolors="none",
            edgecolors=colour,
            linewidths=line,
            linestyles=dashes,
            zorder=3.5,
            label=label,
        )
    )
    if dashes != "-":
        return Line2D([], [], color=colour, ls=dashes, lw=1.2, label=wrapped(label))
    return Line2D([], [], ls="", marker="o", ms=8.0, mfc="none", mec=colour, label=wrapped(label))


def _enlarge(axes: Axes, at: Array, radius: Array) -> None:
    """Enlarge the axes so that they contain the whole regions around the positions inside."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    x, y = at.T
    inside = (x >= left) & (x <= right) & (y >= bottom) & (y <= top)
    if inside.any():
        x, y, radius = x[inside], y[inside], 1.05 * radius[inside]
        axes.set_xlim(min(left, float(np.min(x - radius))), max(right, float(np.max(x + radius))))
        axes.set_ylim(min(bottom, float(np.min(y - radius))), max(top, float(np.max(y + radius))))


def _too_large(precision: Precision, left_out: Mask) -> list[str]:
    """Name the points whose ellipses would cover the plan."""
    if not left_out.any():
        return []
    names = precision.solution.equations.unknowns["point"].names
    order = np.argsort(-precision.sizes, kind="stable")[: int(left_out.sum())]
    listed = ", ".join(f"{names[i]} ({length(float(precision.sizes[i]))})" for i in order[:5])
    more = f" and {len(order) - 5} more" if len(order) > 5 else ""
    return [f"too large to be drawn: {listed}{more}"]

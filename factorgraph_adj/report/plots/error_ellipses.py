"""Confidence regions in a plan: error ellipses and height intervals, exaggerated and drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...quality.error_ellipses import (
    FIXED_AXIS_VARIANCE_RATIO,
    region_factors,
    solution_confidence_factor,
)
from ...solve.solution import Solution
from ...types import Array, Mask
from .drawing_plane import DrawingPlane, place_covariances, plane_ellipses
from .point_symbols import mean_spacing
from .style import (
    PURPLE,
    VERMILLION,
    draw_scale_key,
    exaggeration_text,
    has_computed_readings,
    length_text,
    readable_number,
    wrapped,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

MAX_ELLIPSE_SIZE = 0.35
"""Largest semi-major axis that is drawn, as a fraction of the extent of the plan."""
MAX_AREA_COVERED = 0.25
"""Largest fraction of the plan that the ellipses of projection centres may cover together."""
_SIGMA0 = {"a-priori": "σ0 a priori", "a-posteriori": "σ̂0 a posteriori"}


ROOM_AROUND_POINTS = 0.15
"""Room beside the points that counts as theirs, as a fraction of the extent of the plan."""


@dataclass(frozen=True, eq=False)
class OtherPlaces:
    """Places that are neither points nor photos, k of them: instruments, places of shapes."""

    at: Array
    """Places in the drawing, (k, 2) metres."""
    sigma: Array
    """Covariances in the axes of the drawing, (k, 3, 3) metres²."""
    colour: str
    """Colour of their ellipses."""
    label: str
    """What each of them is, with its article, for the legend."""


@dataclass(frozen=True, eq=False)
class EllipsesOfPlaces:
    """Ellipses of such places."""

    of: OtherPlaces
    """The places."""
    semi: Array
    """Semi-axes, largest first, (k, 2)."""
    direction: Array
    """Direction of the first semi-axis, radians, (k,)."""


@dataclass(frozen=True, eq=False)
class ConfidenceRegions:
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
    others: tuple[EllipsesOfPlaces, ...]
    """Ellipses of instruments and of places of shapes."""
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

    @property
    def positive_sizes(self) -> Array:
        """Extents of the regions of points; of those of photos and others where points have none.

        The result is empty where everything is held.
        """
        sizes, others = self.sizes, [each.semi[:, 0] for each in self.others]
        if np.any(sizes > 0):
            return np.asarray(sizes[sizes > 0])
        every = np.concatenate([self.centre_semi[:, 0], *others])
        return np.asarray(every[every > 0])


def confidence_regions(
    solution: Solution,
    plan: DrawingPlane,
    confidence: float,
    factor: float | None,
    heights: bool,
    doubtful: bool,
    others: Sequence[OtherPlaces] = (),
) -> ConfidenceRegions | None:
    """Return the confidence regions in a plan; None without covariances."""
    found = place_covariances(solution)
    if found is None:
        return None
    points, centres = (plan.covariance(each) for each in found)
    k1 = solution_confidence_factor(solution, 1, confidence)
    semi, direction = plane_ellipses(points[:, :2, :2])
    centre_semi, centre_direction = plane_ellipses(centres[:, :2, :2])
    up = np.sqrt(np.maximum(points[:, 2, 2], 0.0))
    return ConfidenceRegions(
        solution,
        region_factors(solution, semi**2, confidence)[:, None] * semi,
        direction,
        region_factors(solution, centre_semi**2, confidence)[:, None] * centre_semi,
        centre_direction,
        tuple(_region(solution, each, confidence) for each in others if len(each.at)),
        k1 * up if heights else np.zeros(len(up)),
        f"confidence {100 * confidence:g} %, {_SIGMA0[solution.variance]}"
        + (", free network" if solution.datum is not None else "")
        + (", computed readings" if has_computed_readings(solution) else ""),
        factor,
        doubtful,
    )


def _region(solution: Solution, others: OtherPlaces, confidence: float) -> EllipsesOfPlaces:
    semi, direction = plane_ellipses(others.sigma[:, :2, :2])
    return EllipsesOfPlaces(
        others, region_factors(solution, semi**2, confidence)[:, None] * semi, direction
    )


@dataclass(frozen=True)
class DrawnRegions:
    """Texts and legend of the drawn regions."""

    title: str
    """Line below the title."""
    legend: list[Artist]
    """Entries of the legend."""
    notes: list[str]
    """Notes below the figure."""


def draw_confidence_regions(
    axes: Axes, precision: ConfidenceRegions, at: Array, centres: Array, limits: tuple[Array, Array]
) -> DrawnRegions:
    """Draw ellipses and intervals at points (n, 2) and projection centres (m, 2), with a key."""
    from matplotlib.collections import LineCollection

    sizes = precision.sizes
    positive = precision.positive_sizes
    if not len(positive):
        return DrawnRegions("every point is held: there are no error ellipses", [], [])
    extent = float(np.max(limits[1] - limits[0]))
    typical = float(np.median(positive))
    factor = precision.factor
    if factor is None:
        factor = visible_factor(typical, at if len(at) else centres, limits)
    fits = sizes * factor <= MAX_ELLIPSE_SIZE * extent
    found: list[Artist] = []
    line = 1.0 if len(at) <= 300 else 0.5
    dashes, more = precision.look
    oval = fits & (precision.semi[:, 0] > 0)
    if oval.any():
        which = (precision.semi, precision.direction, oval, factor, VERMILLION, line, dashes)
        found.append(_ellipses(axes, at, *which, "a point", more))
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
        precision.centre_semi[:, 0] * factor <= MAX_ELLIPSE_SIZE * extent
    )
    notes = _too_large(precision, ~fits)
    area = np.pi * factor**2 * np.sum(np.prod(precision.centre_semi[ovals], axis=1))
    if area > MAX_AREA_COVERED * float(np.prod(limits[1] - limits[0])):
        notes.append("error ellipses of projection centres are left out: they would cover the rest")
        ovals[:] = False
    if ovals.any():
        whose = (precision.centre_semi, precision.centre_direction, ovals, factor, PURPLE)
        looks = (0.8 * line, dashes, "a projection centre", more)
        found.append(_ellipses(axes, centres, *whose, *looks))
    for each in precision.others:
        fit = (each.semi[:, 0] > 0) & (each.semi[:, 0] * factor <= MAX_ELLIPSE_SIZE * extent)
        if fit.any():
            region = (each.semi, each.direction, fit, factor, each.of.colour, line, dashes)
            found.append(_ellipses(axes, each.of.at, *region, each.of.label, more))
        enlarge_axes(axes, each.of.at[fit], factor * each.semi[fit, 0])
        lost = int(np.sum(each.semi[:, 0] * factor > MAX_ELLIPSE_SIZE * extent))
        if lost:
            notes.append(f"too large to be drawn: error ellipse of {each.of.label} ({lost})")
    enlarge_axes(axes, at[fits], factor * precision.sizes[fits])
    enlarge_axes(axes, centres[ovals], factor * precision.centre_semi[ovals, 0])
    key = readable_number(typical)
    while key * factor < 0.04 * extent:
        key = readable_number(2.6 * key)
    draw_scale_key(axes, key * factor, f"{length_text(key)}, {exaggeration_text(factor)}")
    return DrawnRegions(precision.title, found, notes)


def visible_factor(typical: float, places: Array, limits: tuple[Array, Array]) -> float:
    """Return the exaggeration, 1, 2 or 5 times a power of ten, that makes regions well visible.

    Args:
        typical: size of a region of medium size, metres.
        places: places of the regions, (n, 2) metres.
        limits: lower left and upper right corner of the drawing, (2,) metres each.
    """
    extent = float(np.max(limits[1] - limits[0]))
    # Instruments and photos around the points leave no more room between these.
    own = (
        places.min(axis=0) - ROOM_AROUND_POINTS * extent,
        places.max(axis=0) + ROOM_AROUND_POINTS * extent,
    )
    among = np.maximum(own[0], limits[0]), np.minimum(own[1], limits[1])
    room = min(0.45 * mean_spacing(places, *among), 0.05 * extent)
    return readable_number(room / typical)


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
    whose: str,
    more: str,
) -> Artist:
    """Draw ellipses; return their entry of the legend, an interval where all are lines.

    A place that is held in one direction of the drawing has an interval instead of an ellipse.
    """
    from matplotlib.collections import EllipseCollection
    from matplotlib.lines import Line2D

    flat = semi[shown, 1] ** 2 <= FIXED_AXIS_VARIANCE_RATIO * semi[shown, 0] ** 2
    label = f"error ellipse of {whose}"
    if flat.all():
        label = f"interval of {whose}, which is free in one direction"
    label += more
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
    if dashes != "-" or flat.all():
        return Line2D([], [], color=colour, ls=dashes, lw=1.2, label=wrapped(label))
    return Line2D([], [], ls="", marker="o", ms=8.0, mfc="none", mec=colour, label=wrapped(label))


def enlarge_axes(axes: Axes, at: Array, radius: Array) -> None:
    """Enlarge the axes so that they contain the whole regions around the positions inside."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    x, y = at.T
    inside = (x >= left) & (x <= right) & (y >= bottom) & (y <= top)
    if inside.any():
        x, y, radius = x[inside], y[inside], 1.05 * radius[inside]
        axes.set_xlim(min(left, float(np.min(x - radius))), max(right, float(np.max(x + radius))))
        axes.set_ylim(min(bottom, float(np.min(y - radius))), max(top, float(np.max(y + radius))))


def _too_large(precision: ConfidenceRegions, left_out: Mask) -> list[str]:
    """Name the points whose ellipses would cover the plan."""
    if not left_out.any():
        return []
    names = precision.solution.equations.unknowns["point"].names
    order = np.argsort(-precision.sizes, kind="stable")[: int(left_out.sum())]
    listed = ", ".join(f"{names[i]} ({length_text(float(precision.sizes[i]))})" for i in order[:5])
    more = f" and {len(order) - 5} more" if len(order) > 5 else ""
    return [f"too large to be drawn: {listed}{more}"]

"""Figure of two epochs: plan of displacements with ellipses and blocks, panel of heights.

The plan is that of the network of the first epoch, see
`factorgraph_adj.report.plots.drawing_plane`. One factor exaggerates displacements and ellipses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from ...epochs.block_motion import BlockMotion
from ...epochs.comparison_result import Congruence
from ...errors import InputError
from ...quality.error_ellipses import confidence_factor
from ...types import Array, Mask
from ..epochs_report import EpochsReport
from .drawing_plane import DrawingPlane, drawing_plane_of
from .network_plan import draw_axis_scales
from .observation_lines import lines_by_kinds
from .point_symbols import PlanNames, legend_with_names, plan_window
from .style import (
    BLACK,
    BLUE,
    GREY,
    PALE,
    PURPLE,
    VERMILLION,
    checked_positive,
    draw_scale_key,
    exaggeration_text,
    in_package_style,
    length_text,
    new_figure,
    readable_number,
    wrapped,
    write_headline,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE_OF_LARGE_DISPLACEMENT = 0.12
"""Size of a large displacement, or ellipse, in the larger side of the plan."""
QUANTILE_OF_LARGE_DISPLACEMENT = 0.9
"""Share of the displacements that are not larger than a large one."""
MAX_DISPLACEMENT_DRAWN = 0.5
"""Size from which a displacement, or an ellipse, is not drawn, in the larger side of the plan."""
EPOCH_POINT_SYMBOLS = {
    "stable": ("^", 34.0, BLUE, BLUE, "stable reference point"),
    "left": ("^", 34.0, "none", VERMILLION, "reference point that is not stable"),
    "moved": ("o", 18.0, VERMILLION, VERMILLION, "point that moved"),
    "kept": ("o", 14.0, BLACK, BLACK, "point without a significant displacement"),
}
"""Marker, area, face, edge and name of each state of a point."""
MAX_KEY_LENGTH_SHARE = 0.12
"""Largest length of the bar of the scale key, in the larger side of the plan."""
MAX_HEIGHT_LABELS = 60
"""Largest number of points whose names stand below a diagram of heights."""


@dataclass(frozen=True, eq=False)
class EpochsDrawing:
    """Places, displacements and ellipses in the drawing plane of the first epoch."""

    report: EpochsReport
    """The comparison."""
    chosen: float | None = None
    """Factor of exaggeration; None: a round number that makes the displacements visible."""

    @cached_property
    def every(self) -> Array:
        """Coordinates of all points of the first network, (m, 3) metres."""
        return np.nan_to_num(self.report.found.solutions[0].state["point"])

    @cached_property
    def plane(self) -> DrawingPlane:
        """Drawing plane."""
        return drawing_plane_of(self.report.network.frame, self.every)

    @cached_property
    def others(self) -> Array:
        """Places of all points of the first network, (m, 2)."""
        return self.plane.coordinates(self.every)[:, :2]

    @cached_property
    def at(self) -> Array:
        """Places of the compared points, (n, 2)."""
        return self.plane.coordinates(self.report.places)[:, :2]

    @property
    def flat(self) -> bool:
        """Whether displacements are horizontal, or have a horizontal part."""
        return self.report.found.differences.axes != "z"

    @property
    def tall(self) -> bool:
        """Whether displacements have a vertical part."""
        return "z" in self.report.found.differences.axes

    @cached_property
    def schematic(self) -> bool:
        """Whether there is no plan: heights alone, of points without plan coordinates."""
        return not self.flat and not np.ptp(self.at, axis=0).any()

    @cached_property
    def vectors(self) -> Array:
        """Displacements in the drawing, (n, 2) metres; heights alone point up and down."""
        local = self.report.vectors @ self.plane.axes.T
        if self.flat:
            return np.asarray(local[:, :2])
        return np.column_stack([np.zeros(len(local)), local[:, 2]])

    @cached_property
    def rises(self) -> Array:
        """Vertical displacements, (n,) metres."""
        return np.asarray((self.report.vectors @ self.plane.axes.T)[:, 2])

    @cached_property
    def intervals(self) -> Array:
        """Half intervals of vertical displacements, (n,) metres."""
        found = self.report.found
        freedom = None if np.isinf(found.scale.freedom) else int(found.scale.freedom)
        k = confidence_factor(1, self.report.confidence, redundancy=freedom)
        every = np.array([x.covariance for x in found.displacements.values()]).reshape(-1, 3, 3)
        up = self.plane.axes[2]
        return np.asarray(k * np.sqrt(np.maximum(np.einsum("i,nij,j->n", up, every, up), 0.0)))

    @cached_property
    def ellipses(self) -> Array:
        """Semi-axes, and direction of the first one from right to up, (n, 3).

        Heights alone have an interval, which is upright.
        """
        if not self.flat:
            upright = np.full(len(self.at), pi / 2)
            return np.column_stack([self.intervals, np.zeros(len(self.at)), upright])
        every = [(*e.semi_axes, pi / 2 - e.azimuth) for e in self.report.ellipses]
        return np.array(every).reshape(-1, 3)

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Lower left and upper right corner of the plan."""
        low, high, _ = plan_window(np.concatenate([self.at, self.others]))
        if float(np.max(high - low)) < 1e-6:
            return low - 1.0, high + 1.0
        return low, high

    @property
    def extent(self) -> float:
        """Larger side of the plan, metres."""
        low, high = self.limits
        return float(np.max(high - low))

    @cached_property
    def sizes(self) -> Array:
        """Larger one of displacement and semi-major axis of each point, (n,) metres."""
        return np.asarray(np.maximum(np.linalg.norm(self.vectors, axis=1), self.ellipses[:, 0]))

    @cached_property
    def factor(self) -> float:
        """Exaggeration of displacements and ellipses: one factor, so that they can be compared."""
        if self.chosen is not None:
            return self.chosen
        sizes = self.sizes[self.sizes > 0]
        if not len(sizes):
            return 1.0
        large = float(np.quantile(sizes, QUANTILE_OF_LARGE_DISPLACEMENT))
        return readable_number(SIZE_OF_LARGE_DISPLACEMENT * self.extent / large)

    @cached_property
    def fits(self) -> Mask:
        """Which displacements are small enough to be drawn, (n,)."""
        return np.asarray(self.factor * self.sizes <= MAX_DISPLACEMENT_DRAWN * self.extent)

    @cached_property
    def reach(self) -> tuple[Array, Array]:
        """Corners of the plan with all displacements and ellipses that are drawn."""
        low, high = self.limits
        ends = (self.at + self.factor * self.vectors)[self.fits]
        size = 1.1 * self.factor * self.ellipses[self.fits, :1]
        every = np.concatenate([[low, high], ends - size, ends + size])
        return every.min(axis=0), every.max(axis=0)

    @cached_property
    def outlines(self) -> list[tuple[Array, Array]]:
        """Each block as a closed line through its points, and how its motion moves this line.

        Two arrays (m, 2) for each block: places, and displacements in metres.
        """
        axes = ["xyz".index(a) for a in self.report.found.differences.axes]
        out = []
        for b in self.report.blocks:
            here = [self.report.names.index(n) for n in b.points]
            model = np.zeros((len(here), 3))
            model[:, axes] = self.report.vectors[np.ix_(here, axes)] - b.residuals
            moved = model @ self.plane.axes.T
            moved = moved[:, :2] if self.flat else np.column_stack([0.0 * moved[:, 2], moved[:, 2]])
            at = self.at[here]
            around = np.arctan2(*(at - at.mean(axis=0)).T[::-1])
            order = np.argsort(around, kind="stable")
            order = np.append(order, order[:1])
            out.append((at[order], moved[order]))
        return out


@in_package_style
def plot_displacements(
    found: Congruence,
    *,
    blocks: Sequence[BlockMotion] = (),
    confidence: float | None = None,
    factor: float | None = None,
    labels: bool = True,
) -> Figure:
    """Draw what moved between two epochs: displacements against the stable points, with ellipses.

    An ellipse stands at the end of its displacement. One factor, which the scale key states,
    exaggerates displacements and ellipses: with the confidence 1 − α a displacement in plan is
    significant where its point lies outside of its ellipse. Significant displacements have the
    colour of warning. Reference points are triangles, filled where they are stable. The lines of a
    block lead through its points, dashed where its motion takes them. Heights alone are drawn as
    arrows up and down; where points have heights and plan coordinates, a diagram of the vertical
    displacements stands below the plan.

    Args:
        found: the result of `congruence`.
        blocks: common motions of points, see `block_motion`.
        confidence: probability of the ellipses and intervals; None: 1 − α of the tests.
        factor: exaggeration; None: a round number that makes the displacements visible.
        labels: write the names of the points where there is room.

    Raises:
        InputError: the confidence is outside (0, 1), the factor is not positive, or matplotlib is
            not installed.
    """
    confidence = 1.0 - found.alpha if confidence is None else confidence
    if not 0 < confidence < 1:
        raise InputError(f"confidence must lie between 0 and 1, not {confidence}")
    if factor is not None:
        checked_positive(factor, "factor")
    report = EpochsReport(found, tuple(blocks), confidence=confidence)
    plan = EpochsDrawing(report, factor)
    both = plan.tall and not plan.schematic
    low, high = plan.reach
    width, height = (high - low).tolist()
    across = float(np.clip(7.5 * max(width / height, 0.55), 4.5, 8.0))
    up = 3.2 if plan.schematic else float(np.clip(across * height / width + 1.0, 4.0, 9.0))
    figure = new_figure(across + 3.0, up + (2.4 if both else 0.0))
    rows = figure.add_gridspec(2 if both else 1, 1, height_ratios=[up, 2.0] if both else [1.0])
    axes = figure.add_subplot(rows[0])
    name = " → ".join(s.network.name or "epoch" for s in found.solutions)
    if plan.schematic:
        _heights(axes, plan)
        write_headline(axes, name, _below(report))
        _legend(figure, axes, plan, _state_entries(axes, plan), labels=False)
        return figure
    legend = _plan(axes, plan)
    write_headline(axes, name, _below(report), width=across - 2.2)
    if both:
        _heights(figure.add_subplot(rows[1]), plan)
    lost = [report.names[i] for i in np.flatnonzero(~plan.fits).tolist()]
    if lost or plan.plane.note:
        notes = [plan.plane.note] if plan.plane.note else []
        notes += [f"too large to be drawn: {', '.join(lost)}"] if lost else []
        figure.supxlabel("\n".join(notes), fontsize=8.0, x=0.01, ha="left")
    _legend(figure, axes, plan, legend, labels=labels)
    return figure


def _below(report: EpochsReport) -> str:
    """Return the line below the title."""
    moved = len(report.found.moved)
    region = "intervals" if report.found.differences.axes == "z" else "ellipses"
    level = "standard" if report.confidence is None else f"{100 * report.confidence:g} %"
    return f"{moved} of {len(report.states)} points moved; {region} {level}"


def _legend(
    figure: Figure, axes: Axes, plan: EpochsDrawing, legend: list[Artist], *, labels: bool
) -> None:
    states = np.array(plan.report.states)
    first = (states == "left") | (states == "moved")
    named = PlanNames(plan.report.names, plan.at, first) if labels else None
    legend_with_names(figure, axes, legend, named, plan.report.doubts)


def _plan(axes: Axes, plan: EpochsDrawing) -> list[Artist]:
    """Draw the plan; return the entries of the legend."""
    from matplotlib.collections import LineCollection

    report, (low, high) = plan.report, plan.reach
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(float(low[0]), float(high[0]))
    axes.set_ylim(float(low[1]), float(high[1]))
    lines = [plan.others[e] for _, ends in lines_by_kinds(report.found.solutions[0]) for e in ends]
    sights = LineCollection(
        lines, colors=PALE, linewidths=0.6, zorder=0, label=f"observed lines ({len(lines)})"
    )
    legend: list[Artist] = []
    if lines:
        axes.add_collection(sights)
        legend.append(sights)
    compared = {*report.found.differences.names}
    if len(report.found.solutions) == 1:
        compared |= {*report.found.differences.later}
    rest = [i for i, n in enumerate(report.network.points) if n not in compared]
    if rest:
        x, y = plan.others[rest].T
        label = f"point that is not compared ({len(rest)})"
        legend.append(axes.scatter(x, y, s=9.0, c=GREY, lw=0, zorder=1, label=wrapped(label)))
    legend += _blocks(axes, plan)
    moved = np.array([x.moved for x in report.found.displacements.values()], dtype=bool)
    for mask, colour, what in (
        (~moved & plan.fits, GREY, "displacement, not significant"),
        (moved & plan.fits, VERMILLION, "significant displacement"),
    ):
        legend += _vectors(axes, plan, mask, colour, what)
    legend += _state_entries(axes, plan)
    if plan.sizes.any():
        key = readable_number(MAX_KEY_LENGTH_SHARE * plan.extent / plan.factor)
        what = "displacements and ellipses" if plan.flat else "displacements and intervals"
        label = f"{what}:\n{length_text(key)}, {exaggeration_text(plan.factor)}"
        draw_scale_key(axes, key * plan.factor, label, upright=not plan.flat)
    draw_axis_scales(axes, plan.plane, plan.extent)
    return legend


def _state_entries(axes: Axes, plan: EpochsDrawing) -> list[Artist]:
    """Draw the points by their states; return the entries of the legend."""
    states = np.array(plan.report.states)
    found: list[Artist] = []
    at = plan.at
    if plan.schematic:
        at = np.column_stack([np.arange(len(at)), 1000.0 * plan.rises])
    for state, (marker, area, face, edge, label) in EPOCH_POINT_SYMBOLS.items():
        own = states == state
        if own.any():
            found.append(
                axes.scatter(
                    at[own, 0],
                    at[own, 1],
                    s=area,
                    marker=marker,
                    facecolors=face,
                    edgecolors=edge,
                    lw=1.2,
                    zorder=2.5,
                    label=wrapped(f"{label} ({int(own.sum())})"),
                )
            )
    return found


def _vectors(axes: Axes, plan: EpochsDrawing, mask: Mask, colour: str, what: str) -> list[Artist]:
    """Draw displacements with their ellipses; return the entries of the legend."""
    from matplotlib.collections import EllipseCollection
    from matplotlib.lines import Line2D

    if not mask.any():
        return []
    ends = plan.at[mask] + plan.factor * plan.vectors[mask]
    axes.quiver(
        *plan.at[mask].T,
        *(ends - plan.at[mask]).T,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        units="inches",
        width=0.018,
        minlength=0.0,
        color=colour,
        zorder=3,
    )
    a, b, turn = plan.ellipses[mask].T
    axes.add_collection(
        EllipseCollection(
            2 * plan.factor * a,
            2 * plan.factor * b,
            np.degrees(turn),
            units="xy",
            offsets=ends,
            offset_transform=axes.transData,
            facecolors="none",
            edgecolors=colour,
            linewidths=0.9,
            zorder=3.5,
        )
    )
    region = "ellipse" if plan.flat else "interval"
    entry = Line2D([], [], color=colour, lw=1.6, marker="o", ms=7.0, mfc="none")
    entry.set_label(wrapped(f"{what}, with its {region} ({int(mask.sum())})"))
    return [entry]


def _blocks(axes: Axes, plan: EpochsDrawing) -> list[Artist]:
    from matplotlib.lines import Line2D

    for at, moved in plan.outlines:
        axes.plot(*at.T, color=PURPLE, lw=1.0, zorder=2)
        axes.plot(*(at + plan.factor * moved).T, color=PURPLE, lw=1.4, ls="--", zorder=2)
    n = len(plan.outlines)
    entry = Line2D([], [], color=PURPLE, ls="--", lw=1.4)
    entry.set_label(wrapped(f"block and its common motion ({n})"))
    return [entry] if n else []


def _heights(axes: Axes, plan: EpochsDrawing) -> None:
    """Draw the vertical displacements with their intervals, point by point."""
    report = plan.report
    moved = np.array([x.moved for x in report.found.displacements.values()], dtype=bool)
    x, mm = np.arange(len(moved)), 1000.0
    axes.axhline(0.0, color=BLACK, lw=0.8, zorder=1)
    for mask, colour in ((~moved, GREY), (moved, VERMILLION)):
        axes.errorbar(
            x[mask],
            mm * plan.rises[mask],
            mm * plan.intervals[mask],
            fmt="o",
            ms=4.0,
            color=colour,
            capsize=2.5,
            lw=1.2,
            zorder=3,
        )
    axes.set_ylabel("rise [mm]")
    axes.set_xlim(-0.6, max(len(moved) - 0.4, 0.6))
    if len(moved) <= MAX_HEIGHT_LABELS:
        axes.set_xticks(x, report.names, rotation=60 if len(moved) > 12 else 0)
    else:
        axes.set_xticks([])

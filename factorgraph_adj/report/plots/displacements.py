"""The plan of two epochs: displacements with their ellipses, reference points and blocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...epochs.blocks import BlockMotion
from ...epochs.comparison import Congruence
from ...errors import InputError
from ...types import Mask
from ..epochs.context import EpochsReport
from .displaced import EpochsDrawing
from .names import Named, legend_with_names
from .network import scales
from .sights import lines_by_kinds
from .style import (
    BLACK,
    BLUE,
    GREY,
    PALE,
    PURPLE,
    VERMILLION,
    drawn,
    exaggeration,
    headline,
    length,
    new_figure,
    positive,
    readable,
    scale_key,
    wrapped,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKS = {
    "stable": ("^", 34.0, BLUE, BLUE, "stable reference point"),
    "left": ("^", 34.0, "none", VERMILLION, "reference point that is not stable"),
    "moved": ("o", 18.0, VERMILLION, VERMILLION, "point that moved"),
    "kept": ("o", 14.0, BLACK, BLACK, "point without a significant displacement"),
}
"""Marker, area, face, edge and name of each state of a point."""
LONGEST_KEY = 0.12
"""Largest length of the bar of the scale key, in the larger side of the plan."""
MOST_LABELS = 60
"""Largest number of points whose names stand below a diagram of heights."""


@drawn
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
        positive(factor, "factor")
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
        headline(axes, name, _below(report))
        _legend(figure, axes, plan, _state_entries(axes, plan), labels=False)
        return figure
    legend = _plan(axes, plan)
    headline(axes, name, _below(report), width=across - 2.2)
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
    named = Named(plan.report.names, plan.at, first) if labels else None
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
        key = readable(LONGEST_KEY * plan.extent / plan.factor)
        what = "displacements and ellipses" if plan.flat else "displacements and intervals"
        label = f"{what}:\n{length(key)}, {exaggeration(plan.factor)}"
        scale_key(axes, key * plan.factor, label, upright=not plan.flat)
    scales(axes, plan.plane, plan.extent)
    return legend


def _state_entries(axes: Axes, plan: EpochsDrawing) -> list[Artist]:
    """Draw the points by their states; return the entries of the legend."""
    states = np.array(plan.report.states)
    found: list[Artist] = []
    at = plan.at
    if plan.schematic:
        at = np.column_stack([np.arange(len(at)), 1000.0 * plan.rises])
    for state, (marker, area, face, edge, label) in MARKS.items():
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
    if len(moved) <= MOST_LABELS:
        axes.set_xticks(x, report.names, rotation=60 if len(moved) > 12 else 0)
    else:
        axes.set_xticks([])

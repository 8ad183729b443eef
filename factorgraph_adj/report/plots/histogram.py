"""The histogram of the test values of all observations."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ...io.numbers import Units
from ...quality.reliability import Reliability
from ...types import Array
from ..rows import ReportRows
from ..set_aside import SetAside
from .style import BLACK, SKY, VERMILLION, beside, drawn, headline, new_figure, nothing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NO_TESTS = "No observation is controlled by others (all redundancy numbers are 0): no test values."
W = "w = v / σᵥ (a-priori σ0 = 1)"
REACH = 5.0
"""Smallest |w| to which the bars reach."""
BARS = 5, 60
"""Smallest and largest number of bars on each side of zero."""


@drawn
def plot_w(rel: Reliability, *, aside: SetAside | None = None) -> Figure:
    """Draw the histogram of the test values w with their expected distribution.

    Without blunders and systematic errors, and with correct standard deviations, each w is
    standard normal. The critical values ±k are edges of bars: each bar beyond them has suspects
    only, and another colour. Values outside the histogram are counted in the outermost bars, and
    a note states this.

    Args:
        rel: reliability of an adjustment; only controlled observations have a w.
        aside: observations that were set aside, see `set_aside`; hatched bars upon the others
            have the test values w that they would have.

    Returns:
        A figure; if no observation is controlled, it shows a message.

    Raises:
        InputError: matplotlib is not installed.
    """
    name = rel.solution.network.name or "network"
    w = w_in_files(rel)[rel.controlled]
    n = len(w)
    if not n:
        return nothing(name, NO_TESTS)
    crit = rel.critical_w
    edges = histogram_edges(n, crit)
    limit = float(edges[-1])
    figure = new_figure(8.0, 4.6)
    axes = figure.add_subplot()
    counts = _counts(w, edges)
    middle = (edges[1:] + edges[:-1]) / 2
    colours = [VERMILLION if abs(m) > crit else SKY for m in middle.tolist()]
    width = float(edges[1] - edges[0])
    axes.bar(edges[:-1], counts, width, align="edge", color=colours, edgecolor="white", lw=0.4)
    beyond = int(np.sum(np.abs(w) > crit))
    axes.fill_between([], [], color=SKY, label="w")
    if beyond:
        axes.fill_between([], [], color=VERMILLION, label=f"suspects ({beyond})")
    x = np.linspace(-limit, limit, 401)
    expected = n * width * np.exp(-x * x / 2.0) / np.sqrt(2.0 * np.pi)
    axes.plot(x, expected, color=BLACK, lw=1.5, label="standard normal")
    critical_lines(axes.axvline, rel)
    lines = [
        f"{n} controlled observations",
        f"{len(rel.w) - n} not controlled: no w",
        f"RMS w {np.sqrt(np.mean(w**2)):.3f}, mean {np.mean(w):.3f}".replace("-", "−"),
        f"|w| > {crit:.2f}: {beyond}, expected {rel.alpha * n:.2g}",
    ]
    if aside is not None and aside.count:
        counts = counts + _draw_aside(axes, aside, edges, counts)
        unknown = int(np.sum(~np.isfinite(aside.w)))
        if unknown:
            lines.append(f"{unknown} components set aside without a w")
    axes.set_ylim(0.0, 1.08 * max(float(np.max(counts)), float(expected.max())))
    axes.set_xlim(-limit, limit)
    axes.set_xlabel(W)
    axes.set_ylabel("number of observations (components)")
    headline(axes, name, "test values w of Baarda")
    there = [("", w), (" set aside", np.zeros(0) if aside is None else aside.w)]
    for what, values in there:
        outer = np.abs(values[np.abs(values) > limit])
        if len(outer):
            lines.append(
                f"{len(outer)}{what} beyond ±{limit:.2f}, in the outer bars;\n"
                f"largest |w|{what} {outer.max():.1f}"
            )
    beside(figure, axes, lines)
    return figure


def rows_of(rel: Reliability) -> ReportRows:
    """Return the rows of an adjustment as reports show them."""
    solution = rel.solution
    return ReportRows(solution.equations, solution.observations.residuals, Units())


def w_in_files(rel: Reliability) -> Array:
    """Return w (n,) in the axes of files, as tables have it."""
    return np.asarray(rows_of(rel).signs() * rel.w)


def histogram_edges(n: int, critical: float) -> Array:
    """Return edges of equal bars for n standard normal values, symmetric about 0.

    Both critical values are edges. Bars are about 2 IQR / ∛n wide (Freedman & Diaconis), and
    reach ±5 and 1 beyond the critical values.
    """
    width = 2 * 1.349 / np.cbrt(n)
    reach = max(REACH, critical + 1.0)
    fewest, most = (b * critical / reach for b in BARS)
    inside = int(np.clip(np.ceil(critical / width), np.ceil(fewest), max(np.floor(most), 1)))
    each_side = int(np.ceil(reach * inside / critical))
    return np.asarray(critical * (np.arange(-each_side, each_side + 1) / inside))


def _draw_aside(axes: Axes, aside: SetAside, edges: Array, below: Array) -> Array:
    """Draw the test values of observations set aside upon the bars; return their counts."""
    found = aside.w[np.isfinite(aside.w)]
    counts = _counts(found, edges)
    some = counts > 0
    axes.bar(
        edges[:-1][some],
        counts[some],
        np.diff(edges)[some],
        below[some],
        align="edge",
        facecolor="white",
        edgecolor=BLACK,
        hatch="xxxx",
        lw=0.6,
        label=f"set aside, as predicted ({aside.count})",
        gid="set aside",
    )
    return counts


def _counts(values: Array, edges: Array) -> Array:
    """Return how many values each bar has; the outermost bars have those beyond them too."""
    return np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0].astype(float)


def critical_lines(line: Callable[..., object], rel: Reliability) -> None:
    """Draw the two critical values of w by ``line``, which takes a place and a style."""
    label = f"critical ±{rel.critical_w:.2f} (α0 = {100 * rel.alpha:.3g} %)"
    line(rel.critical_w, color=VERMILLION, lw=1.2, ls="--", label=label)
    line(-rel.critical_w, color=VERMILLION, lw=1.2, ls="--")

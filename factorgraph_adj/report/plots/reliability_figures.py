"""Figures of test values w (histogram, normal quantiles) and of redundancy numbers by kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import betaincinv, ndtri

from ...io.numbers import Units
from ...quality.reliability import Reliability
from ...types import Array, Index
from ..observation_rows import ReportRows, Row
from ..rejected_observations import RejectedObservations
from .style import (
    BLACK,
    BLUE,
    GREY,
    PALE,
    SKY,
    VERMILLION,
    empty_figure,
    in_package_style,
    legend_at_right,
    new_figure,
    shortened,
    write_headline,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NO_TEST_VALUES = (
    "No observation is controlled by others (all redundancy numbers are 0): no test values."
)
TEST_VALUE_LABEL = "w = v / σᵥ (a-priori σ0 = 1)"
MIN_HISTOGRAM_REACH = 5.0
"""Smallest |w| to which the bars reach."""
BARS_ON_EACH_SIDE = 5, 60
"""Smallest and largest number of bars on each side of zero."""
MAX_VALUES_SHOWN_EACH = 400
"""Largest number of values of a group that shows each value."""
MAX_VECTOR_MARKERS = 20_000
"""Largest number of markers drawn as vectors; more markers become an image in every format."""


@in_package_style
def plot_w(rel: Reliability, *, aside: RejectedObservations | None = None) -> Figure:
    """Draw the histogram of the test values w with their expected distribution.

    Without blunders and systematic errors, and with correct standard deviations, each w is
    standard normal. The critical values ±k are edges of bars: each bar beyond them has suspects
    only, and another colour. Values outside the histogram are counted in the outermost bars, and
    a note states this.

    Args:
        rel: reliability of an adjustment; only controlled observations have a w.
        aside: observations that were rejected, see `set_aside`; hatched bars upon the others
            have the test values w that they would have.

    Returns:
        A figure; if no observation is controlled, it shows a message.

    Raises:
        InputError: matplotlib is not installed.
    """
    name = rel.solution.network.name or "network"
    w = test_values_in_files(rel)[rel.controlled]
    n = len(w)
    if not n:
        return empty_figure(name, NO_TEST_VALUES)
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
    draw_critical_lines(axes.axvline, rel)
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
            lines.append(f"{unknown} components rejected without a w")
    axes.set_ylim(0.0, 1.08 * max(float(np.max(counts)), float(expected.max())))
    axes.set_xlim(-limit, limit)
    axes.set_xlabel(TEST_VALUE_LABEL)
    axes.set_ylabel("number of observations (components)")
    write_headline(axes, name, "test values w of Baarda")
    there = [("", w), (" rejected", np.zeros(0) if aside is None else aside.w)]
    for what, values in there:
        outer = np.abs(values[np.abs(values) > limit])
        if len(outer):
            lines.append(
                f"{len(outer)}{what} beyond ±{limit:.2f}, in the outer bars;\n"
                f"largest |w|{what} {outer.max():.1f}"
            )
    legend_at_right(figure, axes, lines)
    return figure


def report_rows(rel: Reliability) -> ReportRows:
    """Return the rows of an adjustment as reports show them."""
    solution = rel.solution
    return ReportRows(solution.equations, solution.observations.residuals, Units())


def test_values_in_files(rel: Reliability) -> Array:
    """Return w (n,) in the axes of files, as tables have it."""
    return np.asarray(report_rows(rel).signs() * rel.w)


def histogram_edges(n: int, critical: float) -> Array:
    """Return edges of equal bars for n standard normal values, symmetric about 0.

    Both critical values are edges. Bars are about 2 IQR / ∛n wide (Freedman & Diaconis), and
    reach ±5 and 1 beyond the critical values.
    """
    width = 2 * 1.349 / np.cbrt(n)
    reach = max(MIN_HISTOGRAM_REACH, critical + 1.0)
    fewest, most = (b * critical / reach for b in BARS_ON_EACH_SIDE)
    inside = int(np.clip(np.ceil(critical / width), np.ceil(fewest), max(np.floor(most), 1)))
    each_side = int(np.ceil(reach * inside / critical))
    return np.asarray(critical * (np.arange(-each_side, each_side + 1) / inside))


def _draw_aside(axes: Axes, aside: RejectedObservations, edges: Array, below: Array) -> Array:
    """Draw the test values of observations rejected upon the bars; return their counts."""
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
        label=f"rejected, as predicted ({aside.count})",
        gid="rejected",
    )
    return counts


def _counts(values: Array, edges: Array) -> Array:
    """Return how many values each bar has; the outermost bars have those beyond them too."""
    return np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0].astype(float)


def draw_critical_lines(line: Callable[..., object], rel: Reliability) -> None:
    """Draw the two critical values of w by ``line``, which takes a place and a style."""
    label = f"critical ±{rel.critical_w:.2f} (α0 = {100 * rel.alpha:.3g} %)"
    line(rel.critical_w, color=VERMILLION, lw=1.2, ls="--", label=label)
    line(-rel.critical_w, color=VERMILLION, lw=1.2, ls="--")


@in_package_style
def plot_qq(
    rel: Reliability, *, most: int = 8, aside: RejectedObservations | None = None
) -> Figure:
    """Draw the sorted test values w against the quantiles of the standard normal distribution.

    The i-th of n values lies over Φ⁻¹((i − ½)/n). Without blunders the values follow the
    diagonal; a steeper line means that standard deviations are too small in general; outliers
    leave the line at its ends. The shaded band contains 95 % of the points if all w are
    independent; the w of one network are only nearly independent.

    Args:
        rel: reliability of an adjustment; only controlled observations have a w.
        most: largest number of suspects (|w| above the critical value) that are named, with
            their ids, largest |w| first.
        aside: observations that were rejected, see `set_aside`; they are counted, not drawn.

    Returns:
        A figure; if no observation is controlled, it shows a message.

    Raises:
        InputError: matplotlib is not installed.
    """
    name = rel.solution.network.name or "network"
    from matplotlib.ticker import FuncFormatter

    rows = np.flatnonzero(rel.controlled)
    n = len(rows)
    if not n:
        return empty_figure(name, NO_TEST_VALUES)
    every = test_values_in_files(rel)
    rows = rows[np.argsort(every[rows], kind="stable")]
    w, crit = every[rows], rel.critical_w
    i = np.arange(1, n + 1)
    x = ndtri((i - 0.5) / n)
    figure = new_figure(8.0, 6.0)
    axes = figure.add_subplot()
    ends = np.arange(1, min(n, 100) + 1)
    middle = np.linspace(1, n, 300).round().astype(np.intp)
    at = np.unique(np.concatenate([ends, middle, n + 1 - ends]))
    below, above = (np.asarray(ndtri(betaincinv(at, n + 1 - at, p))) for p in (0.025, 0.975))
    axes.fill_between(x[at - 1], below, above, color=PALE, lw=0, label="95 %, independent values")
    reach = float(max(np.abs(x[-1]), 1.0)) * 1.05
    axes.plot([-reach, reach], [-reach, reach], color=BLACK, lw=1.0, label="standard normal")
    draw_critical_lines(axes.axhline, rel)
    bad = np.abs(w) > crit
    for mask, colour, label, marker in ((~bad, BLUE, "w", "o"), (bad, VERMILLION, "suspects", "D")):
        if mask.any():
            axes.plot(
                x[mask],
                w[mask],
                marker,
                color=colour,
                ms=3.5 if n < 2000 else 2.0,
                mew=0,
                label=f"{label} ({int(mask.sum())})",
                rasterized=n > MAX_VECTOR_MARKERS,
            )
    largest = float(np.max(np.abs(w)))
    if largest > 4 * max(crit, reach):
        # A linear scale would let gross errors flatten all other values to a line.
        axes.set_yscale("symlog", linthresh=2 * crit, linscale=2.0)
        low, high = axes.get_ylim()
        axes.set_ylim(2 * min(low, 0.0), 2 * max(high, 0.0))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}".replace("-", "−")))
        axes.set_ylabel(f"w (logarithmic beyond ±{2 * crit:.1f})")
    else:
        axes.set_ylabel(TEST_VALUE_LABEL)
        low, high = axes.get_ylim()
        # Room for names above and below.
        axes.set_ylim(low - 0.1 * (high - low), high + 0.1 * (high - low))
    axes.set_xlabel("quantile of the standard normal distribution")
    axes.set_xlim(-1.25 * reach, 1.25 * reach)
    write_headline(axes, name, "test values w of Baarda in order")
    missing = len(rel.w) - n
    lines = [f"{n} controlled observations", f"{missing} not controlled: no w"]
    suspects = np.argsort(-np.abs(w), kind="stable")[: min(most, int(bad.sum()))]
    if len(suspects) < bad.sum():
        lines.append(f"the {len(suspects)} largest of {int(bad.sum())} suspects are named")
    if aside is not None:
        lines.append(f"{aside.count} rejected: not shown")
    legend_at_right(figure, axes, lines)
    names = [_name(row) for row in report_rows(rel).at(rows[suspects].tolist())]
    _name_tails(figure, axes, np.stack([x, w], 1)[suspects], names)
    return figure


@in_package_style
def plot_redundancy(rel: Reliability) -> Figure:
    """Draw the distribution of the redundancy numbers of each kind of observation.

    Components (x and y of images, which geometry controls differently) and cameras are separate.
    A thick bar contains the middle half of the values, a thin line 90 %, a stroke is the median;
    groups of up to 400 values show every value, larger groups the smallest and the largest.

    Args:
        rel: reliability of an adjustment.

    Returns:
        A figure; without observations, it shows a message.

    Raises:
        InputError: matplotlib is not installed.
    """
    name = rel.solution.network.name or "network"
    groups = _groups(rel) if len(rel.redundancy_numbers) else []
    if not groups:
        return empty_figure(name, "There are no observations.")
    figure = new_figure(9.0, 1.4 + 0.36 * len(groups))
    axes = figure.add_subplot()
    for place, (_, rows) in enumerate(groups):
        _strip(axes, place, rel.redundancy_numbers[rows])
        r = rel.redundancy_numbers[rows]
        lost = int(np.sum(~rel.controlled[rows]))
        text = f"{len(r)}, mean {np.mean(r):.2f}, min {np.min(r) + 0.0:.2f}"
        axes.text(
            1.02, place, text + (f"; {lost} uncontrolled" if lost else ""),
            transform=axes.get_yaxis_transform(), va="center", fontsize=8.0,
        )  # fmt: skip
    total = rel.redundancy_numbers
    axes.axvline(float(total.mean()), color=BLACK, lw=0.8, ls=":", zorder=0)
    low, high = min(0.0, float(total.min())), max(1.0, float(total.max()))
    axes.set_xlim(low - 0.02, high + 0.02)
    axes.set_ylim(len(groups) - 0.5, -0.5)
    axes.set_yticks(range(len(groups)), [label for label, _ in groups])
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("redundancy number r: the part of an error that shows in its own residual")
    whole = total.sum() + rel.redundancy_of_extra_factors
    write_headline(axes, name, f"Σr = {whole:.2f}, mean {total.mean():.2f} (dotted)")
    return figure


def _name(row: Row) -> str:
    """Return kind, points and component of an observation; its id first, if it has its own."""
    name = f"{row.kind_name} {row.what}"
    return f"{row.own_id}: {name}" if row.own_id else name


def _groups(rel: Reliability) -> list[tuple[str, Index]]:
    """Return the groups: kind (and camera) with component, and the rows."""
    component = np.array(
        [
            b.component(i, c)
            for b in rel.solution.equations.blocks
            for i in range(b.n)
            for c in range(b.dimension)
        ],
        dtype=object,
    )
    out = []
    for group in report_rows(rel).groups():
        for name in dict.fromkeys(component[group.rows].tolist()):
            own = group.rows[component[group.rows] == name]
            out.append((f"{group.label} {name}".strip(), own))
    return out


def _strip(axes: Axes, place: int, r: Array) -> None:
    """Draw the distribution of one group."""
    low, first, median, third, high = np.quantile(r, (0.05, 0.25, 0.5, 0.75, 0.95))
    axes.hlines(place, low, high, color=GREY, lw=1.0, zorder=1)
    axes.hlines(place, first, third, color=SKY, lw=9.0, zorder=1)
    if len(r) <= MAX_VALUES_SHOWN_EACH:
        # Multiples of the golden ratio give evenly spread and reproducible offsets.
        offset = 0.5 * (np.arange(len(r)) * 0.6180339887 % 1.0 - 0.5)
    else:
        r, offset = np.array([r.min(), r.max()]), np.zeros(2)
    axes.plot(r, place + offset, "o", color=BLUE, ms=2.0, mew=0, alpha=0.7, zorder=2)
    axes.plot([median], [place], "|", color=BLACK, ms=11.0, mew=1.6, zorder=3)


def _name_tails(figure: Figure, axes: Axes, at: Array, names: list[str]) -> None:
    """Write names beside points of both tails, one above the other, with thin leader lines."""
    figure.draw_without_rendering()
    step = 11.0 * figure.dpi / 72.0
    pixels = axes.transData.transform(at)
    # The curve rises, so there is room above points of the upper and below those of the lower tail.
    for upper, sign, end in ((True, 1.0, axes.bbox.y1), (False, -1.0, axes.bbox.y0)):
        tail = np.flatnonzero((at[:, 1] > 0) == upper)
        tail = tail[np.argsort(sign * pixels[tail, 1])]
        if not len(tail):
            continue
        # All names of a tail begin, or end, beside its innermost point.
        room = 22.0 * figure.dpi / 72.0
        column = pixels[tail, 0].min() - room if upper else pixels[tail, 0].max() + room
        y = sign * spread_places(sign * pixels[tail, 1] + step / 2, step, sign * end - step / 2)
        for i, height in zip(tail.tolist(), y.tolist(), strict=True):
            points = (np.array([column, height]) - pixels[i]) * 72.0 / figure.dpi
            line = {"arrowstyle": "-", "lw": 0.5, "color": GREY, "shrinkA": 0}
            axes.annotate(
                shortened(names[i], 36),
                at[i],
                (float(points[0]), float(points[1])),
                textcoords="offset points",
                ha="right" if upper else "left",
                va="center",
                fontsize=7.5,
                arrowprops=line | {"relpos": (1.0 if upper else 0.0, 0.5)},
                gid="name of a suspect",
            )


def spread_places(wanted: Array, step: float, highest: float) -> Array:
    """Return increasing places (n,), at least ``step`` apart, at or above the wanted places.

    ``wanted`` increases. If the last place would exceed ``highest``, all places move down.
    """
    out = wanted.astype(float).copy()
    for i in range(1, len(out)):
        out[i] = max(out[i], out[i - 1] + step)
    return np.asarray(out - max(0.0, float(np.max(out, initial=-np.inf)) - highest))

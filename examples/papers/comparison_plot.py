"""Comparison of published and computed tables, as bars."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from factorgraph_adj.report.plots.style import (
    BLUE,
    PALE,
    in_package_style,
    legend_at_right,
    new_figure,
    write_headline,
)

from .comparison import Comparison

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@in_package_style
def plot_comparison(comparisons: Sequence[Comparison]) -> Figure:
    """Draw the figures of tables as bars: published ones pale, computed ones blue.

    Args:
        comparisons: the tables; each has a row of plots, one for each of its columns.

    Raises:
        InputError: matplotlib is not installed.
    """
    most = max(len(c.columns) for c in comparisons)
    heights = [0.9 + 0.3 * len(c.rows) for c in comparisons]
    figure = new_figure(2.2 + 1.9 * most, sum(heights) + 0.4)
    parts = figure.subfigures(len(comparisons), 1, height_ratios=heights, squeeze=False)[:, 0]
    for part, table in zip(parts, comparisons, strict=True):
        every = part.subplots(1, len(table.columns), sharey=True, squeeze=False)[0]
        part.suptitle(table.title)
        place = np.arange(len(table.rows))
        for i, (axes, column) in enumerate(zip(every, table.columns, strict=True)):
            printed = [row.printed[i] for row in table.rows]
            ours = [row.ours[i] for row in table.rows]
            if table.has_printed:
                axes.barh(place - 0.2, printed, 0.38, color=PALE, label="printed")
            axes.barh(place + 0.2 * table.has_printed, ours, 0.38, color=BLUE, label="ours")
            axes.set_yticks(place, [row.label for row in table.rows])
            write_headline(axes, column)
        every[0].invert_yaxis()
    with_printed = next((c for c in comparisons if c.has_printed), comparisons[0])
    first = parts[list(comparisons).index(with_printed)].axes[0]
    legend_at_right(figure, first, [])
    return figure

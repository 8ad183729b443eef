"""A network of heights without plan coordinates: heights over a schematic order of its points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from ...quality.reliability import Reliability
from ...solve.solution import Solution
from ...types import Index
from ..set_aside import SetAside
from .aside import draw_places
from .marks import draw_points, status_of
from .names import Named, legend_with_names
from .precision import Precision
from .sights import draw_lines, lines_by_kinds
from .style import (
    VERMILLION,
    doubts_of,
    exaggeration,
    headline,
    length,
    new_figure,
    readable,
    scale_key,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_heights(
    solution: Solution,
    precision: Precision | None,
    labels: bool,
    aside: SetAside | None,
    reliability: Reliability | None,
) -> Figure:
    """Draw heights with their intervals, and a line for each observed difference."""
    from matplotlib.collections import LineCollection

    unknowns, name = solution.equations.unknowns, solution.network.name or "network"
    n = len(unknowns["point"].names)
    at = np.stack([place_in_order(solution).astype(float), solution.state["point"][:, 2]], 1)
    figure = new_figure(10.0, 5.0)
    axes = figure.add_subplot()
    extent = float(np.ptp(at[:, 1])) or 1.0
    axes.set_xlim(-0.6, max(n - 0.4, 0.6))
    axes.set_ylim(float(at[:, 1].min()) - 0.12 * extent, float(at[:, 1].max()) + 0.12 * extent)
    legend = draw_lines(axes, at, solution)
    legend += draw_places(axes, solution, {"point": at}, aside, reliability)
    status = status_of(solution)
    legend += draw_points(axes, at, status)
    points = unknowns["point"].names
    size = np.zeros(n) if precision is None else precision.height
    if precision is None:
        headline(axes, name, "no precision: singular where the iteration stopped")
    elif not size.any():
        headline(axes, name, "every height is held")
    else:
        typical = float(np.median(size[size > 0]))
        factor = precision.factor or readable(0.06 * extent / typical)
        ends = np.repeat(at[:, None], 2, axis=1)
        ends[:, :, 1] += factor * size[:, None] * [-1.0, 1.0]
        bars = LineCollection(
            list(ends[size > 0]),
            colors=VERMILLION,
            linewidths=3.0,
            linestyles=precision.look[0],
            alpha=0.6,
            zorder=3.5,
            label=f"interval of a height (±){precision.look[1]}",
        )
        axes.add_collection(bars)
        legend.append(bars)
        key = readable(2 * typical)
        label = f"{length(key)}, {exaggeration(factor)}"
        scale_key(axes, factor * key, label, upright=True)
        headline(axes, name, precision.title)
    axes.set_xticks([])
    axes.set_xlabel("no plan coordinates: schematic order of the points along the lines")
    axes.set_ylabel("height Z [m]")
    axes.ticklabel_format(axis="y", useOffset=False, style="plain")
    named = Named(points, at, status.important) if labels else None
    legend_with_names(figure, axes, legend, named, doubts_of(solution, reliability))
    return figure


def place_in_order(solution: Solution) -> Index:
    """Return places 0 … n − 1 of the points; points joined by observations get near places."""
    n = len(solution.equations.unknowns["point"].names)
    pairs = [ends for _, ends in lines_by_kinds(solution)]
    ends = np.concatenate([np.zeros((0, 2), dtype=np.intp), *pairs])
    both = np.concatenate([ends, ends[:, ::-1]])
    graph = coo_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(n, n)).tocsr()
    place = np.empty(n, dtype=np.intp)
    place[reverse_cuthill_mckee(graph, symmetric_mode=True)] = np.arange(n)
    return place

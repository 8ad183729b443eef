"""Figure of an adjusted network: plan, or heights in a schematic order of points; axis scales.

Heights without plan coordinates are drawn over a schematic order of the points along the lines.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from ...errors import InputError, taking
from ...frames import GeocentricFrame
from ...quality.reliability import Reliability
from ...solve.solution import Solution
from ...statistical_tests import CONFIDENCE_OF_REGION
from ...types import Array, Index
from ..rejected_observations import RejectedObservations
from .drawing_plane import (
    PLAN_VIEWS,
    DrawingPlane,
    FramePlaces,
    ShapeOutline,
    View,
    draw_outlines,
    drawing_plane_of,
    places_of_window,
    places_with_precision,
    shape_outlines,
)
from .error_ellipses import (
    ConfidenceRegions,
    OtherPlaces,
    confidence_regions,
    draw_confidence_regions,
)
from .image_residuals import image_rows, image_tests
from .observation_lines import (
    draw_observation_lines,
    draw_photos,
    draw_rejected_and_suspects,
    lines_by_kinds,
    photo_outlines,
)
from .point_symbols import (
    PlanNames,
    draw_instruments,
    draw_points,
    legend_with_names,
    plan_window,
    point_status,
)
from .style import (
    BLUE,
    GREEN,
    VERMILLION,
    checked_positive,
    doubts_of_result,
    draw_scale_key,
    empty_figure,
    exaggeration_text,
    in_package_style,
    length_text,
    new_figure,
    readable_number,
    write_headline,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COINCIDENT_EXTENT_M = 1e-6
"""Largest extent, metres, at which points count as coincident; the plan then shows 2 m."""


def draw_heights(
    solution: Solution,
    precision: ConfidenceRegions | None,
    labels: bool,
    aside: RejectedObservations | None,
    reliability: Reliability | None,
) -> Figure:
    """Draw heights with their intervals, and a line for each observed difference."""
    from matplotlib.collections import LineCollection

    unknowns, name = solution.equations.unknowns, solution.network.name or "network"
    n = len(unknowns["point"].names)
    at = np.stack([order_along_lines(solution).astype(float), solution.state["point"][:, 2]], 1)
    figure = new_figure(10.0, 5.0)
    axes = figure.add_subplot()
    extent = float(np.ptp(at[:, 1])) or 1.0
    axes.set_xlim(-0.6, max(n - 0.4, 0.6))
    axes.set_ylim(float(at[:, 1].min()) - 0.12 * extent, float(at[:, 1].max()) + 0.12 * extent)
    legend = draw_observation_lines(axes, at, solution)
    legend += draw_rejected_and_suspects(axes, solution, {"point": at}, aside, reliability)
    status = point_status(solution)
    legend += draw_points(axes, at, status)
    points = unknowns["point"].names
    size = np.zeros(n) if precision is None else precision.height
    if precision is None:
        write_headline(axes, name, "no covariances")
    elif not size.any():
        write_headline(axes, name, "every height is held")
    else:
        typical = float(np.median(size[size > 0]))
        factor = precision.factor or readable_number(0.06 * extent / typical)
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
        key = readable_number(2 * typical)
        label = f"{length_text(key)}, {exaggeration_text(factor)}"
        draw_scale_key(axes, factor * key, label, upright=True)
        write_headline(axes, name, precision.title)
    axes.set_xticks([])
    axes.set_xlabel("no plan coordinates: schematic order of the points along the lines")
    axes.set_ylabel("height Z [m]")
    axes.ticklabel_format(axis="y", useOffset=False, style="plain")
    named = PlanNames(points, at, status.important) if labels else None
    legend_with_names(figure, axes, legend, named, doubts_of_result(solution, reliability))
    return figure


def order_along_lines(solution: Solution) -> Index:
    """Return places 0 … n − 1 of the points; points joined by observations get near places."""
    n = len(solution.equations.unknowns["point"].names)
    pairs = [ends for _, ends in lines_by_kinds(solution)]
    ends = np.concatenate([np.zeros((0, 2), dtype=np.intp), *pairs])
    both = np.concatenate([ends, ends[:, ::-1]])
    graph = coo_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(n, n)).tocsr()
    place = np.empty(n, dtype=np.intp)
    place[reverse_cuthill_mckee(graph, symmetric_mode=True)] = np.arange(n)
    return place


@taking(Solution)
@in_package_style
def plot_network(
    solution: Solution,
    *,
    view: View = "above",
    confidence: float = CONFIDENCE_OF_REGION,
    factor: float | None = None,
    labels: bool = True,
    heights: bool | None = None,
    reliability: Reliability | None = None,
    aside: RejectedObservations | None = None,
) -> Figure:
    """Draw the plan of a network: points, observed lines, photos, instruments, shapes, ellipses.

    Scanners and trackers in frames of their own stand at the estimated zero of the frame, with
    their sights and their ellipse. Shapes and wires are drawn as their estimates have them: a plane
    as the hull of its points, a line, a cylinder or a cone as long as its points reach, circles and
    spheres by their outlines.

    East is right and north is up in local frames with any axes and in topocentric frames;
    geocentric networks are drawn in the horizon of their centre. A network of heights without
    plan coordinates is drawn as heights over a schematic order of its points.

    Ellipses have semi-axes k √λ, λ the eigenvalues of the 2 × 2 covariance in the plan and
    k² = χ²(confidence; 2), or 2 F(confidence; 2, r) in an a-posteriori solution. One factor, 1, 2
    or 5 times a power of ten, exaggerates all ellipses; the scale key states it. Ellipses of a
    free network refer to its inner constraints. Ellipses of a doubtful result (not converged, or
    the global test failed, or test values above the critical value) are dashed.

    Args:
        solution: the result of `adjust`.
        view: from above (the plan), or from the south or the east with heights upwards.
        confidence: probability of the ellipses, and of the intervals of heights.
        factor: exaggeration of the ellipses; by default an ellipse of medium size is well visible.
        labels: write names of points and photos where there is room; in networks of more than
            1000 points only those of photos, of held, known and check points and of stations. The
            legend states how many names were left out.
        heights: draw confidence intervals of heights as bars; by default only if the plan is
            held. In views from a side, the ellipses show the precision of heights.
        reliability: reliability of the same solution; with it, observations with |w| above the
            critical value are marked.
        aside: observations that were rejected, see `set_aside`; dotted lines with a cross mark
            them.

    Returns:
        A figure; ``figure.savefig("network.png")`` writes it.

    Raises:
        InputError: the view is unknown, the confidence is outside (0, 1), the factor is ≤ 0, or
            matplotlib is not installed, or the reliability is of another solution.
    """
    image_tests(solution, reliability)
    if view not in PLAN_VIEWS:
        raise InputError(f"unknown view {view!r}; valid: {', '.join(PLAN_VIEWS)}")
    if not 0 < confidence < 1:
        raise InputError(f"confidence must lie between 0 and 1, not {confidence}")
    if factor is not None:
        checked_positive(factor, "factor")
    xyz = np.nan_to_num(solution.state["point"])
    everything = np.concatenate([xyz, solution.state["pose"][:, 9:]])
    if not len(everything):
        return empty_figure(
            solution.network.name or "network", "The network has no points or photos."
        )
    plan = drawing_plane_of(solution.network.frame, xyz if len(xyz) else everything).seen_from(view)
    free = solution.equations.unknowns["point"].free
    no_plan = not isinstance(solution.network.frame, GeocentricFrame) and not free[:, :2].any()
    schematic = no_plan and not solution.network.photos and not np.ptp(xyz[:, :2], axis=0).any()
    bars = no_plan if heights is None or schematic else heights
    bars = bars and (view == "above" or schematic)
    doubts = doubts_of_result(solution, reliability)
    if schematic:
        precision = confidence_regions(solution, plan, confidence, factor, bars, bool(doubts))
        return draw_heights(solution, precision, labels, aside, reliability)
    found = frame_contents(solution, plan)
    others = found.others(plan)
    precision = confidence_regions(solution, plan, confidence, factor, bars, bool(doubts), others)
    return _plan_view(solution, plan, found, precision, labels, aside, reliability)


@dataclass(frozen=True, eq=False)
class _FrameContents:
    """What a plan shows of frames."""

    frames: FramePlaces
    """The frames."""
    instruments: Array
    """Places of the instruments that stand over no point, (f, 2)."""
    shapes: list[ShapeOutline]
    """Shapes and wires."""

    def others(self, plan: DrawingPlane) -> list[OtherPlaces]:
        """Return the places with their covariances."""
        out = [
            OtherPlaces(at, sigma, BLUE, label)
            for label, at, sigma in places_with_precision(self.frames, plan, self.shapes)
        ]
        found = self.frames.instrument_covariances
        if found is not None:
            own = plan.covariance(found)
            out.append(
                OtherPlaces(self.instruments, own, GREEN, "an instrument in a frame of its own")
            )
        return out


def frame_contents(solution: Solution, plan: DrawingPlane) -> _FrameContents:
    """Return the instruments in frames and the shapes of a solution in a plan."""
    frames, zero = FramePlaces(solution), np.zeros((1, 3))
    places = [frames.places(f, zero)[0] for f in frames.instruments.tolist()]
    at = plan.coordinates(np.array(places).reshape(-1, 3))[:, :2]
    return _FrameContents(frames, at, shape_outlines(solution, frames, plan))


def _plan_view(
    solution: Solution,
    plan: DrawingPlane,
    found: _FrameContents,
    precision: ConfidenceRegions | None,
    labels: bool,
    aside: RejectedObservations | None,
    reliability: Reliability | None,
) -> Figure:
    unknowns, name = solution.equations.unknowns, solution.network.name or "network"
    at = plan.coordinates(np.nan_to_num(solution.state["point"]))[:, :2]
    centres = plan.coordinates(solution.state["pose"][:, 9:])[:, :2]
    both = np.concatenate([at, found.instruments])
    low, high, outside = plan_window(np.concatenate([both, centres]))
    reach = places_of_window(np.stack([low, high]), found.shapes)
    low, high = reach.min(axis=0), reach.max(axis=0)
    extent = float(np.max(high - low))
    if extent < COINCIDENT_EXTENT_M:
        low, high, extent = low - 1.0, high + 1.0, 2.0
    # Long and narrow networks get a margin for names, title and key.
    half = np.maximum(high - low, np.array([0.65, 0.3]) * extent) / 2
    low, high = (low + high) / 2 - half, (low + high) / 2 + half
    width, height = half
    across = float(min(8.0, 7.5 * max(width / height, 0.55)))
    figure = new_figure(across + 3.0, float(np.clip(across * height / width + 1.0, 4.0, 9.0)))
    axes = figure.add_subplot()
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(float(low[0]), float(high[0]))
    axes.set_ylim(float(low[1]), float(high[1]))
    notes = [plan.note] if plan.note else []
    legend = draw_observation_lines(axes, both, solution, found.frames.instruments)
    legend += draw_outlines(axes, found.shapes)
    if len(centres):
        size = 0.07 * extent / max(1.0, np.sqrt(len(centres) / 30))
        shapes = photo_outlines(solution, image_rows(solution), size)
        flat = plan.coordinates(shapes.reshape(-1, 3))[:, :2].reshape(len(centres), -1, 2)
        legend += draw_photos(axes, centres, flat)
    standing = np.full((len(solution.state["frame"]), 2), np.nan)
    standing[found.frames.instruments] = found.instruments
    places = {"point": at, "pose": centres, "frame": standing}
    legend += draw_rejected_and_suspects(axes, solution, places, aside, reliability)
    status = point_status(solution)
    legend += draw_points(axes, at, status)
    legend += draw_instruments(axes, found.instruments)
    if precision is None:
        write_headline(axes, name)
        notes.append(f"no ellipses: {solution.run.solver.no_inverse}")
    else:
        shown = draw_confidence_regions(axes, precision, at, centres, (low, high))
        write_headline(axes, name, shown.title, width=across - 2.2)
        legend += shown.legend
        notes += shown.notes
    if outside:
        notes.append(f"{outside} points or photos lie outside, far away from all others")
    draw_axis_scales(axes, plan, extent)
    if notes:
        figure.supxlabel("\n".join(notes), fontsize=8.0, x=0.01, ha="left")
    points, photos = unknowns["point"].names, unknowns["pose"].names
    frames = [unknowns["frame"].names[f] for f in found.frames.instruments.tolist()]
    own = (photos, centres, frames, found.instruments)
    named = PlanNames(points, at, status.important, *own) if labels else None
    legend_with_names(figure, axes, legend, named, doubts_of_result(solution, reliability))
    return figure


def draw_axis_scales(axes: Axes, plan: DrawingPlane, extent: float) -> None:
    """Write coordinates with all digits, in kilometres if the network is large."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    unit, size = ("km", 1e3) if extent > 20e3 else ("m", 1.0)
    for axis, name in ((axes.xaxis, plan.names[0]), (axes.yaxis, plan.names[1])):
        axis.set_major_locator(MaxNLocator(6))
        axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v / size:.10g}".replace("-", "−")))
        axis.set_label_text(f"{name} [{unit}]")

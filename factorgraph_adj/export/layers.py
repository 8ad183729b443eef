"""A solution as layers of a map: shapes in map coordinates, with what is known of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from ..epochs.comparison import Congruence
from ..errors import InputError
from ..report.context import Report
from ..report.epochs.context import EpochsReport
from ..report.options import Provenance, ReportOptions
from ..report.plots.precision import visible_factor
from ..report.plots.style import readable
from ..solve.solution import Solution
from ..types import Array
from ..version import __version__
from .epochs import epochs_layers
from .footprints import footprints
from .layer import Drawn, Geometry, Layer
from .observation_layers import Shapes, observation_shapes, shift_shapes
from .placing import Placing
from .points import ellipse_shapes, photo_columns, point_columns


@dataclass(frozen=True, eq=False)
class Map:
    """Layers of a solution and what they mean."""

    name: str
    """Name of the network."""
    layers: tuple[Layer, ...]
    """The layers that are not empty, the lowest one of a picture first."""
    placing: Placing
    """What the coordinates are."""
    facts: Mapping[str, str | float | bool] = field(default_factory=dict)
    """Figures of the adjustment, and what is exaggerated."""


Result: TypeAlias = Solution | Report | Congruence | EpochsReport
"""What is exported: an adjustment, or a comparison of two epochs."""


def report_of(result: Result) -> Report | EpochsReport:
    """Return a result as a report; that of the command has its data snooping and its run."""
    if isinstance(result, Report | EpochsReport):
        return result
    if isinstance(result, Congruence):
        return EpochsReport(result)
    return Report(result, ReportOptions(), Provenance())


def adjusted_of(result: Result, format: str) -> Report:
    """Return an adjustment as a report.

    Raises:
        InputError: the result is a comparison of two epochs, which the format cannot express.
    """
    report = report_of(result)
    if isinstance(report, EpochsReport):
        raise InputError(
            f"{format} has adjusted points, and no displacements of two epochs; write one of their "
            "solutions, or the comparison as .gpkg, .geojson, .kml, .dxf or .json"
        )
    return report


def map_of(result: Result, placing: Placing, drawn: Drawn) -> Map:
    """Return the layers of a result.

    Raises:
        InputError: a place has no map coordinates, or the confidence is outside (0, 1).
    """
    report = report_of(result)
    if isinstance(report, EpochsReport):
        found = epochs_layers(report, drawn)
        layers = [
            Layer(x.name, x.title, x.geometry, placed(placing, x.shapes), x.columns, x.looks)
            for x in found.layers
        ]
        told = {**found.facts, **_where(placing, report.places)}
        return Map(found.name, tuple(x for x in layers if len(x)), placing, told)
    network, xyz = report.network, report.solution.state["point"]
    facts: dict[str, str | float | bool] = {
        "program": f"factorgraph_adj {__version__}",
        "network": network.name,
        "converged": report.solution.converged,
        "observations": float(report.solution.n_observations),
        "redundancy": float(report.solution.redundancy),
        "sigma0": report.solution.sigma0,
        **_where(placing, xyz),
    }
    layers = [*_ellipses(report, placing, drawn, facts), *_footprints(report, placing)]
    layers += _observations(report, placing)
    layers += _vectors(report, placing, drawn, facts)
    if network.photos:
        centres = placing.of(report.solution.state["pose"][:, 9:12])
        columns = photo_columns(report)
        title = "projection centres with angles and standard deviations"
        layers.append(Layer("photos", title, "POINT", _each(centres[:, None]), columns))
    at = placing.of(xyz)
    title = "adjusted points; x, y, z in the frame of the network, metres"
    layers.append(Layer("points", title, "POINT", _each(at[:, None]), point_columns(report)))
    return Map(network.name, tuple(x for x in layers if len(x)), placing, facts)


def _where(placing: Placing, xyz: Array) -> dict[str, str | float | bool]:
    """Return what the coordinates of places (n, 3) are."""
    facts: dict[str, str | float | bool] = {
        "coordinates": placing.words,
        "reference_system": placing.name,
        "heights_above": placing.heights,
    }
    way, accuracy = placing.way(xyz)
    if way:
        facts |= {"operation_to_wgs84": way, "accuracy_of_operation_m": accuracy}
    return facts


# -- layers ---------------------------------------------------------------------------------------


def _ellipses(
    report: Report, placing: Placing, drawn: Drawn, facts: dict[str, str | float | bool]
) -> list[Layer]:
    if report.singular:
        return []
    found = ellipse_shapes(report.solution, drawn.confidence)
    if not len(found.names):
        return []
    factor = float(drawn.exaggeration or 0) or _visible(
        found.semi_axes[:, 0], report, found.centres
    )
    level = "standard" if drawn.confidence is None else f"{100 * drawn.confidence:.10g} %"
    facts |= {"confidence_of_ellipses": drawn.confidence or "standard ellipses"}
    facts |= {"exaggeration_of_ellipses": factor}
    shapes = placed(placing, found.rings(factor))
    columns = {**found.columns(), "exaggeration": [factor] * len(found.names)}
    title = f"error ellipses, {level}, drawn {factor:.10g} times their size"
    return [Layer("ellipses", title, "POLYGON", shapes, columns)]


def _footprints(report: Report, placing: Placing) -> list[Layer]:
    found = footprints(report.solution)
    columns = {"name": found.names, "camera": found.cameras}
    title = "photos on the level plane at the median height of the points that they see"
    rings = placed(placing, found.rings)
    return [Layer("footprints", title, "POLYGON", rings, columns)]


def _observations(report: Report, placing: Placing) -> list[Layer]:
    titles: dict[str, str] = {
        "image_points": "image points as rays from the photo to the point",
        "observations": "observations between points, the largest test values last",
        "observations_at_points": "observations of one place, and given values of unknowns",
    }
    layers = []
    for name, found in observation_shapes(report).items():
        geometry: Geometry = "POINT" if name == "observations_at_points" else "LINESTRING"
        shapes = placed(placing, found.shapes)
        layers.append(Layer(name, titles[name], geometry, shapes, found.columns))
    return layers


def _vectors(
    report: Report, placing: Placing, drawn: Drawn, facts: dict[str, str | float | bool]
) -> list[Layer]:
    found: Shapes = shift_shapes(report.solution)
    if not found.shapes:
        return []
    ends = np.array(found.shapes)
    sizes = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    factor = float(drawn.vector_exaggeration or 0) or _visible(sizes, report, ends[:, 0])
    facts |= {"exaggeration_of_vectors": factor}
    ends[:, 1] = ends[:, 0] + factor * (ends[:, 1] - ends[:, 0])
    columns = {**found.columns, "exaggeration": [factor] * len(ends)}
    title = f"adjusted − given coordinates, drawn {factor:.10g} times their size"
    return [Layer("vectors", title, "LINESTRING", placed(placing, list(ends)), columns)]


# -- helpers --------------------------------------------------------------------------------------


def _visible(sizes: Array, report: Report, places: Array) -> float:
    """Return a readable factor that makes shapes of a median size visible among the points."""
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    xyz = report.solution.state["point"]
    frame = report.network.frame
    enu = frame.basis(xyz.mean(axis=0)[None], np.zeros((1, 2))).enu[0]
    plan, at = ((x - xyz.mean(axis=0)) @ enu[:2].T for x in (xyz, places))
    limits = plan.min(axis=0), plan.max(axis=0)
    extent = float(np.max(limits[1] - limits[0]))
    if not len(sizes) or not extent > 0:
        return 1.0
    typical = float(np.median(sizes))
    if len(at) < 2:
        return readable(0.05 * extent / typical)
    return visible_factor(typical, at, limits)


def placed(placing: Placing, shapes: Sequence[Array | None]) -> list[Array | None]:
    """Return shapes in map coordinates; None where a place is not known."""
    there = [np.zeros((0, 3)) if s is None else s for s in shapes]
    sizes = {len(s) for s in there}
    every = placing.of(np.concatenate([np.zeros((0, 3)), *there]))
    if len(sizes) == 1 and (size := sizes.pop()):
        return _each(every.reshape(-1, size, 3))
    ends = np.cumsum([len(s) for s in there])
    return _each(np.split(every, ends[:-1])) if len(there) else []


def _each(shapes: Sequence[Array] | Array) -> list[Array | None]:
    if isinstance(shapes, np.ndarray):
        known = np.asarray(np.isfinite(shapes).all(axis=(1, 2)))
        return [s if k else None for s, k in zip(shapes, known, strict=True)]
    return [s if len(s) and np.isfinite(s).all() else None for s in shapes]

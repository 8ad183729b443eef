"""Map layers of an adjustment or two epochs: shapes in map coordinates, columns, exaggeration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Any, Literal, TypeAlias

import numpy as np

from ..epochs.comparison_result import Congruence
from ..errors import InputError
from ..report.adjustment_report import Report
from ..report.epochs_report import EpochsReport
from ..report.options import Provenance, ReportOptions
from ..report.plots.displacements import EpochsDrawing
from ..report.plots.error_ellipses import visible_factor
from ..report.plots.style import readable_number
from ..solve.solution import Solution
from ..statistical_tests import CONFIDENCE_OF_REGION
from ..types import Array
from ..units import MILLIMETRE
from ..version import __version__
from .map_coordinates import MapCoordinates
from .map_shapes import (
    FrameShapes,
    coordinate_differences,
    ellipse_shapes,
    ellipses_with_size,
    footprints,
    observation_shapes,
    photo_data,
    point_data,
)

Geometry: TypeAlias = Literal["POINT", "LINESTRING", "POLYGON"]
"""What the shapes of a layer are."""


@dataclass(frozen=True, eq=False)
class Layer:
    """Shapes of one kind with columns of data."""

    name: str
    """Name of the layer: points, ellipses, observations …"""
    title: str
    """What the layer shows, with units and exaggeration."""
    geometry: Geometry
    """What the shapes are. Rings of polygons are closed and counter-clockwise."""
    shapes: Sequence[Array | None]
    """Map coordinates (m, 3) of each shape, None for what has no place."""
    columns: Mapping[str, Sequence[Any]]
    """Data of each shape: texts, numbers (NaN: unknown) and truth values by name."""
    looks: Sequence[str] = ()
    """How each shape looks where a format has one look for each; empty: all as the layer."""

    def look(self, number: int) -> str:
        """Return how a shape looks: the name of the layer, or of one of its own looks."""
        return self.looks[number] if self.looks else self.name

    def __len__(self) -> int:
        return len(self.shapes)

    def records(self) -> list[dict[str, Any]]:
        """Return the data of each shape by name, None where a number is not known."""
        cells = [plain_column(column) for column in self.columns.values()]
        return [
            dict(zip(self.columns, row, strict=True))
            for row in (zip(*cells, strict=True) if cells else ({} for _ in self.shapes))
        ]


@dataclass(frozen=True)
class MapScaling:
    """What a map draws larger than it is."""

    confidence: float | None = CONFIDENCE_OF_REGION
    """Probability of the error ellipses; None: standard ellipses."""
    exaggeration: float | None = None
    """Factor of the error ellipses; None: 1, 2 or 5 times a power of ten that makes them visible;
    1: true size."""
    vector_exaggeration: float | None = None
    """The same for differences at check points and control points."""

    def __post_init__(self) -> None:
        """Refuse factors that are not positive."""
        for name in ("exaggeration", "vector_exaggeration"):
            value = getattr(self, name)
            if value is not None and not (
                isinstance(value, int | float) and isfinite(value) and value > 0
            ):
                raise InputError(f"{name} must be a number greater than zero, not {value!r}")


def plain_column(values: Sequence[Any]) -> list[Any]:
    """Return values of Python as `plain_value` does; most columns have values of one type."""
    types = set(map(type, values))
    if types == {float}:
        return [v + 0.0 if isfinite(v) else None for v in values]
    if types <= {str, int, bool}:
        return list(values)
    return [plain_value(v) for v in values]


def plain_value(value: Any) -> Any:
    """Return a value of Python: None for a number that is not finite, −0 as 0."""
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float):
        return value + 0.0 if isfinite(value) else None
    return value


@dataclass(frozen=True, eq=False)
class EpochsLayers:
    """Layers whose shapes are in the frame of the first epoch, metres."""

    name: str
    """Names of the epochs."""
    layers: tuple[Layer, ...]
    """The layers, the lowest one of a picture first."""
    facts: Mapping[str, str | float | bool]
    """Figures of the comparison."""


def epochs_layers(report: EpochsReport, drawn: MapScaling) -> EpochsLayers:
    """Return ``displacement_ellipses``, ``displacements`` and ``points`` of two epochs.

    A displacement is a line from the place of the first epoch, with its ellipse at its end; one
    factor exaggerates both.

    Args:
        report: the comparison.
        drawn: probability of the ellipses, and the factor.

    Raises:
        InputError: the confidence is outside (0, 1), or two factors are asked for.
    """
    if drawn.vector_exaggeration is not None:
        raise InputError(
            "displacements and their ellipses are drawn with one factor: state exaggeration alone"
        )
    report = replace(report, confidence=drawn.confidence)
    plan = EpochsDrawing(report, drawn.exaggeration)
    found, factor = report.found, plan.factor
    ends = report.places + factor * report.vectors
    columns = _columns(report)
    looks = [f"displacements_{'moved' if moved else 'kept'}" for moved in columns["moved"]]
    lines = np.stack([report.places, ends], axis=1)
    title = f"displacements between two epochs, drawn {factor:.10g} times their size"
    exaggerated = {**columns, "exaggeration": [factor] * len(lines)}
    vectors = Layer("displacements", title, "LINESTRING", list(lines), exaggerated, looks)
    at = {n: i for i, n in enumerate(report.names)}
    shapes = ellipses_with_size(report.ellipses, report.network.frame)
    own = [at[n] for n in shapes.names]
    shapes = replace(shapes, centres=ends[own])
    level = "standard" if report.confidence is None else f"{100 * report.confidence:.10g} %"
    ellipses = Layer(
        "displacement_ellipses",
        f"ellipses of displacements, {level}, drawn {factor:.10g} times their size",
        "POLYGON",
        shapes.rings(factor),
        {
            **shapes.columns(),
            "moved": [columns["moved"][i] for i in own],
            "exaggeration": [factor] * len(own),
        },
        [looks[i] for i in own],
    )
    title = "compared points at their places of the first epoch, with their displacements"
    points = Layer("points", title, "POINT", list(report.places[:, None]), columns)
    name = " → ".join(s.network.name for s in found.solutions)
    facts: dict[str, str | float | bool] = {
        "program": f"factorgraph_adj {__version__}",
        "epochs": name,
        "doubts": "; ".join(report.doubts),
        "sigma0_of_tests": float(np.sqrt(found.scale.variance)),
        "alpha": found.alpha,
        "power": found.power,
        "stable": ", ".join(found.stable),
        "moved": ", ".join(found.moved),
        "confidence_of_ellipses": report.confidence or "standard ellipses",
        "exaggeration": factor,
    }
    return EpochsLayers(name, (ellipses, vectors, points), facts)


def _columns(report: EpochsReport) -> dict[str, Sequence[Any]]:
    every = list(report.found.displacements.values())
    sigmas = np.array([x.sigmas for x in every]).reshape(-1, 3)
    frame = report.network.frame
    enu = frame.basis(report.places, np.zeros((len(every), 2))).enu
    local = np.einsum("nij,nj->ni", enu, report.vectors)
    columns: dict[str, Sequence[Any]] = {"name": report.names, "status": list(report.states)}
    columns |= {a: report.places[:, i].tolist() for i, a in enumerate("xyz")}
    columns |= {
        f"d{a}_mm": (report.vectors[:, i] / MILLIMETRE).tolist() for i, a in enumerate("xyz")
    }
    columns |= {f"sigma_d{a}_mm": (sigmas[:, i] / MILLIMETRE).tolist() for i, a in enumerate("xyz")}
    for i, a in enumerate(("east", "north", "up")):
        columns[f"d_{a}_mm"] = (local[:, i] / MILLIMETRE).tolist()
    return columns | {
        "length_mm": [x.length / MILLIMETRE for x in every],
        "test_value": [x.test.value for x in every],
        "critical": [x.test.critical for x in every],
        "p_value": [x.test.p_value for x in every],
        "moved": [x.moved for x in every],
        "detectable_mm": [x.detectable / MILLIMETRE for x in every],
    }


@dataclass(frozen=True, eq=False)
class SolutionMap:
    """Layers of a solution and what they mean."""

    name: str
    """Name of the network."""
    layers: tuple[Layer, ...]
    """The layers that are not empty, the lowest one of a picture first."""
    placing: MapCoordinates
    """What the coordinates are."""
    facts: Mapping[str, str | float | bool] = field(default_factory=dict)
    """Figures of the adjustment, and what is exaggerated."""


ExportedResult: TypeAlias = Solution | Report | Congruence | EpochsReport
"""What is exported: an adjustment, or a comparison of two epochs."""


def report_of(result: ExportedResult) -> Report | EpochsReport:
    """Return a result as a report; that of the command has its data snooping and its run."""
    if isinstance(result, Report | EpochsReport):
        return result
    if isinstance(result, Congruence):
        return EpochsReport(result)
    return Report(result, ReportOptions(), Provenance())


def adjustment_of(result: ExportedResult, format: str) -> Report:
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


def solution_map(result: ExportedResult, placing: MapCoordinates, drawn: MapScaling) -> SolutionMap:
    """Return the layers of a result.

    Raises:
        InputError: a place has no map coordinates, or the confidence is outside (0, 1).
    """
    report = report_of(result)
    if isinstance(report, EpochsReport):
        found = epochs_layers(report, drawn)
        layers = [
            Layer(x.name, x.title, x.geometry, placed_shapes(placing, x.shapes), x.columns, x.looks)
            for x in found.layers
        ]
        told = {**found.facts, **_where(placing, report.places)}
        return SolutionMap(found.name, tuple(x for x in layers if len(x)), placing, told)
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
        columns = photo_data(report)
        title = "projection centres with angles and standard deviations"
        layers.append(Layer("photos", title, "POINT", _each(centres[:, None]), columns))
    at = placing.of(xyz)
    title = "adjusted points; x, y, z in the frame of the network, metres"
    layers.append(Layer("points", title, "POINT", _each(at[:, None]), point_data(report)))
    return SolutionMap(network.name, tuple(x for x in layers if len(x)), placing, facts)


def _where(placing: MapCoordinates, xyz: Array) -> dict[str, str | float | bool]:
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
    report: Report, placing: MapCoordinates, drawn: MapScaling, facts: dict[str, str | float | bool]
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
    shapes = placed_shapes(placing, found.rings(factor))
    columns = {**found.columns(), "exaggeration": [factor] * len(found.names)}
    title = f"error ellipses, {level}, drawn {factor:.10g} times their size"
    return [Layer("ellipses", title, "POLYGON", shapes, columns)]


def _footprints(report: Report, placing: MapCoordinates) -> list[Layer]:
    found = footprints(report.solution)
    columns = {"name": found.names, "camera": found.cameras}
    title = "photos on the level plane at the median height of the points that they see"
    rings = placed_shapes(placing, found.rings)
    return [Layer("footprints", title, "POLYGON", rings, columns)]


def _observations(report: Report, placing: MapCoordinates) -> list[Layer]:
    titles: dict[str, str] = {
        "image_points": "image points as rays from the photo to the point",
        "observations": "observations between points, the largest test values last",
        "observations_at_points": "observations of one place, and given values of unknowns",
    }
    layers = []
    for name, found in observation_shapes(report).items():
        geometry: Geometry = "POINT" if name == "observations_at_points" else "LINESTRING"
        shapes = placed_shapes(placing, found.shapes)
        layers.append(Layer(name, titles[name], geometry, shapes, found.columns))
    return layers


def _vectors(
    report: Report, placing: MapCoordinates, drawn: MapScaling, facts: dict[str, str | float | bool]
) -> list[Layer]:
    found: FrameShapes = coordinate_differences(report.solution)
    if not found.shapes:
        return []
    ends = np.array(found.shapes)
    sizes = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    factor = float(drawn.vector_exaggeration or 0) or _visible(sizes, report, ends[:, 0])
    facts |= {"exaggeration_of_vectors": factor}
    ends[:, 1] = ends[:, 0] + factor * (ends[:, 1] - ends[:, 0])
    columns = {**found.columns, "exaggeration": [factor] * len(ends)}
    title = f"adjusted − given coordinates, drawn {factor:.10g} times their size"
    return [Layer("vectors", title, "LINESTRING", placed_shapes(placing, list(ends)), columns)]


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
        return readable_number(0.05 * extent / typical)
    return visible_factor(typical, at, limits)


def placed_shapes(placing: MapCoordinates, shapes: Sequence[Array | None]) -> list[Array | None]:
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

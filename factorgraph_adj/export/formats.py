"""Formats of results by suffix, and writing; arrays of xarray, pandas frames, JSON Schema.

A new format needs one function that writes a solution, and one line in `EXPORT_FORMATS`. A
solution can be written in every format of a network as well, with adjusted values for given ones.
results.json has everything that an adjustment found. Labelled arrays require the extra ``xarray``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..columns import require_pandas
from ..epochs.comparison_result import Congruence
from ..errors import InputError, Problem, known, taking
from ..io.file_transaction import write_files
from ..io.format_options import fitting_options, options_of, refuse_unknown_options
from ..io.writers import WRITERS
from ..network.network import Network
from ..quality.reliability import reliability
from ..report.adjustment_report import Report
from ..report.epochs_report import EpochsReport
from ..report.results_json import epochs_results_text, results_text
from ..solve.solution import Solution, cofactors_at
from ..types import Array
from ..version import __version__
from .dxf_ply import refuse_drawing, write_dxf, write_ply
from .geojson_kml import write_geojson, write_kml
from .geopackage import write_geopackage
from .map_coordinates import refuse_unknown_place
from .map_layers import ExportedResult, report_of
from .precision_files import write_precision_map

if TYPE_CHECKING:
    import pandas
    import xarray

XARRAY_MISSING = "labelled arrays need xarray: pip install 'factorgraph_adj[xarray]'"
AXIS_LABELS = ["x", "y", "z"]
POSE_COMPONENTS = ["rx", "ry", "rz", "x", "y", "z"]
"""Components of the covariance of a photo: rotations about the axes of the camera, and X0."""


@taking(Solution)
def to_xarray(solution: Solution) -> xarray.Dataset:
    """Return points, photos and observations with their covariances as a labelled data set.

    ======================  =========================================  ==============
    variable                dimensions                                 unit
    ======================  =========================================  ==============
    ``coordinates``         point, axis                                m
    ``covariance``          point, axis, axis2                         m²
    ``position``            photo, axis                                m
    ``rotation``            photo, axis, camera_axis (world_R_camera)  1
    ``pose_covariance``     photo, component, component2               rad², rad m, m²
    ``observed``            row                                        SI, image units
    ``residual``            row (computed − observed)                  SI, image units
    ``sigma``               row                                        SI, image units
    ======================  =========================================  ==============

    Rows have the coordinates ``id``, ``kind`` and ``observation_component``. The covariances are
    those of each point and each photo; `covariance_array` has those between points.

    Raises:
        InputError: xarray is not installed.
        SingularError: there are no covariances.
    """
    xr = _xarray()
    points, photos = list(solution.network.points), list(solution.network.photos)
    number = solution.equations.unknowns["pose"].number
    stored = solution.state["pose"][[number[n] for n in photos]]
    poses = np.array([solution.pose_covariance(n) for n in photos]).reshape(-1, 6, 6)
    table = solution.observations
    records = list(table)
    rows = {
        "observed": np.array([r.observed for r in records], dtype=float),
        "residual": table.residuals,
        "sigma": table.sigmas,
    }
    data: dict[str, Any] = {
        "coordinates": (("point", "axis"), solution.state["point"].copy(), {"units": "m"}),
        "covariance": (("point", "axis", "axis2"), solution.point_covariances, {"units": "m2"}),
        "position": (("photo", "axis"), stored[:, 9:12].copy(), {"units": "m"}),
        "rotation": (("photo", "axis", "camera_axis"), stored[:, :9].reshape(-1, 3, 3).copy()),
        "pose_covariance": (("photo", "component", "component2"), poses),
        **{name: (("row",), values) for name, values in rows.items()},
    }
    labels: dict[str, Any] = {
        "point": _texts(points),
        "photo": _texts(photos),
        "axis": AXIS_LABELS,
        "axis2": AXIS_LABELS,
        "camera_axis": AXIS_LABELS,
        "component": POSE_COMPONENTS,
        "component2": POSE_COMPONENTS,
        "id": ("row", _texts([r.id for r in records])),
        "kind": ("row", _texts([r.kind for r in records])),
        "observation_component": ("row", _texts([r.component for r in records])),
    }
    attributes = {
        "network": solution.network.name,
        "program": f"factorgraph_adj {__version__}",
        "sigma0": solution.sigma0,
        "redundancy": solution.redundancy,
        "variance": solution.variance,
        "converged": int(solution.converged),
    }
    return xr.Dataset(data, labels, attributes)


def to_pandas(solution: Solution) -> dict[str, pandas.DataFrame]:
    """Return the tables of a solution as data frames, in metres, radians and image units.

    They are `Solution.point_table`, `photo_table`, `unknown_table` and `Reliability.table`. A
    network without photos has a frame without rows. Columns without a unit below are names, marks
    (true or false) and numbers without a unit.

    - ``points``: x, y, z and sigma_x, sigma_y, sigma_z in metres; on the ellipsoid also latitude
      and longitude in radians, height, sigma_east, sigma_north and sigma_up in metres.
    - ``photos``: x, y, z and sigma_x, sigma_y, sigma_z in metres; omega, phi, kappa and the
      components sigma_rx, sigma_ry, sigma_rz of the turn in radians.
    - ``unknowns``: value and sigma in the unit of the component, SI (metres, radians, seconds and
      their ratios); those of a camera in its image unit, or in none.
    - ``observations``: residual, sigma, mdb (∇) and estimated_error in the unit of the observation,
      metres or radians, image unit for image points; largest_effect, on a coordinate, in metres;
      r, w, tau and delta_bar have none.

    Raises:
        InputError: pandas is not installed (extra ``table``).
        AdjustmentError: there are no covariances, or no reliability.
    """
    require_pandas()
    tables = (solution.point_table(), solution.photo_table(), solution.unknown_table())
    return {t.title: t.to_pandas() for t in (*tables, reliability(solution).table())}


@taking(Solution)
def covariance_array(solution: Solution, names: Sequence[str] | None = None) -> xarray.DataArray:
    """Return the joint covariance of points as an array with the names of points and axes.

    Args:
        solution: the result of an adjustment.
        names: n points; None: all of them. The array has 9 n² numbers.

    Returns:
        The covariance with the dimensions point, axis, point2, axis2, m²; zero for held
        components. In a free network it belongs to the inner constraints.

    Raises:
        InputError: xarray is not installed, or a point is unknown (all are listed) or named twice.
    """
    xr = _xarray()
    chosen = list(solution.network.points) if names is None else [str(n) for n in names]
    unknown = [n for n in chosen if n not in solution.network.points]
    if unknown:
        valid = known(solution.network.points, meant=unknown[0])
        raise InputError(f"unknown points {', '.join(map(repr, unknown))}; known: {valid}")
    if len(set(chosen)) < len(chosen):
        twice = sorted({n for n in chosen if chosen.count(n) > 1})
        raise InputError(f"points are named twice: {', '.join(twice)}")
    joint = _joint(solution, chosen).reshape(len(chosen), 3, len(chosen), 3)
    labels = {
        "point": _texts(chosen),
        "axis": AXIS_LABELS,
        "point2": _texts(chosen),
        "axis2": AXIS_LABELS,
    }
    return xr.DataArray(
        joint, labels, ("point", "axis", "point2", "axis2"), "covariance", {"units": "m2"}
    )


def _joint(solution: Solution, names: Sequence[str]) -> Array:
    """Return the covariance of points, (3 n, 3 n) metres²."""
    if solution.reference is not None:
        # A change of the datum acts on blocks.
        return solution.covariance(names)
    table = solution.equations.unknowns["point"]
    number = np.array([table.number[n] for n in names], dtype=np.intp)
    free = (table.free[number] & (table.offset[number] >= 0)[:, None]).ravel()
    columns = (table.offset[number, None] + np.arange(3)).ravel()[free]
    out = np.zeros((3 * len(names), 3 * len(names)))
    out[np.ix_(free, free)] = cofactors_at(solution, columns) * solution.variance_factor
    return out


def _texts(values: Sequence[str]) -> np.ndarray[Any, Any]:
    """Return texts as an array whose type files of xarray can hold."""
    return np.array(values, dtype=str) if len(values) else np.zeros(0, dtype="<U1")


def _xarray() -> Any:
    try:
        import xarray
    except ImportError:
        raise InputError(XARRAY_MISSING) from None
    return xarray


@taking(ExportedResult)
def write_results(result: ExportedResult, path: str | Path) -> None:
    """Write a result as results.json, the file that ``--out`` of the command writes too.

    Numbers have the digits that bring float64 back, in metres, radians and image units; ``null`` is
    a number that is not known. `results_schema` describes every member.

    Args:
        result: the result of `adjust`, or its report with data snooping; or of `congruence`, or its
            report with blocks.
        path: the file, such as ``results.json``.

    Raises:
        InputError: the file cannot be written.
    """
    file, report = Path(path), report_of(result)
    text = epochs_results_text(report) if isinstance(report, EpochsReport) else results_text(report)
    write_files(file.parent, {file.name: text})


def results_schema(of: Literal["adjustment", "epochs"] = "adjustment") -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of results.json; its version is ``format`` of the file.

    Args:
        of: whether the file is that of an adjustment, or of a comparison of two epochs.

    Raises:
        InputError: another word.
    """
    names = {"adjustment": "results.schema.json", "epochs": "epochs.schema.json"}
    if of not in names:
        raise InputError(f"there is no schema of {of!r}; valid: {known(names)}")
    text = (files("factorgraph_adj.report") / names[of]).read_text(encoding="utf-8")
    return dict(json.loads(text))


@dataclass(frozen=True)
class ExportFormat:
    """One format of solutions."""

    name: str
    """Word for the format: ``geopackage``."""
    suffixes: tuple[str, ...]
    """Suffixes of file names, with dots."""
    description: str
    """Name of the format for help and messages."""
    write: Callable[..., object]
    """Function of a solution, or a report, and a path; its keyword-only arguments are options. It
    raises InputError and leaves no file behind where the format cannot express the solution."""

    check: Callable[[Network], object] | None = None
    """Function of the network that raises InputError for what can be known before the adjustment:
    no reference system, or an extra that is missing; None: nothing."""
    epochs: bool = True
    """Whether it can express a comparison of two epochs."""

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the keyword-only arguments of the function."""
        return options_of(self.write)


EXPORT_FORMATS: tuple[ExportFormat, ...] = (
    ExportFormat("results", (".json",), "results for programs", write_results),
    ExportFormat("geopackage", (".gpkg",), "GeoPackage", write_geopackage),
    ExportFormat("geojson", (".geojson",), "GeoJSON", write_geojson, refuse_unknown_place),
    ExportFormat("kml", (".kml",), "KML", write_kml, refuse_unknown_place),
    ExportFormat("dxf", (".dxf",), "DXF drawing", write_dxf, refuse_drawing),
    ExportFormat("ply", (".ply",), "PLY points", write_ply, epochs=False),
    ExportFormat(
        "precision-map",
        (".txt", ".las"),
        "precision map",
        write_precision_map,
        epochs=False,
    ),
)
"""The formats that a solution can be written in."""


@dataclass(frozen=True)
class ExportTarget:
    """A file to write, and the format that it gets."""

    path: Path
    """The file, or folder."""
    name: str
    """Word for the format."""
    description: str
    """Name of the format for messages."""
    options: tuple[str, ...]
    """Names of its options."""
    of_network: bool
    """Whether it is a format of networks, which gets adjusted values for given ones."""
    function: Callable[..., object]
    """The function that writes it."""
    check: Callable[[Network], object] | None = None
    """What forbids it before the adjustment, see `ExportFormat`."""
    epochs: bool = False
    """Whether it can express a comparison of two epochs."""

    def refuse_epochs(self) -> None:
        """Raise that the format cannot express a comparison of two epochs.

        Raises:
            InputError: it cannot.
        """
        if not self.epochs:
            valid = ", ".join(s for e in EXPORT_FORMATS if e.epochs for s in e.suffixes)
            raise InputError(
                Problem(
                    f"{self.description} has no displacements of two epochs; write the solution "
                    f"of an epoch, or the comparison as {valid}",
                    str(self.path),
                )
            )

    def write(self, what: Network | ExportedResult, **options: Any) -> None:
        """Write a result, or a network in a format of networks.

        Raises:
            InputError: the format has no such option, is not one of networks, or cannot express
                what is written (all is listed).
        """
        doing = f"writing {self.description}"
        refuse_unknown_options(options, self.options, doing=doing, where=str(self.path))
        options = fitting_options(self.function, options, doing=doing, where=str(self.path))
        if isinstance(what, Congruence | EpochsReport):
            self.refuse_epochs()
            self.function(what, self.path, **options)
            return
        if not self.of_network:
            if isinstance(what, Network):
                raise InputError(
                    Problem(
                        f"{self.description} has results: adjust the network, and write the "
                        "solution",
                        str(self.path),
                    )
                )
            self.function(what, self.path, **options)
            return
        solution = what.solution if isinstance(what, Report) else what
        network = solution if isinstance(solution, Network) else solution.as_network()
        self.function(network, self.path, **options)


def format_list() -> str:
    """Return the suffixes and names of all formats, those of solutions first."""
    own = ", ".join(f"{', '.join(e.suffixes)} ({e.description})" for e in EXPORT_FORMATS)
    return f"{own}; and adjusted networks as {WRITERS}"


def export_target(path: str | Path, format: str | None = None) -> ExportTarget:
    """Return how a file is written: by the name of its format, or by its suffix.

    Raises:
        InputError: no format has the name, or the suffix.
    """
    file = Path(path)
    for e in EXPORT_FORMATS:
        if format == e.name or (format is None and file.suffix.lower() in e.suffixes):
            return ExportTarget(
                file, e.name, e.description, e.options, False, e.write, e.check, e.epochs
            )
    names = [e.name for e in EXPORT_FORMATS] + [w.name for w in WRITERS.entries]
    if format is not None and format not in names:
        valid = known(names, meant=format, most=80)
        raise InputError(f"no format {format!r} can be written; valid: {valid}")
    try:
        w = WRITERS.of(file, format)
    except InputError:
        what = f"unknown kind of file to write; valid: {format_list()}"
        raise InputError(Problem(what, str(path))) from None
    return ExportTarget(file, w.name, w.description, w.options, True, w.write)


@taking(Network | ExportedResult)
def write(
    what: Network | ExportedResult,
    path: str | Path,
    *,
    format: str | None = None,
    **options: Any,
) -> None:
    """Write a network or a result in the format that the suffix tells; `read` is the reverse.

    A solution can be written for geographic programs (GeoPackage, GeoJSON, KML), as a drawing
    (DXF), as points (PLY), as a table of points with covariances (TXT), as results for programs
    (JSON), and in every format of a network, with adjusted values for given ones.

    Args:
        what: a network, a solution, or a report with data snooping; or a comparison of two epochs,
            or its report with blocks, in the formats of solutions except PLY and TXT.
        path: the file, or folder.
        format: name of the format, where the suffix does not determine it.
        options: options of the function that writes the format.

    Raises:
        InputError: no format has the suffix or the name, the format has no such option, or cannot
            express what is to be written (all is listed). No file has changed then.
    """
    export_target(path, format).write(what, **options)

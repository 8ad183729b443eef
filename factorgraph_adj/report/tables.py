"""The solution as files: results.json for programs, CSV tables for people and programs.

The names of the columns, or a column beside the value, state the units of CSV tables.
results.json has metres, radians and image units throughout.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import isfinite, nan
from pathlib import Path

import numpy as np

from ..graph.variables import camera_of_calibration
from ..io.atomic import write_files
from ..io.tables import write_columns, write_table
from ..models.variables import VariableKind
from ..quality.posed import place_of_frame
from ..quality.variance_components import VarianceComponents
from ..solve.solution import Solution
from .causes import unit_of
from .context import Report
from .coordinates import by_photo
from .frames import measured_frames
from .geographic import geographic_columns
from .grid import grid_columns, grid_photo_columns
from .lines import lines_table
from .observation_tables import figures, observations_table, snooping_table
from .options import Provenance, ReportOptions
from .precision import figure, photo_columns, point_columns
from .rows import exact
from .shapes import shapes_table
from .summary import results_text
from .text import render
from .unknowns import small_unknowns

UNKNOWN_COLUMNS = (
    *("kind", "name", "component", "value", "sigma", "unit", "state"),
    *("t", "significant"),
)
GIVEN_COLUMNS = (
    *("kind", "name", "component", "error", "sigma", "unit", "w"),
    *("t2_together", "dof_together"),
)
RESULT_FILES = (
    *("protocol.txt", "results.json", "observations.csv", "points.csv", "unknowns.csv"),
    *("photos.csv", "shapes.csv", "relative.csv", "snooping.csv", "unknowns_left_out.csv"),
    *("variance_components.csv", "given_values.csv"),
)
"""Files of a solution; those that it has no content for are removed."""
PAIRS = ("xx", "xy", "xz", "yy", "yz", "zz")


def write_solution(
    solution: Solution,
    folder: str | Path,
    options: ReportOptions | None = None,
    provenance: Provenance | None = None,
) -> None:
    """Write protocol.txt, results.json and the CSV tables into a folder; an error writes none.

    The tables have a header line with units in the names of the columns, such as ``sigma_x_mm``:
    coordinates in metres or the unit of the project, angles in its unit of angles. Numbers are
    written with the digits that bring the double precision back, so that they can be read as data;
    latitudes, longitudes and heights, which are computed from X Y Z, to 10 nm. The
    protocol rounds. `reference/command` lists every file and its columns. `adjust --out` writes the
    same files.

    Args:
        solution: the result of `adjust`.
        folder: the folder; it is created if missing, and files of an earlier solution are replaced.
        options: as for `protocol`; the folder of the tables is set to ``folder``.
        provenance: as for `protocol`.

    Raises:
        InputError: the folder cannot be written to; no file has changed.
    """
    there = replace(options or ReportOptions(), tables=str(folder))
    write_tables(Report(solution, there, provenance or Provenance()), folder)


def write_tables(report: Report, folder: str | Path) -> None:
    """Write the files of a report, see `write_solution`."""
    files: dict[str, str | None] = dict.fromkeys(RESULT_FILES)
    files |= {
        "protocol.txt": render(report),
        "results.json": results_text(report),
        "observations.csv": observations_table(report),
        "shapes.csv": shapes_table(report) or None,
        "relative.csv": lines_table(report) or None,
        "snooping.csv": snooping_table(report) or None,
        "unknowns_left_out.csv": _left_out_table(report)
        if report.network.unknowns_left_out
        else None,
        "given_values.csv": _given_table(report) if report.given else None,
    }
    if report.components is not None:
        files["variance_components.csv"] = _components_table(report.components)
    if not report.singular:
        files["points.csv"] = _points_table(report)
        files["unknowns.csv"] = write_table(UNKNOWN_COLUMNS, _unknowns(report))
        if report.network.photos:
            files["photos.csv"] = _photos_table(report)
    write_files(folder, files)


# -- CSV ------------------------------------------------------------------------------------------


def _left_out_table(report: Report) -> str:
    gone = report.network.unknowns_left_out
    columns = {name: [getattr(x, name) for x in gone] for name in ("kind", "name", "why")}
    return write_columns(columns | {"observations": [" ".join(x.ids) for x in gone]})


def _points_table(report: Report) -> str:
    solution, length, small = report.solution, report.units.length, report.units.sigma_length
    given = report.network.points
    found = solution.state["point"]
    columns = {"name": list(given)}
    columns |= {a: [exact(v, length) for v in found[:, i].tolist()] for i, a in enumerate("xyz")}
    columns["unit"] = [length] * len(given)
    variances = np.maximum(np.einsum("nii->ni", solution.point_covariances), 0.0)
    for i, a in enumerate("xyz"):
        columns[f"sigma_{a}_{small}"] = figures(np.sqrt(variances[:, i]) / report.small)
    for pair in PAIRS:
        i, j = ("xyz".index(a) for a in pair)
        covariance = solution.point_covariances[:, i, j] / report.small**2
        columns[f"covariance_{pair}_{small}2"] = figures(covariance)
    columns |= geographic_columns(report)
    columns |= grid_columns(report)
    columns |= point_columns(report)
    if any(p.side_shot for p in given.values()):
        columns["side_shot"] = ["yes" if p.side_shot else "" for p in given.values()]
    none = (nan, nan, nan)
    check = np.array([p.check or none for p in given.values()], dtype=float).reshape(-1, 3)
    for i, a in enumerate("xyz"):
        columns[f"check_d{a}_{small}"] = figures((found[:, i] - check[:, i]) / report.small)
    return write_columns(columns)


def _photos_table(report: Report) -> str:
    counts, norms = by_photo(report)
    length, angle = report.units.length, report.units.angle
    small, small_angle = report.units.sigma_length, report.units.sigma_angle
    names = list(report.network.photos)
    poses = [report.poses[n] for n in names]
    columns = {"name": names, "camera": [f.camera for f in report.network.photos.values()]}
    columns |= {a: [exact(p.position[i], length) for p in poses] for i, a in enumerate("xyz")}
    columns["unit"] = [length] * len(names)
    about = ("omega", "phi", "kappa")
    columns |= {a: [exact(p.angles[i], angle) for p in poses] for i, a in enumerate(about)}
    columns["angle_unit"] = [angle] * len(names)
    for i, a in enumerate("xyz"):
        columns[f"sigma_{a}_{small}"] = [figure(p.sigma_position[i] / report.small) for p in poses]
    for i, a in enumerate(about):
        sigmas = [figure(p.sigma_angles[i] / report.radian) for p in poses]
        columns[f"sigma_{a}_{small_angle}"] = sigmas
    columns |= grid_photo_columns(report)
    columns |= photo_columns(report)
    columns["image_points"] = [str(counts[n]) for n in names]
    columns["normalised_rms"] = [figure(norms[n]) for n in names]
    return write_columns(columns)


def _given_table(report: Report) -> str:
    rows = []
    for v in report.given:
        t2 = figure(v.together.t2)
        for i, (component, one) in enumerate(zip(v.components, v.apart, strict=True)):
            unit, symbol = unit_of(report, v.sizes[i])
            error, sigma = (figure(float(x[0]) / unit) for x in (one.error, one.sigma))
            w = figure(float(v.w[i]))
            dof = str(v.together.dof)
            cells = (v.kind, v.name, component, error, sigma, symbol, w, t2, dof)
            rows.append(dict(zip(GIVEN_COLUMNS, cells, strict=True)))
    return write_table(GIVEN_COLUMNS, rows)


def _components_table(found: VarianceComponents) -> str:
    return write_columns(
        {
            "group": [c.name for c in found.components],
            "scalars": [str(c.n) for c in found.components],
            "redundancy": [figure(c.redundancy) for c in found.components],
            "factor": [figure(c.factor) for c in found.components],
            "sigma_factor": [figure(c.sigma) for c in found.components],
            "freedom": [figure(c.freedom) for c in found.components],
            "p_value": [figure(c.p_value) for c in found.components],
            "lower_95": [figure(c.interval()[0]) for c in found.components],
            "upper_95": [figure(c.interval()[1]) for c in found.components],
            "state": [c.state for c in found.components],
            "note": [c.note for c in found.components],
        }
    )


def _unknowns(report: Report) -> Iterator[dict[str, str]]:
    """Iterate over calibrations, orientation unknowns and small unknowns, by component."""
    for name in report.calibrations:
        camera = camera_of_calibration(report.network, name)
        e = report.calibrations[name]
        for i, parameter in enumerate(e.names):
            weighted = isfinite(camera.sigma[i]) and not camera.fixed[i]
            state = "held" if camera.fixed[i] else "weighted" if weighted else "free"
            yield {
                "kind": "calibration",
                "name": name,
                "component": parameter,
                "value": exact(float(e.values[i])),
                "sigma": figure(float(e.sigmas[i])),
                "unit": camera.unit,
                "state": state,
                **_test(report, "calibration", name, parameter),
            }
    for (station, chosen), given in report.network.orientations.items():
        found = report.solution.orientation(station, chosen)
        yield {
            "kind": "orientation",
            "name": f"{station}/{chosen}",
            "component": "orientation",
            "value": exact(float(found.values[0]), "rad"),
            "sigma": figure(float(found.sigmas[0])),
            "unit": "rad",
            "state": "held" if given.fixed[0] else "free",
        }
    for u in small_unknowns(report):
        yield {
            "kind": u.kind,
            "name": u.name,
            "component": u.component,
            "value": exact(u.value, u.unit),
            "sigma": figure(u.sigma / u.size),
            "unit": u.unit,
            "state": u.state,
            **_test(report, u.kind, u.name, u.component),
        }
    length = report.units.length
    for name in measured_frames(report):
        place = place_of_frame(report.solution, name)
        for component, value, sigma in zip(place.names, place.values, place.sigmas, strict=True):
            yield {
                "kind": "frame",
                "name": name,
                "component": component,
                "value": exact(float(value), length),
                "sigma": figure(float(sigma) / report.metre),
                "unit": length,
                "state": "computed" if sigma > 0 else "held",
            }


def _test(report: Report, kind: VariableKind, name: str, component: str) -> dict[str, str]:
    tested = report.tested(kind, name, component)
    if tested is None:
        return {}
    return {"t": figure(tested.t), "significant": "yes" if tested.significant else "no"}

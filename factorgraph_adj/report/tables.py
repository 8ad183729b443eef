"""The solution as files: solution.json for programs, CSV tables for people and programs.

Units stand in the names of the columns, or beside the value; those of solution.json are
metres, radians and image units throughout.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any

from ..frames import GeocentricFrame, LocalFrame
from ..io.atomic import write_files
from ..io.numbers import Units, write
from ..io.tables import write_table
from ..quality.global_test import global_test
from ..quality.solution import Solution
from .context import Report
from .coordinates import by_photo
from .text import render
from .unknowns import small_unknowns

FORMAT = 1
"""Version of solution.json."""
OBSERVATION_COLUMNS = (
    *("id", "kind", "from", "to", "to2", "photo", "component", "observed", "unit"),
    *("residual", "sigma", "small_unit", "normalised", "source"),
)
UNKNOWN_COLUMNS = ("kind", "name", "component", "value", "sigma", "unit", "state")
PAIRS = ("xx", "xy", "xz", "yy", "yz", "zz")


def write_solution(
    solution: Solution, folder: str | Path, *, units: Units | None = None, most: int = 60
) -> None:
    """Write protocol.txt, solution.json and the CSV tables into a folder, all or nothing.

    Args:
        solution: what `adjust` found.
        folder: made if it is not there; files of an earlier solution are replaced.
        units: units of the tables and the protocol.
        most: rows after which the protocol cuts a list.

    Raises:
        InputError: the folder cannot be written to; what was there before is there still.
    """
    write_tables(Report(solution, units or Units(), most, str(folder)), folder)


def write_tables(report: Report, folder: str | Path) -> None:
    """Write the files of a report, see `write_solution`."""
    files = {
        "protocol.txt": render(report),
        "solution.json": json.dumps(_finite(_summary(report)), indent=1, ensure_ascii=False) + "\n",
        "observations.csv": write_table(OBSERVATION_COLUMNS, _observations(report)),
    }
    if not report.singular:
        files["points.csv"] = _points_table(report)
        files["unknowns.csv"] = write_table(UNKNOWN_COLUMNS, _unknowns(report))
        if report.network.photos:
            files["photos.csv"] = _photos_table(report)
    write_files(folder, files)


# -- CSV ------------------------------------------------------------------------------------------


def _points_table(report: Report) -> str:
    small = report.units.sigma_length
    columns = [
        *("name", "x", "y", "z", "unit", *(f"sigma_{a}_{small}" for a in "xyz")),
        *(f"covariance_{p}_{small}2" for p in PAIRS),
        *(f"check_d{a}_{small}" for a in "xyz"),
    ]
    return write_table(columns, _points(report, report.units.length, small))


def _photos_table(report: Report) -> str:
    small, small_angle = report.units.sigma_length, report.units.sigma_angle
    columns = [
        *("name", "camera", "x", "y", "z", "unit", "omega", "phi", "kappa", "angle_unit"),
        *(f"sigma_{a}_{small}" for a in "xyz"),
        *(f"sigma_{a}_{small_angle}" for a in ("omega", "phi", "kappa")),
        *("image_points", "normalised_rms"),
    ]
    return write_table(columns, _photos(report, report.units.length, report.units.angle))


def _points(report: Report, length: str, small: str) -> Iterator[dict[str, str]]:
    for p in report.network.points.values():
        found = report.solution.point(p.name).tolist()
        covariance = report.solution.covariance(p.name).tolist()
        out = {"name": p.name, "unit": length}
        out |= {a: write(v, length) for a, v in zip("xyz", found, strict=True)}
        for i, a in enumerate("xyz"):
            out[f"sigma_{a}_{small}"] = _figure(max(covariance[i][i], 0.0) ** 0.5 / report.small)
            if p.check is not None and isfinite(p.check[i]):
                out[f"check_d{a}_{small}"] = _figure((found[i] - p.check[i]) / report.small)
        for pair in PAIRS:
            value = covariance["xyz".index(pair[0])]["xyz".index(pair[1])]
            out[f"covariance_{pair}_{small}2"] = _figure(value / report.small**2)
        yield out


def _photos(report: Report, length: str, angle: str) -> Iterator[dict[str, str]]:
    counts, norms = by_photo(report)
    small, small_angle = report.units.sigma_length, report.units.sigma_angle
    names = ("omega", "phi", "kappa")
    for f in report.network.photos.values():
        pose = report.poses[f.name]
        out = {"name": f.name, "camera": f.camera, "unit": length, "angle_unit": angle}
        out |= {a: write(v, length) for a, v in zip("xyz", pose.position, strict=True)}
        angles = zip(names, pose.angles, strict=True)
        out |= {a: write(v, angle) for a, v in angles}
        for a, s in zip("xyz", pose.sigma_position, strict=True):
            out[f"sigma_{a}_{small}"] = _figure(s / report.small)
        for a, s in zip(names, pose.sigma_angles, strict=True):
            out[f"sigma_{a}_{small_angle}"] = _figure(s / report.radian)
        out["image_points"] = str(counts[f.name])
        out["normalised_rms"] = _figure(norms[f.name])
        yield out


def _observations(report: Report) -> Iterator[dict[str, str]]:
    for r in report.rows.all():
        photo = r.kind in ("image", "photo_position")
        points = r.names[1:] if photo else r.names
        yield {
            "id": r.id,
            "kind": r.kind,
            "from": points[0] if points else "",
            "to": points[1] if len(points) > 1 else "",
            "to2": points[2] if len(points) > 2 else "",
            "photo": r.names[0] if photo else "",
            "component": r.component,
            "observed": _value(r.observed, r.scale.unit),
            "unit": r.scale.unit,
            "residual": _figure(r.residual / r.scale.size),
            "sigma": _figure(r.sigma / r.scale.size),
            "small_unit": r.scale.small,
            "normalised": _figure(r.residual / r.sigma),
            "source": r.source,
        }


def _unknowns(report: Report) -> Iterator[dict[str, str]]:
    """Calibrations, orientation unknowns and the small unknowns, one component a row."""
    for name in report.calibrations:
        camera = report.network.cameras[name.split("@")[0]]
        e = report.calibrations[name]
        for i, parameter in enumerate(e.names):
            weighted = isfinite(camera.sigma[i]) and not camera.fixed[i]
            state = "held" if camera.fixed[i] else "weighted" if weighted else "free"
            yield {
                "kind": "calibration",
                "name": name,
                "component": parameter,
                "value": write(float(e.values[i])),
                "sigma": _figure(float(e.sigmas[i])),
                "unit": camera.unit,
                "state": state,
            }
    for (station, chosen), given in report.network.orientations.items():
        found = report.solution.orientation(station, chosen)
        yield {
            "kind": "orientation",
            "name": f"{station}/{chosen}",
            "component": "orientation",
            "value": write(float(found.values[0]), "rad"),
            "sigma": _figure(float(found.sigmas[0])),
            "unit": "rad",
            "state": "held" if given.fixed[0] else "free",
        }
    for u in small_unknowns(report):
        yield {
            "kind": u.kind,
            "name": u.name,
            "component": u.component,
            "value": _figure(u.value / u.size),
            "sigma": _figure(u.sigma / u.size),
            "unit": u.unit,
            "state": "held" if u.held else "free",
        }


def _value(value: float, unit: str) -> str:
    return write(value, "" if unit == "px" else unit) if unit != "mm" else repr(value)


def _figure(value: float) -> str:
    """Return a derived figure with enough digits for any further use."""
    return f"{value:.9g}" if isfinite(value) else ""


# -- JSON -----------------------------------------------------------------------------------------


def _summary(report: Report) -> dict[str, Any]:
    s, network = report.solution, report.network
    frame = network.frame
    kind = "local" if isinstance(frame, LocalFrame) else "topocentric"
    test = global_test(s)
    return {
        "format": FORMAT,
        "name": network.name,
        "frame": "geocentric" if isinstance(frame, GeocentricFrame) else kind,
        "converged": s.converged,
        "reason": s.reason,
        "iterations": s.iterations,
        "n_observations": s.n_observations,
        "n_unknowns": s.n_unknowns,
        "datum": "given" if s.datum is None else "free",
        "datum_defect": s.datum_defect,
        "redundancy": s.redundancy,
        "vtpv": s.vtpv,
        "sigma0": s.sigma0,
        "variance": s.variance,
        "global_test": {**asdict(test), "accepted": test.accepted},
        "observations": [
            {
                "kind": g.label,
                "number": g.observations,
                "scalars": g.scalars,
                "normalised_rms": g.normalised_rms,
                "largest": g.largest,
            }
            for g in report.rows.groups()
        ],
        **({} if report.singular else _unknown_values(report)),
    }


def _unknown_values(report: Report) -> dict[str, Any]:
    s, network = report.solution, report.network
    return {
        "points": {
            name: {"xyz": s.point(name).tolist(), "sigma": list(report.sigmas[name])}
            for name in network.points
        },
        "photos": {name: _pose(report, name) for name in network.photos},
        "calibrations": {name: _calibration(report, name) for name in report.calibrations},
        "orientations": [
            {"station": station, "set": chosen, **_estimate(s.orientation(station, chosen))}
            for station, chosen in network.orientations
        ],
        "others": [
            {
                "kind": u.kind,
                "name": u.name,
                "component": u.component,
                "value": u.value,
                "sigma": u.sigma,
            }
            for u in small_unknowns(report)
        ],
    }


def _pose(report: Report, name: str) -> dict[str, Any]:
    pose = report.poses[name]
    return {
        "position": list(pose.position),
        "world_R_camera": pose.rotation.tolist(),
        "omega_phi_kappa": list(pose.angles),
        "sigma_position": list(pose.sigma_position),
        "sigma_omega_phi_kappa": list(pose.sigma_angles),
    }


def _calibration(report: Report, name: str) -> dict[str, Any]:
    e = report.calibrations[name]
    camera = report.network.cameras[name.split("@")[0]]
    return {
        "lens": camera.lens.kind,
        "unit": e.unit,
        "parameters": list(e.names),
        "values": e.values.tolist(),
        "sigma": e.sigmas.tolist(),
        "correlation": e.correlation.tolist(),
    }


def _estimate(e: Any) -> dict[str, float]:
    return {"value": float(e.values[0]), "sigma": float(e.sigmas[0])}


def _finite(value: Any) -> Any:
    """Return a JSON value with null for numbers that are not finite."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not isfinite(value) else value

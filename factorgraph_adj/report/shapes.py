"""Section of the protocol, and table: shapes as engineers state them."""

from __future__ import annotations

from math import isfinite, pi

import numpy as np

from ..io.tables import write_columns
from ..models.variables import UNKNOWNS
from ..quality.shapes import AdjustedShape, AdjustedSize
from ..units import ANGLE, decimal, decimal_angle
from .context import Report
from .layout import decimals, paragraph, short, table, title, with_sigma, without_empty
from .observation_tables import figures
from .precision import figure
from .rows import exact

MEANING = (
    "X, Y, Z: the centre, or the apex of a cone or paraboloid; of planes, lines and cylinders the "
    "place nearest to the middle of their points, with σ along the normal or across the axis only. "
    "Axis: unit vector of the normal or the axis. Tilt: its angle against the vertical; azimuth: "
    "clockwise from north. Under each value its σ"
)
OPEN = pi / 2
"""σ of an azimuth, radians, from which the azimuth says nothing and is not shown."""
ROUNDING = 1e-9
"""Part of the largest σ of a place below which that of a coordinate is rounding."""


def shapes(report: Report) -> list[str]:
    """Return the shapes: place, axis, tilt, azimuth and sizes with their σ, points, residuals."""
    if not report.shapes:
        return []
    shown, note = report.cut(list(report.shapes), "shapes", "shapes.csv")
    units = report.units
    angle = decimal_angle(units.angle)
    header = ["shape", "points", "max v", "X", "Y", "Z", "axis", "tilt", "azimuth", "size", ""]
    rows: list[list[str]] = []
    for one in shown:
        rows += _rows(report, one)
    header, rows = without_empty(header, rows)
    small = f"{units.length}, {angle}; v, σ: {units.sigma_length}, {units.sigma_angle}"
    return [*title(f"Shapes ({small})"), *table(header, rows), *note, *paragraph(MEANING)]


def _rows(report: Report, one: AdjustedShape) -> list[list[str]]:
    """Return two rows of the table: the values of a shape, and their σ."""
    small = [float(np.sqrt(max(v, 0.0))) / report.small for v in np.diag(one.covariance)]
    places = decimals([max(small) * report.small / report.metre], default=4, most=9)
    at = [decimal(float(v) / report.metre, places) for v in one.place]
    direction = "" if np.isnan(one.axis).any() else " ".join(decimal(v, 5) for v in one.axis)
    turns = ((one.tilt, one.sigma_tilt), (one.azimuth, one.sigma_azimuth))
    angles = [_angle(report, *turn) for turn in turns]
    sizes = [_size(report, size) for size in one.sizes[:2]]
    sizes += [("", "")] * (2 - len(sizes))
    largest = short(one.largest / report.small) if isfinite(one.largest) else ""
    return [
        [one.name, str(one.points), largest, *at, direction, *(v for v, _ in (*angles, *sizes))],
        [
            f"  {one.shape}, σ",
            *("", ""),
            *(_sigma(s, max(small)) for s in small),
            "",
            *(s for _, s in (*angles, *sizes)),
        ],
    ]


def _sigma(value: float, largest: float = 0.0) -> str:
    """Return a σ; that of a coordinate along which symmetry leaves the shape open is none."""
    if value <= ROUNDING * largest:
        return "–" if largest > 0 else "held"
    return short(value)


def _angle(report: Report, value: float, sigma: float) -> tuple[str, str]:
    """Return an angle and its σ; empty where it is none, or says nothing."""
    if not isfinite(value) or sigma > OPEN:
        return "", ""
    size = ANGLE[decimal_angle(report.units.angle)]
    digits = decimals([sigma / size], default=4, most=9)
    return decimal(value / size, digits), _sigma(sigma / report.radian)


def _size(report: Report, size: AdjustedSize) -> tuple[str, str]:
    """Return a size with its name and unit, and its σ."""
    unit, length = _unit(report, size)
    small = report.radian if _is_angle(size) else report.small
    value = with_sigma(size.value / length, size.sigma / length)
    return f"{size.attribute} {value} {unit}", _sigma(size.sigma / small)


def _is_angle(size: AdjustedSize) -> bool:
    return UNKNOWNS[size.kind].components[0].quantity == "angle"


def _unit(report: Report, size: AdjustedSize) -> tuple[str, float]:
    """Return the unit in which a size is shown, and its length."""
    if _is_angle(size):
        unit = decimal_angle(report.units.angle)
        return unit, ANGLE[unit]
    return report.units.length, report.metre


def shapes_table(report: Report) -> str:
    """Return shapes.csv, or nothing where there are no shapes."""
    found, units = report.shapes, report.units
    if not found:
        return ""
    angle, small, fine = decimal_angle(units.angle), units.sigma_length, units.sigma_angle
    turn = ANGLE[angle]
    sigmas = np.sqrt(np.maximum([np.diag(s.covariance) for s in found], 0.0)) / report.small
    columns = {"name": [s.name for s in found], "shape": [s.shape for s in found]}
    columns["points"] = [str(s.points) for s in found]
    columns |= {a: [exact(float(s.place[i]), units.length) for s in found] for i, a in _XYZ}
    columns["unit"] = [units.length] * len(found)
    columns |= {f"sigma_{a}_{small}": figures(sigmas[:, i]) for i, a in _XYZ}
    columns |= {f"axis_{a}": [figure(float(s.axis[i])) for s in found] for i, a in _XYZ}
    columns[f"tilt_{angle}"] = [figure(s.tilt / turn) for s in found]
    columns[f"sigma_tilt_{fine}"] = [figure(s.sigma_tilt / report.radian) for s in found]
    columns[f"azimuth_{angle}"] = [figure(s.azimuth / turn) for s in found]
    columns[f"sigma_azimuth_{fine}"] = [figure(s.sigma_azimuth / report.radian) for s in found]
    for number in ("", "2"):
        i = 1 if number else 0
        sizes = [s.sizes[i] if len(s.sizes) > i else None for s in found]
        columns[f"size{number}"] = ["" if s is None else s.attribute for s in sizes]
        columns[f"value{number}"] = ["" if s is None else _exact(report, s) for s in sizes]
        columns[f"unit_of_value{number}"] = [
            "" if s is None else _unit(report, s)[0] for s in sizes
        ]
        columns[f"sigma_value{number}"] = [
            "" if s is None else figure(s.sigma / _unit(report, s)[1]) for s in sizes
        ]
    columns[f"rms_{small}"] = [figure(s.rms / report.small) for s in found]
    columns[f"largest_{small}"] = [figure(s.largest / report.small) for s in found]
    return write_columns(columns)


_XYZ = tuple(enumerate("xyz"))


def _exact(report: Report, size: AdjustedSize) -> str:
    return exact(size.value, _unit(report, size)[0])

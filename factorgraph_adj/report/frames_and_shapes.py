"""Text sections of frames (models, scanner stations) and of shapes, with σ; shapes.csv.

A shape is a frame whose place, axis and sizes are reported instead of its rotation and offset.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite, pi, sqrt

import numpy as np

from ..entities import Parameter
from ..io.csv_tables import write_columns
from ..models.sub_frame import split_frame
from ..models.unknown_registry import UNKNOWNS
from ..observations import observation_kind
from ..quality.derived_quantities import (
    PLACE_COMPONENTS,
    AdjustedShape,
    AdjustedSize,
    place_of_frame,
)
from ..rotation import TURN_ABOUT_X, angles_by_rotation, omega_phi_kappa
from ..units import ANGLE, decimal, decimal_angle
from .adjustment_report import Report
from .layout import (
    decimals,
    figure,
    figures,
    paragraph,
    short,
    table,
    title,
    with_sigma,
    without_empty_columns,
)
from .observation_rows import all_digits

FRAMES_LEGEND = (
    "X = O + Eᵀ e^ℓ R (q + c): rotation R of ω, φ, κ, offset c of x, y, z, scale e^ℓ; E: the "
    "horizon at the origin O of a level frame. Offset and v are in the unit of the frame, which is "
    "e^ℓ times that of the network. X, Y, Z: the place of the zero of the frame in the network, "
    "where a scanner or tracker stands. Under each value its σ, (w) where it was weighted"
)
ROUNDING_OF_PLACE = 1e-9
"""Part of the largest σ of a place below which that of a coordinate is rounding."""
SHAPES_LEGEND = (
    "X, Y, Z: the centre, or the apex of a cone or paraboloid; of planes, lines and cylinders the "
    "place nearest to the middle of their points, with σ along the normal or across the axis only. "
    "Axis: unit vector of the normal or the axis. Tilt: its angle against the vertical; azimuth: "
    "clockwise from north. Under each value its σ"
)
MAX_SIGMA_AZIMUTH_RAD = pi / 2
"""σ of an azimuth, radians, from which the azimuth says nothing and is not shown."""
_XYZ = tuple(enumerate("xyz"))


@dataclass(frozen=True)
class _FrameMeasurements:
    """What was measured in a frame."""

    places: int
    """Number of points and projection centres that were measured in it."""
    rms: float
    """Root mean square of residuals that are lengths, unit of the frame; NaN: there are none."""
    normalised: float
    """Root mean square of v/σ; NaN: nothing was measured."""


def frames_section(report: Report) -> list[str]:
    """Return the frames: origin, places, residuals; rotation, offset and scale with their σ."""
    stated, seen, units = report.network.frames, _measurements_by_frame(report), report.units
    number = report.solution.equations.unknowns["frame"].number
    own = _own(report, seen)
    if not own:
        return []
    names, note = report.cut(own, "frames", "unknowns.csv")
    overview: list[list[str]] = []
    rows: list[list[str]] = []
    places: list[list[str]] = []
    for name in names:
        found = seen[number[name]]
        overview.append(
            [
                name,
                _origin(report, stated[name]),
                "yes" if stated[name].constants[-1] else "no",
                str(found.places),
                short(found.rms / report.small),
                short(found.normalised),
            ]
        )
        rows += _values(report, name, stated[name])
        places += _place(report, name)
    angle = decimal_angle(units.angle)
    header = [
        "frame",
        f"origin [{units.length}]",
        "level",
        "places",
        f"RMS v [{units.sigma_length}]",
    ]
    header += ["RMS v/σ"]
    second = [
        "frame",
        *(f"{a} [{angle}]" for a in "ωφκ"),
        *(f"{a} [{units.length}]" for a in "xyz"),
    ]
    small = f"σ [{units.sigma_angle}, {units.sigma_length}, ppm]"
    return [
        *title("Frames"),
        *table(header, overview, left=3),
        *note,
        "",
        *table([*second, "scale"], [r if r[0] else [f"  {small}", *r[1:]] for r in rows]),
        "",
        *table(
            ["frame", *(f"{a} [{units.length}]" for a in PLACE_COMPONENTS)],
            [r if r[0] else [f"  σ [{units.sigma_length}]", *r[1:]] for r in places],
        ),
        *paragraph(FRAMES_LEGEND),
    ]


def measured_frames(report: Report) -> list[str]:
    """Return the frames in which something was measured, and those that are no shapes."""
    return _own(report, _measurements_by_frame(report))


def _own(report: Report, seen: list[_FrameMeasurements]) -> list[str]:
    """Return the frames of the section; a shape has a table of its own instead."""
    number = report.solution.equations.unknowns["frame"].number
    shapes = {s.name for s in report.shapes}
    return [n for n in report.network.frames if n not in shapes or seen[number[n]].places]


def _place(report: Report, name: str) -> list[list[str]]:
    """Return two rows of the table of places: X, Y, Z of a frame's zero, and their σ."""
    e = place_of_frame(report.solution, name)
    small = [float(s) / report.small for s in e.sigmas]
    digits = decimals([s * report.small / report.metre for s in small], default=4, most=9)
    values = [decimal(float(v) / report.metre, digits) for v in e.values]
    return [[name, *values], ["", *("held" if s == 0 else short(s) for s in small)]]


def _origin(report: Report, stated: Parameter) -> str:
    """Return the point at the origin, or its constant coordinates."""
    if stated.origin:
        return f"point {stated.origin}"
    return " ".join(_short(v / report.metre) for v in stated.constants[:3])


def _short(value: float) -> str:
    """Return a constant coordinate with at most three decimals."""
    return f"{value + 0.0:.3f}".rstrip("0").rstrip(".")


def _measurements_by_frame(report: Report) -> list[_FrameMeasurements]:
    """Return what was measured in each frame, by number."""
    equations = report.solution.equations
    n = len(equations.unknowns["frame"].names)
    places: list[set[tuple[str, int]]] = [set() for _ in range(n)]
    lengths, scalars, square, norm = np.zeros((4, n))
    for block in equations.blocks:
        if (
            not block.named
            or block.variables[0][0] != "frame"
            or observation_kind(block.kind).shape
        ):
            continue
        index = block.variables[0][1]
        for (kind, numbers), attribute in zip(block.arguments, block.named, strict=True):
            if kind in ("point", "pose") and "." not in attribute:
                for i, number in np.unique(np.stack([index, numbers], 1), axis=0).tolist():
                    places[i].add((kind, number))
        v = report.solution.observations.residuals[block.rows].reshape(block.observed.shape)
        scalars += block.dimension * np.bincount(index, minlength=n)
        norm += np.bincount(index, np.sum((v / block.sigma) ** 2, axis=1), n)
        if block.unit == "m":
            lengths += block.dimension * np.bincount(index, minlength=n)
            square += np.bincount(index, np.sum(v**2, axis=1), n)
    with np.errstate(invalid="ignore"):
        found = zip(places, np.sqrt(square / lengths), np.sqrt(norm / scalars), strict=True)
    return [_FrameMeasurements(len(p), float(v), float(w)) for p, v, w in found]


def _values(report: Report, name: str, stated: Parameter) -> list[list[str]]:
    """Return two rows of the table: the values of a frame, and their σ."""
    solution, units = report.solution, report.units
    table_ = solution.equations.unknowns["frame"]
    stored = solution.state["frame"][table_.number[name]]
    rotation, offset, ln_scale, _, _ = (x[0] for x in split_frame(stored[None]))
    covariance = solution.variable_covariance(("frame", name))
    # ω, φ, κ turn photogrammetric axes, and the functions take rotations of camera axes.
    camera = rotation @ TURN_ABOUT_X
    turn = angles_by_rotation(camera) @ TURN_ABOUT_X
    by_angles = np.diag(turn @ covariance[:3, :3] @ turn.T).tolist()
    variances = [*by_angles, *np.diag(covariance)[3:].tolist()]
    sizes = [report.radian] * 3 + [report.small] * 3 + [1e-6]
    sigmas = [sqrt(v) / s if v >= 0 else v for v, s in zip(variances, sizes, strict=True)]
    weighted = np.isfinite(stated.sigma) & ~np.array(stated.fixed)
    below = [
        "held" if s == 0 else short(s) + (" (w)" if w else "")
        for s, w in zip(sigmas, weighted.tolist(), strict=True)
    ]
    whole = ANGLE[decimal_angle(units.angle)]
    digits = [
        decimals([s * small / large for s in sigmas[part]], default=4, most=9)
        for part, small, large in (
            (slice(0, 3), report.radian, whole),
            (slice(3, 6), report.small, report.metre),
        )
    ]
    values = [decimal(a / whole, digits[0]) for a in omega_phi_kappa(camera)]
    values += [decimal(float(c) / report.metre, digits[1]) for c in offset]
    return [[name, *values, _scale(float(ln_scale), sigmas[6])], ["", *below]]


def _scale(ln_scale: float, sigma_ppm: float) -> str:
    """Return a scale as the factor e^ℓ, to the second digit of its σ."""
    if ln_scale == 0 and sigma_ppm == 0:
        return "1"
    scale = exp(ln_scale)
    return decimal(scale, decimals([1e-6 * sigma_ppm * scale], default=6, most=12))


def shapes_section(report: Report) -> list[str]:
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
    header, rows = without_empty_columns(header, rows)
    small = f"{units.length}, {angle}; v, σ: {units.sigma_length}, {units.sigma_angle}"
    return [*title(f"Shapes ({small})"), *table(header, rows), *note, *paragraph(SHAPES_LEGEND)]


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
    if value <= ROUNDING_OF_PLACE * largest:
        return "–" if largest > 0 else "held"
    return short(value)


def _angle(report: Report, value: float, sigma: float) -> tuple[str, str]:
    """Return an angle and its σ; empty where it is none, or says nothing."""
    if not isfinite(value) or sigma > MAX_SIGMA_AZIMUTH_RAD:
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
    columns |= {a: [all_digits(float(s.place[i]), units.length) for s in found] for i, a in _XYZ}
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


def _exact(report: Report, size: AdjustedSize) -> str:
    return all_digits(size.value, _unit(report, size)[0])

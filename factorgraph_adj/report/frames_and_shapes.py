"""Text sections of frames (models, scanner stations) and of shapes, with σ; shapes.csv.

A shape is a frame whose place, axis and sizes are reported instead of its rotation and offset.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import exp, isfinite, pi, sqrt
from typing import Any

import numpy as np

from ..entities import Parameter
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
from ..types import Array
from ..units import ANGLE, decimal, decimal_angle
from .adjustment_report import Report
from .layout import decimals, paragraph, short, table, title, with_sigma
from .tables import NO_FIGURE, NUMBER, READ, Column, Table, Unit, as_text, unit_of

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
    """Return planes, lines, circles and other shapes, as engineers state them."""
    if not report.shapes:
        return []
    made, units = shapes_table(report), report.units
    rows, note = report.cut(list(made.rows), "shapes", "shapes.csv")
    small = f"{units.length}, {decimal_angle(units.angle)}; v, σ: "
    heading = title(f"Shapes ({small}{units.sigma_length}, {units.sigma_angle})")
    return [*heading, *as_text(replace(made, rows=rows)), *note, *paragraph(SHAPES_LEGEND)]


def shapes_table(report: Report) -> Table[AdjustedShape]:
    """Return the table of shapes; text has σ below each value."""
    return Table("shapes", report.shapes, list(_shape_columns(report)))


def _shape_columns(report: Report) -> Iterator[Column[AdjustedShape]]:
    units = report.units
    metre, small = unit_of(units.length), unit_of(units.sigma_length)
    angle, fine = unit_of(decimal_angle(units.angle)), unit_of(units.sigma_angle)
    page, written = ("html", "csv"), {"suffix": True, "only": ("html", "csv")}
    of_text = {"short_heading": True, "only": ("text",)}
    largest = Column[AdjustedShape](title="max v", key="largest", value="largest", unit=small)

    yield Column(title="shape", key="name", value="name")
    yield Column(
        title="kind",
        value=lambda s: f"  {s.shape}, σ",
        below="shape",
        only=("text",),
    )
    yield Column(title="kind", key="shape", value="shape", translated=True, only=page)
    yield Column(title="points", value="points")
    yield replace(largest, **of_text)  # type: ignore[arg-type]
    for i, a in enumerate("xyz"):
        place = Column[AdjustedShape](
            title=a.upper(),
            key=a,
            value=lambda s, i=i: float(s.place[i]),  # type: ignore[misc]
            unit=metre,
            digits=lambda s: decimals([float(_sigmas(s).max()) / metre.size], default=4, most=9),
            exact=True,
            short_heading=True,
        )
        yield place
        yield from _sigma(
            place,
            small,
            lambda s, i=i: float(_sigmas(s)[i]),  # type: ignore[misc]
            lambda s: float(_sigmas(s).max()),
        )
    yield Column(title="unit", value=lambda s: units.length, only=("csv",))
    yield Column(title="axis", value=_direction, only=READ)
    for i, a in enumerate("xyz"):
        yield Column(
            title=f"axis_{a}",
            value=lambda s, i=i: float(s.axis[i]),  # type: ignore[misc]
            only=("csv",),
        )
    for name in ("tilt", "azimuth"):
        turn = Column[AdjustedShape](
            title=name,
            value=name,
            unit=angle,
            digits=lambda s, n=name: decimals(  # type: ignore[misc]
                [getattr(s, f"sigma_{n}") / angle.size], default=4, most=9
            ),
            shown=lambda s, n=name: None if _is_known(s, n) else "",  # type: ignore[misc]
            suffix=True,
            short_heading=True,
        )
        yield turn
        yield from _sigma(
            turn,
            fine,
            lambda s, n=name: getattr(s, f"sigma_{n}"),  # type: ignore[misc]
            known=lambda s, n=name: _is_known(s, n),  # type: ignore[misc]
        )
    for i, heading in enumerate(("size", "size2")):
        yield from _size_columns(report, i, heading)
    yield Column(title="RMS v", key="rms", value="rms", unit=small, **written)  # type: ignore[arg-type]
    yield replace(largest, **written)  # type: ignore[arg-type]


def _sigma(
    column: Column[AdjustedShape],
    unit: Unit,
    value: Callable[[AdjustedShape], float],
    largest: Callable[[AdjustedShape], float] = lambda s: 0.0,
    known: Callable[[AdjustedShape], bool] = lambda s: True,
) -> Iterator[Column[AdjustedShape]]:
    """Return σ of a column; that along which symmetry leaves the shape open is none."""

    def shown(s: AdjustedShape) -> str | None:
        if not known(s):
            return ""
        if value(s) > ROUNDING_OF_PLACE * largest(s):
            return None
        return NO_FIGURE if largest(s) > 0 else "held"

    yield Column(
        title=f"σ {column.title}" if column.title.isupper() else "σ",
        key=f"sigma_{column.name}",
        value=value,
        unit=unit,
        shown=shown,
        translated=True,
        suffix=True,
        below=column.title,
    )


def _sigmas(s: AdjustedShape) -> Array:
    """Return the standard deviations of the place, metres."""
    return np.sqrt(np.maximum(np.diag(s.covariance), 0.0))


def _is_known(s: AdjustedShape, name: str) -> bool:
    """Return whether a tilt or azimuth is one, and says something."""
    return isfinite(getattr(s, name)) and getattr(s, f"sigma_{name}") <= MAX_SIGMA_AZIMUTH_RAD


def _direction(s: AdjustedShape) -> str:
    return "" if np.isnan(s.axis).any() else " ".join(decimal(float(v), 5) for v in s.axis)


def _size_columns(report: Report, i: int, heading: str) -> Iterator[Column[AdjustedShape]]:
    """Return the columns of the size with number i: its name, value, unit and σ."""

    def of(figure: Callable[[AdjustedSize], Any]) -> Callable[[AdjustedShape], Any]:
        return lambda s: figure(s.sizes[i]) if len(s.sizes) > i else None

    def units(size: AdjustedSize) -> tuple[Unit, Unit]:
        if UNKNOWNS[size.kind].components[0].quantity == "angle":
            return unit_of(decimal_angle(report.units.angle)), unit_of(report.units.sigma_angle)
        return unit_of(report.units.length), unit_of(report.units.sigma_length)

    def read(size: AdjustedSize) -> str:
        unit = units(size)[0]
        value = with_sigma(size.value / unit.size, size.sigma / unit.size)
        return f"{size.attribute} {value} {unit.name}"

    def sigma(size: AdjustedSize) -> str:
        fine = units(size)[1]
        return f"{short(size.sigma / fine.size)} {fine.name}" if size.sigma > 0 else "held"

    def whole(s: AdjustedShape) -> Unit:
        return units(s.sizes[i])[0] if len(s.sizes) > i else NUMBER

    yield Column(title=heading, value=of(read), only=READ)
    yield Column(title="σ", value=of(sigma), below=heading, only=READ)
    yield Column(title=heading, value=of(lambda size: size.attribute), only=("csv",))
    value = Column[AdjustedShape](
        title=heading.replace("size", "value"),
        value=of(lambda size: size.value),
        unit=whole,
        exact=True,
        only=("csv",),
    )
    yield value
    yield Column(
        title=f"unit_of_{value.title}", value=of(lambda size: units(size)[0].name), only=("csv",)
    )
    yield replace(
        value, title=f"sigma_{value.title}", value=of(lambda size: size.sigma), exact=False
    )

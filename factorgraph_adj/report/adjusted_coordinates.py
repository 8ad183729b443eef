"""Table of adjusted lines with relative ellipses; ellipse columns and decimals of points.

Lines join pairs of places. Lines and ellipses are given if the options ask for them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..io.numbers import Units
from ..quality.derived_quantities import AdjustedLine
from ..quality.error_ellipses import ErrorEllipse, confidence_factor
from ..quality.point_precision import Place, place_variable
from ..units import ANGLE, decimal, decimal_angle, format_angle
from .adjustment_report import Report
from .layout import decimals, exponent, paragraph, percent, title
from .observation_rows import observation_scale
from .tables import READ, Column, Rendering, Table, Unit, as_text, unit_of

DECIMALS_OF_AZIMUTH = {
    "rad": 4,
    "mrad": 1,
    "gon": 1,
    "mgon": -2,
    "cc": -3,
    "deg": 1,
    "arcmin": 0,
    "arcsec": -2,
}
"""Decimals of azimuths and dips of ellipses by unit; further digits are not significant."""
NOT_AT_A_MINIMUM = (
    "not converged: standard deviations belong to the place where the iteration stopped; at a "
    "minimum they may be several times larger or smaller"
)
"""Note on the precision of a result that has not converged."""


def region_factor(report: Report, dimension: int) -> float:
    """Return the factor from standard deviations to a region of the requested confidence."""
    s = report.solution
    estimated = s.variance == "a-posteriori" and s.redundancy > 0
    known = s.redundancy if estimated else None
    return confidence_factor(dimension, report.options.confidence, redundancy=known)


def height_half_widths(report: Report) -> dict[str, float]:
    """Return half the confidence interval of each point's height, metres."""
    solution = report.solution
    at = solution.state["point"]
    up = solution.network.frame.basis(at, np.zeros((len(at), 2))).enu[:, 2]
    variance = np.einsum("ni,nij,nj->n", up, solution.point_covariances, up)
    found = region_factor(report, 1) * np.sqrt(np.maximum(variance, 0.0))
    names = solution.equations.unknowns["point"].names
    return dict(zip(names, found.tolist(), strict=True))


def rounded_azimuth(units: Units, angle: float) -> str:
    """Write an azimuth or dip with the decimals of `DECIMALS_OF_AZIMUTH`."""
    if units.angle == "dms":
        return format_angle(angle, "dms", 0)
    digits = DECIMALS_OF_AZIMUTH[units.angle]
    value = round(angle / ANGLE[units.angle], digits)
    return decimal(value, max(digits, 0))


def ellipse_columns(
    units: Units,
    ellipse: Callable[[Any], ErrorEllipse],
    digits: int | None,
    readable: tuple[Rendering, ...],
) -> list[Column[Any]]:
    """Return the columns of error ellipses: semi-axes, and the azimuth of the larger one.

    Args:
        units: units of the report.
        ellipse: the ellipse of a row.
        digits: decimals of the semi-axes; None: three significant digits.
        readable: renderings for people that have them.
    """

    def turn(row: Any) -> str:
        e = ellipse(row)
        return rounded_azimuth(units, e.azimuth) if e.semi_axes[0] > 0 else ""

    azimuth = Column[Any](
        title="azimuth_a",
        key="ellipse_azimuth",
        value=lambda row: ellipse(row).azimuth,
        unit=unit_of(decimal_angle(units.angle)),
        suffix=True,
        only=("csv",),
    )
    semi_axes = [
        Column[Any](
            title=name,
            key=key,
            value=lambda row, i=i: ellipse(row).semi_axes[i],  # type: ignore[misc]
            unit=unit_of(units.sigma_length),
            digits=digits,
            suffix=True,
            only=(*readable, "csv"),
        )
        for i, (name, key) in enumerate((("a", "ellipse_major"), ("b", "ellipse_minor")))
    ]
    shown = replace(azimuth, unit=unit_of(units.angle), shown=turn, only=readable)
    return [*semi_axes, shown, azimuth]


def decimals_of_points(report: Report) -> tuple[int, int]:
    """Return the decimals of σ of points, and those of coordinates, which show as much."""
    sigmas: list[float] = []
    if not report.singular:
        free = report.solution.equations.unknowns["point"].offset >= 0
        some = (report.sigmas[free] / report.small).ravel()
        some = some[(some > 0) & np.isfinite(some)]
        # The median alone decides: networks have tens of thousands of points.
        middle = len(some) // 2
        sigmas = [float(np.partition(some, middle)[middle])] if len(some) else []
    places = decimals(sigmas, default=2, most=5)
    return places, min(max(places + exponent(report.metre / report.small * 1.0001), 0), 9)


def place_name(place: Place) -> str:
    """Return the name of a point, or of the photo of a projection centre."""
    return place_variable(place)[1]


def lines_table(report: Report, lines: Sequence[AdjustedLine] | None = None) -> Table[AdjustedLine]:
    """Return the table of adjusted lines with relative error ellipses.

    Args:
        report: the report.
        lines: some of its lines; None: all.
    """
    rows = report.lines if lines is None else lines
    plan, heights = _dimensions(report)
    units, confidence = report.units, report.options.confidence
    metre, small = Unit(units.length, report.metre), Unit(units.sigma_length, report.small)
    fine_angle, decimal_unit = unit_of(units.sigma_angle), unit_of(decimal_angle(units.angle))
    length, angle = observation_scale("m", units), observation_scale("rad", units)
    fine = decimals((x.sigma_distance / report.small for x in rows), default=2, most=5)
    digits = max(fine + length.further_decimals, 0)
    sigmas = (x.sigma_azimuth / angle.size for x in rows)
    turned = max(decimals(sigmas, default=2, most=5) + angle.further_decimals, 0)
    in_plan = ("text", "html", "json") if plan else ("html", "json")
    in_height = ("text", "html", "json") if heights else ("html", "json")

    def name(end: str) -> Callable[[AdjustedLine], str]:
        return lambda x: place_name(getattr(x, end))

    distance = Column[AdjustedLine](
        title="distance", value="distance", unit=metre, digits=digits, exact=True
    )
    sigma = Column[AdjustedLine](
        title="σ", key="sigma_distance", value="sigma_distance", unit=small, digits=fine
    )
    rise = replace(distance, title="rise", value="rise")
    sigma_rise = replace(sigma, key="sigma_rise", value="sigma_rise")
    azimuth = Column[AdjustedLine](title="azimuth", value="azimuth", unit=decimal_unit, exact=True)
    sigma_azimuth = Column[AdjustedLine](
        title="σ", key="sigma_azimuth", value="sigma_azimuth", unit=fine_angle
    )
    csv = {"only": ("csv",), "suffix": True}
    shown_azimuth = replace(
        azimuth, unit=unit_of(units.angle, turn=True), digits=turned, only=in_plan
    )
    columns: list[Column[AdjustedLine]] = [
        Column(title="from", value=name("a")),
        Column(title="to", value=name("b")),
        distance,
        replace(rise, only=("csv",)),
        Column(title="unit", value=lambda x: units.length, only=("csv",)),
        replace(sigma, only=("text", "html", "json")),
        replace(sigma, **csv),  # type: ignore[arg-type]
        Column(title="ppm", value="ppm", digits=1, only=("text", "html", "csv")),
        replace(sigma_rise, **csv),  # type: ignore[arg-type]
        shown_azimuth,
        replace(azimuth, **csv),  # type: ignore[arg-type]
        replace(sigma_azimuth, only=in_plan),
        replace(sigma_azimuth, **csv),  # type: ignore[arg-type]
        replace(rise, only=in_height),
        replace(sigma_rise, only=in_height),
        Column(title="confidence", value=lambda x: confidence, only=("csv",)),
        *ellipse_columns(units, lambda x: x.ellipse, fine, READ if plan else ("html",)),
        Column(title="ellipse", value=_ellipse_record, only=("json",)),
    ]
    return Table("lines", rows, columns)


def _ellipse_record(line: AdjustedLine) -> dict[str, Any]:
    """Return the relative ellipse of a line for results.json."""
    e = line.ellipse
    semi_axes = {"semi_axes": list(e.semi_axes), "azimuth": e.azimuth}
    return semi_axes | {"confidence": e.confidence, "factor": e.factor}


def lines_section(report: Report) -> list[str]:
    """Return distances, azimuths and rises with σ, and relative error ellipses."""
    if not report.lines:
        return []
    shown, note = report.cut(list(report.lines), "lines", "relative.csv")
    plan, heights = _dimensions(report)
    words = paragraph(_words(report, plan=plan, heights=heights))
    heading = title("Adjusted lines, from mark to mark")
    return [*heading, *as_text(lines_table(report, shown)), *note, *words]


def _dimensions(report: Report) -> tuple[bool, bool]:
    """Return whether plan coordinates, and heights, of any point are unknown."""
    free = [p.fixed for p in report.network.points.values()]
    frame_is_flat = report.geographic is None
    plan = any(not (f[0] and f[1]) for f in free) or not frame_is_flat
    return plan, any(not f[2] for f in free) or not frame_is_flat


def _words(report: Report, *, plan: bool, heights: bool) -> str:
    words = ["distance: slope distance"]
    if heights:
        words.append("rise: height difference along the vertical of the midpoint")
    if plan:
        words.append("azimuth: clockwise from north, at the first place")
        k, asked = region_factor(report, 2), report.options.confidence
        level = "standard ellipses" if asked is None else f"{percent(asked)} ellipses"
        words.append(f"a, b: relative {level}, {k:.3f} × standard ellipse")
    return "; ".join(words)

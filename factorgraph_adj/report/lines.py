"""Adjusted lines: a section of the protocol, a table, and records for programs."""

from __future__ import annotations

from math import isfinite
from typing import Any

from ..io.tables import write_columns
from ..quality.lines import AdjustedLine
from ..quality.relative import Place, variable
from ..units import ANGLE, decimal, format_turn
from .context import Report
from .layout import decimals, paragraph, percent, short, table, title, without_empty
from .precision import angle_unit, coarse, factor, figure
from .rows import exact, scale_of


def place_name(place: Place) -> str:
    """Return the name of a point, or of the photo of a projection centre."""
    return variable(place)[1]


def lines(report: Report) -> list[str]:
    """Return distances, azimuths and rises with σ, and relative error ellipses."""
    found = report.lines
    if not found:
        return []
    units = report.units
    shown, note = report.cut(list(found), "lines", "relative.csv")
    plan, heights = _dimensions(report)
    length, angle = scale_of("m", units), scale_of("rad", units)
    fine = decimals((x.sigma_distance / report.small for x in shown), default=2, most=5)
    digits = max(fine + length.further_decimals, 0)
    sigmas = (x.sigma_azimuth / angle.size for x in shown)
    turned = max(decimals(sigmas, default=2, most=5) + angle.further_decimals, 0)
    rows = []
    for x in shown:
        row = [place_name(x.a), place_name(x.b)]
        row += [decimal(x.distance / report.metre, digits), _small(x.sigma_distance, report, fine)]
        row += [f"{x.ppm:.1f}" if isfinite(x.ppm) else ""]
        if plan:
            there = isfinite(x.azimuth)
            row += [format_turn(x.azimuth, units.angle, turned) if there else ""]
            row += [short(x.sigma_azimuth / angle.size) if there else ""]
        if heights:
            row += [decimal(x.rise / report.metre, digits), _small(x.sigma_rise, report, fine)]
        if plan:
            row += [_small(a, report, fine) for a in x.ellipse.semi_axes]
            row += [coarse(report, x.ellipse.azimuth) if x.ellipse.semi_axes[0] > 0 else ""]
        rows.append(row)
    small = units.sigma_length
    header = ["from", "to", f"distance [{units.length}]", f"σ [{small}]", "ppm"]
    header += [f"azimuth [{units.angle}]", f"σ [{units.sigma_angle}]"] if plan else []
    header += [f"rise [{units.length}]", f"σ [{small}]"] if heights else []
    header += [f"a [{small}]", f"b [{small}]", "azimuth a"] if plan else []
    header, rows = without_empty(header, rows)
    out = [*title("Adjusted lines, from mark to mark"), *table(header, rows, left=2), *note]
    return [*out, *paragraph(_words(report, plan=plan, heights=heights))]


def _dimensions(report: Report) -> tuple[bool, bool]:
    """Return whether plan coordinates, and heights, of any point are unknown."""
    free = [p.fixed for p in report.network.points.values()]
    frame_is_flat = report.geographic is None
    plan = any(not (f[0] and f[1]) for f in free) or not frame_is_flat
    return plan, any(not f[2] for f in free) or not frame_is_flat


def _small(metres: float, report: Report, places: int) -> str:
    return f"{metres / report.small:.{places}f}" if isfinite(metres) else ""


def _words(report: Report, *, plan: bool, heights: bool) -> str:
    words = ["distance: slope distance"]
    if heights:
        words.append("rise: height difference along the vertical of the midpoint")
    if plan:
        words.append("azimuth: clockwise from north, at the first place")
        k, asked = factor(report, 2), report.options.confidence
        level = "standard ellipses" if asked is None else f"{percent(asked)} ellipses"
        words.append(f"a, b: relative {level}, {k:.3f} × standard ellipse")
    return "; ".join(words)


def lines_table(report: Report) -> str:
    """Return relative.csv; empty if the options ask for no lines."""
    found, small, angle = report.lines, report.units.sigma_length, angle_unit(report)
    if not found:
        return ""
    length = report.units.length

    def sizes(values: list[float]) -> list[str]:
        return [figure(v / report.small) for v in values]

    def turns(values: list[float]) -> list[str]:
        return [exact(v, angle) if isfinite(v) else "" for v in values]

    confidence = report.options.confidence
    return write_columns(
        {
            "from": [place_name(x.a) for x in found],
            "to": [place_name(x.b) for x in found],
            "distance": [exact(x.distance, length) for x in found],
            "rise": [exact(x.rise, length) for x in found],
            "unit": [length] * len(found),
            f"sigma_distance_{small}": sizes([x.sigma_distance for x in found]),
            "ppm": [figure(x.ppm) for x in found],
            f"sigma_rise_{small}": sizes([x.sigma_rise for x in found]),
            f"azimuth_{angle}": turns([x.azimuth for x in found]),
            f"sigma_azimuth_{report.units.sigma_angle}": [
                figure(x.sigma_azimuth / report.radian) for x in found
            ],
            "confidence": ["" if confidence is None else f"{confidence:g}"] * len(found),
            f"ellipse_major_{small}": sizes([x.ellipse.semi_axes[0] for x in found]),
            f"ellipse_minor_{small}": sizes([x.ellipse.semi_axes[1] for x in found]),
            f"ellipse_azimuth_{angle}": [figure(x.ellipse.azimuth / ANGLE[angle]) for x in found],
        }
    )


def line_record(line: AdjustedLine) -> dict[str, Any]:
    """Return a line for results.json, in metres and radians."""
    e = line.ellipse
    return {
        "from": place_name(line.a),
        "to": place_name(line.b),
        "distance": line.distance,
        "sigma_distance": line.sigma_distance,
        "azimuth": line.azimuth,
        "sigma_azimuth": line.sigma_azimuth,
        "rise": line.rise,
        "sigma_rise": line.sigma_rise,
        "ellipse": {
            "semi_axes": list(e.semi_axes),
            "azimuth": e.azimuth,
            "confidence": e.confidence,
            "factor": e.factor,
        },
    }

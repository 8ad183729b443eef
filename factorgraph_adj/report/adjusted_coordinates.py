"""Adjusted points, check points, photos and lines: coordinates, σ and error ellipses.

Error ellipses of points and ellipsoids of projection centres are given if the options ask for
them, and so are adjusted lines between pairs of places with their relative error ellipses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import nan, sqrt
from typing import Any

import numpy as np

from ..quality.derived_quantities import AdjustedLine
from ..quality.error_ellipses import ErrorEllipse, confidence_factor
from ..quality.point_precision import Place, place_variable
from ..units import ANGLE, decimal, format_angle
from .adjustment_report import Report
from .layout import decimals, exponent, figure, paragraph, percent, short, table, title
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


def angle_unit(report: Report) -> str:
    """Return the unit of azimuths in tables; it is decimal degrees for degrees-minutes-seconds."""
    return report.units.angle if report.units.angle in ANGLE else "deg"


def rounded_azimuth(report: Report, angle: float) -> str:
    """Write an azimuth or dip with the decimals of `DECIMALS_OF_AZIMUTH`."""
    if report.units.angle == "dms":
        return format_angle(angle, "dms", 0)
    digits = DECIMALS_OF_AZIMUTH[report.units.angle]
    value = round(angle / ANGLE[report.units.angle], digits)
    return decimal(value, max(digits, 0))


def ellipse_columns(
    report: Report,
    ellipse: Callable[[Any], ErrorEllipse],
    digits: int,
    readable: tuple[Rendering, ...],
) -> list[Column[Any]]:
    """Return the columns of error ellipses: semi-axes, and the azimuth of the larger one.

    Args:
        report: the report.
        ellipse: the ellipse of a row.
        digits: decimals of the semi-axes.
        readable: renderings for people that have them.
    """

    def turn(row: Any) -> str:
        e = ellipse(row)
        return rounded_azimuth(report, e.azimuth) if e.semi_axes[0] > 0 else ""

    azimuth = Column[Any](
        title="azimuth_a",
        key="ellipse_azimuth",
        value=lambda row: ellipse(row).azimuth,
        unit=unit_of(angle_unit(report)),
        suffix=True,
        only=("csv",),
    )
    semi_axes = [
        Column[Any](
            title=name,
            key=key,
            value=lambda row, i=i: ellipse(row).semi_axes[i],  # type: ignore[misc]
            unit=Unit(report.units.sigma_length, report.small),
            digits=digits,
            suffix=True,
            only=(*readable, "csv"),
        )
        for i, (name, key) in enumerate((("a", "ellipse_major"), ("b", "ellipse_minor")))
    ]
    shown = replace(azimuth, unit=unit_of(report.units.angle), shown=turn, only=readable)
    return [*semi_axes, shown, azimuth]


def centre_ellipsoids_section(report: Report) -> list[str]:
    """Return the section of error ellipsoids of the projection centres."""
    if report.options.confidence is None or not report.ellipsoids:
        return []
    sizes = (a / report.small for e in report.ellipsoids.values() for a in e.semi_axes)
    places = decimals(sizes, default=2, most=5)
    names, note = report.cut(list(report.ellipsoids), "photos", "photos.csv")
    rows = []
    for name in names:
        e = report.ellipsoids[name]
        cells = [name]
        for size, azimuth, dip in zip(e.semi_axes, e.azimuths, e.dips, strict=True):
            angles = (
                [rounded_azimuth(report, azimuth), rounded_azimuth(report, dip)]
                if size > 0
                else ["", ""]
            )
            cells += [f"{size / report.small:.{places}f}", *angles]
        rows.append(cells)
    unit, angle = report.units.sigma_length, report.units.angle
    header = ["photo"]
    for axis in "abc":
        header += [f"{axis} [{unit}]", f"azimuth [{angle}]", "dip"]
    heading = (
        f"Projection centres: {percent(report.options.confidence)} error ellipsoids, "
        f"{region_factor(report, 3):.3f} × standard ellipsoid"
    )
    return [*title(heading), *table(header, rows), *note]


# -- columns of tables ----------------------------------------------------------------------------


def photo_ellipsoid_columns(report: Report) -> dict[str, list[str]]:
    """Return the columns of photos.csv; empty without a confidence."""
    if report.options.confidence is None:
        return {}
    small, angle = report.units.sigma_length, angle_unit(report)
    names, found = list(report.network.photos), report.ellipsoids
    out = {"confidence": [f"{report.options.confidence:g}" if n in found else "" for n in names]}
    for i in range(3):
        for what, unit, size in (
            ("semi_axes", small, report.small),
            ("azimuths", angle, ANGLE[angle]),
            ("dips", angle, ANGLE[angle]),
        ):
            noun = {"semi_axes": "axis", "azimuths": "azimuth", "dips": "dip"}[what]
            out[f"ellipsoid_{noun}{i + 1}_{unit}"] = [
                figure(getattr(found[n], what)[i] / size) if n in found else "" for n in names
            ]
    return out


NOT_AT_A_MINIMUM = (
    "not converged: standard deviations belong to the place where the iteration stopped; at a "
    "minimum they may be several times larger or smaller"
)
"""What is said of the precision of a result that is none."""


def decimals_of_points(report: Report) -> tuple[int, int]:
    """Return the decimals of σ of points, and those of coordinates, which show as much."""
    free = [n for n in report.network.points if report.free("point", n)]
    names = [] if report.singular else free
    sigmas = (s / report.small for n in names for s in report.sigmas[n])
    places = decimals(sigmas, default=2, most=5)
    return places, min(max(places + exponent(report.metre / report.small * 1.0001), 0), 9)


def photos_section(report: Report) -> list[str]:
    """Return exterior orientation, standard deviations, number of points and RMS of each photo."""
    network, units = report.network, report.units
    if not network.photos:
        return []
    counts, norms = image_statistics_by_photo(report)
    digits = {"dms": 1, "rad": 6, "mrad": 3, "mgon": 1, "cc": 0, "arcsec": 0}.get(units.angle, 4)
    names, note = report.cut(list(network.photos), "photos", "photos.csv")
    rows = []
    for name in names:
        pose = report.poses[name]
        place = [decimal(v / report.metre, 4) for v in pose.position]
        angles = [format_angle(v, units.angle, digits) for v in pose.angles]
        rows.append(
            [
                name,
                str(counts[name]),
                f"{norms[name]:.2f}" if counts[name] else "–",
                *place,
                *angles,
            ]
        )
        if not report.free("pose", name):
            rows.append(["", "", "", *["held"] * 6])
            continue
        about = [s / report.radian for s in pose.sigma_angles]
        centre = [s / report.small for s in pose.sigma_position]
        sigmas = zip(
            [*centre, *about], held_components_of_pose(network.photos[name].fixed), strict=True
        )
        label = f"σ [{units.sigma_length}, {units.sigma_angle}]"
        rows.append(["", "", label, *("held" if held else short(s) for s, held in sigmas)])
    header = ["photo", "points", "RMS v/σ", *(f"{a} [{units.length}]" for a in ("X0", "Y0", "Z0"))]
    header += [f"{a} [{units.angle}]" for a in "ωφκ"]
    stopped = [] if report.solution.converged else [f"  {NOT_AT_A_MINIMUM}"]
    return [*title("Photos"), *table(header, rows), *note, *stopped]


def held_components_of_pose(fixed: tuple[bool, ...]) -> tuple[bool, ...]:
    """Return whether X0, Y0, Z0, ω, φ, κ are held; an angle is held if all rotations are."""
    return (*fixed[3:], *[all(fixed[:3])] * 3)


def image_statistics_by_photo(report: Report) -> tuple[dict[str, int], dict[str, float]]:
    """Return number of image points and RMS v/σ of each photo."""
    names = list(report.network.photos)
    counts, squares = dict.fromkeys(names, 0), dict.fromkeys(names, 0.0)
    normalised = report.solution.observations.normalised
    for block in report.solution.equations.blocks:
        if not block.image:
            continue
        v = normalised[block.rows].reshape(block.observed.shape)
        each = (v * v).sum(axis=1).tolist()
        for photo, square in zip(block.variables[0][1].tolist(), each, strict=True):
            counts[names[photo]] += 1
            squares[names[photo]] += square
    return counts, {n: sqrt(squares[n] / (2 * c)) if c else nan for n, c in counts.items()}


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
    fine_angle, decimal_unit = Unit(units.sigma_angle, report.radian), unit_of(angle_unit(report))
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
        *ellipse_columns(report, lambda x: x.ellipse, fine, READ if plan else ("html",)),
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

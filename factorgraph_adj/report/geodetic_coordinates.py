"""Report of latitude, longitude, height of points; of grid places of points and photos, with σ.

Both are sections of the text report and columns of points.csv and photos.csv.
"""

from __future__ import annotations

from dataclasses import replace
from math import log10, pi
from typing import Any

import numpy as np

from ..crs.grid_places import GridPlaces
from ..frames import MEAN_EARTH_RADIUS, Frame, GeocentricFrame, LocalFrame
from ..units import ANGLE, decimal, decimal_angle, format_angle
from .adjusted_coordinates import decimals_of_points
from .adjustment_report import Report
from .layout import exponent, paragraph, table, title
from .tables import DATA, Column, FiguresByNumber, Unit, unit_of

COMPASS_WORDS = {"e": "east", "w": "west", "n": "north", "s": "south"}
"""Names of the axes of local frames."""
EAST_NORTH_UP = ("east", "north", "up")
ANGLE_DIGIT_TOLERANCE = 0.1
"""Part of a decimal by which the last digit of an angle may be coarser than that of a length."""
RESOLVED_DECIMALS = 8
"""Decimals of a metre that latitude, longitude and height have in tables: they are computed from
X Y Z, of which float64 resolves 1e-9 m at the distance of the Earth's centre."""
GEOGRAPHIC_UNIT_NAMES = {"dms": "degrees-minutes-seconds", "deg": "decimal degrees", "gon": "gon"}
"""Names of units of latitudes and longitudes."""
GRID_COLUMNS = ("easting", "northing", "grid_height")
"""Columns of tables, where ``height`` is the ellipsoidal one."""
RESOLUTION_IN_TEXT_RAD, RESOLUTION_IN_TABLES_RAD = 1e-6, 1e-9
"""Resolution of the convergence and of ω, φ, κ in the text report and in tables, radians."""


def geographic_section(report: Report) -> list[str]:
    """Return latitude, longitude and height of the points with σ in east, north and up."""
    frame, found, given = report.network.frame, report.geographic, report.network.points
    names = [n for n in given if report.free("point", n)]
    if found is None or isinstance(frame, LocalFrame) or not names:
        return []
    number = report.solution.equations.unknowns["point"].number
    places, digits = decimals_of_points(report)
    unit, length, small = report.units.geographic, report.units.length, report.units.sigma_length
    fine = angle_digits(unit, digits, report.metre)
    shown, note = report.cut(list(given), "points", "points.csv")
    rows = []
    for name in shown:
        i = number[name]
        angles = (float(a[i]) for a in (found.latitude, found.longitude))
        sigma = [f"{s / report.small:.{places}f}" for s in found.sigma[i].tolist()]
        rows.append(
            [
                name,
                *(format_angle(a, unit, fine) for a in angles),
                decimal(float(found.height[i]) / report.metre, digits),
                *(sigma if report.free("point", name) else ["held"] * 3),
            ]
        )
    header = ["point", f"latitude [{unit}]", f"longitude [{unit}]", f"height [{length}]"]
    header += [f"σ {a} [{small}]" for a in EAST_NORTH_UP]
    words = (
        "latitude (north positive) and longitude (east positive) in "
        f"{GEOGRAPHIC_UNIT_NAMES.get(unit, unit)}, "
        "height above the ellipsoid; σ along east, north and up at the point"
    )
    heading = f"Latitude, longitude and ellipsoidal height ({frame.ellipsoid_name})"
    return [*title(heading), *table(header, rows), *note, *paragraph(words)]


def angle_digits(unit: str, digits: int, metre: float) -> int:
    """Return the decimals of a latitude that show as much as ``digits`` decimals of a length.

    Args:
        unit: unit of the latitude.
        digits: decimals of the length.
        metre: unit of the length, metres.
    """
    one = MEAN_EARTH_RADIUS * ANGLE["arcsec" if unit == "dms" else unit] / metre
    return max(int(-(-(digits + log10(one) - ANGLE_DIGIT_TOLERANCE) // 1)), 0)


def geographic_columns(report: Report, digits: int) -> list[Column[Any]]:
    """Return the columns of points; none in a local frame.

    Args:
        report: the report.
        digits: decimals of lengths where people read them.
    """
    found = report.geographic
    if found is None:
        return []
    units, unit = report.units, unit_of(report.units.geographic)
    angle = {
        "unit": unit,
        "digits": angle_digits(unit.name, digits, report.metre),
        "resolved": angle_digits(unit.name, RESOLVED_DECIMALS, 1.0),
        "only": ("html", *DATA),
    }
    height = {
        "unit": Unit(units.length, report.metre),
        "digits": digits,
        "resolved": _resolved(report),
        "only": ("html", *DATA),
    }
    columns: list[Column[Any]] = [
        Column(title="latitude", value=FiguresByNumber(found.latitude), **angle),  # type: ignore[arg-type]
        Column(title="longitude", value=FiguresByNumber(found.longitude), **angle),  # type: ignore[arg-type]
        Column(title="geographic_unit", value=lambda row: unit.name, only=("csv",)),
        Column(title="height", value=FiguresByNumber(found.height), **height),  # type: ignore[arg-type]
        Column(title="sigma_east_north_up", value=FiguresByNumber(found.sigma), only=("json",)),
    ]
    return columns + [
        Column(
            title=f"σ{a[0].upper()}",
            key=f"sigma_{a}",
            value=FiguresByNumber(found.sigma[:, i]),
            unit=Unit(units.sigma_length, report.small),
            suffix=True,
            only=("html", "csv", "frame"),
        )
        for i, a in enumerate(EAST_NORTH_UP)
    ]


def _resolved(report: Report) -> int:
    """Return the decimals that computed lengths have in tables, see `RESOLVED_DECIMALS`."""
    return max(RESOLVED_DECIMALS + exponent(report.metre), 0)


def frame_in_words(frame: Frame) -> str:
    """Return what the axes of a frame are, and where it is."""
    if isinstance(frame, LocalFrame):
        x, y = (COMPASS_WORDS[a] for a in frame.axes)
        shape = f"curved, R = {frame.radius:.0f} m" if frame.curvature else "flat"
        return f"local, x {x}, y {y}, z up, {shape}"
    if isinstance(frame, GeocentricFrame):
        return f"geocentric, ellipsoid {frame.ellipsoid_name}"
    place = ", ".join(format_angle(a, "dms", 4) for a in (frame.latitude, frame.longitude))
    return f"topocentric (east, north, up) at {place}, ellipsoid {frame.ellipsoid_name}"


def reference_system_line(report: Report) -> list[str]:
    """Return the line of the overview that names the reference system."""
    system = report.network.crs
    if system is None:
        return []
    if report.no_grid:
        return [f"  system         {system.definition}"]
    return [f"  system         {system.name}; heights: {system.vertical}"]


def grid_section(report: Report) -> list[str]:
    """Return easting, northing and height with σ, convergence and factors of the points."""
    found, system = report.grid, report.network.crs
    if system is None or isinstance(report.network.frame, LocalFrame):
        return []
    if found is None:
        return [*title("Grid coordinates"), *paragraph(f"none: {report.no_grid}")]
    if not found.names:
        return []
    places, digits = decimals_of_points(report)
    p, angle = found.places, report.units.angle
    shown, note = report.cut(list(found.names), "points", "points.csv")
    number = {n: i for i, n in enumerate(found.names)}
    rows = []
    for name in shown:
        i = number[name]
        sigma = [f"{s / report.small:.{places}f}" for s in p.sigma[i].tolist()]
        rows.append(
            [
                name,
                *(decimal(v / report.metre, digits) for v in p.coordinates[i].tolist()),
                *(sigma if report.free("point", name) else ["held"] * 3),
                _signed(float(p.convergence[i]), angle),
                f"{(p.scale[i] - 1.0) * 1e6:+.1f}",
                f"{(p.combined[i] - 1.0) * 1e6:+.1f}",
            ]
        )
    length, small = report.units.length, report.units.sigma_length
    header = ["point", *(f"{a} [{length}]" for a in "ENH"), *(f"σ {a} [{small}]" for a in "ENH")]
    header += [f"γ [{angle}]", "k−1 [ppm]", "c−1 [ppm]"]
    words = (
        f"{system.name}; heights: {system.vertical}. γ is the azimuth of grid north, k the scale "
        "of the projection, c the combined factor: length in the grid / level length at the point"
    )
    return [*title("Grid coordinates"), *table(header, rows), *note, *paragraph(words)]


def grid_photos_section(report: Report) -> list[str]:
    """Return easting, northing and height of the photos, and ω, φ, κ from the axes of the grid."""
    found = report.grid_photos
    if found is None or isinstance(report.network.frame, LocalFrame) or not found.names:
        return []
    places, digits = decimals_of_points(report)
    angle, length = report.units.angle, report.units.length
    small, small_angle = report.units.sigma_length, report.units.sigma_angle
    shown, note = report.cut(list(found.names), "photos", "photos.csv")
    rows = []
    for i, name in enumerate(shown):
        sigma = [f"{s / report.small:.{places}f}" for s in found.places.sigma[i].tolist()]
        turns = [f"{s / report.radian:.2f}" for s in found.sigma_angles[i].tolist()]
        at = found.places.coordinates[i].tolist()
        shown_angles = (_signed(v, angle) for v in found.angles[i].tolist())
        rows.append([name, *(decimal(v / report.metre, digits) for v in at), *shown_angles])
        if report.free("pose", name):
            rows.append([f"σ [{small}, {small_angle}]", *sigma, *turns])
    header = ["photo", *(f"{a} [{length}]" for a in "ENH"), *(f"{a} [{angle}]" for a in "ωφκ")]
    words = "ω, φ, κ count from easting, northing and the vertical at the photo"
    heading = "Exterior orientation in the grid"
    return [*title(heading), *table(header, rows), *note, *paragraph(words)]


def _signed(value: float, unit: str, fine: float = RESOLUTION_IN_TEXT_RAD) -> str:
    """Return an angle from −π to π to some fine."""
    wrapped = (value + pi) % (2.0 * pi) - pi
    one = ANGLE["arcsec" if unit == "dms" else unit]
    return format_angle(wrapped, unit, max(int(-np.floor(np.log10(fine / one))), 0))


def grid_columns(report: Report) -> list[Column[Any]]:
    """Return the columns of points; none without grid coordinates."""
    found = report.grid
    if found is None or isinstance(report.network.frame, LocalFrame):
        return []
    p = found.places
    columns: list[Column[Any]] = [
        Column(title="grid", value=FiguresByNumber(p.coordinates), only=("json",)),
        Column(title="sigma_grid", value=FiguresByNumber(p.sigma), only=("json",)),
    ]
    columns += _grid_places(report, p)
    columns += [
        Column(
            title="undulation",
            value=FiguresByNumber(p.undulation),
            unit=Unit(report.units.length, report.metre),
            resolved=_resolved(report),
            only=("csv",),
        ),
        Column(
            title="convergence",
            value=FiguresByNumber(p.convergence),
            unit=unit_of(decimal_angle(report.units.angle)),
            suffix=True,
            only=("csv", "json"),
        ),
    ]
    for key, factors in (("scale", p.scale), ("combined_factor", p.combined)):
        columns.append(Column(title=key, value=FiguresByNumber(factors), only=("json",)))
        texts = [f"{v:.10f}" for v in factors.tolist()]
        columns.append(Column(title=key, value=lambda row, t=texts: t[row.number], only=("csv",)))  # type: ignore[misc]
    return columns


def grid_photo_columns(report: Report) -> list[Column[Any]]:
    """Return the columns of photos; none without grid coordinates."""
    found = report.grid_photos
    if found is None or isinstance(report.network.frame, LocalFrame):
        return []
    p, units = found.places, report.units
    columns = _grid_places(report, p)
    for i, a in enumerate(("omega", "phi", "kappa")):
        values = found.angles[:, i].tolist()
        texts = [_signed(v, units.angle, RESOLUTION_IN_TABLES_RAD) for v in values]
        angle = Column[Any](
            title=f"{a}_grid",
            value=lambda row, t=texts: t[row.number],  # type: ignore[misc]
            only=("csv",),
        )
        columns.insert(len(GRID_COLUMNS) + i, angle)
        columns.append(
            replace(
                angle,
                title=f"sigma_{a}_grid",
                value=FiguresByNumber(found.sigma_angles[:, i]),
                unit=Unit(units.sigma_angle, report.radian),
                suffix=True,
            )
        )
    return columns


def _grid_places(report: Report, places: GridPlaces) -> list[Column[Any]]:
    """Return the columns of easting, northing and height with σ."""
    length, small = (
        Unit(report.units.length, report.metre),
        Unit(report.units.sigma_length, report.small),
    )
    coordinates: list[Column[Any]] = [
        Column(
            title=a,
            value=FiguresByNumber(places.coordinates[:, i]),
            unit=length,
            resolved=_resolved(report),
            only=("csv",),
        )
        for i, a in enumerate(GRID_COLUMNS)
    ]
    return coordinates + [
        Column(
            title=f"sigma_{a}",
            value=FiguresByNumber(places.sigma[:, i]),
            unit=small,
            suffix=True,
            only=("csv",),
        )
        for i, a in enumerate(GRID_COLUMNS)
    ]

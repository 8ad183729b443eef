"""Latitude, longitude and ellipsoidal height of points: a section of the protocol and columns."""

from __future__ import annotations

from math import log10

from ..frames import MEAN_EARTH_RADIUS, LocalFrame
from ..types import Array
from ..units import ANGLE, decimal, format_angle
from .context import Report
from .coordinates import digits_of_points
from .layout import exponent, paragraph, table, title
from .observation_tables import figures
from .rows import tidy

ENU = ("east", "north", "up")
MARGIN = 0.1
"""Part of a decimal by which the last digit of an angle may be coarser than that of a length."""
RESOLVED = 8
"""Decimals of a metre that latitude, longitude and height have in tables: they are computed from
X Y Z, of which float64 resolves 1e-9 m at the distance of the Earth's centre."""
WORDS = {"dms": "degrees-minutes-seconds", "deg": "decimal degrees", "gon": "gon"}
"""Names of units of latitudes and longitudes."""


def geographic(report: Report) -> list[str]:
    """Return latitude, longitude and height of the points with σ in east, north and up."""
    frame, found, given = report.network.frame, report.geographic, report.network.points
    names = [n for n in given if report.free("point", n)]
    if found is None or isinstance(frame, LocalFrame) or not names:
        return []
    number = report.solution.equations.unknowns["point"].number
    places, digits = digits_of_points(report)
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
    header += [f"σ {a} [{small}]" for a in ENU]
    words = (
        f"latitude (north positive) and longitude (east positive) in {WORDS.get(unit, unit)}, "
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
    return max(int(-(-(digits + log10(one) - MARGIN) // 1)), 0)


def geographic_columns(report: Report) -> dict[str, list[str]]:
    """Return the columns of points.csv; none in a local frame."""
    found = report.geographic
    if found is None:
        return {}
    unit, small = report.units.geographic, report.units.sigma_length
    length, metre = report.units.length, report.metre
    fine, digits = angle_digits(unit, RESOLVED, 1.0), max(RESOLVED + exponent(metre), 0)

    def angles(values: Array) -> list[str]:
        return [tidy(format_angle(v, unit, fine), unit) for v in values.tolist()]

    out = {
        "latitude": angles(found.latitude),
        "longitude": angles(found.longitude),
        "geographic_unit": [unit] * len(found.height),
        "height": [tidy(decimal(v / metre, digits), length) for v in found.height.tolist()],
    }
    return out | {
        f"sigma_{a}_{small}": figures(found.sigma[:, i] / report.small) for i, a in enumerate(ENU)
    }

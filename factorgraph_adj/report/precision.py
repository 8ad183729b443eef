"""Error ellipses of points and ellipsoids of projection centres, if the options ask for them."""

from __future__ import annotations

from functools import partial
from math import isfinite

import numpy as np

from ..quality.ellipses import confidence_factor
from ..units import ANGLE, decimal, format_angle
from .context import Report
from .layout import decimals, percent, table, title

COARSE = {"rad": 4, "mrad": 1, "gon": 1, "mgon": -2, "cc": -3, "deg": 1, "arcmin": 0, "arcsec": -2}
"""Decimals of azimuths and dips of ellipses by unit; further digits are not significant."""


def factor(report: Report, dimension: int) -> float:
    """Return the factor from standard deviations to a region of the requested confidence."""
    s = report.solution
    estimated = s.variance == "a-posteriori" and s.redundancy > 0
    known = s.redundancy if estimated else None
    return confidence_factor(dimension, report.options.confidence, redundancy=known)


def half_widths(report: Report) -> dict[str, float]:
    """Return half the confidence interval of each point's height, metres."""
    solution = report.solution
    at = solution.state["point"]
    up = solution.network.frame.basis(at, np.zeros((len(at), 2))).enu[:, 2]
    variance = np.einsum("ni,nij,nj->n", up, solution.point_covariances, up)
    found = factor(report, 1) * np.sqrt(np.maximum(variance, 0.0))
    names = solution.equations.unknowns["point"].names
    return dict(zip(names, found.tolist(), strict=True))


def angle_unit(report: Report) -> str:
    """Return the unit of azimuths in tables; it is decimal degrees for degrees-minutes-seconds."""
    return report.units.angle if report.units.angle in ANGLE else "deg"


def coarse(report: Report, angle: float) -> str:
    """Write an azimuth or dip with the decimals of `COARSE`."""
    if report.units.angle == "dms":
        return format_angle(angle, "dms", 0)
    digits = COARSE[report.units.angle]
    value = round(angle / ANGLE[report.units.angle], digits)
    return decimal(value, max(digits, 0))


def ellipse_columns(report: Report, places: int) -> tuple[list[str], dict[str, list[str]], str]:
    """Return header, cells by point and a note that explains the confidence figures of points.

    The figures are ellipses if plan coordinates are unknown, intervals if only heights are.

    Args:
        report: a report with a confidence.
        places: decimals of lengths.
    """
    if report.options.confidence is None:
        return [], {}, ""
    unit, level = report.units.sigma_length, percent(report.options.confidence)
    given = report.network.points
    names = [n for n in given if report.free("point", n)]
    write = partial(_length, report=report, places=places)
    if all(given[n].fixed[0] and given[n].fixed[1] for n in names):
        widths = half_widths(report)
        note = f"  ± z: {level} interval, {factor(report, 1):.3f} σ"
        return [f"± z [{unit}]"], {n: [write(widths[n])] for n in names}, note
    cells = {}
    for name in names:
        e = report.ellipses[name]
        azimuth = coarse(report, e.azimuth) if e.semi_axes[0] > 0 else ""
        cells[name] = [*(write(a) for a in e.semi_axes), azimuth]
    header = [f"a [{unit}]", f"b [{unit}]", f"azimuth a [{report.units.angle}]"]
    k = factor(report, 2)
    note = f"  a, b: {level} error ellipses in the horizon, {k:.3f} × standard ellipse"
    if any(0 < report.ellipses[n].factor < k - 1e-9 for n in names):
        note += f"; {factor(report, 1):.3f} × where an axis is held"
    return header, cells, note


def _length(metres: float, *, report: Report, places: int) -> str:
    return f"{metres / report.small:.{places}f}"


def centres(report: Report) -> list[str]:
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
            angles = [coarse(report, azimuth), coarse(report, dip)] if size > 0 else ["", ""]
            cells += [f"{size / report.small:.{places}f}", *angles]
        rows.append(cells)
    unit, angle = report.units.sigma_length, report.units.angle
    header = ["photo"]
    for axis in "abc":
        header += [f"{axis} [{unit}]", f"azimuth [{angle}]", "dip"]
    heading = (
        f"Projection centres: {percent(report.options.confidence)} error ellipsoids, "
        f"{factor(report, 3):.3f} × standard ellipsoid"
    )
    return [*title(heading), *table(header, rows), *note]


# -- columns of tables ----------------------------------------------------------------------------


def point_columns(report: Report) -> dict[str, list[str]]:
    """Return the columns of points.csv; empty without a confidence."""
    if report.options.confidence is None:
        return {}
    small, angle = report.units.sigma_length, angle_unit(report)
    ellipses, widths = report.ellipses, half_widths(report)
    names = list(report.network.points)
    return {
        "confidence": [f"{report.options.confidence:g}"] * len(names),
        f"ellipse_major_{small}": [figure(ellipses[n].semi_axes[0] / report.small) for n in names],
        f"ellipse_minor_{small}": [figure(ellipses[n].semi_axes[1] / report.small) for n in names],
        f"ellipse_azimuth_{angle}": [figure(ellipses[n].azimuth / ANGLE[angle]) for n in names],
        f"height_half_width_{small}": [figure(widths[n] / report.small) for n in names],
    }


def photo_columns(report: Report) -> dict[str, list[str]]:
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


def figure(value: float) -> str:
    """Return a derived figure with enough digits for further use; empty if not finite.

    >>> figure(-0.0), figure(float("nan"))
    ('0', '')
    """
    return f"{value + 0.0:.9g}" if isfinite(value) else ""

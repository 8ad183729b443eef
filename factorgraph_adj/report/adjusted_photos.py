"""Adjusted photos as table, text, arrays: orientation, σ, image RMS; ellipsoids of centres."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import isfinite, nan, sqrt
from typing import Any

import numpy as np

from ..columns import Columns
from ..quality.error_ellipses import ErrorEllipsoid
from ..solve.solution import Solution
from ..units import decimal_angle
from .adjusted_coordinates import NOT_AT_A_MINIMUM, region_factor, rounded_azimuth
from .adjusted_points import has_values
from .adjustment_report import Report
from .exterior_orientations import PoseFigures
from .geodetic_coordinates import grid_photo_columns
from .layout import decimals, percent, table, title
from .tables import (
    NO_FIGURE,
    READ,
    ArrayRows,
    Column,
    FiguresByNumber,
    Table,
    Unit,
    as_frame,
    as_text,
    unit_of,
)

DECIMALS_OF_ANGLES = {"dms": 1, "rad": 6, "mrad": 3, "mgon": 1, "cc": 0, "arcsec": 0}
"""Decimals of ω, φ, κ by unit; otherwise four."""
ANGLES = {"ω": "omega", "φ": "phi", "κ": "kappa"}
"""Names of the angles in files."""


@dataclass(frozen=True)
class AdjustedPhoto:
    """A photo as a row of tables."""

    number: int
    """Number of the photo in its network."""
    name: str
    """Its name."""
    camera: str
    """Name of its camera."""


def photos_table(report: Report) -> Table[AdjustedPhoto]:
    """Return the table of adjusted photos."""
    photos = report.network.photos
    cameras, numbers = [f.camera for f in photos.values()], np.arange(len(photos))
    rows = ArrayRows.of(AdjustedPhoto, number=numbers, name=list(photos), camera=cameras)
    return Table("photos", rows, photo_columns(report))


def photo_columns(report: Report) -> list[Column[AdjustedPhoto]]:
    """Return the columns of photos; without convergence and covariance, how their images fit."""
    counts, norms = (
        FiguresByNumber(lambda i=i: np.array(list(image_statistics_by_photo(report)[i].values())))  # type: ignore[misc]
        for i in range(2)
    )
    count = Column[AdjustedPhoto](title="points", key="image_points", value=counts, only=READ)
    fit = Column[AdjustedPhoto](
        title="RMS v/σ",
        key="normalised_rms",
        value=norms,
        digits=2,
        shown=lambda row: None if counts(row) else NO_FIGURE,
        only=READ,
    )
    return [
        Column(title="photo", key="name", value="name"),
        Column(title="camera", value="camera", only=("html", "csv", "frame")),
        count,
        fit,
        *(_orientation(report) if has_values(report) else ()),
        replace(count, only=("csv",)),
        replace(fit, only=("csv",)),
    ]


def photo_frame(solution: Solution) -> Columns:
    """Return the adjusted photos as arrays, metres and radians.

    Raises:
        SingularError: there is no covariance.
    """
    report = Report(solution)
    _ = report.poses
    return as_frame(photos_table(report))


def _orientation(report: Report) -> Iterator[Column[AdjustedPhoto]]:
    units, radians = report.units, unit_of(report.units.angle)
    metre, small = Unit(units.length, report.metre), Unit(units.sigma_length, report.small)
    small_angle = Unit(units.sigma_angle, report.radian)
    digits, data = DECIMALS_OF_ANGLES.get(units.angle, 4), ("csv", "frame")

    def figures(part: Callable[[PoseFigures], Any]) -> FiguresByNumber:
        return FiguresByNumber(lambda: np.array([part(p) for p in report.poses.values()]))

    def of(name: str, i: int) -> FiguresByNumber:
        return figures(lambda pose: getattr(pose, name)[i])

    def record(key: str, name: str) -> Column[AdjustedPhoto]:
        whole = figures(lambda pose: getattr(pose, name))
        return Column[AdjustedPhoto](title=key, value=whole, only=("json",))

    yield record("position", "position")
    yield record("world_R_camera", "rotation")
    yield record("omega_phi_kappa", "angles")
    if not report.singular:
        yield record("sigma_position", "sigma_position")
        yield record("sigma_omega_phi_kappa", "sigma_angles")
    place = {"unit": metre, "digits": 4, "exact": True, "only": (*READ, *data)}
    turn = {"unit": radians, "digits": digits, "exact": True, "only": (*READ, *data)}
    for i, a in enumerate("xyz"):
        yield Column(title=f"{a.upper()}0", key=a, value=of("position", i), **place)  # type: ignore[arg-type]
    yield Column(title="unit", value=lambda row: units.length, only=("csv",))
    for i, (sign, a) in enumerate(ANGLES.items()):
        yield Column(title=sign, key=a, value=of("angles", i), **turn)  # type: ignore[arg-type]
    yield Column(title="angle_unit", value=lambda row: units.angle, only=("csv",))
    if report.singular:
        return
    label = f"σ [{units.sigma_length}, {units.sigma_angle}]"
    yield Column(
        title="σ",
        value=lambda row: label if report.free("pose", row.name) else None,
        below="RMS v/σ",
        only=("text",),
    )
    for i, a in enumerate("xyz"):
        yield from _sigma(report, f"{a.upper()}0", f"sigma_{a}", of("sigma_position", i), small, i)
    for i, (sign, a) in enumerate(ANGLES.items()):
        value = of("sigma_angles", i)
        yield from _sigma(report, sign, f"sigma_{a}", value, small_angle, 3 + i)
    for i, a in enumerate("xyz"):
        yield Column(
            title=f"sigma_r{a}",
            value=of("sigma_rotations", i),
            unit=small_angle,
            only=("frame",),
        )
    yield from grid_photo_columns(report)
    yield from _ellipsoid(report)


def _sigma(
    report: Report,
    sign: str,
    key: str,
    value: FiguresByNumber,
    unit: Unit,
    component: int,
) -> Iterator[Column[AdjustedPhoto]]:
    """Return σ of a component, which text has below its value."""
    photos = report.network.photos

    def shown(row: AdjustedPhoto) -> str | None:
        held = held_components_of_pose(photos[row.name].fixed)[component]
        if held or not report.free("pose", row.name):
            return "held"
        return None if isfinite(value(row)) else NO_FIGURE

    column = Column[AdjustedPhoto](
        title=f"σ {sign}",
        key=key,
        value=value,
        unit=unit,
        suffix=True,
        shown=shown,
        translated=True,
        below=sign,
    )
    # Those of rotations about the axes of the camera stand in frames, not those of ω, φ, κ.
    yield replace(column, only=(*READ, "csv") if component >= 3 else (*READ, "csv", "frame"))


def _ellipsoid(report: Report) -> Iterator[Column[AdjustedPhoto]]:
    """Return the error ellipsoids of the projection centres."""
    confidence, found = report.options.confidence, report.ellipsoids
    if confidence is None:
        return

    def of(part: Callable[[ErrorEllipsoid], float]) -> Callable[[AdjustedPhoto], float | None]:
        return lambda row: part(found[row.name]) if row.name in found else None

    small, angle = unit_of(report.units.sigma_length), unit_of(decimal_angle(report.units.angle))
    yield Column(title="confidence", value=of(lambda e: confidence), only=("csv",))
    for i in range(3):
        for noun, members, unit in (
            ("axis", "semi_axes", small),
            ("azimuth", "azimuths", angle),
            ("dip", "dips", angle),
        ):
            yield Column(
                title=f"ellipsoid_{noun}{i + 1}",
                value=of(lambda e, m=members, i=i: getattr(e, m)[i]),  # type: ignore[misc]
                unit=unit,
                suffix=True,
                only=("csv",),
            )


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


# -- text -----------------------------------------------------------------------------------------


def photos_section(report: Report) -> list[str]:
    """Return exterior orientation, standard deviations, number of points and RMS of each photo."""
    if not report.network.photos:
        return []
    made = photos_table(report)
    rows, note = report.cut(list(made.rows), "photos", "photos.csv")
    stopped = [] if report.solution.converged else [f"  {NOT_AT_A_MINIMUM}"]
    return [*title("Photos"), *as_text(replace(made, rows=rows)), *note, *stopped]


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
                [rounded_azimuth(report.units, azimuth), rounded_azimuth(report.units, dip)]
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

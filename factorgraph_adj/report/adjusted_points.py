"""Tables of points with σ and ellipses, side shots, check-point differences: text, CSV, arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import isfinite, isinf, nan, sqrt
from typing import Any

import numpy as np

from ..accuracy.positional_accuracy import positional_accuracy
from ..columns import Columns
from ..frames import GeocentricFrame, LocalFrame
from ..quality.point_precision import CheckPoints
from ..quality.point_precision import check_points as compare
from ..quality.protection_levels import FIGURES, ProtectionLevels
from ..solve.solution import Solution
from ..types import Array, Index, Mask
from .adjusted_coordinates import (
    NOT_AT_A_MINIMUM,
    decimals_of_points,
    ellipse_columns,
    height_half_widths,
    region_factor,
)
from .adjustment_report import Report
from .catalogue import Texts
from .geodetic_coordinates import geographic_columns, grid_columns
from .layout import decimals, paragraph, percent, rms, short, title
from .tables import (
    ENGLISH,
    NO_FIGURE,
    READ,
    ArrayRows,
    Column,
    FiguresByNumber,
    Rendering,
    Table,
    Unit,
    as_frame,
    as_text,
)

COVARIANCE_PAIRS = {
    "xx": (0, 0),
    "xy": (0, 1),
    "xz": (0, 2),
    "yy": (1, 1),
    "yz": (1, 2),
    "zz": (2, 2),
}
"""Rows and columns of the covariance of a point, in the order of files."""
PROTECTION_SYMBOLS = ("Lx", "Ly", "Lz", "Lh", "Lv", "L")
"""Symbols of protection levels, in the order of `FIGURES`."""


@dataclass(frozen=True)
class AdjustedPoint:
    """A point as a row of tables."""

    number: int
    """Number of the point."""
    name: str
    """Its name."""


# -- all points -----------------------------------------------------------------------------------


def points_table(report: Report, names: Iterable[str] | None = None) -> Table[AdjustedPoint]:
    """Return the table of adjusted points.

    Args:
        report: the report.
        names: some of its points; None: all.
    """
    every = list(report.network.points)
    number = report.solution.equations.unknowns["point"].number
    some = range(len(every)) if names is None else [number[n] for n in names]
    numbers = np.array(some, dtype=np.intp)
    rows = ArrayRows.of(AdjustedPoint, number=numbers, name=[every[i] for i in some])
    return Table("points", rows, point_columns(report, numbers))


def has_values(report: Report) -> bool:
    """Return whether there are values to write, with covariances or by conjugate gradients."""
    return not report.singular or report.solution.converged


def point_columns(report: Report, numbers: Index) -> list[Column[AdjustedPoint]]:
    """Return the columns of the points with some numbers.

    Where there is no covariance, these are coordinates alone.
    """
    points = report.network.points.values()
    held = np.fromiter(chain.from_iterable(p.fixed for p in points), bool).reshape(-1, 3)
    # Text lacks a coordinate that is held in each of these points.
    some: tuple[Rendering, ...] = ("html", "csv", "frame")
    readable = [some if held[numbers, i].all() else ("text", *some) for i in range(3)]
    places, digits = decimals_of_points(report)
    precision = () if report.singular else _precision(report, held, readable, places, digits)
    return [*_coordinates(report, readable, digits), *precision]


def point_frame(solution: Solution) -> Columns:
    """Return the adjusted points as arrays, metres and radians.

    Raises:
        SingularError: there is no covariance.
    """
    _ = solution.point_covariances
    return as_frame(points_table(Report(solution)))


def _coordinates(
    report: Report, readable: Sequence[Sequence[Rendering]], digits: int
) -> Iterator[Column[AdjustedPoint]]:
    x, units = report.solution.state["point"], report.units
    metre = Unit(units.length, report.metre)
    yield Column(title="point", key="name", value="name")
    yield Column(title="xyz", value=FiguresByNumber(x), only=("json",))
    for i, a in enumerate("xyz"):
        yield Column(
            title=a,
            value=FiguresByNumber(x[:, i]),
            unit=metre,
            digits=digits,
            exact=True,
            only=readable[i],
        )
    yield Column(title="unit", value=lambda row: units.length, only=("csv",))


def _precision(
    report: Report, held: Mask, readable: Sequence[Sequence[Rendering]], places: int, digits: int
) -> Iterator[Column[AdjustedPoint]]:
    given, small = list(report.network.points.values()), report.units.sigma_length
    sigmas, unit = report.sigmas, Unit(small, report.small)
    covariances = report.solution.point_covariances
    yield Column(title="sigma", value=FiguresByNumber(sigmas), only=("json",))
    for i, a in enumerate("xyz"):
        yield Column(
            title=f"σ{a}",
            key=f"sigma_{a}",
            value=FiguresByNumber(sigmas[:, i]),
            unit=unit,
            digits=places,
            suffix=True,
            shown=lambda row, i=i: "held" if held[row.number, i] else None,  # type: ignore[misc]
            translated=True,
            only=readable[i],
        )
    pairs = np.stack([covariances[:, i, j] for i, j in COVARIANCE_PAIRS.values()], axis=1)
    yield Column(title="covariance", value=FiguresByNumber(pairs), only=("json",))
    square = Unit(f"{small}2", report.small**2)
    for k, pair in enumerate(COVARIANCE_PAIRS):
        yield Column(
            title=f"covariance_{pair}",
            value=FiguresByNumber(pairs[:, k]),
            unit=square,
            suffix=True,
            only=("csv",),
        )
    yield from geographic_columns(report, digits)
    yield from grid_columns(report)
    yield from _regions(report, places)
    yield from _protection(report, places)
    free = report.solution.equations.unknowns["point"].free
    for i, a in enumerate("xyz"):
        yield Column(title=f"held_{a}", value=FiguresByNumber(~free[:, i]), only=("frame",))
    yield Column(
        title="side_shot",
        value=lambda row: given[row.number].side_shot or None,
        only=("csv", "json"),
    )

    def differences() -> Array:
        check = np.array([p.check or (nan, nan, nan) for p in given], dtype=float).reshape(-1, 3)
        return np.asarray(report.solution.state["point"] - check)

    for column in _differences(report, None, FiguresByNumber(differences)):
        yield replace(column, only=("csv",))


def _regions(report: Report, places: int) -> Iterator[Column[AdjustedPoint]]:
    """Return error ellipses and intervals of heights; people read those of what is unknown."""
    confidence = report.options.confidence
    if confidence is None:
        return
    ellipses, widths, flat = report.ellipses, height_half_widths(report), _only_heights(report)

    def shown(row: AdjustedPoint) -> str | None:
        return None if report.free("point", row.name) else ""

    yield Column(title="confidence", value=lambda row: confidence, only=("csv",))
    for column in ellipse_columns(
        report.units, lambda row: ellipses[row.name], places, () if flat else READ
    ):
        words = column.shown
        yield replace(
            column,
            help="ellipse",
            shown=shown if words is None else lambda row, w=words: shown(row) or w(row),  # type: ignore[misc]
        )
    yield Column(
        title="± z",
        key="height_half_width",
        value=lambda row: widths[row.name],
        unit=Unit(report.units.sigma_length, report.small),
        digits=places,
        suffix=True,
        shown=shown,
        help="ellipse",
        only=(*READ, "csv") if flat else ("csv",),
    )

    def record(row: AdjustedPoint) -> dict[str, Any]:
        e = ellipses[row.name]
        semi_axes = {"semi_axes": list(e.semi_axes), "azimuth": e.azimuth}
        return {"confidence": e.confidence, **semi_axes}

    yield Column(title="ellipse", value=record, only=("json",))


def _protection(report: Report, places: int) -> Iterator[Column[AdjustedPoint]]:
    """Return protection levels and the observations that make them, if they are asked for."""
    found = report.protection_levels
    if found is None:
        return
    flat = _only_heights(report)
    unit = Unit(report.units.sigma_length, report.small)
    for f, (figure, symbol) in enumerate(zip(FIGURES, PROTECTION_SYMBOLS, strict=True)):
        levels = found.levels[:, f]
        shown = figure == "vertical" if flat else figure in ("horizontal", "vertical", "space")

        def words(row: AdjustedPoint, levels: Array = levels) -> str | None:
            if not report.free("point", row.name):
                return ""
            return "∞" if isinf(levels[row.number]) else None

        yield Column(
            title=symbol,
            key=f"protection_{figure}",
            value=FiguresByNumber(levels),
            unit=unit,
            digits=places,
            suffix=True,
            shown=words,
            help="protection",
            only=(*READ, "csv") if shown else ("csv",),
        )

    def weakest(row: AdjustedPoint) -> str | None:
        mode = found.weakest(row.name, "space")
        return None if mode is None else ", ".join(mode.ids)

    def record(row: AdjustedPoint) -> dict[str, Any]:
        levels = found.levels[row.number].tolist()
        mode = found.weakest(row.name, "space")
        return {
            "risk": found.risk,
            "faults": found.faults,
            "accepted": found.accepted,
            **{f: v if isfinite(v) else None for f, v in zip(FIGURES, levels, strict=True)},
            "weakest": [] if mode is None else list(mode.ids),
        }

    yield Column(
        title="weakest",
        key="protection_weakest",
        value=weakest,
        help="weakest",
        only=("html", "csv"),
    )
    yield Column(title="protection", value=record, only=("json",))


def _protection_words(report: Report) -> list[str]:
    """Return what the protection levels of the points are."""
    found = report.protection_levels
    if found is None:
        return []
    errors = "one gross error" if found.faults == 1 else "up to two gross errors"
    out = (
        f"Lh, Lv, L: protection levels in plan, in height and in space: larger errors that no "
        f"test shows have a probability of at most {found.risk:g}, with {errors} of any sizes"
    )
    if found.rejected is not None:
        out += ", whatever data snooping rejects"
    if not found.accepted:
        out += "; NOT VALID HERE: a test rejects an observation"
    return [*paragraph(out), *_weakest_protection(report, found)]


def _weakest_protection(report: Report, found: ProtectionLevels) -> list[str]:
    """Return the point with the largest level, and what makes it."""
    if not len(found.names):
        return []
    name = found.names[int(np.argmax(found.space))]
    mode = found.weakest(name, "space")
    if mode is None:
        return []
    level = found.level(name, "space")
    size = f"{level / report.small:.3g} {report.units.sigma_length}" if isfinite(level) else "∞"
    return paragraph(f"largest L: {name}, {size}, by errors of {mode}")


def _only_heights(report: Report) -> bool:
    """Return whether the plan coordinates of all points that have unknowns are held."""
    free = (p.fixed for n, p in report.network.points.items() if report.free("point", n))
    return all(fixed[0] and fixed[1] for fixed in free)


def _meaning(report: Report) -> list[str]:
    """Return what the confidence figures of points are."""
    if report.options.confidence is None:
        return _protection_words(report)
    level, one = percent(report.options.confidence), region_factor(report, 1)
    if _only_heights(report):
        return [f"  ± z: {level} interval, {one:.3f} σ", *_protection_words(report)]
    k = region_factor(report, 2)
    note = f"  a, b: {level} error ellipses in the horizon, {k:.3f} × standard ellipse"
    factors = (e.factor for n, e in report.ellipses.items() if report.free("point", n))
    if any(0 < factor < k - 1e-9 for factor in factors):
        note += f"; {one:.3f} × where an axis is held"
    return [note, *_protection_words(report)]


def points_section(report: Report) -> list[str]:
    """Return adjusted coordinates with their standard deviations, RMS and weakest point."""
    given = {n: p for n, p in report.network.points.items() if not p.side_shot}
    names = [n for n in given if report.free("point", n)]
    if not names:
        return []
    shown = (report.sigmas / report.small).tolist()
    sigmas = {n: s for n, s in zip(report.network.points, shown, strict=True) if n in given}
    places, _ = decimals_of_points(report)
    out = [*title("Adjusted coordinates"), *_listed(report, list(given))]
    if not report.solution.converged:
        out.append(f"  {NOT_AT_A_MINIMUM}")
    if len(names) > 1:
        axes = [i for i in range(3) if not all(given[n].fixed[i] for n in names)]
        free = {i: [sigmas[n][i] for n in names if not given[n].fixed[i]] for i in axes}
        mean = ", ".join(f"σ{'xyz'[i]} {rms(each):.{places}f}" for i, each in free.items())
        worst = max(names, key=lambda n: sum(s * s for s in sigmas[n]))
        out.append(
            f"  root mean square {mean} {report.units.sigma_length}; weakest point {worst}: "
            f"{sqrt(sum(s * s for s in sigmas[worst])):.{places}f} {report.units.sigma_length}"
        )
    return out


def side_shots_section(report: Report) -> list[str]:
    """Return the side shots: points that follow from the adjusted ones, and bear on none."""
    given = report.network.points
    names = [n for n, p in given.items() if p.side_shot and report.free("point", n)]
    if not names:
        return []
    heading = title("Side shots: computed from the adjusted points; nothing checks them")
    return [*heading, *_listed(report, names)]


def _listed(report: Report, names: list[str]) -> list[str]:
    """Return the lines of some points."""
    made = points_table(report, names)
    rows, note = report.cut(list(made.rows), "points", "points.csv")
    return [*as_text(replace(made, rows=rows)), *note, *_meaning(report)]


# -- check points ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class CheckedPoint:
    """A check point, or the root mean square of all, as a row of tables."""

    name: str
    """Name of the point."""
    differences: Sequence[float]
    """Adjusted − known coordinates, metres."""
    normalised: Sequence[float] = (nan, nan, nan)
    """Differences over their standard deviations."""


def check_points_table(report: Report, found: CheckPoints) -> Table[CheckedPoint]:
    """Return the table of check points."""
    every = found.differences.tolist(), found.normalised.tolist()
    rows = [CheckedPoint(*row) for row in zip(found.names, *every, strict=True)]
    size = (abs(v) / report.small for row in rows for v in row.differences if isfinite(v))
    places = decimals(size, default=2, most=5)
    d = _differences(report, places, lambda row: row.differences)
    together = Column[CheckedPoint](
        title="√(dx²+dy²)",
        value=lambda row: float(np.hypot(row.differences[0], row.differences[1])),
        unit=Unit(report.units.sigma_length, report.small),
        digits=places,
        only=("html",),
    )
    columns = [
        Column[CheckedPoint](title="point", value="name"),
        *(replace(column, only=READ) for column in d),
        together,
        replace(
            together,
            title="√(dx²+dy²+dz²)",
            value=lambda row: float(np.sqrt(np.sum(np.square(row.differences)))),
        ),
    ]
    for i, a in enumerate("xyz"):
        columns.append(
            Column(
                title=f"d{a}/σ",
                value=lambda row, i=i: row.normalised[i],  # type: ignore[misc]
                digits=2,
                help="check_ratio",
                only=("html",),
            )
        )
    return Table("check", rows, columns)


def _differences(
    report: Report, places: int | None, of: Callable[[Any], Sequence[float]]
) -> list[Column[Any]]:
    """Return the columns of adjusted − known coordinates."""
    return [
        Column(
            title=f"d{a}",
            key=f"check_d{a}",
            value=lambda row, i=i: of(row)[i],  # type: ignore[misc]
            unit=Unit(report.units.sigma_length, report.small),
            digits=places,
            suffix=True,
        )
        for i, a in enumerate("xyz")
    ]


def check_points_section(report: Report) -> list[str]:
    """Return the differences at check points, whose coordinates are known, and their RMS."""
    found = compare(report.solution)
    if not found.names:
        return []
    made = check_points_table(report, found)
    rows, note = report.cut(list(made.rows), "check points", "points.csv")
    rows += [
        CheckedPoint(n, v.tolist()) for n, v in (("RMS", found.rms), ("RMS σ", found.rms_sigma))
    ]
    heading = title("Check points: adjusted − known coordinates, which took no part")
    words = paragraph(" ".join(accuracy_sentences(report, found, ENGLISH)))
    return [*heading, *as_text(replace(made, rows=rows)), *note, *words]


def accuracy_sentences(report: Report, found: CheckPoints, t: Texts) -> list[str]:
    """Return the axes of the differences, and what ASPRS edition 2 and NSSDA say of them."""
    survey = report.options.survey
    accuracy = positional_accuracy(found, survey=0.0 if survey is None else survey)

    def text(metres: float) -> str:
        return short(metres / report.small) if isfinite(metres) else NO_FIGURE

    unit = report.units.sigma_length
    h, v = (text(x) for x in accuracy.survey)
    stated = t("check_survey_none") if survey is None else t("check_survey", h=h, v=v, unit=unit)
    frame = report.network.frame
    kind = "local" if isinstance(frame, LocalFrame) else "topocentric"
    kind = "geocentric" if isinstance(frame, GeocentricFrame) else kind
    out = [
        t(f"check_axes_{kind}"),
        t(
            "check_accuracy",
            rmse_h=text(accuracy.rmse_horizontal),
            rmse_v=text(accuracy.rmse_vertical),
            horizontal=text(accuracy.nssda[0]),
            vertical=text(accuracy.nssda[1]),
            survey=stated,
            unit=unit,
        ),
    ]
    for standard, least in accuracy.shortfalls():
        out.append(t.number("check_few", accuracy.number, least=least, standard=standard))
    for direction, own, total in accuracy.coarse_surveys:
        out.append(t(f"check_coarse_{direction}", own=text(own), total=text(total), unit=unit))
    return out

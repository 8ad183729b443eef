"""Calibrations with correlations, and tables of orientation unknowns, other unknowns and shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from ...graph.variables import camera_of_calibration
from ...models.variables import UNKNOWNS
from ...units import ANGLE, decimal, decimal_angle, format_turn
from ..context import Report
from ..layout import percent, short, with_sigma
from ..unknowns import STRONG, small_unknowns
from .language import Texts
from .sheets import NONE, Head, Sheet, columns_of, sheet

MOST_CALIBRATIONS = 20
"""Largest number of calibrations that have a table and a matrix of their own."""


@dataclass(frozen=True)
class Correlations:
    """Correlations of the free parameters of a calibration."""

    names: Sequence[str]
    """Parameters, k."""
    cells: Sequence[Sequence[tuple[str, bool]]]
    """Correlation as text, and whether it is strong, k rows of k."""


@dataclass(frozen=True)
class Calibration:
    """A calibration as the report shows it."""

    name: str
    """Name of the camera, or camera@photo."""
    camera: str
    """Name of its camera."""
    sheet: Sheet
    """Its parameters."""
    correlations: Correlations | None
    """Their correlations; None for fewer than two free parameters."""


def calibrations(report: Report, t: Texts) -> tuple[list[Calibration], int]:
    """Return the first calibrations, and the number of all."""
    if report.singular:
        return [], 0
    names = list(report.calibrations)
    shown = enumerate(names[:MOST_CALIBRATIONS])
    return [_calibration(report, t, i, name) for i, name in shown], len(names)


def _calibration(report: Report, t: Texts, number: int, name: str) -> Calibration:
    camera, e, rows = camera_of_calibration(report.network, name), report.calibrations[name], []
    for i, parameter in enumerate(e.names):
        value, sigma = float(e.values[i]), float(e.sigmas[i])
        if camera.fixed[i]:
            if value != 0.0 or i < 3:
                rows.append([parameter, f"{value + 0.0:.8g}", t("held"), NONE, NONE, ""])
            continue
        given = float(camera.values[i])
        change = decimal((value - given) / sigma, 1) if sigma > 0 and isfinite(given) else NONE
        tested = report.tested("calibration", name, parameter)
        test, verdict = NONE, ""
        if tested is not None and (tested.additional or tested.weighted):
            test = decimal(tested.t, 2)
            verdict = t("significant" if tested.significant else "not_significant")
            verdict = f"{t('weighted')}, {verdict}" if tested.weighted else verdict
        rows.append([parameter, with_sigma(value, sigma), f"{sigma:.2g}", change, test, verdict])
    heads: list[Head] = [
        (t("col.parameter"), False),
        (f"{t('col.value')} [{camera.unit}]", True),
        ("σ", True),
        (t("col.change"), True, t("help.change")),
        ("t", True, t("help.t")),
        (t("col.verdict"), False),
    ]
    found = report.significance
    note = ""
    if found is not None:
        level = percent(1 - found.alpha)
        note = t("calibration.note", critical=f"{found.critical:.2f}", level=level)
    caption = t("calibration.caption", name=name, lens=camera.lens.kind, unit=camera.unit)
    made = sheet(f"calibration-{number}", caption, columns_of(heads, rows), notes=[note])
    assert made is not None, "a calibration has parameters"
    return Calibration(name, camera.name, made, _correlations(e.names, e.correlation, camera.fixed))


def _correlations(
    names: Sequence[str], matrix: np.ndarray, fixed: Sequence[bool]
) -> Correlations | None:
    free = [i for i, held in enumerate(fixed) if not held]
    if len(free) < 2:
        return None
    strong = (np.abs(matrix) >= STRONG) & ~np.eye(len(matrix), dtype=bool)
    cells = [[(decimal(float(matrix[i, j]), 2), bool(strong[i, j])) for j in free] for i in free]
    return Correlations([names[i] for i in free], cells)


def orientations(report: Report, t: Texts) -> Sheet | None:
    """Return the orientation unknowns of the sets of directions."""
    if report.singular:
        return None
    units, rows = report.units, []
    digits = {"dms": 2, "deg": 6, "rad": 8, "mgon": 2, "cc": 1, "arcsec": 2}.get(units.angle, 5)
    for station, chosen in report.network.orientations:
        e = report.solution.orientation(station, chosen)
        free = report.free("orientation", f"{station}/{chosen}")
        sigma = short(float(e.sigmas[0]) / report.radian) if free else t("held")
        rows.append([station, chosen, format_turn(float(e.values[0]), units.angle, digits), sigma])
    heads: list[Head] = [
        (t("col.station"), False),
        (t("col.set"), False),
        (f"{t('col.orientation')} [{units.angle}]", units.angle != "dms"),
        (f"σ [{units.sigma_angle}]", True),
    ]
    return sheet("orientations", t("orientations.caption"), columns_of(heads, rows))


def others(report: Report, t: Texts) -> Sheet | None:
    """Return refraction, verticals, distance meters, frames and further kinds of unknowns."""
    if report.singular:
        return None
    rows = []
    for u in small_unknowns(report):
        value, sigma = u.value / u.size, u.sigma / u.size
        held = u.state == "held"
        tested = report.tested(u.kind, u.name, u.component)
        test, verdict = NONE, t(f"unknown.{u.state}")
        if tested is not None:
            test = decimal(tested.t, 2)
            verdict += f", {t('significant' if tested.significant else 'not_significant')}"
        shown = f"{value + 0.0:.5g}" if held else with_sigma(value, sigma)
        cells = [t.kind(UNKNOWNS[u.kind].title), u.name, u.sign, shown]
        rows.append([*cells, t("held") if held else short(sigma), u.unit, test, verdict])
    heads: list[Head] = [
        (t("col.kind"), False),
        (t("col.name"), False),
        (t("col.parameter"), False),
        (t("col.value"), True),
        ("σ", True),
        (t("col.unit"), False),
        ("t", True, t("help.t")),
        (t("col.state"), False),
    ]
    return sheet("others", t("others.caption"), columns_of(heads, rows))


def shapes(report: Report, t: Texts) -> Sheet | None:
    """Return planes, lines, circles and other shapes as engineers state them."""
    units, rows = report.units, []
    angle = decimal_angle(units.angle)
    for s in report.shapes:
        sigma = np.sqrt(np.maximum(np.diag(s.covariance), 0.0)) / report.small
        axis = "" if np.isnan(s.axis).any() else " ".join(decimal(float(v), 5) for v in s.axis)
        sizes = []
        for size in s.sizes:
            turn = UNKNOWNS[size.kind].components[0].quantity == "angle"
            unit, one = (angle, ANGLE[angle]) if turn else (units.length, report.metre)
            sizes.append(f"{size.attribute} {with_sigma(size.value / one, size.sigma / one)}")
            sizes[-1] += f" ± {short(size.sigma / one)} {unit}"
        rows.append(
            [
                s.name,
                t.kind(s.shape),
                str(s.points),
                *(decimal(float(v) / report.metre, 5) for v in s.place),
                *(short(float(v)) for v in sigma),
                axis,
                "; ".join(sizes),
                short(s.rms / report.small),
                short(s.largest / report.small),
            ]
        )
    heads: list[Head] = [
        (t("col.shape"), False),
        (t("col.kind"), False),
        (t("col.points"), True),
        *((f"{a} [{units.length}]", True) for a in "XYZ"),
        *((f"σ{a} [{units.sigma_length}]", True) for a in "XYZ"),
        (t("col.axis"), False),
        (t("col.size"), False),
        (f"RMS v [{units.sigma_length}]", True),
        (f"max v [{units.sigma_length}]", True),
    ]
    return sheet("shapes", t("shapes.caption"), columns_of(heads, rows))

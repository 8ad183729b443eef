"""HTML tables of estimates: points, check points, photos, lines, calibrations, other unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...graph.variables import camera_of_calibration
from ...quality.point_precision import check_points as compare
from ...quality.reliability import point_redundancy
from ...units import decimal
from ..adjusted_coordinates import lines_table
from ..adjusted_photos import photos_table
from ..adjusted_points import (
    AdjustedPoint,
    CheckedPoint,
    accuracy_sentences,
    check_points_table,
    points_table,
)
from ..adjustment_report import Report
from ..catalogue import Texts
from ..frames_and_shapes import shapes_table
from ..layout import percent
from ..plots.point_symbols import point_status
from ..tables import NO_FIGURE, Column, FiguresByNumber, Sheet, as_html
from ..unknowns import (
    STRONG_CORRELATION,
    calibration_table,
    orientations_table,
    others_table,
    without_absent,
)

NEW_POINT = "new"
"""What a point is that is nothing else."""
POINT_STATES = ("held", "part", "known", "check", "datum", "station", NEW_POINT, "side_shot")
"""Keys of what a point may be; the first that fits is shown, and `NEW_POINT` where none does."""
MAX_CALIBRATIONS_SHOWN = 20
"""Largest number of calibrations that have a table and a matrix of their own."""


def point_states(report: Report) -> list[str]:
    """Return the key of what each point is, one of `POINT_STATES`."""
    status = point_status(report.solution)
    out = np.full(len(report.network.points), NEW_POINT, dtype=object)
    for key in reversed([k for k in POINT_STATES if k != NEW_POINT]):
        out[getattr(status, key)] = key
    return [str(k) for k in out]


def largest_tests(report: Report) -> np.ndarray:
    """Return the largest |w| or |τ| of the observations of each point; NaN without any, (n,)."""
    out = np.full(len(report.network.points), np.nan)
    values = report.tests[0]
    if not len(values):
        return out
    for block in report.solution.equations.blocks:
        size = np.abs(values[block.rows].reshape(block.observed.shape))
        largest = np.fmax.reduce(size, axis=1)
        for kind, index in block.variables:
            if kind == "point":
                np.fmax.at(out, index, largest)
    return out


def points_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return adjusted coordinates with standard deviations, ellipses and redundancy."""
    made, states = points_table(report), [t(f"state_{k}") for k in point_states(report)]
    state = Column[AdjustedPoint](title="state", value=lambda row: states[row.number])
    columns = [made.columns[0], state, *made.columns[1:], *_redundancy(report)]
    notes = [t("points_reference")] if report.solution.datum is not None else []
    if report.options.confidence is not None:
        notes.append(t("points_ellipses", level=percent(report.options.confidence)))
    return as_html(replace(made, columns=columns), t, notes=notes)


def _redundancy(report: Report) -> list[Column[AdjustedPoint]]:
    """Return how well the observations of each point are controlled."""
    if report.reliability is None:
        return []
    counts = point_redundancy(report.reliability)
    largest = FiguresByNumber(largest_tests(report))
    name = f"max |{'τ' if report.pope else 'w'}|"
    return [
        Column(title="scalars", value=FiguresByNumber(counts.rows)),
        Column(title="mean_r", value=FiguresByNumber(counts.mean), digits=2, help="r"),
        Column(title=name, value=largest, digits=2, help="test"),
    ]


def check_points_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return the differences at check points, with mean, RMS and expected RMS as notes."""
    if report.singular:
        return None
    found = compare(report.solution)
    made = check_points_table(report, found)
    differences = [c for c in made.columns if c.key.startswith("check_d")]

    def three(values: np.ndarray) -> str:
        row = CheckedPoint("", values.tolist())
        return ", ".join(c.read(row, missing=NO_FIGURE) for c in differences)

    note = t(
        "check_note",
        unit=report.units.sigma_length,
        mean=three(found.mean),
        rms=three(found.rms),
        expected=three(found.rms_sigma),
    )
    if not found.names:
        return as_html(made, t, notes=[note])
    return as_html(made, t, notes=[note, " ".join(accuracy_sentences(report, found, t))])


def photos_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return exterior orientations with their standard deviations, points and RMS."""
    return as_html(photos_table(report), t)


def lines_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return adjusted distances, azimuths and rises with relative error ellipses."""
    if not report.lines:
        return None
    level = report.options.confidence
    note = t("lines_standard") if level is None else t("points_ellipses", level=percent(level))
    return as_html(lines_table(report), t, notes=[note])


@dataclass(frozen=True)
class CalibrationCorrelations:
    """Correlations of the free parameters of a calibration."""

    names: Sequence[str]
    """Parameters, k."""
    cells: Sequence[Sequence[tuple[str, bool]]]
    """Correlation as text, and whether it is strong, k rows of k."""


@dataclass(frozen=True)
class CalibrationSheet:
    """A calibration as the report shows it."""

    name: str
    """Name of the camera, or camera@photo."""
    camera: str
    """Name of its camera."""
    sheet: Sheet
    """Its parameters."""
    correlations: CalibrationCorrelations | None
    """Their correlations; None for fewer than two free parameters."""


def calibration_sheets(report: Report, t: Texts) -> tuple[list[CalibrationSheet], int]:
    """Return the first calibrations, and the number of all."""
    if report.singular:
        return [], 0
    names = list(report.calibrations)
    shown = enumerate(names[:MAX_CALIBRATIONS_SHOWN])
    return [_calibration(report, t, i, name) for i, name in shown], len(names)


def _calibration(report: Report, t: Texts, number: int, name: str) -> CalibrationSheet:
    camera, e = camera_of_calibration(report.network, name), report.calibrations[name]
    found = report.significance
    note = ""
    if found is not None:
        level = percent(1 - found.alpha)
        note = t("calibration_note", critical=f"{found.critical:.2f}", level=level)
    caption = t("calibration_caption", name=name, lens=camera.lens.kind, unit=camera.unit)
    listed = without_absent(calibration_table(report, name), camera.lens)
    made = replace(listed, name=f"calibration-{number}")
    sheet = as_html(made, t, caption=caption, notes=[note])
    assert sheet is not None, "a calibration has parameters"
    return CalibrationSheet(
        name, camera.name, sheet, _correlations(e.names, e.correlation, camera.fixed)
    )


def _correlations(
    names: Sequence[str], matrix: np.ndarray, fixed: Sequence[bool]
) -> CalibrationCorrelations | None:
    free = [i for i, held in enumerate(fixed) if not held]
    if len(free) < 2:
        return None
    strong = (np.abs(matrix) >= STRONG_CORRELATION) & ~np.eye(len(matrix), dtype=bool)
    cells = [[(decimal(float(matrix[i, j]), 2), bool(strong[i, j])) for j in free] for i in free]
    return CalibrationCorrelations([names[i] for i in free], cells)


def orientations_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return the orientation unknowns of the sets of directions."""
    return None if report.singular else as_html(orientations_table(report), t)


def other_unknowns_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return refraction, verticals, distance meters, frames and further kinds of unknowns."""
    return None if report.singular else as_html(others_table(report), t)


def shapes_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return planes, lines, circles and other shapes as engineers state them."""
    return as_html(shapes_table(report), t)

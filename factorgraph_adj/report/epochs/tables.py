"""The table of displacements of two epochs as CSV."""

from __future__ import annotations

import csv
import io

import numpy as np

from ...units import ANGLE, LENGTH, decimal_angle
from .context import EpochsReport

PLAIN = ("name", "stable", "test_value", "critical", "moved")
"""Columns that are no lengths."""


def displacement_table(report: EpochsReport) -> str:
    """Return the displacements as CSV, with the ellipse of each displacement in plan.

    Lengths and angles are in the units of the report, which stand in the names of the columns. The
    ellipse lies in the horizon of the point; its azimuth is clockwise from north.
    """
    stream = io.StringIO()
    columns = report.found.table()
    length, angle = report.units.sigma_length, decimal_angle(report.units.angle)
    metres, radians = LENGTH[length], ANGLE[angle]
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(
        [
            *(c if c in PLAIN else f"{c}_{length}" for c in columns),
            *(f"ellipse_{axis}_{length}" for axis in ("major", "minor")),
            f"ellipse_azimuth_{angle}",
            "confidence",
        ]
    )
    for i, e in enumerate(report.ellipses):
        cells = [columns[c][i] if c in PLAIN else columns[c][i] / metres for c in columns]
        axes = (axis / metres for axis in e.semi_axes)
        figures = (*cells, *axes, e.azimuth / radians, report.confidence)
        writer.writerow([_cell(v) for v in figures])
    return stream.getvalue()


def _cell(value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return str(value).lower()
    return value if isinstance(value, str) else repr(float(value))  # type: ignore[arg-type]

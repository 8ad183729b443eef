"""The table of displacements of two epochs as CSV."""

from __future__ import annotations

import numpy as np

from ...io.tables import write_all_columns
from ...units import ANGLE, LENGTH, decimal_angle
from .context import EpochsReport

PLAIN = ("name", "stable", "test_value", "critical", "moved")
"""Columns that are no lengths."""


def displacement_table(report: EpochsReport) -> str:
    """Return the displacements as CSV, with the ellipse of each displacement in plan.

    Lengths and angles are in the units of the report, which stand in the names of the columns. The
    ellipse lies in the horizon of the point; its azimuth is clockwise from north.
    """
    columns = report.found.table()
    length, angle = report.units.sigma_length, decimal_angle(report.units.angle)
    metres, radians = LENGTH[length], ANGLE[angle]
    table: dict[str, list[object]] = {}
    for c in columns:
        if c in PLAIN:
            table[c] = list(columns[c])
        else:
            table[f"{c}_{length}"] = [x / metres for x in columns[c]]
    for i, axis in enumerate(("major", "minor")):
        table[f"ellipse_{axis}_{length}"] = [e.semi_axes[i] / metres for e in report.ellipses]
    table[f"ellipse_azimuth_{angle}"] = [e.azimuth / radians for e in report.ellipses]
    table["confidence"] = [report.confidence] * len(report.ellipses)
    return write_all_columns({c: [_cell(v) for v in values] for c, values in table.items()})


def _cell(value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return str(value).lower()
    return value if isinstance(value, str) else repr(float(value))  # type: ignore[arg-type]

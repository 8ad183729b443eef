"""The table of displacements of two epochs as CSV."""

from __future__ import annotations

import csv
import io

import numpy as np

from .context import EpochsReport


def displacement_table(report: EpochsReport) -> str:
    """Return the displacements as CSV: metres, with the ellipse of the displacement in plan.

    The ellipse lies in the horizon of the point; its azimuth is clockwise from north, radians.
    """
    stream = io.StringIO()
    columns = report.found.table()
    extra = ("ellipse_major", "ellipse_minor", "ellipse_azimuth", "confidence")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*columns, *extra])
    for i, e in enumerate(report.ellipses):
        cells = [_cell(columns[c][i]) for c in columns]
        figures = (*e.semi_axes, e.azimuth, report.confidence)
        writer.writerow([*cells, *(_cell(v) for v in figures)])
    return stream.getvalue()


def _cell(value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return str(value).lower()
    return value if isinstance(value, str) else repr(float(value))  # type: ignore[arg-type]

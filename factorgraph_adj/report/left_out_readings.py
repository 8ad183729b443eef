"""Readings that are not in an adjustment, with why: section of the text report, table of the page.

An incremental adjustment leaves out what its tests or people reject, and what waits. Its solution
does not have these readings, and a report of it alone would say nothing of them.
"""

from __future__ import annotations

from .adjustment_report import Report
from .layout import title
from .options import LeftOutReading
from .tables import Column, Table, as_text


def left_out_table(report: Report) -> Table[LeftOutReading]:
    """Return the table of the readings that are left out."""
    columns: list[Column[LeftOutReading]] = [
        Column(title="observation", value="label"),
        Column(title="state", value="state", english=True),
        Column(title="reason", value="why", english=True, only=("html",)),
        Column(title="reason", value="why", below="", only=("text",)),
    ]
    return Table("left_out", list(report.provenance.left_out), columns)


def left_out_section(report: Report) -> list[str]:
    """Return the readings that are left out; nothing where there are none."""
    if not report.provenance.left_out:
        return []
    return [*title("Readings that are left out"), *as_text(left_out_table(report))]

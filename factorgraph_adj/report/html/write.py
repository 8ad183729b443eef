"""Write the report of an adjustment as one HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...io.atomic import write_files
from ...solve.solution import Solution
from ..context import Report
from ..options import Provenance, ReportOptions
from .language import Language


def write_report(
    solution: Solution,
    path: str | Path,
    *,
    language: Language = "en",
    options: ReportOptions | None = None,
    provenance: Provenance | None = None,
    files: Sequence[str | Path] = (),
) -> None:
    """Write the report of an adjustment as one HTML file; the extra ``report`` is required.

    The file opens in a browser by a double click and asks for nothing from the network. It has:
    the verdict with its reasons; the plan, with error ellipses and with the observations that are
    in doubt, and a view in three dimensions; groups of observations; the worst observations and
    those that were set aside; points, control and check points, photos, calibrations and other
    unknowns; all observations; the distribution of test values and of redundancy; input files,
    versions, options, and the protocol as text. Tables sort, filter and export CSV.

    The same arguments give the same file: a date stands in it only if ``provenance`` has one.

    Args:
        solution: the result of `adjust`.
        path: the file, such as ``report.html``; one that is there is replaced.
        language: ``en`` or ``de``. Sentences of the adjustment itself, such as the reason why an
            iteration ended and the name of a likely cause, are English in both.
        options: units, probabilities, tests, ellipses and lines, as for `protocol`. Without a
            confidence, the plan shows ellipses of 95 % and the tables none.
        provenance: data snooping or variance components that the solution comes from, and the run.
        files: input files and folders, which the report lists with their SHA-256.

    Raises:
        InputError: the extra is not installed, the language is unknown, an input file cannot be
            read, or the file cannot be written; an earlier one has not changed then.
    """
    report = Report(solution, options or ReportOptions(), provenance or Provenance())
    write_html(report, path, language=language, files=files)


def write_html(
    report: Report,
    path: str | Path,
    *,
    language: Language = "en",
    files: Sequence[str | Path] = (),
) -> None:
    """Write a report as an HTML file, see `write_report`."""
    from .page import html  # the figures behind it take long to import

    target = Path(path)
    write_files(target.parent, {target.name: html(report, language=language, files=files)})

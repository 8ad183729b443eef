"""Write the report of an adjustment as one HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...epochs.blocks import BlockMotion
from ...epochs.comparison import Congruence
from ...errors import InputError
from ...io.atomic import write_files
from ...quality.levels import CONFIDENCE
from ...solve.solution import Solution
from ..context import Report
from ..epochs.context import EpochsReport
from ..options import Provenance, ReportOptions
from .language import Language


def write_report(
    solution: Solution | Congruence,
    path: str | Path,
    *,
    language: Language = "en",
    options: ReportOptions | None = None,
    provenance: Provenance | None = None,
    files: Sequence[str | Path] = (),
    blocks: Sequence[BlockMotion] = (),
) -> None:
    """Write the report of an adjustment, or of two epochs, as one HTML file.

    The extra ``report`` is required. The file opens in a browser by a double click and asks for
    nothing from the network. It has: the verdict with its reasons; the plan, with error ellipses
    and with the observations that are in doubt, and a view in three dimensions; groups of
    observations; the worst observations and those that were set aside; points, control and check
    points, photos, calibrations and other unknowns; all observations; the distribution of test
    values and of redundancy; input files, versions, options, and the protocol as text. Tables sort,
    filter and export CSV.

    Of two epochs it has: the verdict; the plan of the displacements with their ellipses; the
    displacements with test values and smallest detectable ones; the congruence tests of the
    reference points; common motions and strains; the adjustments with the ratio of their variances.

    The same arguments give the same file: a date stands in it only if ``provenance`` has one.

    Args:
        solution: the result of `adjust`, or of `congruence`.
        path: the file, such as ``report.html``; one that is there is replaced.
        language: ``en`` or ``de``. Sentences of the adjustment itself, such as the reason why an
            iteration ended and the name of a likely cause, are English in both.
        options: units, probabilities, tests, ellipses and lines, as for `protocol`. Without a
            confidence, the plan shows ellipses of 95 % and the tables none. Of two epochs units and
            confidence count.
        provenance: data snooping or variance components that the solution comes from, and the run.
        files: input files and folders, which the report lists with their SHA-256.
        blocks: common motions of points of two epochs.

    Raises:
        InputError: the extra is not installed, the language is unknown, an input file cannot be
            read, blocks are given for one adjustment, or the file cannot be written; an earlier one
            has not changed then.
    """
    if isinstance(solution, Congruence):
        stated = options or ReportOptions()
        level = CONFIDENCE if stated.confidence is None else stated.confidence
        run = provenance or Provenance()
        epochs = EpochsReport(solution, tuple(blocks), run, level, stated.units)
        write_html(epochs, path, language=language, files=files)
        return
    if blocks:
        raise InputError("blocks belong to the report of two epochs, of a result of congruence")
    report = Report(solution, options or ReportOptions(), provenance or Provenance())
    write_html(report, path, language=language, files=files)


def write_html(
    report: Report | EpochsReport,
    path: str | Path,
    *,
    language: Language = "en",
    files: Sequence[str | Path] = (),
) -> None:
    """Write a report as an HTML file, see `write_report`."""
    # The figures behind them take long to import.
    from .epochs_page import epochs_html
    from .page import html

    target = Path(path)
    if isinstance(report, EpochsReport):
        text = epochs_html(report, language=language, files=files)
    else:
        text = html(report, language=language, files=files)
    write_files(target.parent, {target.name: text})

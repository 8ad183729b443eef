"""Summaries of an experiment by cell: mean, deviation, confidence intervals, failures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import nan, sqrt

import numpy as np

from ..errors import InputError, known, unknown_name
from ..report import layout
from ..result_display import Rows, Shown
from ..statistical_tests import chi2_quantile, chi2_upper_quantile, student_quantile
from ..types import Array
from .repetitions import Repetition
from .study import Level, Levels, encoded, key, said, written

SHOWN = 3
"""Largest number of messages of failed repetitions that a table shows."""
LONGEST = 200
"""Largest number of characters of a message that a table shows."""


@dataclass(frozen=True)
class FigureSummary:
    """One figure in one cell; statistics of too few values are NaN.

    With n values xᵢ of mean x̄ and standard deviation s, and t and χ² of n − 1 degrees of
    freedom at probability p, α = 1 − confidence:

        mean:                x̄ ± t(1 − α/2) s / √n                      (Student)
        standard deviation:  s √((n − 1) / χ²(1 − α/2)) … s √((n − 1) / χ²(α/2))
        RMS:                 √(Σ xᵢ² / n)

    Each single interval has the confidence level for normally distributed values. With large n,
    the interval of the mean holds approximately for other distributions; that of s does not.
    """

    levels: Levels
    """The cell."""
    figure: str
    """Name of the figure."""
    n: int
    """Number of finite values."""
    n_failed: int
    """Number of failed repetitions of the cell."""
    n_missing: int
    """Number of successful repetitions without a finite value."""
    mean: float
    """Mean x̄; NaN without values."""
    mean_interval: tuple[float, float]
    """Lower and upper bound; NaN with less than two values."""
    standard_deviation: float
    """Standard deviation s with divisor n − 1; NaN with less than two values."""
    standard_deviation_interval: tuple[float, float]
    """Lower and upper bound; NaN with less than two values."""
    rms: float
    """Root mean square; for a figure that is an error, it combines bias and scatter."""


@dataclass(frozen=True)
class FailureCount:
    """The failed repetitions with one error message."""

    error: str
    """Type of the error."""
    message: str
    """Message of the error."""
    n: int
    """Number of repetitions that failed with this error."""
    seed: int
    """Seed of the first of these repetitions."""
    levels: Levels
    """Cell of the first of these repetitions."""


@dataclass(frozen=True, repr=False)
class Summary(Shown):
    """Figures of all cells; ``str`` is a table for people."""

    name: str
    """Name of the experiment."""
    factors: tuple[str, ...]
    """Names of the factors."""
    confidence: float
    """Confidence level of each interval, between 0 and 1."""
    n_repetitions: int
    """Number of all repetitions, including failed ones."""
    n_failed: int
    """Number of failed repetitions."""
    rows: tuple[FigureSummary, ...]
    """Summaries in the order of figures, and of cells in each figure."""
    failures: tuple[FailureCount, ...] = ()
    """Errors of failed repetitions, in the order of their first occurrence."""

    def headline(self) -> str:
        """Return how many repetitions there are."""
        return f"Summary of {self.name!r}: {self.n_repetitions} repetitions, {self.n_failed} failed"

    def first_rows(self) -> Rows:
        """Return the figures of the cells."""
        return Rows(
            (*self.factors, "figure", "n", "mean", "std. dev.", "RMS"),
            (
                (
                    *(r.levels[f] for f in self.factors),
                    r.figure,
                    r.n,
                    r.mean,
                    r.standard_deviation,
                    r.rms,
                )
                for r in self.rows
            ),
            len(self.rows),
        )

    def of(self, figure: str, /, **levels: Level) -> FigureSummary:
        """Return the summary of a figure in one cell.

        Args:
            figure: name of the figure.
            **levels: levels that identify the cell; factors with one level may be left out.

        Raises:
            InputError: the figure or a factor is unknown, or the levels do not identify one cell.
        """
        every = [row for row in self.rows if row.figure == figure]
        if not every:
            names = dict.fromkeys(row.figure for row in self.rows)
            raise InputError(unknown_name("figure", figure, names))
        unknown = [name for name in levels if name not in self.factors]
        if unknown:
            raise InputError(unknown_name("factor", unknown[0], self.factors))
        want = encoded(levels)
        found = [row for row in every if encoded({n: row.levels[n] for n in levels}) == want]
        if len(found) != 1:
            which = "no cell has" if not found else f"{len(found)} cells have"
            listed = known(said(row.levels) for row in every)
            raise InputError(f"{which} {said(levels)}; cells: {listed}")
        return found[0]

    def __str__(self) -> str:
        """Return an aligned table of plain text."""
        header = [*self.factors, "n", "failed", "missing", "mean", "from", "to"]
        header += ["std. dev.", "from", "to", "RMS"]
        lines = [f"{self.name}: intervals of {layout.percent(self.confidence)} confidence"]
        if self.n_failed:
            lines.append(f"{self.n_failed} of {self.n_repetitions} repetitions failed")
            lines += [f"  {_why(f)}" for f in self.failures[:SHOWN]]
            if len(self.failures) > SHOWN:
                lines.append(f"  … and {len(self.failures) - SHOWN} other messages")
        for figure in dict.fromkeys(row.figure for row in self.rows):
            cells = [self._cells(row) for row in self.rows if row.figure == figure]
            drop = {"failed", "missing"}
            for name in list(drop):
                if any(row[header.index(name)] != "0" for row in cells):
                    drop.discard(name)
            keep = [i for i, name in enumerate(header) if name not in drop]
            lines += ["", figure]
            lines += layout.table(
                [header[i] for i in keep],
                [[row[i] for i in keep] for row in cells],
                left=len(self.factors),
            )
        return "\n".join(lines)

    def _cells(self, row: FigureSummary) -> list[str]:
        """Return the cells of a line; the digits of a mean follow from its standard deviation."""
        sigma = row.standard_deviation / sqrt(row.n) if row.n else nan
        low, high = row.mean_interval
        return [
            *(written(row.levels[name]) for name in self.factors),
            *map(str, (row.n, row.n_failed, row.n_missing)),
            *(_shown(value, sigma) for value in (row.mean, low, high)),
            *map(layout.short, (row.standard_deviation, *row.standard_deviation_interval)),
            layout.short(row.rms),
        ]


def _why(failure: FailureCount) -> str:
    """Return a failure as a line; a long message is cut."""
    message = " ".join(failure.message.split())
    if len(message) > LONGEST:
        message = message[: LONGEST - 1] + "…"
    where = f", {said(failure.levels)}" if failure.levels else ""
    what = f"{failure.error}: {message}" if message else failure.error
    return f"{failure.n} × {what} (first with seed {failure.seed}{where})"


def _shown(value: float, sigma: float) -> str:
    return layout.with_sigma(value, sigma) if np.isfinite(value) else "–"


def summarise(
    *,
    name: str,
    factors: tuple[str, ...],
    figures: Iterable[str],
    rows: Sequence[Repetition],
    confidence: float,
) -> Summary:
    """Return the summary of an experiment, see `Results.summary`.

    Args:
        name: name of the experiment.
        factors: names of its factors.
        figures: names of the figures, in the order of the table.
        rows: every repetition, including failed ones.
        confidence: confidence level of each interval, between 0 and 1.

    Raises:
        InputError: the confidence is not between 0 and 1.
    """
    if isinstance(confidence, bool) or not 0 < confidence < 1:
        raise InputError(f"confidence must be between 0 and 1, not {confidence!r}")
    cells: dict[str, list[Repetition]] = {}
    for row in rows:
        cells.setdefault(key(row.levels), []).append(row)
    failed = [row for row in rows if row.error]
    return Summary(
        name=name,
        factors=factors,
        confidence=confidence,
        n_repetitions=len(rows),
        n_failed=len(failed),
        rows=tuple(_rows(figures, list(cells.values()), confidence)),
        failures=_failures(failed),
    )


def _failures(failed: Sequence[Repetition]) -> tuple[FailureCount, ...]:
    """Return the failures, one for each different error message."""
    same: dict[tuple[str, str], list[Repetition]] = {}
    for row in failed:
        same.setdefault((row.error, row.message), []).append(row)
    return tuple(
        FailureCount(error, message, len(rows), rows[0].seed, rows[0].levels)
        for (error, message), rows in same.items()
    )


def _rows(
    figures: Iterable[str], cells: list[list[Repetition]], confidence: float
) -> Iterator[FigureSummary]:
    for figure in figures:
        for rows in cells:
            good = [row for row in rows if not row.error]
            values = np.array([row.figures.get(figure, nan) for row in good])
            values = values[np.isfinite(values)]
            mean, s = _moments(values)
            n = len(values)
            yield FigureSummary(
                levels=rows[0].levels,
                figure=figure,
                n=n,
                n_failed=len(rows) - len(good),
                n_missing=len(good) - n,
                mean=mean,
                mean_interval=_of_mean(mean, s, n, confidence),
                standard_deviation=s,
                standard_deviation_interval=_of_deviation(s, n, confidence),
                rms=float(np.sqrt(np.mean(values**2))) if n else nan,
            )


def _moments(values: Array) -> tuple[float, float]:
    """Return mean and standard deviation.

    They are computed from differences to the first value, which are exactly zero for equal values.
    """
    if not values.size:
        return nan, nan
    off = values - values[0]
    mean = float(values[0] + off.mean())
    return mean, float(off.std(ddof=1)) if values.size > 1 else nan


def _of_mean(mean: float, s: float, n: int, confidence: float) -> tuple[float, float]:
    if n < 2:
        return nan, nan
    half = -student_quantile((1 - confidence) / 2, n - 1) * s / sqrt(n)
    return mean - half, mean + half


def _of_deviation(s: float, n: int, confidence: float) -> tuple[float, float]:
    if n < 2:
        return nan, nan
    tail = (1 - confidence) / 2
    low, high = float(chi2_upper_quantile(tail, n - 1)), chi2_quantile(tail, n - 1)
    return s * sqrt((n - 1) / low), s * sqrt((n - 1) / high)

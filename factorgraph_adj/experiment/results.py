"""Results of an experiment: one row for each repetition, as a table, a file or a data frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..columns import data_frame, polars_frame
from ..errors import InputError, Problem, known
from ..io.atomic import write_files
from ..io.tables import write_all_columns
from ..quality.levels import CONFIDENCE
from ..shown import Shown
from ..types import Array
from .repetition import Repetition
from .study import Level, Levels, encoded, written
from .summary import Summary, summarise

if TYPE_CHECKING:
    import pandas
    import polars


@dataclass(frozen=True, repr=False)
class Results(Shown):
    """All repetitions of an experiment, sorted by cell and repetition."""

    name: str
    """Name of the experiment."""
    factors: tuple[str, ...]
    """Names of the factors."""
    rows: tuple[Repetition, ...]
    """Every repetition, including failed ones."""

    def headline(self) -> str:
        """Return the numbers of repetitions and of failed ones."""
        failed = len(self.failed)
        return f"Results of {self.name!r}: {len(self.rows)} repetitions, {failed} failed"

    @property
    def failed(self) -> tuple[Repetition, ...]:
        """The repetitions that failed, with their seeds and errors."""
        return tuple(row for row in self.rows if row.error)

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures, in the order in which they first appear."""
        return tuple(dict.fromkeys(name for row in self.rows for name in row.figures))

    def values(self, figure: str, /, **levels: Level) -> Array:
        """Return a figure of every repetition at some levels, (n,) in the order of rows.

        Args:
            figure: name of the figure.
            **levels: levels of the wanted cells; without levels, all cells.

        Returns:
            The values; NaN where a repetition failed or lacks the figure.

        Raises:
            InputError: the figure, factor or level is unknown.
        """
        if figure not in self.figures:
            what = f"unknown figure {figure!r}; known: {known(self.figures, meant=figure)}"
            raise InputError(what)
        self._check(levels)
        want = encoded(levels)
        return np.array(
            [
                row.figures.get(figure, np.nan)
                for row in self.rows
                if encoded({name: row.levels[name] for name in levels}) == want
            ]
        )

    def _check(self, levels: Levels) -> None:
        problems = []
        for name, level in levels.items():
            if name not in self.factors:
                what = f"unknown factor {name!r}; known: {known(self.factors, meant=name)}"
                problems.append(Problem(what))
                continue
            there = {written(row.levels[name]): row.levels[name] for row in self.rows}
            if encoded({"": level}) not in [encoded({"": other}) for other in there.values()]:
                what = f"unknown level {level!r}; known: {known(there, meant=level)}"
                problems.append(Problem(what, f"factor {name!r}"))
        if problems:
            raise InputError(problems)

    def table(self) -> str:
        """Return all rows as CSV: factors, repetition, seed, figures, error, message.

        Floats have all their digits (``repr``). The entry of a figure is empty if the repetition
        failed or lacks the figure; ``nan`` is a figure that is not a number.
        """
        rows = self.rows
        columns = {n: [written(r.levels[n]) for r in rows] for n in self.factors}
        columns["repetition"] = [str(r.repetition) for r in rows]
        columns["seed"] = [str(r.seed) for r in rows]
        for n in self.figures:
            columns[n] = [repr(r.figures[n]) if n in r.figures else "" for r in rows]
        columns["error"] = [r.error for r in rows]
        columns["message"] = [r.message for r in rows]
        return write_all_columns(columns)

    def write(self, path: str | Path) -> None:
        """Write the whole table to a file.

        Raises:
            InputError: the file cannot be written; an existing file is left unchanged.
        """
        path = Path(path)
        write_files(path.parent, {path.name: self.table()})

    def to_pandas(self) -> pandas.DataFrame:
        """Return a data frame with the columns of `table`; NaN where a figure is missing.

        Raises:
            InputError: pandas is not installed (extra ``table``).
        """
        return data_frame(self._columns())

    def to_polars(self) -> polars.DataFrame:
        """Return a data frame of polars with the columns of `to_pandas`.

        Raises:
            InputError: polars is not installed (extra ``polars``).
        """
        return polars_frame(self._columns())

    def _columns(self) -> dict[str, object]:
        rows = self.rows
        columns: dict[str, object] = {
            name: [row.levels[name] for row in rows] for name in self.factors
        }
        columns["repetition"] = [row.repetition for row in rows]
        columns["seed"] = [row.seed for row in rows]
        columns |= {name: self.values(name) for name in self.figures}
        columns["error"] = [row.error for row in rows]
        columns["message"] = [row.message for row in rows]
        return columns

    def summary(self, *, confidence: float = CONFIDENCE) -> Summary:
        """Return mean, standard deviation and RMS of each figure in each cell, with intervals.

        Args:
            confidence: confidence level of each interval, between 0 and 1: the share of such
                experiments whose interval contains the true value, for normally distributed
                figures.

        Raises:
            InputError: the confidence is not between 0 and 1.
        """
        return summarise(
            name=self.name,
            factors=self.factors,
            figures=self.figures,
            rows=self.rows,
            confidence=confidence,
        )

"""Results as columns of arrays, and as a data frame where pandas or polars is installed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import InputError, unknown_name
from .result_display import FIRST, Rows, Shown

if TYPE_CHECKING:
    import pandas
    import polars

MISSING = "a data frame needs pandas: pip install 'factorgraph_adj[table]'"
MISSING_POLARS = "a frame of polars needs polars: pip install 'factorgraph_adj[polars]'"


@dataclass(frozen=True, eq=False, repr=False)
class Columns(Shown):
    """A table: arrays of the same length by name.

    Example:
        >>> table = Columns("points", {"name": np.array(["A", "B"]), "x": np.array([1.0, 2.0])})
        >>> table["x"].sum(), len(table), list(table)
        (np.float64(3.0), 2, ['name', 'x'])
    """

    title: str
    """What the rows are."""
    columns: Mapping[str, np.ndarray[Any, Any]]
    """Arrays (n,) by name; the unit is that of the library: metres, radians, image units.
    Counts, names, factors and test values have none; `Solution.to_pandas` lists columns and units.
    """

    def __getitem__(self, name: str) -> np.ndarray[Any, Any]:
        """Return a column.

        Raises:
            InputError: no such column.
        """
        if name not in self.columns:
            raise InputError(unknown_name("column", name, self.columns, most=30))
        return self.columns[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the columns."""
        return iter(self.columns)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.columns.values()), ()))

    def headline(self) -> str:
        """Return what the rows are, their number, and the columns."""
        return f"{len(self)} {self.title}: {', '.join(self.columns)}"

    def first_rows(self) -> Rows:
        """Return the first rows."""
        first = [c[:FIRST].tolist() for c in self.columns.values()]
        return Rows(tuple(self.columns), zip(*first, strict=True), len(self))

    def to_pandas(self) -> pandas.DataFrame:
        """Return a data frame with the same columns.

        Raises:
            InputError: pandas is not installed (extra ``table``).
        """
        return data_frame(self.columns)

    def to_polars(self) -> polars.DataFrame:
        """Return a data frame of polars with the same columns.

        Raises:
            InputError: polars is not installed (extra ``polars``).
        """
        return polars_frame(self.columns)


def data_frame(columns: Mapping[str, object]) -> pandas.DataFrame:
    """Return a data frame of columns of the same length.

    Raises:
        InputError: pandas is not installed (extra ``table``).
    """
    require_pandas()
    import pandas

    return pandas.DataFrame(dict(columns))


def require_pandas() -> None:
    """Raise that pandas is not installed, before anything is computed for it.

    Raises:
        InputError: pandas is not installed (extra ``table``).
    """
    if find_spec("pandas") is None:
        raise InputError(MISSING)


def polars_frame(columns: Mapping[str, Any]) -> polars.DataFrame:
    """Return a data frame of polars of columns of the same length.

    Texts become strings, and numbers that are not known stay NaN: they are no missing values.

    Raises:
        InputError: polars is not installed (extra ``polars``).
    """
    try:
        import polars
    except ImportError:
        raise InputError(MISSING_POLARS) from None
    lists = {n: c.tolist() if c.dtype == object else c for n, c in _arrays(columns).items()}
    frame = polars.DataFrame(lists, strict=False)
    empty = [n for n, c in _arrays(columns).items() if c.dtype == object and not len(c)]
    return frame.with_columns(polars.col(empty).cast(polars.String)) if empty else frame


def _arrays(columns: Mapping[str, Any]) -> dict[str, np.ndarray[Any, Any]]:
    """Return columns as arrays."""
    return {name: np.asarray(column) for name, column in columns.items()}

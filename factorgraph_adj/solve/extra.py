"""Factors that the user adds to an adjustment, and their rows at a state."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import gtsam

from ..errors import InputError
from ..graph.equations import Equations
from ..graph.extra import linearise_extra
from ..graph.variables import State
from .linear import ExtraRows


@dataclass(frozen=True, eq=False)
class Extra:
    """A user's factors, linearised at one state.

    GTSAM cannot pickle factors of every type, for instance factors written in Python. A pickled
    `Extra` keeps only the rows at its state. A solution with these rows has all its estimates,
    covariances and reliability figures. The rows cannot be linearised at another state: after
    pickling, `s_transform` cannot move a free network with such factors to other datum points.
    Copies share the factors.
    """

    factors: tuple[gtsam.NonlinearFactor, ...] | None = ()
    """The factors; none after pickling."""
    rows: tuple[ExtraRows, ...] = ()
    """Rows of the factors."""

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return sum(len(e.residual) for e in self.rows)

    def at(self, equations: Equations, state: State) -> Extra:
        """Return the same factors, linearised at another state.

        Raises:
            InputError: the factors were lost in pickling; or as `linearise_extra`.
        """
        factors = self.given()
        if not factors:
            return self
        found = linearise_extra(factors, equations, state)
        return Extra(factors, tuple(ExtraRows(*rows) for rows in found))

    def given(self) -> tuple[gtsam.NonlinearFactor, ...]:
        """Return the factors.

        Raises:
            InputError: the factors were lost in pickling.
        """
        if self.factors is None:
            raise InputError(
                "the factors that were added to this adjustment were left behind when its solution "
                "was pickled: their rows are those of the solution, and cannot be had at another "
                "state; adjust again with extra_factors="
            )
        return self.factors

    def __deepcopy__(self, memo: dict[int, Any]) -> Extra:
        """Return a copy with copied rows and the same factors."""
        return Extra(self.factors, deepcopy(self.rows, memo))

    def __copy__(self) -> Extra:
        """Return the object itself, as it is immutable."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        """Return the rows for pickling, without the factors."""
        return {"factors": None if self.factors else (), "rows": self.rows}


NOTHING_MORE = Extra()
"""No rows beside the observations."""

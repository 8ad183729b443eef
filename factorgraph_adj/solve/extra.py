"""Factors that the user adds to an adjustment, and their rows where it is."""

from __future__ import annotations

from collections.abc import Sequence
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

    GTSAM cannot pickle factors of every type, those written in Python for one. A pickled `Extra`
    keeps the rows at its state: a solution with it has all its estimates, covariances and figures
    of reliability. It cannot be linearised anywhere else: a free network with such factors cannot
    be carried to other datum points by `s_transform` after it was pickled. Copies share the
    factors.
    """

    factors: tuple[gtsam.NonlinearFactor, ...] | None = ()
    """The factors; none where they were left behind."""
    rows: tuple[ExtraRows, ...] = ()
    """Their rows."""

    @classmethod
    def of(
        cls, factors: Sequence[gtsam.NonlinearFactor], equations: Equations, state: State
    ) -> Extra:
        """Linearise factors at a state; see `linearise_extra`."""
        return cls(tuple(factors)).at(equations, state)

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return sum(len(e.residual) for e in self.rows)

    def at(self, equations: Equations, state: State) -> Extra:
        """Return the same factors, linearised at another state.

        Raises:
            InputError: they were left behind when this was pickled; or as `linearise_extra`.
        """
        if self.factors is None:
            raise InputError(
                "the factors that were added to this adjustment were left behind when its solution "
                "was pickled: their rows are those of the solution, and cannot be had at another "
                "state; adjust again with extra_factors="
            )
        if not self.factors:
            return self
        found = linearise_extra(self.factors, equations, state)
        return Extra(self.factors, tuple(ExtraRows(*rows) for rows in found))

    def __deepcopy__(self, memo: dict[int, Any]) -> Extra:
        """Copy the rows."""
        return Extra(self.factors, deepcopy(self.rows, memo))

    def __copy__(self) -> Extra:
        """Return the same: nothing of it changes."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled; the factors are left behind."""
        return {"factors": None if self.factors else (), "rows": self.rows}

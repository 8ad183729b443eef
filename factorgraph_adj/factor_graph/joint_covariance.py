"""Observations that have entered, with the joint covariance of what they touch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..quality.leave_out import Tested
from ..types import Array, Index


@dataclass(frozen=True, eq=False)
class JointCovariance:
    """Units with the joint covariance of what they touch."""

    rows: list[Index]
    """Rows of each unit."""
    columns: Index
    """Columns of what they touch, (m,)."""
    a: Array
    """Whitened partials, (k, m)."""
    v: Array
    """Whitened residuals, (k,)."""
    covariance: Array
    """Joint covariance of the columns, (m, m)."""

    @cached_property
    def m(self) -> Array:
        """M = I − A Q Aᵀ, with Q after the update, (k, k)."""
        return np.asarray(np.eye(len(self.a)) - self._spread.T @ self.a.T)

    @cached_property
    def _spread(self) -> Array:
        return np.asarray(self.covariance @ self.a.T)

    def tested(self) -> Tested:
        """Return the units, to be tested against everything else."""
        return Tested(self.rows, self.v, lambda u: self.m[:, u])

    @property
    def least_redundancy(self) -> float:
        """The smallest eigenvalue of M: 0 where only they tell."""
        return float(np.linalg.eigvalsh(0.5 * (self.m + self.m.T))[0]) if len(self.m) else 1.0

    def spread(self, i: int, columns: Index) -> Array:
        """Return Q Aᵀ of columns that they touch (−1: held, 0) with the rows of a unit, (m, d)."""
        out = np.zeros((len(columns), len(self.rows[i])))
        free = columns >= 0
        out[free] = self._spread[np.ix_(self._at(columns[free]), self.rows[i])]
        return out

    def partials(self, columns: Index) -> Array:
        """Return the whitened partials by columns that they touch, (k, m)."""
        return np.asarray(self.a[:, self._at(columns)])

    def variance(self, columns: Index) -> Array:
        """Return the variances of columns that they touch (−1: held, 0), (m,)."""
        out = np.zeros(len(columns))
        free = columns >= 0
        out[free] = np.diag(self.covariance)[self._at(columns[free])]
        return out

    def _at(self, columns: Index) -> Index:
        return np.asarray(np.searchsorted(self.columns, columns))

"""Cofactors of a base after a low-rank update, with those of a free network in one datum.

A free network is solved in a minimal datum, and so are the columns G = Q Bᵀ of its update. With the
basis B_0 of the motions that its datum leaves open, and B_D, the same at the datum points alone,
S = I − B_0 B_Dᵀ transforms cofactors onto the inner constraints of the base
(`solve.datum_defects.FreeDatum.transformed`):

    Q′ = S (Q − G P Gᵀ) Sᵀ,    S G = G − B_0 (Gᵀ B_D)ᵀ

Every block is in that datum. Blocks of two datums make no cofactor matrix: A Q′ Aᵀ of rows that are
insensitive to every motion is the same in each datum, but wrong, and perhaps not positive, where
variances refer to one datum and covariances to another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..graph.dependence import Variable
from ..solve.linear_base import ReducedCofactors, ReducedFunctions
from ..solve.low_rank_update import Update
from ..solve.solution import Solution
from ..types import Array, Index


@dataclass(frozen=True, eq=False)
class UpdatedCofactors:
    """Cofactors of functions of the unknowns of a base and its update."""

    base: Solution
    """The base."""
    lifted: ReducedCofactors
    """Its cofactors."""
    update: Update
    """Rows that joined or left."""
    slots: Mapping[int, int]
    """Slots of points, see `solve.linear_base`."""
    expand: Callable[[Index, Array], ReducedFunctions]
    """Returns functions of columns as functions of the coordinates of the update."""

    def joint(self, columns: Index, a: Array) -> Array:
        """Return A Q′ Aᵀ (k, k) of functions of unknowns.

        Args:
            columns: columns that the functions touch, each once, (m,).
            a: the functions, (k, m); zero at columns that are held.
        """
        if self.base.datum is None:
            f = self.expand(columns, a)
            return np.asarray(self.update.between(f.at, f.b, f.at, f.b) + f.own)
        y = np.zeros((self.base.equations.unknowns.n_columns, len(a)))
        y[columns] = a.T
        out = a @ self.base.cofactor_times(y)[columns]
        return 0.5 * (out + out.T) - self.update.loss(self._along(columns, a))

    def selected(self, variable: Variable, columns: Index) -> Array:
        """Return the cofactors of a variable of the base from its selected inverse, (m, m)."""
        size = len(columns)
        found = self.base.variable_covariance(variable)[:size, :size]
        return np.asarray(found - self.update.loss(self._along(columns, np.eye(size))))

    def _along(self, columns: Index, a: Array) -> Array:
        """Return A G (k, n), or A S G in a free network."""
        f = self.expand(columns, a)
        out = f.b @ self.update.spread[f.at]
        if self.base.datum is not None:
            out -= (a @ self.base.datum.basis[columns]) @ self._of_datum.T
        return np.asarray(out)

    @cached_property
    def _of_datum(self) -> Array:
        """Gᵀ B_D of a free network, (n, d)."""
        datum = self.base.datum
        assert datum is not None
        masked = datum.masked
        if not len(self.update.signs):
            return np.zeros((0, masked.shape[1]))
        coordinates = [self.lifted.gradient(b, self.slots) for b in masked.T]
        return np.asarray(self.update.spread.T @ np.column_stack(coordinates))

"""A section of a large network: what arrivals touch, adjusted anew beside the rest.

A photo that arrives in a block of thousands touches some hundred points. With all observations of
these points it is a small network of its own; what everything else says of its cameras stands in
the last adjustment of the whole (`factorgraph_adj.solve.prior`). Its adjustment is that of the
whole network, where the rest is linear, and the rest follows the cameras of the section:

    dx = K d,  K = Q_·T Q_TT⁻¹,   Q'_ab = Q_ab + K_a (Q'_TT − Q_TT) K_bᵀ.

Everything that arrives after the adjustment of the whole belongs to the section, which therefore
grows until the whole is adjusted again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from ..solve.drift import Drift
from ..solve.lifted import Lifted
from ..solve.prior import Marginal
from ..solve.solution import Solution
from ..types import NO_ROWS, Array, Index


@dataclass(frozen=True, eq=False)
class Section:
    """What a section knows of the rest."""

    base: Solution
    """The whole network, as it was adjusted last."""
    lifted: Lifted
    """Its cofactors."""
    inside: Index
    """Rows of the ledger in it."""
    drift: Drift | None
    """How far its linear forms were found to hold; none: that is not known."""
    columns: Index
    """Columns of T in it, (m,)."""
    spread: Array
    """Cofactors of its coordinates with T, (size, m)."""
    known: Marginal
    """What everything but the observations of the section says of T."""
    rows: Index
    """Rows of the whole network that the section has."""
    work: int
    """Rays of all sections that have been adjusted since the whole was."""
    looked: tuple[Array | None, Drift] | None = None
    """Movement of the whole (n_columns,) at the last look at how far its linear forms hold, none
    where it had not moved, and what was seen; none: nothing is known of that."""

    @property
    def vtpv(self) -> float:
        """VᵀPv of the whole less that of the section."""
        return self.base.vtpv - self.known.vtpv

    @property
    def redundancy(self) -> int:
        """Redundancy of the whole less that of the section."""
        return self.base.redundancy - self.known.redundancy

    @property
    def n_rows(self) -> int:
        """Number of rows of the whole less that of the section."""
        return self.base.n_observations - self.known.n_rows

    def renumbered(self, new: Index) -> Section:
        """Return the section after the rows of the ledger have got new numbers (n,)."""
        return replace(self, inside=renumbered(self.inside, new))

    def movement(self, d: Array) -> Array:
        """Return how the whole follows the movement d (m,) of T, (n_columns,)."""
        weights = cho_solve((self.known.root, True), d)
        return self.lifted.unknowns(self.spread @ weights, {})

    def length(self, d: Array) -> float:
        """Return the length √(dᵀ Q_TT⁻¹ d) of a movement of T, relative to σ."""
        return float(np.linalg.norm(solve_triangular(self.known.root, d, lower=True)))

    def carried(self, columns: Index) -> Array:
        """Return K of unknowns outside the section, (k, m)."""
        f = self.lifted.expand(columns, np.eye(len(columns)), {})
        return np.asarray(cho_solve((self.known.root, True), (f.b @ self.spread[f.at]).T).T)


def renumbered(rows: Index, new: Index) -> Index:
    """Return rows by their new numbers (n,); none where one of them is no more in the ledger."""
    found = new[rows]
    return NO_ROWS if (found < 0).any() else found

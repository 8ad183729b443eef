"""Section of a large network: its linear prior from the rest, and how the rest follows it.

A photo that arrives in a block of thousands touches some hundred points. With all observations of
these points it is a small network of its own; the information of all other observations on its
cameras is in the last adjustment of the whole (`factorgraph_adj.solve.added_factors`). Its
adjustment is that of the whole network, where the rest is linear, and the rest follows the cameras
of the section:

    dx = K d,  K = Q_·T Q_TT⁻¹,   Q'_ab = Q_ab + K_a (Q'_TT − Q_TT) K_bᵀ.

All arrivals after the adjustment of the whole belong to the section, which therefore grows until
the whole is adjusted again. Single rows need not make it grow: they may touch unknowns outside,
which follow T and coordinates u of their own,

    dx = K d + G u,   Q_oo − K_o Q_TT K_oᵀ = G_o G_oᵀ,   G = (Q_·o − K Q_To) G_o⁻ᵀ,

where u are independent of T and of one another and have the covariance I. Such rows are rows on T
and u beside the section.

"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve

from ..solve.added_factors import MIN_PRIOR_EIGENVALUE, MarginalPrior
from ..solve.linear_base import POINT_SLOTS, LinearisationDrift, ReducedCofactors
from ..solve.solution import Solution
from ..types import NO_ROWS, Array, Index

MAX_SECTION_WAITS = 15
"""Largest number of adjustments of the whole between two attempts to adjust a section."""
MAX_ROUNDED_VARIANCE_RATIO = 1e-13
"""Share of variances below which their difference is rounding."""


class Attempts(NamedTuple):
    """Attempts to adjust sections while the whole moves farther than its linear forms hold.

    A block that grows by much with every photo needs an adjustment of the whole for each, and that
    of a section is in vain. After k failures in a row the next 2ᵏ⁻¹ − 1 adjustments are of the
    whole without an attempt, at most `MAX_SECTION_WAITS`.
    """

    failures: int = 0
    """Failures in a row."""
    waits: int = 0
    """Number of adjustments until the next attempt."""

    def failed(self) -> Attempts:
        """Return the attempts after another failure."""
        return Attempts(self.failures + 1, min(2**self.failures - 1, MAX_SECTION_WAITS))

    def passed(self) -> Attempts:
        """Return the attempts after an adjustment of the whole."""
        return self._replace(waits=max(self.waits - 1, 0))


class Looked(NamedTuple):
    """Examination of how far the linear forms of the whole are valid."""

    movement: Array | None
    """Movement of the whole at that moment, (n_columns,); None: it had not moved."""
    drift: LinearisationDrift
    """Its result."""
    u: Array = np.zeros(0)
    """Coordinates u at that moment, (n,)."""


@dataclass(frozen=True, eq=False)
class Section:
    """A section of a large network, with its prior from the rest."""

    base: Solution
    """The whole network at its last adjustment."""
    lifted: ReducedCofactors
    """Its cofactors."""
    inside: Index
    """Rows of the ledger in it."""
    drift: LinearisationDrift | None
    """How far its linear forms were found to hold; None: that is not known."""
    columns: Index
    """Columns of T in it, (m,)."""
    spread: Array
    """Cofactors of its coordinates with T, (size, m)."""
    known: MarginalPrior
    """Information of all observations except those of the section on T."""
    rows: Index
    """Rows of the whole network that the section has."""
    work: int
    """Rays of all sections that have been adjusted since the last adjustment of the whole."""
    looked: Looked | None = None
    """The last examination of the linear forms of the whole; None: there was none."""
    reached: Index = field(default_factory=lambda: NO_ROWS)
    """Columns of the whole outside the section that rows beside it touch."""
    slots: Mapping[int, int] = field(default_factory=dict)
    """Slots of their points, as those of a system."""
    own: Array | None = None
    """G, (size, n); None: there are no u."""

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

    @property
    def n_own(self) -> int:
        """Number of coordinates u."""
        return 0 if self.own is None else self.own.shape[1]

    @cached_property
    def root(self) -> Array:
        """Root of the cofactors of T and u in the rest: L and I, (m + n, m + n)."""
        m = len(self.columns)
        out = np.eye(m + self.n_own)
        out[:m, :m] = self.known.root
        return out

    def reaching(self, columns: Index) -> Section | None:
        """Return the section beside which rows may touch more columns of the whole.

        None: there is no room for them.
        """
        new = np.setdiff1d(columns, self.reached)
        slots = self.lifted.with_slots(new, self.slots)
        if len(slots) > POINT_SLOTS:
            return None
        f = self.lifted.expand(new, np.eye(len(new)), slots)
        q = self.lifted.times(f.at, f.b)
        before = np.einsum("ij,ji->i", f.b, q[f.at])
        q -= self.spread @ cho_solve((self.known.root, True), (f.b @ self.spread[f.at]).T)
        if self.own is not None:
            q -= self.own @ (f.b @ self.own[f.at]).T
        c = f.b @ q[f.at]
        # The part independent of T may be far smaller than a weak datum makes all of it together.
        least = np.maximum(MAX_ROUNDED_VARIANCE_RATIO * before, np.finfo(float).tiny)
        sigma = np.sqrt(np.maximum(np.diag(c), least))
        c = c / np.outer(sigma, sigma)
        values, vectors = np.linalg.eigh(0.5 * (c + c.T))
        on = values > MIN_PRIOR_EIGENVALUE  # the others follow T
        own = (q / sigma) @ (vectors[:, on] / np.sqrt(values[on]))
        if self.own is not None:
            own = np.concatenate([self.own, own], axis=1)
        return replace(self, reached=np.append(self.reached, new), slots=slots, own=own)

    def movement(self, d: Array, u: Array) -> Array:
        """Return how the whole follows the movement d (m,) of T, and u (n,), (n_columns,)."""
        z = self.spread @ cho_solve((self.known.root, True), d)
        if self.own is not None:
            z += self.own @ u
        return self.lifted.unknowns(z, self.slots)

    def coordinates(self, g: Array) -> Array:
        """Return a gradient by the coordinates of the whole (size,) as one by T and u, (m + n,)."""
        of_t = cho_solve((self.known.root, True), self.spread.T @ g)
        return np.asarray(of_t if self.own is None else np.append(of_t, self.own.T @ g))

    def length(self, d: Array, u: Array) -> float:
        """Return the length √(dᵀ Q_TT⁻¹ d + uᵀu) of a movement, relative to σ."""
        return float(np.sqrt(max(self.inner(d, u, d, u), 0.0)))

    def inner(self, d: Array, u: Array, other: Array, own: Array) -> float:
        """Return the inner product of two movements whose squares are those of their lengths."""
        whitened = cho_solve((self.known.root, True), other)
        return float(d @ whitened + u @ own)

    def carried(self, columns: Index) -> Array:
        """Return K and G of unknowns outside the section, beside one another, (k, m + n)."""
        f = self.lifted.expand(columns, np.eye(len(columns)), self.slots)
        k = cho_solve((self.known.root, True), (f.b @ self.spread[f.at]).T).T
        return np.asarray(k if self.own is None else np.hstack([k, f.b @ self.own[f.at]]))


def renumbered(rows: Index, new: Index) -> Index:
    """Return rows by their new numbers (n,); none where one of them has left the ledger."""
    found = new[rows]
    return NO_ROWS if (found < 0).any() else found

"""Covariances of a design to which rows are added, or from which they are taken, one by one.

Q are the cofactors of some unknowns, and the rows touch no others: `Update` of
`factorgraph_adj.solve.update` tells what they change. With the loss Q − Q' of cofactors,

    r' = r + l (Q − Q') a                   redundancy number of an observation i, a = AᵀPe_i
    ∇x = Q' a ∇',  ∇' = δ0 / √(P_ii − aᵀQ'a)

so that nothing is solved anew. Unknowns that come with rows have no covariance before: of rows
[B, C] with C their partials, ZᵀB with ZᵀC = 0 says what they tell about the others, and
x_c = −(CᵀC)⁻¹Cᵀ B x has the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..solve.update import Update
from ..types import Array, Index, Mask
from .candidates import CandidateRows
from .targets import (
    DetectableError,
    PointTarget,
    RedundancyNumber,
    RowTarget,
    lacking,
    point_figures,
)

TIED = 1e-9
"""Singular value of the partials by new unknowns, relative, that leaves one undetermined."""


@dataclass(frozen=True, eq=False)
class Watched:
    """Observations whose redundancy number or effect a target asks for; k of them."""

    left: Array
    """Rows of A, (k, n)."""
    right: Array
    """AᵀPe_i, (k, n)."""
    weight: Array
    """P_ii, (k,)."""
    sigma: Array
    """Standard deviations, (k,)."""
    delta0: float
    """δ0 of the smallest detectable error."""


@dataclass(frozen=True, eq=False)
class PointItems:
    """Points that a target asks for."""

    target: PointTarget
    """The target."""
    places: Index
    """Places of their coordinates, −1 where held, (m, 3)."""
    horizon: Array
    """East and north of each, (m, 2, 3)."""


@dataclass(frozen=True, eq=False)
class RowItems:
    """Observations that a target asks for."""

    target: RowTarget
    """The target."""
    rows: Index
    """Which of the watched ones, (m,)."""
    places: Index
    """Places of the points whose shifts count, −1 where held, (p, 3)."""


class Covariances:
    """Q of chosen unknowns, and how far the targets are."""

    def __init__(self, q: Array, watched: Watched, items: Sequence[PointItems | RowItems]) -> None:
        """Start.

        Args:
            q: cofactors, (n, n); rows and columns of unknowns that come later are zero.
            watched: observations.
            items: what the targets ask for.
        """
        self.q, self.watched, self.items = q, watched, items
        self.refresh()

    def copy(self) -> Covariances:
        """Return a copy; what is asked for is shared."""
        return Covariances(self.q.copy(), self.watched, self.items)

    def refresh(self) -> None:
        """Work out what follows from Q."""
        w = self.watched
        qa = w.right @ self.q
        self.r = 1.0 - np.einsum("kn,kn->k", w.left, qa)
        self.precision = w.weight - np.einsum("kn,kn->k", w.right, qa)
        self._qa = np.concatenate([qa, np.zeros((len(qa), 1))], axis=1)
        self._blocks = [
            self._block(i.places) if isinstance(i, PointItems) else None for i in self.items
        ]

    def _block(self, places: Index) -> Array:
        padded = np.pad(self.q, (0, 1))
        return padded[places[:, :, None], places[:, None, :]]

    def lack(self, update: Update | None = None) -> float:
        """Return how far all targets are together, after an update if there is one."""
        total = 0.0
        for n, item in enumerate(self.items):
            total += float(lacking(item.target, self._figures(n, item, update)).sum())
        return total

    def _figures(self, n: int, item: PointItems | RowItems, update: Update | None) -> Array:
        if isinstance(item, PointItems):
            blocks = self._blocks[n]
            assert blocks is not None
            if update is not None:
                blocks = blocks - update.loss(_spread_to(update, item.places))
            return point_figures(item.target, blocks, item.horizon)
        w, rows = self.watched, item.rows
        r, precision, qa = self.r[rows], self.precision[rows], self._qa[rows]
        if update is not None:
            left, right = w.left[rows] @ update.spread, w.right[rows] @ update.spread
            r = r + update.losses(left, right)
            precision = precision + update.losses(right)
        if isinstance(item.target, RedundancyNumber):
            return np.asarray(r)
        controlled = precision > 1e-6 * w.weight[rows]
        mdb = np.full(len(rows), np.inf)
        mdb[controlled] = w.delta0 / np.sqrt(precision[controlled])
        if isinstance(item.target, DetectableError):
            return np.asarray(mdb / w.sigma[rows])
        moved = qa[:, item.places]
        if update is not None:
            lost = update.loss(_spread_to(update, item.places), right)
            moved = moved - lost.transpose(2, 0, 1)
        far = np.sqrt(np.sum(moved**2, axis=2)).max(axis=1, initial=0.0)
        return np.asarray(np.where(controlled, far * np.where(controlled, mdb, 1.0), np.inf))

    def update(self, known: Told) -> Update:
        """Return what rows would change."""
        return Update.of(self.q).with_rows(known.at, known.b)

    def add(self, known: Told) -> None:
        """Add rows, and the unknowns that come with them."""
        update = self.update(known)
        self.q -= update.loss(update.spread)
        if len(known.new):
            k = known.carry
            cross = k @ self.q[known.old]
            self.q[known.new] = cross
            self.q[:, known.new] = cross.T
            own = known.own + k @ cross[:, known.old].T
            self.q[np.ix_(known.new, known.new)] = 0.5 * (own + own.T)
        self.refresh()


def _spread_to(update: Update, places: Index) -> Array:
    """Return G of coordinates, zero where they are held (−1), (..., k)."""
    padded = np.concatenate([update.spread, np.zeros((1, update.spread.shape[1]))])
    return np.asarray(padded[places])


@dataclass(frozen=True, eq=False)
class Told:
    """What the rows of a candidate tell about unknowns that are known, and about new ones."""

    at: Index
    """Places that B touches, (m,)."""
    b: Array
    """B, (k, m)."""
    new: Index
    """Places of new unknowns, (c,)."""
    old: Index
    """Places of the others that C's rows touch, (m,)."""
    carry: Array
    """K of x_c = K x, (c, m)."""
    own: Array
    """Cofactors (CᵀC)⁻¹ of the new unknowns where the others are held, (c, c)."""


def told(rows: CandidateRows, place: Index, known: Mask) -> Told | None:
    """Return what rows tell; none where they leave new unknowns undetermined.

    Args:
        rows: of a candidate.
        place: place of each column, (n_columns,).
        known: which columns are known by now, (n_columns,).
    """
    new = ~known[rows.columns]
    old = place[rows.columns[~new]]
    b = rows.a[:, ~new]
    nothing = np.zeros(0, dtype=np.intp)
    if not new.any():
        return Told(old, b, nothing, old, np.zeros((0, len(old))), np.zeros((0, 0)))
    c = rows.a[:, new]
    scale = np.linalg.norm(c, axis=0)
    if len(c) < c.shape[1] or not scale.all():
        return None
    u, s, vt = np.linalg.svd(c / scale, full_matrices=True)
    k = c.shape[1]
    if s[-1] <= TIED * s[0]:
        return None
    inverse = (vt.T / s) / scale[:, None]
    carry = -(inverse @ u[:, :k].T) @ b
    return Told(old, u[:, k:].T @ b, place[rows.columns[new]], old, carry, inverse @ inverse.T)

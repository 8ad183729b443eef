"""Covariances of a design, updated for added or removed rows.

Q are the cofactors of those unknowns that the rows touch. `Update` of
`factorgraph_adj.solve.low_rank_update` gives the changes by the rows. With the loss Q − Q' of
cofactors,

    r' = r + l (Q − Q') a                   redundancy number of an observation i, a = AᵀPe_i
    ∇x = Q' a ∇',  ∇' = δ0 / √(P_ii − aᵀQ'a)

so that the normal equations are not solved again. New unknowns x_c have no covariance before their
rows [B, C] are added, with the partials C by the new and B by the other unknowns x. With ZᵀC = 0,
ZᵀB is the information of the rows on x, and x_c = −(CᵀC)⁻¹Cᵀ B x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ..solve.low_rank_update import Update
from ..types import Array, Index, Mask
from .candidates import CandidateRows
from .plan import DisplacementItems
from .targets import (
    DetectableDisplacement,
    DetectableError,
    PointTarget,
    RedundancyNumber,
    RowTarget,
    lacking,
    point_figures,
)

TIED = 1e-9
"""Singular value of the partials by new unknowns, relative to the largest, up to which a new
unknown is undetermined."""


@dataclass(frozen=True, eq=False)
class Watched:
    """The k observations whose redundancy number or effect a target limits."""

    left: Array
    """Rows of A, (k, n)."""
    right: Array
    """AᵀPe_i, (k, n)."""
    weight: Array
    """Weights P_ii, (k,)."""
    sigma: Array
    """Standard deviations, (k,)."""
    delta0: float
    """δ0 of the smallest detectable error."""


@dataclass(frozen=True, eq=False)
class PointItems:
    """The m points to which a target applies."""

    target: PointTarget
    """The target."""
    places: Index
    """Places of the coordinates in Q, −1 for held coordinates, (m, 3)."""
    horizon: Array
    """Unit vectors east and north at each point, (m, 2, 3)."""


@dataclass(frozen=True, eq=False)
class RowItems:
    """The m observations to which a target applies."""

    target: RowTarget
    """The target."""
    rows: Index
    """Numbers of the observations among the watched ones, (m,)."""
    places: Index
    """Places in Q of the points whose shifts count, −1 for held coordinates, (p, 3)."""


@dataclass(frozen=True, eq=False)
class JointItems:
    """The points of a target of displacements, whose figures depend on all their covariances."""

    moved: DisplacementItems
    """Points and reference points."""
    places: Index
    """Places of their coordinates in Q, (n,)."""

    @property
    def target(self) -> DetectableDisplacement:
        """The target."""
        return self.moved.target


Items: TypeAlias = PointItems | RowItems | JointItems


class Covariances:
    """Q of chosen unknowns, and the lack of the targets."""

    def __init__(self, q: Array, watched: Watched, items: Sequence[Items]) -> None:
        """Start with the cofactors of a design.

        Args:
            q: cofactors, (n, n); zero in the rows and columns of unknowns that are added later.
            watched: observations that targets limit.
            items: points and observations of the targets.
        """
        self.q, self.watched, self.items = q, watched, items
        self.refresh()

    def copy(self) -> Covariances:
        """Return a copy with its own Q; observations and items are shared."""
        return Covariances(self.q.copy(), self.watched, self.items)

    def refresh(self) -> None:
        """Compute the quantities that depend on Q."""
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
        """Return the total lack of all targets, after the update if one is given."""
        total = 0.0
        for n, item in enumerate(self.items):
            total += float(lacking(item.target, self._figures(n, item, update)).sum())
        return total

    def _figures(self, n: int, item: Items, update: Update | None) -> Array:
        if isinstance(item, PointItems):
            blocks = self._blocks[n]
            assert blocks is not None
            if update is not None:
                blocks = blocks - update.loss(_spread_to(update, item.places))
            return point_figures(item.target, blocks, item.horizon)
        if isinstance(item, JointItems):
            q = self.q[np.ix_(item.places, item.places)]
            if update is not None:
                q = q - update.loss(update.spread[item.places])
            return item.moved.figures(q)
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
        """Return the update of Q by rows."""
        return Update.of(self.q).with_rows(known.at, known.b)

    def add(self, known: Told) -> None:
        """Add rows and their new unknowns."""
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
    """Return the spread G of coordinates, zero for held coordinates (−1), (..., k)."""
    padded = np.concatenate([update.spread, np.zeros((1, update.spread.shape[1]))])
    return np.asarray(padded[places])


@dataclass(frozen=True, eq=False)
class Told:
    """Information of the rows of a candidate on known unknowns and on new ones."""

    at: Index
    """Places of the unknowns that B touches, (m,)."""
    b: Array
    """Partials B by known unknowns, (k, m)."""
    new: Index
    """Places of the new unknowns, (c,)."""
    old: Index
    """Places of the known unknowns in the rows of C, (m,)."""
    carry: Array
    """Matrix K of x_c = K x, (c, m)."""
    own: Array
    """Cofactors (CᵀC)⁻¹ of the new unknowns for held known unknowns, (c, c)."""


def told(rows: CandidateRows, place: Index, known: Mask) -> Told | None:
    """Return the information of rows; None if the rows leave a new unknown undetermined.

    Args:
        rows: rows of a candidate.
        place: place of each column in Q, (n_columns,).
        known: columns whose unknowns are determined so far, (n_columns,).
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

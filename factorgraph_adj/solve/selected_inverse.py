"""Joint covariances of sets of columns, from the cliques of the Bayes tree.

All variables of a factor lie in the clique where the first of them is eliminated. Its joint
covariance is there after one pass down the tree (Takahashi's selected inverse), and the sets of
any number of observations are looked up at once.
"""

from __future__ import annotations

import numpy as np

from ..types import Array, Index
from .factor import Factor


class SelectedInverse:
    """Covariances of tree and border of a factorised system."""

    def __init__(self, factor: Factor) -> None:
        """Lay the covariances of all cliques one after the other."""
        plan = factor.plan
        self._n = plan.unknowns.n_columns
        self._border = factor.border_covariance()
        self._in_border = plan.in_border
        self._clique = np.full(self._n, -1, dtype=np.intp)
        cliques = factor.clique_covariances()
        sizes = np.array([len(columns) for columns, _ in cliques], dtype=np.intp)
        self._size = sizes
        self._start = np.cumsum(sizes**2) - sizes**2
        self._values = np.concatenate([joint.ravel() for _, joint in cliques] or [np.zeros(0)])
        for number, c in enumerate(factor.cliques):
            self._clique[c.frontal] = number
        columns = np.concatenate([c for c, _ in cliques] or [np.zeros(0, dtype=np.intp)])
        owner = np.repeat(np.arange(len(cliques)), sizes)
        place = np.arange(len(columns)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        code = owner * self._n + columns
        order = np.argsort(code)
        self._code, self._place = code[order], place[order]

    def joint(self, columns: Index) -> Array:
        """Return the joint covariances (n, k, k) of sets of columns (n, k).

        The columns of a set belong to variables of one observation; −1 gives zeros.
        """
        out = np.zeros((*columns.shape, columns.shape[1]))
        known = columns >= 0
        safe = np.where(known, columns, 0)
        # Parents come first: the clique of the first variable that is eliminated is the last.
        clique = np.where(known, self._clique[safe], -1).max(axis=1, initial=-1)
        inside = np.flatnonzero(clique >= 0)
        if len(inside):
            at, which, has = clique[inside], safe[inside], known[inside]
            found = np.searchsorted(self._code, at[:, None] * self._n + which)
            place = np.where(has, self._place[np.minimum(found, len(self._place) - 1)], 0)
            flat = self._start[at][:, None, None] + (
                place[:, :, None] * self._size[at][:, None, None] + place[:, None, :]
            )
            pair = has[:, :, None] & has[:, None, :]
            out[inside] = np.where(pair, self._values[flat], 0.0)
        outside = np.flatnonzero((clique < 0) & known.any(axis=1))
        if len(outside):
            place = self._in_border[safe[outside]]
            has = known[outside]
            pair = has[:, :, None] & has[:, None, :]
            found_values = self._border[place[:, :, None], place[:, None, :]]
            out[outside] = np.where(pair, found_values, 0.0)
        return out

"""Joint covariances of sets of columns, from one pass down the Bayes tree.

Takahashi's selected inverse: with R x_F = d − S x_S of a clique and T = R⁻¹S,

    Σ_FS = −T Σ_SS,   Σ_FF = R⁻¹R⁻ᵀ − Σ_FS Tᵀ,

and Σ_SS is a part of the parent's joint covariance. All variables of a factor lie in the clique
that eliminates the first of them, so that the covariances of many observations are looked up at
once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..types import Array, Index
from .fronts import BlockMatrix
from .tree import Clique
from .triangular import upper_solve, upper_transposed_solve


class SelectedInverse:
    """Covariances of tree and cameras of a factorised system."""

    def __init__(
        self,
        cliques: Sequence[Clique],
        border: BlockMatrix | None,
        in_border: Index,
        n_columns: int,
    ) -> None:
        """Compute the joint covariance of each clique, from the roots to the leaves.

        Args:
            cliques: the cliques of the tree, parents first.
            border: covariances of the cameras; none: there are none.
            in_border: place of each column in them, −1 elsewhere, (n_columns,).
            n_columns: number of columns.
        """
        self._n = n_columns
        self._cliques = cliques
        self._border = border
        self._in_border = in_border
        nothing = [np.zeros(0, dtype=np.intp)]
        columns = np.concatenate([x for c in cliques for x in (c.frontal, c.separator)] or nothing)
        frontal = np.array([len(c.frontal) for c in cliques], dtype=np.intp)
        separator = np.array([len(c.separator) for c in cliques], dtype=np.intp)
        parent = np.array([c.parent for c in cliques], dtype=np.intp)
        size = self._size = frontal + separator
        first = np.cumsum(size) - size
        place = np.arange(len(columns)) - np.repeat(first, size)
        owner = np.repeat(np.arange(len(cliques)), size)
        own = place < np.repeat(frontal, size)
        self._clique = np.full(n_columns, -1, dtype=np.intp)
        self._clique[columns[own]] = owner[own]
        code = owner * n_columns + columns
        order = np.argsort(code)
        self._code, self._place = code[order], place[order]
        # Places of the separators in the parent, or among the cameras.
        there = parent[owner[~own]]
        within = np.where(
            there >= 0, self._find(np.maximum(there, 0), columns[~own]), in_border[columns[~own]]
        )
        stop = np.cumsum(separator)
        self._start = np.cumsum(size**2) - size**2
        self._values = np.empty(int(np.sum(size**2)))
        joints: list[Array] = []
        for number, c in enumerate(cliques):
            f, k = frontal[number], size[number]
            inverse = upper_solve(c.r, np.eye(f))
            at = self._start[number]
            joint = self._values[at : at + k * k].reshape(k, k)
            if k > f:
                where = within[stop[number] - (k - f) : stop[number]]
                if c.parent >= 0:
                    sss = joints[c.parent][where[:, None], where]
                else:
                    sss = self._cameras(where[None])[0]
                across = -c.t @ sss
                joint[:f, :f] = inverse @ inverse.T - across @ c.t.T
                joint[:f, f:] = across
                joint[f:, :f] = across.T
                joint[f:, f:] = sss
            else:
                joint[:] = inverse @ inverse.T
            joints.append(joint)

    def _cameras(self, places: Index) -> Array:
        """Return the joint covariances (n, k, k) of places (n, k); zero at −1: held components."""
        out = np.zeros((*places.shape, places.shape[1]))
        on = (places[:, :, None] >= 0) & (places[:, None, :] >= 0)
        if on.any():
            assert self._border is not None
            rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None, :])
            out[on] = self._border.at(rows[on], columns[on])
        return out

    def _find(self, clique: Index, columns: Index) -> Index:
        """Return the places of columns in the cliques that contain them."""
        if not len(self._code):
            return np.zeros(np.shape(columns), dtype=np.intp)
        found = np.searchsorted(self._code, clique * self._n + columns)
        return np.asarray(self._place[np.minimum(found, len(self._place) - 1)])

    def joint(self, columns: Index) -> Array:
        """Return the joint covariances (n, k, k) of sets of columns (n, k).

        The columns of a set belong to variables of one observation; −1 and held components give
        zeros.
        """
        out = np.zeros((*columns.shape, columns.shape[1]))
        safe = np.maximum(columns, 0)
        # Held components have no place in a clique or in the border.
        free = (self._clique[safe] >= 0) | (self._in_border[safe] >= 0)
        known = (columns >= 0) & free
        # Parents come first, so that the last clique eliminates the first variable.
        clique = np.where(known, self._clique[safe], -1).max(axis=1, initial=-1)
        inside = np.flatnonzero(clique >= 0)
        if len(inside):
            at, has = clique[inside], known[inside]
            place = np.where(has, self._find(at[:, None], safe[inside]), 0)
            flat = self._start[at][:, None, None] + (
                place[:, :, None] * self._size[at][:, None, None] + place[:, None, :]
            )
            pair = has[:, :, None] & has[:, None, :]
            out[inside] = np.where(pair, self._values[flat], 0.0)
        outside = np.flatnonzero((clique < 0) & known.any(axis=1))
        if len(outside):
            place = np.where(known[outside], self._in_border[safe[outside]], -1)
            out[outside] = self._cameras(place)
        return out

    def leverage(self, columns: Index, a: Array) -> Array:
        """Return A Σ Aᵀ (d, d) of one observation with partials (d, k) by columns (k,).

        The value equals that from `joint`, but is computed from the clique's own R: with
        y = R⁻ᵀ A_Fᵀ and B = A_S − A_F T,  A Σ Aᵀ = yᵀy + B Σ_SS Bᵀ.  No digits cancel if Σ_FF is
        large along a direction that the observation hardly measures, such as to a far point.
        """
        known = columns >= 0
        columns, a = columns[known], a[:, known]
        free = (self._clique[columns] >= 0) | (self._in_border[columns] >= 0)
        columns, a = columns[free], a[:, free]  # held components have no place
        number = int(self._clique[columns].max(initial=-1))
        if number < 0:
            return np.asarray(a @ self._cameras(self._in_border[columns][None])[0] @ a.T)
        c, k = self._cliques[number], int(self._size[number])
        f = len(c.frontal)
        whole = np.zeros((len(a), k))
        whole[:, self._find(np.full(len(columns), number), columns)] = a
        y = upper_transposed_solve(c.r, whole[:, :f].T)
        b = whole[:, f:] - whole[:, :f] @ c.t
        start = self._start[number]
        outer = self._values[start : start + k * k].reshape(k, k)[f:, f:]
        return np.asarray(y.T @ y + b @ outer @ b.T)

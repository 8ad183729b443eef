"""Test statistics of observations, each against everything else, itself left out.

An item is an observation or a correlated group. With the rows of several items whitened, their
residuals v and redundancy matrix M = I − A Q Aᵀ in an adjustment with all of them, every item u is
as if predicted by all the others:

    d_u = M_uu⁻¹ v_u             innovation, computed − observed
    D_u = M_uu⁻¹                 its covariance
    w_i = (M_uu⁻¹v)_i/√(…)_ii = v_i/√M_ii for single observations
    T²  = v_uᵀ M_uu⁻¹ v_u        χ² with rank(M_uu) degrees of freedom
    r_i = M_ii                   redundancy number

If u is left out, the others follow without a new solution, with M_uu⁺ = H Hᵀ and K = M_·u H:

    M ← M − K Kᵀ,    v ← v − K Hᵀ v_u.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..types import Array, Index, Mask
from .distributions import chi2_quantile
from .reliability import UNCONTROLLED


@dataclass(frozen=True, eq=False)
class Figures:
    """Figures of items, padded to the largest number of components d, (n, d)."""

    innovation: Array
    """Innovations, units of the observations; NaN where nothing else controls them.

    Where others control a combination of the components of a group, and none of them alone, these
    are the smallest ones, dᵀΣ⁻¹d, that agree with it.
    """
    sigma: Array
    """Their standard deviations; infinite where nothing else controls them."""
    w: Array
    """Test values; NaN where nothing else controls them."""
    redundancy_numbers: Array
    """Redundancy numbers."""
    t2: Array
    """T² of every item, (n,)."""
    dof: Index
    """Its degrees of freedom, (n,)."""


class Tested:
    """M and v of items, of which some may be left out one after the other."""

    def __init__(
        self,
        rows: Sequence[Index],
        v: Array,
        m: Callable[[Index], Array],
        blocks: Array | None = None,
    ) -> None:
        """Take over n items with k rows.

        Args:
            rows: rows of each item.
            v: residuals, (k,).
            m: returns the columns M_·u (k, u) of some rows u.
            blocks: M_uu of every item, padded with zeros, (n, d, d); none: they come from ``m``.
        """
        self.rows = rows
        self.v = v.copy()
        self._m = m
        most = max((len(r) for r in rows), default=1)
        self.place = np.zeros((len(rows), most), dtype=np.intp)
        self.valid: Mask = np.zeros((len(rows), most), dtype=bool)
        for i, own in enumerate(rows):
            self.place[i, : len(own)] = own
            self.valid[i, : len(own)] = True
        if blocks is None:
            whole = m(np.arange(len(v)))
            blocks = whole[self.place[:, :, None], self.place[:, None, :]]
        self.blocks = np.where(self.valid[:, :, None] & self.valid[:, None, :], blocks, 0.0)
        self._left: list[Array] = []
        self._gone: Index = np.zeros(0, dtype=np.intp)

    def block(self, i: int) -> Array:
        """Return M_uu of an item."""
        d = len(self.rows[i])
        return self.blocks[i, :d, :d]

    def residual(self) -> Array:
        """Return the residuals of all items, padded with zeros, (n, d)."""
        return np.where(self.valid, self.v[self.place], 0.0)

    def statistics(self) -> tuple[Array, Index]:
        """Return T² and its degrees of freedom of every item, (n,)."""
        values, vectors = np.linalg.eigh(self.blocks)
        on = values > UNCONTROLLED
        along = np.einsum("nij,ni->nj", vectors, self.residual())
        with np.errstate(over="ignore", invalid="ignore"):
            part = np.where(on, along**2 / np.where(on, values, 1.0), 0.0)
        return part.sum(axis=1), on.sum(axis=1)

    def ratios(self, alpha: float) -> Array:
        """Return T² relative to its critical value, (n,); zero where nothing controls an item."""
        t2, dof = self.statistics()
        most = int(np.max(dof, initial=0))
        critical = np.array([critical_t2(alpha, k) if k else np.inf for k in range(1 + most)])
        # A value too far off for its square is beyond every critical value.
        return np.where(np.isnan(t2), np.inf, t2 / critical[dof])

    def leave_out(self, i: int) -> None:
        """Leave an item out."""
        u = self.rows[i]
        columns = self._m(u)
        for k in self._left:
            columns = columns - k @ k[u].T
        columns[self._gone] = 0.0
        values, vectors = np.linalg.eigh(self.block(i))
        on = values > UNCONTROLLED
        half = vectors[:, on] / np.sqrt(values[on])
        gain = columns @ half
        self.v = self.v - gain @ (half.T @ self.v[u])
        padded = np.where(self.valid[:, :, None], gain[self.place], 0.0)
        self.blocks = self.blocks - padded @ padded.transpose(0, 2, 1)
        self.blocks[i] = 0.0
        self.v[u] = 0.0
        self._left.append(gain)
        self._gone = np.append(self._gone, u)

    def figures(self, raw: Sequence[Array], chosen: Index) -> Figures:
        """Return the figures of some items, (n,).

        Args:
            raw: L of each item with Σ = L Lᵀ.
            chosen: numbers of the items, (n,).
        """
        n, most = len(chosen), self.place.shape[1]
        root = np.broadcast_to(np.eye(most), (n, most, most)).copy()
        for i, number in enumerate(chosen.tolist()):
            own = raw[number]
            root[i, : len(own), : len(own)] = own
        v, m = self.residual()[chosen], self.blocks[chosen]
        values, vectors = np.linalg.eigh(m)
        on = values > UNCONTROLLED
        scaled = vectors * np.where(on, 1.0 / np.where(on, values, 1.0), 0.0)[:, None, :]
        inverse = scaled @ vectors.transpose(0, 2, 1)
        half = np.linalg.inv(root)
        innovation = np.einsum("nij,njk,nk->ni", root, inverse, v)
        variance = np.einsum("nij,njk,nik->ni", root, inverse, root)
        pv = np.einsum("nji,nj->ni", half, v)
        precision = np.einsum("nji,njk,nki->ni", half, m, half)
        weight = np.einsum("nji,nji->ni", half, half)
        controlled = precision > UNCONTROLLED * weight
        w = np.where(controlled, pv / np.sqrt(np.where(controlled, precision, 1.0)), np.nan)
        t2, dof = self.statistics()
        return Figures(
            np.where(controlled, innovation, np.nan),
            np.where(controlled, np.sqrt(np.maximum(variance, 0.0)), np.inf),
            w,
            np.einsum("nij,njk,nki->ni", root, m, half),
            t2[chosen],
            dof[chosen],
        )


@lru_cache(maxsize=256)
def critical_t2(alpha: float, dof: int) -> float:
    """Return the critical value of T²: the quantile 1 − α of χ² with ``dof`` degrees."""
    return chi2_quantile(1.0 - alpha, dof) if dof else np.nan

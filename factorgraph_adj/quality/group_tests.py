"""T² tests and reliability of correlated groups and users' factors; leave-one-out tests.

Correlated groups (GNSS vectors, control with covariance, clusters): for an error ∇ of all d
components of a group at once, with E choosing its rows, M = Eᵀ P Q_vv P E and u = Eᵀ P v (Baarda
1968; Teunissen 2000),

    T = uᵀ M⁻¹ u ~ χ²_d,    ∇̂ = −M⁻¹ u,    ∇ᵀ M ∇ = λ0(α0, power, d) at the limit of detection.

A factor that a user added has k whitened rows with the residuals v and the redundancy matrix
M = I − A Q Aᵀ. Its rows count in standard deviations of the noise model that the user gave it:

    redundancy numbers    r_i = M_ii
    test values           w_i = v_i / √M_ii
    of all rows           T² = vᵀ M⁻¹ v, χ² with rank(M) degrees of freedom
    smallest detectable   ∇_i = δ0 / √r_i, in σ of the row
    external reliability  δ̄_i = δ0 √((1 − r_i)/r_i)

The rows of a factor without a Jacobian are those of a square root of its information, see
`factorgraph_adj.graph.user_factors`: their T² has a meaning, their single figures have none.

Leave-one-out tests: an item u is an observation or a correlated group. With the whitened rows of
several items, their v and M, every item is as if predicted by all the others:

    d_u = M_uu⁻¹ v_u             innovation, computed − observed
    D_u = M_uu⁻¹                 its covariance
    w_i = (M_uu⁻¹v)_i/√(…)_ii = v_i/√M_ii for single observations
    T²  = v_uᵀ M_uu⁻¹ v_u        χ² with rank(M_uu) degrees of freedom

If u is left out, the others follow without a new solution, with M_uu⁺ = H Hᵀ and K = M_·u H:

    M ← M − K Kᵀ,    v ← v − K Hᵀ v_u.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Literal

import numpy as np

from ..solve.leverages import ClusterLeverage
from ..solve.linearised_equations import ExtraRows
from ..solve.solution import Solution
from ..statistical_tests import ChiSquareTest, chi2_quantile, noncentrality_of_power
from ..types import Array, Index, Mask
from .error_effects import weighted_rows

Test = Literal["baarda", "pope"]
"""Baarda's w with σ0 = 1, or Pope's τ with the estimated σ̂0."""
MIN_CONTROLLED_SHARE = 1e-6
"""Share of an error in the residuals above which an observation counts as controlled: a redundancy
number, or an eigenvalue of M. Below this share the smallest detectable error is more than 4000 σ,
and rounding errors dominate."""
ROUNDED_SHARE = 10.0
"""Share of an error in the residuals up to which rounding alone may make it, relative to the error
of variances that probes of the factorisation have shown. Eight of them all show less than a tenth
of it with a probability of 2·10⁻⁹."""


def least_share(solution: Solution) -> float:
    """Return the share of an error in the residuals above which an observation is controlled.

    Normal equations of a weak network leave an observation that nothing controls, such as the only
    height that is given, a share as large as the relative error of its variances.
    """
    return max(MIN_CONTROLLED_SHARE, ROUNDED_SHARE * solution.factor.uncertainty)


@dataclass(frozen=True, eq=False)
class FactorReliability(ChiSquareTest):
    """Reliability of a factor that the user added; arrays over its k rows."""

    name: str
    """Its name; ``factor 1 (RangeFactor3)`` where the user gave none."""
    residuals: Array
    """v, in σ of the noise model, computed − observed, (k,)."""
    redundancy_numbers: Array
    """r, from 0 to 1, (k,)."""
    e1: Array
    """Part of an error that goes into all unknowns except object points, (k,)."""
    w: Array
    """Test values of Baarda, (k,); NaN where nothing else controls a row."""
    mdb: Array
    """Smallest detectable error ∇, in σ of the row, (k,); infinite where nothing controls it."""
    delta_bar: Array
    """External reliability δ̄, (k,)."""
    t2: float
    """T² of all rows; NaN where nothing else controls any of them."""
    dof: int
    """Its degrees of freedom."""
    critical: float
    """Critical value of T²; NaN without degrees of freedom."""


def factor_reliability(
    rows: ExtraRows,
    found: ClusterLeverage,
    alpha: float,
    delta0: float,
    sigma0: float,
    least: float,
) -> FactorReliability:
    """Return the figures of a factor.

    Args:
        rows: its rows.
        found: their leverages.
        alpha: probability α0 of a false alarm.
        delta0: δ0 of a single test.
        sigma0: σ0 of the smallest detectable errors.
        least: share of an error in the residuals above which a row is controlled.
    """
    m = np.eye(len(found.hat)) - found.hat
    r = np.diag(m).copy()
    on = r > least
    root = np.sqrt(np.where(on, r, np.nan))
    t2, dof = t2_statistic(rows.residual, m, least)
    return FactorReliability(
        name=rows.name,
        residuals=rows.residual,
        redundancy_numbers=r,
        e1=np.diag(found.others).copy(),
        w=rows.residual / root,
        mdb=np.where(on, delta0 * sigma0 / root, np.inf),
        delta_bar=np.where(on, delta0 * np.sqrt(np.maximum(1.0 - r, 0.0)) / root, np.inf),
        t2=t2,
        dof=dof,
        critical=chi2_quantile(1.0 - alpha, dof) if dof else np.nan,
    )


def t2_statistic(v: Array, m: Array, least: float) -> tuple[float, int]:
    """Return T² = vᵀ M⁺ v and rank(M); NaN where M vanishes.

    Args:
        v: residuals with their own covariance M, (k,), such as those of the rows of a factor.
        m: M, (k, k).
        least: eigenvalue of M above which its direction is controlled.
    """
    values, vectors = np.linalg.eigh(0.5 * (m + m.T))
    on = values > least
    dof = int(on.sum())
    if not dof:
        return np.nan, 0
    return float(np.sum((vectors[:, on].T @ v) ** 2 / values[on])), dof


@dataclass(frozen=True)
class GroupReliability:
    """One correlated observation or cluster."""

    ids: tuple[str, ...]
    """Ids of the observations in the group."""
    rows: Index
    """Scalar rows of the observations, (d,)."""
    redundancy: float
    """Trace of the group's block of Q_vv P, 0 to d."""
    dof: int
    """Rank of M: number of components of an error that other observations control."""
    test: float
    """T, χ² with ``dof`` degrees of freedom; NaN for an uncontrolled group (``dof`` = 0)."""
    critical: float
    """Critical value of T."""
    estimated_error: Array
    """∇̂ = observed − true, (d,), units of the observations; zero in uncontrolled directions."""
    weakest: Array
    """Smallest detectable error in the direction in which it is largest, (d,); the components of
    uncontrolled directions are infinite."""
    external: float
    """Largest δ̄ of an error of the smallest detectable size; infinite if any direction is
    uncontrolled."""


@lru_cache(maxsize=256)
def noncentrality_of_group(alpha: float, power: float, dof: int) -> float:
    """Return λ0 of χ² with ``dof`` degrees of freedom; λ0 = δ0² for one degree of freedom."""
    # Imported here, because only correlated groups need it and its import is slow.
    from scipy.stats import ncx2

    critical = chi2_quantile(1.0 - alpha, dof)
    return noncentrality_of_power(lambda x: float(ncx2.sf(critical, dof, x)), power)


def group_reliability(
    ids: tuple[str, ...],
    rows: Index,
    whitener: Array,
    hat: Array,
    weighted_residual: Array,
    members: Index,
    limits: tuple[float, float],
    scale: float,
    least: float,
) -> GroupReliability:
    """Return the figures of a group of rows.

    Args:
        ids: observations of the group.
        rows: rows of these observations in the network, (d,).
        whitener: W of the block or cluster that contains the group, (k, k).
        hat: Ã Q Ãᵀ of the block or cluster, (k, k).
        weighted_residual: P v of the group, (d,).
        members: places of the group's rows among the k, (d,).
        limits: α0 and power.
        scale: σ0 of the smallest detectable error.
        least: share of an error in the residuals above which a direction is controlled.
    """
    unseen = np.eye(len(hat)) - hat
    share = np.linalg.solve(whitener, unseen @ whitener)
    m = (whitener.T @ unseen @ whitener)[np.ix_(members, members)]
    p = (whitener.T @ whitener)[np.ix_(members, members)]
    # With P of the group scaled to the identity, the eigenvalues of M are shares from 0 to 1.
    root = np.linalg.cholesky(p)
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ m @ inverse.T)
    on = values > least
    dof = int(on.sum())
    basis = inverse.T @ vectors  # errors that are orthonormal in P
    u = basis.T @ weighted_residual
    d = len(rows)
    if not dof:
        nan = np.full(d, np.nan)
        redundancy = float(np.trace(share[np.ix_(members, members)]))
        return GroupReliability(
            ids, rows, redundancy, 0, np.nan, np.nan, nan, np.full(d, np.inf), np.inf
        )
    limit = noncentrality_of_group(*limits, dof)
    estimated = -basis[:, on] @ (u[on] / values[on])
    weakest = (
        basis[:, 0] * np.sqrt(limit / values[0]) * scale
        if on.all()
        else _infinite_where_uncontrolled(basis, on)
    )
    lost = (whitener.T @ hat @ whitener)[np.ix_(members, members)]
    external = np.inf
    if on.all():
        hidden = basis.T @ lost @ basis / np.sqrt(np.outer(values, values))
        external = float(np.sqrt(limit * max(float(np.linalg.eigvalsh(hidden)[-1]), 0.0)))
    return GroupReliability(
        ids,
        rows,
        float(np.trace(share[np.ix_(members, members)])),
        dof,
        float(np.sum(u[on] ** 2 / values[on])),
        critical_t2(limits[0], dof),
        estimated,
        weakest,
        external,
    )


def _infinite_where_uncontrolled(basis: Array, on: Mask) -> Array:
    """Return infinity in the components of uncontrolled directions, zero elsewhere."""
    touched = np.any(np.abs(basis[:, ~on]) > 1e-9 * np.abs(basis).max(), axis=1)
    return np.where(touched, np.inf, 0.0)


def group_reliabilities(
    solution: Solution,
    hats: tuple[list[Array], list[Array]],
    limits: tuple[float, float],
    scale: float,
) -> tuple[GroupReliability, ...]:
    """Return every correlated observation, and every cluster of several of them, as a group.

    Args:
        solution: the adjustment.
        hats: Ã Q Ãᵀ of blocks and clusters.
        limits: α0 and power.
        scale: σ0 of the smallest detectable errors.
    """
    equations = solution.equations
    residual = solution.normal().system.residual
    pv = weighted_rows(equations, residual[:, None])[:, 0]
    of = partial(group_reliability, limits=limits, scale=scale, least=least_share(solution))
    out = []
    for number, block in enumerate(equations.blocks):
        if block.whitener is None:
            continue
        clustered = set(equations.in_cluster.get(number, np.zeros(0, dtype=np.intp)).tolist())
        every = np.arange(block.dimension)
        for i in range(block.n):
            if i not in clustered:
                rows = block.first_row + i * block.dimension + every
                w, hat = block.whitener[i], hats[0][number][i]
                out.append(of((block.ids[i],), rows, w, hat, pv[rows], every))
    ids = solution.observations.ids
    for c, hat in zip(equations.clusters, hats[1], strict=True):
        names = [ids[r] for r in c.rows]
        single = dict.fromkeys(names)
        for name in single:
            members = np.array([i for i, n in enumerate(names) if n == name], dtype=np.intp)
            rows = c.rows[members]
            out.append(of((name,), rows, c.whitener, hat, pv[rows], members))
        if len(single) > 1:
            members = np.arange(len(c.rows))
            out.append(of(tuple(single), c.rows, c.whitener, hat, pv[c.rows], members))
    return tuple(out)


@dataclass(frozen=True, eq=False)
class LeaveOneOutFigures:
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


class LeaveOneOutTests:
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
            blocks: M_uu of every item, padded with zeros, (n, d, d); None: they come from ``m``.
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
        on = values > MIN_CONTROLLED_SHARE
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
        on = values > MIN_CONTROLLED_SHARE
        half = vectors[:, on] / np.sqrt(values[on])
        gain = columns @ half
        self.v = self.v - gain @ (half.T @ self.v[u])
        padded = np.where(self.valid[:, :, None], gain[self.place], 0.0)
        self.blocks = self.blocks - padded @ padded.transpose(0, 2, 1)
        self.blocks[i] = 0.0
        self.v[u] = 0.0
        self._left.append(gain)
        self._gone = np.append(self._gone, u)

    def figures(self, raw: Sequence[Array], chosen: Index) -> LeaveOneOutFigures:
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
        on = values > MIN_CONTROLLED_SHARE
        scaled = vectors * np.where(on, 1.0 / np.where(on, values, 1.0), 0.0)[:, None, :]
        inverse = scaled @ vectors.transpose(0, 2, 1)
        half = np.linalg.inv(root)
        innovation = np.einsum("nij,njk,nk->ni", root, inverse, v)
        variance = np.einsum("nij,njk,nik->ni", root, inverse, root)
        pv = np.einsum("nji,nj->ni", half, v)
        precision = np.einsum("nji,njk,nki->ni", half, m, half)
        weight = np.einsum("nji,nji->ni", half, half)
        controlled = precision > MIN_CONTROLLED_SHARE * weight
        w = np.where(controlled, pv / np.sqrt(np.where(controlled, precision, 1.0)), np.nan)
        t2, dof = self.statistics()
        return LeaveOneOutFigures(
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

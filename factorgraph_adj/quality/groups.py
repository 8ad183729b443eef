"""Tests of correlated groups as a whole: GNSS vectors, control with covariance, clusters.

For an error ∇ of all d components of a group at once, with E choosing its rows, M = Eᵀ P Q_vv P E
and u = Eᵀ P v (Baarda 1968; Teunissen 2000):

    T = uᵀ M⁻¹ u ~ χ²_d,    ∇̂ = −M⁻¹ u,    ∇ᵀ M ∇ = λ0(α0, power, d) at the limit of detection.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..solve.solution import Solution
from ..types import Array, Index, Mask
from .distributions import chi2_quantile
from .rows import weighted

RANK = 1e-6
"""Share of an error in the residuals above which it counts as controlled; the same value as for
single observations."""


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


def noncentrality_of_group(alpha: float, power: float, dof: int) -> float:
    """Return λ0 of χ² with ``dof`` degrees of freedom; λ0 = δ0² for one degree of freedom."""
    # Imported here, because only correlated groups need these modules and their import is slow.
    from scipy.optimize import brentq
    from scipy.stats import ncx2

    critical = chi2_quantile(1.0 - alpha, dof)

    def missing(value: float) -> float:
        return float(ncx2.sf(critical, dof, value)) - power

    top = 10.0
    while missing(top) < 0:
        top *= 2.0
    return float(brentq(missing, 1e-9, top, xtol=1e-12))


def group_reliability(
    ids: tuple[str, ...],
    rows: Index,
    whitener: Array,
    hat: Array,
    weighted_residual: Array,
    members: Index,
    limits: tuple[float, float],
    scale: float,
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
    """
    unseen = np.eye(len(hat)) - hat
    share = np.linalg.solve(whitener, unseen @ whitener)
    m = (whitener.T @ unseen @ whitener)[np.ix_(members, members)]
    p = (whitener.T @ whitener)[np.ix_(members, members)]
    # With P of the group scaled to the identity, the eigenvalues of M are shares from 0 to 1.
    root = np.linalg.cholesky(p)
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ m @ inverse.T)
    on = values > RANK
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
    weakest = basis[:, 0] * np.sqrt(limit / values[0]) * scale if on.all() else _open(basis, on)
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
        chi2_quantile(1.0 - limits[0], dof),
        estimated,
        weakest,
        external,
    )


def _open(basis: Array, on: Mask) -> Array:
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
    pv = weighted(equations, residual[:, None])[:, 0]
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
                out.append(
                    group_reliability((block.ids[i],), rows, w, hat, pv[rows], every, limits, scale)
                )
    ids = solution.observations.ids
    for c, hat in zip(equations.clusters, hats[1], strict=True):
        names = [ids[r] for r in c.rows]
        single = dict.fromkeys(names)
        for name in single:
            members = np.array([i for i, n in enumerate(names) if n == name], dtype=np.intp)
            rows = c.rows[members]
            out.append(
                group_reliability((name,), rows, c.whitener, hat, pv[rows], members, limits, scale)
            )
        if len(single) > 1:
            members = np.arange(len(c.rows))
            out.append(
                group_reliability(
                    tuple(single), c.rows, c.whitener, hat, pv[c.rows], members, limits, scale
                )
            )
    return tuple(out)

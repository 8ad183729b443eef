"""The test of an error that several observations share, described by columns.

Where observations l have an error C ∇ with unknown ∇ (q,), the model is f(x) + C ∇ = l. With the
residuals v and P Q_vv P = P − P A Q AᵀP of the adjustment without ∇,

    u = CᵀP v,   S = CᵀP Q_vv P C
    ∇̂ = −S⁻¹ u,   Σ_∇ = S⁻¹,   T² = uᵀ S⁻¹ u,

T² is χ² with q degrees of freedom without an error, and vᵀPv decreases by T² where ∇ is an unknown
(Baarda 1968; Teunissen 2006). Nothing is adjusted again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csc_array, csr_array, diags_array

from ...graph.equations import Equations
from ...solve.solution import Solution
from ...types import NO_ROWS, Array, Index

CHUNK = 4_000_000
"""Largest number of elements of the dense right-hand sides that are solved at once."""
ROWS = 100_000
"""Number of rows whose partials are in memory at once."""
CONTROLLED = 1e-6
"""Share of an error in the residuals below which nothing tells of it, as for observations."""


@dataclass(frozen=True)
class Explained:
    """What an error with q components explains."""

    error: Array
    """Estimated error ∇̂, (q,); NaN for components that the residuals do not tell of."""
    sigma: Array
    """Its standard deviations for σ0 = 1, (q,); infinite for such components."""
    t2: float
    """T²; NaN if the residuals tell of no component."""
    dof: int
    """Number of components that the residuals tell of."""


def whitening(equations: Equations) -> csr_array:
    """Return W with W Σ Wᵀ = I of all observations, (n_rows, n_rows)."""
    diagonal = 1.0 / equations.sigmas()
    parts: list[tuple[Array, Index, Index]] = []
    for place, block in enumerate(equations.blocks):
        if block.whitener is None:
            continue
        alone = np.setdiff1d(np.arange(block.n), equations.in_cluster.get(place, NO_ROWS))
        rows = np.arange(block.rows.start, block.rows.stop).reshape(block.observed.shape)[alone]
        diagonal[rows] = 0.0
        i, j = np.broadcast_arrays(rows[:, :, None], rows[:, None, :])
        parts.append((block.whitener[alone].ravel(), i.ravel(), j.ravel()))
    for c in equations.clusters:
        diagonal[c.rows] = 0.0
        i, j = np.broadcast_arrays(c.rows[:, None], c.rows[None, :])
        parts.append((c.whitener.ravel(), i.ravel(), j.ravel()))
    out = csr_array(diags_array(diagonal))
    if parts:
        values, i, j = (np.concatenate(x) for x in zip(*parts, strict=True))
        out = out + csr_array(coo_array((values, (i, j)), shape=out.shape))
    return csr_array(out)


def explain(solution: Solution, columns: csc_array, groups: Sequence[Index]) -> list[Explained]:
    """Test errors that several observations share.

    Args:
        solution: the adjustment without them.
        columns: W C of all of them beside one another, (n_rows, k).
        groups: the columns of each error.
    """

    def pieces(at: Index) -> Iterator[tuple[Index, csr_array]]:
        z = csr_array(columns[:, at])
        for rows in in_pieces(np.flatnonzero(np.diff(z.indptr))):
            yield rows, csr_array(z[rows])

    return explain_pieces(solution, pieces, groups)


def in_pieces(rows: Index) -> list[Index]:
    """Divide rows so that their partials take bounded memory."""
    return np.array_split(rows, -(-len(rows) // ROWS)) if len(rows) else []


def explain_pieces(
    solution: Solution,
    pieces: Callable[[Index], Iterator[tuple[Index, csr_array]]],
    groups: Sequence[Index],
) -> list[Explained]:
    """Test errors whose columns are made piece by piece.

    Args:
        solution: the adjustment without them.
        pieces: (columns, (k,)) → rows (r,), and W C of these rows and columns, (r, k); rows where
            all of them are zero may be left out.
        groups: the columns of each error.
    """
    most = max(1, CHUNK // max(solution.equations.unknowns.n_columns, 1))
    out: list[Explained] = []
    part: list[Index] = []
    for group in groups:
        if part and sum(map(len, part)) + len(group) > most:
            out += _explain(solution, pieces, part)
            part = []
        part.append(group)
    return out + (_explain(solution, pieces, part) if part else [])


def _explain(
    solution: Solution,
    pieces: Callable[[Index], Iterator[tuple[Index, csr_array]]],
    groups: Sequence[Index],
) -> list[Explained]:
    system = solution.normal().system
    at = np.concatenate(groups)
    k = len(at)
    u, total = np.zeros(k), csr_array((k, k))
    y = np.zeros((solution.equations.unknowns.n_columns, k))
    for rows, z in pieces(at):
        u += z.T @ system.residual[rows]
        total = total + z.T @ z
        y += system.sparse(rows).T @ z.toarray()
    q = solution.cofactor_times(y)
    first, out = 0, []
    for group in groups:
        own = slice(first, first + len(group))
        mine = total[own][:, own].toarray()
        s = mine - y[:, own].T @ q[:, own]
        out.append(_of_one(u[own], s, np.diag(mine)))
        first += len(group)
    return out


def gains(solution: Solution, columns: csc_array, q: int) -> Array:
    """Return T² of errors with q components each, (h,); 0 where the residuals do not tell of one.

    Args:
        solution: the adjustment without them.
        columns: W C of all of them beside one another, (n_rows, h q).
        q: number of components.
    """
    system = solution.normal().system
    rows: Index = np.unique(columns.indices).astype(np.intp)
    a, v = system.sparse(rows), system.residual[rows]
    at_once = max(1, CHUNK // max(q * a.shape[1], 1)) * q
    out = []
    for first in range(0, columns.shape[1], at_once):
        z = csr_array(columns[:, first : first + at_once])[rows]
        y = (a.T @ z).toarray()
        s = -np.einsum(
            "uhi,uhj->hij",
            y.reshape(len(y), -1, q),
            solution.cofactor_times(y).reshape(len(y), -1, q),
        )
        for i in range(q):
            for j in range(q):
                s[:, i, j] += np.asarray(z[:, i::q].multiply(z[:, j::q]).sum(axis=0)).ravel()
        total = np.asarray(z.multiply(z).sum(axis=0)).reshape(-1, q)
        scale = np.sqrt(np.where(total > 0, total, 1.0))
        values, vectors = np.linalg.eigh(s / (scale[:, :, None] * scale[:, None, :]))
        along = np.einsum("hij,hi->hj", vectors, (z.T @ v).reshape(-1, q) / scale)
        seen = values > CONTROLLED
        out.append(np.sum(np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0), axis=1))
    return np.concatenate(out) if out else np.zeros(0)


def beside(
    solution: Solution, columns: csc_array, one: Index, other: Index
) -> tuple[Explained, Explained, Array]:
    """Return what one error explains, what another one explains beside it, and S of the latter.

    With u and S of both together, the other one has, with the first as an unknown,

        u₂₁ = u₂ − S₂₁ S₁₁⁻¹ u₁,   S₂₂₁ = S₂₂ − S₂₁ S₁₁⁻¹ S₁₂.

    Args:
        solution: the adjustment without them.
        columns: W C of both beside one another, (n_rows, k).
        one: columns of the first; the residuals tell of all its components.
        other: columns of the other.
    """
    system = solution.normal().system
    rows: Index = np.unique(columns.indices).astype(np.intp)
    z = csr_array(columns)[rows]
    y = system.sparse(rows).T @ z.toarray()
    total = (z.T @ z).toarray()
    u, s = z.T @ system.residual[rows], total - y.T @ solution.cofactor_times(y)
    own, size = s[np.ix_(one, one)], np.diag(total)
    moved = np.linalg.solve(own, np.column_stack([u[one], s[np.ix_(one, other)]]))
    left = s[np.ix_(other, other)] - s[np.ix_(other, one)] @ moved[:, 1:]
    rest = u[other] - s[np.ix_(other, one)] @ moved[:, 0]
    return _of_one(u[one], own, size[one]), _of_one(rest, left, size[other]), left


def _of_one(u: Array, s: Array, total: Array) -> Explained:
    """Return what one error explains, from u, S and the diagonal of CᵀPC."""
    scale = np.sqrt(np.where(total > 0, total, 1.0))
    values, vectors = np.linalg.eigh(0.5 * (s + s.T) / np.outer(scale, scale))
    seen = values > CONTROLLED
    along = vectors[:, seen].T @ (u / scale)
    t2 = float(np.sum(along**2 / values[seen])) if seen.any() else np.nan
    error = -(vectors[:, seen] @ (along / values[seen])) / scale
    sigma = np.sqrt(np.sum(vectors[:, seen] ** 2 / values[seen], axis=1)) / scale
    # A component of which nothing tells has a part in what is not seen.
    open_ = np.sum(vectors[:, ~seen] ** 2, axis=1) > CONTROLLED
    return Explained(
        np.where(open_, np.nan, error), np.where(open_, np.inf, sigma), t2, int(seen.sum())
    )

"""Information of the residuals of observation groups on the variances of the groups.

With whitened observation equations v = A dx + l, R = I − A Q Aᵀ projects errors to residuals.
For disjoint groups g with one variance each,

    q_g  = v_gᵀv_g                      weighted square sum of the residuals, E(q_g) = r_g,
    r_g  = tr R_gg                      redundancy of the group, Σ r_g = redundancy,
    S_gh = tr(R_gh R_hg) = ‖R_gh‖²_F    with Σ_h S_gh = r_g, for R is idempotent:

S is the matrix of Helmert's equations S σ² = q, and cov(ln σ̂²) = 2 S⁻¹ (Koch 1999, § 3.6;
Förstner 1979; Amiri-Simkooei 2007, with N_gh = ½ tr(Q_g W Q_h W), W = P Q_vv P). The residuals
give

    B_gh = v_gᵀR_gh v_h,   E(B) = S,   ∂(r − q)/∂ln σ² = 2 B − S + diag(r − q),

where B is the average information of Gilmour, Thompson & Cullis (1995, Biometrics 51, 1440–1450).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..solve.linear import LinearSystem
from ..solve.solution import Solution
from ..types import Array
from .observation_groups import ObservationGroups
from .reliability import reliability

EXACT_ROWS = 2000
"""Scalar observations up to which R is computed as a whole."""
FEW, MANY, LEAST = 2, 64, 4
"""Numbers of random sign vectors in larger networks: `FEW` for each group during the iteration,
`MANY` for all groups together at its end, but at least `LEAST` for each group."""
AT_ONCE = 16
"""Number of columns that are projected at once."""


@dataclass(frozen=True, eq=False)
class GroupRedundancy:
    """Square sums, redundancies and S of k groups at one solution."""

    squares: Array
    """q (k,)."""
    redundancy: Array
    """r (k,)."""
    information: Array
    """S (k, k)."""
    average: Array
    """B (k, k)."""
    exact: bool
    """Whether S is exact, or estimated from random probes."""
    probed: Array | None = None
    """The estimate from the probes, (k + 1, k + 1); the last one is for rows without a group."""


def group_redundancy(
    solution: Solution,
    groups: ObservationGroups,
    *,
    seed: int = 0,
    exact: bool | None = None,
    earlier: GroupRedundancy | None = None,
) -> GroupRedundancy:
    """Return q, r, S and B of groups of observations; correlated observations share a group.

    With up to `EXACT_ROWS` observations the figures are computed from R itself. In larger networks
    r is the sum of the redundancy numbers, and S is estimated by stochastic traces (Hutchinson
    1990): with independent random signs z_g over the rows of group g, E‖(R z_g)_h‖² = S_gh. The
    diagonal element, usually by far the largest of its row, follows from r:
    S_gg = r_g − Σ_{h≠g} S_gh. This makes it nearly exact.

    Args:
        solution: an adjustment.
        groups: the group of each observation.
        seed: seed of the random signs.
        exact: whether S is computed exactly; None: up to `EXACT_ROWS` observations.
        earlier: figures with other weights, whose probes serve again: what one group has in
            another hardly changes, and r, q and B are those of the solution.
    """
    k = len(groups.names)
    system = solution.normal().system
    every = _with_extra(groups, system)
    if exact is None:
        exact = len(every.of_row) <= EXACT_ROWS
    projector, probed = None, None
    if exact:
        a = system.times(np.eye(system.unknowns.n_columns))
        projector = np.eye(len(a)) - a @ solution.factor.solve(a.T)
        redundancy = every.sums(np.diag(projector))[:k]
        half = every.sums(np.square(projector))
        s = every.sums(np.ascontiguousarray(half.T))[:k, :k]
    else:
        redundancy = groups.sums(reliability(solution).redundancy_numbers)[:k]
        probed = None if earlier is None else earlier.probed
        if probed is None:
            probed = _by_probes(solution, every, np.random.default_rng(seed), FEW)
        s = _completed(probed, redundancy)
    v = np.zeros(len(every.of_row))
    v[: len(system.residual)] = system.residual
    average = np.empty((k, k))
    for first in range(0, k, AT_ONCE):
        chosen = np.arange(first, min(first + AT_ONCE, k))
        z = np.where(every.of_row[:, None] == chosen, v[:, None], 0.0)
        z = _project(solution, z) if projector is None else projector @ z
        average[:, chosen] = every.sums(v[:, None] * z)[:k]
    squares = every.sums(v * v)[:k]
    return GroupRedundancy(squares, redundancy, s, average, exact, probed)


def sharpened(
    at: GroupRedundancy, solution: Solution, groups: ObservationGroups, *, seed: int = 0
) -> GroupRedundancy:
    """Return the figures with an S exact enough for standard deviations."""
    if at.exact:
        return at
    probes = max(LEAST, MANY // len(groups.names))
    every = _with_extra(groups, solution.normal().system)
    s = _by_probes(solution, every, np.random.default_rng(seed), probes)
    return replace(at, information=_completed(s, at.redundancy))


def _with_extra(groups: ObservationGroups, system: LinearSystem) -> ObservationGroups:
    """Append the rows of factors that the user added; these rows are in no group."""
    added = sum(len(e.a) for e in system.extra)
    return replace(groups, of_row=np.append(groups.of_row, np.full(added, -1, dtype=np.intp)))


def _completed(s: Array, redundancy: Array) -> Array:
    """Return S (k, k) from its estimate (k + 1, k + 1) and r.

    If mainly other groups check a group, its diagonal element is a small difference between r and
    the rest of the row; then the estimate from the probes is more accurate.
    """
    k = len(redundancy)
    beside = s - np.diag(np.diag(s))
    rest = redundancy - beside[:k].sum(axis=1)
    diagonal = np.where(rest > redundancy / 4.0, rest, np.diag(s)[:k])
    return np.asarray(beside[:k, :k] + np.diag(diagonal))


def _project(solution: Solution, z: Array) -> Array:
    """Return R Z (rows, k)."""
    system = solution.normal().system
    return np.asarray(z - system.times(solution.factor.solve(system.transposed(z))))


def _by_probes(
    solution: Solution, groups: ObservationGroups, rng: np.random.Generator, probes: int
) -> Array:
    """Return an estimate of S, (k + 1, k + 1); the last column is for rows without a group."""
    k = len(groups.names)
    out = np.zeros((k + 1, k + 1))
    of_group = [np.flatnonzero(groups.of_row == number) for number in range(k)]
    every = [number for number in range(k) for _ in range(probes)]
    for first in range(0, len(every), AT_ONCE):  # many groups have few probes each
        chosen = every[first : first + AT_ONCE]
        z = np.zeros((len(groups.of_row), len(chosen)))
        for column, number in enumerate(chosen):
            z[of_group[number], column] = rng.choice([-1.0, 1.0], len(of_group[number]))
        np.add.at(out, chosen, groups.sums(np.square(_project(solution, z))).T / probes)
    # S_gh and S_hg estimate the same element; rows without a group, at the end, have no probes.
    out[:k, :k] = (out[:k, :k] + out[:k, :k].T) / 2.0
    return out

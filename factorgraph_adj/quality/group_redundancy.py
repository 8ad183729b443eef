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

The residuals at the minimum of the linearised equations are R v for the residuals v at any state
near the minimum: the figures are those of the minimum after one Gauss-Newton step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..solve.linear import LinearisedEquations
from ..solve.solution import Solution
from ..types import Array
from .observation_groups import ObservationGroups
from .reliability import reliability

EXACT_ROWS = 2000
"""Scalar observations up to which R is computed as a whole."""
FEW, MANY = 2, 64
"""Numbers of random sign vectors in larger networks: at most `FEW` for each group during the
iteration, `MANY` for all groups together at its end, but at least one for each group."""
SIMILAR = 0.1
"""Largest change of ln f² since the probes with which S still gives standard deviations: the
elements of S beside its diagonal change by this part of their value, the diagonal follows r."""
AT_ONCE = 16
"""Number of columns that are projected at once."""


@dataclass(frozen=True)
class Probed:
    """An estimate of S from random probes."""

    s: Array
    """The estimate, (k + 1, k + 1); the last row and column are for rows without a group."""
    probes: int
    """Number of probes of each group."""
    logarithms: Array
    """Logarithms of the weights of the rows at that time, relative to the network's, (n,)."""


@dataclass(frozen=True, eq=False)
class GroupRedundancy:
    """Square sums, redundancies and S of k groups at the minimum next to one linearisation."""

    squares: Array
    """q (k,)."""
    redundancy: Array
    """r (k,)."""
    information: Array
    """S (k, k)."""
    exact: bool
    """Whether S is exact, or estimated from random probes."""
    movement: Array
    """Step to the minimum, (n_columns,)."""
    residuals: Array
    """Whitened residuals R v at the minimum, (n_rows,)."""
    groups: ObservationGroups
    """Group of each row; rows of factors that the user added are at the end."""
    project: Callable[[Array], Array]
    """Function that returns R Z (n_rows, m) for Z (n_rows, m)."""
    probed: Probed | None = None
    """The probes; none: S is exact, or diag(r)."""

    @property
    def unprobed(self) -> bool:
        """Whether S is only diag(r)."""
        return not self.exact and self.probed is None

    def average_times(self, x: Array) -> Array:
        """Return B x (k,) for x (k,)."""
        v, k = self.residuals, len(self.squares)
        of_row = np.append(x, 0.0)[self.groups.of_row]
        return self.groups.sums(v * self.project((v * of_row)[:, None])[:, 0])[:k]

    @cached_property
    def average(self) -> Array:
        """B (k, k)."""
        return np.stack([self.average_times(x) for x in np.eye(len(self.squares))], axis=1)


def group_redundancy(
    solution: Solution,
    groups: ObservationGroups,
    *,
    seed: int = 0,
    exact: bool | None = None,
    earlier: GroupRedundancy | None = None,
    probe: bool = False,
) -> GroupRedundancy:
    """Return q, r and S of groups of observations, and B; correlated observations share a group.

    With up to `EXACT_ROWS` observations the figures are computed from R itself. In larger networks
    r is the sum of the redundancy numbers, and S is estimated by stochastic traces (Hutchinson
    1990): with independent random signs z_g over the rows of group g, E‖(R z_g)_h‖² = S_gh. The
    diagonal element, usually by far the largest of its row, follows from r:
    S_gg = r_g − Σ_{h≠g} S_gh. This makes it nearly exact. Without probes S is diag(r), which makes
    Förstner's iteration of Helmert's equations; for one group of all rows it is exact.

    Args:
        solution: an adjustment, or a step of one.
        groups: the group of each observation.
        seed: seed of the random signs.
        exact: whether S is computed exactly; None: up to `EXACT_ROWS` observations.
        earlier: figures with other weights, whose probes serve again: what one group has in
            another hardly changes, and r, q and B are those of the solution.
        probe: whether S is estimated in a large network if ``earlier`` has no probes.
    """
    k = len(groups.names)
    system = solution.normal().system
    every = _with_extra(groups, system)
    if exact is None:
        exact = len(every.of_row) <= EXACT_ROWS
    v = np.concatenate([system.residual, *(e.residual for e in system.extra)])
    x = solution.factor.solve(system.transposed(v[:, None]))
    residuals = v - system.times(x)[:, 0]
    squares = every.sums(np.square(residuals))[:k]
    if exact:
        a = system.times(np.eye(system.unknowns.n_columns))
        projector = np.eye(len(a)) - a @ solution.factor.solve(a.T)
        redundancy = every.sums(np.diag(projector))[:k]
        half = every.sums(np.square(projector))
        s = every.sums(np.ascontiguousarray(half.T))[:k, :k]
        return GroupRedundancy(
            squares, redundancy, s, True, -x[:, 0], residuals, every, projector.__matmul__
        )
    redundancy = groups.sums(reliability(solution).redundancy_numbers)[:k]
    out = GroupRedundancy(
        squares,
        redundancy,
        np.diag(redundancy),
        k == 1 and not np.any(every.of_row),
        -x[:, 0],
        residuals,
        every,
        lambda z: _project(solution, z),
    )
    probed = None if earlier is None else earlier.probed
    if probed is None:
        if out.exact or not probe:
            return out
        probed = _by_probes(out, solution, seed, min(FEW, _enough(k)))
    return replace(out, information=_completed(probed.s, redundancy), probed=probed)


def sharpened(
    at: GroupRedundancy, solution: Solution, groups: ObservationGroups, *, seed: int = 0
) -> GroupRedundancy:
    """Return the figures with an S exact enough for standard deviations.

    Probes of the iteration serve if they are enough, and the weights have hardly changed since.
    """
    if at.exact:
        return at
    probed, enough = at.probed, _enough(len(groups.names))
    if probed is not None and probed.probes >= enough:
        change = np.abs(_logarithms(solution) - probed.logarithms).max(initial=0.0)
        if change <= SIMILAR:
            return at
    probed = _by_probes(at, solution, seed, enough)
    return replace(at, information=_completed(probed.s, at.redundancy), probed=probed)


def _enough(k: int) -> int:
    """Return the number of probes of each of k groups for standard deviations."""
    return max(1, MANY // k)


def _logarithms(solution: Solution) -> Array:
    """Return the logarithms of the weights of all rows, relative to the network's, (n,)."""
    if solution.weights is None:
        return np.zeros(solution.equations.n_rows)
    return np.log(solution.weights)


def _with_extra(groups: ObservationGroups, system: LinearisedEquations) -> ObservationGroups:
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
    """Return R Z (rows, m)."""
    system = solution.normal().system
    out = np.empty_like(z)
    for first in range(0, z.shape[1], AT_ONCE):
        part = slice(first, first + AT_ONCE)
        x = solution.factor.solve(system.transposed(z[:, part]))
        out[:, part] = z[:, part] - system.times(x)
    return out


def _by_probes(at: GroupRedundancy, solution: Solution, seed: int, probes: int) -> Probed:
    """Return an estimate of S."""
    rng, of_row = np.random.default_rng(seed), at.groups.of_row
    k = len(at.redundancy)
    out = np.zeros((k + 1, k + 1))
    of_group = [np.flatnonzero(of_row == number) for number in range(k)]
    every = [number for number in range(k) for _ in range(probes)]
    for first in range(0, len(every), AT_ONCE):  # many groups have few probes each
        chosen = every[first : first + AT_ONCE]
        z = np.zeros((len(of_row), len(chosen)))
        for column, number in enumerate(chosen):
            z[of_group[number], column] = rng.choice([-1.0, 1.0], len(of_group[number]))
        np.add.at(out, chosen, at.groups.sums(np.square(at.project(z))).T / probes)
    # S_gh and S_hg estimate the same element; rows without a group, at the end, have no probes.
    out[:k, :k] = (out[:k, :k] + out[:k, :k].T) / 2.0
    return Probed(out, probes, _logarithms(solution))

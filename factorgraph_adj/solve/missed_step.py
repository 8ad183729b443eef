"""What linear rows in the place of others miss, and how far it moves the unknowns that remain.

Rows of a marginalisation (`solve.marginalisation`) hold near where they were made. There, with all
partials, the unknowns R that leave follow a movement d of those that remain, T, as everything does,
by M d with M = Q_·T Q_TT⁻¹, since R has no other rows. The rows then have the residuals

    v(M d) = v + A M d + ½ W[d, d] + …,    W = Mᵀ (∂²v/∂x²) M of each row,

in the coordinates in which d is measured (`Prior.movement`). With R at its minimum, the gradient of
vᵀv/2 by T is to second order Mᵀ times that of the joint movement M d. Its part MᵀAᵀ(v + A M d) is
that of the linear rows; they miss

    g(d) = Σ v W d + Σ (½ MᵀAᵀ W[d, d] + W d · A M d) = B d + τ[d, d],

with a matrix B and a tensor τ that are symmetric in all places, as g is the gradient of a function.
The sum of several marginalisations has the same form g₀ + B d + τ[d, d], so one g₀, B and τ stand
for all: where T has moved by d₀, and its unknowns follow those that remain later by d₀ + C d',

    g₀' = Cᵀ g(d₀),    B' = Cᵀ (B + 2 τ[d₀]) C,    τ' = τ[C, C, C],

and what the rows that become linear then miss is added. T takes the step s = −(Q g)_T, and every
function of the unknowns, such as one of them, moves by no more than

    ‖s‖ = √(gᵀ Q g)

of its σ, Q being the cofactors of the present. In coordinates u of T in which its cofactor matrix
was the identity when the rows were made, s = −g.

This is exact to second order in d where there are no residuals, and nothing is sampled. Two things
are known by their size alone. A movement changes the normal matrix, the identity for u, by
D = B + 2 τ[d], and so curvature by about ‖D‖ of itself: T takes a step that is longer by as much.
And residuals curve R, too, which follow T by other partials than M then: that changes B by some
‖B‖² again. In which direction is not known, so that

    ρ = ‖D‖ (‖B d‖ + ‖τ[d, d]‖)

is added, and summed over the marginalisations. The bound of the step is ‖s‖ + ρ: beyond the second
order, and where residuals curve rows by much of their normal matrix, it is an estimate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..types import Array, Index
from .linear import LinearisedEquations
from .normal import NormalEquations
from .prior import Prior

MAX_UNKNOWNS = 250
"""Largest number of components of T for which all second derivatives are computed: they take
number³ × 8 bytes, 125 MB."""
STEP = 0.01
"""Movement for the differences of partials, relative to σ."""
MIN_RELATIVE_EIGENVALUE = 1e-12
"""Smallest eigenvalue of a correlation matrix that counts, relative to the largest one."""


class MissedStep(NamedTuple):
    """What the rows of all marginalisations miss, for a movement u = S d of T, (k,).

    k is the rank of the cofactor matrix of T, which is the identity for u.
    """

    scale: Array = np.zeros((0, 0))
    """S, (k, m), of a movement d of the prior's unknowns; zero for held components."""
    constant: Array = np.zeros(0)
    """g₀, (k,)."""
    linear: Array = np.zeros((0, 0))
    """B, (k, k)."""
    quadratic: Array = np.zeros((0, 0, 0))
    """τ, (k, k, k)."""
    remainder: float = 0.0
    """ρ of all marginalisations before the last one."""

    @property
    def is_known(self) -> bool:
        """Whether there are few enough unknowns that it was computed."""
        return len(self.scale) == len(self.constant)

    def at(self, moved: Array) -> tuple[Array, float]:
        """Return g(d) for d, (m,), and ρ; infinite where it is not known.

        Args:
            moved: the movement d since the last marginalisation, (m,).
        """
        if not self.is_known:
            return np.zeros(len(moved)), np.inf
        gradient, _, remainder = self._moved(moved)
        return gradient @ self.scale, remainder

    def carried(self, moved: Array, scale: Array, follow: Array) -> MissedStep:
        """Return the same of the unknowns of a later marginalisation.

        Args:
            moved: the movement d₀ until then, (m,).
            scale: S of the unknowns of the later one, (k', m').
            follow: how the unknowns of this one follow a movement u' of them, (m, k').
        """
        constant, linear, remainder = self._moved(moved)
        c = self.scale @ follow
        quadratic = self.quadratic
        for _ in range(3):  # one place after another
            quadratic = np.tensordot(quadratic, c, (0, 0))
        return MissedStep(scale, c.T @ constant, c.T @ linear @ c, quadratic, remainder)

    def _moved(self, moved: Array) -> tuple[Array, Array, float]:
        """Return g(d), its derivative B + 2 τ[d], and ρ."""
        u = self.scale @ moved
        half = self.quadratic @ u
        straight, curved, derivative = self.linear @ u, half @ u, self.linear + 2.0 * half
        size = float(np.linalg.norm(derivative, 2)) if len(u) else 0.0
        missed = float(np.linalg.norm(straight) + np.linalg.norm(curved))
        return self.constant + straight + curved, derivative, self.remainder + size * missed


NOTHING_MISSED = MissedStep()
"""Nothing was marginalised."""


def not_known(m: int) -> MissedStep:
    """Return that it was not computed what the rows of m columns miss."""
    return MissedStep(np.zeros((1, m)))


def missed_step(
    normal: NormalEquations,
    rows: Index,
    columns: Index,
    before: Prior | None,
    known: MissedStep,
) -> MissedStep:
    """Return what the rows of a marginalisation miss, and those before it.

    Args:
        normal: the network, with the rows of an earlier marginalisation.
        rows: the rows that become linear.
        columns: columns of the unknowns of the new prior, (m,).
        before: rows of an earlier marginalisation; none: there was none.
        known: what these and those before them miss.
    """
    here, unknowns = normal.system, normal.system.unknowns
    if len(columns) > MAX_UNKNOWNS or not known.is_known:
        return not_known(len(columns))
    factor = normal.factorise(np.zeros(unknowns.n_columns))
    unit = np.zeros((unknowns.n_columns, len(columns)))
    unit[columns, np.arange(len(columns))] = unknowns.free[columns]
    q = factor.solve(unit)
    scale = _scale(q[columns])
    follow = q @ scale.T
    found = _missed(here, rows, scale, follow)
    if before is None:
        return found
    prior = before.at(here.equations, here.state)
    moved = before.movement(here.equations, here.state)
    old = known.carried(moved, scale, follow[prior.rows[0].columns])
    return MissedStep(
        scale,
        old.constant,
        found.linear + old.linear,
        found.quadratic + old.quadratic,
        old.remainder,
    )


def _scale(cofactors: Array) -> Array:
    """Return S (k, m) with S Q_TT Sᵀ = I, zero for held components."""
    sigma = np.sqrt(np.maximum(np.diag(cofactors), 0.0))
    on = sigma > 0
    c = cofactors[np.ix_(on, on)] / np.outer(sigma[on], sigma[on])
    values, vectors = np.linalg.eigh((c + c.T) / 2)
    counts = values > MIN_RELATIVE_EIGENVALUE * values.max(initial=0.0)
    out = np.zeros((int(counts.sum()), len(cofactors)))
    out[:, on] = (vectors[:, counts] / np.sqrt(values[counts])).T / sigma[on]
    return out


def _missed(here: LinearisedEquations, rows: Index, scale: Array, follow: Array) -> MissedStep:
    """Return what rows miss, from differences of their partials.

    Rows of an earlier marginalisation are linear, and stay so.

    Args:
        here: the network.
        rows: the rows that become linear.
        scale: S, (k, m).
        follow: movements of everything for a unit of each of u, (n_columns, k).
    """
    equations, k = here.equations.of_rows(rows), follow.shape[1]
    base, every = LinearisedEquations(equations, here.state), np.arange(equations.n_rows)
    a = base.sparse(every)
    touched = np.unique(a.indices)
    at = follow[touched]
    weights = np.column_stack([a @ follow, base.residual])
    w = np.empty((k, k, k + 1))  # Σ W[a, b] of the rows, each times A M of c, or v
    for i in range(k):
        there = here.unknowns.retract(here.state, STEP * follow[:, i])
        change = LinearisedEquations(equations, there).sparse(every) - a
        w[i] = at.T @ (change[:, touched].T @ weights) / STEP
    w = 0.5 * (w + w.transpose(1, 0, 2))
    x = w[:, :, :k]
    quadratic = 0.5 * (x + x.transpose(0, 2, 1) + x.transpose(2, 0, 1))
    return MissedStep(scale, np.zeros(k), w[:, :, k].copy(), quadratic)

"""Marginalisation: linear rows in the place of retired unknowns, and the errors of these rows.

Unknowns R that nothing new will touch are eliminated, with all rows that touch them, where the
network is. Their rows A_R dx_R + A_T dx_T + v, those of an earlier marginalisation that touch
them among them, are turned by an orthogonal Q,

    Qᵀ [A_R A_T v] = [U  S  c]
                     [0  R  z],

so that whatever T is, R takes up the upper rows, and the lower ones are left as rows R d + z of the
movement d of T from where the network was (`Prior`). Estimates and cofactors of T are those of the
whole network, where the rows are linear. vᵀPv and the redundancy stay: of n rows that u unknowns
left, n − u count, however few are kept, and their sum of squares at the minimum of T is |z|².

The linear rows are valid near where they were made. There, with all partials, R follows a movement
d of T, as everything does, by M d with M = Q_·T Q_TT⁻¹, since R has no other rows. The rows then
have the residuals

    v(M d) = v + A M d + ½ W[d, d] + …,    W = Mᵀ (∂²v/∂x²) M of each row,

in the coordinates in which d is measured (`Prior.movement`). With R at its minimum, the gradient of
vᵀv/2 by T is to second order Mᵀ times that of the joint movement M d. Its part MᵀAᵀ(v + A M d) is
that of the linear rows; they miss

    g(d) = Σ v W d + Σ (½ MᵀAᵀ W[d, d] + W d · A M d) = B d + τ[d, d],

with a matrix B and a tensor τ that are symmetric in all places, as g is the gradient of a function.
The sum of several marginalisations has the same form g₀ + B d + τ[d, d], so one g₀, B and τ serve
all: where T has moved by d₀, and its unknowns follow those that remain later by d₀ + C d',

    g₀' = Cᵀ g(d₀),    B' = Cᵀ (B + 2 τ[d₀]) C,    τ' = τ[C, C, C],

and what the rows that become linear then miss is added. T takes the step s = −(Q g)_T, and every
function of the unknowns, such as one of them, moves by no more than ‖s‖ = √(gᵀ Q g) of its σ, Q
being the cofactors of the present. In coordinates u of T in which its cofactor matrix was the
identity when the rows were made, s = −g.

This is exact to second order, and nothing is sampled. Of the third order it is known how large it
may be: a movement that changes the normal matrix, the identity for u, by D = B + 2 τ[d] changes the
curvature by about ‖D‖ of itself. In which direction is not known, so that ρ = ‖D‖ ‖τ[d, d]‖ is
added, and summed over the marginalisations. The bound of the step is ‖s‖ + ρ: to second order a
bound, beyond it an estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import qr
from scipy.sparse import csr_array

from ..errors import SingularError
from ..types import Array, Index
from .added_factors import Prior, unknown_groups_of
from .linearised_equations import ExtraRows, LinearisedEquations
from .normal_equations import NormalEquations

MAX_SECOND_DERIVATIVE_UNKNOWNS = 250
"""Largest number of components of T for which all second derivatives are computed: they take
number³ × 8 bytes, 125 MB."""
DIFFERENCE_STEP_SIGMAS = 0.01
"""Movement for the differences of partials, relative to σ."""
MIN_RELATIVE_EIGENVALUE = 1e-12
"""Smallest eigenvalue of a correlation matrix that counts, relative to the largest one."""
MIN_RETIRED_PIVOT = 1e-13
"""Smallest pivot, relative to the largest partial of its rows, of a determined unknown."""
RETIRED_ROWS_NAME = "retired observations"
"""Name of the rows."""


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


NO_MISSED_STEP = MissedStep()
"""Nothing was marginalised."""


def unknown_missed_step(m: int) -> MissedStep:
    """Return that it was not computed what the rows of m columns miss."""
    return MissedStep(np.zeros((1, m)))


def missed_step_of_rows(
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
        before: rows of an earlier marginalisation; None: there was none.
        known: what these and those before them miss.
    """
    here, unknowns = normal.system, normal.system.unknowns
    if len(columns) > MAX_SECOND_DERIVATIVE_UNKNOWNS or not known.is_known:
        return unknown_missed_step(len(columns))
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
        there = here.unknowns.retract(here.state, DIFFERENCE_STEP_SIGMAS * follow[:, i])
        change = LinearisedEquations(equations, there).sparse(every) - a
        w[i] = at.T @ (change[:, touched].T @ weights) / DIFFERENCE_STEP_SIGMAS
    w = 0.5 * (w + w.transpose(1, 0, 2))
    x = w[:, :, :k]
    quadratic = 0.5 * (x + x.transpose(0, 2, 1) + x.transpose(2, 0, 1))
    return MissedStep(scale, np.zeros(k), w[:, :, k].copy(), quadratic)


class Marginalisation(NamedTuple):
    """Rows in the place of others."""

    prior: Prior
    """They."""
    missed: MissedStep
    """What they miss, and those of earlier marginalisations."""


class _Rows(NamedTuple):
    """Dense rows."""

    columns: Index
    """What they touch, (m,)."""
    a: Array
    """Partials, (k, m)."""
    v: Array
    """Residuals, (k,)."""


def marginalise(
    normal: NormalEquations,
    rows: Index,
    gone: Sequence[Index],
    before: Prior | None = None,
    missed: MissedStep = NO_MISSED_STEP,
) -> Marginalisation:
    """Eliminate unknowns.

    Args:
        normal: the network at its state, with the rows of an earlier marginalisation.
        rows: all rows that touch the unknowns.
        gone: columns of each of the unknowns.
        before: the earlier marginalisation; None: there was none.
        missed: what its rows, and those before them, miss.

    Raises:
        SingularError: an unknown is not determined to working precision.
    """
    system, free = normal.system, normal.system.unknowns.free
    earlier = [e for e in system.extra if before is not None]
    held: Index = np.concatenate([np.zeros(0, np.intp), *(e.columns for e in earlier)])
    own = [c[free[c]] for c in gone]
    first = [c for c in own if not np.isin(c, held).any()]
    last = np.concatenate([held[:0], *(c for c in own if np.isin(c, held).any())])
    left = _eliminated(system.sparse(rows), system.residual[rows], first)
    counted = len(rows) - sum(map(len, own)) + (0 if before is None else before.n_rows)
    prior, columns = _together(normal, left, earlier, last, counted)
    return Marginalisation(prior, missed_step_of_rows(normal, rows, columns, before, missed))


def _eliminated(a: csr_array, v: Array, order: Sequence[Index]) -> list[_Rows]:
    """Eliminate unknowns one after another, those with the fewest rows first; return the rest."""
    by_column, open_rows = a.tocsc(), np.ones(a.shape[0], dtype=bool)
    touching = np.diff(by_column.indptr)
    mine: dict[int, set[int]] = {}
    made: dict[int, _Rows] = {}
    for number, columns in enumerate(sorted(order, key=lambda c: int(touching[c].sum()))):
        fresh: Index = np.unique(by_column[:, columns].indices).astype(np.intp)
        fresh = fresh[open_rows[fresh]]
        open_rows[fresh] = False
        parts = [_dense(a, v, fresh)] if len(fresh) else []
        there = set().union(*(mine.get(c, ()) for c in columns.tolist())) & made.keys()
        parts += [made.pop(i) for i in sorted(there)]
        joint = _stacked(parts, columns)
        n = len(columns)
        turned = qr(np.column_stack([joint.a, joint.v]), mode="r", check_finite=False)[0]
        turned = turned[: len(joint.columns) + 1]
        largest = np.abs(joint.a[:, :n]).max(axis=0, initial=0.0)
        if len(turned) < n or (np.abs(np.diag(turned[:, :n])) <= MIN_RETIRED_PIVOT * largest).any():
            raise SingularError("an unknown that is to be retired is not determined")
        if len(turned) > n:
            made[number] = _Rows(
                joint.columns[n:], np.asarray(turned[n:, n:-1]), np.asarray(turned[n:, -1])
            )
            for c in joint.columns[n:].tolist():
                mine.setdefault(c, set()).add(number)
    rest = np.flatnonzero(open_rows)
    return [*made.values(), *([_dense(a, v, rest)] if len(rest) else [])]


def _together(
    normal: NormalEquations,
    parts: Sequence[_Rows],
    earlier: Sequence[ExtraRows],
    last: Index,
    counted: int,
) -> tuple[Prior, Index]:
    """Eliminate what an earlier marginalisation touches, and keep as few rows as there can be.

    Args:
        normal: the network.
        parts: rows that are left.
        earlier: rows of the earlier marginalisation.
        last: columns that are left to be eliminated.
        counted: number of rows that count in the redundancy.

    Returns:
        The rows that are kept, and the columns that they touch.
    """
    free = normal.system.unknowns.free
    old = [
        _Rows(e.columns[on], e.a[:, on], e.residual) for e in earlier for on in (free[e.columns],)
    ]
    joint = _stacked([*old, *parts], last)
    n = len(last)
    own: Array = np.zeros((len(joint.v), 0))
    upper: Array = np.zeros((0, len(joint.columns)))
    if joint.a.size:
        turned = qr(joint.a, mode="economic", check_finite=False)
        own, upper = np.asarray(turned[0]), np.asarray(turned[1])
    largest = np.abs(joint.a[:, :n]).max(axis=0, initial=0.0)
    if len(upper) < n or (np.abs(np.diag(upper[:, :n])) <= MIN_RETIRED_PIVOT * largest).any():
        raise SingularError("an unknown that is to be retired is not determined")
    z = own.T @ joint.v
    rest = float(np.linalg.norm(joint.v - own @ z))
    columns, r, z = joint.columns[n:], upper[n:, n:], z[n:]
    if counted > len(z):  # what no movement changes
        r, z = np.vstack([r, np.zeros(r.shape[1])]), np.append(z, rest)
    every, places = _whole(normal, columns)
    wide = np.zeros((len(z), len(every)))
    wide[:, places] = r
    groups, apart = unknown_groups_of(normal, every), counted - len(z)
    prior = Prior(groups=groups, r=wide, z=z, apart=apart, name=RETIRED_ROWS_NAME)
    return prior, every


def _whole(normal: NormalEquations, columns: Index) -> tuple[Index, Index]:
    """Return all columns of the unknowns of some columns, and the places of these among them."""
    unknowns = normal.system.unknowns
    owners = sorted(set(unknowns.owners(columns)))
    every = [unknowns.columns(kind, unknowns[kind].number[name]) for kind, name in owners]
    out = np.sort(np.concatenate([columns[:0], *every]))
    return out, np.searchsorted(out, columns)


def _dense(a: csr_array, v: Array, rows: Index) -> _Rows:
    """Return some rows with the columns that they touch."""
    some = a[rows]
    columns, place = np.unique(some.indices, return_inverse=True)
    dense = np.zeros((len(rows), len(columns)))
    dense[np.repeat(np.arange(len(rows)), np.diff(some.indptr)), place] = some.data
    return _Rows(columns.astype(np.intp), dense, v[rows])


def _stacked(parts: Sequence[_Rows], first: Index) -> _Rows:
    """Return rows below one another, with some columns first."""
    every = np.concatenate([first[:0], *(p.columns for p in parts)])
    columns = np.concatenate([first, np.setdiff1d(every, first)])
    order = np.argsort(columns)
    out = np.zeros((sum(len(p.v) for p in parts), len(columns)))
    row = 0
    for p in parts:
        places = order[np.searchsorted(columns, p.columns, sorter=order)]
        out[row : row + len(p.v), places] = p.a
        row += len(p.v)
    return _Rows(columns, out, np.concatenate([np.zeros(0), *(p.v for p in parts)]))

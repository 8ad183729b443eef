"""What the rows of some unknowns say of all others: linear rows in their place.

Unknowns R that nothing new will touch are eliminated, with all rows that touch them, where the
network stands. Their rows A_R dx_R + A_T dx_T + v, those of an earlier marginalisation that touch
them among them, are turned by an orthogonal Q,

    Qᵀ [A_R A_T v] = [U  S  c]
                     [0  R  z],

so that whatever T is, R takes up the upper rows, and the lower ones are left as rows R d + z of the
movement d of T from where the network stood (`factorgraph_adj.solve.prior.Prior`). Estimates and
cofactors of T are those of the whole network, where the rows are linear.

The linear rows hold near where they were made; `solve.missed_step` says what they miss elsewhere.

vᵀPv and the redundancy stay: of n rows that u unknowns left, n − u count, however few are kept, and
their sum of squares at the minimum of T is |z|².
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import qr
from scipy.sparse import csr_array

from ..types import Array, Index
from .linear import ExtraRows
from .missed_step import NOTHING_MISSED, MissedStep, missed_step
from .normal import NormalEquations
from .prior import Prior, groups_of
from .singular import SingularError

WEAKEST = 1e-13
"""Smallest pivot, relative to the largest partial of its rows, of a determined unknown."""


NAME = "retired observations"
"""Name of the rows."""


class Marginalised(NamedTuple):
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


def marginalised(
    normal: NormalEquations,
    rows: Index,
    gone: Sequence[Index],
    before: Prior | None = None,
    missed: MissedStep = NOTHING_MISSED,
) -> Marginalised:
    """Eliminate unknowns.

    Args:
        normal: the network where it stands, with the rows of an earlier marginalisation.
        rows: all rows that touch the unknowns.
        gone: columns of each of the unknowns.
        before: the earlier marginalisation; none: there was none.
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
    return Marginalised(prior, missed_step(normal, rows, columns, before, missed))


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
        if len(turned) < n or (np.abs(np.diag(turned[:, :n])) <= WEAKEST * largest).any():
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
    if len(upper) < n or (np.abs(np.diag(upper[:, :n])) <= WEAKEST * largest).any():
        raise SingularError("an unknown that is to be retired is not determined")
    z = own.T @ joint.v
    rest = float(np.linalg.norm(joint.v - own @ z))
    columns, r, z = joint.columns[n:], upper[n:, n:], z[n:]
    if counted > len(z):  # what no movement changes
        r, z = np.vstack([r, np.zeros(r.shape[1])]), np.append(z, rest)
    every, places = _whole(normal, columns)
    wide = np.zeros((len(z), len(every)))
    wide[:, places] = r
    groups, apart = groups_of(normal, every), counted - len(z)
    prior = Prior(groups=groups, r=wide, z=z, apart=apart, name=NAME)
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

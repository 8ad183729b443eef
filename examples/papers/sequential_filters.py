"""Algorithms that update a least-squares solution by single observations, as experiments.

Four of them are those of on-line triangulation: the Kalman form (Mikhail and Helmering 1973),
Givens rotations (Gentleman 1973, Blais 1983), the update of a triangular factor (Gruen 1982, in the
rank-one form of Bennett 1965 and Gill et al. 1974), and the low-rank update of a base that this
library uses in its fronts. The fifth is iSAM2 of GTSAM (Kaess et al. 2012), which the library uses
for terrestrial networks.

All of them minimise vᵀv of the same whitened linear rows v = A x + v₀, and begin with a base that
determines all unknowns. Each has its own representation of the solution:

    Kalman              Q = N⁻¹ and x
    Givens              R with N = RᵀR, and Rx = z
    triangular factor   U and D with N = UᵀDU, and Ux = z
    low-rank update     Q of the base, G = QBᵀ of the rows B since then, D = S + BQBᵀ
    iSAM2               R in cliques of a tree, of which the touched ones are eliminated again
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import gtsam
import numpy as np
from scipy.linalg import solve_triangular

from factorgraph_adj.solve.low_rank_update import Update
from factorgraph_adj.types import Array, Index

MAX_ROWS_OF_UPDATE = 64
"""Largest number of rows that a base takes; more cost less in solving a new base, and more in D."""


class Rows(NamedTuple):
    """Whitened linear rows of one observation."""

    number: int
    """Number of the observation."""
    at: Index
    """Columns that they touch, ascending, (m,)."""
    b: Array
    """Partials by these, (k, m)."""
    v: Array
    """Residuals at x = 0, (k,)."""


class SequentialFilter(Protocol):
    """A solution to which rows are added, and from which they are removed."""

    operations: int
    """Number of multiplications so far; 0 where the algorithm is not written out here."""

    def change(self, rows: Rows, sign: float) -> None:
        """Add rows (sign 1) or remove them (−1)."""

    @property
    def x(self) -> Array:
        """Unknowns at the minimum, (n,)."""

    def cofactors(self) -> Array:
        """Return Q, (n, n)."""

    @property
    def vtv(self) -> float:
        """Value of vᵀv at the minimum."""

    @property
    def numbers(self) -> int:
        """Number of stored numbers that are not zero."""


def minimum(a: Array, v: Array) -> tuple[Array, Array, float]:
    """Return x, R and vᵀv at the minimum of |A x + v|², by Householder's QR."""
    q, r = np.linalg.qr(a)
    z = -q.T @ v
    left = v + q @ z
    return solve_triangular(r, z), r * np.sign(np.diag(r))[:, None], float(left @ left)


class KalmanFilter:
    """Update of Q and x: Q' = Q − QBᵀ(±I + BQBᵀ)⁻¹BQ, x' = x − QBᵀ(±I + BQBᵀ)⁻¹v."""

    def __init__(self, a: Array, v: Array) -> None:
        """Solve the base of rows A (m, n) and v (m,)."""
        self.x, r, self.vtv = minimum(a, v)
        half = solve_triangular(r, np.eye(len(r)))
        self.q, self.operations = half @ half.T, 0

    def change(self, rows: Rows, sign: float) -> None:
        """Add or remove rows; see `SequentialFilter.change`."""
        _, at, b, v = rows
        g = self.q[:, at] @ b.T
        d = sign * np.eye(len(b)) + b @ g[at]
        v = v + b @ self.x[at]
        gain = np.linalg.solve(d, g.T).T
        self.vtv += float(v @ np.linalg.solve(d, v))
        self.x = self.x - gain @ v
        self.q -= gain @ g.T
        n, k = g.shape
        self.operations += k * n * len(at) + k * k * n + k * n * (n + 1) // 2

    def cofactors(self) -> Array:
        """Return Q."""
        return self.q

    @property
    def numbers(self) -> int:
        """Half of Q, which is full, and x."""
        n = len(self.q)
        return n * (n + 1) // 2 + n


class GivensFilter:
    """Rotation of each row into R; removal by hyperbolic rotations (weight −1).

    The right side is a column of R, whose last element is √vᵀv. Elements that are zero in both rows
    stay so, and are left out.
    """

    def __init__(self, a: Array, v: Array) -> None:
        """Solve the base of rows A (m, n) and v (m,)."""
        x, r, vtv = minimum(a, v)
        self.r, self.operations = np.zeros((len(x) + 1,) * 2), 0
        self.r[:-1, :-1], self.r[:-1, -1], self.r[-1, -1] = r, r @ x, np.sqrt(vtv)

    def change(self, rows: Rows, sign: float) -> None:
        """Add or remove rows; see `SequentialFilter.change`."""
        _, at, b, v = rows
        for partials, residual in zip(b, v, strict=True):
            row = np.zeros(len(self.r))
            row[at], row[-1] = partials, -residual
            k = int(at[0])
            while k < len(row):
                r = self.r[k]
                on = k + np.flatnonzero((r[k:] != 0.0) | (row[k:] != 0.0))
                old, new, t = r[on], row[on], row[k] / r[k]
                if sign > 0:
                    c = 1.0 / np.hypot(1.0, t)
                    r[on], row[on] = c * (old + t * new), c * (new - t * old)
                else:  # mixed form, stable (Bojanczyk et al. 1987): the new r enters the row
                    c = np.sqrt(1.0 - t * t)
                    r[on] = (old - t * new) / c
                    row[on] = c * new - t * r[on]
                row[k] = 0.0
                self.operations += 4 * len(on)
                rest = np.flatnonzero(row[k + 1 :])
                k = k + 1 + int(rest[0]) if len(rest) else len(row)

    @property
    def x(self) -> Array:
        """Unknowns, by back-substitution."""
        return np.asarray(solve_triangular(self.r[:-1, :-1], self.r[:-1, -1]))

    @property
    def vtv(self) -> float:
        """Value of vᵀv: the square of the last element."""
        return float(self.r[-1, -1] ** 2)

    def cofactors(self) -> Array:
        """Return R⁻¹R⁻ᵀ."""
        half = solve_triangular(self.r[:-1, :-1], np.eye(len(self.r) - 1))
        return np.asarray(half @ half.T)

    @property
    def numbers(self) -> int:
        """Elements of R and of the right side."""
        return int(np.count_nonzero(self.r))


class TriangularFactorUpdate:
    """Rank-one update of N = UᵀDU without square roots; the right side is a column of U."""

    def __init__(self, a: Array, v: Array) -> None:
        """Solve the base of rows A (m, n) and v (m,)."""
        x, r, self.vtv = minimum(a, v)
        d = np.diag(r)
        self.d, self.u, self.operations = d**2, np.column_stack([r, r @ x]) / d[:, None], 0

    def change(self, rows: Rows, sign: float) -> None:
        """Add or remove rows; see `SequentialFilter.change`."""
        _, at, b, v = rows
        n = len(self.d)
        for partials, residual in zip(b, v, strict=True):
            row, weight = np.zeros(n + 1), sign
            row[at], row[-1] = partials, -residual
            k = int(at[0])
            while k < n:
                p, u = row[k], self.u[k]
                on = k + 1 + np.flatnonzero((u[k + 1 :] != 0.0) | (row[k + 1 :] != 0.0))
                d = self.d[k] + weight * p * p
                gain, weight = weight * p / d, weight * self.d[k] / d
                row[on] -= p * u[on]
                u[on] += gain * row[on]
                self.d[k] = d
                self.operations += 2 * len(on) + 4
                rest = np.flatnonzero(row[k + 1 : n])
                k = k + 1 + int(rest[0]) if len(rest) else n
            self.vtv += weight * float(row[-1] ** 2)

    @property
    def x(self) -> Array:
        """Unknowns, by back-substitution."""
        return np.asarray(solve_triangular(self.u[:, :-1], self.u[:, -1], unit_diagonal=True))

    def cofactors(self) -> Array:
        """Return U⁻¹D⁻¹U⁻ᵀ."""
        half = solve_triangular(self.u[:, :-1], np.eye(len(self.d)), unit_diagonal=True)
        return np.asarray((half / self.d) @ half.T)

    @property
    def numbers(self) -> int:
        """Elements of U, D and of the right side; ones on the diagonal of U are not stored."""
        return int(np.count_nonzero(self.u))


class LowRankUpdate:
    """The update of this library, `factorgraph_adj.solve.low_rank_update`, on a dense base.

    In the fronts of the library the base is their factor, and only the columns G are dense. Where
    more rows have changed than a base takes, the present solution is the new base.
    """

    def __init__(self, a: Array, v: Array) -> None:
        """Solve the base of rows A (m, n) and v (m,)."""
        self._at_base, r, self._vtv = minimum(a, v)
        half = solve_triangular(r, np.eye(len(r)))
        self._q, self.operations = half @ half.T, 0
        self.update = Update.of(self._q)

    def change(self, rows: Rows, sign: float) -> None:
        """Add or remove rows; see `SequentialFilter.change`."""
        _, at, b, v = rows
        if len(self.update.signs) + len(b) > MAX_ROWS_OF_UPDATE:
            self._at_base, self._vtv, self._q = self.x, self.vtv, self.cofactors()
            self.update = Update.of(self._q)
        k, n, j = len(b), len(self._q), len(self.update.signs)
        self.update = self.update.with_rows(at, b, v + b @ self._at_base[at], sign=sign)
        self.operations += k * n * len(at) + k * j * len(at) + (j + k) ** 3 // 3 + n * (j + k)

    @property
    def x(self) -> Array:
        """Unknowns: those of the base and the movement by all rows since then."""
        return np.asarray(self._at_base + self.update.step)

    @property
    def vtv(self) -> float:
        """Value of vᵀv."""
        return self._vtv + self.update.vtpv

    def cofactors(self) -> Array:
        """Return Q − G D⁻¹ Gᵀ."""
        return self._q - self.update.loss(self.update.spread)

    @property
    def numbers(self) -> int:
        """Half of Q of the base, and G and D."""
        n, j = len(self._q), len(self.update.signs)
        return n * (n + 1) // 2 + n + n * j + j * (j + 1) // 2


class ISAM2Filter:
    """iSAM2 of GTSAM with linear factors, which are never linearised again."""

    def __init__(self, a: Array, v: Array, variables: list[Index]) -> None:
        """Put the rows A (m, n) and v (m,) of the base in; ``variables``: columns of each key."""
        params = gtsam.ISAM2Params()
        params.setFactorization("QR")
        params.enableRelinearization = False
        params.findUnusedFactorSlots = True
        params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.0))
        self.isam, self.variables, self.operations = gtsam.ISAM2(params), variables, 0
        self.key_of = np.repeat(np.arange(len(variables)), [len(c) for c in variables])
        self._slots: dict[int, int] = {}
        self._rows = [(a, v, 1.0)]
        graph, values = gtsam.GaussianFactorGraph(), gtsam.Values()
        for key, columns in enumerate(variables):
            values.insert(key, np.zeros(len(columns)))
        for row, residual in zip(a, v, strict=True):
            graph.push_back(self._factor(row[None], np.array([residual])))
        self.isam.update(gtsam.LinearContainerFactor.ConvertLinearGraph(graph), values)

    def _factor(self, row: Array, v: Array) -> gtsam.GaussianConditional:
        """Return the factor of rows (k, n)."""
        keys = np.unique(self.key_of[np.flatnonzero(row.any(axis=0))]).tolist()
        terms = [(key, np.asfortranarray(row[:, self.variables[key]])) for key in keys]
        # A JacobianFactor takes three keys at most in Python; a conditional takes any number.
        return gtsam.GaussianConditional(terms, 1, -v, gtsam.noiseModel.Unit.Create(len(v)))

    def change(self, rows: Rows, sign: float) -> None:
        """Add or remove rows; see `SequentialFilter.change`."""
        number, at, b, v = rows
        row = np.zeros((len(b), len(self.key_of)))
        row[:, at] = b
        self._rows.append((row, v, sign))
        if sign < 0:
            nothing = gtsam.NonlinearFactorGraph()
            self.isam.update(nothing, gtsam.Values(), [self._slots.pop(number)])
            return
        graph = gtsam.GaussianFactorGraph()
        graph.push_back(self._factor(row, v))
        new = gtsam.LinearContainerFactor.ConvertLinearGraph(graph)
        (self._slots[number],) = self.isam.update(new, gtsam.Values()).getNewFactorsIndices()

    @property
    def x(self) -> Array:
        """Unknowns."""
        values = self.isam.calculateEstimate()
        return np.concatenate([values.atVector(k) for k in range(len(self.variables))])

    @property
    def vtv(self) -> float:
        """Value of vᵀv of all rows, which iSAM2 does not keep."""
        x = self.x
        return sum(sign * float(np.sum((a @ x + v) ** 2)) for a, v, sign in self._rows)

    def cofactors(self) -> Array:
        """Return Q, of all variables jointly."""
        keys = gtsam.KeyVector(list(range(len(self.variables))))
        return np.asarray(self.isam.jointMarginalCovariance(keys).fullMatrix())

    @property
    def numbers(self) -> int:
        """Elements of R in the cliques, and the right side."""
        return int(self.isam.treeNnz()) + len(self.key_of)

"""One least-squares step with dense matrices: a reference that shares no line with the solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factorgraph_adj.graph.equations import Equations
from factorgraph_adj.graph.variables import State
from factorgraph_adj.quality.reliability import reliability
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.types import Array, Mask
from tests.support.differences import columns_of, whitened_system

RANK = 1e-10
"""Singular values of the scaled design matrix, relative to the greatest, that count as zero."""


@dataclass(frozen=True)
class Dense:
    """Linearised observation equations v + A dx of the free unknowns, divided by σ."""

    design: Array
    """A (n_rows, n_unknowns)."""
    residual: Array
    """v (n_rows,)."""
    free: Mask
    """Columns of the network that are unknowns, (n_columns,)."""

    @classmethod
    def at(cls, equations: Equations, state: State) -> Dense:
        """Linearise a network."""
        design = np.zeros((equations.n_rows, equations.unknowns.n_columns))
        residual = np.zeros(equations.n_rows)
        weights = np.diag(1.0 / equations.sigmas())
        for block in equations.blocks:
            v, partials = block.evaluate(equations.network.frame, state)
            design[block.rows] = columns_of(equations.unknowns, block, partials)
            residual[block.rows] = v.ravel()
            if block.whitener is not None:
                for i, own in enumerate(block.whitener):
                    rows = block.first_row + block.dimension * i + np.arange(block.dimension)
                    weights[np.ix_(rows, rows)] = own
        for cluster in equations.clusters:
            weights[np.ix_(cluster.rows, cluster.rows)] = cluster.whitener
        free = equations.unknowns.free
        return cls(weights @ design[:, free], weights @ residual, free)

    def vtpv_after_step(self) -> float:
        """Return min |v + A dx|²: vᵀPv as the linear model promises it."""
        u, _ = self._range()
        v = self.residual - u @ (u.T @ self.residual)
        return float(v @ v)

    def cofactor(self, datum: Mask) -> Array:
        """Return Q (n_columns, n_columns), zero for what is held.

        With a datum defect by inner constraints over the columns in ``datum`` (n_columns,):
        Q = S Q⁻ Sᵀ, S = I − G (G_DᵀG_D)⁻¹ G_Dᵀ, G the null space of A.
        """
        scale = np.linalg.norm(self.design, axis=0)
        _, s, vt = np.linalg.svd(self.design / scale, full_matrices=True)
        rank = int(np.sum(s > RANK * s[0]))
        root = (vt[:rank] / s[:rank, None] / scale).T
        motions = (vt[rank:] / scale).T
        if motions.shape[1]:
            on = motions[datum[self.free]]
            root = root - motions @ np.linalg.solve(on.T @ on, on.T @ root[datum[self.free]])
        q = np.zeros((len(self.free),) * 2)
        q[np.ix_(self.free, self.free)] = root @ root.T
        return q

    def redundancy_numbers(self) -> Array:
        """Return r_i = 1 − (A Q Aᵀ)_ii (n_rows,), observations without correlation."""
        u, _ = self._range()
        return np.asarray(1.0 - np.sum(u * u, axis=1))

    def _range(self) -> tuple[Array, Array]:
        """Return an orthonormal basis of the range of A, and its singular values."""
        scaled = self.design / np.linalg.norm(self.design, axis=0)
        u, s, _ = np.linalg.svd(scaled, full_matrices=False)
        return u[:, s > RANK * s[0]], s


@dataclass(frozen=True)
class DenseReliability:
    """Reliability from full matrices; a reference that shares no line with the package."""

    redundancy_numbers: Array
    """diag(Q_vv P) (n_rows,)."""
    e1: Array
    e2: Array
    e12: Array
    weighted: Array
    """Pv."""
    precision: Array
    """P Q_vv P (n_rows, n_rows)."""
    lost: Array
    """diag(P A Q AᵀP)."""
    effects: Array
    """Q AᵀP (n_columns, n_rows): effects of errors of one unit."""

    @classmethod
    def of(cls, solution: Solution) -> DenseReliability:
        """Compute everything from dense inverses."""
        equations = solution.equations
        dense = Dense.at(equations, solution.state)
        whitener = np.diag(1.0 / equations.sigmas())
        for block in equations.blocks:
            if block.whitener is not None:
                for i, own in enumerate(block.whitener):
                    rows = block.first_row + block.dimension * i + np.arange(block.dimension)
                    whitener[np.ix_(rows, rows)] = own
        for cluster in equations.clusters:
            whitener[np.ix_(cluster.rows, cluster.rows)] = cluster.whitener
        weight = whitener.T @ whitener
        datum = (
            np.zeros(len(dense.free), dtype=bool)
            if solution.datum is None
            else solution.datum.columns
        )
        q = dense.cofactor(datum)
        a = np.zeros((len(weight), len(dense.free)))
        a[:, dense.free] = np.linalg.solve(whitener, dense.design)
        points = np.zeros(len(dense.free), dtype=bool)
        for number in range(len(equations.unknowns["point"].names)):
            points[equations.unknowns.columns("point", number)] = True
        hat = a @ q @ a.T @ weight
        one = a[:, ~points] @ q[np.ix_(~points, ~points)] @ a[:, ~points].T @ weight
        basis = _basis(whitener @ a[:, points & dense.free])
        two = np.linalg.solve(whitener, basis @ basis.T @ whitener)
        precision = weight - weight @ a @ q @ a.T @ weight
        return cls(
            1.0 - np.diag(hat),
            np.diag(one).copy(),
            np.diag(two).copy(),
            np.diag(hat - one - two).copy(),
            whitener.T @ dense.residual,
            precision,
            np.diag(weight @ a @ q @ a.T @ weight).copy(),
            q @ a.T @ weight,
        )


def _basis(a: Array) -> Array:
    """Return an orthonormal basis of the range of a matrix."""
    length = np.linalg.norm(a, axis=0)
    u, s, _ = np.linalg.svd(a[:, length > 0] / length[length > 0], full_matrices=False)
    return np.asarray(u[:, s > RANK * max(s.max(initial=0.0), 1e-300)])


@dataclass(frozen=True)
class DenseNormal:
    """Normal matrix of a solution, as its factorisation has it, with all columns."""

    a: Array
    """Whitened partials (n_rows, n_columns), zero for held components."""
    matrix: Array
    """N = AᵀA + the terms of the minimal datum of a free network, (n_columns, n_columns)."""
    q: Array
    """The inverse of N, zero for held components."""
    free: Mask
    """Columns that are unknowns, (n_columns,)."""

    @classmethod
    def of(cls, solution: Solution) -> DenseNormal:
        """Compute everything from full matrices."""
        free = solution.equations.unknowns.free
        a = np.where(free, whitened_system(solution.equations, solution.state)[0], 0.0)
        terms = solution.run.constraint
        if solution.datum is not None:
            terms = solution.normal().better_minimal_datum(terms, solution.datum, exact=True)
        n = a.T @ a + np.diag(np.where(free, terms, 0.0))
        return cls(a, n, inverse(n, free), free)

    @property
    def sigma(self) -> Array:
        """Standard deviations (n_columns,), one for held components."""
        return np.sqrt(np.where(self.free, np.diag(self.q), 1.0))


def inverse(n: Array, on: Mask) -> Array:
    """Return the inverse of the rows and columns of a normal matrix that are on, zero elsewhere."""
    at = np.ix_(on, on)
    scale = np.sqrt(np.diag(n)[on])
    out = np.zeros_like(n)
    out[at] = np.linalg.inv(n[at] / np.outer(scale, scale)) / np.outer(scale, scale)
    return out


CLOSE = 1e-7
"""Relative agreement of figures by elimination and by full matrices."""


def assert_adjustment_of_full_matrices(solution: Solution) -> None:
    """Compare a minimum, and the covariances of the points P…, with those of full matrices."""
    dense = Dense.at(solution.equations, solution.state)
    step = np.linalg.lstsq(dense.design, dense.residual, rcond=None)[0]
    q = dense.cofactor(np.zeros(len(dense.free), dtype=bool))
    assert np.abs(step / np.sqrt(np.diag(q)[dense.free])).max() < 1e-5
    for name in [n for n in solution.network.points if n.startswith("P")]:
        columns = solution.equations.unknowns.columns("point", solution.number("point", name))
        expected = solution.variance_factor * q[np.ix_(columns, columns)]
        found = solution.variable_covariance(("point", name))
        np.testing.assert_allclose(found, expected, rtol=0, atol=CLOSE * np.abs(expected).max())


def assert_reliability_of_full_matrices(solution: Solution) -> None:
    """Compare redundancy numbers, tests and detectable errors with those of full matrices."""
    rel, dense = reliability(solution), DenseReliability.of(solution)
    np.testing.assert_allclose(rel.redundancy_numbers, dense.redundancy_numbers, rtol=0, atol=CLOSE)
    root = np.sqrt(np.diag(dense.precision))
    np.testing.assert_allclose(rel.w, dense.weighted / root, rtol=CLOSE, atol=CLOSE)
    np.testing.assert_allclose(rel.mdb, rel.delta0 / root, rtol=CLOSE)

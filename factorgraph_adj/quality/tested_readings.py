"""Readings with their tests, whitened: the units in which data snooping finds gross errors.

A reading is what data snooping rejects as one: an observation with all its components, or the
parts of a joint reading, such as an edge of a pose graph (`Equations.reading_of_row`). Each row has
Baarda's w, a joint reading T² of all its rows. With M = P Q_vv P, P and D = diag(M) of the rows of
a reading, and M z = s P z for its directions z and shares s,

    T = [z_1/√s_1, z_2/√s_2, …],    TᵀM T = I,    F = D^½ T.

An error f = T n has T² = nᵀn. A direction whose share is zero is uncontrolled: its errors show in
no residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array

from ..types import Array, Index, Mask
from .causes.shared_error_tests import whitening_matrix
from .error_effects import residual_response
from .group_tests import least_share
from .joint_readings import has_joint_readings
from .reliability import Reliability, stiff_ties
from .snooping_candidates import RowGroups, stated_conditions


@dataclass(frozen=True, eq=False)
class TestedReadings:
    """The readings of a network with their tests, whitened by their own M; m readings, n rows."""

    order: Index
    """Rows of the network in the order of readings, (n,)."""
    first: Index
    """Place of the first row of each reading in this order, (m,)."""
    joint: Mask
    """Which readings are tested by T² instead of by w of their rows, (m,)."""
    whitening: csr_array
    """T, block diagonal in the order of readings, (n, n): an error f = T n has T'M T = I for each
    reading by itself; columns of uncontrolled directions are zero."""
    dual: csr_array
    """Block diagonal F, (n, n): the tests of a reading alone give Σ|F y|, or |F y| for T²."""
    responses: csr_array
    """Block diagonal D^-½ M T, (n, n): with C it gives the noncentralities of all w; zero rows
    have no test of their own."""
    hidden: csr_array
    """Errors of one σ in uncontrolled directions, (n, number of directions)."""
    hidden_of: Index
    """Reading of each such direction."""
    share: Array
    """Smallest share of an error of a reading in its residuals, without uncontrolled ones, (m,)."""

    @property
    def n(self) -> int:
        """Number of readings."""
        return len(self.first)

    def rows(self, unit: int) -> Index:
        """Return the rows of the network of a reading."""
        return np.split(self.order, self.first[1:])[unit]

    def sums(self, values: Array) -> Array:
        """Return the sums of rows (n, k) in the order of readings over each reading, (m, k)."""
        if len(self.first) == len(self.order):
            return values
        return np.asarray(np.add.reduceat(values, self.first, axis=0))

    def dual_norms(self) -> float:
        """Return s, the largest √d ‖F‖ of a reading that is tested by w; 1 with single rows."""
        size = np.diff(np.append(self.first, len(self.order)))
        many = np.flatnonzero((size > 1) & ~self.joint)
        out = 1.0
        for d in np.unique(size[many]).tolist():
            rows = self.first[many[size[many] == d], None] + np.arange(d)
            i, j = np.broadcast_arrays(rows[:, :, None], rows[:, None, :])
            blocks = np.asarray(self.dual[i.ravel(), j.ravel()]).reshape(-1, d, d)
            largest = np.linalg.norm(blocks, ord=2, axis=(1, 2)).max()
            out = max(out, float(np.sqrt(d) * largest))
        return out

    def single(self, effects: Array) -> Array:
        """Return the slopes of single readings, (m, figures).

        Args:
            effects: γ = Tᵀg of the axes of each figure, (n, figures, axes).
        """
        rows, figures, axes = effects.shape
        seen = effects
        if self.dual.nnz != rows or np.any(self.dual.data != 1.0):
            seen = (self.dual @ effects.reshape(rows, -1)).reshape(rows, figures, axes)
        size = np.sqrt(np.einsum("nfa,nfa->nf", seen, seen))
        if not self.joint.any():
            return self.sums(size)
        return np.where(self.joint[:, None], np.sqrt(self.sums(size**2)), self.sums(size))


def tested_readings(rel: Reliability) -> TestedReadings:
    """Return the readings of an adjustment with the whitening of their tests."""
    equations = rel.solution.equations
    groups = RowGroups.of(equations)
    order = np.arange(equations.n_rows) if groups.order is None else groups.order
    joint = np.zeros(len(groups.first), dtype=bool)
    if has_joint_readings(equations):
        own = equations.observation_of_row
        for unit in np.flatnonzero(groups.size > 1).tolist():
            joint[unit] = len(np.unique(own[groups.rows(unit)])) > 1
    whitener = whitening_matrix(equations)
    weight = csr_array(whitener.T @ whitener)
    least = least_share(rel.solution)
    stated = np.ones(len(groups.first), dtype=bool)
    np.logical_and.at(stated, groups.number, stiff_ties(rel))
    stated[stated_conditions(equations, groups)] = True
    white, dual, responses = _Diagonal(), _Diagonal(), _Diagonal()
    hidden: list[tuple[int, Array]] = []
    share = np.ones(len(groups.first))
    for size in np.unique(groups.size).tolist():
        units = np.flatnonzero(groups.size == size)
        at = groups.first[units, None] + np.arange(size)
        p, m = _own_weights(rel, weight, order[at], units)
        inverse = np.linalg.inv(np.linalg.cholesky(p)).transpose(0, 2, 1)
        values, vectors = np.linalg.eigh(inverse.transpose(0, 2, 1) @ m @ inverse)
        on = values > least
        # A property that the user states has no error, and no test that decides.
        on[stated[units]] = True
        basis = inverse @ vectors  # errors that are orthonormal in P
        if size == 1:
            basis = np.abs(basis)
        seen = np.where(on & ~stated[units, None], 1.0 / np.sqrt(np.where(on, values, 1.0)), 0.0)
        own = basis * seen[:, None, :]
        scale = np.sqrt(np.maximum(np.einsum("nii->ni", m), 0.0))
        tests = scale[:, :, None] * own
        tests[joint[units]] = np.eye(size)
        if size == 1:
            tests = np.ones_like(tests)
        with_test = (scale > 0.0) & ~joint[units, None]
        size_of_test = np.where(with_test, scale, np.inf)
        responses.add(at, (m @ own) / size_of_test[:, :, None])
        white.add(at, own)
        dual.add(at, tests)
        share[units] = np.where(on & ~stated[units, None], values, 1.0).min(axis=1)
        for unit, direction in zip(*(x.tolist() for x in np.nonzero(~on)), strict=True):
            error = np.zeros(len(order))
            error[at[unit]] = basis[unit, :, direction]
            hidden.append((int(units[unit]), error))
    return TestedReadings(
        order,
        groups.first,
        joint,
        white.matrix(len(order)),
        dual.matrix(len(order)),
        responses.matrix(len(order)),
        csr_array(np.array([e for _, e in hidden]).reshape(len(hidden), len(order)).T),
        np.array([unit for unit, _ in hidden], dtype=np.intp),
        share,
    )


class _Diagonal:
    """A block diagonal matrix that is filled with blocks of several sizes."""

    def __init__(self) -> None:
        self._values: list[Array] = []
        self._rows: list[Index] = []
        self._columns: list[Index] = []

    def add(self, at: Index, blocks: Array) -> None:
        """Add blocks (m, d, d) at the rows (m, d)."""
        rows, columns = np.broadcast_arrays(at[:, :, None], at[:, None, :])
        self._values.append(blocks.ravel())
        self._rows.append(rows.ravel())
        self._columns.append(columns.ravel())

    def matrix(self, n: int) -> csr_array:
        """Return the matrix, (n, n)."""
        at = np.concatenate(self._rows), np.concatenate(self._columns)
        return csr_array(coo_array((np.concatenate(self._values), at), shape=(n, n)))


def _own_weights(
    rel: Reliability, weight: csr_array, rows: Index, units: Index
) -> tuple[Array, Array]:
    """Return P and M of readings with the rows (m, d), (m, d, d) each."""
    m, d = rows.shape
    if d == 1:
        p = weight.diagonal()[rows]
        return p[:, :, None], rel.precision[rows][:, :, None]
    i, j = np.broadcast_arrays(rows[:, :, None], rows[:, None, :])
    p = np.asarray(weight[i.ravel(), j.ravel()]).reshape(m, d, d)
    out = np.full((m, d, d), np.nan)
    equations = rel.solution.equations
    place = np.full(equations.n_rows, -1)
    place[rows[:, 0]] = np.arange(m)
    blocks, clusters = rel.leverages.hats
    for block, hat in zip(equations.blocks, blocks, strict=True):
        first = block.first_row + np.arange(block.n) * block.dimension
        at = place[first]
        if block.dimension != d or not np.any(at >= 0):
            continue
        own = np.eye(d) - hat
        if block.whitener is None:
            own = own / (block.sigma[:, :, None] * block.sigma[:, None, :])
        else:
            own = block.whitener.transpose(0, 2, 1) @ own @ block.whitener
        out[at[at >= 0]] = own[at >= 0]
    for c, hat in zip(equations.clusters, clusters, strict=True):
        own = c.whitener.T @ (np.eye(len(hat)) - hat) @ c.whitener
        number = np.full(equations.n_rows, -1)
        number[c.rows] = np.arange(len(c.rows))
        for unit in np.unique(place[c.rows][place[c.rows] >= 0]).tolist():
            members = number[rows[unit]]
            out[unit] = own[np.ix_(members, members)]
    for unit in np.flatnonzero(np.isnan(out).any(axis=(1, 2))).tolist():
        # Known coordinates of one point: an observation for each axis in the equations.
        out[unit] = residual_response(rel.solution, rows[unit])[rows[unit]]
    return p, 0.5 * (out + out.transpose(0, 2, 1))

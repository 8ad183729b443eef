"""One least-squares step with dense matrices: a reference that shares no line with the solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from differences import columns_of

from factorgraph_adj.graph.equations import Equations
from factorgraph_adj.graph.variables import State
from factorgraph_adj.types import Array, Mask

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

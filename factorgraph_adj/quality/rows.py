"""Conversion of whitened rows to observations, with covariances inside observations and clusters.

With W Σ Wᵀ = I and P = WᵀW the solver works on Ã = W A and ṽ = W v, observation by observation or
cluster by cluster. For the rows of an observation or a cluster, Q_vv P = W⁻¹ M W and
P Q_vv P = Wᵀ M W with M = I − Ã Q Ãᵀ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..solve.leverage import Leverages
from ..types import Array, Index


def share_diagonal(
    equations: Equations, blocks: Sequence[Array], clusters: Sequence[Array]
) -> Array:
    """Return diag(W⁻¹ M W) over all rows, for M (n, d, d) of blocks and (k, k) of clusters."""
    out = np.empty(equations.n_rows)
    for block, m in zip(equations.blocks, blocks, strict=True):
        if block.whitener is not None:
            m = np.asarray(np.linalg.solve(block.whitener, m @ block.whitener))
        out[block.rows] = np.einsum("nii->ni", m).ravel()
    for c, m in zip(equations.clusters, clusters, strict=True):
        out[c.rows] = np.diag(np.linalg.solve(c.whitener, m @ c.whitener))
    return out


def weighted_diagonal(
    equations: Equations, blocks: Sequence[Array], clusters: Sequence[Array]
) -> Array:
    """Return diag(Wᵀ M W) over all rows, for M as in `share_diagonal`."""
    out = np.empty(equations.n_rows)
    for block, m in zip(equations.blocks, blocks, strict=True):
        if block.whitener is None:
            found = np.einsum("nii->ni", m) / block.sigma**2
        else:
            found = np.einsum("nji,njk,nki->ni", block.whitener, m, block.whitener)
        out[block.rows] = found.ravel()
    for c, m in zip(equations.clusters, clusters, strict=True):
        out[c.rows] = np.einsum("ji,jk,ki->i", c.whitener, m, c.whitener)
    return out


def weights(equations: Equations) -> Array:
    """Return P_ii of all rows."""
    out = 1.0 / equations.sigmas() ** 2
    for block in equations.blocks:
        if block.whitener is not None:
            out[block.rows] = np.sum(block.whitener**2, axis=1).ravel()
    for c in equations.clusters:
        out[c.rows] = np.sum(c.whitener**2, axis=0)
    return out


def weighted(equations: Equations, whitened: Array) -> Array:
    """Return Wᵀ y over all rows for y (n_rows, k); P v for y = ṽ."""
    out = np.empty_like(whitened)
    k = whitened.shape[1]
    for block in equations.blocks:
        y = whitened[block.rows].reshape(*block.observed.shape, k)
        if block.whitener is None:
            found = y / block.sigma[:, :, None]
        else:
            found = block.whitener.transpose(0, 2, 1) @ y
        out[block.rows] = found.reshape(-1, k)
    for c in equations.clusters:
        out[c.rows] = c.whitener.T @ whitened[c.rows]
    return out


def largest_shift(equations: Equations, found: Leverages) -> Array:
    """Return max |Q_p AᵀP e_i| over the observation's own points p, lengths in space, (n_rows,).

    The unit is metres per unit of the observation; NaN for an observation without unknown points.
    """
    out = np.full(equations.n_rows, np.nan)
    for block, part in zip(equations.blocks, found.blocks, strict=True):
        if part.own.shape[1]:
            own = part.own if block.whitener is None else part.own @ block.whitener
            by_point = own.reshape(block.n, -1, 3, block.dimension)
            size = np.linalg.norm(by_point, axis=2).max(axis=1)
            if block.whitener is None:
                size = size / block.sigma
            moving = _has_point(equations, block)
            out[block.rows] = np.where(moving[:, None], size, np.nan).ravel()
    offset = equations.unknowns["point"].offset
    for c, joint in zip(equations.clusters, found.clusters, strict=True):
        shift = joint.own @ c.whitener
        for j, row in enumerate(c.rows.tolist()):
            place = place_of(equations, row)
            first = np.array(
                [
                    offset[index[place.observation]]
                    for kind, index in place.block.variables
                    if kind == "point"
                ]
            )
            owns = (np.isin(joint.columns, p + np.arange(3)) for p in first[first >= 0].tolist())
            out[row] = max((float(np.linalg.norm(shift[own, j])) for own in owns), default=np.nan)
    return out


def _has_point(equations: Equations, block: Block) -> Array:
    offset = equations.unknowns["point"].offset
    out = np.zeros(block.n, dtype=bool)
    for kind, index in block.variables:
        if kind == "point":
            out |= offset[index] >= 0
    return out


@dataclass(frozen=True)
class Place:
    """Block, observation and component of a scalar row."""

    number: int
    """Number of the block."""
    block: Block
    """The block."""
    observation: int
    """Number of the observation in the block."""
    component: int
    """Number of the component in the observation."""


def place_of(equations: Equations, row: int) -> Place:
    """Return the block, observation and component of a scalar row."""
    for number, block in enumerate(equations.blocks):
        if block.rows.start <= row < block.rows.stop:
            return Place(number, block, *divmod(row - block.first_row, block.dimension))
    raise IndexError(row)


def whitened_unit(equations: Equations, row: int) -> tuple[Index, Array]:
    """Return the rows and values of W e_i."""
    for c in equations.clusters:
        at = np.flatnonzero(c.rows == row)
        if len(at):
            return c.rows, c.whitener[:, at[0]]
    place = place_of(equations, row)
    block, i, component = place.block, place.observation, place.component
    if block.whitener is None:
        return np.array([row]), np.array([1.0 / block.sigma[i, component]])
    first = block.first_row + i * block.dimension
    return first + np.arange(block.dimension), block.whitener[i, :, component]

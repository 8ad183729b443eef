"""Effects of an error of one observation on residuals and unknowns; diagonals with P and Q_vv.

With W Σ Wᵀ = I and P = WᵀW the solver works on Ã = W A and ṽ = W v, observation by observation or
cluster by cluster. For the rows of an observation or a cluster, Q_vv P = W⁻¹ M W and
P Q_vv P = Wᵀ M W with M = I − Ã Q Ãᵀ. The functions convert whitened rows to observations, with the
covariances inside observations and clusters, and give the effect ∇x = Q AᵀP e_i ∇ of an error ∇.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..solve.gauss_newton_steps import Factorised
from ..solve.leverages import Leverages
from ..solve.solution import Solution
from ..types import Array, Index

UnknownName: TypeAlias = str | tuple[VariableKind, str]
"""An unknown: the name of a point, or the kind and name of any variable."""


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


def weight_diagonal(equations: Equations) -> Array:
    """Return P_ii of all rows."""
    out = 1.0 / equations.sigmas() ** 2
    for block in equations.blocks:
        if block.whitener is not None:
            out[block.rows] = np.sum(block.whitener**2, axis=1).ravel()
    for c in equations.clusters:
        out[c.rows] = np.sum(c.whitener**2, axis=0)
    return out


def weighted_rows(equations: Equations, whitened: Array) -> Array:
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


def largest_point_shift(equations: Equations, found: Leverages) -> Array:
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
            place = row_place(equations, row)
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
class RowPlace:
    """Block, observation and component of a scalar row."""

    number: int
    """Number of the block."""
    block: Block
    """The block."""
    observation: int
    """Number of the observation in the block."""
    component: int
    """Number of the component in the observation."""


def row_place(equations: Equations, row: int) -> RowPlace:
    """Return the block, observation and component of a scalar row."""
    for number, block in enumerate(equations.blocks):
        if block.rows.start <= row < block.rows.stop:
            return RowPlace(number, block, *divmod(row - block.first_row, block.dimension))
    raise IndexError(row)


def whitened_unit_error(equations: Equations, row: int) -> tuple[Index, Array]:
    """Return the rows and values of W e_i."""
    for c in equations.clusters:
        at = np.flatnonzero(c.rows == row)
        if len(at):
            return c.rows, c.whitener[:, at[0]]
    place = row_place(equations, row)
    block, i, component = place.block, place.observation, place.component
    if block.whitener is None:
        return np.array([row]), np.array([1.0 / block.sigma[i, component]])
    first = block.first_row + i * block.dimension
    return first + np.arange(block.dimension), block.whitener[i, :, component]


@dataclass(frozen=True)
class Effect:
    """Effect of an error on one variable."""

    kind: VariableKind
    """Kind of the variable."""
    name: str
    """Name of the variable."""
    components: tuple[str, ...]
    """Names of its components."""
    values: Array
    """Effect on each component, in metres, radians or image units."""


def effect_on_unknowns(
    solution: Solution, row: int, unknowns: UnknownName | Sequence[UnknownName] | None, error: float
) -> Array | tuple[Effect, ...]:
    """Return ∇x = Q AᵀP e_i ∇, see `Reliability.effect_on`."""
    moved = error * unit_error_shifts(solution, np.array([row]))[:, 0]
    table = solution.equations.unknowns
    if isinstance(unknowns, str):
        unknowns = ("point", unknowns)
    if unknowns is None:
        every = [(kind, table[kind].names[number]) for kind, number in table.active()]
        return _effects(solution, moved, every)
    if _is_one(unknowns):
        return _effects(solution, moved, [unknowns])[0].values  # type: ignore[list-item]
    return _effects(
        solution,
        moved,
        [("point", u) if isinstance(u, str) else u for u in unknowns],
    )


def _is_one(unknowns: object) -> bool:
    """Distinguish a pair of kind and name from a sequence of two names."""
    return (
        isinstance(unknowns, tuple)
        and len(unknowns) == 2
        and isinstance(unknowns[1], str)
        and unknowns[0] in UNKNOWNS
    )


def _effects(
    solution: Solution, moved: Array, chosen: Iterable[tuple[VariableKind, str]]
) -> tuple[Effect, ...]:
    out = []
    table = solution.equations.unknowns
    for kind, name in chosen:
        number = solution.number(kind, name)
        columns = table.columns(kind, number)
        values = moved[columns] if len(columns) else np.zeros(int(table[kind].size[number]))
        out.append(Effect(kind, name, table.component_names(kind, number), values))
    return tuple(out)


def unit_error_shifts(solution: Solution, rows: Index) -> Array:
    """Return Q AᵀP e_i of the rows (k,), (n_columns, k): effects of errors of size 1."""
    return solution.cofactor_times(_normal_rows(solution, rows))


def residual_response(
    solution: Solution, rows: Index, *, factor: Factorised | None = None
) -> Array:
    """Return the columns of P Q_vv P = P − P A Q AᵀP at the rows (k,), (n_rows, k).

    ``factor`` solves with another Q, that of an update; None: the solution's.
    """
    equations = solution.equations
    system = solution.normal().system
    y = np.zeros((equations.n_rows, len(rows)))
    for j, row in enumerate(rows.tolist()):
        at, values = whitened_unit_error(equations, row)
        y[at, j] = values
    x = (solution.factor if factor is None else factor).solve(_normal_rows(solution, rows))
    return weighted_rows(equations, y - system.times(x)[: equations.n_rows])


def _normal_rows(solution: Solution, rows: Index) -> Array:
    """Return AᵀP e_i of the rows (k,), (n_columns, k)."""
    equations = solution.equations
    system = solution.normal().system
    out = np.zeros((equations.unknowns.n_columns, len(rows)))
    clusters = None
    for j, row in enumerate(rows.tolist()):
        _, values = whitened_unit_error(equations, row)
        member = next((i for i, c in enumerate(equations.clusters) if row in c.rows), None)
        if member is not None:
            clusters = system.cluster_rows() if clusters is None else clusters
            columns, a = clusters[member]
            out[columns, j] = a.T @ values
            continue
        place = row_place(equations, row)
        lb, i = system.blocks[place.number], place.observation
        if lb.block.whitener is None:
            part = slice(place.component, place.component + 1)
        else:
            part = slice(None)
        for offset, a in zip(lb.offsets, lb.a, strict=True):
            if len(a) and offset[i] >= 0:
                out[offset[i] : offset[i] + a.shape[2], j] += a[i, part].T @ values
    return out

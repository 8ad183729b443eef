"""The effect of an error of one observation on any unknown, and on other observations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ..models.variables import UNKNOWNS, VariableKind
from ..solve.solution import Solution
from ..solve.step import Factorised
from ..types import Array, Index
from .rows import place_of, weighted, whitened_unit

Unknown: TypeAlias = str | tuple[VariableKind, str]
"""An unknown: the name of a point, or the kind and name of any variable."""


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


def effect_of(
    solution: Solution, row: int, unknowns: Unknown | Sequence[Unknown] | None, error: float
) -> Array | tuple[Effect, ...]:
    """Return ∇x = Q AᵀP e_i ∇, see `Reliability.effect_on`."""
    moved = error * shifts(solution, np.array([row]))[:, 0]
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


def shifts(solution: Solution, rows: Index) -> Array:
    """Return Q AᵀP e_i of the rows (k,), (n_columns, k): effects of errors of size 1."""
    return solution.cofactor_times(_normal_rows(solution, rows))


def response(solution: Solution, rows: Index, *, factor: Factorised | None = None) -> Array:
    """Return the columns of P Q_vv P = P − P A Q AᵀP at the rows (k,), (n_rows, k).

    ``factor`` solves with another Q, that of an update; none: the solution's.
    """
    equations = solution.equations
    system = solution.normal().system
    y = np.zeros((equations.n_rows, len(rows)))
    for j, row in enumerate(rows.tolist()):
        at, values = whitened_unit(equations, row)
        y[at, j] = values
    x = (solution.factor if factor is None else factor).solve(_normal_rows(solution, rows))
    return weighted(equations, y - system.times(x)[: equations.n_rows])


def _normal_rows(solution: Solution, rows: Index) -> Array:
    """Return AᵀP e_i of the rows (k,), (n_columns, k)."""
    equations = solution.equations
    system = solution.normal().system
    out = np.zeros((equations.unknowns.n_columns, len(rows)))
    clusters = None
    for j, row in enumerate(rows.tolist()):
        _, values = whitened_unit(equations, row)
        member = next((i for i, c in enumerate(equations.clusters) if row in c.rows), None)
        if member is not None:
            clusters = system.cluster_rows() if clusters is None else clusters
            columns, a = clusters[member]
            out[columns, j] = a.T @ values
            continue
        place = place_of(equations, row)
        lb, i = system.blocks[place.number], place.observation
        if lb.block.whitener is None:
            part = slice(place.component, place.component + 1)
        else:
            part = slice(None)
        for offset, a in zip(lb.offsets, lb.a, strict=True):
            if len(a) and offset[i] >= 0:
                out[offset[i] : offset[i] + a.shape[2], j] += a[i, part].T @ values
    return out

"""Largest part of a free network that the null vectors of its equations move as a whole.

Null vectors of the observations move the largest coherent part of a free network as a whole:
shifted, turned and scaled. With the motions G of `factorgraph_adj.solve.datum_defects.generators`
and a basis Z of the null space, both scaled, a part C is coherent if

    Z_C = G_C T        with one T (7, d).

T follows from three variables that share observations; the part is the set of variables that fit
it.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.sparse import csr_array

from ..graph.variables import State
from ..models.unknown_registry import VariableKind
from ..types import Array, Index
from .datum_defects import generators
from .linearised_equations import LinearisedEquations

MAX_MOTION_MISFIT = 1e-6
"""Largest difference of a scaled null vector from a motion that counts as rounding."""
MAX_SEED_TRIPLES = 2000
"""Largest number of triples that are tried."""
MAX_SEED_NEIGHBOURS = 8
"""Largest number of neighbours of a variable from which its triples are made."""


def largest_coherent_part(
    system: LinearisedEquations, state: State, z: Array, scale: Array
) -> set[tuple[VariableKind, str]]:
    """Return the variables of the largest part that null vectors move as a whole.

    Args:
        system: the linearised network.
        state: where it was linearised.
        z: basis of its null space, scaled by √diag(N), (n_columns, d).
        scale: √diag(N), (n_columns,).
    """
    unknowns = system.unknowns
    g = scale[:, None] * generators(system.equations, state)
    active = list(unknowns.active())
    columns = [unknowns.columns(*v) for v in active]
    owner = np.repeat(np.arange(len(active)), [len(c) for c in columns])
    every = np.concatenate(columns)
    best = np.zeros(len(active), dtype=bool)
    most = 0
    for seed in _seeds(system, active, columns):
        at = np.concatenate([columns[i] for i in seed])
        mixture = np.linalg.lstsq(g[at], z[at], rcond=None)[0]
        off = np.abs(g[every] @ mixture - z[every]).max(axis=1)
        worst = np.zeros(len(active))
        np.maximum.at(worst, owner, off)
        inside = worst < MAX_MOTION_MISFIT
        n = int(np.isin(owner, np.flatnonzero(inside)).sum())
        if n > most:
            best, most = inside, n
    return {
        (kind, unknowns[kind].names[number])
        for (kind, number), on in zip(active, best.tolist(), strict=True)
        if on
    }


def _seeds(
    system: LinearisedEquations, active: list[tuple[VariableKind, int]], columns: list[Index]
) -> list[tuple[int, int, int]]:
    """Return triples of points and photos that share observations, by their numbers."""
    variable = np.full(system.unknowns.n_columns, -1, dtype=np.intp)
    for i, ((kind, _), own) in enumerate(zip(active, columns, strict=True)):
        if kind in ("point", "pose"):
            variable[own] = i
    a = system.sparse(np.arange(system.equations.n_rows)).tocoo()
    on = variable[a.col] >= 0
    shape = system.equations.n_rows, len(active)
    pattern = csr_array((np.ones(on.sum()), (a.row[on], variable[a.col[on]])), shape)
    shared = (pattern.T @ pattern).tocsr()
    found: dict[tuple[int, int, int], None] = {}
    for i in range(len(active)):
        row = slice(shared.indptr[i], shared.indptr[i + 1])
        others = shared.indices[row][np.argsort(-shared.data[row], kind="stable")]
        near = [int(j) for j in others.tolist() if j != i][:MAX_SEED_NEIGHBOURS]
        for pair in combinations(near, 2):
            first, second, third = sorted((i, *pair))
            found[first, second, third] = None
    seeds = list(found)
    if len(seeds) <= MAX_SEED_TRIPLES:
        return seeds
    chosen = np.random.default_rng(1).choice(len(seeds), MAX_SEED_TRIPLES, replace=False)
    return [seeds[i] for i in np.sort(chosen).tolist()]

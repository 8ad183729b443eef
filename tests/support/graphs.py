"""Graphs of GTSAM as normal equations, to compare them with those of the library."""

from __future__ import annotations

import gtsam
import numpy as np

from factorgraph_adj.factor_graph.network_graph import Graph
from factorgraph_adj.graph.keys import from_gtsam, state_of
from factorgraph_adj.types import Array


def normal_equations(built: Graph) -> tuple[Array, Array]:
    """Return N and AᵀPv of the graph by our tangents, without what keeps held components."""
    unknowns, keys = built.equations.unknowns, built.keys
    state = state_of(built.equations, built.values)
    n, g = np.zeros((unknowns.n_columns,) * 2), np.zeros(unknowns.n_columns)
    partly_held = sum(
        not unknowns.free[unknowns.columns(kind, number)].all()
        for kind, number in unknowns.active()
    )
    for i in range(built.graph.size() - partly_held):
        linear = gtsam.JacobianFactor(built.graph.at(i).linearize(built.values))
        a, b = linear.jacobian()
        first = 0
        full = np.zeros((len(b), unknowns.n_columns))
        for key in list(linear.keys()):
            kind, number = keys.variable(key)
            size = int(unknowns[kind].size[number])
            part = a[:, first : first + size]
            scale = unknowns.graph_scale(kind, number)
            part = from_gtsam(kind, part, state[kind][number], scale)
            full[:, unknowns.columns(kind, number)] = part
            first += size
        n += full.T @ full
        g -= full.T @ b
    return n, g

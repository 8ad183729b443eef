"""Normal equations eliminated by GTSAM's QR, which fronts by QR are compared with."""

from __future__ import annotations

import gtsam
import numpy as np

from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from factorgraph_adj.types import Array

MAX_COLAMD_VARIABLES = 300
"""Variables up to which COLAMD orders as well as METIS."""


def gaussian_graph(system: LinearisedEquations, rhs: Array) -> gtsam.GaussianFactorGraph:
    """Return the rows A x = b as factors, one for each observation; clusters are left out.

    A key is the first column of a variable.

    Args:
        system: the linearised network.
        rhs: b, (rows,).
    """
    graph = gtsam.GaussianFactorGraph()
    for lb in system.blocks:
        arrays, b = lb.a, rhs[lb.block.rows].reshape(lb.block.observed.shape)
        unit = gtsam.noiseModel.Unit.Create(lb.block.dimension)
        for i in range(lb.block.n):
            terms = [
                (int(offset[i]), np.asfortranarray(a[i][:, : system.unknowns.size_at[offset[i]]]))
                for offset, a in zip(lb.offsets, arrays, strict=True)
                if len(a) and offset[i] >= 0
            ]
            if terms:
                graph.add(gtsam.GaussianConditional(terms, 1, b[i], unit))
    for column in np.flatnonzero(~system.unknowns.free).tolist():
        first = max(c for c in system.unknowns.size_at if c <= column)
        a = np.zeros((1, system.unknowns.size_at[first]))
        a[0, column - first] = 1.0
        one = gtsam.noiseModel.Unit.Create(1)
        graph.add(gtsam.JacobianFactor(first, a, np.zeros(1), one))
    return graph


def order(graph: gtsam.GaussianFactorGraph) -> gtsam.Ordering:
    """Return GTSAM's order of elimination."""
    if graph.keys().size() > MAX_COLAMD_VARIABLES:
        return gtsam.Ordering.MetisGaussianFactorGraph(graph)
    return gtsam.Ordering.ColamdGaussianFactorGraph(graph)


def solution_by_gtsam(system: LinearisedEquations, rhs: Array) -> Array:
    """Return x that minimises |A x − b|, by multifrontal QR, (n_columns,)."""
    graph = gaussian_graph(system, rhs)
    found = graph.eliminateMultifrontal(order(graph), gtsam.EliminateQR).optimize()
    out = np.zeros(system.unknowns.n_columns)
    for key, size in system.unknowns.size_at.items():
        out[key : key + size] = found.at(key)
    return out

"""GTSAM's optimisers with their defaults on the graph of a network, compared with `adjust`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gtsam
import numpy as np

from factorgraph_adj.factor_graph.network_graph import Graph
from factorgraph_adj.graph.keys import state_of
from factorgraph_adj.graph.variables import Unknowns
from factorgraph_adj.models.unknown_registry import UNKNOWNS, VariableKind
from factorgraph_adj.solve.solution import Solution

OPTIMISERS: dict[str, Callable[[Graph], Any]] = {
    "Levenberg-Marquardt": lambda g: gtsam.LevenbergMarquardtOptimizer(
        g.graph, g.values, gtsam.LevenbergMarquardtParams()
    ),
    "Gauss-Newton": lambda g: gtsam.GaussNewtonOptimizer(
        g.graph, g.values, gtsam.GaussNewtonParams()
    ),
    "Dogleg": lambda g: gtsam.DoglegOptimizer(g.graph, g.values, gtsam.DoglegParams()),
}
"""With default parameters."""


def isam2(built: Graph, *, threshold: float = 0.01, most: int = 30) -> gtsam.Values:
    """Return the estimate of ISAM2 (threshold, skip 1), relinearised until nothing moves."""
    params = gtsam.ISAM2Params()
    params.setRelinearizeThreshold(threshold)
    params.relinearizeSkip = 1
    isam = gtsam.ISAM2(params)
    isam.update(built.graph, built.values)
    force = gtsam.ISAM2UpdateParams()
    force.force_relinearize = True
    force.forceFullSolve = True
    for _ in range(most):
        isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), force)
    return isam.calculateBestEstimate()


def distance(solution: Solution, built: Graph, values: gtsam.Values) -> float:
    """Return the largest distance of values from a solution, relative to σ of free components."""
    there = state_of(built.equations, values)
    unknowns, own = built.equations.unknowns, solution.equations.unknowns
    worst = 0.0
    for kind, number in unknowns.active():
        name = unknowns[kind].names[number]
        here = own[kind].number[name]
        columns = own.columns(kind, here)
        step = UNKNOWNS[kind].local(solution.state[kind][here][None], there[kind][number][None])[0]
        sigma = np.sqrt(np.maximum(np.diag(_covariance(solution, own, kind, name)), 0.0))
        free = own.free[columns] & (sigma > 0.0)
        moved = np.abs(step[: len(columns)][free]) / sigma[free]
        worst = max(worst, float(moved.max(initial=0.0)))
    return worst


def _covariance(solution: Solution, own: Unknowns, kind: VariableKind, name: str) -> Any:
    size = len(own.columns(kind, own[kind].number[name]))
    return solution.variable_covariance((kind, name))[:size, :size]


def covariances_differ(solution: Solution, built: Graph, values: gtsam.Values) -> float:
    """Return the largest difference of GTSAM's marginal covariances from ours, relative to σ σ."""
    marginals = gtsam.Marginals(built.graph, values)
    own = solution.equations.unknowns
    worst = 0.0
    for kind, number in built.equations.unknowns.active():
        name = built.equations.unknowns[kind].names[number]
        ours = _covariance(solution, own, kind, name)
        key = built.keys.key(kind, name)
        theirs = built.keys.covariance(kind, name, marginals.marginalCovariance(key), values)
        sigma = np.sqrt(np.maximum(np.diag(ours), 0.0))
        free = sigma > 0.0
        gap = np.abs(theirs - ours)[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
        worst = max(worst, float(gap.max(initial=0.0)))
    return worst

"""A network as a GTSAM factor graph, for inspection and for combination with a user's factors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import gtsam
import numpy as np

from ..network.network import Network
from ..types import Array
from .blocks import Block
from .equations import Equations, compile_network
from .factors import Part, held_factor, observation_factor
from .keys import KeyMap, values_of
from .variables import State
from .weights import Cluster


@dataclass(frozen=True)
class Graph:
    """The factor graph of a network at its start values."""

    graph: gtsam.NonlinearFactorGraph
    """A factor written in Python for each observation and weighted unknown, in the order of the
    equations; one for each correlated group; at the end a factor with a constrained noise model
    for each variable of which only some components are held. Unwhitened residuals are computed −
    observed, in SI or image units. The graph is a copy: changing it changes no adjustment."""
    values: gtsam.Values
    """Start values of the variables."""
    keys: KeyMap
    """Names ↔ keys."""
    equations: Equations
    """The observation equations of the factors in arrays, with the weights of the start values."""

    @property
    def error(self) -> float:
        """Half of vᵀPv at the start values."""
        return float(self.graph.error(self.values))


def build_graph(network: Network | Equations, *, state: State | None = None) -> Graph:
    """Return the factor graph of a network.

    The error of the graph is ½ vᵀPv, with the weights of the start values and without robust
    weights; it has no datum of a free network. The factors are Python callbacks of the models, so
    iterate in Python with ``graph.linearize(values)``: GTSAM's own optimisers copy all values for
    every callback. `adjust` uses the same models on whole arrays and needs no graph.

    Args:
        network: the network, or its observation equations.
        state: start values; by default those of the network, completed by
            `factorgraph_adj.approximate.approximate`.

    Raises:
        InputError: the network has nothing to adjust, or the geometry of a sight is degenerate.
        ApproximationError: start values are missing and cannot be found.
    """
    equations = network if isinstance(network, Equations) else compile_network(network)
    if state is None:
        state = equations.unknowns.start()
        if any(np.isnan(values).any() for values in state.values()):
            from ..approximate import approximate  # local, because `approximate` imports `graph`

            state = approximate(equations)
    state = {kind: values.copy() for kind, values in state.items()}  # the factors keep the state
    equations = equations.weighted_at(state)
    graph = gtsam.NonlinearFactorGraph()
    for part, noise in (*_single(equations), *_clustered(equations)):
        graph.push_back(
            observation_factor(equations.network.frame, equations.unknowns, state, part, noise)
        )
    unknowns = equations.unknowns
    for kind, number in unknowns.active():
        table = unknowns[kind]
        if not table.free[number, : table.size[number]].all():
            graph.push_back(held_factor(unknowns, state, kind, number))
    return Graph(graph, values_of(equations, state), KeyMap(unknowns), equations)


def _single(equations: Equations) -> Iterator[tuple[list[Part], gtsam.noiseModel.Base]]:
    """Yield the observations without correlations to others."""
    for place, block in enumerate(equations.blocks):
        alone = np.ones(block.n, dtype=bool)
        alone[equations.in_cluster.get(place, slice(0))] = False
        rows = np.arange(block.dimension)[None]
        noise = _noise_models(block)
        for i in np.flatnonzero(alone).tolist():
            yield [Part(block, np.array([i]), rows)], noise(i)


def _clustered(equations: Equations) -> Iterator[tuple[list[Part], gtsam.noiseModel.Base]]:
    """Yield the clusters of observations with a joint covariance, one factor each."""
    for cluster in equations.clusters:
        yield _parts(equations.blocks, cluster), _gaussian(cluster.whitener)


def _parts(blocks: tuple[Block, ...], cluster: Cluster) -> list[Part]:
    """Return the observations of a cluster, block by block."""
    parts = []
    for block in blocks:
        inside = np.flatnonzero(
            (cluster.rows >= block.rows.start) & (cluster.rows < block.rows.stop)
        )
        if not len(inside):
            continue
        number, component = np.divmod(cluster.rows[inside] - block.first_row, block.dimension)
        chosen, where = np.unique(number, return_inverse=True)
        rows = np.empty((len(chosen), block.dimension), dtype=np.intp)
        rows[where, component] = inside
        parts.append(Part(block, chosen, rows))
    return parts


def _noise_models(block: Block) -> Callable[[int], gtsam.noiseModel.Base]:
    """Return a function from observation number to noise model; equal models are shared."""
    whitener = block.whitener
    if whitener is not None:
        return lambda i: _gaussian(whitener[i])
    models: dict[bytes, gtsam.noiseModel.Base] = {}

    def diagonal(i: int) -> gtsam.noiseModel.Base:
        key = block.sigma[i].tobytes()
        if key not in models:
            models[key] = gtsam.noiseModel.Diagonal.Sigmas(block.sigma[i])
        return models[key]

    return diagonal


def _gaussian(whitener: Array) -> gtsam.noiseModel.Base:
    """Return the noise model of covariance (WᵀW)⁻¹.

    GTSAM silently reads only the upper triangle of a square root, but W is lower triangular. The
    factor R of W = QR is upper triangular and RᵀR = WᵀW.
    """
    return gtsam.noiseModel.Gaussian.SqrtInformation(np.linalg.qr(whitener, mode="r"))

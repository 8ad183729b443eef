"""Network as a GTSAM factor graph: noise models, held components, inner constraints, eased ties."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TypeAlias

import gtsam
import numpy as np

from ..blas_threads import with_one_thread
from ..errors import DatumError, taking
from ..graph.blocks import Block
from ..graph.equations import Equations, compile_network
from ..graph.factors import Part, held_factor, observation_factor
from ..graph.keys import KeyMap, insert, to_gtsam, values_of
from ..graph.variables import State, Unknowns
from ..graph.weights import Cluster
from ..models.unknown_registry import VariableKind
from ..network.network import DatumChoice, Network
from ..orientation.choice_of_start import choose_start
from ..solve.datum_defects import FreeDatum, find_defects
from ..solve.inner_constraints import datum_columns
from ..solve.linearised_equations import LinearisedEquations
from ..solve.rigid_mounts import eased_ties
from ..types import Array, Index

MAX_CONSTRAINT_WEIGHT_RATIO = 2.0**20
"""Weight of the constraints, relative to that of the best observed coordinate."""
MAX_TIE_WEIGHT_RATIO = 2.0**16
"""Largest weight of a tie to a carrier, relative to all that holds the best held member otherwise.
GTSAM's Cholesky refuses pivots below 2⁻²⁴ of what was there; estimates and covariances change by
the inverse, relative to σ, at most."""


def inner_constraints(
    system: LinearisedEquations, diagonal: Array, origin: State, keys: KeyMap
) -> gtsam.LinearContainerFactor | None:
    """Return the inner constraints of a free network over its datum points.

        v = B_Dᵀ (x − x₀)_D / σ,    B_DᵀB_D = I

    B spans the motions that no observation notices at the start. As nothing pulls at them, v is
    zero at the minimum whatever σ is. With the weights P of all observations of a coordinate,
    1/σ² = `MAX_CONSTRAINT_WEIGHT_RATIO` max Σ P: σ² is what covariances have too much along these
    motions, and GTSAM's Cholesky takes no more.

    Args:
        system: the network, linearised at its start.
        diagonal: diagonal of N there, (n_columns,).
        origin: x₀.
        keys: keys of the variables.

    Returns:
        The factor; none where the observations notice every motion.

    Raises:
        DatumError: the datum points cannot carry the datum, or the parts of the network are not
            connected with one another.
    """
    equations, state = system.equations, system.state
    defects = [d for d in find_defects(system, state, diagonal, free=True) if d.motions.shape[1]]
    if not defects:
        return None
    if len(defects) > 1:
        raise DatumError(
            f"the observations connect the network in {len(defects)} parts, each without a datum: "
            "a free network is one",
            defect=sum(d.motions.shape[1] for d in defects),
            names=[],
        )
    (defect,) = defects
    columns = datum_columns(equations, defect.motions)
    rows = FreeDatum(defect.motions, columns).masked.T
    weight = float(np.sqrt(diagonal[columns].max(initial=0.0) * MAX_CONSTRAINT_WEIGHT_RATIO)) or 1.0
    unknowns, values, terms = equations.unknowns, gtsam.Values(), []
    for kind, number in unknowns.active():
        own = rows[:, unknowns.columns(kind, number)] * weight
        if own.any():
            scale = unknowns.graph_scale(kind, number)
            insert(values, unknowns, origin, [(kind, number)], [keys.at(kind, number)])
            part = to_gtsam(kind, own, state[kind][number], scale)
            terms.append((keys.at(kind, number), np.asfortranarray(part)))
    unit = gtsam.noiseModel.Unit.Create(len(rows))
    # A JacobianFactor takes three keys at most in Python; a conditional takes any number.
    conditional = gtsam.GaussianConditional(terms, 1, np.zeros(len(rows)), unit)
    return gtsam.LinearContainerFactor(conditional, values)


NamedParts: TypeAlias = tuple[str, list[Part], Callable[[], gtsam.noiseModel.Base]]
"""Name and observations of a factor, and a function that makes its noise model."""


@dataclass(frozen=True)
class Graph:
    """The factor graph of a network at its start values."""

    graph: gtsam.NonlinearFactorGraph
    """A factor written in Python for each observation and weighted unknown, in the order of the
    equations; one for each correlated group; then a factor for each variable of which only some
    components are held, which keeps these, and one with the inner constraints of a free network.
    Unwhitened residuals are computed − observed, in SI or image units. The graph is a copy:
    changing it changes no adjustment."""
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


@taking(Network | Equations)
@with_one_thread
def build_graph(
    network: Network | Equations, *, state: State | None = None, datum: DatumChoice | None = None
) -> Graph:
    """Return the factor graph of a network.

    The error of the graph is ½ vᵀPv, with the weights of the start values and without robust
    weights. GTSAM's optimisers, its ``Marginals`` and ``ISAM2`` take it as it comes: calibrations
    are divided by their scales (`KeyMap.scale`), held components are not pulled at, and rigid ties
    weigh no more than GTSAM's Cholesky can take (`MAX_TIE_WEIGHT_RATIO`). Each factor is a callback
    of the models of this library, for which GTSAM's optimisers copy all values: up to some thousand
    variables they are of use; beyond that iterate with ``graph.linearize(values)``, or take
    `adjust`, which uses the same models on whole arrays.

    Args:
        network: the network, or its observation equations.
        state: start values; by default those of the network, completed as for `adjust`.
        datum: given, or free: with inner constraints over the datum points; by default that of the
            network.

    Raises:
        InputError: the network has nothing to adjust, or the geometry of a sight is degenerate.
        ApproximationError: start values are missing and cannot be found.
        DatumError: the datum points of a free network cannot carry its datum.
    """
    equations = network if isinstance(network, Equations) else compile_network(network)
    chosen = equations.network.datum if datum is None else datum
    origin = state
    if state is None:
        start = choose_start(equations, chosen, None)
        state, origin = start.state, start.origin
    assert origin is not None
    state = {kind: values.copy() for kind, values in state.items()}  # the factors keep the state
    equations = equations.weighted_at(state)
    system = LinearisedEquations(equations, state)
    diagonal = system.diagonal()
    eased_equations = with_eased_ties(equations, system, diagonal)
    unknowns = equations.unknowns
    keys = KeyMap(unknowns)
    graph = gtsam.NonlinearFactorGraph()
    for _, part, noise in observation_parts(eased_equations):
        factor = observation_factor(equations.network.frame, unknowns, state, part, noise(), keys)
        graph.push_back(factor)
    for (kind, number), sigma in held_sigmas(unknowns, diagonal).items():
        graph.push_back(held_factor(unknowns, state, kind, number, sigma, keys))
    if chosen == "free":
        constraints = inner_constraints(system, diagonal, origin, keys)
        if constraints is not None:
            graph.push_back(constraints)
    return Graph(graph, values_of(equations, state), keys, equations)


def with_eased_ties(
    equations: Equations, system: LinearisedEquations, diagonal: Array
) -> Equations:
    """Return equations whose ties weigh no more than `MAX_TIE_WEIGHT_RATIO` says."""
    _, shares = eased_ties(system, diagonal)
    factors = np.minimum(shares[: equations.n_rows] ** 2 * MAX_TIE_WEIGHT_RATIO, 1.0)
    return equations if (factors == 1.0).all() else equations.reweighted(factors)


def held_sigmas(unknowns: Unknowns, diagonal: Array) -> dict[tuple[VariableKind, int], float]:
    """Return standard deviations that keep held components, for each partly held variable.

    They are those that its best observed free component has by its own observations: much smaller
    ones would spoil the pivots of GTSAM's Cholesky, and nothing pulls at held components.
    """
    out = {}
    for kind, number in unknowns.active():
        columns = unknowns.columns(kind, number)
        free = unknowns.free[columns]
        if not free.all():
            scale = unknowns.graph_scale(kind, number)
            by = diagonal[columns] * (1.0 if scale is None else scale**2)
            most = float(np.where(free, by, 0.0).max())
            out[kind, number] = most**-0.5 if most > 0.0 else 1.0
    return out


def observation_parts(equations: Equations) -> Iterator[NamedParts]:
    """Yield the observations of each factor, with its name and a function of its noise model.

    The name is the id of the observation, or of the first one of a correlated group.
    """
    yield from _single(equations)
    for cluster in equations.clusters:
        name = equations.id(int(cluster.rows[0]))
        yield name, _parts(equations.blocks, cluster), partial(_gaussian, cluster.whitener)


def _single(equations: Equations) -> Iterator[NamedParts]:
    """Yield the observations without correlations to others.

    An observation of coordinates, which has a row of its own for each axis, is one factor.
    """
    for place, block in enumerate(equations.blocks):
        alone = np.ones(block.n, dtype=bool)
        alone[equations.in_cluster.get(place, slice(0))] = False
        chosen = np.flatnonzero(alone)
        noise = _noise_models(block)
        number = equations.observation_of_row[block.first_row + chosen * block.dimension]
        starts = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(chosen)]
        for begin, end in pairwise(starts):
            own = chosen[begin:end]
            if len(own):
                name = equations.id(block.first_row + int(own[0]) * block.dimension)
                rows = np.arange(block.dimension * len(own)).reshape(len(own), -1)
                yield name, [Part(block, own, rows)], partial(noise, own)


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


def _noise_models(block: Block) -> Callable[[Index], gtsam.noiseModel.Base]:
    """Return a function from numbers in a block to noise model; equal models are shared."""
    whitener = block.whitener
    if whitener is not None:
        return lambda own: _gaussian(whitener[int(own[0])])
    models: dict[bytes, gtsam.noiseModel.Base] = {}

    def diagonal(own: Index) -> gtsam.noiseModel.Base:
        sigma = block.sigma[own].ravel()
        key = sigma.tobytes()
        if key not in models:
            models[key] = gtsam.noiseModel.Diagonal.Sigmas(sigma)
        return models[key]

    return diagonal


def _gaussian(whitener: Array) -> gtsam.noiseModel.Base:
    """Return the noise model of covariance (WᵀW)⁻¹.

    GTSAM silently reads only the upper triangle of a square root, but W is lower triangular. The
    factor R of W = QR is upper triangular and RᵀR = WᵀW. Its diagonal is made positive: GTSAM takes
    an R that is diagonal up to rounding for one of inverse standard deviations, and refuses
    negative ones.
    """
    r = np.linalg.qr(whitener, mode="r")
    signs = np.where(np.diag(r) < 0, -1.0, 1.0)
    return gtsam.noiseModel.Gaussian.SqrtInformation(signs[:, None] * r)

"""Networks taken apart and put together again observation by observation, against the batch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from factorgraph_adj import IncrementalAdjustment, Network, Solution, adjust
from factorgraph_adj.observations import AnyObservation, Correlated, ImagePoint
from factorgraph_adj.types import Array


def bare(network: Network) -> Network:
    """Return the network without observations."""
    out = network.copy()
    out.observations, out.clusters = {}, []
    out.image_mask(np.zeros(network.n_image_points, dtype=bool))
    return out


def items(network: Network) -> list[AnyObservation]:
    """Return its observations in file order, correlated groups where their first member stands."""
    group_of = {i: n for n, (ids, _) in enumerate(network.clusters) for i in ids}
    out: list[AnyObservation] = []
    done: set[int] = set()
    for ident, o in network.observations.items():
        number = group_of.get(ident)
        if number is None:
            out.append(replace(o, id=ident))
        elif number not in done:
            done.add(number)
            ids, covariance = network.clusters[number]
            members = tuple(replace(network.observations[i], id=i) for i in ids)
            out.append(Correlated(members, covariance))
    return [*out, *network.image_points()]


def ids_of(item: AnyObservation) -> list[str]:
    """Return the ids of an observation or a group."""
    members = item.observations if isinstance(item, Correlated) else (item,)
    return [
        o.id or f"{o.photo}/{o.point}" if isinstance(o, ImagePoint) else str(o.id) for o in members
    ]


def variables(solution: Solution) -> Iterator[tuple[str, str]]:
    """Return kind and name of all variables that own columns."""
    unknowns = solution.equations.unknowns
    for kind, number in unknowns.active():
        yield kind, unknowns[kind].names[number]


@dataclass(frozen=True)
class Difference:
    """How far two solutions are from each other."""

    estimates: float
    """Largest difference of an estimate, relative to its σ."""
    sigmas: float
    """Largest relative difference of a σ."""


def difference(a: Solution, b: Solution) -> Difference:
    """Compare the variables of a with those of b."""
    estimates = sigmas = 0.0
    assert sorted(variables(a)) == sorted(variables(b))
    for kind, name in variables(b):
        qa, qb = (
            np.sqrt(np.maximum(np.diag(s.variable_covariance((kind, name))), 0.0)) for s in (a, b)
        )
        free = qb > 0
        if not free.any():
            continue
        moved = _between(a, b, kind, name)
        estimates = max(estimates, float(np.max(np.abs(moved[free]) / qb[free])))
        sigmas = max(sigmas, float(np.max(np.abs(qa[free] / qb[free] - 1.0))))
    return Difference(estimates, sigmas)


def _between(a: Solution, b: Solution, kind: str, name: str) -> Array:
    va, vb = (s.state[kind][s.number(kind, name)] for s in (a, b))
    if kind == "pose":
        ra, rb = va[:9].reshape(3, 3), vb[:9].reshape(3, 3)
        turn = rb.T @ ra
        w = 0.5 * np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        )
        return np.concatenate([w, va[9:] - vb[9:]])
    size = len(b.equations.unknowns.component_names(kind, b.number(kind, name)))
    moved = va[:size] - vb[:size]
    return (moved + np.pi) % (2 * np.pi) - np.pi if kind == "orientation" else moved


def batch(inc: IncrementalAdjustment) -> Solution:
    """Return the batch adjustment of the same observations."""
    return adjust(inc.network(), start=inc.solution(), tolerance=1e-9)

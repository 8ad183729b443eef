"""Points of which their own readings do not say where they are.

Three standard deviations that reach the farthest station, or photo, reach infinity too. Partials
at the place where such a point is taken to be say nothing about any other; adjustments with it
hardly come to rest, and right readings beside it look wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..observations import observation_kind
from .elimination import Layers, first_point
from .linear import LinearisedEquations
from .solution import Solution

WITHIN = 3.0
"""Standard deviations of a point within which it may be."""


NARROW = 1e-4
"""1 − cos 0.8°: rays with a smaller angle let adjustments of blocks of photos creep."""

AT_ONCE = 100_000
"""Number of observations that are worked on at once."""


@dataclass(frozen=True)
class Anywhere:
    """A point that may be anywhere."""

    name: str
    """Its name."""
    sigma: float
    """Largest standard deviation with everything else held, metres."""
    sight: float
    """Its farthest sight, metres."""

    def __str__(self) -> str:
        """Say so."""
        return (
            f"point {self.name!r} may be anywhere: its standard deviation is {self.sigma:.3g} m "
            f"even with all else held, its farthest sight {self.sight:.3g} m"
        )


def anywhere(solution: Solution) -> list[Anywhere]:
    """Return the points with 3/√λ ≥ s: λ least eigenvalue of N_pp, s farthest sight.

    N_pp is the block of AᵀPA of the point alone: how well the datum is known, or other points,
    does not matter. Neither does a direction of which readings with constant partials (weights,
    control, GNSS vectors, levelling) say most; and partials across a sight change with its
    length only. Correlations between observations are not counted.

    Args:
        solution: of what is to enter.
    """
    return anywhere_at(solution.normal().system)


def anywhere_at(system: LinearisedEquations) -> list[Anywhere]:
    """Return the points that may be anywhere, where a network has been linearised."""
    equations, state = system.equations, system.state
    points = equations.unknowns["point"]
    where = {"point": state["point"], "pose": state["pose"][:, 9:]}
    every, constant = np.zeros((2, len(points.names), 3, 3))
    far = np.zeros(len(points.names))
    for place, linear in enumerate(system.blocks):
        block = linear.block
        curved = _curved(block)
        if curved:
            ends = [(k, index) for k, index in block.variables if k in where]
            for kind, index in ends[1:]:
                first = ends[0]
                sight = where[kind][index] - where[first[0]][first[1]]
                length = np.sqrt(np.sum(sight**2, axis=1))
                for end, at in (first, (kind, index)):
                    if end == "point":
                        np.maximum.at(far, at, length)
        correlated = equations.in_cluster.get(place)
        for begin in range(0, block.n, AT_ONCE):
            rows = np.arange(begin, min(begin + AT_ONCE, block.n))
            for (kind, index), a in zip(block.variables, linear.partials(rows), strict=True):
                if kind != "point" or not len(a):
                    continue
                if correlated is not None:
                    inside = np.isin(rows, correlated)
                    a[inside] /= block.sigma[rows[inside]][:, :, None]
                own = a.transpose(0, 2, 1) @ a
                np.add.at(every, index[rows], own)
                if not curved:
                    np.add.at(constant, index[rows], own)
    # Held components are known best.
    diagonal = np.einsum("nii->ni", every)
    diagonal += np.where(points.free, 0.0, 1.0 + diagonal.sum(axis=1, keepdims=True))
    values, vectors = np.linalg.eigh(every)
    weakest, least = vectors[:, :, 0], np.maximum(values[:, 0], 0.0)
    given = np.einsum("ni,nij,nj->n", weakest, constant, weakest)
    vague = points.free.any(axis=1) & (far * np.sqrt(least) <= WITHIN) & (given <= 0.5 * least)
    return [
        Anywhere(points.names[i], float(1.0 / np.sqrt(least[i])) if least[i] else np.inf, far[i])
        for i in np.flatnonzero(vague & (far > 0)).tolist()
    ]


def narrow(equations: Equations, state: State, layers: Layers) -> list[str]:
    """Return the points that only cameras see, with rays that are nearly parallel.

    The least eigenvalue of Σ(I − d dᵀ) over the directions d of the rays of a point, 1 − cos of
    their angle for two of them, is below `NARROW`. An adjustment creeps along such rays for tens of
    iterations where photos move too.

    Args:
        equations: the network.
        state: where it is.
        layers: layers of its elimination.
    """
    own = np.zeros((len(state["point"]), 3, 3))
    by_cameras = layers.reduced.copy()
    for block in equations.blocks:
        if block.lens is None:
            target = first_point(block)
            if target is not None and len(block.variables) > 1:
                by_cameras[block.variables[target][1]] = False
            continue
        (_, photo), _, (_, point) = block.variables
        sight = state["point"][point] - state["pose"][photo, 9:]
        d = sight / np.linalg.norm(sight, axis=1)[:, None]
        for i in range(3):
            for j in range(3):
                across = float(i == j) - d[:, i] * d[:, j]
                own[:, i, j] += np.bincount(point, weights=across, minlength=len(own))
    least = np.linalg.eigvalsh(own)[:, 0]
    found = np.flatnonzero(by_cameras & (least < NARROW))
    names = equations.unknowns["point"].names
    return [names[i] for i in found.tolist()]


def _curved(block: Block) -> bool:
    """Return whether partials by points depend on where these are."""
    return block.lens is not None or (not block.prior and observation_kind(block.kind).curved)

"""Doubtful points: vague, at infinity or at a camera, of narrow rays, or with exchanged names.

Vague points. If three standard deviations of a point reach the farthest station, or photo, they
reach infinity too. Partials at its assumed position are valid for no other; adjustments with it
hardly converge, and right readings beside it seem wrong.

Points at infinity. Rays of a wrong image point meet nowhere ahead of their cameras. vᵀPv may then
decrease without end as the point moves away, or towards the projection centre of the wrong one,
where it has every direction: there is no minimum at a finite distance.

Exchanged points. Where two names are exchanged in all readings, nothing contradicts: the network
fits, and each point is where the other one is. Only given approximate coordinates reveal it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..errors import known
from ..graph.equations import Equations
from ..graph.variables import State
from ..types import Array, Index
from .elimination_layers import Layers, first_point
from .linearised_equations import LinearisedEquations
from .solution import Solution

CONFIDENCE_SIGMAS = 3.0
"""Number of standard deviations of a point within which it may be."""


MIN_RAY_EIGENVALUE = 1e-4
"""1 − cos 0.8°: rays with a smaller angle make adjustments of blocks of photos converge slowly."""

VAGUE_ROWS_AT_ONCE = 100_000
"""Number of observations that are processed at once."""
MIN_EXCHANGE_MOVEMENT_RATIO = 10.0
"""Smallest movement of such a point, and distance between two of them, relative to the median of
the movements of all points from their given coordinates."""
MAX_EXCHANGE_DISTANCE_RATIO = 0.1
"""Largest distance of a point from the other's given coordinates, relative to its movement."""
MIN_GIVEN_POINTS = 5
"""Smallest number of points with given coordinates whose median measures the quality of these."""
MAX_POINTS_COMPARED = 1000
"""Largest number of points that moved far and are compared with one another."""
INFINITE_DISTANCE_RATIO, ZERO_DISTANCE_RATIO = 1e3, 1e-3
"""Distances of a point from a photo, relative to the median of all image points, above and below
which it counts as infinitely far away, and as being at the projection centre."""
MAX_POINTS_IN_MESSAGE = 5
"""Largest number of points that a reason names of each."""


@dataclass(frozen=True)
class VaguePoint:
    """A point that may be anywhere."""

    name: str
    """Its name."""
    sigma: float
    """Largest standard deviation with everything else held, metres."""
    sight: float
    """Its farthest sight, metres."""

    def __str__(self) -> str:
        """Return the message."""
        if not math.isfinite(self.sigma):
            return (
                f"point {self.name!r} may be anywhere: its observations leave a direction "
                f"undetermined even with all else held, its farthest sight is {self.sight:.3g} m"
            )
        return (
            f"point {self.name!r} may be anywhere: its standard deviation is {self.sigma:.3g} m "
            f"even with all else held, its farthest sight {self.sight:.3g} m"
        )


def vague_points(solution: Solution) -> list[VaguePoint]:
    """Return the points with 3/√λ ≥ s: λ least eigenvalue of N_pp, s farthest sight.

    N_pp is the block of AᵀPA of the point alone: how well the datum is known, or other points,
    does not matter. Neither does a direction of which readings with constant partials (weights,
    control, GNSS vectors, levelling) say most; and partials across a sight change with its
    length only. Correlations between observations are not counted.

    Args:
        solution: of what is to enter.
    """
    return vague_points_at(solution.normal().system)


def vague_points_at(system: LinearisedEquations) -> list[VaguePoint]:
    """Return the points that may be anywhere, where a network has been linearised."""
    equations, state = system.equations, system.state
    points = equations.unknowns["point"]
    where = {"point": state["point"], "pose": state["pose"][:, 9:]}
    every, constant = np.zeros((2, len(points.names), 3, 3))
    far = np.zeros(len(points.names))
    for place, linear in enumerate(system.blocks):
        block = linear.block
        curved = block.curved
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
        for begin in range(0, block.n, VAGUE_ROWS_AT_ONCE):
            rows = np.arange(begin, min(begin + VAGUE_ROWS_AT_ONCE, block.n))
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
    vague = (
        points.free.any(axis=1)
        & (far * np.sqrt(least) <= CONFIDENCE_SIGMAS)
        & (given <= 0.5 * least)
    )
    return [
        VaguePoint(points.names[i], float(1.0 / np.sqrt(least[i])) if least[i] else np.inf, far[i])
        for i in np.flatnonzero(vague & (far > 0)).tolist()
    ]


def points_with_narrow_rays(equations: Equations, state: State, layers: Layers) -> list[str]:
    """Return the points that only cameras see, with rays that are nearly parallel.

    The least eigenvalue of Σ(I − d dᵀ) over the directions d of the rays of a point, 1 − cos of
    their angle for two of them, is below `MIN_RAY_EIGENVALUE`. An adjustment in which photos move
    too converges slowly along such rays, in tens of iterations.

    Args:
        equations: the network.
        state: its values.
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
        (_, photo), _, (_, point), *_ = block.variables
        sight = state["point"][point] - state["pose"][photo, 9:]
        d = sight / np.linalg.norm(sight, axis=1)[:, None]
        for i in range(3):
            for j in range(3):
                across = float(i == j) - d[:, i] * d[:, j]
                own[:, i, j] += np.bincount(point, weights=across, minlength=len(own))
    least = np.linalg.eigvalsh(own)[:, 0]
    found = np.flatnonzero(by_cameras & (least < MIN_RAY_EIGENVALUE))
    names = equations.unknowns["point"].names
    return [names[i] for i in found.tolist()]


def describe_exchanged_points(equations: Equations, state: State) -> tuple[str, ...]:
    """Return a sentence for each ring of points that lie at one another's given coordinates.

    Point p lies at the given coordinates of q if
    |x_p − x_q⁰| ≤ `MAX_EXCHANGE_DISTANCE_RATIO` |x_p − x_p⁰|.

    Args:
        equations: the network.
        state: its values at the end of the adjustment.
    """
    table = equations.unknowns["point"]
    loose = table.free.all(axis=1) & ~np.isfinite(table.sigma).any(axis=1)
    known = np.flatnonzero(loose & np.isfinite(table.values).all(axis=1))
    if len(known) < MIN_GIVEN_POINTS:
        return ()
    given, at = table.values[known], state["point"][known]
    moved = np.linalg.norm(at - given, axis=1)
    least = MIN_EXCHANGE_MOVEMENT_RATIO * float(np.median(moved))
    far = np.flatnonzero(moved > least)
    if not 2 <= len(far) <= MAX_POINTS_COMPARED:
        return ()
    apart = np.linalg.norm(at[far][:, None] - given[far], axis=2)
    nearest = apart.argmin(axis=1)
    close = apart[np.arange(len(far)), nearest] <= MAX_EXCHANGE_DISTANCE_RATIO * moved[far]
    names = [table.names[i] for i in known[far].tolist()]
    return tuple(_sentence([names[i] for i in ring]) for ring in _rings(nearest, close))


def _rings(nearest: Index, close: Array) -> list[list[int]]:
    """Return the rings p → nearest(p) → … → p of two and more."""
    out: list[list[int]] = []
    seen: set[int] = set()
    for first in range(len(nearest)):
        ring, here = [], first
        while close[here] and here not in ring:
            ring.append(here)
            here = int(nearest[here])
        if len(ring) > 1 and here == first and not seen & set(ring):
            out.append(ring)
        seen |= set(ring)
    return out


def _sentence(names: list[str]) -> str:
    ring = f"{', '.join(map(repr, names[:-1]))} and {names[-1]!r}"
    return (
        f"points {ring} lie at one another's given coordinates: their names may be exchanged in "
        "all readings"
    )


def describe_runaway_points(equations: Equations, state: State) -> str:
    """Return in words which points have run to infinity or to a camera; empty: none has.

    Args:
        equations: the network.
        state: values of all variables where an iteration ended.
    """
    rays = []
    for block in equations.blocks:
        if block.lens is not None:
            photo, point = block.variables[0][1], block.variables[2][1]
            sight = state["point"][point] - state["pose"][photo, 9:]
            rays.append((photo, point, np.linalg.norm(sight, axis=1)))
    if not rays:
        return ""
    photo, point, distance = (np.concatenate(x) for x in zip(*rays, strict=True))
    ratio = distance / np.median(distance)
    nearest = np.full(len(state["point"]), np.inf)
    np.minimum.at(nearest, point, ratio)
    seen = np.isfinite(nearest)
    points, photos = equations.unknowns["point"].names, equations.unknowns["pose"].names
    far = [points[i] for i in np.flatnonzero(seen & (nearest > INFINITE_DISTANCE_RATIO)).tolist()]
    at = np.flatnonzero(ratio < ZERO_DISTANCE_RATIO)
    near = [
        f"{points[p]} at that of photo {photos[f]}"
        for p, f in zip(point[at].tolist(), photo[at].tolist(), strict=True)
    ]
    parts = []
    if far:
        parts.append(f"points at infinity: {known(far, most=MAX_POINTS_IN_MESSAGE)}")
    if near:
        parts.append(f"points at projection centres: {known(near, most=MAX_POINTS_IN_MESSAGE)}")
    if not parts:
        return ""
    return (
        f"{'; '.join(parts)}; their rays meet nowhere ahead of the cameras, so that vᵀPv has no "
        "minimum with them: data snooping (adjust --snoop, fga.snoop) finds wrong image points"
    )

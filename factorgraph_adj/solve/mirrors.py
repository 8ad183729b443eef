"""Points that fit as well on the other side of the plane or line of their stations.

Distances from stations in a plane, or in plan from stations on a line, are the same at the mirror
image of their point. A minimum of vᵀPv lies at both places, and only a start says which one is
found. The image of each point is judged by its own observations, all else where it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..observations import KINDS
from ..types import Array, Index, Mask

FLAT = 0.1
"""Largest spread of stations across their plane, relative to the distance of the point from it."""
MISFIT = 100.0
"""Increase of vᵀPv at the image up to which an adjustment from there is worth while."""


def mirror_midpoints(equations: Equations, state: State, candidates: Mask) -> dict[int, Array]:
    """Return the midpoints between points and their mirror images that fit nearly as well.

    An image fits nearly as well if vᵀPv of the observations of its point grows by less than
    `MISFIT`. The image is twice the midpoint less the point; midpoints are (3,), metres, by the
    number of the point.

    Args:
        equations: a network.
        state: where it is at rest.
        candidates: which points may have images, (points,).
    """
    out: dict[int, Array] = {}
    before: Array | None = None
    for middles, some in _middles(equations, state, candidates):
        if not some.any():
            continue
        if before is None:
            before = _squares(equations, state)
        there = _own_squares(equations, state, 2.0 * middles - state["point"], some, before)
        for n in np.flatnonzero(some & (there < before + MISFIT)).tolist():
            out.setdefault(n, middles[n])
    return out


def _curved(equations: Equations) -> list[Block]:
    """Return the observations of which partials depend on where points are; rays are none."""
    return [
        b
        for place, b in enumerate(equations.blocks)
        if place not in equations.rays and b.kind in KINDS and not b.prior and KINDS[b.kind].curved
    ]


def _middles(equations: Equations, state: State, candidates: Mask) -> Iterator[tuple[Array, Mask]]:
    """Yield middles between points and images (points, 3), and which points have such an image.

    The plane lies through the stations, upright or as they lie; coordinates that are held stay.
    """
    points, free = state["point"], equations.unknowns["point"].free
    n = len(points)
    number, sums, squares = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))
    for block in _curved(equations):
        ends = [index for kind, index in block.variables if kind == "point"]
        for own in ends:
            for other in ends:
                on = np.flatnonzero(candidates[own]) if own is not other else own[:0]
                sight = points[other[on]] - points[own[on]]
                np.add.at(number, own[on], 1.0)
                np.add.at(sums, own[on], sight)
                np.add.at(squares, own[on], sight[:, :, None] * sight[:, None, :])
    some = candidates & (number > 1.0)
    numbers = np.flatnonzero(some)
    if not len(numbers):
        return
    mean = sums[numbers] / number[numbers, None]
    spread = squares[numbers] / number[numbers, None, None]
    spread = spread - mean[:, :, None] * mean[:, None, :]
    up = equations.network.frame.basis(points[numbers], np.zeros((len(numbers), 2))).enu[:, 2]
    for upright in (False, True):
        held = np.einsum("ni,ij->nij", ~free[numbers], np.eye(3))
        if upright:
            held = held + up[:, :, None] * up[:, None, :]
        across = np.eye(3) - np.linalg.pinv(held) @ held
        big = 1.0 + np.trace(spread, axis1=1, axis2=2)
        within = across @ spread @ across + big[:, None, None] * (np.eye(3) - across)
        values, vectors = np.linalg.eigh(within)
        normal = vectors[:, :, 0]
        height = np.sum(normal * mean, axis=1)
        flat = np.sqrt(np.maximum(values[:, 0], 0.0)) < FLAT * np.abs(height)
        middles, found = points.copy(), np.zeros(n, dtype=bool)
        middles[numbers] += height[:, None] * normal
        found[numbers] = flat
        yield middles, found


def _squares(equations: Equations, state: State) -> Array:
    """Return vᵀPv of the observations of every point, (points,); see `_own_squares`."""
    out = np.zeros(len(state["point"]))
    for place, block in enumerate(equations.blocks):
        ends = [index for kind, index in block.variables if kind == "point"]
        if place in equations.rays or not ends:
            continue
        v = block.evaluate(equations.network.frame, state, jacobians=False).residual
        squares = np.sum(block.whiten(v) ** 2, axis=1)
        for index in ends:
            np.add.at(out, index, squares)
    return out


def _own_squares(
    equations: Equations, state: State, places: Array, some: Mask, before: Array
) -> Array:
    """Return vᵀPv of the observations of points, each alone at its place, (points,).

    Correlations between observations are not counted; infinite: no value there. A point of which
    vᵀPv has grown by `MISFIT` needs no further observations.
    """
    n = len(some)
    out = np.zeros(n)
    both = {**state, "point": np.concatenate([state["point"], places])}
    for place, block in enumerate(equations.blocks):
        if place in equations.rays:
            continue
        for j, (kind, index) in enumerate(block.variables):
            if kind != "point":
                continue
            fitting = some & (out < before + MISFIT)
            rows: Index = np.flatnonzero(fitting[index])
            if not len(rows):
                continue
            part = block.select(rows)
            variables = list(part.variables)
            variables[j] = ("point", part.variables[j][1] + n)
            part = replace(part, variables=tuple(variables))
            try:
                v = part.evaluate(equations.network.frame, both, jacobians=False).residual
            except InputError:  # a sight without length, for instance
                out[index[rows]] = np.inf
                continue
            np.add.at(out, index[rows], np.sum(part.whiten(v) ** 2, axis=1))
    return out

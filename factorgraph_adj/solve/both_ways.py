"""The look both ways where an adjustment ended in a place between two.

Where observations are symmetric about a plane through a point, as slope distances from stations of
one height are, vᵀPv has no gradient across the plane: its partial derivatives are zero, and
Gauss-Newton steps stay in it, even if vᵀPv is smaller on both sides. A weak weight may then stand
for what determines the point. Such a point has a direction in which N is much weaker than in
another. At the end, vᵀPv is computed at points moved to both sides along it; where it decreases,
the adjustment goes on from there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..graph.variables import State
from ..types import Array, Index, Mask
from .datum import middle
from .iterate import Ended
from .linear_block import LinearBlock
from .normal import NormalEquations
from .run import Run

WEAK = 1e-6
"""Smallest eigenvalue of N of a point, relative to its largest, below which both sides of the point
are looked at: its σ are then in a ratio of 1000."""
WAYS = tuple(10.0**-k for k in range(6))
"""Distances at which vᵀPv is computed, relative to the extent of the network."""
LOWER, ROUNDING = 1e-6, 1e-9
"""Decrease of vᵀPv from which a place counts as better, and more of it relative to vᵀPv."""
EQUAL = 1.0
"""Difference of vᵀPv up to which two places fit equally well: one observation moved by one σ."""
APART = 3.0
"""Distance of two places, in units of their σ without the others, from which they are two."""
TIMES = 5
"""Largest number of times that an adjustment goes on."""


@dataclass(frozen=True)
class Weakest:
    """Points, each with the direction in which it is determined most weakly."""

    points: Index
    """Numbers of the points, (n,)."""
    directions: Array
    """Unit vectors, (n, 3)."""


def look_both_ways(
    run: Run, ended: Ended, go_on: Callable[[int], Ended]
) -> tuple[Ended, tuple[str, ...]]:
    """Go on from a place between two; ``run.state`` is the better place, or the one that it was.

    Args:
        run: an adjustment at rest.
        ended: how it ended.
        go_on: function that iterates from ``run.state`` after a number of iterations.

    Returns:
        How it ended at last, and what is to be told of points that fit as well elsewhere.
    """
    told: list[str] = []
    for _ in range(TIMES):
        if run.at_solution is None and not _candidates(run).any():
            break
        normal = run.at_solution or run.normal_at(run.state)
        run.at_solution = normal
        weakest = _weakest(normal, _candidates(run))
        better = _better(run, weakest, ended.vtpv)
        if better is None:
            break
        saddle, number = run.state, better[1]
        run.state, run.at_solution = better[0], None
        ended = go_on(ended.iterations)
        if not ended.converged:
            break
        told += _other_place(run, ended, saddle, number, go_on)
    return ended, tuple(told)


def _candidates(run: Run) -> Mask:
    """Return which points have unknown coordinates and are in no photo, (points,)."""
    equations = run.equations
    table = equations.unknowns["point"]
    out = np.asarray(table.offset >= 0)
    for place in equations.rays:
        out[equations.blocks[place].variables[2][1]] = False
    return np.asarray(out & (table.free.sum(axis=1) > 1))


def _weakest(normal: NormalEquations, candidates: Mask) -> Weakest:
    """Return the points that are determined in one direction much worse than in another."""
    table = normal.solver.equations.unknowns["point"]
    blocks = np.zeros((len(table.offset), 3, 3))
    for lb in normal.system.blocks:
        if not isinstance(lb, LinearBlock):
            continue
        for (kind, index), a in zip(lb.block.variables, lb.a, strict=True):
            if kind == "point" and len(a):
                np.add.at(blocks, index, np.einsum("ndi,ndj->nij", a, a))
    numbers = np.flatnonzero(candidates)
    some = blocks[numbers]
    # A held component, of which row and column are zero, is no weak direction.
    which, axis = np.nonzero(~table.free[numbers])
    some[which, axis, axis] = np.trace(some, axis1=1, axis2=2)[which]
    values, vectors = np.linalg.eigh(some)
    weak = values[:, 0] < WEAK * values[:, -1]
    return Weakest(numbers[weak], vectors[weak, :, 0])


def _better(run: Run, weakest: Weakest, vtpv: float) -> tuple[State, int] | None:
    """Return a state with a smaller vᵀPv and the number of the point that moved; none: no better.

    All points move at once, and each is judged by its own observations; the best is tried alone.
    """
    if not len(weakest.points):
        return None
    extent = middle(run.state)[1]
    before = _shares(run, run.state)[weakest.points]
    best: list[tuple[float, int, float]] = []
    for way in WAYS:
        for sign in (1.0, -1.0):
            change = _shares(run, _moved(run.state, weakest, sign * way * extent))
            gain = before - change[weakest.points]
            i = int(np.argmax(gain))
            best.append((float(gain[i]), i, sign * way * extent))
    enough = LOWER + ROUNDING * vtpv
    for most, i, way in sorted(best, reverse=True)[: len(WAYS)]:
        if not most > enough:
            break
        one = Weakest(weakest.points[[i]], weakest.directions[[i]])
        state = _moved(run.state, one, way)
        if run.vtpv(state) < vtpv - enough:
            return state, int(one.points[0])
    return None


def _moved(state: State, weakest: Weakest, way: float) -> State:
    points = state["point"].copy()
    points[weakest.points] += way * weakest.directions
    return {**state, "point": points}


def _shares(run: Run, state: State) -> Array:
    """Return vᵀPv of the observations that touch each point, (points,); infinite: none."""
    equations = run.equations
    out = np.zeros(len(state["point"]))
    if not np.isfinite(run.vtpv(state)):
        return np.full(len(out), np.inf)
    v = equations.residuals(state)
    for block in equations.blocks:
        square = np.sum(v[block.rows].reshape(-1, block.dimension) ** 2, axis=1)
        for kind, index in block.variables:
            if kind == "point":
                np.add.at(out, index, square)
    return out


def _other_place(
    run: Run, ended: Ended, saddle: State, number: int, go_on: Callable[[int], Ended]
) -> list[str]:
    """Adjust from the other side of the place between, and tell if the point fits there too."""
    here, at_solution = run.state, run.at_solution
    points = here["point"].copy()
    points[number] = 2.0 * saddle["point"][number] - points[number]
    run.state = {**here, "point": points}
    other = go_on(ended.iterations)
    there = run.state
    enough = LOWER + ROUNDING * ended.vtpv
    lower = other.converged and other.vtpv < ended.vtpv - enough
    equal = other.converged and abs(other.vtpv - ended.vtpv) < EQUAL
    run.state, run.at_solution = (there, run.at_solution) if lower else (here, at_solution)
    kept, left = (there, here) if lower else (here, there)
    apart = np.abs(kept["point"][number] - left["point"][number])
    normal = run.at_solution or run.normal_at(run.state)
    run.at_solution = normal
    table = run.equations.unknowns["point"]
    precise = np.sqrt(normal.diagonal[table.offset[number] + np.arange(3)])
    if not (equal and precise @ apart > APART):
        return []
    at = ", ".join(f"{x:.4f}" for x in left["point"][number])
    return [f"point {table.names[number]!r} fits equally well at {at}"]

"""Points that fit at two places: mirror ambiguities, and places between the two.

Where observations are symmetric about a plane through a point, as slope distances from stations of
one height are, vᵀPv has no gradient across the plane: its partial derivatives are zero, and
Gauss-Newton steps stay in it, even if vᵀPv is smaller on both sides. A weak weight may then stand
for what determines the point. Such a point has a direction in which N is much weaker than in
another. At the end, vᵀPv is computed at points moved to both sides along it; where it decreases,
the adjustment goes on from there.

Points whose stations lie in a plane, or in plan on a line, are adjusted from their mirror images
too. What fits equally well at another place is told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import AdjustmentError
from ..graph.equations import Equations
from ..graph.variables import State
from ..types import Array, Index, Mask
from .datum import middle
from .iterate import Ended
from .linear import ExtraRows, LinearisedEquations
from .linear_block import LinearBlock
from .mirrors import mirror_midpoints
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
TIMES = 20
"""Largest number of times that an adjustment goes on; all points that may move do so at once."""
EXAMINED = 20
"""Largest number of points of which the other side is examined one by one."""
MOST_THERE = 100
"""Largest number of iterations on the other side."""
BETWEEN = "a point is between two places, and vᵀPv decreases to both sides"
"""Reason of an adjustment that still finds such points after `TIMES`."""


@dataclass(frozen=True)
class Weakest:
    """Points, each with the direction in which it is determined most weakly."""

    points: Index
    """Numbers of the points, (n,)."""
    directions: Array
    """Unit vectors, (n, 3)."""


def resolve_ambiguous_points(
    run: Run, ended: Ended, go_on: Callable[[Run, int], Ended], examine: Callable[[Run], Ended]
) -> tuple[Ended, tuple[str, ...]]:
    """Move points to the better of two places that fit, and say which of them fit at both.

    ``run.state`` and ``run.at_solution`` become those of the place that was chosen.

    Args:
        run: an adjustment at rest.
        ended: how it ended.
        go_on: function that iterates from ``run.state`` after a number of iterations.
        examine: function that iterates from another state, with iterations of its own.

    Returns:
        How it ended at last, and what is to be told of points that fit as well elsewhere.
    """
    between: dict[int, Array] = {}
    candidates = standing_free(run.equations)
    for _ in range(TIMES):
        if not candidates.any():
            break
        normal = run.at_solution or run.normal_at(run.state)
        run.at_solution = normal
        better = better_place(run, normal, candidates, ended.vtpv)
        if better is None:
            break
        between |= {number: run.state["point"][number] for number in better[1]}
        run.state, run.at_solution = better[0], None
        ended = go_on(run, ended.iterations)
        if not ended.converged:
            return ended, ()
    else:
        return replace(ended, converged=False, reason=BETWEEN, left=np.inf), ()
    candidates = standing_free(run.equations)
    between = mirror_midpoints(run.equations, run.state, candidates) | between
    ended, told = _second_places(run, ended, between, examine)
    return ended, tuple(told)


def standing_free(equations: Equations) -> Mask:
    """Return which points have unknown coordinates and are in no photo, (points,)."""
    table = equations.unknowns["point"]
    out = np.asarray(table.offset >= 0)
    for place in equations.rays:
        out[equations.blocks[place].variables[2][1]] = False
    return np.asarray(out & (table.free.sum(axis=1) > 1))


def weakest_directions(system: LinearisedEquations, candidates: Mask) -> Weakest:
    """Return the points that are determined in one direction much worse than in another.

    Args:
        system: a network, linearised at rest.
        candidates: which points are looked at, (points,).
    """
    table = system.unknowns["point"]
    blocks = np.zeros((len(table.offset), 3, 3))
    for lb in system.blocks:
        if not isinstance(lb, LinearBlock):
            continue
        for (kind, index), a in zip(lb.block.variables, lb.a, strict=True):
            if kind == "point" and len(a):
                np.add.at(blocks, index, np.einsum("ndi,ndj->nij", a, a))
    for e in system.extra:
        for number in _touched(system.equations, e):
            # Columns stand in the order of the factor's keys, those of a point together.
            a = e.a[:, int(np.argmax(e.columns == table.offset[number])) + np.arange(3)]
            blocks[number] += a.T @ a
    numbers = np.flatnonzero(candidates)
    some = blocks[numbers]
    # A held component, of which row and column are zero, is no weak direction.
    which, axis = np.nonzero(~table.free[numbers])
    some[which, axis, axis] = np.trace(some, axis1=1, axis2=2)[which]
    values, vectors = np.linalg.eigh(some)
    weak = values[:, 0] < WEAK * values[:, -1]
    return Weakest(numbers[weak], vectors[weak, :, 0])


def _touched(equations: Equations, e: ExtraRows) -> list[int]:
    """Return the numbers of the points that rows of a user's factor touch."""
    offset = equations.unknowns["point"].offset
    return np.flatnonzero((offset >= 0) & np.isin(offset, e.columns)).tolist()


def better_place(
    run: Run, normal: NormalEquations, candidates: Mask, vtpv: float
) -> tuple[State, list[int]] | None:
    """Return a state with a smaller vᵀPv and the points that moved; none: there is none.

    All points move at once, and each is judged by its own observations. Those that gain go to
    their best places together; where that is no gain, as points observe each other, the best one
    goes alone.

    Args:
        run: an adjustment at rest.
        normal: its normal equations.
        candidates: which points may move, (points,).
        vtpv: vᵀPv at rest.
    """
    weakest = weakest_directions(normal.system, candidates)
    if not len(weakest.points):
        return None
    extent = middle(run.state)[1]
    before = _shares(run, run.state)[weakest.points]
    ways = np.array([sign * way * extent for way in WAYS for sign in (1.0, -1.0)])
    gains = np.array(
        [before - _shares(run, _moved(run.state, weakest, way))[weakest.points] for way in ways]
    )
    best, gain = ways[np.argmax(gains, axis=0)], np.max(gains, axis=0)
    enough = LOWER + ROUNDING * vtpv
    order = np.argsort(-gain)
    order = order[gain[order] > enough]
    for some in (order, order[:1]):
        if not len(some):
            break
        those = Weakest(weakest.points[some], weakest.directions[some])
        state = _moved(run.state, those, best[some])
        if run.vtpv(state) < vtpv - enough:
            return state, those.points.tolist()
    return None


def _moved(state: State, weakest: Weakest, way: Array | float) -> State:
    """Return a state with points moved along their directions by ways in metres, (n,) or one."""
    points = state["point"].copy()
    points[weakest.points] += np.reshape(way, (-1, 1)) * weakest.directions
    return {**state, "point": points}


def _shares(run: Run, state: State) -> Array:
    """Return vᵀPv of the observations that touch each point, (points,); infinite: none."""
    equations = run.equations
    out = np.zeros(len(state["point"]))
    if not np.isfinite(run.vtpv(state)):
        return np.full(len(out), np.inf)
    assert run.last is not None  # what `vtpv` has just evaluated
    v = equations.residuals(state, evaluated=run.last[1])
    for block in equations.blocks:
        square = np.sum(v[block.rows].reshape(-1, block.dimension) ** 2, axis=1)
        for kind, index in block.variables:
            if kind == "point":
                np.add.at(out, index, square)
    for e in run.extra.at(equations, state).rows:
        out[_touched(equations, e)] += float(e.residual @ e.residual)
    return out


def _second_places(
    run: Run, ended: Ended, between: dict[int, Array], examine: Callable[[Run], Ended]
) -> tuple[Ended, list[str]]:
    """Adjust from the other sides, and tell which points fit there too; take a side if better.

    All points go to their other sides together; unless that fits as well, one by one.
    """
    numbers = list(between)
    together = _from_other_side(run, between, numbers, examine) if numbers else None
    if together is not None:
        return _compared(run, ended, numbers, together)
    told: list[str] = []
    for n in numbers[:EXAMINED] if len(numbers) > 1 else []:
        found = _from_other_side(run, between, [n], examine)
        if found is not None:
            ended, more = _compared(run, ended, [n], found)
            told += more
    if len(numbers) > EXAMINED:
        told.append(f"the other sides of {len(numbers) - EXAMINED} more points were not examined")
    return ended, told


def _compared(
    run: Run, ended: Ended, numbers: list[int], other: tuple[Ended, State]
) -> tuple[Ended, list[str]]:
    """Take the better of two states, and tell of the points that fit as well at the other."""
    there, left = other
    equal = abs(there.vtpv - ended.vtpv) < EQUAL
    if there.vtpv < ended.vtpv - LOWER - ROUNDING * ended.vtpv:
        run.state, left, run.at_solution = left, run.state, None
        ended = replace(there, iterations=ended.iterations)
    if not equal:
        return ended, []
    table = run.equations.unknowns["point"]
    normal = run.at_solution or run.normal_at(run.state)
    run.at_solution = normal
    told = []
    for n in numbers:
        apart = np.abs(run.state["point"][n] - left["point"][n])
        precise = np.sqrt(normal.diagonal[table.offset[n] + np.arange(3)])
        if precise @ apart > APART:
            at = ", ".join(f"{x:.4f}" for x in left["point"][n])
            told.append(f"point {table.names[n]!r} fits equally well at {at}")
    return ended, told


def _from_other_side(
    run: Run, between: dict[int, Array], numbers: list[int], examine: Callable[[Run], Ended]
) -> tuple[Ended, State] | None:
    """Return where an adjustment ends from the other side of points; none: it does not fit there.

    A run of its own does it, so that the solution stays what it is.
    """
    points = run.state["point"].copy()
    for n in numbers:
        points[n] = 2.0 * between[n] - points[n]
    here = run.vtpv(run.state)
    other = replace(run, state={**run.state, "point": points}, at_solution=None, last=None)
    try:
        ended = examine(other)
    except AdjustmentError:  # a sight has no direction there, or something is not determined
        return None
    if not ended.converged or ended.vtpv > here + EQUAL:
        return None
    return ended, other.state

"""Second minima: points at better or equal places, mirror images; given values if a start fails.

Where observations are symmetric about a plane through a point, as slope distances from stations of
one height are, vᵀPv has no gradient across the plane: its partial derivatives are zero, and
Gauss-Newton steps stay in it, even if vᵀPv is smaller on both sides. A weak weight may then be all
that determines the point. Such a point has a direction in which N is much weaker than in another.
After convergence, vᵀPv is computed at points moved to both sides along it; where it decreases, the
adjustment continues from there.

Distances from stations in a plane, or in plan from stations on a line, are the same at the mirror
image of their point. A minimum of vᵀPv lies at both places, and only a start decides which one is
found. The image of each point is judged by its own observations, all else where it is; points whose
image fits are adjusted from there too, and the solution reports what fits equally well.

A start that replaces given values may lead to no minimum; the given values are then tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..errors import AdjustmentError, DatumError, InputError
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..start.start_values import Start
from ..types import Array, Index, Mask
from .adjustment_run import AdjustmentRun
from .datum_defects import extent_of
from .gauss_newton import IterationEnd
from .linearised_equations import ExtraRows, LinearBlock, LinearisedEquations
from .normal_equations import NormalEquations
from .solution import Solution

MAX_STATION_SPREAD_RATIO = 0.1
"""Largest spread of stations across their plane, relative to the distance of the point from it."""
MAX_EXCESS = 100.0
"""Increase of vᵀPv at the image up to which an adjustment from there is worth while."""
WEAK_EIGENVALUE_RATIO = 1e-6
"""Smallest eigenvalue of N of a point, relative to its largest, below which both sides of the point
are examined: its σ are then in a ratio of 1000."""
TRIAL_DISTANCES = tuple(10.0**-k for k in range(6))
"""Distances at which vᵀPv is computed, relative to the extent of the network."""
MIN_VTPV_DECREASE, MIN_VTPV_DECREASE_RATIO = 1e-6, 1e-9
"""Decrease of vᵀPv from which a place counts as better, and more of it relative to vᵀPv."""
MAX_EQUAL_VTPV_DIFFERENCE = 1.0
"""Difference of vᵀPv up to which two places fit equally well: one observation moved by one σ."""
MIN_SEPARATION_SIGMAS = 3.0
"""Distance of two places, in units of their σ without the others, from which they are two."""
MAX_RESUMPTIONS = 20
"""Largest number of times that an adjustment continues; all points that may move do so at once."""
MAX_POINTS_EXAMINED = 20
"""Largest number of points of which the other side is examined one by one."""
MAX_OTHER_SIDE_ITERATIONS = 100
"""Largest number of iterations on the other side."""
BETWEEN_TWO_PLACES = "a point is between two places, and vᵀPv decreases to both sides"
"""Reason of an adjustment that still finds such points after `MAX_RESUMPTIONS`."""
REPEATED_FROM_GIVEN_VALUES = "{why}: it was repeated from the given poses and coordinates."
"""Sentence of a solution that began at the given values after all."""
NO_START_CONVERGED = "From the given poses and coordinates it did not converge either."
"""Sentence of a solution that began at the other start, where neither converged."""


def mirror_midpoints(equations: Equations, state: State, candidates: Mask) -> dict[int, Array]:
    """Return the midpoints between points and their mirror images that fit nearly as well.

    An image fits nearly as well if vᵀPv of the observations of its point grows by less than
    `MAX_EXCESS`. The image is twice the midpoint less the point; midpoints are (3,), metres, by the
    number of the point.

    Args:
        equations: a network.
        state: its converged values.
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
        for n in np.flatnonzero(some & (there < before + MAX_EXCESS)).tolist():
            out.setdefault(n, middles[n])
    return out


def _curved(equations: Equations) -> list[Block]:
    """Return the observations of which partials depend on where points are; rays are none."""
    return [b for b in equations.blocks if b.lens is None and b.curved]


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
        flat = np.sqrt(np.maximum(values[:, 0], 0.0)) < MAX_STATION_SPREAD_RATIO * np.abs(height)
        middles, found = points.copy(), np.zeros(n, dtype=bool)
        middles[numbers] += height[:, None] * normal
        found[numbers] = flat
        yield middles, found


def _squares(equations: Equations, state: State) -> Array:
    """Return vᵀPv of the observations of every point, (points,); see `_own_squares`."""
    out = np.zeros(len(state["point"]))
    for place, block in enumerate(equations.blocks):
        ends = [index for kind, index in block.variables if kind == "point"]
        if place in equations.images or not ends:
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
    vᵀPv has grown by `MAX_EXCESS` needs no further observations.
    """
    n = len(some)
    out = np.zeros(n)
    both = {**state, "point": np.concatenate([state["point"], places])}
    for place, block in enumerate(equations.blocks):
        if place in equations.images:
            continue
        for j, (kind, index) in enumerate(block.variables):
            if kind != "point":
                continue
            fitting = some & (out < before + MAX_EXCESS)
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


@dataclass(frozen=True)
class WeakDirections:
    """Points, each with the direction in which it is determined most weakly."""

    points: Index
    """Numbers of the points, (n,)."""
    directions: Array
    """Unit vectors, (n, 3)."""


def resolve_ambiguous_points(
    run: AdjustmentRun,
    ended: IterationEnd,
    go_on: Callable[[AdjustmentRun, int], IterationEnd],
    examine: Callable[[AdjustmentRun], IterationEnd],
) -> tuple[IterationEnd, tuple[str, ...]]:
    """Move points to the better of two places that fit, and say which of them fit at both.

    ``run.state`` and ``run.at_solution`` become those of the place that was chosen.

    Args:
        run: a converged adjustment.
        ended: how it ended.
        go_on: function that iterates from ``run.state`` after a number of iterations.
        examine: function that iterates from another state, with iterations of its own.

    Returns:
        How it ended at last, and sentences on points that fit as well elsewhere.
    """
    between: dict[int, Array] = {}
    candidates = points_without_rays(run.equations)
    for _ in range(MAX_RESUMPTIONS):
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
        return replace(ended, converged=False, reason=BETWEEN_TWO_PLACES, left=np.inf), ()
    candidates = points_without_rays(run.equations)
    between = mirror_midpoints(run.equations, run.state, candidates) | between
    ended, sentences = _second_places(run, ended, between, examine)
    return ended, tuple(sentences)


def points_without_rays(equations: Equations) -> Mask:
    """Return which points have unknown coordinates and are in no photo, (points,)."""
    table = equations.unknowns["point"]
    out = np.asarray(table.offset >= 0)
    for place in equations.images:
        out[equations.blocks[place].variables[2][1]] = False
    return np.asarray(out & (table.free.sum(axis=1) > 1))


def weakest_directions(system: LinearisedEquations, candidates: Mask) -> WeakDirections:
    """Return the points that are determined in one direction much worse than in another.

    Args:
        system: a converged network, linearised.
        candidates: which points are examined, (points,).
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
            # Columns are in the order of the factor's keys, those of a point together.
            a = e.a[:, int(np.argmax(e.columns == table.offset[number])) + np.arange(3)]
            blocks[number] += a.T @ a
    numbers = np.flatnonzero(candidates)
    some = blocks[numbers]
    # A held component, of which row and column are zero, is no weak direction.
    which, axis = np.nonzero(~table.free[numbers])
    some[which, axis, axis] = np.trace(some, axis1=1, axis2=2)[which]
    values, vectors = np.linalg.eigh(some)
    weak = values[:, 0] < WEAK_EIGENVALUE_RATIO * values[:, -1]
    return WeakDirections(numbers[weak], vectors[weak, :, 0])


def _touched(equations: Equations, e: ExtraRows) -> list[int]:
    """Return the numbers of the points that rows of a user's factor touch."""
    offset = equations.unknowns["point"].offset
    return np.flatnonzero((offset >= 0) & np.isin(offset, e.columns)).tolist()


def better_place(
    run: AdjustmentRun, normal: NormalEquations, candidates: Mask, vtpv: float
) -> tuple[State, list[int]] | None:
    """Return a state with a smaller vᵀPv and the points that moved; None: there is none.

    All points move at once, and each is judged by its own observations. Those that gain go to
    their best places together; where that is no gain, as points observe each other, the best one
    goes alone.

    Args:
        run: a converged adjustment.
        normal: its normal equations.
        candidates: which points may move, (points,).
        vtpv: its vᵀPv.
    """
    weakest = weakest_directions(normal.system, candidates)
    if not len(weakest.points):
        return None
    extent = extent_of(run.state)[1]
    before = _shares(run, run.state)[weakest.points]
    ways = np.array([sign * way * extent for way in TRIAL_DISTANCES for sign in (1.0, -1.0)])
    gains = np.array(
        [before - _shares(run, _moved(run.state, weakest, way))[weakest.points] for way in ways]
    )
    best, gain = ways[np.argmax(gains, axis=0)], np.max(gains, axis=0)
    enough = MIN_VTPV_DECREASE + MIN_VTPV_DECREASE_RATIO * vtpv
    order = np.argsort(-gain)
    order = order[gain[order] > enough]
    for some in (order, order[:1]):
        if not len(some):
            break
        those = WeakDirections(weakest.points[some], weakest.directions[some])
        state = _moved(run.state, those, best[some])
        if run.vtpv(state) < vtpv - enough:
            return state, those.points.tolist()
    return None


def _moved(state: State, weakest: WeakDirections, way: Array | float) -> State:
    """Return a state with points moved along their directions by ways in metres, (n,) or one."""
    points = state["point"].copy()
    points[weakest.points] += np.reshape(way, (-1, 1)) * weakest.directions
    return {**state, "point": points}


def _shares(run: AdjustmentRun, state: State) -> Array:
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
    run: AdjustmentRun,
    ended: IterationEnd,
    between: dict[int, Array],
    examine: Callable[[AdjustmentRun], IterationEnd],
) -> tuple[IterationEnd, list[str]]:
    """Adjust from the other sides, and report which points fit there too; take a side if better.

    All points go to their other sides together; unless that fits as well, one by one.
    """
    numbers = list(between)
    together = _from_other_side(run, between, numbers, examine) if numbers else None
    if together is not None:
        return _compared(run, ended, numbers, together)
    sentences: list[str] = []
    for n in numbers[:MAX_POINTS_EXAMINED] if len(numbers) > 1 else []:
        found = _from_other_side(run, between, [n], examine)
        if found is not None:
            ended, more = _compared(run, ended, [n], found)
            sentences += more
    if len(numbers) > MAX_POINTS_EXAMINED:
        sentences.append(
            f"the other sides of {len(numbers) - MAX_POINTS_EXAMINED} more points were not examined"
        )
    return ended, sentences


def _compared(
    run: AdjustmentRun, ended: IterationEnd, numbers: list[int], other: tuple[IterationEnd, State]
) -> tuple[IterationEnd, list[str]]:
    """Take the better of two states, and report the points that fit as well at the other."""
    there, left = other
    equal = abs(there.vtpv - ended.vtpv) < MAX_EQUAL_VTPV_DIFFERENCE
    if there.vtpv < ended.vtpv - MIN_VTPV_DECREASE - MIN_VTPV_DECREASE_RATIO * ended.vtpv:
        run.state, left, run.at_solution = left, run.state, None
        ended = replace(there, iterations=ended.iterations)
    if not equal:
        return ended, []
    table = run.equations.unknowns["point"]
    normal = run.at_solution or run.normal_at(run.state)
    run.at_solution = normal
    sentences = []
    for n in numbers:
        apart = np.abs(run.state["point"][n] - left["point"][n])
        precise = np.sqrt(normal.diagonal[table.offset[n] + np.arange(3)])
        if precise @ apart > MIN_SEPARATION_SIGMAS:
            at = ", ".join(f"{x:.4f}" for x in left["point"][n])
            sentences.append(f"point {table.names[n]!r} fits equally well at {at}")
    return ended, sentences


def _from_other_side(
    run: AdjustmentRun,
    between: dict[int, Array],
    numbers: list[int],
    examine: Callable[[AdjustmentRun], IterationEnd],
) -> tuple[IterationEnd, State] | None:
    """Return where an adjustment ends from the other side of points; None: it does not fit there.

    Another run does it, so that the solution remains unchanged.
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
    if not ended.converged or ended.vtpv > here + MAX_EQUAL_VTPV_DIFFERENCE:
        return None
    return ended, other.state


def adjustment_from_better_start(attempt: Callable[[Start], Solution], start: Start) -> Solution:
    """Return the adjustment from a start, or from the given values that the start has replaced.

    A start is chosen by robust costs, without an adjustment. If it does not converge, the given
    values are tried; what converges is returned, otherwise what has the smaller vᵀPv. The sentences
    on how the adjustment began say so.

    Args:
        attempt: adjusts from a start.
        start: the start; one that replaces no given values is tried alone.

    Raises:
        InputError, DatumError: the error of the first attempt, if the second one fails too.
    """
    if start.instead_of is None:
        return attempt(start)
    first: Solution | None = None
    failure: InputError | DatumError | None = None
    try:
        first = attempt(start)
        if first.converged:
            return first
        why = "The adjustment from there did not converge"
    except (InputError, DatumError) as error:
        failure, why = error, "The adjustment from there ended in an error"
    words = (*start.words, REPEATED_FROM_GIVEN_VALUES.format(why=why))
    given = Start(start.unknowns, start.instead_of, start.origin, words)
    try:
        second = attempt(given)
    except (InputError, DatumError):
        second = None
    if second is not None and (first is None or second.converged or second.vtpv < first.vtpv):
        return second
    if failure is not None:
        raise failure
    assert first is not None
    return replace(first, begun=(*first.begun, NO_START_CONVERGED))


def describe_other_minimum(ours: Solution, theirs: Solution) -> str:
    """Return a sentence on the minimum ``theirs``, seen from ``ours``.

    It has both vᵀPv, and the point whose places in the two are farthest apart.
    """
    message = f"another minimum has vᵀPv {theirs.vtpv:.6g} instead of {ours.vtpv:.6g}"
    unknowns, there = ours.equations.unknowns["point"], theirs.equations.unknowns["point"]
    names = [n for n in unknowns.names if n in there.number]
    if names:
        apart = [float(np.linalg.norm(ours.point(n) - theirs.point(n))) for n in names]
        name = names[int(np.argmax(apart))]
        at = ", ".join(f"{x:.4f}" for x in theirs.point(name))
        message += f", with point {name!r} at {at}, {max(apart):.3g} m away"
    return message

"""The iteration of a network in parts: normal equations summed in the root, damped steps, end.

The root adds the normal equations of all parts, reduced to their junctions, and solves them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..errors import DatumError, SingularError
from ..solve.block_matrix import BlockMatrix
from ..solve.convergence import Judgement, StepRecord
from ..solve.fronts import Fronts
from ..solve.gauss_newton import ITERATION, IterationEnd, Progress
from ..solve.gauss_newton_steps import Attempt, Damping, Step
from ..solve.normal_equations import MIN_CHOLESKY_PIVOT
from ..solve.reduced_system import DenseNormals
from ..types import Array, Index
from .junctions import IterationState, Junctions, ReducedEquations, RootPlaces, unpacked_triangle
from .tasks import eliminate_part, explain_part, step_part
from .workers import Workers

MAX_JUNCTIONS_IN_MESSAGE = 12
"""Largest number of junctions that a message names."""
MAX_SEARCHED_COLUMNS = 4000
"""Largest number of columns for which undetermined combinations are searched densely."""
MAX_NULL_EIGENVALUE = 1e-12
"""Eigenvalue of the scaled normal matrix below which a combination counts as undetermined."""
CONTROL_ADVICE = "give control (fixed or weighted coordinates), or observations that tie the parts"
"""What a user can do about undetermined junctions."""


class Root:
    """The summed normal equations of the junctions at one point of the iteration."""

    def __init__(self, junctions: Junctions, places: RootPlaces) -> None:
        """Begin with nothing."""
        self.junctions, self.places = junctions, places
        pattern, self._order = places.layout
        self.matrix = BlockMatrix.zeros(pattern)
        self.right: Array = np.zeros(junctions.n_columns)
        """Σs."""
        self.diagonal: Array = np.zeros(junctions.n_columns)
        """Diagonal of N of all parts."""
        self._fronts: Fronts | None = None

    def add(self, number: int, reduced: ReducedEquations) -> None:
        """Add the reduced normal equations of a part."""
        columns = self.junctions.columns[number]
        DenseNormals(columns, unpacked_triangle(reduced.normal)).add_to(self.places, self.matrix)
        np.add.at(self.right, columns, reduced.right)
        np.add.at(self.diagonal, columns, reduced.diagonal)

    def factorise(self, damping: float) -> float:
        """Factorise with λ diag(N) added; return the smallest pivot relative to diag(N).

        Raises:
            SingularError: the junctions are not determined.
        """
        m, places = self.matrix, self.places
        if damping > 0.0:
            places.add_diagonal(m, damping * self.diagonal)
        places.hold(m)
        self._fronts = Fronts.of(self._order, m)
        on = places.columns >= 0
        pivots = (self._fronts.pivots * self._fronts.diagonal)[on]
        whole = self.diagonal[places.columns[on]] * (1.0 + damping)
        return float(np.min(pivots / np.maximum(whole, np.finfo(float).tiny), initial=1.0))

    def solve(self) -> Array:
        """Return the movement of the junctions, (n_columns,)."""
        assert self._fronts is not None
        places = self.places
        y = np.zeros((len(places.columns), 1))
        on = places.columns >= 0
        y[on, 0] = -self.right[places.columns[on]]
        x = np.zeros(len(self.right))
        x[places.columns[on]] = self._fronts.solve(y)[on, 0]
        return x

    def covariances(self) -> JunctionCovariances:
        """Return the covariances of the junctions, for σ0 = 1."""
        assert self._fronts is not None
        return JunctionCovariances(self.places, self._fronts.inverse())

    def undetermined(self) -> tuple[int, list[str]]:
        """Return how many combinations are undetermined, and the junctions with a share in them.

        Large roots are not searched: then the number is 0 and the list is empty.
        """
        n = self.junctions.n_columns
        if n > MAX_SEARCHED_COLUMNS:
            return 0, []
        places = self.places
        at = places.place_of[np.arange(n)]
        whole = _dense_matrix(places, self.matrix)[np.ix_(at, at)]
        scale = 1.0 / np.sqrt(np.where(self.diagonal > 0, self.diagonal, 1.0))
        values, vectors = np.linalg.eigh(whole * scale[:, None] * scale)
        null = vectors[:, values < MAX_NULL_EIGENVALUE]
        share = np.sum(null**2, axis=1)
        order = np.argsort(-share, kind="stable")
        named = [
            self.junctions.name(int(i)) for i in order[:MAX_JUNCTIONS_IN_MESSAGE] if share[i] > 0.01
        ]
        return null.shape[1], named


class JunctionCovariances:
    """The covariances of all junctions, at least between those of one part."""

    def __init__(self, places: RootPlaces, inverse: BlockMatrix) -> None:
        """Take in the selected inverse of the root."""
        self._places, self._inverse = places, inverse

    def of(self, columns: Index) -> Array:
        """Return the covariances (m, m) of columns that one part has."""
        at = self._places.place_of[columns]
        i, j = np.tril_indices(len(at))
        out = np.zeros((len(at), len(at)))
        out[i, j] = out[j, i] = self._inverse.at(at[i], at[j])
        return out


class PartSums(NamedTuple):
    """Figures of all parts together."""

    vtpv: float
    """Value of vᵀPv."""
    smallest: float
    """Smallest pivot relative to its diagonal element of N."""
    resolution: float
    """Bound of a movement by one unit in the last digit of every value, relative to σ."""


def sum_of_parts(root: Root, parts: Iterable[tuple[int, ReducedEquations]]) -> PartSums:
    """Add the reduced normal equations of all parts.

    Raises:
        SingularError: the interior of a part is not determined.
    """
    vtpv, smallest, rounding, singular = 0.0, 1.0, 0.0, list[int]()
    for number, reduced in parts:
        if not reduced.smallest > 0.0:
            singular.append(number)
            continue
        root.add(number, reduced)
        vtpv += reduced.vtpv
        smallest = min(smallest, reduced.smallest)
        rounding += reduced.rounding
    if singular:
        raise SingularError("the interior of a part is not determined")
    return PartSums(vtpv, smallest, float(np.sqrt(rounding)))


def _dense_matrix(places: RootPlaces, m: BlockMatrix) -> Array:
    """Return the whole matrix of the root, dense."""
    n, w, side = places.n, places.width, places.side
    out = np.zeros((n, w, n, w))
    i = np.arange(n)
    out[i, :, i, :] = m.diagonal
    out[m.pattern.first, :, m.pattern.second, :] = m.pairs
    out[m.pattern.second, :, m.pattern.first, :] = m.pairs.transpose(0, 2, 1)
    whole = np.zeros((n * w + side,) * 2)
    whole[: n * w, : n * w] = out.reshape(n * w, n * w)
    across = m.side.reshape(n * w, side)
    whole[: n * w, n * w :], whole[n * w :, : n * w] = across, across.T
    whole[n * w :, n * w :] = m.corner
    return whole


@dataclass(frozen=True)
class IterationPoint:
    """How far an iteration has come; a killed run resumes from it."""

    state: int = 0
    """Number of the written state."""
    weights: int = 0
    """Number of the state whose lengths of sights give the standard deviations."""
    iterations: int = 0
    """Number of iterations."""
    last: float = float("inf")
    """Bound of the last step, relative to σ."""
    damping: Damping = field(default_factory=Damping)
    """The damping of the next step."""
    expecting: bool = False
    """Whether the last step is expected to have converged."""
    ended: IterationEnd | None = None
    """How the run ended converged; none: it goes on."""


@dataclass(frozen=True)
class WholeNetwork:
    """A network in parts."""

    workers: Workers
    """Where its parts are."""
    junctions: Junctions
    """The unknowns that several parts have."""
    places: RootPlaces
    """Their places in the root."""

    def eliminated(self, at: IterationState) -> tuple[Root, PartSums]:
        """Return the factorised root, and what it knows of all parts.

        Raises:
            SingularError: an unknown is not determined.
        """
        root = Root(self.junctions, self.places)
        parts = self.workers.each(eliminate_part, [(at,)] * len(self.workers.jobs))
        found = sum_of_parts(root, parts)
        return root, found._replace(smallest=min(found.smallest, root.factorise(at.damping)))

    def moved(self, at: IterationState, junctions: Array, to: int) -> tuple[Step, float]:
        """Return the step with a movement of the junctions, and vᵀPv after it."""
        arguments = [(at, junctions[columns], to) for columns in self.junctions.columns]
        found = self.workers.all(step_part, arguments)
        downhill = sum(m.downhill for m in found)
        decrease = downhill + sum(m.damped for m in found)
        step = Step(junctions, decrease, float(np.sqrt(max(downhill, 0.0))))
        return step, sum(m.vtpv for m in found)

    def explain(self, at: IterationState) -> None:
        """Raise an error that names undetermined unknowns, if there are any.

        Raises:
            DatumError: unknowns of parts are not determined by the part and its junctions, or the
                junctions are not determined by all parts.
        """
        self.workers.all(explain_part, [(at,)] * len(self.workers.jobs))
        root = Root(self.junctions, self.places)
        try:
            sum_of_parts(root, self.workers.each(eliminate_part, [(at,)] * len(self.workers.jobs)))
        except SingularError:
            raise DatumError("the network is not determined", defect=1) from None
        self.places.hold(root.matrix)
        n, names = root.undetermined()
        if n:
            listed = "".join(f"\n  {name}" for name in names)
            raise DatumError(
                f"the parts together leave {n} combination{'s' * (n > 1)} of their junctions "
                f"undetermined: {CONTROL_ADVICE}. Junctions concerned:{listed}",
                defect=n,
                names=names,
            )
        try:
            root.factorise(0.0)
        except SingularError:
            message = f"the parts together leave their junctions undetermined: {CONTROL_ADVICE}"
            raise DatumError(message, defect=1) from None


def iterate_parts(
    whole: WholeNetwork,
    begin: IterationPoint,
    *,
    tolerance: float,
    max_iterations: int,
    note: Callable[[IterationPoint], None],
    progress: Progress | None,
) -> tuple[IterationPoint, IterationEnd]:
    """Step until the unknowns have converged.

    Args:
        whole: the network.
        begin: where the iteration begins, or goes on.
        tolerance: bound on the last step of every unknown, relative to its own σ.
        max_iterations: largest number of iterations in all.
        note: called with the point after each step.
        progress: called after each iteration.

    Returns:
        The last point, and how the iteration ended.

    Raises:
        InputError: an observation cannot be computed.
        DatumError: the observations do not determine all unknowns.
    """
    point, vtpv = begin, np.inf
    stop: StepRecord[int] = StepRecord(tolerance, last=begin.last, expecting=begin.expecting)
    known: dict[int, float] = {}
    while point.iterations < max_iterations or stop.expecting:
        found = _descend(whole, point, stop)
        if found is None:
            return _end_without_step(whole, point, stop, known)
        attempt, judged, before, damping, stop = found
        if judged.arrived:
            return point, IterationEnd.at_rest(stop, point.iterations, judged.left, before)
        if point.iterations >= max_iterations:
            break
        bound, to = attempt.step.bound, point.state + 1
        known.setdefault(point.state, before)
        known[to] = vtpv = attempt.vtpv
        stop = stop.noted(attempt, judged, before, point.state)
        damping = damping.relaxed(judged.gain, bound)
        expecting = stop.expecting
        point = IterationPoint(to, point.weights, point.iterations + 1, bound, damping, expecting)
        note(point)
        if progress is not None:
            progress(point.iterations, vtpv, bound)
        if judged.done:
            return point, IterationEnd.at_rest(stop, point.iterations, judged.left, vtpv)
        if stop.rest.exhausted:
            return _end_at_smallest_step(point, stop, known)
        stop = stop.moved(bound, before, vtpv, plain=True)
        if stop.in_vain:
            whole.explain(IterationState(point.state, point.weights))
            reason = (
                f"vᵀPv hardly decreases any more, yet unknowns still move (by up to {bound:.2g} σ)"
            )
            return point, IterationEnd(point.iterations, False, reason, vtpv)
    reason = f"stopped after {point.iterations} iterations: the last step was {point.last:.2g} σ"
    return point, IterationEnd(point.iterations, False, reason, vtpv)


def _descend(
    whole: WholeNetwork, point: IterationPoint, stop: StepRecord[int]
) -> tuple[Attempt[int], Judgement, float, Damping, StepRecord[int]] | None:
    """Damp until a step is accepted; none: no damping leads to an accepted step.

    Returns:
        The step and its judgement, vᵀPv before it, the damping, and the record with the resolution.
    """
    damping = point.damping
    while not damping.hopeless:
        at = IterationState(point.state, point.weights, damping.value)
        damped = damping.value > 0.0
        try:
            root, found = whole.eliminated(at)
            if found.smallest < MIN_CHOLESKY_PIVOT:
                raise SingularError("a pivot vanished")
        except SingularError:
            if not damped:
                whole.explain(at)
        else:
            if not damped and point.iterations == 0 and found.smallest < ITERATION.suspicious:
                whole.explain(at)
            step, after = whole.moved(at, root.solve(), point.state + 1)
            to = point.state + 1 if np.isfinite(after) else None
            attempt = Attempt(step, to, after)
            here = replace(stop, resolution=found.resolution)
            judged = here.judge(attempt, found.vtpv, damped=damped)
            if judged.accepted:
                return attempt, judged, found.vtpv, damping, here
        damping = damping.harder()
    return None


def _end_at_smallest_step(
    point: IterationPoint, stop: StepRecord[int], known: dict[int, float]
) -> tuple[IterationPoint, IterationEnd]:
    """End at the state from which the smallest of the steps leads that are only rounding."""
    state = stop.rest.state
    assert state is not None
    ended = IterationEnd.at_rest(stop, point.iterations, stop.rest.bound, known[state])
    return replace(point, state=state), ended


def _end_without_step(
    whole: WholeNetwork, point: IterationPoint, stop: StepRecord[int], known: dict[int, float]
) -> tuple[IterationPoint, IterationEnd]:
    """End where no damping leads to a step: converged if the undamped step is small."""
    at = IterationState(point.state, point.weights)
    vtpv, left = np.inf, np.inf
    try:
        root, found = whole.eliminated(at)
        vtpv, stop = found.vtpv, replace(stop, resolution=found.resolution)
        left = whole.moved(at, root.solve(), point.state + 1)[0].bound
    except SingularError:
        whole.explain(at)
    if stop.near_enough(left, vtpv):
        return point, IterationEnd.at_rest(stop, point.iterations, left, vtpv)
    if stop.rest.state is not None:
        return _end_at_smallest_step(point, stop, known)
    reason = "no step decreases vᵀPv any more, yet the solution has not converged"
    return point, IterationEnd(point.iterations, False, reason, vtpv)

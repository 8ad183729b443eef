"""The iteration of a network in parts: the steps of one network, each found part by part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import DatumError
from ..solve.damping import Damping
from ..solve.iterate import ITERATION, Ended, Progress
from ..solve.normal import VANISHED
from ..solve.singular import SingularError
from ..solve.step import Attempt, Step
from ..solve.stopping import Judgement, Stop, at_rest
from ..types import Array
from .junctions import Junctions, RootPlaces
from .messages import At
from .root import Root, summed
from .tasks import eliminate, explain, move
from .workers import Workers

GIVE = "give control (fixed or weighted coordinates), or observations that tie the parts"
"""What a user can do about undetermined junctions."""


@dataclass(frozen=True)
class Point:
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
    ended: Ended | None = None
    """How the run ended at rest; none: it goes on."""


@dataclass(frozen=True)
class Whole:
    """A network in parts."""

    workers: Workers
    """Where its parts are."""
    junctions: Junctions
    """The unknowns that several parts have."""
    places: RootPlaces
    """Their places in the root."""

    def eliminated(self, at: At) -> tuple[Root, float, float]:
        """Return the factorised root, vᵀPv and the smallest pivot relative to diag(N).

        Raises:
            SingularError: an unknown is not determined.
        """
        root = Root(self.junctions, self.places)
        parts = self.workers.each(eliminate, [(at,)] * len(self.workers.jobs))
        vtpv, smallest = summed(root, parts)
        return root, vtpv, min(smallest, root.factorise(at.damping))

    def moved(self, at: At, junctions: Array, to: int) -> tuple[Step, float]:
        """Return the step with a movement of the junctions, and vᵀPv after it."""
        arguments = [(at, junctions[columns], to) for columns in self.junctions.columns]
        found = self.workers.all(move, arguments)
        downhill = sum(m.downhill for m in found)
        decrease = downhill + sum(m.damped for m in found)
        step = Step(junctions, decrease, float(np.sqrt(max(downhill, 0.0))))
        return step, sum(m.vtpv for m in found)

    def explain(self, at: At) -> None:
        """Raise an error that names undetermined unknowns, if there are any.

        Raises:
            DatumError: unknowns of parts are not determined by the part and its junctions, or the
                junctions are not determined by all parts.
        """
        self.workers.all(explain, [(at,)] * len(self.workers.jobs))
        root = Root(self.junctions, self.places)
        try:
            summed(root, self.workers.each(eliminate, [(at,)] * len(self.workers.jobs)))
        except SingularError:
            raise DatumError("the network is not determined", defect=1) from None
        self.places.hold(root.matrix)
        n, names = root.undetermined()
        if n:
            listed = "".join(f"\n  {name}" for name in names)
            raise DatumError(
                f"the parts together leave {n} combination{'s' * (n > 1)} of their junctions "
                f"undetermined: {GIVE}. Junctions concerned:{listed}",
                defect=n,
                names=names,
            )
        try:
            root.factorise(0.0)
        except SingularError:
            message = f"the parts together leave their junctions undetermined: {GIVE}"
            raise DatumError(message, defect=1) from None


def iterate(
    whole: Whole,
    begin: Point,
    *,
    tolerance: float,
    max_iterations: int,
    note: Callable[[Point], None],
    progress: Progress | None,
) -> tuple[Point, Ended]:
    """Step until the unknowns are at rest.

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
    stop: Stop[int] = Stop(tolerance, last=begin.last)
    known: dict[int, float] = {}
    while point.iterations < max_iterations:
        found = _descend(whole, point, stop)
        if found is None:
            return _no_way_on(whole, point, stop, known)
        attempt, judged, before, damping = found
        bound, to = attempt.step.bound, point.state + 1
        known[to] = vtpv = attempt.vtpv
        stop = stop.noted(attempt, judged, before)
        point = Point(
            to, point.weights, point.iterations + 1, bound, damping.relaxed(judged.gain, bound)
        )
        note(point)
        if progress is not None:
            progress(point.iterations, vtpv, bound)
        if judged.done:
            return point, Ended(point.iterations, True, at_rest(judged.left, tolerance), vtpv)
        if stop.rest.exhausted:
            return _at_smallest_step(point, stop, known)
        stop = stop.moved(bound, before, vtpv, plain=True)
        if stop.in_vain:
            whole.explain(At(point.state, point.weights))
            reason = (
                f"vᵀPv hardly decreases any more, yet unknowns still move (by up to {bound:.2g} σ)"
            )
            return point, Ended(point.iterations, False, reason, vtpv)
    reason = (
        f"not at rest after {point.iterations} iterations: the last step was {point.last:.2g} σ"
    )
    return point, Ended(point.iterations, False, reason, vtpv)


def _descend(
    whole: Whole, point: Point, stop: Stop[int]
) -> tuple[Attempt[int], Judgement, float, Damping] | None:
    """Damp until a step is accepted; none: no damping leads to an accepted step."""
    damping = point.damping
    while not damping.hopeless:
        at = At(point.state, point.weights, damping.value)
        damped = damping.value > 0.0
        try:
            root, before, smallest = whole.eliminated(at)
            if smallest < VANISHED:
                raise SingularError("a pivot vanished")
        except SingularError:
            if not damped:
                whole.explain(at)
        else:
            if not damped and point.iterations == 0 and smallest < ITERATION.suspicious:
                whole.explain(at)
            step, after = whole.moved(at, root.solve(), point.state + 1)
            to = point.state + 1 if np.isfinite(after) else None
            attempt = Attempt(step, to, after)
            judged = stop.judge(attempt, before, damped=damped)
            if judged.accepted:
                return attempt, judged, before, damping
        damping = damping.harder()
    return None


def _at_smallest_step(
    point: Point, stop: Stop[int], known: dict[int, float]
) -> tuple[Point, Ended]:
    """End at the state after the smallest of the steps that vᵀPv cannot tell from rounding."""
    state = stop.rest.state
    assert state is not None
    reason = at_rest(stop.rest.bound, stop.tolerance)
    ended = Ended(point.iterations, True, reason, known[state])
    return replace(point, state=state), ended


def _no_way_on(
    whole: Whole, point: Point, stop: Stop[int], known: dict[int, float]
) -> tuple[Point, Ended]:
    """End where no damping leads to a step: at rest if the undamped step is small."""
    at = At(point.state, point.weights)
    vtpv, left = np.inf, np.inf
    try:
        root, vtpv, _ = whole.eliminated(at)
        left = whole.moved(at, root.solve(), point.state + 1)[0].bound
    except SingularError:
        whole.explain(at)
    if stop.near_enough(left, vtpv):
        return point, Ended(point.iterations, True, at_rest(left, stop.tolerance), vtpv)
    if stop.rest.state is not None:
        return _at_smallest_step(point, stop, known)
    reason = "no step decreases vᵀPv any more, yet the solution is not at rest"
    return point, Ended(point.iterations, False, reason, vtpv)

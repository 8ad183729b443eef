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
from ..solve.stopping import Judgement, Stop
from ..types import Array
from .junctions import Junctions, RootPlaces
from .messages import At
from .root import Root, Sums, summed
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
    expecting: bool = False
    """Whether the last step is expected to have come to rest."""
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

    def eliminated(self, at: At) -> tuple[Root, Sums]:
        """Return the factorised root, and what it knows of all parts.

        Raises:
            SingularError: an unknown is not determined.
        """
        root = Root(self.junctions, self.places)
        parts = self.workers.each(eliminate, [(at,)] * len(self.workers.jobs))
        found = summed(root, parts)
        return root, found._replace(smallest=min(found.smallest, root.factorise(at.damping)))

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
    stop: Stop[int] = Stop(tolerance, last=begin.last, expecting=begin.expecting)
    known: dict[int, float] = {}
    while point.iterations < max_iterations or stop.expecting:
        found = _descend(whole, point, stop)
        if found is None:
            return _no_way_on(whole, point, stop, known)
        attempt, judged, before, damping, stop = found
        if judged.arrived:
            return point, Ended.at_rest(stop, point.iterations, judged.left, before)
        if point.iterations >= max_iterations:
            break
        bound, to = attempt.step.bound, point.state + 1
        known.setdefault(point.state, before)
        known[to] = vtpv = attempt.vtpv
        stop = stop.noted(attempt, judged, before, point.state)
        damping = damping.relaxed(judged.gain, bound)
        expecting = stop.expecting
        point = Point(to, point.weights, point.iterations + 1, bound, damping, expecting)
        note(point)
        if progress is not None:
            progress(point.iterations, vtpv, bound)
        if judged.done:
            return point, Ended.at_rest(stop, point.iterations, judged.left, vtpv)
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
) -> tuple[Attempt[int], Judgement, float, Damping, Stop[int]] | None:
    """Damp until a step is accepted; none: no damping leads to an accepted step.

    Returns:
        The step and its judgement, vᵀPv before it, the damping, and the record with the resolution.
    """
    damping = point.damping
    while not damping.hopeless:
        at = At(point.state, point.weights, damping.value)
        damped = damping.value > 0.0
        try:
            root, found = whole.eliminated(at)
            if found.smallest < VANISHED:
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


def _at_smallest_step(
    point: Point, stop: Stop[int], known: dict[int, float]
) -> tuple[Point, Ended]:
    """End at the state from which the smallest of the steps leads that are only rounding."""
    state = stop.rest.state
    assert state is not None
    ended = Ended.at_rest(stop, point.iterations, stop.rest.bound, known[state])
    return replace(point, state=state), ended


def _no_way_on(
    whole: Whole, point: Point, stop: Stop[int], known: dict[int, float]
) -> tuple[Point, Ended]:
    """End where no damping leads to a step: at rest if the undamped step is small."""
    at = At(point.state, point.weights)
    vtpv, left = np.inf, np.inf
    try:
        root, found = whole.eliminated(at)
        vtpv, stop = found.vtpv, replace(stop, resolution=found.resolution)
        left = whole.moved(at, root.solve(), point.state + 1)[0].bound
    except SingularError:
        whole.explain(at)
    if stop.near_enough(left, vtpv):
        return point, Ended.at_rest(stop, point.iterations, left, vtpv)
    if stop.rest.state is not None:
        return _at_smallest_step(point, stop, known)
    reason = "no step decreases vᵀPv any more, yet the solution is not at rest"
    return point, Ended(point.iterations, False, reason, vtpv)

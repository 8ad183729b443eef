"""The adjustment: Gauss-Newton steps, damped where they fail, until nothing moves.

The criterion is rigorous and free of units: for a step dx of N dx = −AᵀPv, Cauchy-Schwarz
bounds the step of every unknown, and of every function of them, relative to its own standard
deviation by √(dxᵀ N dx).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..errors import DatumError, InputError, Problem
from ..graph.equations import Equations, compile_network
from ..graph.extra import linearise_extra
from ..graph.variables import State
from ..models.image import depth
from ..models.variables import UNKNOWNS
from ..network.network import DatumChoice, Network
from ..types import Array, Mask
from .datum import Defect, FreeDatum, find_defects, minimal_datum
from .extrapolation import Extrapolation
from .free_network import SHRINKING, Carried, carry, datum_columns
from .inner import follow
from .linear import ExtraRows
from .normal import NormalEquations, Solver
from .rank import LISTED, describe_defects, undetermined, unnoticed
from .solution import Solution
from .tree import SingularError

if TYPE_CHECKING:
    import gtsam

Progress = Callable[[int, float, float], None]
"""Called with iteration, vᵀPv and the bound of the step relative to σ."""

FIRST_DAMPING = 1e-4
"""Share of the diagonal of N that is added when an undamped step fails."""
LEAST_DAMPING = 1e-12
"""Damping below which steps are undamped again."""
MOST_DAMPING = 1e12
"""Damping at which there is no way on."""
SMALL_ENOUGH_TO_EXPLAIN = 5000
"""Columns up to which a vanished pivot is explained at once, not at the end of the iteration."""
SLOW = 1e-6
"""Relative decrease of vᵀPv of a step, below which many in a row lead nowhere."""
PATIENCE = 20
"""Such steps in a row after which the iteration ends."""
DOUBTFUL = 0.25
"""Part of the predicted decrease below which points follow a step of the cameras on their own."""
FAST = 0.1
"""Ratio of a step to the last one, below which it tells how far the next one will be."""
CLOSE = 0.1
"""Step relative to σ below which that is trusted, and no point passes a camera."""
SUSPICIOUS = 1e-11
"""What is left of a diagonal element of N, relative, below which datum defects are looked for."""
POOR = 1e-6
"""The same below which any undetermined unknown is looked for. Rounding leaves up to 1e-10 of the
smallest pivot of a singular N, as it depends on the order of elimination."""
WORTHWHILE = 1e-3
"""Part of the predicted decrease of vᵀPv that a damped step must bring."""
OFF_DATUM = "not at rest on the inner constraints of the free network"
"""Why a free network at its minimum is not at rest."""
UNCHANGED = 1e-6
"""Part of 1 + vᵀPv that is no change of it."""
STILL = 1.0
"""Step relative to σ above which nothing is at rest, whether vᵀPv can tell or not."""
ROUNDING = 1e-12
"""Decrease relative to vᵀPv that it cannot tell any more; steps still do, by getting smaller."""
BLIND = 1e-9
"""Change relative to vᵀPv that may be rounding: what steps down to that add up to."""
IN_VAIN = 10
"""Of them in a row that do not: rounding is all that is left of them."""
NEAR = 1e-4
"""Step relative to σ below which the next one is tried without damping."""
MOST_WEIGHINGS = 4
"""Times that weights are worked out; they depend on lengths, and hardly on the unknowns."""


@dataclass
class _Run:
    """What the iteration carries along."""

    solver: Solver
    factors: Sequence[gtsam.NonlinearFactor]
    state: State
    start: State
    free: bool
    constraint: Array
    datum: FreeDatum | None = None
    defects: tuple[Defect, ...] = ()
    at_solution: NormalEquations | None = None
    drifting: tuple[tuple[str, str], ...] = ()
    smallest_pivot: float = 0.0
    """That of the last undamped step, relative; 0 where there was none."""

    @property
    def equations(self) -> Equations:
        return self.solver.equations

    def extra(self, state: State) -> list[ExtraRows]:
        """Linearise the user's factors."""
        if not self.factors:
            return []
        return [
            ExtraRows(columns, a, residual)
            for columns, a, residual in linearise_extra(self.factors, self.equations, state)
        ]

    def unobserved(self, normal: NormalEquations) -> Mask:
        """Return the free components that no observation touches, (n_columns,)."""
        return self.equations.unknowns.free & (normal.diagonal <= 0)

    def normal(self) -> NormalEquations:
        """Return the normal equations at the solution."""
        if self.at_solution is None:
            self.at_solution = self.normal_at(self.state)
        return self.at_solution

    def normal_at(self, state: State) -> NormalEquations:
        """Return the normal equations at any state."""
        return NormalEquations(self.solver, state, self.extra(state))

    def vtpv(self, state: State) -> float:
        """Return vᵀPv; infinite where a sight has no answer."""
        try:
            v = self.equations.residuals(state)
        except InputError:
            return np.inf
        value = float(v @ v) + sum(float(e.residual @ e.residual) for e in self.extra(state))
        return value if np.isfinite(value) else np.inf


def adjust(
    network: Network,
    *,
    datum: DatumChoice | None = None,
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    start: Solution | None = None,
    weights: Array | None = None,
    tolerance: float = 1e-5,
    max_iterations: int = 100,
    extra_factors: Sequence[gtsam.NonlinearFactor] = (),
    progress: Progress | None = None,
) -> Solution:
    """Adjust a network by least squares: minimise vᵀPv over all unknowns.

    Args:
        network: what was measured.
        datum: ``given`` (control, fixed, weighted) or ``free`` (inner constraints over the datum
            points); none: as the network says.
        variance: whether covariances are scaled by 1 or by σ̂0².
        start: start from the values of an earlier solution, by name; a few observations more or
            less need a step or two. Inner constraints refer to the same coordinates as there.
        weights: what the weight of each scalar observation is multiplied by, in the order of
            ``solution.observations``; see `Equations.reweighted`.
        tolerance: bound on the last step of every unknown, relative to its own σ.
        max_iterations: after as many the solution says that it has not converged.
        extra_factors: any ``gtsam.NonlinearFactor`` over the keys of `build_graph`; they take
            part in solution and covariance.
        progress: called after each iteration; an exception in it ends the adjustment.

    Returns:
        The solution; its ``converged`` and ``reason`` say how it ended.

    Raises:
        InputError: an observation that cannot be computed, a point behind a camera, nothing
            to adjust: by name, all at once.
        ApproximationError: no approximate values for the points, photos or sets it names.
        DatumError: unknowns that the observations do not determine, by name; or defects of
            datum without a free network asked for.
    """
    choice = network.datum if datum is None else datum
    if choice not in ("given", "free"):
        raise InputError(f"unknown datum {choice!r}; valid: given, free")
    if variance not in ("a-priori", "a-posteriori"):
        raise InputError(f"unknown variance {variance!r}; valid: a-priori, a-posteriori")
    equations = compile_network(network)
    origin, state = _start(equations, choice, start)
    weighed = equations.weighted_at(state)
    iterations = 0
    for _ in range(MOST_WEIGHINGS):
        equations = weighed if weights is None else weighed.reweighted(weights)
        run = _Run(
            Solver.of(equations),
            tuple(extra_factors),
            state,
            origin,
            choice == "free",
            np.zeros(equations.unknowns.n_columns),
        )
        if extra_factors:
            run.solver = Solver.of(equations, run.extra(state))
        most = max_iterations - iterations
        made, converged, reason, vtpv = _iterate(run, tolerance, most, progress)
        iterations, state = iterations + made, run.state
        before, weighed = weighed, weighed.weighted_at(state)
        if not converged or iterations >= max_iterations or weighed.weighs_as(before):
            break
    if converged and run.smallest_pivot < POOR:
        _refuse_unnoticed(run, run.normal())
    if run.datum is not None:
        shape = run.state, run.datum, run.defects
        carried = _carry_to_datum_points(run, tolerance, converged)
        there = run.vtpv(run.state)
        if carried.left > tolerance:
            reason = _at_rest(carried.left, tolerance)
        if converged and not carried.at_rest:
            converged, reason = False, OFF_DATUM
            if not _no_worse(there, vtpv):  # it has lost its shape on the way
                (run.state, run.datum, run.defects), run.at_solution = shape, None
                there = vtpv
        vtpv = there
    _refuse_points_behind(equations, run.state)
    return Solution(
        network=network,
        equations=equations,
        state=run.state,
        start=run.start,
        converged=converged,
        reason=reason,
        drifting=run.drifting,
        iterations=iterations,
        vtpv=vtpv,
        datum=run.datum,
        defects=run.defects,
        variance=variance,
        weights=None if weights is None else np.array(weights, dtype=float),
        n_extra=sum(len(e.residual) for e in run.extra(run.state)),
        normal=run.normal,
        normal_at=run.normal_at,
        constraint=run.constraint,
    )


def _start(
    equations: Equations, datum: DatumChoice, earlier: Solution | None
) -> tuple[State, State]:
    """Return x₀, which inner constraints refer to, and the values to start from."""
    unknowns = equations.unknowns
    origin = unknowns.start()
    if earlier is not None:
        missing = {kind: np.isnan(values) for kind, values in origin.items()}
        known = unknowns.carried(origin, earlier.equations.unknowns, earlier.start, where=missing)
        if not _incomplete(known):
            return known, unknowns.carried(
                known, earlier.equations.unknowns, earlier.state, where=unknowns.moving()
            )
    if _incomplete(origin):
        from ..approximate import approximate

        origin = approximate(equations, datum=datum)
    return origin, origin


def _incomplete(state: State) -> bool:
    return any(bool(np.isnan(values).any()) for values in state.values())


def _iterate(
    run: _Run, tolerance: float, max_iterations: int, progress: Progress | None
) -> tuple[int, bool, str, float]:
    """Step until nothing moves; return iterations, converged, reason, vᵀPv."""
    damping = 0.0
    resume = FIRST_DAMPING
    growth = 2.0
    vtpv = np.inf
    bound = last = np.inf
    slow = 0
    beyond = Extrapolation()
    rest = _Rest()
    plain = True
    for iteration in range(1, max_iterations + 1):
        normal = run.normal_at(run.state)
        vtpv = normal.system.vtpv
        if not np.isfinite(vtpv):
            _name_overflow(run)
        if iteration == 1 and (run.free or bool(np.any(run.unobserved(normal)))):
            _settle_datum(run, normal)
        while True:
            found = _step(run, normal, damping)
            if iteration == 1 and damping == 0.0:
                # A defect of datum leaves a pivot without anything: no need to search without.
                suspicious = found is None or normal.smallest_pivot < SUSPICIOUS
                if suspicious and run.datum is None:
                    _settle_datum(run, normal)
                if run.smallest_pivot < POOR and found is not None:
                    _refuse_unnoticed(run, normal)
            small = False
            if found is not None:
                step, decrease, bound = found
                moved, after = _moved(run, step, bound, vtpv - DOUBTFUL * decrease)
                gain = (vtpv - after) / decrease if decrease > 0 else 0.0
                still = _cannot_tell(bound, decrease, vtpv) and after <= vtpv * (1 + BLIND)
                # What is left after this step, by the rate of convergence so far.
                fast = plain and np.isfinite(last) and bound < FAST * last and bound < CLOSE
                left = bound * bound / last if fast else bound
                no_worse = _no_worse(after, vtpv)
                small = damping == 0.0 and (still or (left < tolerance and no_worse))
                if moved is not None and (small or gain > WORTHWHILE):
                    break
            damping = resume if damping == 0.0 else damping * growth
            growth *= 2.0
            if damping > MOST_DAMPING:
                # No step can be told from rounding: at rest, if the undamped one is small.
                left = _undamped(run, normal)
                if left < tolerance or _cannot_tell(left, left * left, vtpv):
                    return iteration, True, _at_rest(left, tolerance), vtpv
                if rest.best is not None:  # it was there before, as near as vᵀPv can tell
                    left, run.state = rest.best
                    return iteration, True, _at_rest(left, tolerance), run.vtpv(run.state)
                _explain(run, normal)
                reason = "no step decreases vᵀPv any more, yet the solution is not at rest"
                return iteration, False, reason, vtpv
        if after < vtpv - BLIND * (1.0 + vtpv):  # it could tell, after all
            rest = _Rest()
        done = small and left < tolerance
        at_last = rest.of(bound, moved) if small and not done else None
        plain = True
        if bound >= STILL:
            beyond.clear()
        elif not done:
            further, there = _further(
                run, beyond, normal, step, after, slow=bound > FAST * last, blind=small
            )
            if further is not None:
                moved, after, plain = further, there, False
        run.state = moved
        if progress is not None:
            progress(iteration, after, bound)
        if done:
            return iteration, True, _at_rest(left, tolerance), after
        if at_last is not None:
            left, run.state = at_last
            return iteration, True, _at_rest(left, tolerance), run.vtpv(run.state)
        slow = slow + 1 if vtpv - after < SLOW * vtpv and bound > SHRINKING * last else 0
        last = bound
        vtpv = after
        growth = 2.0
        if slow >= PATIENCE:
            normal = run.normal_at(run.state)
            left = _undamped(run, normal)
            if left < tolerance or _cannot_tell(left, left * left, after):
                return iteration, True, _at_rest(left, tolerance), after
            if run.equations.unknowns.n_columns <= SMALL_ENOUGH_TO_EXPLAIN:
                _explain(run, normal)
            elif (why := _undetermined(run, normal)) is not None:
                run.drifting = why.unknowns
            return iteration, False, _drifting(run, bound), after
        damping *= max(0.1, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
        if damping < LEAST_DAMPING or bound < NEAR:
            damping, resume = 0.0, max(damping, LEAST_DAMPING)
    reason = f"not at rest after {max_iterations} iterations: the last step was {bound:.2g} σ"
    return max_iterations, False, reason, vtpv


def _further(
    run: _Run,
    beyond: Extrapolation,
    normal: NormalEquations,
    step: Array,
    after: float,
    *,
    slow: bool,
    blind: bool,
) -> tuple[State | None, float]:
    """Return the state beyond a step and its vᵀPv; none where that is no better than the step.

    Args:
        run: the adjustment.
        beyond: its last steps.
        normal: at the state before the step.
        step: the step.
        after: vᵀPv after it.
        slow: steps shrink slowly; otherwise their own convergence is better than any guess.
        blind: vᵀPv cannot tell which is better.
    """
    movement = beyond.beyond(step, lambda dx: normal.system.times(dx[:, None])[:, 0])
    if movement is not None and slow:
        further = _before_the_cameras(run, run.equations.unknowns.retract(run.state, movement))
        there = np.inf if further is None else run.vtpv(further)
        if there < after or (blind and there <= after * (1 + BLIND)):
            beyond.moved(movement)
            return further, there
    beyond.moved(step)
    return None, np.inf


def _no_worse(after: float, vtpv: float) -> bool:
    """Return whether vᵀPv has not grown by more than rounding; not where it is not a number."""
    return after <= vtpv + UNCHANGED * (1.0 + vtpv)


def _cannot_tell(bound: float, decrease: float, vtpv: float) -> bool:
    """Return whether a step and its decrease are too small to be seen in vᵀPv."""
    return decrease < ROUNDING * max(vtpv, ROUNDING) and bound < STILL


class _Rest:
    """The smallest steps where vᵀPv cannot tell any more: they are taken while they shrink."""

    def __init__(self) -> None:
        self.best: tuple[float, State] | None = None
        """The smallest step so far, relative to σ, and the state after it."""
        self._in_vain = 0

    def of(self, bound: float, moved: State) -> tuple[float, State] | None:
        """Return the smallest step and the state after it, once steps do not shrink any more."""
        if self.best is None or bound < SHRINKING * self.best[0]:
            self._in_vain = 0
        else:
            self._in_vain += 1
        if self.best is None or bound < self.best[0]:
            self.best = bound, moved
        return self.best if self._in_vain >= IN_VAIN else None


def _undamped(run: _Run, normal: NormalEquations) -> float:
    """Return the bound of the step without damping, infinite where there is none."""
    found = _step(run, normal, 0.0)
    return np.inf if found is None else found[2]


def _drifting(run: _Run, bound: float) -> str:
    names = [f"{UNKNOWNS[kind].noun} {name!r}" for kind, name in run.drifting]
    listed = ": " + ", ".join(names[:LISTED]) if names else ""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return (
        f"vᵀPv hardly decreases any more, yet unknowns still move (by up to {bound:.2g} σ): "
        f"some of them are nearly undetermined{listed}{more}"
    )


def _at_rest(left: float, tolerance: float) -> str:
    if left < tolerance:
        return f"at rest: no unknown is further than {tolerance:.0e} of its σ from the minimum"
    return f"at rest: vᵀPv cannot tell any more; the last step was at most {left:.1g} σ"


def _step(run: _Run, normal: NormalEquations, damping: float) -> tuple[Array, float, float] | None:
    """Return step, predicted decrease of vᵀPv, and the bound of the step relative to σ.

    None where undamped normal equations have no answer: damping may lead where they have one. At
    the end of the way the error says what is missing.
    """
    weights = normal.diagonal * damping
    if damping == 0.0:
        run.smallest_pivot = 0.0
    try:
        # Damping fills the datum too, and without taking sides for the points that are held.
        factor = normal.factorise(weights if damping > 0.0 else run.constraint)
    except SingularError:
        if damping > 0.0:
            return None
        if run.equations.unknowns.n_columns <= SMALL_ENOUGH_TO_EXPLAIN:
            _explain(run, normal)
        return None
    if damping == 0.0:
        run.smallest_pivot = normal.smallest_pivot
    y = -normal.gradient[:, None]
    step = factor.solve(y)[:, 0]
    decrease = float(-normal.gradient @ step + step @ (weights * step))
    bound = float(np.sqrt(max(float(-normal.gradient @ step), 0.0)))
    return step, decrease, bound


def _moved(run: _Run, step: Array, bound: float, expected: float) -> tuple[State | None, float]:
    """Return the state after a step, and its vᵀPv; none and infinite where there is none.

    Where vᵀPv is not below what is ``expected``, points follow the cameras on their own.
    """
    plain = run.equations.unknowns.retract(run.state, step)
    moved = _before_the_cameras(run, plain) if bound > CLOSE else plain
    after = np.inf if moved is None else run.vtpv(moved)
    if after > expected and bound > 1.0 and run.solver.plan.reduced.any():
        moved = follow(run.equations, run.solver.plan, run.state, plain)
        moved = _before_the_cameras(run, moved)
        after = np.inf if moved is None else run.vtpv(moved)
    return moved, after


def _settle_datum(run: _Run, normal: NormalEquations) -> None:
    """Find the datum defects; hold what a free network needs, or say what is missing."""
    unknowns = run.equations.unknowns
    if np.any(run.unobserved(normal)):
        _explain(run, normal)
    defects = find_defects(normal.system, run.state, normal.diagonal, free=run.free)
    run.defects = tuple(defects)
    if not defects:
        return
    if not run.free:
        error = undetermined(normal.system, normal.diagonal, defects)
        if error is not None:
            raise error
    if len(defects) > 1:
        lines = describe_defects(unknowns, defects)
        raise DatumError(
            "\n  ".join(["a free network must be connected", *lines]),
            defect=sum(d.size for d in defects),
        )
    motions = defects[0].motions
    columns = datum_columns(run.equations, motions)
    held = minimal_datum(motions * np.sqrt(normal.diagonal)[:, None], columns)
    run.constraint[held] = normal.diagonal[held]
    run.datum = FreeDatum(motions, columns)
    run.constraint = normal.held_better(run.constraint, run.datum)


def _carry_to_datum_points(run: _Run, tolerance: float, at_rest: bool) -> Carried:
    """Move the solution onto the inner constraints."""
    assert run.datum is not None

    def step(normal: NormalEquations) -> tuple[Array, float] | None:
        found = _step(run, normal, 0.0)
        return None if found is None else (found[0], found[2])

    carried = carry(
        run.equations,
        run.state,
        run.start,
        run.datum,
        run.defects,
        normal_at=run.normal_at,
        step=step,
        tolerance=tolerance,
        at_rest=at_rest,
        free=run.free,
    )
    run.state, run.at_solution = carried.state, carried.normal
    run.datum, run.defects = carried.datum, carried.defects
    return carried


def _refuse_unnoticed(run: _Run, normal: NormalEquations) -> None:
    """Raise what is not determined, by name, where a pivot is poor.

    Rounding turns the pivot of a singular N into a small one, and its step into anything.
    """
    try:
        factor = normal.factorise(run.constraint)
    except SingularError:
        _explain(run, normal)
        return
    filled = [] if run.datum is None else [d.at(run.equations, run.state) for d in run.defects]
    known = unnoticed(normal.system, normal.diagonal, factor, filled)
    if known.shape[1]:
        _explain(run, normal, known)


def _explain(run: _Run, normal: NormalEquations, known: Array | None = None) -> None:
    """Raise what is not determined, by name; ``known`` as in `undetermined`."""
    error = _undetermined(run, normal, known)
    try:
        if error is not None:
            raise error from None
    finally:
        del error  # or frame and traceback hold each other, and everything in them


def _undetermined(
    run: _Run, normal: NormalEquations, known: Array | None = None
) -> DatumError | None:
    """Return an error that names what is not determined, or none."""
    free = run.datum is not None
    defects = (
        [d.at(run.equations, run.state) for d in run.defects]
        if free
        else find_defects(normal.system, run.state, normal.diagonal, free=run.free)
    )
    return undetermined(normal.system, normal.diagonal, defects, free=free, known=known)


def _name_overflow(run: _Run) -> None:
    v = run.equations.residuals(run.state)
    bad = np.flatnonzero(~np.isfinite(v))[:12]
    raise InputError(
        [Problem("its residual is not a finite number", run.equations.label(int(r))) for r in bad]
    )


def _behind(equations: Equations, state: State) -> Mask:
    """Return which image points have their object point behind the camera, block by block."""
    out = [np.zeros(0, dtype=bool)]
    for block in equations.blocks:
        if block.kind == "image":
            (_, photo), _, (_, point) = block.variables
            out.append(depth(state["pose"][photo], state["point"][point]) <= 0)
    return np.concatenate(out)


def _before_the_cameras(run: _Run, moved: State) -> State | None:
    """Keep points that a step takes from before to behind a camera where they were.

    Through the focal plane or infinity there is no descent: such a step only changes sides.
    None where the cameras themselves pass points.
    """
    now = _behind(run.equations, moved)
    if not now.any():
        return moved
    passes = now & ~_behind(run.equations, run.state)
    if not passes.any():
        return moved
    point = np.concatenate([b.variables[2][1] for b in run.equations.blocks if b.kind == "image"])
    held = np.unique(point[passes])
    points = moved["point"].copy()
    points[held] = run.state["point"][held]
    kept: State = {**moved, "point": points}
    still = _behind(run.equations, kept) & ~_behind(run.equations, run.state)
    return None if still.any() else kept


def _refuse_points_behind(equations: Equations, state: State) -> None:
    """Raise an error that names image points whose object point lies behind the camera."""
    problems = []
    for block in equations.blocks:
        if block.kind != "image":
            continue
        photo, point = block.variables[0][1], block.variables[2][1]
        behind = depth(state["pose"][photo], state["point"][point]) <= 0
        for number in np.unique(photo[behind]).tolist():
            rows = np.flatnonzero(photo == number)
            name = equations.unknowns["pose"].names[number]
            if behind[rows].all():
                problems.append(
                    Problem(
                        f"all {len(rows)} points lie behind it: is its attitude, or the direction"
                        " of the camera's axes, as it should be?",
                        f"photo {name!r}",
                    )
                )
                continue
            problems += [
                Problem("the adjusted point lies behind the camera", block.labels(int(i)))
                for i in rows[behind[rows]]
            ]
    if problems:
        raise InputError(problems)

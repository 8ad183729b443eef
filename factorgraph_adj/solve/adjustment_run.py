"""State of an adjustment under way: values, AᵀPv, datum defects; errors of datum, rank, overflow.

Datum defects are searched for at its start, and undetermined unknowns after a poor pivot and where
it ends without a minimum.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..errors import AdjustmentError, DatumError, InputError, Problem, SingularError, known
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.base import Linearised
from ..models.unknown_registry import UNKNOWNS
from ..types import Array, Mask
from .added_factors import NO_ADDED_FACTORS, AddedFactors
from .datum_defects import Defect, FreeDatum, extent_of, find_defects, minimal_datum
from .defect_description import describe_defects
from .gauss_newton_steps import NO_EXTRAPOLATIONS, ExtrapolationRecord
from .inner_constraints import datum_columns
from .linearised_equations import LinearisedEquations, sum_of_squares
from .normal_equations import NormalEquations, Solver
from .undetermined_unknowns import (
    MAX_UNKNOWNS_IN_MESSAGE,
    undetermined_combinations,
    undetermined_error,
)
from .unnoticed_motions import zero_length_blocks

GROSS_RMS = 30.0
"""Root mean square of v/σ above which a state is far from the minimum: a singular N there does not
show what the observations determine."""
FITTING_RMS = 3.0
"""Root mean square of v/σ up to which readings fit where an iteration ended. Above it gross errors
or poor start values have led it there."""

RANDOM_STEP = 0.03
"""Random movement of points and projection centres relative to the extent of a network, and of
attitudes in radians: enough for points to leave common lines, too little to pass a camera."""
MOVED_AT_RANDOM = {"point": (True,) * 3, "pose": (False,) * 3 + (True,) * 3}
"""Whether each component of the unknowns that are moved is a length, by kind."""


@dataclass(frozen=True)
class ShapeMisfit:
    """Misfit of a shape when it was fitted again without a smaller vᵀPv."""

    excess: float
    """Excess of vᵀPv of its rows over what chance explains, in units of its deviation."""
    rows: int
    """Number of its rows."""


@dataclass(frozen=True, eq=False)
class RunRecord:
    """Record of a finished adjustment for computations that continue from its solution."""

    solver: Solver
    """How the normal equations are factorised."""
    constraint: Array
    """Terms that a minimal datum adds to the diagonal of N, (n_columns,)."""
    drifting: tuple[tuple[str, str], ...] = ()
    """Kind and name of the undetermined unknowns of an iteration that ended without progress."""
    shape_misfits: Mapping[str, ShapeMisfit] = field(default_factory=dict)
    """Shapes that do not fit and were fitted again in vain, by name, see `shape_minimum`."""
    linearised: NormalEquations | None = None
    """Normal equations that have been made already; they serve if they belong to the state."""


@dataclass
class AdjustmentRun:
    """The changing values of an adjustment under way."""

    solver: Solver
    """How normal equations are factorised."""
    extra: AddedFactors
    """Factors that the user added."""
    state: State
    """Present values of all variables."""
    start: State
    """Values x₀ that inner constraints refer to."""
    began: State
    """Values at which the adjustment began."""
    free: bool
    """Whether a free network is requested."""
    constraint: Array
    """Terms that a minimal datum adds to the diagonal of N, (n_columns,)."""
    datum: FreeDatum | None = None
    """Inner constraints of a free network, once its defects are known."""
    defects: tuple[Defect, ...] = ()
    """Datum defects that were found."""
    at_solution: NormalEquations | None = None
    """Normal equations at the state; None: they have not been made."""
    smallest_pivot: float = 0.0
    """Smallest pivot of the last undamped step, relative to its diagonal element of N; 0: there was
    no undamped step."""
    drifting: tuple[tuple[str, str], ...] = ()
    """Kind and name of the undetermined unknowns of an iteration that ended without progress."""
    weighted: bool = False
    """Whether observations have factors on their weights."""
    damped: bool = False
    """Whether a step was damped, so that the start was not near the minimum."""
    may_end_undetermined: bool = False
    """Whether an iteration that ends where an unknown is not determined that was at the start has
    not converged; otherwise it is a `DatumError`."""
    last: tuple[State, Mapping[int, Linearised]] | None = None
    """The state of the last vᵀPv and what `Equations.evaluated` returned for it, until a state is
    linearised: the evaluation of an accepted step is the next linearisation."""
    made: NormalEquations | None = None
    """Normal equations at the state at which it begins; None: they have not been made."""
    extrapolated: ExtrapolationRecord = NO_EXTRAPOLATIONS
    """The extrapolations that were taken."""
    looked: Mapping[str, ShapeMisfit] = field(default_factory=dict)
    """Shapes that were fitted again in vain, by name, see `shape_minimum`."""

    @classmethod
    def at(
        cls,
        equations: Equations,
        state: State,
        start: State,
        *,
        free: bool,
        extra: AddedFactors = NO_ADDED_FACTORS,
        solver: Solver | None = None,
    ) -> AdjustmentRun:
        """Begin an adjustment at a state; ``solver``: of the same network with other weights."""
        extra = extra.at(equations, state)
        constraint = np.zeros(equations.unknowns.n_columns)
        if solver is None:
            solver = Solver.of(equations, extra.rows)
        run = cls(solver.reweighted(equations), extra, state, start, state, free, constraint)
        run.made, solver.made = solver.made, None
        return run

    @property
    def equations(self) -> Equations:
        """The observation equations."""
        return self.solver.equations

    def unobserved(self, normal: NormalEquations) -> Mask:
        """Return the free components that no observation touches, (n_columns,)."""
        return self.equations.unknowns.free & (normal.diagonal <= 0)

    def normal_at(self, state: State) -> NormalEquations:
        """Return the normal equations at any state."""
        last, self.last = self.last, None
        made, self.made = self.made, None
        if made is not None and made.state is state:
            return made
        evaluated = last[1] if last is not None and last[0] is state else None
        extra = self.extra.at(self.equations, state).rows
        return NormalEquations(self.solver, state, extra, evaluated)

    def gradient_at(self, state: State) -> Array:
        """Return AᵀPv at any state, (n_columns,).

        Raises:
            InputError: an observation cannot be computed there.
        """
        extra = self.extra.at(self.equations, state).rows
        return LinearisedEquations(self.equations, state, extra).gradient()

    def whitened(self, state: State) -> Array:
        """Return whitened residuals at any state, extra rows at the end, (rows,).

        Raises:
            InputError: an observation cannot be computed there.
        """
        extra = self.extra.at(self.equations, state).rows
        return np.concatenate([self.equations.residuals(state), *(e.residual for e in extra)])

    def vtpv(self, state: State) -> float:
        """Return vᵀPv; infinite where an observation cannot be computed."""
        try:
            self.last = None
            evaluated = self.equations.evaluated(state)
            v = self.equations.residuals(state, evaluated=evaluated)
        except InputError:
            return np.inf
        self.last = state, evaluated
        extra = self.extra.at(self.equations, state).rows
        value = sum_of_squares(v, *(e.residual for e in extra))
        return value if np.isfinite(value) else np.inf


def misfits_grossly(normal: NormalEquations) -> bool:
    """Return whether residuals show that a state is far from the minimum."""
    return normal.system.vtpv > GROSS_RMS**2 * normal.solver.equations.n_rows


def settle_datum(run: AdjustmentRun, normal: NormalEquations) -> None:
    """Find the datum defects; hold a minimal datum in a free network, otherwise raise an error.

    Raises:
        DatumError: unknowns have no observations; or the network has datum defects and no free
            network is asked for, or has them in several parts.
    """
    unknowns = run.equations.unknowns
    if np.any(run.unobserved(normal)):
        raise_undetermined(run, normal)
    defects = find_defects(normal.system, run.state, normal.diagonal, free=run.free)
    run.defects = tuple(defects)
    if run.free:
        refuse_shrinking(run, normal, sum(d.size for d in defects))
    if not defects:
        return
    if not run.free:
        error = undetermined_error(normal.system, normal.diagonal, defects)
        if error is not None:
            raise error
    if len(defects) > 1:
        lines = describe_defects(unknowns, defects, run.state)
        raise DatumError(
            "\n  ".join(["a free network must be connected", *lines]),
            defect=sum(d.size for d in defects),
        )
    motions = defects[0].motions
    columns = datum_columns(run.equations, motions)
    held = minimal_datum(motions * np.sqrt(normal.diagonal)[:, None], columns)
    run.constraint = np.zeros_like(run.constraint)  # a run that continues chooses again
    run.constraint[held] = normal.diagonal[held]
    run.datum = FreeDatum(motions, columns)


def refuse_lasting_defects(run: AdjustmentRun, normal: NormalEquations) -> None:
    """Raise an error if a network has datum defects wherever its points and photos are.

    A singular N far from the minimum may be that of the place, such as points that start on a line;
    a motion that no observation notices here, and none where points and photos are moved at random,
    is one of the network: iterations would only turn or shift it.

    Raises:
        DatumError: as `settle_datum`.
    """
    if run.free or not find_defects(normal.system, run.state, normal.diagonal, free=False):
        return
    unknowns = run.equations.unknowns
    rng, size = np.random.default_rng(1), extent_of(run.state)[1]
    movement = np.zeros(unknowns.n_columns)
    for kind, steps in MOVED_AT_RANDOM.items():
        for i in np.flatnonzero(unknowns[kind].offset >= 0).tolist():
            columns = unknowns.columns(kind, i)
            scale = np.where(np.array(steps)[: len(columns)], size, 1.0) * RANDOM_STEP
            movement[columns] = scale * rng.uniform(-1.0, 1.0, len(columns))
    other = unknowns.retract(run.state, np.where(unknowns.free, movement, 0.0))
    try:
        extra = run.extra.at(run.equations, other).rows
        elsewhere = LinearisedEquations(run.equations, other, extra)
        lasting = find_defects(elsewhere, other, elsewhere.diagonal(), free=False)
    except AdjustmentError:  # a sight has no direction there
        return
    if lasting:
        settle_datum(run, normal)


def refuse_shrinking(run: AdjustmentRun, normal: NormalEquations, known: int) -> None:
    """Raise an error if a free network has no minimum, because residuals in metres shrink with it.

    Args:
        run: the adjustment.
        normal: its normal equations.
        known: number of its datum defects.

    Raises:
        DatumError: nothing in the network has a length.
    """
    found = list(zero_length_blocks(normal.system))
    if not found:
        return
    every = find_defects(normal.system, run.state, normal.diagonal, free=True, shrinking=True)
    size = sum(d.size for d in every)
    scaled = any("scale" in d.names() for d in every)
    already = size == known and any("scale" in d.names() for d in run.defects)
    # Velocities are zero at the start, where the scale does not change them.
    if not scaled or (already and not any(block.prior for block, _ in found)):
        return
    counts = ", ".join(f"{int(zero.sum())} {b.kind.replace('_', ' ')}" for b, zero in found)
    raise DatumError(
        "nothing in the free network has a length, so that it has no size at which it fits best: "
        f"residuals in metres ({counts}) are lengths or velocities that should be zero, and shrink "
        "with the network\n  give it a length: a distance, two control points, a known size of a "
        "shape (hold its size), or a frame of known scale",
        defect=size,
    )


def refuse_undetermined(run: AdjustmentRun, normal: NormalEquations) -> None:
    """Raise an error that names the undetermined unknowns, after a poor pivot.

    Rounding gives a singular N a small pivot instead of zero, and its step is then arbitrary.
    """
    try:
        factor = normal.factorise(run.constraint)
    except SingularError:
        raise_undetermined(run, normal)
        return
    filled = [] if run.datum is None else [d.at(run.equations, run.state) for d in run.defects]
    known = undetermined_combinations(normal.system, normal.diagonal, factor, filled)
    if known.shape[1]:
        raise_undetermined(run, normal, known)


def raise_undetermined(
    run: AdjustmentRun, normal: NormalEquations, known: Array | None = None
) -> None:
    """Raise an error that names the undetermined unknowns; ``known`` as in `undetermined`."""
    error = find_undetermined(run, normal, known)
    try:
        if error is not None:
            raise error from None
    finally:
        del error  # otherwise frame and traceback keep each other and all their objects alive


def describe_lost_determinacy(run: AdjustmentRun, normal: NormalEquations) -> str:
    """Return what is not determined where an iteration ended; empty if all is determined.

    Raises:
        DatumError: the same is undetermined at the start, so that the network does not determine
            it; or the run may not end undetermined. Otherwise gross errors, or poor start values,
            have led to a state in which points coincide, or are far away.
    """
    error = find_undetermined(run, normal)
    if error is None:
        return ""
    if not run.may_end_undetermined or normal.system.vtpv <= FITTING_RMS**2 * run.equations.n_rows:
        raise_undetermined(run, normal)  # readings that fit do not determine it
    try:
        began = run.normal_at(run.began)
        if find_undetermined(run, began) is None:
            named = error.names or tuple(name for _, name in error.unknowns)
            listed = f": {', '.join(map(str, named[:MAX_UNKNOWNS_IN_MESSAGE]))}" if named else ""
            return f"where it ended something is not determined that was at the start{listed}"
    except InputError:
        pass
    raise_undetermined(run, normal)
    return ""


def find_undetermined(
    run: AdjustmentRun, normal: NormalEquations, known: Array | None = None
) -> DatumError | None:
    """Return an error that names the undetermined unknowns; None: all are determined."""
    if run.datum is not None:
        free, defects = True, [d.at(run.equations, run.state) for d in run.defects]
    else:
        defects = find_defects(normal.system, run.state, normal.diagonal, free=run.free)
        # Inner constraints would fill the defect, if all else were determined.
        free = run.free and len(defects) < 2
    return undetermined_error(normal.system, normal.diagonal, defects, free=free, known=known)


def raise_overflow(run: AdjustmentRun) -> None:
    """Raise an error that names the observations for which vᵀPv is not finite."""
    v = run.equations.residuals(run.state)
    with np.errstate(over="ignore"):
        bad = np.flatnonzero(~np.isfinite(v * v))[:MAX_UNKNOWNS_IN_MESSAGE]
    bad = bad if len(bad) else np.argsort(-np.abs(v))[:1]
    raise InputError(
        [
            Problem(
                f"its residual is {abs(v[r]):.3g} σ: vᵀPv with it is not a finite number"
                if np.isfinite(v[r])
                else "its residual is not a finite number",
                run.equations.label(int(r)),
            )
            for r in bad
        ]
    )


def drift_reason(run: AdjustmentRun, bound: float) -> str:
    """Return the reason of an iteration that ended while unknowns still moved without gain."""
    names = [f"{UNKNOWNS[kind].noun} {name!r}" for kind, name in run.drifting]
    listed = f": {known(names, most=MAX_UNKNOWNS_IN_MESSAGE)}" if names else ""
    return (
        f"vᵀPv hardly decreases any more, yet unknowns still move (by up to {bound:.2g} σ): "
        f"some of them are nearly undetermined{listed}"
    )

"""An adjustment under way: its equations, its state and its datum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.base import Linearised
from ..types import Array, Mask
from .datum import Defect, FreeDatum
from .extra import NOTHING_MORE, Extra
from .extrapolation import NONE_TAKEN, Extrapolated
from .linear import LinearisedEquations, sum_of_squares
from .normal import NormalEquations, Solver


@dataclass(frozen=True)
class Looked:
    """What a shape was like when it was fitted anew without a smaller vᵀPv."""

    excess: float
    """Excess of vᵀPv of its rows over what chance explains, in units of its deviation."""
    rows: int
    """Number of its rows."""


@dataclass
class Run:
    """The changing values of an adjustment under way."""

    solver: Solver
    """How normal equations are factorised."""
    extra: Extra
    """Factors that the user added."""
    state: State
    """Present values of all variables."""
    start: State
    """Values x₀ that inner constraints refer to."""
    began: State
    """Values at which the adjustment began."""
    free: bool
    """Whether a free network is asked for."""
    constraint: Array
    """Terms that a minimal datum adds to the diagonal of N, (n_columns,)."""
    datum: FreeDatum | None = None
    """Inner constraints of a free network, once its defects are known."""
    defects: tuple[Defect, ...] = ()
    """Datum defects that were found."""
    at_solution: NormalEquations | None = None
    """Normal equations at the state; none: they have not been made."""
    smallest_pivot: float = 0.0
    """Smallest pivot of the last undamped step, relative to its diagonal element of N; 0: there was
    no undamped step."""
    drifting: tuple[tuple[str, str], ...] = ()
    """Kind and name of the undetermined unknowns of an iteration that ended without progress."""
    weighted: bool = False
    """Whether observations have factors on their weights."""
    damped: bool = False
    """Whether a step was damped, so that the start was not near the minimum."""
    may_go_astray: bool = False
    """Whether an iteration that ends where something is not determined that was at the start has
    not converged; otherwise it is a `DatumError`."""
    last: tuple[State, Mapping[int, Linearised]] | None = None
    """The state of the last vᵀPv and what `Equations.evaluated` returned for it, until a state is
    linearised: the evaluation of an accepted step is the next linearisation."""
    made: NormalEquations | None = None
    """Normal equations at the state at which it begins; none: they have not been made."""
    extrapolated: Extrapolated = NONE_TAKEN
    """The extrapolations that were taken."""
    looked: Mapping[str, Looked] = field(default_factory=dict)
    """Shapes that were fitted anew in vain, by name, see `shapes_anew`."""

    @classmethod
    def at(
        cls,
        equations: Equations,
        state: State,
        start: State,
        *,
        free: bool,
        extra: Extra = NOTHING_MORE,
        solver: Solver | None = None,
    ) -> Run:
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

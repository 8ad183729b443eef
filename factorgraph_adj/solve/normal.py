"""Normal equations of one linearisation, to be factorised with any addition to their diagonal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State
from ..models.base import Linearised
from ..types import Array
from .datum import FreeDatum
from .elimination import Layers, layers_of
from .factor import Elimination, Factor, Plan
from .linear import ExtraRows, LinearisedEquations
from .singular import SingularError
from .stiff import eased_diagonal
from .trust import SAMPLES, TRUSTED, held_well, refusal, sample, uncertainty

LARGEST_QR = 3000
"""Largest number of variables in the tree for which every factorisation is by QR."""
VANISHED = 1e-14
"""Pivot relative to its diagonal element of N that counts as zero in a Cholesky factorisation."""
POOR = 1e-10
"""Smallest relative pivot of the cameras' normal equations from which covariances are computed;
below it QR of all unknowns is used."""
VANISHED_QR = 1e-19
"""Pivot relative to its diagonal element of N that counts as zero in a QR factorisation, and for
single points, whose poor pivots come from the rows too (`reduction.factorise_points`)."""
ENLARGED = 4.0
"""Largest factor by which a minimal datum may enlarge a standard deviation; above it a better
minimal datum is chosen."""


@dataclass
class Solver:
    """How a network is factorised; poor pivots turn it to QR of all unknowns."""

    equations: Equations
    """The network."""
    plan: Plan
    """Layers of the elimination, and their index lists."""
    qr_everywhere: bool = False
    """Whether all unknowns are factorised by QR."""
    made: NormalEquations | None = None
    """Normal equations at the state at which an adjustment will begin, if they have been made with
    the weights there: its first step takes them away, so that they do not stay in memory."""
    probing: bool = True
    """Whether random probes check the covariances; figures on the way to a solution need none."""

    @classmethod
    def of(cls, equations: Equations, extra: Sequence[ExtraRows] = ()) -> Solver:
        """Divide a network with a user's factors into the layers of its elimination."""
        touched = np.zeros(equations.unknowns.n_columns, dtype=bool)
        for e in extra:
            touched[e.columns] = True
        layers = layers_of(equations, reduce_points=True, touched=touched)
        return cls(equations, Plan.of(equations, layers))

    def reweighted(self, equations: Equations, *, probing: bool = True) -> Solver:
        """Return the solver of the same equations with other weights; it shares the plan."""
        return replace(self, equations=equations, made=None, probing=probing)

    @property
    def layers(self) -> Layers:
        """Layers of the elimination."""
        return self.plan.layers

    def turn_to_qr(self) -> None:
        """Leave every unknown to GTSAM's QR."""
        nothing = np.zeros(self.equations.unknowns.n_columns, dtype=bool)
        self.plan = Plan(layers_of(self.equations, reduce_points=False, touched=nothing))
        self.qr_everywhere = True


class NormalEquations:
    """The normal matrix N and the right side at one state."""

    def __init__(
        self,
        solver: Solver,
        state: State,
        extra: Sequence[ExtraRows] = (),
        evaluated: Mapping[int, Linearised] | None = None,
    ) -> None:
        """Linearise at ``state``; the arguments are those of `LinearisedEquations`."""
        self.solver, self.state = solver, state
        self.system = LinearisedEquations(solver.equations, state, extra, evaluated)
        self.gradient = self.system.gradient()
        self.diagonal = self.system.diagonal()
        self._elimination: Elimination | None = None
        self._kept: tuple[Array, bool, Factor] | None = None
        self.smallest_pivot = 0.0
        """Smallest pivot of the last factorisation, relative to its diagonal element."""

    @property
    def elimination(self) -> Elimination:
        """What all factorisations have in common, in the present order of the solver."""
        if self._elimination is None:
            self._elimination = Elimination.of(self.system, self.solver.plan)
        return self._elimination

    @cached_property
    def eased(self) -> Array:
        """Diagonal of N without the stiffness of rigid mounts, see `stiff`, (n_columns,)."""
        return eased_diagonal(self.system, self.diagonal)

    @property
    def resolution(self) -> float:
        """Bound √(δᵀ diag(N) δ) of a movement by the units δ in the last digits of all values."""
        spacing = self.solver.equations.unknowns.spacing(self.state)
        return float(np.sqrt(self.diagonal @ spacing**2))

    def factorise(self, extra: Array, *, exact: bool = False, keep: bool = False) -> Factor:
        """Factorise N + diag(extra).

        Args:
            extra: added to the diagonal, (n_columns,).
            exact: whether covariances are needed. QR then factorises the tree even if it is
                large, and all unknowns if pivots are poor. Steps need less precision, as the next
                step corrects their errors.
            keep: whether the next factorisation with the same terms may be this one.

        Raises:
            SingularError: an unknown is not determined.
        """
        solver = self.solver
        qr = solver.qr_everywhere or exact or len(solver.layers.tree) <= LARGEST_QR
        if solver.qr_everywhere:
            factor = self._factorise(extra, qr=True, keep=keep)
            if factor.smallest_pivot(self.diagonal + extra, tree=1.0, point=1.0) <= VANISHED_QR:
                raise SingularError("a pivot vanished")
            return factor
        try:
            factor = self._factorise(extra, qr=qr, keep=keep)
        except SingularError:
            if not exact:
                raise
        else:
            # Pivots of the tree's QR are exact far below those of normal equations.
            worst = factor.smallest_pivot(
                self.diagonal + extra,
                tree=VANISHED / VANISHED_QR if qr else 1.0,
                point=(POOR if exact else VANISHED) / VANISHED_QR,
            )
            self.smallest_pivot = worst
            if worst > (POOR if exact else VANISHED):
                return factor
            if not exact:
                raise SingularError("a pivot vanished")
        solver.turn_to_qr()
        self._elimination = self._kept = None
        return self.factorise(extra, exact=exact)

    def reduced(self, extra: Array) -> Factor:
        """Factorise N + diag(extra) up to the columns that `Layers.kept` leaves to other parts.

        Raises:
            SingularError: an unknown of this part is not determined, even if the kept columns are
                known.
        """
        return self._factorise(extra, qr=True)

    def for_covariances(self, constraint: Array, datum: FreeDatum | None = None) -> Factor:
        """Factorise N with a minimal datum so that covariances are right.

        A free network gets a new minimal datum if the one of the iteration enlarges standard
        deviations, as rounding grows with their square. QR of all unknowns replaces a
        factorisation whose probes fail.

        Args:
            constraint: terms that the minimal datum of the iteration adds to the diagonal of N,
                (n_columns,).
            datum: inner constraints of a free network; none: the datum is given.

        Raises:
            SingularError: an unknown is not determined, or so weakly that covariances would be
                wrong.
        """
        if datum is not None:
            constraint = self.held_better(constraint, datum, exact=True)
        factor = self._probed(constraint)
        if factor.uncertainty > TRUSTED and not self.solver.qr_everywhere:
            self.solver.turn_to_qr()
            self._elimination = self._kept = None
            factor = self._probed(constraint)
        if factor.uncertainty > TRUSTED:
            raise SingularError(refusal(self.system, factor, self.diagonal))
        return factor

    def _probed(self, constraint: Array) -> Factor:
        factor = self.factorise(constraint, exact=True)
        if self.solver.probing:
            factor.uncertainty = uncertainty(self.system, factor)
        return factor

    def held_better(self, constraint: Array, datum: FreeDatum, *, exact: bool = False) -> Array:
        """Return the terms of a well chosen minimal datum on the diagonal of N, (n_columns,).

        Args:
            constraint: terms of any minimal datum; they are returned if this datum is good enough.
            datum: inner constraints of the free network.
            exact: whether a singular factorisation is repeated by QR of all unknowns; otherwise
                ``constraint`` is returned.

        Raises:
            SingularError: an unknown is not determined, and ``exact`` asks for an answer.
        """
        try:
            rough = self.factorise(constraint)
        except SingularError:
            if not exact:
                return constraint
            rough = self.factorise(constraint, exact=True)
        steps = sample(self.system, rough, SAMPLES)
        held, enlarged = held_well(datum, steps, self.diagonal)
        if enlarged <= ENLARGED:
            return constraint
        better = np.zeros_like(constraint)
        better[held] = self.diagonal[held]
        return better

    def _factorise(self, extra: Array, *, qr: bool, keep: bool = False) -> Factor:
        if self._kept is not None and self._kept[1] == qr and np.array_equal(self._kept[0], extra):
            return self._kept[2]
        factor = self.elimination.factorised(extra, qr=qr)
        self._kept = (extra.copy(), qr, factor) if keep else None
        return factor

"""One linearisation, ready to be factorised with any addition to its diagonal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State
from ..types import Array
from .factor import Factor
from .linear import ExtraRows, LinearSystem
from .plan import Plan, make_plan
from .reduction import Rays
from .tree import SingularError, TreeFactors

LARGEST_QR = 3000
"""Variables in the tree up to which every factorisation is by QR."""
POOR = 1e-10
"""What is left of a diagonal element, below which normal equations are not trusted and QR of
everything takes over."""
SINGULAR_QR = 1e-19
"""The same in a QR factorisation, below which an unknown counts as undetermined."""


@dataclass
class Solver:
    """How a network is factorised; turns to QR of everything when the pivots ask for it."""

    equations: Equations
    """The network."""
    plan: Plan
    """Who eliminates what."""
    rays: Rays | None
    """Index lists of the points that are reduced."""
    qr_everywhere: bool = False
    """Whether the pivots asked for it."""

    @classmethod
    def of(cls, equations: Equations, extra: Sequence[ExtraRows] = ()) -> Solver:
        """Plan the elimination of a network with a user's factors."""
        touched = np.zeros(equations.unknowns.n_columns, dtype=bool)
        for e in extra:
            touched[e.columns] = True
        plan = make_plan(equations, reduce_points=True, touched=touched)
        rays = Rays(equations, plan) if plan.reduced.any() else None
        return cls(equations, plan, rays)

    def turn_to_qr(self) -> None:
        """Leave every unknown to GTSAM's QR."""
        nothing = np.zeros(self.equations.unknowns.n_columns, dtype=bool)
        self.plan = make_plan(self.equations, reduce_points=False, touched=nothing)
        self.rays = None
        self.qr_everywhere = True


class NormalEquations:
    """N and the right side at one state."""

    def __init__(
        self, solver: Solver, state: State, extra: Sequence[ExtraRows] = ()
    ) -> None:
        """Linearise at ``state``."""
        self.solver = solver
        self.system = LinearSystem(solver.equations, state, extra)
        self.gradient = self.system.gradient()
        self.diagonal = self.system.diagonal()
        self._factors: TreeFactors | None = None

    def factorise(self, extra: Array, *, exact: bool = False) -> Factor:
        """Factorise N + diag(extra).

        Args:
            extra: added to the diagonal, (n_columns,).
            exact: QR for the tree even where it is large (for covariances).

        Raises:
            SingularError: an unknown is not determined.
        """
        solver = self.solver
        qr = solver.qr_everywhere or exact or len(solver.plan.tree) <= LARGEST_QR
        try:
            factor = self._factorise(extra, qr=qr)
            if self._smallest(factor, extra) > (SINGULAR_QR if solver.qr_everywhere else POOR):
                return factor
        except SingularError:
            if solver.qr_everywhere:
                raise
        if solver.qr_everywhere:
            raise SingularError("a pivot vanished")
        solver.turn_to_qr()
        self._factors = None
        return self.factorise(extra, exact=exact)

    def _factorise(self, extra: Array, *, qr: bool) -> Factor:
        if self._factors is None:
            self._factors = TreeFactors(self.solver.plan, self.system)
        return Factor(
            self.solver.plan, self.solver.rays, self.system, self._factors, extra, qr=qr
        )

    def _smallest(self, factor: Factor, extra: Array) -> float:
        pivots = factor.pivots(self.diagonal + extra)
        return float(pivots.min()) if len(pivots) else 1.0

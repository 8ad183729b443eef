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
from .rays import Rays
from .tree import SingularError, TreeFactors

LARGEST_QR = 3000
"""Variables in the tree up to which every factorisation is by QR."""
VANISHED = 1e-14
"""What is left of a diagonal element of N, relative, below which nothing is left of it."""
POOR = 1e-10
"""The same for the normal equations of the cameras, below which covariances are not trusted to
them and QR of everything takes over."""
POOR_POINT = 1e-12
"""The same for single points, whose poor pivot is nobody else's."""
VANISHED_QR = 1e-19
"""What is left of a diagonal element in a QR factorisation where nothing is left of it."""


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

    def __init__(self, solver: Solver, state: State, extra: Sequence[ExtraRows] = ()) -> None:
        """Linearise at ``state``."""
        self.solver, self.state = solver, state
        self.system = LinearSystem(solver.equations, state, extra)
        self.gradient = self.system.gradient()
        self.diagonal = self.system.diagonal()
        self._factors: TreeFactors | None = None
        self.smallest_pivot = 0.0
        """What was left of the weakest diagonal element in the last factorisation."""

    def factorise(self, extra: Array, *, exact: bool = False) -> Factor:
        """Factorise N + diag(extra).

        Args:
            extra: added to the diagonal, (n_columns,).
            exact: for covariances: QR for the tree even where it is large, and of everything
                where pivots are poor. A step that is a little wrong is corrected by the next.

        Raises:
            SingularError: an unknown is not determined.
        """
        solver = self.solver
        qr = solver.qr_everywhere or exact or len(solver.plan.tree) <= LARGEST_QR
        if solver.qr_everywhere:
            factor = self._factorise(extra, qr=True)
            if factor.smallest_pivot(self.diagonal + extra, tree=1.0, point=1.0) <= VANISHED_QR:
                raise SingularError("a pivot vanished")
            return factor
        try:
            factor = self._factorise(extra, qr=qr)
        except SingularError:
            if not exact:
                raise
        else:
            # Pivots of the tree's QR are exact far below those of normal equations.
            worst = factor.smallest_pivot(
                self.diagonal + extra,
                tree=VANISHED / VANISHED_QR if qr else 1.0,
                point=POOR / POOR_POINT if exact else 1.0,
            )
            self.smallest_pivot = worst
            if worst > (POOR if exact else VANISHED):
                return factor
            if not exact:
                raise SingularError("a pivot vanished")
        solver.turn_to_qr()
        self._factors = None
        return self.factorise(extra, exact=exact)

    def _factorise(self, extra: Array, *, qr: bool) -> Factor:
        if self._factors is None:
            self._factors = TreeFactors(self.solver.plan, self.system)
        return Factor(self.solver.plan, self.solver.rays, self.system, self._factors, extra, qr=qr)

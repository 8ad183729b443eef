"""One linearisation, ready to be factorised with any addition to its diagonal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State
from ..types import Array
from .datum import FreeDatum
from .elimination import Layers, layers_of
from .factor import Factor
from .linear import ExtraRows, LinearSystem
from .rays import Rays
from .tree import SingularError, TreeFactors
from .trust import SAMPLES, TRUSTED, held_well, refusal, sample, uncertainty

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
ENLARGED = 4.0
"""Factor by which a minimal datum may enlarge a standard deviation before a better one is taken."""


@dataclass
class Solver:
    """How a network is factorised; turns to QR of everything when the pivots ask for it."""

    equations: Equations
    """The network."""
    layers: Layers
    """Who eliminates what."""
    rays: Rays | None
    """Index lists of the points that are reduced."""
    qr_everywhere: bool = False
    """Whether the pivots asked for it."""

    @classmethod
    def of(cls, equations: Equations, extra: Sequence[ExtraRows] = ()) -> Solver:
        """Divide a network with a user's factors into the layers of its elimination."""
        touched = np.zeros(equations.unknowns.n_columns, dtype=bool)
        for e in extra:
            touched[e.columns] = True
        layers = layers_of(equations, reduce_points=True, touched=touched)
        rays = Rays(equations, layers) if layers.reduced.any() else None
        return cls(equations, layers, rays)

    def turn_to_qr(self) -> None:
        """Leave every unknown to GTSAM's QR."""
        nothing = np.zeros(self.equations.unknowns.n_columns, dtype=bool)
        self.layers = layers_of(self.equations, reduce_points=False, touched=nothing)
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
        qr = solver.qr_everywhere or exact or len(solver.layers.tree) <= LARGEST_QR
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

    def for_covariances(self, constraint: Array, datum: FreeDatum | None = None) -> Factor:
        """Factorise N with a minimal datum so that covariances are right.

        In a free network the minimal datum is chosen anew where that of the iteration enlarges
        standard deviations: rounding grows with their square. A factorisation whose probes fail
        is replaced by QR of everything.

        Args:
            constraint: what the minimal datum of the iteration adds to the diagonal of N,
                (n_columns,).
            datum: inner constraints of a free network; none where the datum is given.

        Raises:
            SingularError: an unknown is not determined, or so weakly that covariances would be
                wrong.
        """
        if datum is not None:
            constraint = self.held_better(constraint, datum, exact=True)
        factor = self._probed(constraint)
        if factor.uncertainty > TRUSTED and not self.solver.qr_everywhere:
            self.solver.turn_to_qr()
            self._factors = None
            factor = self._probed(constraint)
        if factor.uncertainty > TRUSTED:
            raise SingularError(refusal(self.system, factor, self.diagonal))
        return factor

    def _probed(self, constraint: Array) -> Factor:
        factor = self.factorise(constraint, exact=True)
        factor.uncertainty = uncertainty(self.system, factor)
        return factor

    def held_better(self, constraint: Array, datum: FreeDatum, *, exact: bool = False) -> Array:
        """Return what a well chosen minimal datum adds to the diagonal of N, (n_columns,).

        Args:
            constraint: what any minimal datum adds; it is returned where it holds well.
            datum: inner constraints of the free network.
            exact: QR of everything where there is no other answer; otherwise ``constraint`` is
                returned then.

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

    def _factorise(self, extra: Array, *, qr: bool) -> Factor:
        if self._factors is None:
            self._factors = TreeFactors(self.solver.layers, self.system)
        return Factor(
            self.solver.layers, self.solver.rays, self.system, self._factors, extra, qr=qr
        )

"""Normal equations at a state: Cholesky or QR, minimal datum; covariances probed, or refused.

N is factorised with any addition to its diagonal. A few random probes check the covariances of a
factorisation: with white noise Z of the whitened observations, X = Q Aᵀ Z are estimates whose
covariance is Q N Q = Q, and A X = H Z with H = A Q Aᵀ. H is a projector with every datum, as
N Q N = N is equivalent to H H = H. Rounding in the factorisation changes the eigenvalues 1 of H to
1 − ε. Each ε is the relative error of the variance of the function of the estimates that belongs to
its eigenvector; no function has a variance with a larger error than the largest |ε|. Each column of
H H Z − H Z contains every ε (1 − ε) times a standard normal number, so that its length shows the
largest. Two columns suffice if they are almost zero; otherwise more columns are used. The probes do
not see a function whose variance is lost almost entirely (ε ≈ 1): small pivots are judged before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import qr

from ..errors import InputError, SingularError
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.base import Linearised
from ..types import Array, Index
from .conjugate_gradients import NO_INVERSE
from .datum_defects import FreeDatum
from .elimination_layers import Layers, layers_of
from .factorisation import EliminationPlan, Factorisation, PreparedElimination
from .linearised_equations import ExtraRows, LinearisedEquations
from .rigid_mounts import diagonal_without_stiffness

FIRST_PROBES = 2
"""Number of probes of the first check. The probability that both show less than ε/1000 is 6e-7."""
MAX_CLEAN_PROBE_ERROR = 4e-7
"""Largest |H H z − H z| of the first check for which no second check follows. Variances then have
relative errors below 4e-4, and standard deviations half of that, with the probability of
`FIRST_PROBES`."""
SECOND_PROBES = 8
"""Number of probes of the second check. The probability that all show less than ε/5 is 4e-7."""
MAX_PROBE_ERROR = 1e-4
"""Largest |H H z − H z| of the second check for which covariances are returned. Variances then have
relative errors below 5e-4, with the probability of `SECOND_PROBES`."""
NOISE_SAMPLES = 4
"""Number of estimates from white noise whose root mean squares approximate standard deviations."""
PROBE_SEED = 1
"""Seed of the probes: the same network gives the same figures."""
MIN_HELD_SIGMA_RATIO = 1e-6
"""Standard deviation of an unknown that a datum holds, relative to the standard deviation that it
has if all others are held: below this value only rounding is left."""
MAX_UNKNOWNS_IN_REFUSAL = 5
"""Number of unknowns that a refusal names."""
MIN_CHOLESKY_PIVOT = 1e-14
"""Pivot relative to its diagonal element of N that counts as zero in a Cholesky factorisation."""
MIN_COVARIANCE_PIVOT = 1e-10
"""Smallest relative pivot of the cameras' normal equations from which covariances are computed;
below it QR of all unknowns is used."""
MIN_QR_PIVOT = 1e-19
"""Pivot relative to its diagonal element of N that counts as zero in a QR factorisation, and for
single points, whose poor pivots come from the rows too (`reduction.factorise_points`)."""
SINGULAR_AT_END = "the normal equations are singular where the iteration stopped"
"""Reason why a solution that has not converged may have no covariances."""
MAX_SIGMA_ENLARGEMENT = 4.0
"""Largest factor by which a minimal datum may enlarge a standard deviation; above it a better
minimal datum is chosen."""


def estimates_from_noise(
    system: LinearisedEquations,
    factor: Factorisation,
    n: int,
    source: np.random.Generator | None = None,
) -> Array:
    """Return n estimates X = Q AᵀZ from white noise of the observations, (n_columns, n).

    Args:
        system: the linearised network.
        factor: its normal equations, factorised, with a minimal datum where it has a defect.
        n: number of estimates.
        source: of the noise; None: one that begins again.
    """
    rows = system.equations.n_rows + sum(len(e.residual) for e in system.extra)
    source = np.random.default_rng(PROBE_SEED) if source is None else source
    return factor.solve(system.transposed(source.standard_normal((rows, n))))


def probed_variance_error(system: LinearisedEquations, factor: Factorisation) -> float:
    """Return the relative error of variances from a factorisation: the largest |H H z − H z|.

    Covariances may be returned if the error is at most `MAX_PROBE_ERROR`. A factorisation without
    error costs two solutions with `FIRST_PROBES` right sides.

    Args:
        system: the linearised network.
        factor: its normal equations, factorised, with a minimal datum where it has a defect.
    """
    found = _error(system, factor, FIRST_PROBES)
    return found if found <= MAX_CLEAN_PROBE_ERROR else _error(system, factor, SECOND_PROBES)


def _error(system: LinearisedEquations, factor: Factorisation, n: int) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        once = system.times(estimates_from_noise(system, factor, n))
        twice = system.times(factor.solve(system.transposed(once)))
        error = np.linalg.norm(twice - once, axis=0).max(initial=0.0)
    return float(error) if np.isfinite(error) else np.inf


def choose_minimal_datum(datum: FreeDatum, steps: Array, diagonal: Array) -> tuple[Index, float]:
    """Choose a minimal datum that enlarges standard deviations little.

    Rounding in Q grows with the squares of the terms that the minimal datum adds to two estimates:
    those on inner constraints over all unknowns in the metric of the diagonal of N, on which
    rounding of N acts, and those on the constraints of the datum, which the S-transformation
    computes as a small difference. Let σ be the smaller of the two standard deviations of each
    unknown. Holding the components h adds −G G_h⁻¹ x_h. If the rows g_i / σ_i of h span the
    largest volume, every element of σ_i⁻¹ g_i G_h⁻¹ σ_h is at most one. Pivoting approximates this
    choice.

    Args:
        datum: the undetermined motions, and the inner constraints.
        steps: estimates from white noise on any minimal datum, (n_columns, k); their root mean
            squares approximate standard deviations.
        diagonal: diagonal of N, (n_columns,).

    Returns:
        The columns to hold (d,), and the largest factor by which the minimal datum of ``steps``
        enlarges a σ.
    """
    candidates = np.flatnonzero(np.any(datum.basis != 0.0, axis=1) & (diagonal > 0.0))
    g, x, root = datum.basis[candidates], steps[candidates], np.sqrt(diagonal[candidates, None])
    over_all, _ = np.linalg.qr(root * g)
    inner = _size(x - over_all @ (over_all.T @ (root * x)) / root)
    on_datum = _size(x - g @ (datum.masked.T @ steps))
    sigma = np.maximum(np.minimum(inner, on_datum), MIN_HELD_SIGMA_RATIO / root[:, 0])
    spanned, _ = np.linalg.qr(g / sigma[:, None])
    _, _, order = qr(spanned.T, mode="economic", pivoting=True)
    enlarged = float((_size(x) / sigma).max(initial=1.0))
    return np.asarray(candidates[order[: g.shape[1]]], dtype=np.intp), enlarged


def _size(x: Array) -> Array:
    """Return the root mean square of each row."""
    return np.asarray(np.sqrt(np.mean(x**2, axis=1)))


def covariance_refusal(system: LinearisedEquations, factor: Factorisation, diagonal: Array) -> str:
    """Return the reason why covariances are refused, with the most weakly determined unknowns.

    Args:
        system: the linearised network.
        factor: its most precise factorisation, which is not precise enough.
        diagonal: diagonal of N, (n_columns,).
    """
    unknowns = system.unknowns
    weakness = _size(estimates_from_noise(system, factor, NOISE_SAMPLES)) * np.sqrt(diagonal)
    worst = sorted(
        ((float(weakness[unknowns.columns(k, i)].max()), k, i) for k, i in unknowns.active()),
        key=lambda item: -item[0],
    )
    names = ", ".join(
        f"{k} {unknowns[k].names[i]!r}" for _, k, i in worst[:MAX_UNKNOWNS_IN_REFUSAL]
    )
    return (
        "no covariances: the normal equations are so close to singular that rounding would change"
        f" variances by {factor.uncertainty:.1g} of their value ({MAX_PROBE_ERROR:.0e} is allowed);"
        f" weakest are {names}: observe them better (longer bases, more rays, distances), or hold"
        " them"
    )


@dataclass
class Solver:
    """How a network is factorised; poor pivots turn it to QR of all unknowns."""

    equations: Equations
    """The network."""
    plan: EliminationPlan
    """Layers of the elimination, and their index lists."""
    qr_everywhere: bool = False
    """Whether poor pivots have turned it to QR of all unknowns."""
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
        return cls(equations, EliminationPlan.of(equations, layers))

    def reweighted(self, equations: Equations, *, probing: bool = True) -> Solver:
        """Return the solver of the same equations with other weights; it shares the plan."""
        return replace(self, equations=equations, made=None, probing=probing)

    @classmethod
    def by_gradients(cls, equations: Equations, extra: Sequence[ExtraRows] = ()) -> Solver:
        """Return a solver by conjugate gradients, which has no covariances of all unknowns.

        Raises:
            InputError: the network has no points that only photos see.
        """
        touched = np.zeros(equations.unknowns.n_columns, dtype=bool)
        for e in extra:
            touched[e.columns] = True
        layers = layers_of(equations, reduce_points=True, touched=touched)
        if layers.by_qr or not layers.reduced.any():
            raise InputError(
                "conjugate gradients solve the normal equations of photos after those of points "
                f"that only photos see, and network {equations.network.name!r} has none; valid: "
                "solver='direct'"
            )
        return cls(equations, EliminationPlan.by_gradients(equations, layers))

    @property
    def iterative(self) -> bool:
        """Whether conjugate gradients solve the reduced system."""
        return bool(self.plan.clusters)

    @property
    def no_inverse(self) -> str:
        """Why a solution has no covariances, if it has none."""
        return NO_INVERSE if self.iterative else SINGULAR_AT_END

    @property
    def layers(self) -> Layers:
        """Layers of the elimination."""
        return self.plan.layers

    def turn_to_qr(self) -> None:
        """Factorise every unknown by QR."""
        layers = layers_of(self.equations, reduce_points=False, touched=self.layers.touched)
        self.plan = EliminationPlan.of(self.equations, layers)
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
        self._elimination: PreparedElimination | None = None
        self._kept: tuple[Array, Factorisation] | None = None
        self.smallest_pivot = 0.0
        """Smallest pivot of the last factorisation, relative to its diagonal element."""

    @property
    def elimination(self) -> PreparedElimination:
        """What all factorisations have in common, in the present order of the solver."""
        if self._elimination is None:
            self._elimination = PreparedElimination.of(self.system, self.solver.plan)
        return self._elimination

    @cached_property
    def eased(self) -> Array:
        """Diagonal of N without the stiffness of rigid mounts, see `stiff`, (n_columns,)."""
        return diagonal_without_stiffness(self.system, self.diagonal)

    @property
    def resolution(self) -> float:
        """Bound √(δᵀ diag(N) δ) of a movement by the units δ in the last digits of all values."""
        spacing = self.solver.equations.unknowns.spacing(self.state)
        return float(np.sqrt(self.diagonal @ spacing**2))

    def factorise(self, extra: Array, *, exact: bool = False, keep: bool = False) -> Factorisation:
        """Factorise N + diag(extra).

        Args:
            extra: added to the diagonal, (n_columns,).
            exact: whether covariances are needed. QR then factorises all unknowns if pivots are
                poor. Steps need less precision, as the next step corrects their errors.
            keep: whether the next factorisation with the same terms may be this one.

        Raises:
            SingularError: an unknown is not determined.
        """
        solver = self.solver
        if solver.iterative:
            factor = self._factorise(extra, keep=keep)
            pivot = factor.smallest_pivot(self.diagonal + extra)
            self.smallest_pivot = pivot
            if pivot <= MIN_CHOLESKY_PIVOT:
                raise SingularError("a pivot vanished")
            return factor
        if solver.qr_everywhere:
            factor = self._factorise(extra, keep=keep)
            if factor.smallest_pivot(self.diagonal + extra) <= MIN_QR_PIVOT:
                raise SingularError("a pivot vanished")
            return factor
        try:
            factor = self._factorise(extra, keep=keep)
        except SingularError:
            if not exact:
                raise
        else:
            # Pivots of QR are exact far below those of normal equations.
            worst = factor.smallest_pivot(
                self.diagonal + extra,
                fronts=MIN_CHOLESKY_PIVOT / MIN_QR_PIVOT if solver.layers.by_qr else 1.0,
                points=(MIN_COVARIANCE_PIVOT if exact else MIN_CHOLESKY_PIVOT) / MIN_QR_PIVOT,
            )
            self.smallest_pivot = worst
            if worst > (MIN_COVARIANCE_PIVOT if exact else MIN_CHOLESKY_PIVOT):
                return factor
            if not exact:
                raise SingularError("a pivot vanished")
        solver.turn_to_qr()
        self._elimination = self._kept = None
        return self.factorise(extra, exact=exact)

    def reduced(self, extra: Array) -> Factorisation:
        """Factorise N + diag(extra) up to the columns that `Layers.kept` leaves to other parts.

        Raises:
            SingularError: an unknown of this part is not determined, even if the kept columns are
                known.
        """
        return self._factorise(extra)

    def for_covariances(self, constraint: Array, datum: FreeDatum | None = None) -> Factorisation:
        """Factorise N with a minimal datum so that covariances are right.

        A free network gets a new minimal datum if the one of the iteration enlarges standard
        deviations, as rounding grows with their square. QR of all unknowns replaces a
        factorisation whose probes fail.

        Args:
            constraint: terms that the minimal datum of the iteration adds to the diagonal of N,
                (n_columns,).
            datum: inner constraints of a free network; None: the datum is given.

        Raises:
            SingularError: an unknown is not determined, or so weakly that covariances would be
                wrong.
        """
        if datum is not None:
            constraint = self.better_minimal_datum(constraint, datum, exact=True)
        factor = self._probed(constraint)
        exact = self.solver.qr_everywhere or self.solver.iterative
        if factor.uncertainty > MAX_PROBE_ERROR and not exact:
            self.solver.turn_to_qr()
            self._elimination = self._kept = None
            factor = self._probed(constraint)
        if factor.uncertainty > MAX_PROBE_ERROR:
            raise SingularError(covariance_refusal(self.system, factor, self.diagonal))
        return factor

    def _probed(self, constraint: Array) -> Factorisation:
        factor = self.factorise(constraint, exact=True)
        if self.solver.probing:
            factor.uncertainty = probed_variance_error(self.system, factor)
        return factor

    def better_minimal_datum(
        self, constraint: Array, datum: FreeDatum, *, exact: bool = False
    ) -> Array:
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
        steps = estimates_from_noise(self.system, rough, NOISE_SAMPLES)
        held, enlarged = choose_minimal_datum(datum, steps, self.diagonal)
        if enlarged <= MAX_SIGMA_ENLARGEMENT:
            return constraint
        better = np.zeros_like(constraint)
        better[held] = self.diagonal[held]
        return better

    def _factorise(self, extra: Array, *, keep: bool = False) -> Factorisation:
        if self._kept is not None and np.array_equal(self._kept[0], extra):
            return self._kept[1]
        factor = self.elimination.factorised(extra)
        self._kept = (extra.copy(), factor) if keep else None
        return factor

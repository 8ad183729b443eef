"""Predictions of left-out observations from accepted ones; innovation tests, alone and joined.

With the whitened innovation d of an observation or a correlated group (computed from the present
estimates − observed), its whitened partials A and the joint covariance Q of the variables it
touches:

    C = I + A Q Aᵀ              covariance of d
    T² = dᵀ C⁻¹ d               χ² with as many degrees of freedom as d has components
    w_i = (L⁻ᵀ C⁻¹ d)_i/√(L⁻ᵀ C⁻¹ L⁻¹)_ii

with Σ = L Lᵀ: w has the components of the observation, which are not the whitened ones in a
correlated group. These are the figures of the observation in an adjustment with it
(`quality.group_tests`), as M = C⁻¹. They need only values and cofactors of a linear system: both
engines have them.

Additional observations make C smaller, so that d_i²/C_ii ≤ T² with C_ii of any earlier moment is
necessary for T² to be small: most observations that still contradict are recognised by their
innovations alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..errors import AdjustmentError
from ..graph.dependence import Variable
from ..graph.equations import compile_rows
from ..graph.variables import State, Unknowns
from ..ledger.excerpts import excerpt
from ..ledger.ledger import Ledger
from ..models.unknown_registry import VariableKind
from ..quality.group_tests import LeaveOneOutTests, critical_t2
from ..solve.feasible_states import state_off_lines
from ..types import NO_ROWS, Array, Index
from .linear_system import LinearForms, LinearSystem, rows_of
from .rebase import notices_motion

SIGMA_SLACK = 1.05
"""Factor by which a σ may have grown since it was computed, because unknowns have moved."""
MAX_LINEARISED_TOGETHER = 32
"""Number of observations that are linearised and solved for together: solutions of more of them
take much memory in a large network."""
MIN_INNOVATION_VARIANCE = 0.99
"""Smallest eigenvalue of C with which a test is valid: C − I is a covariance, and smaller ones come
from cofactors that rounding has spoiled."""
UNANSWERED = (
    "what it touches is determined too weakly: rounding leaves no covariance of its innovation, "
    "and no test"
)
"""Why an observation that is left out has no test."""


NO_FIGURES: Array = np.zeros(0)


class InnovationTest(NamedTuple):
    """The test of an observation, or a correlated group, that is left out."""

    row: int
    """Its row in the ledger."""
    ratio: float
    """T²/critical."""
    w: float
    """The largest |w|."""
    innovation: Array = NO_FIGURES
    """Computed from what is accepted − observed, SI or image units, (k,); empty without a test."""
    sigma: Array = NO_FIGURES
    """Standard deviations of the innovation, (k,)."""
    of_components: Array = NO_FIGURES
    """Test values w with their signs, (k,)."""
    redundancy_numbers: Array = NO_FIGURES
    """Redundancy numbers that the components would have, diag(L C⁻¹ L⁻¹), (k,)."""

    @property
    def answered(self) -> bool:
        """Whether there is a test; otherwise T² and |w| are NaN, see `UNANSWERED`."""
        return not np.isnan(self.w)


def near_enough(ledger: Ledger, system: LinearSystem, rows: Index) -> Index:
    """Return which of some observations may fit at the present estimates, the nearest first.

    An innovation larger than √critical · σ of the last test still contradicts.

    Args:
        ledger: the ledger in which they are left out, with their verdicts.
        system: the system; it knows all variables that they touch.
        rows: the observations.
    """
    distance: dict[int, float] = {}
    for row, innovation in _innovations(ledger, system, rows):
        distance[row] = _distance(ledger, row, innovation)
    near = [row for row, far in distance.items() if far <= SIGMA_SLACK]
    return np.array(sorted(near, key=lambda row: distance[row]), dtype=np.intp)


def _distance(ledger: Ledger, row: int, innovation: Array) -> float:
    """Return the largest |d_i|/(√critical σ_i), with the σ of the last test; 0 without one."""
    verdicts = ledger.rows.verdicts.get(row, ())
    if not verdicts or any(v.sigma is None or not v.dof for v in verdicts):
        return 0.0
    sigma = np.concatenate([v.sigma for v in verdicts if v.sigma is not None])
    with np.errstate(invalid="ignore"):
        return float(np.max(np.abs(innovation) / sigma)) / float(np.sqrt(verdicts[0].critical))


def _innovations(ledger: Ledger, system: LinearSystem, rows: Index) -> Iterator[tuple[int, Array]]:
    """Iterate over observations with their innovations, in the units of the observations.

    Observations that are degenerate at the present estimates are left out.
    """
    if not len(rows):
        return
    try:
        equations = compile_rows(excerpt(ledger, system, rows, hold=False))
        state = state_off_lines(equations, equations.unknowns.start())
        equations = equations.weighted_at(state)
        v = equations.residuals(state)
    except AdjustmentError:
        if len(rows) > 1:
            for part in np.array_split(rows, 2):
                yield from _innovations(ledger, system, part)
        return
    found, raw = rows_of(ledger.units(rows), equations)
    for row, own, root in zip(rows.tolist(), found, raw, strict=True):
        yield row, root @ v[own]


def innovation_tests(
    ledger: Ledger, system: LinearSystem, rows: Index, alpha: float
) -> Iterator[InnovationTest]:
    """Iterate over the tests of observations between known variables, each alone.

    Observations that are degenerate at the present estimates are left out, and so are those
    sensitive to motions that the datum of a free network leaves open: no test controls these. A
    test without figures is that of an observation with unusable cofactors, see
    `InnovationTest.answered`.

    Args:
        ledger: the ledger in which they are left out.
        system: the system.
        rows: the observations.
        alpha: probability of a false alarm of one test.
    """
    for first in range(0, len(rows), MAX_LINEARISED_TOGETHER):
        for forms in _parts(ledger, system, rows[first : first + MAX_LINEARISED_TOGETHER]):
            yield from _tests(system, forms, alpha)


def _parts(ledger: Ledger, system: LinearSystem, rows: Index) -> Iterator[_Forms]:
    """Iterate over observations in parts that are linearised together.

    Observations that are degenerate at the present estimates are separate, or left out.
    """
    try:
        yield _Forms.of(ledger, system, rows)
    except AdjustmentError:
        for part in np.array_split(rows, 2) if len(rows) > 1 else ():
            yield from _parts(ledger, system, part)


def _tests(system: LinearSystem, forms: _Forms, alpha: float) -> Iterator[InnovationTest]:
    """Iterate over the tests of observations that were linearised together."""
    known = [i for i, own in enumerate(forms.of_units) if not forms.say_where_network_is(own)]
    groups = [forms.of_units[i] for i in known]
    found = _cofactors(system, forms, groups) if groups else []
    for i, own, q in zip(known, groups, found, strict=True):
        row, c = int(forms.ledger_rows[i]), np.eye(len(own)) + q
        yield _test(row, forms.v[own], c, forms.raw[i], alpha)


def _cofactors(system: LinearSystem, forms: _Forms, groups: Sequence[Index]) -> list[Array]:
    """Return A Q Aᵀ of units, given by their rows; NaN where there are no covariances."""
    try:
        return system.function_cofactors(forms.touched, forms.a, groups)
    except AdjustmentError:
        if len(groups) == 1:
            return [np.full((len(groups[0]),) * 2, np.nan)]
        return [q for own in groups for q in _cofactors(system, forms, [own])]


class JoinedRows(NamedTuple):
    """Accepted units and left-out units that are taken in, each against all others."""

    of_units: Sequence[Index]
    """Rows of each unit, in the order of the ledger."""
    v: Array
    """Residuals with all of them in, (k,)."""
    m: Array
    """Redundancy matrix M, (k, k)."""

    def tested(self) -> LeaveOneOutTests:
        """Return the units, to be tested and left out one after the other."""
        return LeaveOneOutTests(self.of_units, self.v, lambda u: self.m[:, u])


def joined(ledger: Ledger, system: LinearSystem, out: Index, inside: Index) -> JoinedRows | None:
    """Return left-out units, as if they were accepted, and accepted units: each against all others.

    With the rows S of what is left out and C = I + A_S Q A_Sᵀ:

        Q′ = Q − Q A_Sᵀ C⁻¹ A_S Q,   v′ = v − A Q A_Sᵀ C⁻¹ v_S,   M = I − A Q′ Aᵀ.

    None: an observation is degenerate, or determines the position of a free network.

    Args:
        ledger: the ledger.
        system: the system, without the left-out units.
        out: observations that are left out, between known variables.
        inside: accepted observations.
    """
    try:
        rows = np.union1d(out, inside)
        forms = _Forms.of(ledger, system, rows)
        every = np.arange(len(forms.v))
        if forms.say_where_network_is(every):
            return None
        (q,) = system.function_cofactors(forms.touched, forms.a, [every])
    except AdjustmentError:
        return None
    of_out = [forms.of_units[i] for i in np.flatnonzero(np.isin(rows, out)).tolist()]
    entering = np.concatenate(of_out)
    spread = q[:, entering]
    gain = spread @ np.linalg.inv(np.eye(len(entering)) + spread[entering])
    m = np.eye(len(q)) - q + gain @ spread.T
    v = forms.v - gain @ forms.v[entering]
    return JoinedRows(forms.of_units, v, m)


class _Forms(NamedTuple):
    """Observations between known variables, linearised together by those."""

    ledger_rows: Index
    """Rows of the units in the ledger."""
    of_units: Sequence[Index]
    """Rows of each unit."""
    raw: Sequence[Array]
    """L of each unit with Σ = L Lᵀ."""
    v: Array
    """Whitened residuals at the present estimates, (k,)."""
    a: Array
    """Whitened partials, (k, m)."""
    touched: Mapping[Variable, Index]
    """Components of variables that they touch, in the order of the columns."""
    motions: Array
    """Motions of these that the datum of a free network leaves open, (m, d)."""

    @classmethod
    def of(cls, ledger: Ledger, system: LinearSystem, rows: Index) -> _Forms:
        """Linearise observations by the unknowns of their own excerpt.

        Partials in a free network are those at the solution with its datum: cofactors and open
        motions belong to that state, and rows would seem to be sensitive to later rotations.

        Raises:
            AdjustmentError: names observations with degenerate geometry.
        """
        units = ledger.units(rows)
        equations = compile_rows(excerpt(ledger, system, rows, hold=False))
        unknowns = equations.unknowns

        def columns(kind: VariableKind, name: str) -> Index:
            return unknowns.columns(kind, unknowns[kind].number[name])

        def at(state: State) -> LinearForms:
            return LinearForms.of(units, equations, columns, lambda c: np.zeros(len(c)), state)

        state = unknowns.start()
        here, held = at(state), system.datum_solution
        if held is None or held.datum is None:
            touched = _touched(unknowns, here.columns)
            none = np.zeros((len(here.columns), 0))
            return cls(rows, here.rows, here.raw, here.v, here.a, touched, none)
        its = held.equations.unknowns
        there = at(unknowns.carried(state, its, held.state, where=unknowns.moving()))
        touched = _touched(unknowns, there.columns)
        of_base = [its.columns(v[0], its[v[0]].number[v[1]])[own] for v, own in touched.items()]
        motions = held.datum.motions[np.concatenate([NO_ROWS, *of_base])]
        return cls(rows, here.rows, here.raw, here.v, there.a, touched, motions)

    def say_where_network_is(self, rows: Index) -> bool:
        """Return whether rows are sensitive to motions left open by the datum of a free network."""
        return notices_motion(self.a[rows], self.motions)


def _touched(unknowns: Unknowns, columns: Index) -> dict[Variable, Index]:
    """Return the components of variables in the columns of an excerpt, in their order."""
    out: dict[Variable, Index] = {}
    for kind, number in unknowns.active():
        own = unknowns.columns(kind, number)
        if len(component := np.flatnonzero(np.isin(own, columns))):
            out[kind, unknowns[kind].names[number]] = component
    return out


def _test(row: int, v: Array, c: Array, raw: Array, alpha: float) -> InnovationTest:
    """Return the test of an observation with the covariance of its innovation."""
    if not (np.isfinite(c).all() and np.linalg.eigvalsh(c)[0] >= MIN_INNOVATION_VARIANCE):
        return InnovationTest(row, np.nan, np.nan)
    inverse, half = np.linalg.inv(c), np.linalg.inv(raw)
    e = inverse @ v
    with np.errstate(over="ignore"):
        ratio = float(e @ v) / critical_t2(alpha, len(e))
        w = half.T @ e / np.sqrt(np.diag(half.T @ inverse @ half))
    figures = raw @ v, np.sqrt(np.diag(raw @ c @ raw.T)), w, np.diag(raw @ inverse @ half)
    return InnovationTest(row, ratio, float(np.max(np.abs(w))), *figures)

"""Observations that are left out, each predicted from everything that is in.

With the whitened innovation d of an observation or a correlated group (computed from where
everything is by now − observed), its whitened partials A and the joint covariance Q of what it
touches:

    C = I + A Q Aᵀ              covariance of d
    T² = dᵀ C⁻¹ d               χ² with as many degrees of freedom as d has components
    w_i = (C⁻¹d)_i/√(C⁻¹)_ii

The same figures as those of the observation in an adjustment with it (`quality.leave_out`), as
M = C⁻¹. Nothing is asked of a linear system but values and cofactors: both engines have them.

What enters makes C smaller, so that d_i²/C_ii ≤ T² with C_ii of any earlier moment is necessary for
T² to be small: most of what still contradicts is recognised by its innovation alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np

from ..errors import AdjustmentError
from ..graph.dependence import Variable
from ..graph.equations import Equations, compile_rows
from ..graph.variables import State, Unknowns
from ..ledger.candidates import excerpt
from ..ledger.ledger import Ledger
from ..ledger.row_store import Unit
from ..models.variables import VariableKind
from ..quality.leave_out import Tested, critical_t2
from ..solve.starts_on_lines import beside_lines
from ..types import Array, Index
from .linear_forms import LinearForms, rows_of
from .linear_system import LinearSystem
from .rebase import notices_motion

SIGMA_SLACK = 1.05
"""Factor by which a σ may have grown since it was computed, as unknowns have moved."""


class InnovationTest(NamedTuple):
    """The test of an observation, or a correlated group, that is left out."""

    row: int
    """Its row in the ledger."""
    ratio: float
    """T²/critical."""
    w: float
    """The largest |w|."""


def near_enough(ledger: Ledger, system: LinearSystem, rows: Index) -> Index:
    """Return which of some observations may fit by now, the nearest first.

    An innovation larger than √critical · σ of the last test contradicts all the same.

    Args:
        ledger: where they are left out, with their verdicts.
        system: where everything is; it knows all that they touch.
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

    What has no answer where everything is by now is left out.
    """
    if not len(rows):
        return
    try:
        equations = compile_rows(excerpt(ledger, system, rows, hold=False))
        state = beside_lines(equations, equations.unknowns.start())
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

    What has no answer where everything is by now is left out, and so is what notices motions that
    the datum of a free network leaves open, or has cofactors that are not positive: no test tells
    of these.

    Args:
        ledger: where they are left out.
        system: where everything is.
        rows: the observations.
        alpha: probability of a false alarm of one test.
    """
    for row in rows.tolist():
        with suppress(AdjustmentError):
            units = ledger.units(np.array([row]))
            equations = compile_rows(excerpt(ledger, system, np.array([row]), hold=False))
            forms = _forms(system, equations, units)
            touched = _touched(equations.unknowns, forms.columns)
            if not _says_where_network_is(system, touched, forms.a):
                test = _test(row, forms, _cofactors(system, touched), alpha)
                if not np.isnan(test.w):
                    yield test


class JoinedRows(NamedTuple):
    """Units of which some are in and some are taken in, each against all others."""

    of_units: Sequence[Index]
    """Rows of each unit, in the order of the ledger."""
    v: Array
    """Residuals with all of them in, (k,)."""
    m: Array
    """Redundancy matrix M, (k, k)."""

    def tested(self) -> Tested:
        """Return the units, to be tested and left out one after the other."""
        return Tested(self.of_units, self.v, lambda u: self.m[:, u])


def joined(ledger: Ledger, system: LinearSystem, out: Index, inside: Index) -> JoinedRows | None:
    """Return units that are left out, as if they were in, and units that are in: each against all.

    With the rows S of what is left out and C = I + A_S Q A_Sᵀ:

        Q′ = Q − Q A_Sᵀ C⁻¹ A_S Q,   v′ = v − A Q A_Sᵀ C⁻¹ v_S,   M = I − A Q′ Aᵀ.

    None: something has no answer, or says where a free network is.

    Args:
        ledger: where they stand.
        system: where everything is, without what is left out.
        out: observations that are left out, between known variables.
        inside: observations that are in.
    """
    try:
        rows = np.union1d(out, inside)
        units = ledger.units(rows)
        equations = compile_rows(excerpt(ledger, system, rows, hold=False))
        forms = _forms(system, equations, units)
        touched = _touched(equations.unknowns, forms.columns)
        if _says_where_network_is(system, touched, forms.a):
            return None
        a, q = forms.a, _cofactors(system, touched)
    except AdjustmentError:
        return None
    of_out = [forms.rows[i] for i in np.flatnonzero(np.isin(rows, out)).tolist()]
    entering = np.concatenate(of_out)
    spread = a @ q @ a[entering].T
    gain = spread @ np.linalg.inv(np.eye(len(entering)) + spread[entering])
    m = np.eye(len(a)) - a @ q @ a.T + gain @ spread.T
    v = forms.v - gain @ forms.v[entering]
    return JoinedRows(forms.rows, v, m)


def _forms(system: LinearSystem, equations: Equations, units: Sequence[Unit]) -> LinearForms:
    """Linearise observations by the unknowns of their own excerpt.

    Partials in a free network are those at the solution with its datum: cofactors and open motions
    belong to that state, and rows would seem to notice what has turned since then.
    """
    unknowns = equations.unknowns

    def columns(kind: VariableKind, name: str) -> Index:
        return unknowns.columns(kind, unknowns[kind].number[name])

    def at(state: State) -> LinearForms:
        return LinearForms.of(units, equations, columns, lambda c: np.zeros(len(c)), state)

    here, held = at(unknowns.start()), system.datum_solution
    if held is None:
        return here
    its, moving = held.equations.unknowns, unknowns.moving()
    there = at(unknowns.carried(unknowns.start(), its, held.state, where=moving))
    return replace(here, a=there.a)


def _touched(unknowns: Unknowns, columns: Index) -> dict[Variable, Index]:
    """Return the components of variables that columns of an excerpt are, in their order."""
    out: dict[Variable, Index] = {}
    for kind, number in unknowns.active():
        own = unknowns.columns(kind, number)
        if len(component := np.flatnonzero(np.isin(own, columns))):
            out[kind, unknowns[kind].names[number]] = component
    return out


def _says_where_network_is(
    system: LinearSystem, touched: Mapping[Variable, Index], a: Array
) -> bool:
    """Return whether rows notice motions that the datum of a free network leaves open."""
    held = system.datum_solution
    if held is None or held.datum is None or not touched:
        return False
    its = held.equations.unknowns
    columns = [its.columns(v[0], its[v[0]].number[v[1]])[own] for v, own in touched.items()]
    return notices_motion(a, held.datum.motions[np.concatenate(columns)])


def _cofactors(system: LinearSystem, touched: Mapping[Variable, Index]) -> Array:
    """Return the joint cofactors of components of variables, (m, m)."""
    ends = np.cumsum([len(own) for own in touched.values()], dtype=np.intp)
    at = {v: np.arange(end - len(touched[v]), end) for v, end in zip(touched, ends, strict=True)}
    out = np.zeros((int(ends[-1]) if len(ends) else 0,) * 2)
    for a, b in combinations_with_replacement(touched, 2):
        block = system.cofactors(a, b)[np.ix_(touched[a], touched[b])]
        out[np.ix_(at[a], at[b])], out[np.ix_(at[b], at[a])] = block, block.T
    return out


def _test(row: int, forms: LinearForms, q: Array, alpha: float) -> InnovationTest:
    """Return the test of an observation with the joint cofactors of what it touches."""
    inverse = np.linalg.inv(np.eye(len(forms.v)) + forms.a @ q @ forms.a.T)
    e = inverse @ forms.v
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        ratio = float(e @ forms.v) / critical_t2(alpha, len(e))
        # Cofactors that rounding or a weak datum spoils leave no positive C: |w| is no number.
        w = float(np.max(np.abs(e) / np.sqrt(np.diag(inverse))))
    return InnovationTest(row, ratio, w)

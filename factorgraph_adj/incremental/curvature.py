"""Observations that fail a test on linear forms which do not hold as far as the test reaches.

A test value is as good as the linear form on which it stands. Where an unknown is determined
weakly, the observation may bend over the range that its σ leaves open by as much as its innovation
is: a distance from a station at the height of a point, whose height only a weak weight holds, has
no derivative by the height, and still depends on it. Such an observation is tested by adjusting
with it and without:

    T² = vᵀPv with − vᵀPv without,

with the same degrees of freedom and the same critical value. The adjustment with it begins where
the points are, and moved both ways along the direction in which they are weakest, by as much as
makes vᵀPv smallest.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from ..errors import AdjustmentError
from ..quality.leave_out import critical_t2
from ..solve.start import Start
from ..types import Array, Index
from .candidates import Candidates, known_in
from .inside import Inside
from .judging import accepted
from .ledger import Ledger
from .rebasing import Draft
from .rules import Rules
from .system import System
from .verdicts import Verdict

MOVES_TO_TRY = tuple(3.0**-k for k in range(13))
"""Moves at which vᵀPv is computed, relative to the farthest likely one."""
MAX_MOVE_IN_SIGMA = 3.0
"""Largest move of a point, relative to its largest σ, over which an observation may bend."""
MAX_MOVE_IN_EXTENTS = 10.0
"""Largest move, relative to the extent of the network: where a σ is larger, nothing holds the
point there."""
MIN_BEND_TO_RESIDUAL = 0.5
"""Smallest change of an observation by its bend, relative to its residual, from which on a test on
its linear form says nothing."""
MAX_RESIDUAL_IN_SIGMA = 1e12
"""Residual relative to σ from which no place of a point explains a reading."""
MAX_UNITS_TESTED = 8
"""Largest number of units that are tested so after one command: each takes an adjustment."""


def tested_by_adjusting(
    ledger: Ledger, system: System, rows: Index, rules: Rules, given: Collection[str]
) -> tuple[Ledger, System, list[Verdict]]:
    """Let observations enter that fit when everything is adjusted with them.

    Args:
        ledger: where they were left out.
        system: where everything is without them.
        rows: observations that failed a test on linear forms; those that do not bend, and those
            between unknowns that are not known any more, stay as they are.
        rules: the options.
        given: ids of observations that did not wait before.

    Returns:
        Ledger and system, and the verdicts on what has entered.
    """
    told: list[Verdict] = []
    if system.doubt or system.section is not None:
        return ledger, system, told
    ready = Candidates(ledger, known_in(system), rows).ready
    bent = [row for row in ready[-MAX_UNITS_TESTED:].tolist() if _bends(ledger, system, row)]
    # Together first: others than the first may tell which of two places is right.
    for part in [bent, *([row] for row in bent if len(bent) > 1)]:
        out = np.setdiff1d(np.array(part, dtype=np.intp), ledger.having("accepted"))
        if len(out) and (found := _with(ledger, system, out, rules)):
            base = found[1].base
            joint = Inside.of(base.normal(), base.factor, found[0].units(out), base)
            verdicts = list(accepted(joint, rules.alpha, given, gains=rules.datum == "given"))
            # One that contradicts must not hide in the sum of those that fit.
            if not any(v.test > 1.0 for v in verdicts):
                (ledger, system), told = found, [*told, *verdicts]
    return ledger, system, told


def _weakest(system: System, name: str) -> Array | None:
    """Return the farthest movement of a point that is likely, (3,) metres; none: it is held."""
    columns = system.columns("point", name)
    if not system.known("point", name) or not len(columns):
        return None
    values, vectors = np.linalg.eigh(system.cofactors(("point", name), ("point", name)))
    extent = float(np.linalg.norm(np.ptp(system.base.state["point"], axis=0)))
    farthest = min(
        MAX_MOVE_IN_SIGMA * np.sqrt(max(float(values[-1]), 0.0)), MAX_MOVE_IN_EXTENTS * extent
    )
    return np.asarray(vectors[:, -1] * farthest)


def _bends(ledger: Ledger, system: System, row: int) -> bool:
    """Return whether an observation bends by as much as it contradicts, within reach of a point."""
    try:
        forms = system.forms(ledger, np.array([row]))
    except AdjustmentError:
        return False
    with np.errstate(over="ignore"):
        size = float(np.linalg.norm(forms.v))
    if not size < MAX_RESIDUAL_IN_SIGMA:
        return False
    for name in forms.units[0].points:
        step = _weakest(system, name)
        if step is None:
            continue
        for moved in (step, -step):
            try:
                if forms.bend(name, moved) > MIN_BEND_TO_RESIDUAL * size:
                    return True
            except AdjustmentError:
                return True  # it has no answer there: nothing is less linear
    return False


def _with(
    ledger: Ledger, system: System, rows: Index, rules: Rules
) -> tuple[Ledger, System] | None:
    """Return ledger and system with observations; none where they do not fit."""
    points = dict.fromkeys(n for u in ledger.units(rows) for n in u.points)
    ledger = ledger.moved(rows, "accepted", "tested by adjusting")
    try:
        draft = Draft.of(ledger, system, rules.datum)
        for name in points:
            if (step := _weakest(system, name)) is not None:
                draft = replace(draft, start=_moved(draft, name, step))
        found = draft.adjusted(rules.datum)
    except AdjustmentError:
        return None
    if not isinstance(found, System) or not found.base.converged:
        return None
    dof = max(found.redundancy - system.redundancy, 1)
    fits = found.vtpv - system.vtpv <= critical_t2(rules.alpha, dof)
    return (ledger, found) if fits else None


def _moved(draft: Draft, name: str, step: Array) -> Start:
    """Return the start with a point moved both ways, if vᵀPv is smaller there."""
    number = draft.equations.unknowns["point"].number[name]
    return min(_places(draft.start, number, step), key=lambda start: _vtpv(draft, start))


def _places(start: Start, number: int, step: Array) -> Iterator[Start]:
    """Iterate over a start, and the same with a point moved both ways."""
    yield start
    for part in MOVES_TO_TRY:
        for sign in (1.0, -1.0):
            points = start.state["point"].copy()
            points[number] += sign * part * step
            yield replace(start, state={**start.state, "point": points})


def _vtpv(draft: Draft, start: Start) -> float:
    """Return vᵀPv at a start; infinite where an observation has no answer."""
    try:
        v = draft.equations.weighted_at(start.state).residuals(start.state)
    except AdjustmentError:
        return np.inf
    return float(v @ v)

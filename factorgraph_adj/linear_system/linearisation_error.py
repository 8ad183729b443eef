"""Errors of linear forms; systems kept near the minimum by gradient steps or a new base.

An examination (`factorgraph_adj.solve.linear_base`) computes the error of the gradient by the
linear forms of a base, and the change of variances; between two examinations both are predicted.
Where the remaining step comes near the promised accuracy, the state follows the gradient; where
variances do, or where that is not enough, only a new base is near enough to the minimum.

In small networks all observations are linearised again after every change: the Gauss-Newton step
from there is the error of the system, and its cofactors are compared with those of that state.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from ..errors import AdjustmentError, SingularError
from ..ledger.command_input import Options
from ..ledger.ledger import Ledger
from ..solve.linear_base import LinearisationDrift, largest_variance_error, missed_gradient
from ..solve.linearised_equations import LinearisedEquations
from ..types import NO_ROWS, Array
from .front_system import FrontSystem
from .linear_system import LinearForms, LinearSystem
from .rebase import Draft
from .section import Looked

STEP_SHARE = 0.5
"""Largest remaining step as a share of the promised accuracy, where σ̂0 is 1 or less. Where
residuals are large the minimum is further away than such a step, as second partials count too:
there it is this share divided by σ̂0."""
VARIANCE_ERROR_SHARE = 1.3
"""Largest relative error of a variance as a share of the promised accuracy. The error of a standard
deviation is half of it; the rest is a margin for what the power iteration misses."""
BORDER_SHARE = 0.3
"""Share of the remaining step by which rows of new unknowns may be wrong without an examination."""
EXAMINATION_WORK_RATIO = 0.1
"""Work of an examination of the whole, relative to an adjustment of it."""
MAX_SMALL_UNKNOWNS = 250
"""Largest number of unknowns of a network that is linearised again after every change: an
examination of its linear forms would take as long."""
ZERO_VARIANCE_RATIO = 1e-12
"""Variance relative to the conditional one up to which it is zero: a given datum leaves no smaller
one, and inner constraints none to a single datum point."""
SIGMA_SHARE = 0.9
"""Share of the promised accuracy by which a standard deviation may differ there."""


def within_accuracy(
    system: FrontSystem, accuracy: float, arrived: LinearForms | None = None
) -> FrontSystem | None:
    """Return a system, moved if need be, within ``accuracy`` of the minimum.

    None: only a new base is. Estimates follow the gradient at the present state; cofactors stay
    those of the base.

    Args:
        system: the system.
        accuracy: largest deviation, relative to σ.
        arrived: forms that have just joined the system.

    Raises:
        InputError: names observations that are degenerate at the present state.
    """
    found = _within(system, accuracy, arrived)
    return None if found is None else with_rest(found, accuracy)


def with_rest(system: FrontSystem, accuracy: float) -> FrontSystem | None:
    """Return a system whose linear forms hold for the unknowns outside its section.

    None: the whole has to be adjusted.

    Args:
        system: the system.
        accuracy: as for `within_accuracy`.

    Raises:
        InputError: as for `within_accuracy`.
    """
    section = system.section
    if section is None:
        return system
    bound, largest = largest_step(system, accuracy), VARIANCE_ERROR_SHARE * accuracy
    d, u = system.followed_by
    gained = _of_rest(system, section.root)
    if section.looked is not None:
        before, there, of_own = section.looked
        gone = d if before is None else d - before[section.columns]
        own = u.copy()
        own[: len(of_own)] -= of_own
        inner = section.inner(d - gone, u - own, gone, own)
        left, change = there.predicted(section.length(gone, own), gained, inner)
        if left <= bound and change <= largest:
            return system
    rest, _ = _look(system.rest, gained, system)
    drift = rest.drift
    assert drift is not None
    if drift.left <= bound and drift.turned <= largest:
        looked = Looked(rest.movement, drift, u)
        work = section.work + int(EXAMINATION_WORK_RATIO * section.base.equations.n_rays)
        return replace(system, section=replace(section, looked=looked, work=work))
    return None  # nor if figures are not finite


def largest_step(system: FrontSystem, accuracy: float) -> float:
    """Return the largest step, relative to σ, that may remain."""
    r = system.redundancy
    sigma0 = float(np.sqrt(system.vtpv / r)) if r > 0 else 1.0
    return STEP_SHARE * accuracy / max(1.0, sigma0)


def _within(
    system: FrontSystem, accuracy: float, arrived: LinearForms | None
) -> FrontSystem | None:
    """Return a system, see `within_accuracy`; unknowns outside its section are not examined."""
    bound, gained = largest_step(system, accuracy), _gained(system)
    largest = VARIANCE_ERROR_SHARE * accuracy
    # Without the rows that left, cofactors are at most this much larger: N' ≥ M_min N.
    larger = 1.0 / system.update.condition
    step, changed = 0.0, 0.0
    if arrived is not None and all(w.forms is not arrived for w in system.border.watched):
        step, change_of = arrived.missed(system.step_at(arrived.columns))
        changed = arrived.relative(change_of)
    if system.border.watched:
        n = system.lifted.size + np.arange(system.border.n)
        q = system.update.variance(n, np.eye(len(n)))
        border, gap, change = system.border.looked(system.step_at, q, BORDER_SHARE * bound, largest)
        system = replace(system, border=border)
        step, changed = float(np.hypot(step, gap)), float(np.hypot(changed, change))
    if not (step <= bound and changed <= largest):
        return None
    if system.drift is not None:
        ahead, inner = _since(system, system.drift.weights)
        left, change = system.drift.predicted(ahead, gained, inner)
        if step + np.sqrt(larger) * left <= bound and larger * change <= largest:
            return system
    looked, g = _look(system, gained)
    assert looked.drift is not None
    if not larger * looked.drift.turned <= largest:
        return None
    if step + looked.drift.left <= bound:
        return looked
    again, _ = _look(_following(looked, g), gained)
    assert again.drift is not None
    return again if step + again.drift.left <= bound else None


def _look(
    system: FrontSystem, gained: float, part: FrontSystem | None = None
) -> tuple[FrontSystem, Array]:
    """Examine the linear forms; return the system that stores how far they hold, and g.

    Args:
        system: the system.
        gained: largest factor by which a variance is smaller than that of the base.
        part: a section of the system, whose rows are not examined; None: there is none.
    """
    apart = NO_ROWS if part is None or part.section is None else part.section.rows
    here = system.base.normal().system
    extra = system.base.extra.at(here.equations, system.state).rows
    there = LinearisedEquations(here.equations, system.state, extra)
    g = missed_gradient(here, there, system.movement, apart)
    if system.followed is not None:
        g = g - system.followed
    left = _left(system, g, gained, part)
    length = _since(system, np.zeros(0))[0] + system.shifted
    before = system.drift
    curvature = left / length**2 if length > 0 else 0.0
    if before is not None and system.followed is not None:
        curvature = before.curvature
    elif before is not None:
        curvature = max(before.curvature, curvature)
    start = None if before is None else before.direction
    size, direction = largest_variance_error(here, there, system.lifted.factor, start, apart)
    rate = size / length if length > 0 else 0.0
    drift = LinearisationDrift(
        system.weights, left, size, length, curvature, rate, length, gained, direction
    )
    return replace(system, drift=drift), g


def _left(system: FrontSystem, g: Array, gained: float, part: FrontSystem | None) -> float:
    """Return a bound of the largest step h = −Q' g of an unknown, relative to its σ'.

    It is the smaller of two: |h| ≤ σ' √(gᵀ Q' g), as Q' is positive, and σ' ≥ σ/√gained.
    """
    lifted, update = system.lifted, system.update
    h = lifted.factor.solve(g[:, None])[:, 0]
    if part is not None:
        h += _by_section(part, g)
    elif len(update.signs):
        along = update.spread.T @ lifted.gradient(g, system.slots)
        h -= lifted.unknowns(update.spread @ (update.inverse @ along), system.slots)
    sigma = lifted.sigma
    largest = np.max(np.abs(h) / np.where(sigma > 0, sigma, np.inf), initial=0.0)
    return float(min(largest * np.sqrt(gained), np.sqrt(max(float(g @ h), 0.0))))


def _by_section(system: FrontSystem, g: Array) -> Array:
    """Return (Q' − Q) g of the whole, where Q' counts the section: [K G] (C' − C) [K G]ᵀ g.

    C and C' are the cofactors of T and u without it and with it.
    """
    section, at = system.section, system.of_rest
    assert section is not None
    along = section.coordinates(section.lifted.gradient(g, section.slots))
    now = system.update.times(at, along[None])[at, 0] - section.root @ (section.root.T @ along)
    m = len(section.columns)
    return section.movement(now[:m], now[m:])


def _gained(system: FrontSystem) -> float:
    """Return the largest factor by which rows that joined make a variance smaller.

    It is ‖D₊‖ of their information without new unknowns, whose rows are independent combinations of
    them: with new unknowns it is no larger.
    """
    joined = system.update.signs > 0
    if not joined.any():
        return 1.0
    return float(np.linalg.norm(system.update.inner[np.ix_(joined, joined)], 2))


def _of_rest(system: FrontSystem, root: Array) -> float:
    """Return the largest factor by which a section makes a variance of the rest smaller.

    With the cofactors L Lᵀ of T and u in the rest it is the largest eigenvalue of (L⁻¹ Q' L⁻ᵀ)⁻¹;
    as the unknowns outside follow them, none of their variances becomes smaller by more.
    """
    at = system.of_rest
    free = np.ones(len(at), dtype=bool)
    of_prior = system.base.extra.rows[0].columns
    free[: len(of_prior)] = system.unknowns.free[of_prior]
    if not free.any():
        return 1.0
    q = system.update.times(at, np.eye(len(at)))[at]
    half = solve_triangular(root, solve_triangular(root, q, lower=True).T, lower=True)
    least = np.linalg.eigvalsh(half[np.ix_(free, free)])[0]
    return max(1.0, 1.0 / max(float(least), np.finfo(float).tiny))


def _following(system: FrontSystem, g: Array) -> FrontSystem:
    """Return a system moved by the step of a gradient, with unchanged cofactors.

    The gradient moves the base by −Q g, where its rows have other residuals.
    """
    h = system.lifted.factor.solve(g[:, None])[:, 0]
    along = system.update.spread.T @ system.lifted.gradient(g, system.slots)
    update = replace(system.update, residuals=system.update.residuals - along)
    shifted = system.shifted + float(np.sqrt(max(float(g @ h), 0.0)))
    followed = g if system.followed is None else system.followed + g
    offset = system.shift - h
    return replace(system, update=update, offset=offset, followed=followed, shifted=shifted)


def _since(system: FrontSystem, then: Array) -> tuple[float, float]:
    """Return √(dxᵀN dx) of the movement dx by the update since its weights were ``then``.

    The second is dxᵀN dx' with the movement dx' until then.
    """
    w, before = system.weights.copy(), np.zeros(len(system.weights))
    before[: len(then)] = then
    w -= before
    moved = system.update.inner @ w - system.update.signs * w
    inner = float(before @ moved)
    if system.followed is not None:  # N dx of the base is the gradient that it followed
        along = system.update.spread.T @ system.lifted.gradient(system.followed, system.slots)
        inner += float(along @ w)
    return float(np.sqrt(max(float(w @ moved), 0.0))), inner


def is_small(system: LinearSystem) -> bool:
    """Return whether everything is linearised after every change."""
    return system.n_rows - system.redundancy <= MAX_SMALL_UNKNOWNS


def near_minimum(
    ledger: Ledger, system: FrontSystem, rules: Options, arrived: LinearForms | None = None
) -> FrontSystem | None:
    """Return a system, moved if need be, within the promised accuracy of the minimum.

    None: only a new base is.

    Args:
        ledger: the ledger.
        system: the system of the observations in the graph.
        rules: the options.
        arrived: forms that have just joined the system.

    Raises:
        InputError: names observations that are degenerate at the present state.
    """
    if system.section is not None or not is_small(system):
        return within_accuracy(system, rules.accuracy, arrived)
    try:
        return system if _is_near(ledger, system, rules) else None
    except (AdjustmentError, SingularError):
        return None


def _is_near(ledger: Ledger, system: FrontSystem, rules: Options) -> bool:
    """Return whether step and standard deviations are within the promised accuracy."""
    draft = Draft.of(ledger, system, rules.datum)
    unknowns = draft.equations.unknowns
    normal, constraint = draft.normal(system.base)
    factor = normal.factorise(constraint)
    n = unknowns.n_columns
    onto = np.eye(n)
    if (datum := draft.inner_constraints(system.base)) is not None:
        # Cofactors of a free network are on its inner constraints.
        onto -= datum.basis @ datum.masked.T
    solved = factor.solve(np.column_stack([normal.gradient, np.eye(n)]))
    variance = np.where(unknowns.free, np.diag(onto @ solved[:, 1:] @ onto.T), 0.0)
    there = variance * normal.diagonal > ZERO_VARIANCE_RATIO
    step = np.abs(onto @ solved[:, 0])[there] / np.sqrt(variance[there])
    if not np.max(step, initial=0.0) <= largest_step(system, rules.accuracy):
        return False
    own = np.zeros(n)
    for kind, number in unknowns.active():
        v = kind, unknowns[kind].names[number]
        columns = unknowns.columns(kind, number)
        found = np.diag(system.cofactors(v, v)) if len(columns) else NO_ROWS
        own[columns] = found[: len(columns)]
    ratio = np.sqrt(np.maximum(own[there], 0.0) / variance[there])
    return bool(np.max(np.abs(ratio - 1.0), initial=0.0) <= SIGMA_SHARE * rules.accuracy)

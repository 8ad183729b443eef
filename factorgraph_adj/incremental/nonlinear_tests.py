"""Tests of arrivals by readjustment, at mirror images, at other minima; doubts on sides of points.

Some readings alone determine on which of two sides a point is. Where a point fits as well at its
mirror image, one reading that fits on the other side only moves it there. If it is wrong, so is the
position, and no test shows it: the reading is accepted with a doubt, which lasts until another
reading determines the side as well. vᵀPv of the two sides, both without the reading, then differ by
more than the critical value of one degree of freedom. A later reading that contradicts may be the
right one of the two: its verdict names the one that it contradicts.

A test value is as good as its linear form. Where an unknown is weakly determined, the observation
may be nonlinear over the range of the unknown's σ by as much as its innovation: a distance from a
station at the height of a point whose height only a weak weight holds has no derivative by the
height, and still depends on it. Such an observation is tested by adjusting with it and without:

    T² = vᵀPv with − vᵀPv without,

with the same degrees of freedom and the same critical value. The adjustment with it begins at the
present points, or at a place where vᵀPv is smaller: moved both ways along the direction in which
they are weakest, or at the mirror image that fits the other observations as well (see
`solve.second_minimum`). Both vᵀPv are those of one side: those of the two sides without the
observation may differ by the critical value of one degree of freedom, which chance exceeds with a
probability of α/2 at most. An observation that moves a point to its other side, which nothing else
determines, is accepted with a doubt, as above.

Observations that arrive one by one determine an unknown from the first few of them, which several
values may fit, such as those of a frame that two points leave on either side; a gross error that
was accepted for a time may have led an unknown there, too. Later observations show which value is
right, and the iteration from the other one may end in a minimum of its own, at any distance. After
convergence the network is therefore also adjusted from approximate values of all accepted
observations, as `adjust` does it. The smaller vᵀPv counts, and the solution names the other one. In
large networks, where this takes as long as the rest, it is done where vᵀPv exceeds what chance
explains.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..errors import AdjustmentError
from ..graph.equations import Equations, compile_rows
from ..graph.variables import State
from ..ledger.command_input import Options
from ..ledger.excerpts import excerpt
from ..ledger.ledger import Ledger
from ..ledger.row_store import Unit
from ..ledger.verdicts import Side, Verdict
from ..ledger.waiting_observations import Candidates, NothingKnown, known_in
from ..linear_system.arrival_decisions import accepted_verdicts
from ..linear_system.front_system import FrontSystem
from ..linear_system.isam2_system import ISAM2System
from ..linear_system.joint_tests import RowsInBase
from ..linear_system.rebase import Draft
from ..network.network import DatumChoice
from ..orientation.choice_of_start import choose_start
from ..quality.group_tests import critical_t2
from ..solve.second_minimum import describe_other_minimum, mirror_midpoints, points_without_rays
from ..start.start_values import Start
from ..types import Array, Index

MIN_MOVE_IN_SIGMA = 3.0
"""Smallest move of a point, relative to its largest σ, that takes it to another side."""
MIN_PART_THAT_STAYS = 0.5
"""Part of that move that remains without the reading: with less there is no second side."""
MAX_MOVE_IN_SIGMA = 3.0
"""Largest move of a point, relative to its largest σ, over which an observation may be
nonlinear."""
MAX_MOVE_IN_EXTENTS = 10.0
"""Largest move, relative to the extent of the network: a larger σ means that nothing determines the
point there."""
MIN_BEND_TO_RESIDUAL = 0.5
"""Smallest change of an observation by its nonlinearity, relative to its residual, from which a
test on its linear form is meaningless."""
MAX_RESIDUAL_IN_SIGMA = 1e12
"""Residual relative to σ from which no position of a point explains a reading."""
MAX_UNITS_TESTED = 8
"""Largest number of units tested in this way after one command: each takes an adjustment."""
MAX_CHANCE_EXCESS = 4.0
"""Excess of vᵀPv over the redundancy r, in units of its standard deviation √(2r), from which a
network is also adjusted from approximate values."""
MIN_RELATIVE_DECREASE = 1e-6
"""Decrease of vᵀPv, relative to 1 + vᵀPv, from which another minimum counts as better."""
LARGE_NETWORK_UNKNOWNS = 3_000
"""Number of unknowns from which a network is large."""
MOVES_TO_TRY = tuple(3.0**-k for k in range(13))
"""Moves at which vᵀPv is computed, relative to the farthest probable one."""


def with_points_at(start: Start, places: Mapping[str, Iterable[float]]) -> Start:
    """Return a start with points elsewhere, (3,) metres each."""
    points = start.state["point"].copy()
    for name, place in places.items():
        points[start.unknowns["point"].number[name]] = list(place)
    return replace(start, state={**start.state, "point": points})


def adjusted_without(
    ledger: Ledger,
    system: FrontSystem,
    rows: Index,
    datum: DatumChoice,
    places: Mapping[str, Iterable[float]],
) -> FrontSystem | None:
    """Return the system without some readings, adjusted with points starting at other places.

    Points stay on the side where they start, whichever fits better. None: there is no minimum
    there.
    """
    try:
        draft = Draft.of(ledger.moved(rows, "waiting", "side"), system, datum)
        begin = with_points_at(draft.start, places)
        found = replace(draft, start=begin).adjusted(datum, other_sides=False)
    except AdjustmentError:
        return None
    return found if isinstance(found, FrontSystem) and found.converged else None


def changed_sides(
    before: FrontSystem, after: FrontSystem, here: FrontSystem, names: Iterable[str]
) -> list[Side]:
    """Return which points readings have moved to their other sides.

    Args:
        before: the system without the readings.
        after: with them.
        here: without them, adjusted from ``after``.
        names: points that may have moved.
    """
    out = []
    for name in names:
        was, at, stays = (s.value("point", name) for s in (before, after, here))
        if was is None or at is None or stays is None or not len(after.columns("point", name)):
            continue
        moved = float(np.linalg.norm(at - was))
        variances = np.diag(after.cofactors(("point", name), ("point", name)))
        if moved > MIN_MOVE_IN_SIGMA * float(np.sqrt(max(variances.max(), 0.0))) and (
            np.linalg.norm(stays - was) > MIN_PART_THAT_STAYS * moved
        ):
            out.append(Side(name, (float(was[0]), float(was[1]), float(was[2])), moved))
    return out


def with_current_sides(ledger: Ledger, system: FrontSystem | None, rules: Options) -> Ledger:
    """Return the ledger after a command, noting which of its readings still determine a side alone.

    Sides are examined of points whose observations the command has added, removed or changed.
    """
    if not ledger.sides:
        return ledger
    sides = {i: s for i, s in ledger.sides.items() if ledger.status(i) == "accepted"}
    own = set(ledger.find(ledger.sides).tolist())
    changed = {p for row in ledger.causes.keys() - own for p in ledger.unit(row).points}
    if system is not None and system.section is None and not system.doubt:
        for ident, side in sides.items():
            if side.point in changed:
                sides[ident] = replace(side, alone=_alone(ledger, system, ident, side, rules))
    return ledger if sides == ledger.sides else replace(ledger, sides=sides)


def _alone(ledger: Ledger, system: FrontSystem, ident: str, side: Side, rules: Options) -> bool:
    """Return whether no other reading determines the side of a point."""
    row = ledger.find([ident])
    here = adjusted_without(ledger, system, row, rules.datum, {})
    other = adjusted_without(ledger, system, row, rules.datum, {side.point: side.other})
    if here is None:
        return side.alone
    if other is None or not changed_sides(other, system, here, [side.point]):
        return False
    return abs(other.vtpv - here.vtpv) <= critical_t2(rules.alpha, 1)


def contradicted_reading(ledger: Ledger, system: FrontSystem, row: int, rules: Options) -> str:
    """Return a sentence on the reading without which a suspect fits, as it alone determines a side.

    Empty: there is none.
    """
    points, own = ledger.unit(row).points, np.array([row], dtype=np.intp)
    for ident, side in ledger.sides.items():
        if not side.alone or side.point not in points or ledger.status(ident) != "accepted":
            continue
        suspect, there = ledger.find([ident]), {side.point: side.other}
        both = ledger.moved(own, "accepted", "side")
        fits = adjusted_without(both, system, suspect, rules.datum, there)
        neither = adjusted_without(ledger, system, suspect, rules.datum, there)
        if fits is None or neither is None:
            continue
        dof = max(fits.redundancy - neither.redundancy, 1)
        if fits.vtpv - neither.vtpv <= critical_t2(rules.alpha, dof):
            return f"fits without {ident!r}, which alone determines the side of {side.point!r}"
    return ""


def side_doubts(ledger: Ledger) -> tuple[str, ...]:
    """Return sentences on the points of which one reading alone determines the side."""
    return tuple(
        f"{ident!r} alone determines the side of point {side.point!r}: without it, "
        f"{', '.join(f'{x:.4f}' for x in side.other)} fits as well, {side.moved:.3g} m away"
        for ident, side in ledger.sides.items()
        if side.alone and ledger.status(ident) == "accepted"
    )


def tested_by_readjustment(
    ledger: Ledger, system: FrontSystem, rows: Index, rules: Options, given: Collection[str]
) -> tuple[Ledger, FrontSystem, list[Verdict]]:
    """Let observations enter that failed a linear test and fit after a readjustment.

    T² = vᵀPv with − vᵀPv without ≤ χ²(1 − α, dof), on one side; see the module's docstring.

    Args:
        ledger: the ledger in which they were left out.
        system: the system without them.
        rows: observations that failed a test on linear forms; nearly linear ones, and those between
            unknowns that are no longer known, stay as they are.
        rules: the options.
        given: ids of observations that did not wait before.

    Returns:
        Ledger and system, and the verdicts on the observations that have entered.
    """
    accepted: list[Verdict] = []
    if system.doubt or system.section is not None:
        return ledger, system, accepted
    ready = Candidates(ledger, known_in(system), rows).ready
    last = ready[-MAX_UNITS_TESTED:]
    images = _images(ledger, system, last, rules) if len(last) else {}
    bent = [row for row in last.tolist() if _bends(ledger, system, row, images)]
    # Together first: others than the first may decide which of two places is right.
    for part in [bent, *([row] for row in bent if len(bent) > 1)]:
        out = np.setdiff1d(np.array(part, dtype=np.intp), ledger.having("accepted"))
        if len(out) and (found := _with(ledger, system, out, rules, images)):
            joint = RowsInBase.of_system(found[1], found[0].units(out))
            verdicts = list(
                accepted_verdicts(joint, rules.alpha, given, gains=rules.datum == "given")
            )
            # One that contradicts must not hide in the sum of those that fit.
            if not any(v.test > 1.0 for v in verdicts):
                doubts = {i: str(s) for i, s in found[0].sides.items() if s.alone}
                verdicts = [replace(v, doubt=doubts.get(v.id, "")) for v in verdicts]
                (ledger, system), accepted = found, [*accepted, *verdicts]
    return ledger, system, accepted


def may_bend(ledger: Ledger, system: ISAM2System, rows: Index) -> bool:
    """Return whether failed observations may be nonlinear enough for a test by readjustment.

    If none is, `tested_by_readjustment` would leave all as they are, and fronts take longer.

    Args:
        ledger: the ledger in which they were left out.
        system: the system without them.
        rows: the observations.
    """
    ready = Candidates(ledger, known_in(system), rows).ready[-MAX_UNITS_TESTED:]
    last = [row for row in ready.tolist() if ledger.unit(row).points]
    if not last:
        return False
    points = [("point", name) for row in last for name in ledger.unit(row).points]
    inside = Candidates(ledger, NothingKnown(), ledger.having("accepted"))
    try:  # weights of points, which could only refuse an image, are not examined
        beside = compile_rows(excerpt(ledger, system, inside.touching(points), hold=False))
        images = _mirror_images(ledger, beside, beside.unknowns.start(), ready)
    except AdjustmentError:
        return True
    return any(_bends(ledger, system, row, images) for row in last)


def _weakest(system: FrontSystem | ISAM2System, name: str) -> Array | None:
    """Return the farthest probable movement of a point, (3,) metres; None: it is held."""
    if not system.known("point", name) or not len(system.columns("point", name)):
        return None
    values, vectors = np.linalg.eigh(system.cofactors(("point", name), ("point", name)))
    farthest = min(
        MAX_MOVE_IN_SIGMA * np.sqrt(max(float(values[-1]), 0.0)),
        MAX_MOVE_IN_EXTENTS * system.extent,
    )
    return np.asarray(vectors[:, -1] * farthest)


def _images(ledger: Ledger, system: FrontSystem, rows: Index, rules: Options) -> dict[str, Array]:
    """Return the movements of points of observations to their mirror images, (3,) metres each.

    All observations in the graph count, and none that has left it.
    """
    if (solution := system.adjusted_solution) is not None:
        equations, state = solution.equations, solution.state
    else:
        try:
            draft = Draft.of(ledger, system, rules.datum)
        except AdjustmentError:
            return {}
        equations, state = draft.equations, draft.start.state
    return _mirror_images(ledger, equations, state, rows)


def _mirror_images(
    ledger: Ledger, equations: Equations, state: State, rows: Index
) -> dict[str, Array]:
    """Return the movements of points of observations to their mirror images in some equations."""
    unknowns = equations.unknowns["point"]
    candidates = np.zeros(len(unknowns.offset), dtype=bool)
    for unit in ledger.units(rows):
        candidates[[unknowns.number[n] for n in unit.points if n in unknowns.number]] = True
    candidates &= points_without_rays(equations)
    middles = mirror_midpoints(equations, state, candidates) if candidates.any() else {}
    return {unknowns.names[n]: 2.0 * (at - state["point"][n]) for n, at in middles.items()}


def _bends(
    ledger: Ledger, system: FrontSystem | ISAM2System, row: int, images: Mapping[str, Array]
) -> bool:
    """Return whether an observation is nonlinear by as much as it contradicts, near a point.

    So is one that fits at the mirror image of a point: its form holds on one side only.
    """
    try:
        forms = system.forms(ledger, np.array([row]))
    except AdjustmentError:
        return False
    with np.errstate(over="ignore"):
        size = float(np.linalg.norm(forms.v))
    if not size < MAX_RESIDUAL_IN_SIGMA:
        return False
    for name in forms.units[0].points:
        if name in images:
            with suppress(AdjustmentError):  # a station may be at the image
                if forms.misfit(name, images[name]) < MIN_BEND_TO_RESIDUAL * size:
                    return True
        step = _weakest(system, name)
        if step is None:
            continue
        for moved in (step, -step):
            try:
                if forms.bend(name, moved) > MIN_BEND_TO_RESIDUAL * size:
                    return True
            except AdjustmentError:
                return True  # it is degenerate there: nothing is less linear
    return False


def _with(
    ledger: Ledger, system: FrontSystem, rows: Index, rules: Options, images: Mapping[str, Array]
) -> tuple[Ledger, FrontSystem] | None:
    """Return ledger and system with observations; None where they do not fit."""
    units = ledger.units(rows)
    points = dict.fromkeys(n for u in units for n in u.points)
    ledger = ledger.moved(rows, "accepted", "tested by adjusting")
    try:
        draft = Draft.of(ledger, system, rules.datum)
        for name in points:
            if (step := _weakest(system, name)) is not None:
                ways = [sign * way * step for way in MOVES_TO_TRY for sign in (1.0, -1.0)]
                ways += [images[name]] if name in images else []
                draft = replace(draft, start=_moved(draft, name, ways))
        found = draft.adjusted(rules.datum)
    except AdjustmentError:
        return None
    if not isinstance(found, FrontSystem) or not found.converged:
        return None
    here = adjusted_without(ledger, found, rows, rules.datum, {})
    sides = [] if here is None else changed_sides(system, found, here, points)
    vtpv = min(system.vtpv, np.inf if here is None else here.vtpv)
    if here is not None and sides:
        vtpv = here.vtpv
        if vtpv - system.vtpv > critical_t2(rules.alpha, 1):
            return None  # by the others this is the wrong side
    dof = max(found.redundancy - system.redundancy, 1)
    if found.vtpv - vtpv > critical_t2(rules.alpha, dof):
        return None
    equal = abs(vtpv - system.vtpv) <= critical_t2(rules.alpha, 1)
    return replace(ledger, sides={**ledger.sides, **dict(_told_alone(units, sides, equal))}), found


def _told_alone(
    units: Sequence[Unit], sides: Iterable[Side], equal: bool
) -> Iterator[tuple[str, Side]]:
    """Iterate over the readings that moved points to their other sides, each the only one."""
    for side in sides:
        telling = [u for u in units if side.point in u.points]
        if len(telling) == 1:
            yield telling[0].ids[0], replace(side, alone=equal)


def _moved(draft: Draft, name: str, ways: Iterable[Array]) -> Start:
    """Return the start values with a point moved in one direction, if vᵀPv is smaller there."""
    at = draft.start.state["point"][draft.equations.unknowns["point"].number[name]]
    places = (with_points_at(draft.start, {name: at + way}) for way in ways)
    return min((draft.start, *places), key=lambda start: _vtpv(draft, start))


def _vtpv(draft: Draft, start: Start) -> float:
    """Return vᵀPv at start values; infinite where an observation is degenerate."""
    try:
        v = draft.equations.weighted_at(start.state).residuals(start.state)
    except AdjustmentError:
        return np.inf
    return float(v @ v)


def smaller_minimum(
    draft: Draft, found: FrontSystem, datum: DatumChoice, *, tolerances: Sequence[float]
) -> FrontSystem:
    """Return the system with the smaller vᵀPv: as found, or adjusted from approximate values.

    It names the other, if these are two minima.

    Args:
        draft: the whole network, with the previous estimates as start values.
        found: its converged system.
        datum: given or free.
        tolerances: bounds of the last step, as for `Draft.adjusted`.
    """
    if draft.equations.unknowns.n_columns > LARGE_NETWORK_UNKNOWNS and not exceeds_chance(found):
        return found
    with suppress(AdjustmentError):  # no approximate values, or nothing can be computed there
        values = choose_start(draft.equations, datum, None).state
        begin = Start(draft.equations.unknowns, values, draft.start.origin)
        readjusted = replace(draft, start=begin).adjusted(datum, tolerances=tolerances)
        if isinstance(readjusted, FrontSystem) and readjusted.converged:
            least = MIN_RELATIVE_DECREASE * (1.0 + min(found.vtpv, readjusted.vtpv))
            if readjusted.vtpv < found.vtpv - least:
                return _with_other(readjusted, found)
            if found.vtpv < readjusted.vtpv - least:
                return _with_other(found, readjusted)
    return found


def _with_other(system: FrontSystem, other: FrontSystem) -> FrontSystem:
    """Return a converged system whose solution names another minimum."""
    return system.with_second_place(describe_other_minimum(system.solution, other.solution))


def exceeds_chance(system: FrontSystem) -> bool:
    """Return whether vᵀPv is larger than chance explains."""
    r = system.redundancy
    return r > 0 and system.vtpv - r > MAX_CHANCE_EXCESS * np.sqrt(2.0 * r)

"""Readings that alone tell on which of two sides a point is.

Where a point fits as well at its mirror image, one reading that fits on the other side only moves
it there. If it is wrong, so is the place, and nothing shows it: the reading is accepted with a
doubt, which lasts until another reading tells the side as well. vᵀPv of the two sides, both without
the reading, then differ by more than the critical value of one degree of freedom. A later reading
that contradicts may be the right one of the two: its verdict names the one that it contradicts.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from ..errors import AdjustmentError
from ..network.network import DatumChoice
from ..quality.leave_out import critical_t2
from ..solve.start import Start
from ..types import Index
from .ledger import Ledger
from .rebasing import Draft
from .rules import Rules
from .system import System
from .verdicts import Side

MIN_MOVE_IN_SIGMA = 3.0
"""Smallest move of a point, relative to its largest σ, that takes it to another side."""
MIN_PART_THAT_STAYS = 0.5
"""Part of that move which is left once the reading is out: with less there is no second side."""


def with_points_at(start: Start, places: Mapping[str, Iterable[float]]) -> Start:
    """Return a start with points elsewhere, (3,) metres each."""
    points = start.state["point"].copy()
    for name, place in places.items():
        points[start.unknowns["point"].number[name]] = list(place)
    return replace(start, state={**start.state, "point": points})


def without(
    ledger: Ledger,
    system: System,
    rows: Index,
    datum: DatumChoice,
    places: Mapping[str, Iterable[float]],
) -> System | None:
    """Return the system without some readings, adjusted with points at other places to begin with.

    Points stay on the side where they begin, whichever fits better. None: it has no minimum there.
    """
    try:
        draft = Draft.of(ledger.moved(rows, "waiting", "side"), system, datum)
        begin = with_points_at(draft.start, places)
        found = replace(draft, start=begin).adjusted(datum, other_sides=False)
    except AdjustmentError:
        return None
    return found if isinstance(found, System) and found.base.converged else None


def other_sides(before: System, after: System, here: System, names: Iterable[str]) -> list[Side]:
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


def examined(ledger: Ledger, system: System | None, rules: Rules) -> Ledger:
    """Return the ledger after a command, with which of its readings still tell a side alone.

    Sides of points are looked at of which anything has come, left or changed.
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


def _alone(ledger: Ledger, system: System, ident: str, side: Side, rules: Rules) -> bool:
    """Return whether nothing but a reading tells the side of a point."""
    row = ledger.find([ident])
    here = without(ledger, system, row, rules.datum, {})
    other = without(ledger, system, row, rules.datum, {side.point: side.other})
    if here is None:
        return side.alone
    if other is None or not other_sides(other, system, here, [side.point]):
        return False
    return abs(other.vtpv - here.vtpv) <= critical_t2(rules.alpha, 1)


def contradicted(ledger: Ledger, system: System, row: int, rules: Rules) -> str:
    """Return a sentence on the reading without which a suspect fits, as it alone tells a side.

    Empty: there is none.
    """
    points, own = ledger.unit(row).points, np.array([row], dtype=np.intp)
    for ident, side in ledger.sides.items():
        if not side.alone or side.point not in points or ledger.status(ident) != "accepted":
            continue
        told, there = ledger.find([ident]), {side.point: side.other}
        both = ledger.moved(own, "accepted", "side")
        fits = without(both, system, told, rules.datum, there)
        neither = without(ledger, system, told, rules.datum, there)
        if fits is None or neither is None:
            continue
        dof = max(fits.redundancy - neither.redundancy, 1)
        if fits.vtpv - neither.vtpv <= critical_t2(rules.alpha, dof):
            return f"fits without {ident!r}, which alone tells the side of {side.point!r}"
    return ""


def doubts(ledger: Ledger) -> tuple[str, ...]:
    """Return sentences on the points of which one reading alone tells the side."""
    return tuple(
        f"{ident!r} alone tells the side of point {side.point!r}: without it, "
        f"{', '.join(f'{x:.4f}' for x in side.other)} fits as well, {side.moved:.3g} m away"
        for ident, side in ledger.sides.items()
        if side.alone and ledger.status(ident) == "accepted"
    )

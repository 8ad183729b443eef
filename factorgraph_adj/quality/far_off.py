"""Readings that are far off: whether they have led data snooping astray.

A reading that belongs to another point, or was read in the other face, bends the adjustment of
everything so far that the largest test values are those of good readings, and other ones are set
aside. At the approximate values such a reading is far off all the same, and the good ones are not.
So the search is made a second time from there, and the simpler of the two results counts.
"""

from __future__ import annotations

from collections import Counter

from ..observations import KINDS
from ..solve.solution import Solution
from ..solve.start import Start
from .causes.readings import Readings
from .rejections import Snooping
from .snooping_search import SnoopingSearch

FAR = 1000.0
"""Smallest test value of a reading that is far off: a gross error of this size is one of several
degrees or decimetres, for which the linear model of the tests no longer holds."""


def astray(search: SnoopingSearch, found: Snooping) -> bool:
    """Return whether readings that are far off may have led a search astray.

    A single reading that is far off, with which everything else fits, is one gross error. What
    fits as something else, as a whole, is an exchange. It is otherwise if readings that are far
    off stay, or if several that share a point were set aside. Image points do not count: a block
    of photos has no minimum near poor approximate values.

    Args:
        search: the search, at its end.
        found: its result.
    """
    stays = {u.id for u in found.unresolved if abs(u.test) > FAR}
    gone = {r.id for r in found.rejected if abs(r.test) > FAR}
    if not stays and len(gone) < 2:
        return False
    ends = _ends(search)
    if not stays.isdisjoint(ends):
        return True
    explained = {ident for match in search.matches() for ident in match.ids}
    points = Counter(end for ident in gone - explained if ident in ends for end in ends[ident])
    return any(n > 1 for n in points.values())


End = tuple[str, int]
"""An end of a sight: the kind of the unknown, and its number."""


def _ends(search: SnoopingSearch) -> dict[str, frozenset[End]]:
    """Return what readings join, by id: the station and the target, or the frame and the place."""
    equations = search.equations
    r = Readings.of(equations, search.solution.state)
    ids = (equations.id(int(row)) for row in r.row)
    ends = zip(r.station.tolist(), r.target.tolist(), strict=True)
    out: dict[str, frozenset[End]] = {
        ident: frozenset({("point", a), ("point", b)})
        for ident, (a, b) in zip(ids, ends, strict=True)
    }
    for block in equations.blocks:
        record = KINDS.get(block.kind)
        if block.prior or record is None or record.tells == "nothing":
            continue
        (_, frame), (what, place) = block.variables[:2]
        pairs = zip(block.ids, frame.tolist(), place.tolist(), strict=True)
        out |= {i: frozenset({("frame", f), (str(what), p)}) for i, f, p in pairs}
    return out


def approximate_values(solution: Solution) -> Start:
    """Return the values from which an adjustment began, as the start of another."""
    return Start(solution.equations.unknowns, solution.start, solution.start)


def simpler(one: SnoopingSearch, a: Snooping, other: SnoopingSearch, b: Snooping) -> Snooping:
    """Return the result that takes less to explain, the first of two that take as much.

    What takes less is, in this order: fewer observations that do not fit and stay, fewer sights
    with readings set aside, fewer observations set aside.

    Args:
        one: the first search, at its end.
        a: its result.
        other: the second search, at its end.
        b: its result.
    """
    return b if _effort(other, b) < _effort(one, a) else a


def _effort(search: SnoopingSearch, found: Snooping) -> tuple[int, int, int]:
    ends = _ends(search)
    aside = search.ids_aside()
    sights = {ends.get(ident, ident) for ident in aside}
    return len(found.unresolved), len(sights), len(aside)

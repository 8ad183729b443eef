"""Sights that are possible now: from stations that are set up to every point, levelling, GNSS.

What a station reads together is one sight. Levelled differences are those between neighbouring
points. `factorgraph_adj.planning.sight_templates` has the observations that are repeated.

The rows of all sights are evaluated at once, as blocks of the models of the kinds: no observation
is made before it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from scipy.spatial import KDTree

from ..errors import InputError, Problem, known
from ..graph.blocks import Block
from ..ledger.ledger import Ledger
from ..linear_system.cofactor_columns import UNKNOWN, CofactorColumns
from ..linear_system.linear_system import LinearSystem
from ..linear_system.rebase import MIN_NOTICED_MOTION
from ..observations import Observation
from ..observations.base import Sight
from ..observations.positions import ControlPoint
from ..types import Array, Index, Mask
from .candidates import Candidate
from .sight_templates import Places, SightMemory
from .targets import matching

NEIGHBOURS = 6
"""Number of nearest points to which levelled differences are possible from each point."""
LEAST_LENGTH = 1e-3
"""Shortest sight, metres."""
POINT = 3
"""Number of coordinates of a point."""


@dataclass(frozen=True, eq=False)
class PossibleSights:
    """m sights of at most d whitened rows each, in w columns of the cofactors."""

    a: Array
    """Partials, (m, d, w); zero in rows that say nothing of determined unknowns."""
    columns: Index
    """Columns, −1: none, (m, w)."""
    points: Index
    """Point at which each sight ends, whose columns are the last three, (m,); −1: none."""
    make: Callable[[int], Candidate]
    """Returns a sight as a candidate."""
    lacks: Mask
    """Whether a row of the sight needs something that is not determined, (m,)."""
    determines: Index
    """New point that a sight would determine, (m,); −1: none."""
    kinds: tuple[str, ...] = ()
    """Kinds of readings."""
    reads: Mask | None = None
    """Which of these each sight reads, (m, kinds); None: all."""
    costs: Array | None = None
    """Costs, (m,); None: they follow from the kinds."""

    @property
    def n(self) -> int:
        """Number of sights."""
        return len(self.a)

    def cost_of(self, costs: Mapping[str, float] | None) -> Array:
        """Return the cost of each sight, (m,).

        Args:
            costs: cost of a reading of each kind, 1 for others; None: each sight has the cost 1.
        """
        if self.costs is not None:
            return self.costs
        if costs is None:
            return np.ones(self.n)
        each = np.array([costs.get(k, 1.0) for k in self.kinds])
        if self.reads is None:
            return np.full(self.n, each.sum())
        return np.asarray(self.reads @ each)


Slot: TypeAlias = tuple[str, str, str]
"""Kind of a variable, its attribute, and kind of the observation (empty for ends of sights)."""


class RowBuilder:
    """Rows of m sights that end at points."""

    def __init__(self, places: Places, m: int, d: int) -> None:
        """Begin without rows."""
        self.places, self.m, self.d = places, m, d
        self.slots: dict[Slot, tuple[Array, Index]] = {}

    def add(self, number: int, which: Index, block: Block) -> None:
        """Take the rows of a block as row ``number`` of the sights ``which``."""
        rows, by_role = self.places.partials(block)
        which = which[rows]
        for (kind, index), name, a in zip(block.variables, block.named, by_role, strict=False):
            end = name in ("station", "target")
            slot = (kind, name, "" if end else block.kind)
            columns = self.places.of_kind(kind)[index[rows]][:, : a.shape[2]]
            if not (columns >= -1).all() or (columns >= 0).any():
                if slot not in self.slots:
                    width = a.shape[2]
                    empty = np.zeros((self.m, self.d, width))
                    self.slots[slot] = empty, np.full((self.m, width), -1, dtype=np.intp)
                into, of = self.slots[slot]
                into[which, number] = a[:, 0]
                of[which] = columns

    def rows(self, last: Slot) -> tuple[Array, Index, Mask]:
        """Return partials (m, d, w), columns (m, w), and which rows say something, (m, d).

        Args:
            last: slot whose columns come last.
        """
        empty = np.zeros((self.m, self.d, POINT)), np.full((self.m, POINT), -1, dtype=np.intp)
        order = [*(s for k, s in self.slots.items() if k != last), self.slots.get(last, empty)]
        a = np.concatenate([x for x, _ in order], axis=2)
        columns = np.concatenate([c for _, c in order], axis=1)
        a = np.where((columns == -1)[:, None, :], 0.0, a)
        lost = ((columns == UNKNOWN)[:, None, :] & (a != 0.0)).any(axis=2)
        return a, columns, lost


def _finished(
    places: Places,
    builder: RowBuilder,
    ends: Index,
    make: Callable[[int], Candidate],
) -> PossibleSights:
    """Return the rows of sights without what says nothing of determined unknowns."""
    a, columns, lost = builder.rows(("point", "target", ""))
    new = (places.columns[ends] == UNKNOWN).any(axis=1)
    determines = np.full(len(ends), -1, dtype=np.intp)
    only_new = (columns[:, :-POINT] != UNKNOWN).all(axis=1)
    some = np.flatnonzero(new & only_new)
    if len(some):
        free = places.columns[ends[some]] == UNKNOWN
        part = np.where(free[:, None, :], a[some, :, -POINT:], 0.0)
        rank = np.linalg.matrix_rank(part)
        determines[some] = np.where(rank >= free.sum(axis=1), ends[some], -1)
    told = np.where(lost[:, :, None], 0.0, a)
    motions = places.cofactors.motions
    if motions.shape[1]:
        g = np.where((columns >= 0)[:, :, None], motions[columns], 0.0)
        far = np.abs(told @ g) > MIN_NOTICED_MOTION * (np.abs(told) @ np.abs(g)) + 1e-300
        told = np.where(far.any(axis=2)[:, :, None], 0.0, told)
    columns = np.where(columns >= 0, columns, -1)
    lacks: Mask = np.asarray(lost.any(axis=1))
    return PossibleSights(told, columns, ends, make, lacks, determines)


def _near(places: Places, stations: Index, targets: Index, reach: float) -> tuple[Index, Index]:
    """Return pairs of a station (its place among the given ones) and a point within reach."""
    at = places.coordinates
    there: Mask = np.asarray(np.isfinite(at).all(axis=1))
    begin, ends = np.flatnonzero(there[stations]), targets[there[targets]]
    if not len(begin) or not len(ends):
        return begin[:0], ends[:0]
    tree = KDTree(at[ends])
    near: Any = tree.query_ball_point(at[stations[begin]], reach, return_sorted=True)
    found = [np.array(each, dtype=np.intp) for each in near]
    first, second = np.repeat(begin, list(map(len, found))), ends[np.concatenate(found)]
    far = np.linalg.norm(at[second] - at[stations[first]], axis=1) > LEAST_LENGTH
    return first[far], second[far]


def station_sights(
    places: Places,
    numbers: Mapping[str, Mapping[str, int]],
    originals: Sequence[Observation],
    targets: Collection[str] | None,
    reach: float,
    *,
    singly: bool,
) -> PossibleSights | None:
    """Return the sights from stations to points; None: there are none.

    Args:
        places: values and columns.
        numbers: template of each kind, for each station.
        originals: the templates.
        targets: names of the points; None: all.
        reach: largest length of a sight, metres.
        singly: whether each reading is a sight of its own; otherwise everything that a station
            reads is one.
    """
    at_name = {n: i for i, n in enumerate(places.names)}
    names = [s for s in numbers if s in at_name]
    wanted = np.array([targets is None or n in targets for n in places.names], dtype=bool)
    stations = np.array([at_name[s] for s in names], dtype=np.intp)
    first, ends = _near(places, stations, np.flatnonzero(wanted), reach)
    if not len(first):
        return None
    kinds = sorted({k for own in numbers.values() for k in own})
    template = np.array([[numbers[s].get(k, -1) for k in kinds] for s in names], dtype=np.intp)
    of_kind = template[first]
    if singly:
        which, kind = np.nonzero(of_kind >= 0)
        alone = np.full((len(which), len(kinds)), -1, dtype=np.intp)
        alone[np.arange(len(which)), kind] = of_kind[which, kind]
        first, ends, of_kind = first[which], ends[which], alone
    depth = 1 if singly else len(kinds)
    builder = RowBuilder(places, len(ends), depth)
    of_block = places.rows_of_templates[0]
    for j in range(len(kinds)):
        there = np.where(of_kind[:, j] >= 0, of_block[of_kind[:, j]], -1)
        for number in np.unique(there[there >= 0]).tolist():
            on = np.flatnonzero(there == number)
            block = places.tiled(of_kind[on, j], ends[on])
            builder.add(0 if singly else j, on, block)

    def make(i: int) -> Candidate:
        station, end = names[int(first[i])], places.names[int(ends[i])]
        chosen = [originals[n] for n in of_kind[i].tolist() if n >= 0]
        made = tuple(replace(o, target=end, id=None, source=None) for o in chosen)
        return Candidate(f"{station} to {end}", made)

    found = _finished(places, builder, ends, make)
    return replace(found, kinds=tuple(kinds), reads=of_kind >= 0)


def levelled_differences(
    places: Places, number: int, original: Sight, targets: Collection[str] | None, reach: float
) -> PossibleSights | None:
    """Return levelled differences between neighbours; arguments as of `station_sights`."""
    at = places.coordinates
    there = np.flatnonzero(np.isfinite(at).all(axis=1))
    if len(there) < 2:
        return None
    near = KDTree(at[there, :2]).query(at[there, :2], k=min(NEIGHBOURS + 1, len(there)))[1]
    begin = np.repeat(there, near.shape[1])
    pairs = np.sort(np.stack([begin, there[near.ravel()]], axis=1), axis=1)
    pairs = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
    far = np.linalg.norm(at[pairs[:, 0], :2] - at[pairs[:, 1], :2], axis=1)
    wanted = np.array([targets is None or n in targets for n in places.names], dtype=bool)
    pairs = pairs[(far <= reach) & wanted[pairs].any(axis=1)]
    if not len(pairs):
        return None
    first, ends = pairs.T
    builder = RowBuilder(places, len(ends), 1)
    block = places.tiled(np.full(len(ends), number), ends, first)
    builder.add(0, np.arange(len(ends)), block)

    def make(i: int) -> Candidate:
        a, b = places.names[int(first[i])], places.names[int(ends[i])]
        made = replace(original, station=a, target=b, id=None, source=None)
        return Candidate(f"levelled {a} to {b}", (made,))

    # Both ends are points: neither is a station with few columns.
    found = _finished(places, builder, ends, make)
    return replace(found, points=np.full(len(ends), -1), kinds=(original.kind,))


def gnss_positions(
    places: Places, original: ControlPoint, targets: Collection[str] | None
) -> PossibleSights | None:
    """Return observed coordinates of points with the covariance of a template."""
    wanted = [targets is None or n in targets for n in places.names]
    finite = np.isfinite(places.coordinates).all(axis=1)
    ends = np.flatnonzero(np.array(wanted, dtype=bool) & finite)
    if not len(ends):
        return None
    axes = np.eye(POINT)[["xyz".index(a) for a in original.axes]]
    vectors = np.broadcast_to(axes, (len(ends), *axes.shape))
    if original.local:
        frame = places.equations.network.frame
        enu = frame.basis(places.coordinates[ends], np.zeros((len(ends), 2))).enu
        vectors = enu[:, ["enu".index(a) for a in original.axes]]
    given = original.covariance
    covariance = np.diag(np.square(original.sigma)) if given is None else np.asarray(given)  # type: ignore[arg-type]
    a = np.linalg.inv(np.linalg.cholesky(covariance)) @ vectors
    builder = RowBuilder(places, len(ends), a.shape[1])
    builder.slots["point", "target", ""] = np.array(a), places.columns[ends]

    def make(i: int) -> Candidate:
        place = int(ends[i])
        value: Any = original.value
        if not original.local:
            value = tuple(places.coordinates[place]["xyz".index(a)] for a in original.axes)
        name = places.names[place]
        made = replace(original, point=name, value=value, id=None, source=None)
        return Candidate(f"GNSS at {name}", (made,))

    return replace(_finished(places, builder, ends, make), kinds=(original.kind,))


def possible_sights(
    ledger: Ledger,
    system: LinearSystem,
    cofactors: CofactorColumns,
    memory: SightMemory,
    *,
    stations: Collection[str] | None = None,
    points: Collection[str] | None = None,
    kinds: Collection[str] | None = None,
    reach: float | None = None,
    singly: bool = False,
) -> tuple[Places, list[PossibleSights]]:
    """Return what may be observed now, with the values and columns of it.

    Args:
        ledger: what has arrived.
        system: the linear system.
        cofactors: its cofactors.
        memory: what was found before.
        stations: names of the stations; None: all that are set up.
        points: names of the points to which sights go; None: all.
        kinds: kinds of observations; None: all.
        reach: largest length of a sight, metres; None: that of the longest sight so far.
        singly: whether each reading is a sight of its own; otherwise everything that a station
            reads is one.
    """
    found = memory.templates(ledger)
    chosen = _named("station that is set up", found.sights, stations)
    ends = None if points is None else set(_named("point", ledger.network.points, points))
    there = {k for own in found.sights.values() for k in own}
    there |= {o.kind for o in (found.levelled, found.gnss) if o is not None}
    wanted = set(_named("kind of what has been observed", sorted(there), kinds))
    originals: list[Observation] = []
    numbers: dict[str, dict[str, int]] = {}
    for station in chosen:
        for kind, o in found.sights[station].items():
            if kind in wanted:
                numbers.setdefault(station, {})[kind] = len(originals)
                originals.append(o)
    levelled = found.levelled
    if levelled is not None and levelled.kind in wanted and stations is None:
        originals.append(levelled)
    else:
        levelled = None
    places = Places.of(ledger, system, cofactors, originals, memory)
    if reach is None:
        reach = places.longest(found.ends)
    families: Iterable[PossibleSights | None] = (
        station_sights(places, numbers, originals, ends, reach, singly=singly) if numbers else None,
        None
        if levelled is None
        else levelled_differences(places, len(originals) - 1, levelled, ends, reach),
        gnss_positions(places, found.gnss, ends)
        if found.gnss is not None and found.gnss.kind in wanted and stations is None
        else None,
    )
    return places, [f for f in families if f is not None and f.n]


def _named(what: str, names: Iterable[str], patterns: Collection[str] | None) -> list[str]:
    """Return those names that match patterns; None: all.

    Raises:
        InputError: patterns that match none.
    """
    every = list(names)
    if patterns is None:
        return every
    wrong = [p for p in patterns if not matching(every, (p,)).any()]
    if wrong:
        raise InputError(Problem(f"there is no {what} like {p!r}: {known(every)}") for p in wrong)
    on = matching(every, tuple(patterns))
    return [n for n, o in zip(every, on.tolist(), strict=True) if o]

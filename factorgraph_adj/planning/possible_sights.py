"""Sights that are possible now: from stations that are set up to every point, levelling, GNSS.

What a station reads together is one sight. Levelled differences are those between neighbouring
points. `factorgraph_adj.planning.sight_templates` has the observations that are repeated.

The rows of all sights are evaluated at once, as blocks of the models of the kinds
(`factorgraph_adj.planning.sight_rows`): no observation is made before it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from ..errors import InputError, Problem, known
from ..ledger.ledger import Ledger
from ..linear_system.cofactor_columns import CofactorColumns
from ..linear_system.linear_system import LinearSystem
from ..observations import Observation
from ..observations.base import Sight
from ..observations.positions import ControlPoint
from ..types import Index, Mask
from .candidates import Candidate
from .sight_rows import END, POINT, PossibleSights, RowBuilder, SightRows
from .sight_templates import Places, SightMemory
from .targets import matching

NEIGHBOURS = 6
"""Number of nearest points to which levelled differences are possible from each point."""
LEAST_LENGTH = 1e-3
"""Shortest sight, metres."""
MAX_SIGHTS = 1_000_000
"""Largest number of pairs of station and point that are examined; a million takes about 1 GiB."""
REACH_MARGIN = 1e-4
"""Part of the reach by which the longest sight so far may grow, as present coordinates move."""


def _near(
    places: Places, stations: Index, targets: Index, reach: float
) -> tuple[Index, Index, float]:
    """Return pairs of a station (its place among the given ones) and a point within reach.

    The third is the change of a length up to which there are no other pairs, metres.

    Raises:
        InputError: there are more than `MAX_SIGHTS`.
    """
    at = places.coordinates
    there: Mask = np.asarray(np.isfinite(at).all(axis=1))
    begin, ends = np.flatnonzero(there[stations]), targets[there[targets]]
    if not len(begin) or not len(ends):
        return begin[:0], ends[:0], np.inf
    tree = KDTree(at[ends])
    further = reach * (1.0 + REACH_MARGIN)
    counted: Any = tree.query_ball_point(at[stations[begin]], further, return_length=True)
    if (number := int(counted.sum()) - int(np.isin(stations[begin], ends).sum())) > MAX_SIGHTS:
        what = f"{number} sights are possible, more than the {MAX_SIGHTS} that are examined"
        raise InputError(f"{what}: limit `stations`, `to` or `reach`")
    near: Any = tree.query_ball_point(at[stations[begin]], further, return_sorted=True)
    found = [np.array(each, dtype=np.intp) for each in near]
    first, second = np.repeat(begin, list(map(len, found))), ends[np.concatenate(found)]
    length = np.linalg.norm(at[second] - at[stations[first]], axis=1)
    apart = length[length > 0.0]
    limits = np.abs(np.concatenate([apart - reach, apart - LEAST_LENGTH]))
    slack = min(float(limits.min(initial=np.inf)), REACH_MARGIN * reach)
    on = (length > LEAST_LENGTH) & (length <= reach)
    return first[on], second[on], slack


def station_sights(
    places: Places,
    numbers: Mapping[str, Mapping[str, int]],
    originals: Sequence[Observation],
    targets: Collection[str] | None,
    reach: float,
    *,
    singly: bool,
) -> SightRows | None:
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
    first, ends, slack = _near(places, stations, np.flatnonzero(wanted), reach)
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
    of_block = places.rows_of_templates[0]

    def evaluate(places: Places, builder: RowBuilder, some: Index) -> None:
        for j in range(len(kinds)):
            own = of_kind[some, j]
            there = np.where(own >= 0, of_block[own], -1)
            for number in np.unique(there[there >= 0]).tolist():
                on = np.flatnonzero(there == number)
                block = places.tiled(own[on], ends[some[on]])
                builder.add(places, 0 if singly else j, on, block)

    point_names = places.names

    def make(i: int) -> Candidate:
        station, end = names[int(first[i])], point_names[int(ends[i])]
        chosen = [originals[n] for n in of_kind[i].tolist() if n >= 0]
        made = tuple(replace(o, target=end, id=None, source=None) for o in chosen)
        return Candidate(f"{station} to {end}", made)

    pairs = stations[first], ends
    about: dict[str, Any] = {"kinds": tuple(kinds), "reads": of_kind >= 0, "slack": slack}
    return SightRows(places, pairs, depth, evaluate, make, **about)


def levelled_differences(
    places: Places, number: int, original: Sight, targets: Collection[str] | None, reach: float
) -> SightRows | None:
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
    names = places.names

    def evaluate(places: Places, builder: RowBuilder, some: Index) -> None:
        block = places.tiled(np.full(len(some), number), ends[some], first[some])
        builder.add(places, 0, np.arange(len(some)), block)

    def make(i: int) -> Candidate:
        a, b = names[int(first[i])], names[int(ends[i])]
        made = replace(original, station=a, target=b, id=None, source=None)
        return Candidate(f"levelled {a} to {b}", (made,))

    # Both ends are points: neither is a station with few columns.
    about: dict[str, Any] = {"kinds": (original.kind,), "leaves": False}
    about["slack"] = REACH_MARGIN * float(far.min())  # neighbours are those of about now
    return SightRows(places, (first, ends), 1, evaluate, make, **about)


def gnss_positions(
    places: Places, original: ControlPoint, targets: Collection[str] | None
) -> SightRows | None:
    """Return observed coordinates of points with the covariance of a template."""
    wanted = [targets is None or n in targets for n in places.names]
    finite = np.isfinite(places.coordinates).all(axis=1)
    ends = np.flatnonzero(np.array(wanted, dtype=bool) & finite)
    if not len(ends):
        return None
    given = original.covariance
    covariance = np.diag(np.square(original.sigma)) if given is None else np.asarray(given)  # type: ignore[arg-type]
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))
    seen: dict[str, Places] = {"present": places}

    def evaluate(places: Places, builder: RowBuilder, some: Index) -> None:
        seen["present"] = places
        vectors = np.eye(POINT)[["xyz".index(a) for a in original.axes]]
        if original.local:
            frame, at = places.equations.network.frame, places.coordinates[ends[some]]
            enu = frame.basis(at, np.zeros((len(at), 2))).enu
            vectors = enu[:, ["enu".index(a) for a in original.axes]]
        a, of = builder.slots[END]
        a[:], of[:] = whitener @ vectors, ends[some]

    def make(i: int) -> Candidate:
        place, value = int(ends[i]), original.value
        present = seen["present"]
        if not original.local:
            at = present.coordinates[place]
            value = tuple(at["xyz".index(a)] for a in original.axes)
        name = present.names[place]
        made = replace(original, point=name, value=value, id=None, source=None)
        return Candidate(f"GNSS at {name}", (made,))

    depth = len(whitener)
    return SightRows(places, (None, ends), depth, evaluate, make, kinds=(original.kind,))


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
        reach = memory.reach(places.longest(found.ends), REACH_MARGIN)
    about = None if ends is None else frozenset(ends)
    chosen_numbers = tuple((s, tuple(own.items())) for s, own in numbers.items())

    def of_stations() -> SightRows | None:
        return station_sights(places, numbers, originals, ends, reach, singly=singly)

    def of_levels() -> SightRows | None:
        assert levelled is not None
        return levelled_differences(places, len(originals) - 1, levelled, ends, reach)

    def of_positions() -> SightRows | None:
        assert found.gnss is not None
        return gnss_positions(places, found.gnss, ends)

    families: list[tuple[Any, Callable[[], SightRows | None]]] = []
    if numbers:
        families.append((("stations", chosen_numbers, about, reach, singly), of_stations))
    if levelled is not None:
        families.append((("levelled", about, reach), of_levels))
    if found.gnss is not None and found.gnss.kind in wanted and stations is None:
        families.append((("positions", id(found.gnss), about), of_positions))
    rows = [memory.kept(places, key, make) for key, make in families]
    return places, [r.found(places) for r in rows if r is not None]


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

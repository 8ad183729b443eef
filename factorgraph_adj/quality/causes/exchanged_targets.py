"""Targets with each other's names at one set-up, looked up beside everything that they concern.

Exchanged names bend the places of both points, and where these come from the readings alone also
the approximate values. So nothing is taken from an adjustment of them: the points of all readings
that do not fit (the suspects) leave the network, and what is left is adjusted (the core);
stations, and points that place the network, stay without the sights that do not fit. Then, for each
set-up that sees a suspect, its readings are given other names, and the points are fitted to all
their readings beside the core (`renamed`). Two hypotheses are tested: two targets of a set-up are
each other, and a target is another point of the list. A set-up is a station with one height of the
instrument. Each name that is tried must lie near where the readings of other set-ups have the
point, in the order of these distances.

An exchange at one set-up may be the same to all readings as the exchange of the two points at
another one. Hypotheses whose T² differ by less than `SAME` are named together.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from ...errors import AdjustmentError
from ...graph.equations import Equations
from ...network.network import Network
from ...network.selection import without
from ...solve.batch import adjust
from ...solve.solution import Solution
from ...types import Array, Index, Mask
from ..distributions import chi2_quantile, normal_quantile
from ..reliability import Reliability, reliability
from .matches import EXCHANGED, NAME, WITH_HEIGHT, Match, both_ways
from .renamed import Fit, RenamedReadings
from .separable import FARTHEST, SAME
from .set_ups import SetUp, Sight, places_seen, sights_of

MOST_SUSPECTS = 40
"""Largest number of points that may leave the network: exchanges are few."""
MOST_CORES = 5
"""Largest number of times that points leave the core, since its readings do not fit."""
SHARE = 0.4
"""Part of the largest test value of the core from which on readings leave it together."""
MOST_PAIRS = 40
"""Largest number of pairs of exchanges with a point in common that are fitted."""
TRIED = 6
"""Number of hypotheses that are fitted for a point at a set-up: those whose places are nearest."""
NEAR = 0.02
"""Largest distance of places that a name may join, as a share of the length of the sight:
refraction or a height that goes with the name move a place by far less."""
NEAR_AT_LEAST = 1.0
"""The same for short sights, metres."""


@dataclass(frozen=True, eq=False)
class Exchange:
    """Readings of a set-up that fit under other names."""

    match: Match
    """What is to be said of it."""
    points: Mapping[str, Array]
    """Coordinates of the points that were fitted, metres."""
    core: Solution
    """The adjustment beside which they were fitted."""


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """Other names of the targets of a set-up."""

    set_up: SetUp
    names: tuple[tuple[int, int], ...]
    """Name of the target and the point that it is."""
    with_height: bool
    distance: float
    """Sum of the distances between places that the names join, metres."""

    @property
    def points(self) -> frozenset[int]:
        """The points that are concerned."""
        return frozenset(p for pair in self.names for p in pair)


@dataclass(eq=False)
class _Tested:
    """Hypotheses that are right together, with their fit."""

    what: tuple[_Hypothesis, ...]
    points: frozenset[int]
    before: Fit
    after: Fit
    same: list[_Tested] = field(default_factory=list)
    """Hypotheses on the same points that cannot be told from it."""


def exchanged_targets(
    equations: Equations, solution: Solution, bad: Collection[str], alpha: float
) -> tuple[Exchange, ...]:
    """Look for targets with other names among the points of readings that do not fit.

    Args:
        equations: the whole network.
        solution: an adjustment of it, or of a part; only what is left of it without the suspects
            is used, as approximate values.
        bad: ids of the readings that do not fit there.
        alpha: probability with which readings of the right names do not fit.
    """
    sights = sights_of(equations, solution)
    core = _Core.of(equations, solution, bad, sights, alpha)
    found = () if core is None else _Search(equations, core, sights, alpha).found()
    points = {name: at for e in found for name, at in e.points.items()}
    # Two names that are found one after the other are an exchange too.
    return tuple(Exchange(m, points, found[0].core) for m in both_ways([e.match for e in found]))


@dataclass(frozen=True, eq=False)
class _Core:
    """The adjustment of what does not concern the suspects."""

    solution: Solution
    reliability: Reliability
    suspects: frozenset[int]
    """Points of readings that do not fit, by number in the whole network."""

    @classmethod
    def of(
        cls,
        equations: Equations,
        solution: Solution,
        bad: Collection[str],
        sights: Mapping[SetUp, Mapping[int, Sight]],
        alpha: float,
    ) -> _Core | None:
        """Return the core; none: it is not determined, or everything is suspect."""
        aside, critical = set(bad), normal_quantile(1.0 - 0.5 * alpha)
        out: _Core | None = None
        for _ in range(MOST_CORES):
            suspects, ids = _suspects(sights, aside)
            if not suspects or len(suspects) > MOST_SUSPECTS:
                return out
            names = equations.unknowns["point"].names
            leave = [names[p] for p in suspects & _may_leave(equations, sights)]
            try:
                network = without(equations.network, ids | aside, points=leave)
                rel = reliability(_adjusted(network, solution), alpha=alpha)
            except AdjustmentError:
                return out
            core = rel.solution
            if not core.converged:
                return out
            out = cls(core, rel, frozenset(suspects))
            w = np.nan_to_num(np.abs(rel.w))
            if w.max(initial=0.0) <= critical:
                break
            worst = np.flatnonzero(w >= max(critical, SHARE * float(w.max())))
            aside |= {core.equations.id(int(row)) for row in worst}
        return out


def _adjusted(network: Network, start: Solution) -> Solution:
    """Return the adjustment of a part; from its own approximate values, if they lead further down.

    What has bent the whole may have bent the start.
    """
    out = adjust(network, start=start)
    if out.converged and out.vtpv < FARTHEST**2:
        return out
    with suppress(AdjustmentError):
        other = adjust(network)
        if other.converged and not (out.converged and out.vtpv <= other.vtpv):
            return other
    return out


def _suspects(
    sights: Mapping[SetUp, Mapping[int, Sight]], bad: Collection[str]
) -> tuple[set[int], set[str]]:
    """Return the targets of readings that do not fit, and all that was read in these sights."""
    points: set[int] = set()
    ids: set[str] = set()
    for targets in sights.values():
        for target, sight in targets.items():
            if not set(bad).isdisjoint(sight.ids):
                points.add(target)
                ids.update(sight.ids)
    return points, ids


def _may_leave(equations: Equations, sights: Mapping[SetUp, Mapping[int, Sight]]) -> set[int]:
    """Return the points without which a network still has its stations and its datum."""
    free: Mask = np.array(equations.unknowns["point"].free.all(axis=1))
    for block in equations.blocks:
        if block.fixes == "coordinates":
            for kind, index in block.variables:
                if kind == "point":
                    free[index] = False
    stations = {s.station for s in sights}
    return {p for p in np.flatnonzero(free).tolist() if p not in stations}


class _Search:
    """The search for other names of the suspects."""

    def __init__(
        self,
        equations: Equations,
        core: _Core,
        sights: Mapping[SetUp, Mapping[int, Sight]],
        alpha: float,
    ) -> None:
        self.equations, self.core, self.sights, self.alpha = equations, core, sights, alpha
        self.names = equations.unknowns["point"].names
        leaving = _may_leave(equations, sights)
        self.open = (core.suspects | _uncontrolled(equations, core, sights)) & leaving
        """Points that are fitted: the core tells nothing of them."""
        self.renamed = RenamedReadings(equations, core.solution, sorted(self.open))
        self.state = self.renamed.innovations.state
        self.places = {
            (s, t): at
            for s, targets in sights.items()
            for t, at in places_seen(equations, self.state, s.station, s.height, targets).items()
        }
        self.readings = _readings_of(equations, self.open)
        self.recorded = _recorded_heights(sights)

    def found(self) -> tuple[Exchange, ...]:
        """Return the exchanges, those that explain most first."""
        every = self._nearest(self._hypotheses())
        fitting = [t for h in every if (t := self._tested((h,))) is not None]
        out = self._best(fitting)
        explained = {p for t in out for p in t.points}
        left = [h for h in every if not h.points & explained]
        if len(self.core.suspects - explained) > 2:
            both = [t for pair in _sharing(left) if (t := self._tested(pair)) is not None]
            out += self._best(both)
        return tuple(e for t in out for e in self._exchanges(t))

    # -- hypotheses ---------------------------------------------------------------------------

    def _hypotheses(self) -> Iterator[_Hypothesis]:
        """Iterate over other names that may be right by the places alone."""
        suspects = self.core.suspects
        for s, targets in self.sights.items():
            for i in sorted(suspects & targets.keys()):
                for j in sorted((suspects | self.open) & targets.keys()):
                    if j != i and not (j in suspects and j < i):
                        yield from self._near(s, ((i, j), (j, i)))
                for k in range(len(self.names)):
                    if k not in (i, s.station) and not (k in self.open and k not in suspects):
                        yield from self._near(s, ((i, k),))

    def _near(self, s: SetUp, names: tuple[tuple[int, int], ...]) -> Iterator[_Hypothesis]:
        distance = sum(self._distance(s, a, b) for a, b in names)
        if not np.isfinite(distance):
            return
        yield _Hypothesis(s, names, False, distance)
        own = self.sights[s]
        if any(self.recorded[b] and self.recorded[b][:1] != own[a].heights for a, b in names):
            yield _Hypothesis(s, names, True, distance)

    def _distance(self, s: SetUp, a: int, b: int) -> float:
        """Return how far the place of target a at a set-up is from where the others have b."""
        at = self.places[s, a]
        station = self.state["point"][s.station]
        if b in self.open:
            others = [p for (o, t), p in self.places.items() if t == b and o != s]
        else:
            others = [self.state["point"][b]]
        limit = max(NEAR_AT_LEAST, NEAR * float(np.linalg.norm((at - station)[:2])))
        distances = [d for p in others if np.isfinite(d := _apart(at, p))]
        if not distances or not np.isfinite(limit):
            return limit if np.isfinite(limit) else NEAR_AT_LEAST
        return min(distances) if min(distances) <= limit else np.inf

    def _nearest(self, every: Iterator[_Hypothesis]) -> list[_Hypothesis]:
        """Return the hypotheses that are fitted, the nearest first."""
        own: dict[tuple[SetUp, int], list[_Hypothesis]] = defaultdict(list)
        for h in every:
            own[h.set_up, h.names[0][0]].append(h)
        chosen = [h for hs in own.values() for h in sorted(hs, key=_by_distance)[:TRIED]]
        return sorted(chosen, key=_by_distance)

    # -- fits ---------------------------------------------------------------------------------

    def _tested(self, together: tuple[_Hypothesis, ...]) -> _Tested | None:
        """Return hypotheses that are right together, if all readings of their points fit."""
        points = frozenset(p for h in together for p in h.points)
        new = [p for p in sorted(points) if p in self.open]
        changed: dict[tuple[int, int], tuple[int, float | None]] = {}
        start: dict[int, Array] = {}
        for h in together:
            for a, b in h.names:
                sight = self.sights[h.set_up][a]
                height = self.recorded[b][0] if h.with_height and self.recorded[b] else None
                changed |= dict.fromkeys(sight.readings, (b, height))
        readings: set[tuple[int, int]] = set(changed)
        for p in new:
            readings |= self.readings[p]
            own = [
                at
                for (s, t), at in self.places.items()
                if self._name(together, s, t) == p and np.isfinite(at[:2]).all()
            ]
            if not own:
                return None
            start[p] = _median(own)
        observations = _by_block(readings)
        after = self.renamed.fit(observations, changed, start)
        if after.dof < 1 or after.t2 > chi2_quantile(1.0 - self.alpha, after.dof):
            return None
        before = self.renamed.fit(observations, {}, start)
        if before.t2 < after.t2 + SAME:
            return None
        if not np.isfinite(before.t2):
            before = self.renamed.at(observations, after.coordinates)
        return _Tested(together, points, before, after)

    def _name(self, together: Sequence[_Hypothesis], s: SetUp, target: int) -> int:
        """Return the point that a target of a set-up is."""
        for h in together:
            if h.set_up == s:
                return dict(h.names).get(target, target)
        return target

    def _best(self, fitting: Sequence[_Tested]) -> list[_Tested]:
        """Return the tests that count; of those on the same points the one that explains most."""
        out: list[_Tested] = []
        for t in sorted(fitting, key=lambda t: (-t.after.dof, t.after.t2)):
            rival = next((o for o in out if o.points & t.points), None)
            if rival is None:
                out.append(t)
            elif rival.after.dof == t.after.dof and t.after.t2 < rival.after.t2 + SAME:
                rival.same.append(t)
        return out

    # -- result -------------------------------------------------------------------------------

    def _exchanges(self, t: _Tested) -> Iterator[Exchange]:
        """Iterate over what is to be said of hypotheses that fit together."""
        coordinates = {self.names[p]: x for p, x in t.after.coordinates.items()}
        same = tuple(self._said(o.what) for o in t.same)
        for h in t.what:
            ids = tuple(dict.fromkeys(i for a, _ in h.names for i in self.sights[h.set_up][a].ids))
            cause = EXCHANGED if len(h.names) > 1 else NAME
            t2 = t.before.t2, t.after.t2
            a, b = h.names[0]
            sight = (self.names[h.set_up.station], self.names[a], self.names[b])
            alone = sight if len(h.names) == 1 and not same else None
            match = Match(cause, self._said((h,)), ids, *t2, alone, h.with_height, same)
            yield Exchange(match, coordinates, self.core.solution)

    def _said(self, together: Sequence[_Hypothesis]) -> str:
        return " and ".join(self._place(h) for h in together)

    def _place(self, h: _Hypothesis) -> str:
        station = self.names[h.set_up.station]
        a, b = (self.names[p] for p in h.names[0])
        suffix = WITH_HEIGHT if h.with_height else ""
        if len(h.names) > 1:
            a, b = sorted((a, b))
            return f"{a!r} and {b!r} seen from {station!r}{suffix}"
        return f"{a!r} seen from {station!r}, which is {b!r}{suffix}"


def _by_distance(h: _Hypothesis) -> float:
    return h.distance


def _apart(a: Array, b: Array) -> float:
    """Return the distance of two places; in plan, where a height is not known."""
    d = a - b
    return float(np.linalg.norm(d if np.isfinite(d[2]) else d[:2]))


def _median(own: Sequence[Array]) -> Array:
    """Return the median of places (3,)."""
    return np.asarray(np.nan_to_num(np.nanmedian(np.stack(own), axis=0)))


def _by_block(readings: Collection[tuple[int, int]]) -> dict[int, Index]:
    """Return numbers of observations by the place of their block."""
    out: dict[int, list[int]] = defaultdict(list)
    for place, number in readings:
        out[place].append(number)
    return {place: np.array(sorted(numbers), dtype=np.intp) for place, numbers in out.items()}


def _sharing(every: Sequence[_Hypothesis]) -> list[tuple[_Hypothesis, ...]]:
    """Return pairs of exchanges at different set-ups that share a point, the nearest first."""
    pairs: list[tuple[_Hypothesis, ...]] = [
        (a, b)
        for a, b in combinations([h for h in every if len(h.names) > 1], 2)
        if a.set_up != b.set_up and a.points & b.points and a.points != b.points
    ]
    return sorted(pairs, key=lambda pair: sum(h.distance for h in pair))[:MOST_PAIRS]


def _readings_of(equations: Equations, points: Collection[int]) -> dict[int, set[tuple[int, int]]]:
    """Return the observations of each point, by block and number."""
    out: dict[int, set[tuple[int, int]]] = {p: set() for p in points}
    for place, block in enumerate(equations.blocks):
        for kind, index in block.variables:
            if kind == "point":
                for number in np.flatnonzero(np.isin(index, list(points))).tolist():
                    out[int(index[number])].add((place, number))
    return out


def _uncontrolled(
    equations: Equations, core: _Core, sights: Mapping[SetUp, Mapping[int, Sight]]
) -> frozenset[int]:
    """Return the targets of the core of whose readings nothing tells."""
    own, number = core.solution.equations, equations.unknowns["point"].number
    controlled: set[int] = set()
    for block in own.blocks:
        rows = core.reliability.controlled[block.rows].reshape(block.n, block.dimension)
        for kind, index in block.variables:
            if kind == "point":
                names = own.unknowns["point"].names
                fine = index[rows.any(axis=1)]
                controlled |= {number[names[p]] for p in np.unique(fine).tolist()}
    targets = {t for own_targets in sights.values() for t in own_targets}
    return frozenset(targets - controlled)


def _recorded_heights(
    sights: Mapping[SetUp, Mapping[int, Sight]],
) -> defaultdict[int, tuple[float, ...]]:
    """Return the heights that are recorded with each target, those most recorded first."""
    counts: defaultdict[int, Counter[float]] = defaultdict(Counter)
    for targets in sights.values():
        for target, sight in targets.items():
            counts[target].update(sight.heights)
    out: defaultdict[int, tuple[float, ...]] = defaultdict(tuple)
    out |= {t: tuple(h for h, _ in c.most_common()) for t, c in counts.items()}
    return out

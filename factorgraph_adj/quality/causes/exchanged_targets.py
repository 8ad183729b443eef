"""Targets of a set-up that are exchanged, or are another point; the fits: `renamed_sights`.

Exchanged names bend the places of both points, and where these come from the readings alone also
the approximate values. So nothing is taken from an adjustment of them: the points of all readings
that do not fit (the suspects) leave the network, and what is left is adjusted (the core);
stations, and points that place the network, stay without the sights that do not fit. Then, for each
set-up that sees a suspect, its readings are given other names, and the points are fitted to all
their readings beside the core (`renamed_sights`). Two hypotheses are tested: two targets of a
set-up are each other, and a target is another point of the list. A set-up is a station with one
height of the instrument. Each name that is tried must lie near where the readings of other set-ups
have the point, in the order of these distances.

An exchange at one set-up may be the same to all readings as the exchange of the two points at
another one. Hypotheses whose T² differ by less than `MIN_T2_DIFFERENCE` are named together.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from ...graph.equations import Equations
from ...solve.solution import Solution
from ...types import Array, Index
from .mistaken_identity import (
    EXCHANGED_TARGETS,
    WITH_HEIGHT,
    WRONG_TARGET_NAME,
    MistakenIdentity,
    merged_exchanges,
)
from .readings import most_recorded_heights
from .renamed_sights import (
    CoreNetwork,
    ReadingFit,
    RenamedReadings,
    SetUp,
    Sight,
    removable_points,
    sighted_places,
    sights_by_set_up,
    uncontrolled_targets,
)
from .separability import MIN_T2_DIFFERENCE

MAX_EXCHANGE_PAIRS = 40
"""Largest number of pairs of exchanges with a point in common that are fitted."""
MAX_FITTED_HYPOTHESES = 6
"""Number of hypotheses that are fitted for a point at a set-up: those whose places are nearest."""
MAX_PLACE_DISTANCE_SHARE = 0.02
"""Largest distance of places that a name may join, as a share of the length of the sight:
refraction or a height that goes with the name move a place by far less."""
MIN_PLACE_TOLERANCE_M = 1.0
"""The same for short sights, metres."""


@dataclass(frozen=True, eq=False)
class TargetExchange:
    """Readings of a set-up that fit under other names."""

    match: MistakenIdentity
    """Its description."""
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
    readings: frozenset[tuple[int, int]]
    """All readings of the points, by block and number."""
    before: ReadingFit
    after: ReadingFit
    same: list[_Tested] = field(default_factory=list)
    """Hypotheses that share points with it and cannot be distinguished from it."""

    @property
    def gain(self) -> float:
        """By how much T² is less with the other names, σ0 = 1."""
        return self.before.t2 - self.after.t2


def exchanged_targets(
    equations: Equations,
    solution: Solution,
    bad: Collection[str],
    alpha: float,
    *,
    estimated: bool = False,
) -> tuple[TargetExchange, ...]:
    """Look for targets with other names among the points of readings that do not fit.

    Args:
        equations: the whole network.
        solution: an adjustment of it, or of a part; only what is left of it without the suspects
            is used, as approximate values.
        bad: ids of the readings that do not fit there.
        alpha: probability with which readings of the right names do not fit.
        estimated: whether σ0 is that of what is left of the network; otherwise it is 1.
    """
    sights = sights_by_set_up(equations, solution)
    core = CoreNetwork.of(equations, solution, bad, sights, alpha, estimated=estimated)
    found = () if core is None else _Search(equations, core, sights, alpha).found()
    points = {name: at for e in found for name, at in e.points.items()}
    # Two names that are found one after the other are an exchange too.
    return tuple(
        TargetExchange(m, points, found[0].core) for m in merged_exchanges([e.match for e in found])
    )


class _Search:
    """The search for other names of the suspects."""

    def __init__(
        self,
        equations: Equations,
        core: CoreNetwork,
        sights: Mapping[SetUp, Mapping[int, Sight]],
        alpha: float,
    ) -> None:
        self.equations, self.core, self.sights, self.alpha = equations, core, sights, alpha
        self.names = equations.unknowns["point"].names
        leaving = removable_points(equations, sights)
        self.open = (core.suspects | uncontrolled_targets(equations, core, sights)) & leaving
        """Points that are fitted: the core does not determine them."""
        self.renamed = RenamedReadings(equations, core.solution, sorted(self.open))
        self.state = self.renamed.innovations.state
        self.places = {
            (s, t): at
            for s, targets in sights.items()
            for t, at in sighted_places(equations, self.state, s.station, s.height, targets).items()
        }
        of_core = core.solution.network.observations
        self.readings = {
            p: own if p in self.open else {o for o in own if self._id(o) not in of_core}
            for p, own in _readings_of(equations, self.open | core.suspects).items()
        }
        """Observations of points that are fitted, and those of others that the core lacks."""
        self.recorded: defaultdict[int, tuple[float, ...]] = defaultdict(tuple)
        """Heights that are recorded with each target, those most recorded first."""
        self.recorded |= most_recorded_heights(
            (target, height)
            for targets in sights.values()
            for target, sight in targets.items()
            for height in sight.heights
        )

    def _id(self, observation: tuple[int, int]) -> str:
        block = self.equations.blocks[observation[0]]
        return block.ids[observation[1]]

    def found(self) -> tuple[TargetExchange, ...]:
        """Return the exchanges, those that explain most first."""
        every = self._nearest(self._hypotheses())
        fitting = [t for h in every if (t := self._tested((h,))) is not None]
        out = self._best(fitting)
        # A name may be one of two exchanges with a point in common; an exchange is none.
        explained = {p for t in out if len(t.what[0].names) > 1 for p in t.points}
        if len(self.core.suspects - explained) > 1:
            pairs = self._pairs(explained)
            both = [t for pair in pairs if (t := self._tested(pair)) is not None]
            out = self._best([*fitting, *both])
        return tuple(e for t in self._separated(out) for e in self._exchanges(t))

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

    def _pairs(self, explained: Collection[int]) -> list[tuple[_Hypothesis, ...]]:
        """Return pairs of exchanges at different set-ups that share a point, the nearest first.

        Of each alone only one name need lie near: what the other set-up has of the shared point is
        another point.
        """
        suspects = self.core.suspects
        every = []
        for s, targets in self.sights.items():
            there = sorted(((suspects | self.open) & targets.keys()).difference(explained))
            for i, j in combinations(there, 2):
                names = (i, j), (j, i)
                if {i, j} & suspects and np.isfinite(min(self._distance(s, *n) for n in names)):
                    every.append(_Hypothesis(s, names, False, 0.0))
        pairs: dict[tuple[_Hypothesis, ...], float] = {
            (a, b): self._spread((a, b))
            for a, b in combinations(every, 2)
            if a.set_up != b.set_up and a.points & b.points and a.points != b.points
        }
        near = sorted((pair for pair in pairs if np.isfinite(pairs[pair])), key=pairs.__getitem__)
        return near[:MAX_EXCHANGE_PAIRS]

    def _spread(self, together: tuple[_Hypothesis, ...]) -> float:
        """Return how far places with the same names are apart; infinite: farther than names may."""
        out = 0.0
        for p in {p for h in together for p in h.points}:
            own = [
                (s, at)
                for (s, t), at in self.places.items()
                if self._name(together, s, t) == p and np.isfinite(at[:2]).all()
            ]
            if not own:
                return np.inf
            at = self.state["point"][p] if p not in self.open else own[0][1]
            for s, other in own:
                distance = _apart(at, other)
                if distance > self._limit(s, other):
                    return np.inf
                out += distance
        return out

    def _limit(self, s: SetUp, at: Array) -> float:
        """Return the largest distance of the same place seen from elsewhere, metres."""
        length = float(np.linalg.norm((at - self.state["point"][s.station])[:2]))
        return max(MIN_PLACE_TOLERANCE_M, MAX_PLACE_DISTANCE_SHARE * length)

    def _distance(self, s: SetUp, a: int, b: int) -> float:
        """Return how far the place of target a at a set-up is from where the others have b."""
        at = self.places[s, a]
        if b in self.open:
            others = [p for (o, t), p in self.places.items() if t == b and o != s]
        else:
            others = [self.state["point"][b]]
        limit = self._limit(s, at)
        distances = [d for p in others if np.isfinite(d := _apart(at, p))]
        if not distances or not np.isfinite(limit):
            return limit if np.isfinite(limit) else MIN_PLACE_TOLERANCE_M
        return min(distances) if min(distances) <= limit else np.inf

    def _nearest(self, every: Iterator[_Hypothesis]) -> list[_Hypothesis]:
        """Return the hypotheses that are fitted, the nearest first."""
        own: dict[tuple[SetUp, int], list[_Hypothesis]] = defaultdict(list)
        for h in every:
            own[h.set_up, h.names[0][0]].append(h)
        chosen = [
            h for hs in own.values() for h in sorted(hs, key=_by_distance)[:MAX_FITTED_HYPOTHESES]
        ]
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
        for p in points & self.readings.keys():
            readings |= self.readings[p]
        for p in new:
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
        weight = self.core.weight
        if after.dof < 1 or after.t2 > weight.limit(after.dof, self.alpha):
            return None
        before = self.renamed.fit(observations, {}, start)
        if not np.isfinite(before.t2):
            before = self.renamed.at(observations, after.coordinates)
        tested = _Tested(together, points, frozenset(readings), before, after)
        return tested if MIN_T2_DIFFERENCE * weight.variance <= tested.gain < np.inf else None

    def _name(self, together: Sequence[_Hypothesis], s: SetUp, target: int) -> int:
        """Return the point that a target of a set-up is."""
        for h in together:
            if h.set_up == s:
                return dict(h.names).get(target, target)
        return target

    def _best(self, fitting: Sequence[_Tested]) -> list[_Tested]:
        """Return the tests that count; of those that share points the one that explains most.

        What explains less by no more than `MIN_T2_DIFFERENCE` is named with it. The same readings
        under the names as they are have one T², the least that any start has led to.
        """
        out: list[_Tested] = []
        same = MIN_T2_DIFFERENCE * self.core.weight.variance
        before: dict[frozenset[tuple[int, int]], ReadingFit] = {}
        for t in fitting:
            least = before.setdefault(t.readings, t.before)
            before[t.readings] = min(least, t.before, key=lambda fit: fit.t2)
        tested = [replace(t, before=before[t.readings]) for t in fitting]
        for t in sorted((t for t in tested if t.gain >= same), key=lambda t: -t.gain):
            rival = next((o for o in out if o.points & t.points), None)
            if rival is None:
                out.append(replace(t, same=[]))
            elif rival.gain - t.gain < same:
                rival.same.append(t)
        return out

    def _separated(self, found: Sequence[_Tested]) -> list[_Tested]:
        """Return the tests, after those that readings join were fitted together.

        What joins the points of two exchanges, as levelling does, may determine at which set-up
        each of them was made.
        """
        for one, other in combinations(found, 2):
            if not self._joined(one, other):
                continue
            ways = [(*a.what, *b.what) for a in (one, *one.same) for b in (other, *other.same)]
            best = self._best([t for way in ways if (t := self._tested(way)) is not None])
            if best:
                left = [t for t in found if t not in (one, other)]
                return self._separated([*left, best[0]])
        return list(found)

    def _joined(self, one: _Tested, other: _Tested) -> bool:
        """Return whether readings join the points of two tests, one of which is not decided."""
        if not (one.same or other.same):
            return False
        a, b = ({o for p in t.points & self.open for o in self.readings[p]} for t in (one, other))
        return not a.isdisjoint(b)

    # -- result -------------------------------------------------------------------------------

    def _exchanges(self, t: _Tested) -> Iterator[TargetExchange]:
        """Iterate over the exchanges of hypotheses that fit together."""
        coordinates = {self.names[p]: x for p, x in t.after.coordinates.items()}
        same = tuple(self._said(o.what) for o in t.same)
        for h in t.what:
            ids = tuple(dict.fromkeys(i for a, _ in h.names for i in self.sights[h.set_up][a].ids))
            cause = EXCHANGED_TARGETS if len(h.names) > 1 else WRONG_TARGET_NAME
            t2 = t.before.t2, t.after.t2
            a, b = h.names[0]
            sight = (self.names[h.set_up.station], self.names[a], self.names[b])
            alone = sight if len(h.names) == 1 and not same else None
            match = MistakenIdentity(cause, self._said((h,)), ids, *t2, alone, h.with_height, same)
            match = match.judged_by(self.core.weight.variance)
            yield TargetExchange(match, coordinates, self.core.solution)

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
    """Return the median of places (3,); 0 for a coordinate that none of them knows."""
    places, out = np.stack(own), np.zeros(3)
    known = np.isfinite(places).any(axis=0)
    out[known] = np.nanmedian(places[:, known], axis=0)
    return out


def _by_block(readings: Collection[tuple[int, int]]) -> dict[int, Index]:
    """Return numbers of observations by the place of their block."""
    out: dict[int, list[int]] = defaultdict(list)
    for place, number in readings:
        out[place].append(number)
    return {place: np.array(sorted(numbers), dtype=np.intp) for place, numbers in out.items()}


def _readings_of(equations: Equations, points: Collection[int]) -> dict[int, set[tuple[int, int]]]:
    """Return the observations of each point, by block and number."""
    out: dict[int, set[tuple[int, int]]] = {p: set() for p in points}
    for place, block in enumerate(equations.blocks):
        for kind, index in block.variables:
            if kind == "point":
                for number in np.flatnonzero(np.isin(index, list(points))).tolist():
                    out[int(index[number])].add((place, number))
    return out

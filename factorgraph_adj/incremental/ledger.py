"""The ledger: every observation that has arrived, what became of it, and why.

A ledger is a value: every change returns another one, and notes the change with its cause. What is
noted becomes a line of the journal.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..errors import InputError, Problem
from ..models.variables import UNKNOWNS, VariableKind
from ..network.additions import add_entities
from ..network.entities import FREE_ORIENTATION, Camera, ImageTable, Photo, Point, parameter_key
from ..network.network import Network
from ..network.selection import without
from ..observations import AnyObservation, Correlated, ImagePoint, Observation
from ..types import Array, Index
from .rays import GONE, Names, Rays
from .units import Unit, Variable, identity, named, unit_of
from .verdicts import OUTCOMES, Outcome, Verdict


class Entry(NamedTuple):
    """A unit, and what became of it."""

    unit: Unit
    """The unit."""
    outcome: Outcome
    """What became of it."""
    verdicts: tuple[Verdict, ...] = ()
    """Verdicts on suspects and rejected units; empty for others."""


class Some(NamedTuple):
    """Some observations."""

    units: tuple[Unit, ...]
    """Observations and correlated groups."""
    rays: Index
    """Rows of image points in the ledger, in ascending order."""

    def __bool__(self) -> bool:
        """Return whether there are any."""
        return bool(self.units) or len(self.rays) > 0

    @classmethod
    def none(cls) -> Some:
        """Return no observations."""
        return cls((), np.zeros(0, dtype=np.intp))

    @classmethod
    def of(cls, several: Sequence[Some]) -> Some:
        """Return all of several selections, each observation once."""
        units = {u.ids[0]: u for some in several for u in some.units}
        rays = np.concatenate([cls.none().rays, *(some.rays for some in several)])
        return cls(tuple(units.values()), np.unique(rays))

    def joined(self, other: Some) -> Some:
        """Return these and others, each once."""
        return Some.of([self, other])

    def less(self, other: Some) -> Some:
        """Return these without others."""
        gone = {u.ids[0] for u in other.units}
        left = tuple(u for u in self.units if u.ids[0] not in gone)
        return Some(left, np.setdiff1d(self.rays, other.rays))

    @property
    def n_rows(self) -> int:
        """Number of scalar rows."""
        return sum(u.n_scalars for u in self.units) + 2 * len(self.rays)


class Change(NamedTuple):
    """What happened to some observations."""

    before: Mapping[str, Outcome | None]
    """What had become of each by its id; none: it was not there."""
    units: tuple[Unit, ...]
    """Units that were defined anew."""
    rays: Index
    """Rows of the image points."""
    cause: str
    """Why."""


@dataclass(frozen=True, eq=False)
class Ledger:
    """Everything that was described and observed."""

    network: Network
    """Points, photos and other unknowns; it has no observations."""
    names: Names
    """Names of its photos and points."""
    entries: Mapping[str, Entry] = field(default_factory=dict)
    """Observations and groups by their (first) id, in the order of arrival."""
    member: Mapping[str, str] = field(default_factory=dict)
    """First id of the group of every further member of a group."""
    rays: Rays = field(default_factory=Rays)
    """Image points that belong to no group."""
    lacks: Mapping[Variable, str] = field(default_factory=dict)
    """Why variables are not determined."""
    next: int = 1
    """Number from which ids are given to observations without one."""
    changes: tuple[Change, ...] = ()
    """Changes since the last line of the journal."""
    filled: Mapping[VariableKind, Mapping[str, Sequence[float]]] = field(default_factory=dict)
    """Approximate values that were found since then."""
    unweighted: tuple[str, ...] = ()
    """Weighted unknowns that lost their weights since then."""

    @classmethod
    def of(cls, network: Network) -> Ledger:
        """Return a ledger with the observations of a network, all accepted."""
        bare = network.copy()
        bare.observations, bare.clusters, bare.images = {}, [], ImageTable()
        group = {i: (ids, cov) for ids, cov in network.clusters for i in ids}
        entries: dict[str, Entry] = {}
        member: dict[str, str] = {}
        for ident in network.observations:
            ids, covariance = group.get(ident, ((ident,), None))
            if ids[0] not in entries:
                found = [named(network.observations[i], i) for i in ids]
                entries[ids[0]] = Entry(unit_of(network, found, covariance), "accepted")
                member |= dict.fromkeys(ids[1:], ids[0])
        rays = Rays().with_table(network.images.copy(), "accepted")
        return cls(bare, Names.of(bare), entries, member, rays)

    # -- arrivals -----------------------------------------------------------------------------

    def with_entities(
        self, points: Sequence[Point], photos: Sequence[Photo], cameras: Sequence[Camera]
    ) -> Ledger:
        """Return the ledger with new points, photos and cameras.

        Raises:
            InputError: every name that is there already, and unknown cameras.
        """
        network = self.network.copy()
        problems = add_entities(network, points=points, photos=photos, cameras=cameras)
        if problems:
            raise InputError(problems)
        return replace(self, network=network, names=Names.of(network))

    def taken(self, observations: Sequence[AnyObservation]) -> tuple[Ledger, Some]:
        """Take new observations in as waiting, each with an id.

        Raises:
            InputError: unknown names, ids that are there, points measured twice in a photo: all.
        """
        self._refuse(observations)
        units: list[Unit] = []
        table = ImageTable()
        given: set[str] = set()
        number = self.next
        for item in observations:
            if isinstance(item, ImagePoint):
                self._append(table, item)
                continue
            members = item.observations if isinstance(item, Correlated) else (item,)
            found = []
            for o in members:
                ident = identity(o)
                while ident is None:
                    ident, number = str(number), number + 1
                    ident = None if self.has(ident) or ident in given else ident
                given.add(ident)
                found.append(named(o, ident))
            covariance = np.asarray(item.covariance) if isinstance(item, Correlated) else None
            units.append(unit_of(self.network, found, covariance))
        ledger = replace(self, next=number)._without_rejected(units, table)
        first = ledger.rays.n
        if table.size:
            ledger = replace(ledger, rays=ledger.rays.with_table(table, "waiting"))
        some = Some(tuple(units), np.arange(first, first + table.size))
        return ledger.moved(some, "waiting", "arrival", new=True), some

    def given(self, observations: Sequence[AnyObservation], some: Some) -> list[str]:
        """Return the ids of observations that were taken in, in their own order."""
        units = iter(some.units)
        out: list[str] = []
        for item in observations:
            out += [identity(item) or ""] if isinstance(item, ImagePoint) else next(units).ids
        return out

    def _append(self, table: ImageTable, o: ImagePoint) -> None:
        row = table.size
        sigma = np.broadcast_to(np.asarray(o.sigma, dtype=float), (1, 2))
        photo, point = self.names.photo[o.photo], self.names.point[o.point]
        table.append(np.array([photo]), np.array([point]), np.array([[o.x, o.y]]), sigma)
        if o.id is not None:
            table.ids[row] = o.id
        if o.source is not None:
            table.sources[row] = o.source

    def _refuse(self, observations: Sequence[AnyObservation]) -> None:
        """Refuse bad observations, all together."""
        problems: list[Problem] = []
        seen: set[str] = set()
        there: dict[str, set[str]] = {}
        for item in observations:
            for o in item.observations if isinstance(item, Correlated) else (item,):
                try:
                    self.network._check_names(o, seen)
                except InputError as error:
                    problems.extend(error.problems)
                    continue
                ident = identity(o) or ""
                if isinstance(o, ImagePoint):
                    if o.photo not in there:
                        there[o.photo] = self._measured(o.photo)
                    if o.point in there[o.photo]:
                        what = "the point is measured in this photo already"
                        problems.append(Problem(what, o.label()))
                    there[o.photo].add(o.point)
                elif self.status(ident) not in ("gone", "rejected"):
                    problems.append(Problem(f"duplicate id {ident!r}", o.label()))
        if problems:
            raise InputError(problems)

    def _measured(self, photo: str) -> set[str]:
        """Return the points that are measured in a photo, rejected image points apart."""
        rays, number = self.rays, self.names.photo[photo]
        there = (rays.photo == number) & (rays.status >= 0) & ~rays.having("rejected")
        return {self.names.points[p] for p in rays.point[there].tolist()}

    def _without_rejected(self, units: Sequence[Unit], table: ImageTable) -> Ledger:
        """Drop the rejected observations whose ids come again."""
        again = [i for u in units for i in u.ids if self.status(i) == "rejected"]
        rows = [np.zeros(0, dtype=np.intp)]
        if len(rejected := np.flatnonzero(self.rays.having("rejected"))):
            code = np.array(self.rays.photo[rejected]) * len(self.names.points)
            code += self.rays.point[rejected]
            photo, point, *_ = table.columns()
            rows.append(rejected[np.isin(code, photo * len(self.names.points) + point)])
        keys = dict.fromkeys(self.member.get(i, i) for i in again)
        old = Some(tuple(self.entries[k].unit for k in keys), np.concatenate(rows))
        return self.moved(old, None, "replaced") if old else self

    # -- changes ------------------------------------------------------------------------------

    def moved(
        self,
        some: Some,
        outcome: Outcome | None,
        cause: str,
        *,
        verdicts: Mapping[str, Verdict] | None = None,
        new: bool = False,
    ) -> Ledger:
        """Return the ledger where some observations have an outcome.

        Args:
            some: the observations.
            outcome: what becomes of them; none: they are taken out.
            cause: why.
            verdicts: verdicts on suspects and rejected observations by id.
            new: whether they were not there before.
        """
        if not some:
            return self
        told = verdicts or {}
        entries, member = dict(self.entries), self.member
        before: dict[str, Outcome | None] = {}
        for unit in some.units:
            key = unit.ids[0]
            was = None if key not in entries else entries[key].outcome
            before |= dict.fromkeys(unit.ids, was)
            if outcome is None:
                entries.pop(key, None)
            else:
                entries[key] = Entry(unit, outcome, tuple(told[i] for i in unit.ids if i in told))
            if len(unit.ids) > 1:
                member = dict(member)
                for i in unit.ids[1:]:
                    member.pop(i, None)
                if outcome is not None:
                    member |= dict.fromkeys(unit.ids[1:], key)
        rays = self.rays
        if len(some.rays):
            for row in some.rays.tolist():
                code = int(rays.status[row])
                before[rays.name(self.names, row)] = None if new else OUTCOMES[code]
            by_row: dict[int, Verdict] = {}
            if told:
                names = {r: rays.name(self.names, r) for r in some.rays.tolist()}
                by_row = {r: told[i] for r, i in names.items() if i in told}
            rays = rays.moved(some.rays, outcome, by_row)
        change = Change(before, some.units, some.rays, cause)
        return replace(
            self,
            entries=entries,
            member=member,
            rays=rays,
            changes=(*self.changes, change),
        )

    def without_weights(self, ids: Sequence[str]) -> Ledger:
        """Return the ledger where weighted unknowns have lost their weights, by their names."""
        if not ids:
            return self
        network = without(self.network, list(ids))
        return replace(self, network=network, unweighted=(*self.unweighted, *ids))

    def with_lacks(self, lacks: Mapping[Variable, str]) -> Ledger:
        """Return the ledger where variables lack what is said of them."""
        return replace(self, lacks={**self.lacks, **lacks}) if lacks else self

    def without_lacks(self, gone: Some) -> Ledger:
        """Return the ledger without what is said of variables that nothing observes any more."""
        lost = {v for u in gone.units for v in u.unknowns if v in self.lacks}
        lost |= {
            v
            for p in self.rays.point[gone.rays].tolist()
            if (v := ("point", self.names.points[p])) in self.lacks
        }
        for entry in self.entries.values() if lost else ():
            lost.difference_update(entry.unit.unknowns)
        seen = self.rays.point[self.rays.status != GONE]
        lost = {v for v in lost if v[0] != "point" or self.names.point[v[1]] not in seen}
        return replace(self, lacks={v: w for v, w in self.lacks.items() if v not in lost})

    def with_values(self, kind: VariableKind, found: Mapping[str, Array]) -> Ledger:
        """Return the ledger with approximate values where none were given."""
        network = self.network
        filled: dict[str, Sequence[float]] = {}
        for name, value in found.items():
            changed = _filled(network, kind, name, value)
            if changed is not None:
                if network is self.network:
                    network = network.copy()
                filled[name] = np.asarray(value).tolist()
                if isinstance(changed, Point):
                    network.points[name] = changed
                else:
                    network.photos[name] = changed
        if not filled:
            return self
        before = {**self.filled, kind: {**self.filled.get(kind, {}), **filled}}
        return replace(self, network=network, filled=before)

    def recorded(self) -> Ledger:
        """Return the ledger without what was noted for the journal."""
        return replace(self, changes=(), filled={}, unweighted=(), rays=self.rays.compacted())

    # -- questions ----------------------------------------------------------------------------

    def has(self, ident: str) -> bool:
        """Return whether there is an observation of this id."""
        return self.status(ident) != "gone"

    def entry(self, ident: str) -> Entry | None:
        """Return the entry of a unit by any id of its; none where there is none."""
        return self.entries.get(self.member.get(ident, ident))

    def status(self, ident: str) -> str:
        """Return what became of an id; ``gone`` where there is none."""
        entry = self.entry(ident)
        if entry is not None:
            return entry.outcome
        rows = self.rays.find(self.names, [ident])
        return OUTCOMES[int(self.rays.status[rows[-1]])] if len(rows) else "gone"

    def find(self, ids: Iterable[str]) -> Some:
        """Return the observations of ids, correlated groups as a whole."""
        units: dict[str, Unit] = {}
        others: list[str] = []
        for ident in ids:
            key = self.member.get(ident, ident)
            if key in self.entries:
                units[key] = self.entries[key].unit
            else:
                others.append(ident)
        return Some(tuple(units.values()), self.rays.find(self.names, others))

    def having(self, outcome: Outcome) -> Some:
        """Return all observations with an outcome."""
        units = tuple(e.unit for e in self.entries.values() if e.outcome == outcome)
        return Some(units, np.flatnonzero(self.rays.having(outcome)))

    def among(self, some: Some, outcome: Outcome) -> Some:
        """Return those of some observations of the ledger that have an outcome."""
        there = ((u, self.entries.get(u.ids[0])) for u in some.units)
        units = tuple(u for u, e in there if e is not None and e.outcome == outcome)
        return Some(units, some.rays[self.rays.having(outcome)[some.rays]])

    def ids_of(self, some: Some) -> list[str]:
        """Return the ids of observations."""
        out = [i for u in some.units for i in u.ids]
        return out + [self.rays.name(self.names, r) for r in some.rays.tolist()]

    def observation(self, ident: str) -> Observation:
        """Return an observation by its id.

        Raises:
            InputError: no such id.
        """
        some = self.find([ident])
        if some.units:
            unit = some.units[0]
            return unit.observations[unit.ids.index(ident)]
        if not len(some.rays):
            raise InputError(Problem("unknown observation", f"observation {ident!r}"))
        return self.rays.observation(self.names, int(some.rays[0]))

    def verdicts(self, outcome: Outcome) -> Iterator[Verdict]:
        """Iterate over the verdicts on suspects, or on rejected observations."""
        for entry in self.entries.values():
            if entry.outcome == outcome:
                yield from entry.verdicts
        rows = np.flatnonzero(self.rays.having(outcome))
        for row in rows.tolist():
            if row in self.rays.verdicts:
                yield self.rays.verdicts[row]

    @cached_property
    def described(self) -> Network:
        """Everything that was described, with the observations in the graph."""
        return self.with_observations(self.having("accepted"))

    def with_observations(self, some: Some) -> Network:
        """Return the network with some observations."""
        out = self.network.copy()
        out.observations = {}
        for unit in some.units:
            if unit.covariance is None:
                (o,) = unit.observations
                out.observations[unit.ids[0]] = o
                _state_found(out, o)
            else:
                out.add(unit.item)
        out.images = self.rays.table(some.rays)
        return out


def _state_found(network: Network, o: Observation) -> None:
    """State the unknowns that an observation brings with it, such as that of its set."""
    for kind, attribute in o.record.parameters:
        if UNKNOWNS[kind].absent == "found":
            key = parameter_key(UNKNOWNS[kind], attribute, o)
            network.of_kind(kind).setdefault(key, FREE_ORIENTATION)


def _filled(network: Network, kind: VariableKind, name: str, value: Array) -> Point | Photo | None:
    """Return a point or photo with an approximate value; none where all of it is given."""
    if kind == "point":
        point = network.points[name]
        given = np.array(point.coordinates)
        if not np.isnan(given).any():
            return None
        found = np.where(np.isnan(given), value, given)
        return replace(point, coordinates=tuple(found.tolist()))
    photo = network.photos[name]
    if photo.position is not None and photo.rotation is not None:
        return None
    if photo.position is None:
        photo = replace(photo, position=tuple(np.asarray(value)[9:].tolist()))
    if photo.rotation is None:
        photo = replace(photo, rotation=np.array(value[:9]).reshape(3, 3))
    return photo

"""Ledger of all arrived observations and their outcomes, an immutable value, and its changes.

Every change returns another ledger, and notes the change with its cause. The noted changes become a
line of the journal.

"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from math import isnan
from typing import Any

import numpy as np

from ..entities import Camera, ImageTable, Photo, Point, triple
from ..errors import MOST_COMPARED, InputError, Problem, similar
from ..garbage_collection import without_collections
from ..graph.dependence import Variable, components, stated_late
from ..graph.observation_selection import without
from ..models.unknown_registry import VariableKind
from ..network.additions import NO_UNKNOWNS, UnknownsGiven, add_entities
from ..network.network import Network
from ..observations import AnyObservation, Correlated, ImagePoint, Observation
from ..observations.ids import identity, named, number_beyond
from ..types import Array, Index
from .command_input import checked, ticks
from .retired_unknowns import Retired
from .row_store import OUTCOME_CODE, REMOVED, Names, RowColumns, RowStore, Unit, insert_units
from .verdicts import OUTCOMES, Outcome, Side, Verdict


@dataclass(frozen=True, eq=False)
class Ledger:
    """Everything that was described and observed."""

    network: Network
    """Points, photos and other unknowns; it has no observations."""
    names: Names
    """Names of its photos and points."""
    rows: RowStore
    """Observations, correlated groups and image points, in the order of arrival."""
    lacks: Mapping[Variable | str, str] = field(default_factory=dict)
    """Why variables are not determined, and why observations, by their first ids, still wait."""
    next: int = 1
    """Number from which ids are assigned where there is none, beyond all ids that ever were."""
    causes: Mapping[int, str] = field(default_factory=dict)
    """Why rows have changed since the last line of the journal."""
    filled: Mapping[VariableKind, Mapping[str, Sequence[float]]] = field(default_factory=dict)
    """Approximate values that were computed since then."""
    unweighted: tuple[str, ...] = ()
    """Weighted unknowns that lost their weights since then."""
    oriented: Mapping[str, str] = field(default_factory=dict)
    """How photos without poses were oriented since then, by name."""
    sides: Mapping[str, Side] = field(default_factory=dict)
    """Points that readings have moved to their other sides, by the first id of the reading."""
    sizes: dict[Variable, tuple[int, int]] = field(default_factory=dict)
    """Results of `needs` for this network."""
    clock: int = 1
    """Number of the current command; where arrivals have times, at least their `ticks`."""
    time: float | None = None
    """Time of the latest arrival that stated one, seconds."""
    retired: Retired | None = None
    """Linear rows and archive of everything retired; None: nothing was."""

    @classmethod
    @without_collections
    def of(cls, network: Network) -> Ledger:
        """Return a ledger with the observations of a network, all accepted."""
        bare = network.copy()
        bare.observations, bare.clusters, bare.images = {}, [], ImageTable()
        group = {i: (ids, cov) for ids, cov in network.clusters for i in ids}
        units: dict[str, tuple[tuple[Observation, ...], Array | None]] = {}
        for ident, o in network.observations.items():
            if ident not in group:
                units[ident] = (named(o, ident),), None
            elif (ids := group[ident][0])[0] not in units:
                found = tuple(named(network.observations[i], i) for i in ids)
                units[ids[0]] = found, group[ident][1]
        joint = [(group.observations, group.covariance) for group in network.image_groups()]
        made = Unit.of_each(network, [*units.values(), *joint])
        rows = RowStore().with_more(RowColumns.of_units(made), "accepted")
        table = network.images.kept(~network.images.is_joint) if joint else network.images
        rows = rows.with_more(RowColumns(table), "accepted")
        number = number_beyond([*network.observations, *network.images.ids.values()])
        return cls(bare, Names.of(bare), rows, next=number)

    # -- arrivals -----------------------------------------------------------------------------

    def at(self, time: float) -> Ledger:
        """Return the ledger at the time of an arrival, see `checked`."""
        found = checked(time, self.time)
        return replace(self, time=found, clock=max(self.clock, ticks(found)))

    def with_entities(
        self,
        points: Sequence[Point],
        photos: Sequence[Photo],
        cameras: Sequence[Camera],
        unknowns: UnknownsGiven = NO_UNKNOWNS,
    ) -> Ledger:
        """Return the ledger with new points, photos, cameras and other unknowns.

        A point that is there without coordinates takes those of a given one without other fields,
        as approximate values.

        Raises:
            InputError: all other names that are there already, unknown cameras and points, and
                unknowns that would change observations that are there.
        """
        network = self.network.copy()
        placed = {p.name: p for p in points if self._places(p)}
        new = [p for p in points if placed.get(p.name) is not p]
        problems = add_entities(
            network, points=new, photos=photos, cameras=cameras, unknowns=unknowns
        )
        problems += stated_late(unknowns, self._touched_variables(network))
        if self.retired is not None:
            problems += self.retired.named_again(points, photos)
        if problems:
            raise InputError(problems)
        out = replace(self, network=network, names=Names.of(network), sizes={})
        return out.with_values("point", {n: list(p.coordinates) for n, p in placed.items()})

    def _touched_variables(self, network: Network) -> Iterator[tuple[str, list[Variable]]]:
        """Yield the first id of each unit, and its variables here and in another network.

        Of image points these are the motions of their photos in the other network.
        """
        rows = np.flatnonzero(self.rows.status != REMOVED)
        rays = self.rows.images(rows)
        numbers, first = np.unique(self.rows.photo[rays], return_index=True)
        for number, row in zip(numbers.tolist(), rays[first].tolist(), strict=True):
            if own := network.of_photo(self.names.photos[number]):
                yield self.ids_of(np.array([row]))[0], [*own]
        for _, unit in self.rows.units(rows):
            now = Unit.of(network, unit.observations, unit.covariance).variables
            yield unit.ids[0], [*now, *unit.variables]

    def _places(self, point: Point) -> bool:
        """Return whether a point only gives approximate values to one without coordinates."""
        there = self.network.points.get(point.name)
        if there is None or not any(map(isnan, there.coordinates)):
            return False
        if any(point.fixed) or point.sigma is not None or point.datum or point.check is not None:
            return False
        at = triple(point.coordinates, "coordinates", f"point {point.name!r}")
        return not any(map(isnan, at))

    def taken(self, observations: Sequence[AnyObservation]) -> tuple[Ledger, Index]:
        """Take new observations in as waiting, each with an id; return their rows in order.

        Raises:
            InputError: all unknown names, ids that are there, and points measured twice in a photo.
        """
        self._refuse(observations)
        items, number = self._numbered(observations)
        ids = (identity(o) or "" for item in items for o in _members(item))
        again = self.find(ids)  # rejected, otherwise `_refuse` would have refused it
        ledger = replace(self, next=number).moved(again, None, "replaced")
        return ledger.appended(items, "arrival")

    def _numbered(self, observations: Sequence[AnyObservation]) -> tuple[list[AnyObservation], int]:
        """Return observations that all have ids, and the next number."""
        every = [o for item in observations for o in _members(item)]
        ids = [identity(o) for o in every]
        used, number, new = set(ids), self.next, []
        for o, ident in zip(every, ids, strict=True):
            if ident is None:
                while str(number) in used:
                    number += 1
                ident, number = str(number), number + 1
            new.append(named(o, ident))
        left = iter(new)
        items: list[AnyObservation] = []
        for item in observations:
            own = tuple(islice(left, len(_members(item))))
            if isinstance(item, Correlated):
                items.append(replace(item, observations=own))
            else:
                items.extend(own)
        return items, number_beyond([i for i in ids if i is not None], number)

    def appended(self, items: Sequence[AnyObservation], cause: str) -> tuple[Ledger, Index]:
        """Take observations with ids in as waiting; return their rows in order."""
        is_ray = np.array([isinstance(item, ImagePoint) for item in items], dtype=bool)
        table = ImageTable()
        if is_ray.any():
            rays = [o for o in items if isinstance(o, ImagePoint)]
            table = ImageTable.of(rays, self.names.photo, self.names.point)
        groups = [
            (_members(o), np.asarray(o.covariance) if isinstance(o, Correlated) else None)
            for o in items
            if not isinstance(o, ImagePoint)
        ]
        units = Unit.of_each(self.network, groups)
        ledger = replace(
            self, rows=self.rows.with_more(RowColumns.of_units(units), "waiting", self.clock)
        )
        ledger, of_rays = ledger.with_images(table, cause)
        n = self.rows.n
        rows = np.empty(len(items), dtype=np.intp)
        rows[~is_ray], rows[is_ray] = n + np.arange(len(units)), of_rays
        for row, item in zip(rows.tolist(), items, strict=True):
            if isinstance(item, ImagePoint):
                ledger.rows.note_image(self.network, row, item)
        return ledger.moved(rows, "waiting", cause), rows

    def with_images(self, table: ImageTable, cause: str) -> tuple[Ledger, Index]:
        """Take image points in as waiting; return their rows."""
        n = self.rows.n
        ledger = replace(self, rows=self.rows.with_more(RowColumns(table), "waiting", self.clock))
        rows = n + np.arange(table.size)
        return ledger.moved(rows, "waiting", cause), rows

    def _refuse(self, observations: Sequence[AnyObservation]) -> None:
        """Refuse invalid observations, all together."""
        problems: list[Problem] = []
        seen: set[str] = set()
        there: dict[str, set[str]] = {}
        every = [m for item in observations for m in _members(item)]
        named_here = Counter(i for o in every if (i := identity(o)) is not None)
        rows = self.find(named_here)
        rejected = self.rows.status[rows] == OUTCOME_CODE["rejected"]
        used = set(self.ids_of(rows[~rejected]))
        for _, unit in self.rows.units(rows[rejected]):
            left = [i for i in unit.ids if i not in named_here]
            if left:
                what = f"is of a rejected group: remove {left[0]!r} and the others first"
                problems += [
                    Problem(what, f"observation {i!r}") for i in unit.ids if i in named_here
                ]
        for o in every:
            gone = [] if self.retired is None else self.retired.named_by(o, self.network)
            if gone:
                problems.extend(gone)
                continue
            try:
                self.network.check_names(o, seen)
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
                    continue
                there[o.photo].add(o.point)
            if ident in used or named_here[ident] > 1:
                problems.append(Problem(self._duplicate(ident), o.label()))
        if problems:
            raise InputError(problems)

    def _duplicate(self, ident: str) -> str:
        if self.status(ident) == "gone":
            return f"duplicate id {ident!r}"
        return (
            f"duplicate id {ident!r}: there is an observation with this id already; give the new "
            "one another id, or put it in the place of the old one (replace)"
        )

    def _measured(self, photo: str) -> set[str]:
        """Return the points that are measured in a photo, without rejected image points."""
        status, number = self.rows.status, self.names.photo[photo]
        gone = (REMOVED, OUTCOMES.index("rejected"))
        there = (self.rows.photo == number) & ~np.isin(status, gone)
        out = {self.names.points[p] for p in self.rows.point[there].tolist()}
        for row in self.rows.room.joint_images:
            if row < len(status) and status[row] not in gone:
                out |= {o.points()[0] for o in self.unit(row).observations if photo in o.photos()}
        return out

    # -- changes ------------------------------------------------------------------------------

    def moved(
        self,
        rows: Index,
        outcome: Outcome | None,
        cause: str,
        verdicts: Mapping[str, Verdict] | None = None,
    ) -> Ledger:
        """Return the ledger with a new outcome of some rows.

        Args:
            rows: the rows.
            outcome: their new outcome; None: they are taken out.
            cause: the cause of the change.
            verdicts: verdicts by id on suspects and rejected observations, and on accepted ones
                that a decision by hand let in.
        """
        if not len(rows):
            return self
        moved: dict[int, tuple[Verdict, ...]] = {}
        if verdicts:
            for row in rows.tolist():
                ids = self.rows.ids(self.names, row)
                if own := tuple(verdicts[i] for i in ids if i in verdicts):
                    moved[row] = own
        causes = {**self.causes, **dict.fromkeys(rows.tolist(), cause)}
        return replace(self, rows=self.rows.moved(rows, outcome, moved), causes=causes)

    def without_weights(self, ids: Sequence[str]) -> Ledger:
        """Return the ledger where weighted unknowns, by name, have lost their weights."""
        if not ids:
            return self
        network = without(self.network, list(ids))
        return replace(self, network=network, unweighted=(*self.unweighted, *ids), sizes={})

    def with_lacks(self, lacks: Mapping[Any, str]) -> Ledger:
        """Return the ledger with reasons why variables, or observations, wait."""
        return replace(self, lacks={**self.lacks, **lacks}) if lacks else self

    def without_lacks(self, gone: Index) -> Ledger:
        """Return the ledger without reasons of variables that nothing observes any more."""
        of_ids = {u.ids[0] for u in self.units(gone)} & self.lacks.keys()
        lost = {v for u in self.units(gone) for v in u.variables if v in self.lacks}
        if not lost and not of_ids:
            return self
        there = np.flatnonzero(self.rows.status != REMOVED)
        for _, unit in self.rows.units(there):
            lost.difference_update(unit.variables)
        seen = self.rows.point[self.rows.images(there)]
        lost = {v for v in lost if v[0] != "point" or self.names.point[v[1]] not in seen}
        dropped = lost | of_ids
        return replace(self, lacks={v: w for v, w in self.lacks.items() if v not in dropped})

    def with_values(self, kind: VariableKind, found: Mapping[str, Sequence[float]]) -> Ledger:
        """Return the ledger with approximate values where none were given."""
        entities = self.network.points if kind == "point" else self.network.photos
        changed: dict[str, Point | Photo] = {}
        for name, value in found.items():
            entity = _filled(entities[name], value)
            if entity is not None:
                changed[name] = entity
        if not changed:
            return self
        network = self.network.copy()
        (network.points if kind == "point" else network.photos).update(changed)  # type: ignore[arg-type]
        values = {n: found[n] for n in changed}
        filled = {**self.filled, kind: {**self.filled.get(kind, {}), **values}}
        return replace(self, network=network, filled=filled)

    def recorded(self) -> tuple[Ledger, Index | None]:
        """Return the ledger without changes noted for the journal, and new numbers of rows."""
        rows, new = self.rows.compacted()
        noted: dict[str, Any] = {"causes": {}, "filled": {}, "unweighted": (), "oriented": {}}
        return replace(self, **noted, rows=rows, clock=self.clock + 1), new

    # -- questions ----------------------------------------------------------------------------

    def needs(self, variable: Variable) -> tuple[int, int]:
        """Return how many free components a variable has, and how many of them are weighted."""
        found = self.sizes.get(variable)
        if found is None:
            found = self.sizes[variable] = components(self.network, variable)
        return found

    def having(self, outcome: Outcome) -> Index:
        """Return all rows with an outcome."""
        return self.rows.having(outcome)

    def count(self, outcome: Outcome) -> int:
        """Return the number of observations with an outcome."""
        return self.rows.count(outcome)

    def find(self, ids: Iterable[str]) -> Index:
        """Return the rows of ids, correlated groups as a whole."""
        return self.rows.find(self.names, ids)

    def missing(self, ids: Iterable[str]) -> list[str]:
        """Return those of some ids that no observation has."""
        every = list(ids)
        there = set(self.ids_of(self.find(every)))
        return [i for i in every if i not in there]

    def unknown(self, ident: str) -> Problem:
        """Return the problem that no observation has an id."""
        if note := self.retirement_note(ident):
            return Problem(note, f"observation {ident!r}")
        there = np.flatnonzero(self.rows.status != REMOVED)
        meant = similar(ident, self.ids_of(there)) if len(there) <= MOST_COMPARED else ""
        return Problem(f"unknown observation{meant}", f"observation {ident!r}")

    def retirement_note(self, ident: str) -> str:
        """Return that an observation was retired, and what to do; empty where it was not."""
        return "" if self.retired is None else self.retired.of_id(ident)

    def status(self, ident: str) -> str:
        """Return the outcome of an id; ``gone`` where there is none."""
        rows = self.find([ident])
        return OUTCOMES[int(self.rows.status[rows[0]])] if len(rows) else "gone"

    def is_accepted(self, ident: str) -> bool:
        """Return whether the observation with an id is in the graph."""
        return self.status(ident) == "accepted"

    def unit(self, row: int) -> Unit:
        """Return a row as a unit."""
        return self.rows.unit(self.network, self.names, row)

    def units(self, rows: Index) -> list[Unit]:
        """Return rows as units."""
        return [self.unit(row) for row in rows.tolist()]

    def ids_of(self, rows: Index) -> list[str]:
        """Return the ids of the observations of rows."""
        return [i for row in rows.tolist() for i in self.rows.ids(self.names, row)]

    def n_scalars(self, rows: Index) -> int:
        """Return the number of scalar rows."""
        rays = self.rows.images(rows)
        return 2 * len(rays) + sum(u.n_scalars for _, u in self.rows.units(rows))

    def observation(self, ident: str) -> Observation:
        """Return an observation by its id.

        Raises:
            InputError: no such id.
        """
        rows = self.find([ident])
        if not len(rows):
            raise InputError(self.unknown(ident))
        unit = self.unit(int(rows[0]))
        return unit.observations[unit.ids.index(ident)]

    def observations(self, first: int = 0) -> list[tuple[str, Observation]]:
        """Return ids and observations of rows from a number on, except image points."""
        rows = np.arange(first, self.rows.n)
        rows = rows[self.rows.status[rows] != REMOVED]
        return [
            pair
            for _, unit in self.rows.units(rows)
            for pair in zip(unit.ids, unit.observations, strict=True)
        ]

    def verdicts(self, outcome: Outcome) -> Iterator[Verdict]:
        """Iterate over the verdicts on suspects, or on rejected observations."""
        for row in self.having(outcome).tolist():
            yield from self.rows.verdicts.get(row, ())

    @property
    def everything(self) -> Network:
        """Everything that was described or that an observation names, without observations."""
        out = self.network.copy()
        for _, unit in self.rows.units(np.flatnonzero(self.rows.status != REMOVED)):
            for o in unit.observations:
                out.state_found(o)
        return out

    @cached_property
    @without_collections
    def described(self) -> Network:
        """Everything that was described, with the observations in the graph."""
        return self.with_rows(self.having("accepted"))

    def with_rows(self, inside: Index) -> Network:
        """Return everything that was described, with the observations of some rows."""
        out = self.network.copy()
        if self.retired is not None:
            self.retired.state_found(out)
        out.images = self.rows.table(self.rows.images(inside))
        insert_units(out, (unit for _, unit in self.rows.units(inside)))
        return out


def _members(item: AnyObservation) -> tuple[Observation, ...]:
    return item.observations if isinstance(item, Correlated) else (item,)


def _filled(entity: Point | Photo, value: Sequence[float]) -> Point | Photo | None:
    """Return a point or photo with an approximate value; None where it has all values."""
    if isinstance(entity, Point):
        given = entity.coordinates
        if not isnan(sum(given)):
            return None
        found = tuple([v if isnan(g) else g for g, v in zip(given, value, strict=True)])
        other = object.__new__(Point)  # all other attributes are unchanged
        vars(other).update(vars(entity), coordinates=found)
        return other
    if entity.position is not None and entity.rotation is not None:
        return None
    x, y, z = value[9:]
    position = entity.position or (x, y, z)
    rotation = np.array(value[:9]).reshape(3, 3) if entity.rotation is None else entity.rotation
    return replace(entity, position=position, rotation=rotation)

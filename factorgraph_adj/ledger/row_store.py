"""Store of arrived observations as rows: units and image points in columns, with ids and outcomes.

A unit is an observation, or a correlated group, which arrives as a whole. Image points are in
arrays, so that millions of them need no objects. An image point of a correlated group belongs to
its group.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..entities import FREE_ORIENTATION, ImageTable
from ..graph.block_construction import attribute_keys
from ..graph.dependence import Variable, variables_of_each
from ..graph.variables import calibration_name
from ..network.network import Network
from ..observations import AnyObservation, Correlated, ImagePoint, Observation, observation_kind
from ..observations.ids import identity
from ..stochastic_model import StandardDeviation
from ..types import Array, Index, Mask
from .verdicts import OUTCOMES, Outcome, Verdict

REMOVED = -1
"""Status of a row that was taken out; `Rows.compacted` reuses its space."""
OUTCOME_CODE: dict[Outcome, int] = {outcome: number for number, outcome in enumerate(OUTCOMES)}
"""Status of a row by its outcome."""
NO_PHOTO = -1
"""Number of the photo of rows that are no image points."""


@dataclass(frozen=True, eq=False)
class Unit:
    """One observation, or a correlated group."""

    ids: tuple[str, ...]
    """Ids of its observations."""
    observations: tuple[Observation, ...]
    """These, each with its id (image points: where it has one of its own)."""
    covariance: Array | None
    """Joint covariance of a group."""
    variables: tuple[Variable, ...]
    """Variables that they depend on."""

    @classmethod
    def of(
        cls, network: Network, observations: Iterable[Observation], covariance: Array | None
    ) -> Unit:
        """Return the unit of observations that have ids."""
        return cls.of_each(network, [(tuple(observations), covariance)])[0]

    @classmethod
    def of_each(
        cls, network: Network, groups: Sequence[tuple[tuple[Observation, ...], Array | None]]
    ) -> list[Unit]:
        """Return the units of observations that have ids, each with its covariance."""
        each = iter(variables_of_each(network, [o for own, _ in groups for o in own]))
        out = []
        for own, covariance in groups:
            variables = next(each)
            for _ in own[1:]:
                variables = tuple(dict.fromkeys((*variables, *next(each))))
            # Marks on film depend on no pose, but are in a network only with their photo, and a
            # photo only with its calibration.
            of_photos = (("pose", name) for o in own for name in o.photos())
            variables = tuple(dict.fromkeys((*variables, *of_photos)))
            if photos := [name for kind, name in variables if kind == "pose"]:
                lenses = (("calibration", calibration_name(network, f)) for f in photos)
                variables = tuple(dict.fromkeys((*variables, *lenses)))
            out.append(cls(tuple(identity(o) or "" for o in own), own, covariance, variables))
        return out

    @cached_property
    def n_scalars(self) -> int:
        """Number of scalar rows."""
        return sum([len(o.component_names()) for o in self.observations])

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the points that it touches."""
        return tuple(name for kind, name in self.variables if kind == "point")

    @property
    def item(self) -> AnyObservation:
        """The observation or group, as the network takes it."""
        if self.covariance is None:
            return self.observations[0]
        return Correlated(self.observations, self.covariance)

    def without(self, network: Network, gone: set[str]) -> Unit | None:
        """Return what remains of a group without some ids; None where nothing does."""
        stays = [i not in gone for i in self.ids]
        if self.covariance is None or not any(stays):
            return None
        sizes = [len(o.component_names()) for o in self.observations]
        rows = np.flatnonzero(np.repeat(stays, sizes))
        left = [o for o, s in zip(self.observations, stays, strict=True) if s]
        return Unit.of(network, left, self.covariance[np.ix_(rows, rows)])

    def scaled(self, by: float) -> AnyObservation:
        """Return the observation or group with its standard deviations multiplied."""
        scaled = tuple(_scaled(o, by) for o in self.observations)
        if self.covariance is None:
            return scaled[0]
        return Correlated(scaled, self.covariance * by**2)


def insert_units(network: Network, units: Iterable[Unit]) -> None:
    """Add observations and groups to a network; their names have been checked.

    Unknowns that nobody has to state, such as orientations, are stated in the order in which
    observations name them. Keys are looked up once for all observations in which they are equal.
    """
    every: list[Observation] = []
    for unit in units:
        every += unit.observations
        if unit.covariance is not None and isinstance(unit.observations[0], ImagePoint):
            network.join_image_points(Correlated(unit.observations, unit.covariance))
            continue
        for ident, o in zip(unit.ids, unit.observations, strict=True):
            if isinstance(o, ImagePoint):
                network.insert(o)
            else:
                network.observations[ident] = o
        if unit.covariance is not None:
            network.clusters.append((unit.ids, unit.covariance))
    by_kind: dict[str, list[int]] = {}
    first: set[int] = set()  # observations that name unknowns which no earlier one has named
    for place, o in enumerate(every):
        by_kind.setdefault(o.kind, []).append(place)
        if o.further:
            first.add(place)
    for name, places in by_kind.items():
        own = [every[place] for place in reversed(places)]
        for kind, attribute in observation_kind(name).found:
            keys = attribute_keys(kind, attribute, own)
            first |= set(dict(zip(keys, reversed(places), strict=True)).values())
    for place in sorted(first):
        for kind, key in every[place].found_parameters():
            network.of_kind(kind).setdefault(key, FREE_ORIENTATION)


def _scaled(o: Observation, by: float) -> Observation:
    changes: dict[str, Any] = {}
    sigma = getattr(o, "sigma", None)
    if isinstance(sigma, StandardDeviation):
        changes["sigma"] = sigma.scaled(by)
    elif isinstance(sigma, tuple):
        changes["sigma"] = tuple(s * by for s in sigma)
    elif sigma is not None:
        changes["sigma"] = sigma * by
    covariance = getattr(o, "covariance", None)
    if covariance is not None:
        changes["covariance"] = np.asarray(covariance) * by**2
    return replace(o, **changes)


@dataclass(frozen=True)
class Names:
    """Names and numbers of the photos and points of a network."""

    photos: tuple[str, ...]
    """Names of the photos, by number."""
    points: tuple[str, ...]
    """Names of the points, by number."""
    photo: Mapping[str, int]
    """Numbers of the photos, by name."""
    point: Mapping[str, int]
    """Numbers of the points, by name."""

    @classmethod
    def of(cls, network: Network) -> Names:
        """Return the names of a network."""
        numbers = network.photo_number, network.point_number
        return cls(tuple(network.photos), tuple(network.points), *numbers)


class RowColumns:
    """Columns of rows, shared by several tables: each uses the rows up to its own end.

    A table appends in place if no other table has used the rows after its end, otherwise to a
    copy. Rows in use are never changed.
    """

    def __init__(self, table: ImageTable | None = None) -> None:
        """Take over image points."""
        given = table or ImageTable()
        self.columns: list[Any] = [c.copy() for c in (*given.columns(), given.correlation)]
        """Numbers of photo and point, coordinates, standard deviations, correlations, and when each
        arrived, (n, …) each."""
        self.used = len(self.columns[0])
        self.columns.append(np.zeros(self.used, dtype=np.intp))
        self.ids: dict[int, str] = dict(table.ids) if table else {}
        """Ids of image points that differ from photo/point."""
        self.sources: dict[int, str] = dict(table.sources) if table else {}
        """Sources of image points."""
        self.units: dict[int, Unit] = {}
        """Observations and groups by row."""
        self.rows: dict[str, list[int]] = {}
        """Rows by all ids except photo/point, the latest last."""
        self.joint_images: list[int] = []
        """Rows of units that are image points with a joint covariance."""
        self.groups: list[int] = []
        """Rows of units that are several observations."""
        self.made: dict[int, Unit] = {}
        """Image points that have been made into units since the last line of the journal."""
        for row, ident in self.ids.items():
            self.rows.setdefault(ident, []).append(row)

    @classmethod
    def of_units(cls, units: Iterable[Unit]) -> RowColumns:
        """Return the columns of units."""
        found = list(units)
        out, n = cls(), len(found)
        nobody = np.full(n, NO_PHOTO, dtype=np.intp)
        nothing = np.zeros((n, 2))
        pairs = [nothing, nothing.copy(), np.zeros(n)]
        out.columns = [nobody, nobody.copy(), *pairs, np.zeros(n, dtype=np.intp)]
        out.used = n
        out._name(0, dict(enumerate(found)), {}, {})
        return out

    def _name(
        self, n: int, units: Mapping[int, Unit], ids: Mapping[int, str], sources: Mapping[int, str]
    ) -> None:
        """Take over what rows have beside numbers, by their places after row n."""
        for row, source in sources.items():
            self.sources[n + row] = source
        for row, ident in ids.items():
            self.ids[n + row] = ident
            self.rows.setdefault(ident, []).append(n + row)
        for row, unit in units.items():
            self.units[n + row] = unit
            if isinstance(unit.observations[0], ImagePoint):
                self.joint_images.append(n + row)
            if len(unit.ids) > 1:
                self.groups.append(n + row)
            for ident in unit.ids:
                self.rows.setdefault(ident, []).append(n + row)

    def kept(self, there: Mask) -> RowColumns:
        """Return columns with some of the first rows, (n,)."""
        new = (np.cumsum(there) - 1).tolist()
        out = RowColumns()
        out.columns = [c[: len(there)][there] for c in self.columns]
        out.used = len(out.columns[0])
        maps = (
            {new[r]: x for r, x in given.items() if r < len(there) and there[r]}
            for given in (self.units, self.ids, self.sources)
        )
        out._name(0, *maps)  # type: ignore[arg-type]
        return out

    def appended(self, n: int, more: RowColumns) -> RowColumns:
        """Return columns with more rows after the first n."""
        end = n + more.used
        room = self if self.used == n else self.kept(np.ones(n, dtype=bool))
        if end > len(room.columns[0]):
            size = max(end, 2 * n, 64)
            grown = [np.empty((size, *c.shape[1:]), c.dtype) for c in room.columns]
            for new, old in zip(grown, room.columns, strict=True):
                new[:n] = old[:n]
            room.columns = grown
        for column, rows in zip(room.columns, more.columns, strict=True):
            column[n:end] = rows
        room._name(n, more.units, more.ids, more.sources)
        room.used = end
        return room


@dataclass(frozen=True, eq=False)
class RowStore:
    """Rows with their outcomes; a value: every change returns another table."""

    status: NDArray[np.int8] = field(default_factory=lambda: np.zeros(0, dtype=np.int8))
    """Outcome of each row, `OUTCOME_CODE` or `REMOVED`, (n,)."""
    room: RowColumns = field(default_factory=RowColumns)
    """Their columns."""
    verdicts: Mapping[int, tuple[Verdict, ...]] = field(default_factory=dict)
    """Verdicts on suspect and rejected rows, and on those that a decision by hand let in."""

    @property
    def n(self) -> int:
        """Number of rows, including those that were taken out."""
        return len(self.status)

    @property
    def photo(self) -> Index:
        """Number of the photo of image points, `NO_PHOTO` of other rows, (n,)."""
        return np.asarray(self.room.columns[0][: self.n])

    @property
    def point(self) -> Index:
        """Number of the point of image points, (n,)."""
        return np.asarray(self.room.columns[1][: self.n])

    @property
    def xy(self) -> Array:
        """Measured coordinates, (n, 2) image units."""
        return np.asarray(self.room.columns[2][: self.n])

    @property
    def sigma(self) -> Array:
        """Standard deviations, (n, 2) image units."""
        return np.asarray(self.room.columns[3][: self.n])

    @property
    def correlation(self) -> Array:
        """Correlations of both coordinates, (n,)."""
        return np.asarray(self.room.columns[4][: self.n])

    @property
    def arrived(self) -> Index:
        """Number of the command with which each row arrived, (n,)."""
        return np.asarray(self.room.columns[5][: self.n])

    def having(self, outcome: Outcome) -> Index:
        """Return the rows that have an outcome."""
        return np.flatnonzero(self.status == OUTCOME_CODE[outcome])

    def count(self, outcome: Outcome) -> int:
        """Return the number of observations that have an outcome; a group is several."""
        mine = self.status == OUTCOME_CODE[outcome]
        groups = (row for row in self.room.groups if row < self.n and mine[row])
        return int(np.count_nonzero(mine)) + sum(len(self.room.units[r].ids) - 1 for r in groups)

    def among(self, rows: Index, outcome: Outcome) -> Index:
        """Return those of some rows that have an outcome."""
        return np.asarray(rows[self.status[rows] == OUTCOME_CODE[outcome]])

    def images(self, rows: Index) -> Index:
        """Return those of some rows that are image points."""
        return np.asarray(rows[self.photo[rows] != NO_PHOTO])

    def units(self, rows: Index) -> Iterator[tuple[int, Unit]]:
        """Iterate over those of some rows that are units."""
        for row in rows[self.photo[rows] == NO_PHOTO].tolist():
            yield row, self.room.units[row]

    # -- changes ------------------------------------------------------------------------------

    def with_more(self, more: RowColumns, outcome: Outcome, arrived: int = 0) -> RowStore:
        """Return the table with more rows."""
        more.columns[5][: more.used] = arrived
        status = np.full(self.n + more.used, OUTCOME_CODE[outcome], dtype=np.int8)
        status[: self.n] = self.status
        return replace(self, status=status, room=self.room.appended(self.n, more))

    def moved(
        self, rows: Index, outcome: Outcome | None, moved: Mapping[int, tuple[Verdict, ...]]
    ) -> RowStore:
        """Return the table with another outcome of some rows; None: they are taken out."""
        status = self.status.copy()
        status[rows] = REMOVED if outcome is None else OUTCOME_CODE[outcome]
        verdicts = self.verdicts
        if verdicts or moved:
            left = set(rows.tolist())
            verdicts = {r: v for r, v in verdicts.items() if r not in left} | dict(moved)
        return replace(self, status=status, verdicts=verdicts)

    def compacted(self) -> tuple[RowStore, Index | None]:
        """Return the table without the rows that were taken out, if these are many.

        Returns:
            The table, and the new numbers of its rows; None: they are unchanged.
        """
        self.room.made.clear()
        there = self.status != REMOVED
        if self.n < 64 or 2 * int(there.sum()) > self.n:
            return self, None
        new = np.where(there, np.cumsum(there) - 1, REMOVED)
        moved = {int(new[r]): v for r, v in self.verdicts.items()}
        return RowStore(self.status[there], self.room.kept(there), moved), new

    def only(self, there: Mask, photo: Index, point: Index) -> RowStore:
        """Return the table with some of its rows, (n,), and new numbers of photos and points."""
        new = np.where(there, np.cumsum(there) - 1, REMOVED)
        moved = {int(new[r]): v for r, v in self.verdicts.items() if there[r]}
        room = self.room.kept(there)
        for column, number in zip(room.columns, (photo, point), strict=False):
            rays = column != NO_PHOTO
            column[rays] = number[column[rays]]
        return RowStore(self.status[there], room, moved)

    # -- questions ----------------------------------------------------------------------------

    def table(self, rows: Index) -> ImageTable:
        """Return image points as a table of a network."""
        out = ImageTable()
        measured = self.xy[rows], self.sigma[rows], self.correlation[rows]
        out.append(self.photo[rows], self.point[rows], *measured)
        for given, found in ((self.room.ids, out.ids), (self.room.sources, out.sources)):
            if given:
                found |= {i: given[r] for i, r in enumerate(rows.tolist()) if r in given}
        return out

    def find(self, names: Names, ids: Iterable[str]) -> Index:
        """Return the rows of ids, in ascending order; ids without a row are ignored."""
        out: list[int] = []
        wanted: dict[int, list[int]] = {}
        for ident in ids:
            own = [r for r in self.room.rows.get(ident, ()) if r < self.n and self.status[r] >= 0]
            if own:
                out.append(own[-1])
                continue
            at = ident.find("/")
            while at >= 0:
                photo, point = names.photo.get(ident[:at]), names.point.get(ident[at + 1 :])
                if photo is not None and point is not None:
                    wanted.setdefault(photo, []).append(point)
                at = ident.find("/", at + 1)
        found = [np.array(out, dtype=np.intp)]
        for photo, points in wanted.items():
            rows = self.measured(photo, np.array(points))
            if self.room.ids:
                rows = rows[np.array([int(r) not in self.room.ids for r in rows], dtype=bool)]
            # A rejected image point may have been measured again: the later one counts.
            _, last = np.unique(self.point[rows][::-1], return_index=True)
            found.append(rows[::-1][last])
        return np.unique(np.concatenate(found))

    def measured(self, photo: int, points: Index) -> Index:
        """Return the rows of some points in a photo, without those that were taken out."""
        rows = np.flatnonzero((self.photo == photo) & (self.status != REMOVED))
        return np.asarray(rows[np.isin(self.point[rows], points)])

    def ids(self, names: Names, row: int) -> tuple[str, ...]:
        """Return the ids of a row."""
        unit = self.room.units.get(row)
        if unit is not None:
            return unit.ids
        own = self.room.ids.get(row)
        return (own or f"{names.photos[self.photo[row]]}/{names.points[self.point[row]]}",)

    def own_ids(self, rows: Index) -> list[str]:
        """Return the ids of those image points among rows that have ids of their own."""
        own = self.room.ids
        return [own[r] for r in self.images(rows).tolist() if r in own] if own else []

    def unit(self, network: Network, names: Names, row: int) -> Unit:
        """Return a row as a unit."""
        unit = self.room.units.get(row) or self.room.made.get(row)
        if unit is not None:
            return unit
        photo, point = names.photos[self.photo[row]], names.points[self.point[row]]
        (x, y), (sx, sy) = self.xy[row].tolist(), self.sigma[row].tolist()
        own, source = self.room.ids.get(row), self.room.sources.get(row)
        rho = float(self.correlation[row])
        named = {"id": own, "source": source}
        o = ImagePoint(photo, point, x, y, sigma=(sx, sy), correlation=rho, **named)
        return self.note_image(network, row, o)

    def note_image(self, network: Network, row: int, o: ImagePoint) -> Unit:
        """Store the unit of an image point, which takes longer to make from the arrays."""
        lens = calibration_name(network, o.photo)
        of_photo = ("pose", o.photo), ("calibration", lens), *network.of_photo(o.photo)
        variables = (*of_photo, ("point", o.point))
        unit = Unit((o.id or f"{o.photo}/{o.point}",), (o,), None, variables)
        self.room.made[row] = unit
        return unit

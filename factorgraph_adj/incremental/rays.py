"""All image points that have arrived, in arrays: what was measured, and what became of each.

An image point of a correlated group belongs to its group (`factorgraph_adj.incremental.units`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..network.entities import ImageTable
from ..network.network import Network
from ..observations import ImagePoint
from ..types import Array, Index, Mask
from .verdicts import OUTCOMES, Outcome, Verdict


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
        numbers = network._photo_number, network._point_number
        return cls(tuple(network.photos), tuple(network.points), *numbers)


GONE = -1
"""Status of a row that was taken out; its room is given back by `Rays.compacted`."""
CODE: dict[Outcome, int] = {outcome: number for number, outcome in enumerate(OUTCOMES)}
"""Status of a row by what became of its image point."""


class Room:
    """Arrays that several tables share: each table uses the rows up to its own end.

    A table appends in place if no other table has used the rows after its end, otherwise to a
    copy. Rows in use are never changed.
    """

    def __init__(self, columns: Sequence[Array | Index]) -> None:
        """Take over the columns, (n, …) each."""
        self.columns: list[Any] = [np.array(c) for c in columns]
        self.used = len(columns[0])

    def appended(self, n: int, more: Sequence[Array | Index]) -> Room:
        """Return a room with rows (m, …) after the first n."""
        end = n + len(more[0])
        room = self
        if self.used != n:
            room = Room([c[:n] for c in self.columns])
        if end > len(room.columns[0]):
            size = max(end, 2 * n, 64)
            grown = [np.empty((size, *c.shape[1:]), c.dtype) for c in room.columns]
            for new, old in zip(grown, room.columns, strict=True):
                new[:n] = old[:n]
            room.columns = grown
        for column, rows in zip(room.columns, more, strict=True):
            column[n:end] = rows
        room.used = end
        return room


def _empty() -> Room:
    none = np.zeros(0, dtype=np.intp)
    return Room([none, none, np.zeros((0, 2)), np.zeros((0, 2))])


@dataclass(frozen=True, eq=False)
class Rays:
    """Image points by row; a value: every change returns another table."""

    status: Array = field(default_factory=lambda: np.zeros(0, dtype=np.int8))
    """What became of each, `CODE` or `GONE`, (n,)."""
    room: Room = field(default_factory=_empty)
    """Numbers of photo and point, coordinates and standard deviations."""
    ids: Mapping[int, str] = field(default_factory=dict)
    """Ids that differ from photo/point, by row."""
    sources: Mapping[int, str] = field(default_factory=dict)
    """Sources by row."""
    verdicts: Mapping[int, Verdict] = field(default_factory=dict)
    """Verdicts on suspects and rejected image points, by row."""

    @property
    def n(self) -> int:
        """Number of rows, taken out ones among them."""
        return len(self.status)

    @property
    def photo(self) -> Index:
        """Number of the photo in the network, (n,)."""
        return np.asarray(self.room.columns[0][: self.n])

    @property
    def point(self) -> Index:
        """Number of the point in the network, (n,)."""
        return np.asarray(self.room.columns[1][: self.n])

    @property
    def xy(self) -> Array:
        """Measured coordinates, (n, 2) image units."""
        return np.asarray(self.room.columns[2][: self.n])

    @property
    def sigma(self) -> Array:
        """Standard deviations, (n, 2) image units."""
        return np.asarray(self.room.columns[3][: self.n])

    def having(self, outcome: Outcome) -> Mask:
        """Return which rows have an outcome, (n,)."""
        return np.asarray(self.status == CODE[outcome])

    # -- changes ------------------------------------------------------------------------------

    def with_table(self, table: ImageTable, outcome: Outcome) -> Rays:
        """Return the table with more rows, in their order."""
        m, n = table.size, self.n
        return replace(
            self,
            status=np.append(self.status, np.full(m, CODE[outcome], dtype=np.int8)),
            room=self.room.appended(n, table.columns()),
            ids={**self.ids, **{n + r: i for r, i in table.ids.items()}},
            sources={**self.sources, **{n + r: s for r, s in table.sources.items()}},
        )

    def moved(self, rows: Index, outcome: Outcome | None, verdicts: Mapping[int, Verdict]) -> Rays:
        """Return the table with another outcome of some rows; none: they are taken out."""
        status = self.status.copy()
        status[rows] = GONE if outcome is None else CODE[outcome]
        told = self.verdicts
        if told or verdicts:
            left = set(rows.tolist())
            told = {r: v for r, v in told.items() if r not in left} | dict(verdicts)
        return replace(self, status=status, verdicts=told)

    def compacted(self) -> Rays:
        """Return the table without the rows that were taken out, where these are many."""
        there = self.status != GONE
        if self.n < 64 or 2 * int(there.sum()) > self.n:
            return self
        new = np.cumsum(there) - 1
        maps = (
            {int(new[r]): x for r, x in given.items() if there[r]}
            for given in (self.ids, self.sources, self.verdicts)
        )
        room = Room([c[: self.n][there] for c in self.room.columns])
        return Rays(self.status[there], room, *maps)  # type: ignore[arg-type]

    # -- questions ----------------------------------------------------------------------------

    def table(self, rows: Mask | Index) -> ImageTable:
        """Return some rows as a table of a network; rows are in ascending order."""
        at = np.flatnonzero(rows) if np.asarray(rows).dtype == bool else np.asarray(rows)
        out = ImageTable()
        out.append(self.photo[at], self.point[at], self.xy[at], self.sigma[at])
        if self.ids or self.sources:
            new = {r: i for i, r in enumerate(at.tolist())}
            out.ids = {new[r]: i for r, i in self.ids.items() if r in new}
            out.sources = {new[r]: s for r, s in self.sources.items() if r in new}
        return out

    def find(self, names: Names, ids: Sequence[str]) -> Index:
        """Return the rows of ids, in ascending order; ids without a row are passed over."""
        out = [np.zeros(0, dtype=np.intp)]
        if not self.n:
            return out[0]
        own = {i: r for r, i in self.ids.items() if self.status[r] != GONE}
        wanted: dict[int, list[int]] = {}
        for ident in ids:
            if ident in own:
                out.append(np.array([own[ident]]))
                continue
            at = ident.find("/")
            while at >= 0:
                photo, point = names.photo.get(ident[:at]), names.point.get(ident[at + 1 :])
                if photo is not None and point is not None:
                    wanted.setdefault(photo, []).append(point)
                at = ident.find("/", at + 1)
        for photo, points in wanted.items():
            rows = self.measured(photo, np.array(points))
            if self.ids:
                rows = rows[[int(r) not in self.ids for r in rows]] if len(rows) else rows
            # A rejected image point may have been measured again: the later one counts.
            _, last = np.unique(self.point[rows][::-1], return_index=True)
            out.append(rows[::-1][last])
        return np.unique(np.concatenate(out))

    def measured(self, photo: int, points: Index) -> Index:
        """Return the rows of some points in a photo, those that were taken out apart."""
        rows = np.flatnonzero((self.photo == photo) & (self.status != GONE))
        return np.asarray(rows[np.isin(self.point[rows], points)])

    def name(self, names: Names, row: int) -> str:
        """Return the id of a row."""
        own = self.ids.get(row)
        if own is not None:
            return own
        return f"{names.photos[self.photo[row]]}/{names.points[self.point[row]]}"

    def observation(self, names: Names, row: int) -> ImagePoint:
        """Return a row as an observation."""
        (x, y), (sx, sy) = self.xy[row].tolist(), self.sigma[row].tolist()
        return ImagePoint(
            names.photos[self.photo[row]],
            names.points[self.point[row]],
            x,
            y,
            sigma=(sx, sy),
            id=self.ids.get(row),
            source=self.sources.get(row),
        )

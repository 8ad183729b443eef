"""Rows of possible sights: partials by the variables of their models, kept between questions.

The partials of a sight change with the places of its ends, by about the shift for the length of the
sight. They are kept until an end has moved by more than `KEPT_SHIFT` of the length of the shortest
sight there, and serve to choose the sights that are worth examining; what is examined is evaluated
at the present estimates, so that no figure depends on what was kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from ..graph.blocks import Block
from ..graph.variables import State
from ..linear_system.cofactor_columns import UNKNOWN
from ..linear_system.rebase import MIN_NOTICED_MOTION
from ..types import Array, Index, Mask
from .candidates import Candidate
from .sight_templates import Places

POINT = 3
"""Number of coordinates of a point."""
KEPT_SHIFT = 1e-5
"""Shift of a point, relative to the length of the shortest sight there, up to which the partials of
its sights are kept: 0.6 mm at 60 m."""
KEPT_SHARE = 0.01
"""Relative uncertainty of bounds of gains from kept partials: these are wrong by 2 `KEPT_SHIFT`,
and their products by 500 times more where both ends of a sight move nearly alike."""

Rows: TypeAlias = tuple[Array, Index]
"""Partials (m, d, w) and columns (m, w), −1: none, of m sights."""


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
    present: Callable[[Index], Rows] | None = None
    """Returns the rows of some sights at the present estimates; None: all are there."""

    @property
    def n(self) -> int:
        """Number of sights."""
        return len(self.a)

    @property
    def uncertain(self) -> float:
        """Relative uncertainty of what follows from ``a``."""
        return 0.0 if self.present is None else KEPT_SHARE

    def rows(self, some: Index) -> Rows:
        """Return the rows of some sights at the present estimates."""
        return (self.a[some], self.columns[some]) if self.present is None else self.present(some)

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
END: Slot = ("point", "target", "")
"""Slot whose columns come last."""


class RowBuilder:
    """Partials of m sights by the numbers of their variables."""

    def __init__(self, m: int, d: int) -> None:
        """Begin without rows."""
        self.m, self.d = m, d
        self.slots: dict[Slot, tuple[Array, Index]] = {END: self._empty(POINT)}

    def _empty(self, width: int) -> tuple[Array, Index]:
        return np.zeros((self.m, self.d, width)), np.full(self.m, -1, dtype=np.intp)

    def add(self, places: Places, number: int, which: Index, block: Block) -> None:
        """Take the rows of a block as row ``number`` of the sights ``which``."""
        rows, by_role = places.partials(block)
        which = which[rows]
        for (kind, index), name, a in zip(block.variables, block.named, by_role, strict=False):
            if not places.varies(kind):
                continue
            end = name in ("station", "target")
            slot = (kind, name, "" if end else block.kind)
            if slot not in self.slots:
                self.slots[slot] = self._empty(a.shape[2])
            into, of = self.slots[slot]
            into[which, number] = a[:, 0]
            of[which] = index[rows]

    def put(self, which: Index, other: RowBuilder) -> None:
        """Replace the rows of some sights by those of another builder."""
        for slot, (a, _) in other.slots.items():
            if slot not in self.slots:
                self.slots[slot] = self._empty(a.shape[2])
        for slot, (into, of) in self.slots.items():
            found = other.slots.get(slot)
            into[which], of[which] = (0.0, -1) if found is None else found

    def rows(self, places: Places) -> Rows:
        """Return partials and columns, `UNKNOWN` for what is not determined; the end comes last."""
        parts, columns = [], []
        for slot in (*(s for s in self.slots if s != END), END):
            a, index = self.slots[slot]
            of_kind = places.of_kind(slot[0])
            at = np.where((index >= 0)[:, None], of_kind[index][:, : a.shape[2]], -1)
            if slot == END or (at != -1).any():
                parts.append(a)
                columns.append(at)
        own = np.concatenate(columns, axis=1)
        return np.where((own == -1)[:, None, :], 0.0, np.concatenate(parts, axis=2)), own


class SightRows:
    """The rows of a family of sights, kept while the points stay where they are."""

    def __init__(
        self,
        places: Places,
        ends: tuple[Index | None, Index],
        depth: int,
        evaluate: Callable[[Places, RowBuilder, Index], None],
        make: Callable[[int], Candidate],
        *,
        kinds: tuple[str, ...],
        reads: Mask | None = None,
        slack: float = np.inf,
        leaves: bool = True,
    ) -> None:
        """Evaluate all sights.

        Args:
            places: values and columns.
            ends: points at which the sights begin, None: at none, and end, (m,) each.
            depth: largest number of rows of a sight.
            evaluate: puts the rows of some sights into a builder.
            make: returns a sight as a candidate.
            kinds: kinds of readings.
            reads: which of these each sight reads, (m, kinds); None: all.
            slack: change of the length of a sight with which others are possible, metres.
            leaves: whether sights end at points, whose columns are the last three, and begin at
                stations, which are few.
        """
        self._ends, self._depth, self._evaluate, self._make = ends, depth, evaluate, make
        self._kinds, self._reads, self._slack, self._leaves = kinds, reads, slack, leaves
        m = len(ends[1])
        self._first = places.coordinates.copy()
        self._shortest = self._lengths()
        self._builder = RowBuilder(m, depth)
        self._renew(places, np.arange(m))
        self._at, self._others = self._first.copy(), self._values(places)
        self._finished: PossibleSights | None = None
        self._tables: dict[str, Index] = {}
        self._motions = np.zeros((0, 0))

    def _lengths(self) -> Array:
        """Return the length of the shortest sight at each point, metres; 1 of GNSS positions."""
        begin, end = self._ends
        out = np.full(len(self._first), np.inf)
        length = np.ones(len(end))
        if begin is not None:
            length = np.linalg.norm(self._first[end] - self._first[begin], axis=1)
            np.minimum.at(out, begin, length)
        np.minimum.at(out, end, length)
        return out

    @staticmethod
    def _values(places: Places) -> State:
        """Return the values of all variables but points on which partials may depend."""
        kinds = {k for b in places.equations.blocks if not b.prior for k, _ in b.variables}
        return {k: places.state[k].copy() for k in kinds if k != "point"}

    def _renew(self, places: Places, which: Index) -> None:
        """Evaluate some sights."""
        part = RowBuilder(len(which), self._depth)
        self._evaluate(places, part, which)
        self._builder.put(which, part)

    def possible(self, places: Places) -> bool:
        """Return whether the same sights are possible now."""
        now = places.coordinates
        there = np.isfinite(now).all(axis=1)
        if not np.array_equal(there, np.isfinite(self._first).all(axis=1)):
            return False
        shift = np.linalg.norm(now[there] - self._first[there], axis=1)
        return 2.0 * float(shift.max(initial=0.0)) < self._slack

    def found(self, places: Places) -> PossibleSights:
        """Return the sights, evaluated again where points have moved too far."""
        self._follow(places)
        kinds = {kind for kind, _, _ in self._builder.slots}
        tables = {k: places.of_kind(k) for k in kinds}
        motions = places.cofactors.motions
        same = np.array_equal(motions, self._motions) and tables.keys() == self._tables.keys()
        same = same and all(np.array_equal(t, self._tables[k]) for k, t in tables.items())
        if self._finished is None or not same:
            self._tables, self._motions = tables, motions
            self._finished = self._told(places, self._builder, self._ends[1])
        found = self._finished

        def present(some: Index) -> Rows:
            part = RowBuilder(len(some), self._depth)
            self._evaluate(places, part, some)
            own = self._told(places, part, self._ends[1][some])
            return own.a, own.columns

        return replace(found, present=present)

    def _follow(self, places: Places) -> None:
        """Evaluate again what depends on variables that have moved too far."""
        values, now = self._values(places), places.coordinates
        if any(_moved(v, self._others[k]) for k, v in values.items()):
            far = np.ones(len(now), dtype=bool)
        else:
            with np.errstate(invalid="ignore"):  # points without a place end no sights
                far = np.linalg.norm(now - self._at, axis=1) > KEPT_SHIFT * self._shortest
        if not far.any():
            return
        begin, end = self._ends
        on = far[end] if begin is None else far[end] | far[begin]
        self._renew(places, np.flatnonzero(on))
        self._at[far] = now[far]
        self._others = values if far.all() else self._others
        self._finished = None

    def _told(self, places: Places, builder: RowBuilder, ends: Index) -> PossibleSights:
        """Return the rows of sights without what says nothing of determined unknowns."""
        a, columns = builder.rows(places)
        lost = ((columns == UNKNOWN)[:, None, :] & (a != 0.0)).any(axis=2)
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
        points = ends if self._leaves else np.full(len(ends), -1, dtype=np.intp)
        about = self._kinds, self._reads
        return PossibleSights(told, columns, points, self._make, lacks, determines, *about)


def _moved(now: Array, before: Array) -> bool:
    """Return whether a value has changed by more than `KEPT_SHIFT`, or is known only now."""
    if now.shape != before.shape or not np.array_equal(np.isnan(now), np.isnan(before)):
        return True
    return bool((np.abs(np.nan_to_num(now - before)) > KEPT_SHIFT).any())

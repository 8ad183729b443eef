"""Observations as linear rows: v(θ) + A(θ) δ, at points of linearisation that can be moved.

Rows of one sort are evaluated at once, whenever they have arrived. An unknown is the movement δ of
a variable from its point of linearisation θ, with x = θ ⊞ δ. What the linear rows miss is measured
and not supposed: the gap g = v(x) − (v(θ) + A(θ) δ) of whitened rows moves no estimate by more than
|g| times its standard deviation, as |Q^½ Aᵀ g| ≤ |g|.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..frames import Frame
from ..graph.dependence import Variable
from ..graph.equations import Equations
from ..graph.variables import State, Unknowns, Variables
from ..models.variables import UNKNOWNS, VariableKind
from ..types import Array, Index, Mask
from .rows import Grown, Rows, Sort, sort_of

OF_SIGMA = 0.5
"""What the change of a standard deviation, relative to itself, counts in a gap."""
SAME = 1e-2
"""Difference of two places, in conditional standard deviations, up to which they are one."""


class Arriving(NamedTuple):
    """Observations that arrive, compiled together."""

    equations: Equations
    """The observations, and what they touch."""
    state: State
    """Values of variables that are new; those that are known stay where they are."""


@dataclass(eq=False)
class Table:
    """The variables of one kind."""

    number: dict[str, int]
    """Number by name."""
    theta: Grown
    """Points of linearisation θ, as in a state."""
    column: Grown
    """Column of each component; −1 for held ones."""
    key: Grown
    """Key of each variable; −1 for constants."""

    def cut(self, n: int) -> None:
        """Drop all variables but the first n."""
        for name in list(self.number)[n:]:
            del self.number[name]
        for each in (self.theta, self.column, self.key):
            each.cut(n)


class Member(NamedTuple):
    """An observation of a unit."""

    sort: Sort
    """Where it stands."""
    row: int
    """Its number there."""


class LinearRows:
    """Observations as linear rows."""

    def __init__(self, frame: Frame) -> None:
        """Begin with nothing.

        Args:
            frame: frame of the coordinates.
        """
        self.frame = frame
        self.tables: dict[VariableKind, Table] = {}
        self.sorts: dict[Sort, Rows] = {}
        self.units: list[tuple[Member, ...]] = []
        """Observations of each unit."""
        self.unit: dict[str, int] = {}
        """Unit of the observation with an id; of weighted unknowns, by their names."""
        self._named: list[tuple[str, int | None]] = []
        """Ids in the order in which they got units, with the units that they had before."""
        self._whitener: dict[int, Array] = {}
        """What whitens a correlated unit."""
        self._gap = Grown()
        """Square of the gap of each unit."""
        self._inside = Grown(dtype=bool)
        """Whether each unit is in."""
        self._first, self._size = Grown(dtype=np.intp), Grown(dtype=np.intp)
        """First column and number of columns of each key."""
        self._alive = Grown(dtype=bool)
        """Which keys have rows."""
        self._key = Grown(dtype=np.intp)
        """Key of each column."""
        self._delta, self._looked, self._diagonal = Grown(), Grown(), Grown()
        """δ, δ at the last look, and the diagonal of N, of each column."""
        self._bound = Grown(fill=np.nan)
        """Upper bound of the standard deviation of each column, as far as it is known."""

    def _place(self, arriving: Arriving, new: dict[Sort, list[Index]]) -> None:
        """Give observations their places, and note their rows by sort."""
        equations, state = arriving
        unknowns = equations.unknowns
        places = {
            kind: self._numbers(kind, table, state[kind]) for kind, table in unknowns.tables.items()
        }
        group = np.full(equations.n_rows, -1)
        for number, cluster in enumerate(equations.clusters):
            group[cluster.rows] = number
        of_unit: dict[str | int, int] = {}
        for block in equations.blocks:
            if not block.n:
                continue
            sort = sort_of(block)
            rows = self.sorts.setdefault(sort, Rows(block))
            joint = group[block.rows].reshape(block.n, -1)[:, 0]
            units = []
            for ident, number in zip(block.ids, joint.tolist(), strict=True):
                # Several axes of an observation of coordinates are one unit, and so is a group.
                name = f"{block.kind} {ident}" if number < 0 else number
                if name not in of_unit:
                    of_unit[name] = len(self.units)
                    self.units.append(())
                self._named.append((ident, self.unit.get(ident)))
                self.unit[ident] = of_unit[name]
                units.append(of_unit[name])
            numbers = [places[kind][index] for kind, index in block.variables]
            at = rows.extend(block, numbers, np.array(units), joint >= 0, equations.network)
            for unit, row in zip(units, at.tolist(), strict=True):
                self.units[unit] += (Member(sort, row),)
            new.setdefault(sort, []).append(at)
        for number, cluster in enumerate(equations.clusters):
            self._whitener[of_unit[number]] = cluster.whitener[:, np.argsort(cluster.rows)]

    def _forget(self, n: int) -> None:
        """Drop all units but the first n, which are out."""
        for rows in self.sorts.values():
            rows.cut(int(np.searchsorted(rows.unit.values, n)))
        while self._named and self.unit[self._named[-1][0]] >= n:
            ident, before = self._named.pop()
            if before is None:
                del self.unit[ident]
            else:
                self.unit[ident] = before
        for unit in range(n, len(self.units)):
            self._whitener.pop(unit, None)
        del self.units[n:]

    def _numbers(self, kind: VariableKind, table: Variables, values: Array) -> Index:
        """Return the numbers of variables; those that are new get one."""
        mine = self.tables.get(kind)
        if mine is None:
            theta = Grown(values.shape[1])
            column = Grown(table.free.shape[1], dtype=np.intp, fill=-1)
            mine = self.tables[kind] = Table({}, theta, column, Grown(dtype=np.intp))
        mine.theta.widen(values.shape[1])
        mine.column.widen(table.free.shape[1])
        out = np.empty(len(table.names), dtype=np.intp)
        for i, name in enumerate(table.names):
            number = mine.number.get(name)
            if number is None:
                number = mine.number[name] = self._new(mine, table, i, values[i])
            out[i] = number
        return out

    def _new(self, mine: Table, table: Variables, i: int, value: Array) -> int:
        """Return the number of a variable that is added to a table."""
        free = np.flatnonzero(table.free[i, : table.size[i]])
        key = self._first.n if len(free) else -1
        column = np.full(mine.column.values.shape[1], -1)
        if len(free):
            self._first.extend(np.array([self._key.n]))
            self._size.extend(np.array([len(free)]))
            self._alive.extend(np.array([False]))
            column[free] = self._key.extend(np.full(len(free), key))
            for each in (self._delta, self._looked, self._diagonal):
                each.extend(np.zeros(len(free)))
            self._bound.extend(np.full(len(free), np.nan))
        stored = np.zeros(mine.theta.values.shape[1])
        stored[: len(value)] = value
        mine.theta.extend(stored[None])
        mine.column.extend(column[None])
        return int(mine.key.extend(np.array([key]))[0])

    def _theta(self) -> State:
        return {kind: table.theta.values for kind, table in self.tables.items()}

    def state(self) -> State:
        """Return the values of all variables, by kind and number."""
        return {
            kind: self._moved(kind, np.arange(table.theta.n)) for kind, table in self.tables.items()
        }

    def carried(self, unknowns: Unknowns, state: State) -> State:
        """Return a state of some unknowns with the values of all variables that are here."""
        out, moving, own = dict(state), unknowns.moving(), self.state()
        for kind, here, there in self._shared(unknowns):
            values = out[kind].copy()
            width = min(values.shape[1], own[kind].shape[1])
            values[here, :width] = np.where(
                moving[kind][here, :width], own[kind][there, :width], values[here, :width]
            )
            out[kind] = values
        return out

    def agrees(self, unknowns: Unknowns, state: State) -> bool:
        """Return whether variables stand in a state within `SAME` conditional standard deviations.

        Args:
            unknowns: their unknowns.
            state: the state.
        """
        own = self.carried(unknowns, state)
        for kind, here, there in self._shared(unknowns):
            columns = self.tables[kind].column.values[there]
            weight = np.where(columns >= 0, self._diagonal.values[columns], 0.0)
            far = np.abs(own[kind][here] - state[kind][here]).max(axis=1, initial=0.0)
            if not (far * np.sqrt(weight.max(axis=1, initial=0.0)) <= SAME).all():
                return False
        return True

    def _shared(self, unknowns: Unknowns) -> Iterable[tuple[VariableKind, Index, Index]]:
        """Iterate over kinds, with numbers of variables in their tables there and here."""
        for kind, table in unknowns.tables.items():
            mine = self.tables.get(kind)
            if mine is None:
                continue
            pairs = [(i, mine.number[n]) for i, n in enumerate(table.names) if n in mine.number]
            if pairs:
                here, there = np.array(pairs).T
                yield kind, here, there

    def _moved(self, kind: VariableKind, numbers: Index) -> Array:
        table = self.tables[kind]
        theta, columns = table.theta.values[numbers], table.column.values[numbers]
        if not (columns >= 0).any():
            return theta
        step = np.where(columns >= 0, self._delta.values[columns], 0.0)
        return UNKNOWNS[kind].retract(theta, step)

    def _forms(self, sort: Sort, rows: Index) -> Iterable[tuple[Array, Index]]:
        """Iterate over the partials (k, d, s) and columns (k, s), −1 held, of each variable."""
        own = self.sorts[sort]
        for j, kind in enumerate(own.kinds):
            a = own.a[j].values[rows] if own.a else np.zeros((len(rows), 1, 0))
            columns = self.tables[kind].column.values[own.index.values[rows, j]]
            yield a, columns[:, : a.shape[2]]

    def _weigh(self, sort: Sort, rows: Index, sign: float) -> None:
        """Add rows to the diagonal of N, or take them from it; groups are for `_weigh_groups`."""
        rows = rows[~self.sorts[sort].joint.values[rows]]
        for a, columns in self._forms(sort, rows):
            on = columns >= 0
            np.add.at(self._diagonal.values, columns[on], sign * (a**2).sum(axis=1)[on])

    def _weigh_groups(self, units: Index, sign: float) -> None:
        """Add correlated units to the diagonal of N, or take them from it."""
        groups = np.array([u for u in units.tolist() if u in self._whitener], dtype=np.intp)
        for terms, _ in self._parts(groups).values():
            for key, a in terms.items():
                first = int(self._first.values[key])
                self._diagonal.values[first : first + a.shape[1]] += sign * (a**2).sum(axis=0)

    def _parts(self, units: Index) -> dict[int, tuple[dict[int, Array], Array]]:
        """Return partials by key, and residuals at θ, of units."""
        rows: dict[Sort, list[int]] = {}
        for unit in units.tolist():
            for sort, row in self.units[unit]:
                rows.setdefault(sort, []).append(row)
        found: dict[Member, tuple[list[tuple[int, Array]], Array]] = {}
        first, key_of = self._first.values, self._key.values
        for sort, own in rows.items():
            at = np.array(own)
            v = self.sorts[sort].v.values[at]
            terms: list[list[tuple[int, Array]]] = [[] for _ in own]
            for a, columns in self._forms(sort, at):
                free: Mask = columns >= 0
                some, every = np.asarray(free.any(axis=1)), np.asarray(free.all(axis=1))
                keys = np.where(some, key_of[columns.max(axis=1, initial=0)], -1).tolist()
                for i, key in enumerate(keys):
                    if key < 0:
                        continue
                    wide = a[i]
                    if not every[i] or wide.shape[1] != self._size.values[key]:
                        wide = np.zeros((a.shape[1], int(self._size.values[key])))
                        wide[:, columns[i][free[i]] - first[key]] = a[i][:, free[i]]
                    terms[i].append((key, wide))
            for i, row in enumerate(own):
                found[Member(sort, row)] = terms[i], v[i]
        return {u: self._joined(u, [found[m] for m in self.units[u]]) for u in units.tolist()}

    def _joined(
        self, unit: int, members: Sequence[tuple[list[tuple[int, Array]], Array]]
    ) -> tuple[dict[int, Array], Array]:
        """Return partials by key, and residuals, of one unit of some observations."""
        if len(members) == 1 and unit not in self._whitener:
            terms, v = members[0]
            return dict(terms), v
        v = np.concatenate([m[1] for m in members])
        joined: dict[int, Array] = {}
        at = 0
        for terms, own in members:
            for key, a in terms:
                joined.setdefault(key, np.zeros((len(v), a.shape[1])))[at : at + len(own)] += a
            at += len(own)
        w = self._whitener.get(unit)
        if w is None:
            return joined, v
        return {key: w @ a for key, a in joined.items()}, w @ v

    def _look(self, moved: float, sigma: Callable[[Index], Array]) -> None:
        """Measure the gaps of rows whose variables have moved since the last look.

        Partials change too, by dA. With s = |dA Q^½| of a row, standard deviations change by no
        more than s of themselves, and the gradient Aᵀv moves estimates by no more than s|v|.

        Args:
            moved: movement in conditional standard deviations from which on rows are looked at.
            sigma: returns upper bounds of the standard deviations of columns.
        """
        weight = np.sqrt(np.maximum(self._diagonal.values, 0.0))
        columns = np.abs(self._delta.values - self._looked.values) * weight > moved
        if not columns.any():
            return
        self._looked.values[columns] = self._delta.values[columns]
        state = self.state()
        groups: dict[int, dict[Member, tuple[Array, float]]] = {}
        for sort, rows in self._touching(columns):
            own = self.sorts[sort]
            units = own.unit.values[rows]
            linear = own.v.values[rows].copy()
            v, partials = own.evaluated(rows, self.frame, state)
            alone = ~own.joint.values[rows]
            scale = np.where(alone[:, None], 1.0, own.weight(rows))
            s = np.zeros_like(v)
            for (a, at), new in zip(self._forms(sort, rows), partials, strict=True):
                linear += np.einsum("nij,nj->ni", a, np.where(at >= 0, self._delta.values[at], 0.0))
                change = np.where((at >= 0)[:, None, :], np.abs(new - a), 0.0)
                some = np.unique(at[(change > 0.0).any(axis=1)])
                bound = np.zeros(len(self._delta.values) + 1)  # the last one is that of −1
                bound[some] = sigma(some)
                s += scale * np.einsum("nij,nj->ni", change, bound[at])
            far = np.linalg.norm(s, axis=1)
            far *= np.maximum(np.linalg.norm(scale * v, axis=1), OF_SIGMA)
            gap = v - linear
            whole = np.linalg.norm(gap, axis=1) + far
            self._gap.values[units[alone]] = whole[alone] ** 2
            for unit, row, g, f in zip(
                units.tolist(), rows.tolist(), gap, far.tolist(), strict=True
            ):
                if unit in self._whitener:
                    groups.setdefault(unit, {})[Member(sort, row)] = g, f
        for unit, parts in groups.items():
            found = [parts[m] for m in self.units[unit]]
            g = self._whitener[unit] @ np.concatenate([g for g, _ in found])
            both = np.linalg.norm(g) + np.linalg.norm([f for _, f in found])
            self._gap.values[unit] = float(both**2)

    def _touching(self, columns: Mask) -> Iterable[tuple[Sort, Index]]:
        """Iterate over the rows inside that touch flagged columns, by sort; groups as wholes."""
        touched = {
            kind: ((table.column.values >= 0) & columns[table.column.values]).any(axis=1)
            for kind, table in self.tables.items()
        }
        hits = {}
        grouped = np.zeros(len(self.units), dtype=bool)
        for sort, own in self.sorts.items():
            index = own.index.values
            hit = np.zeros(len(index), dtype=bool)
            for j, kind in enumerate(own.kinds):
                hit |= touched[kind][index[:, j]]
            hits[sort] = hit
            if self._whitener:
                grouped[own.unit.values[hit & own.joint.values]] = True
        for sort, own in self.sorts.items():
            hit, units = hits[sort], own.unit.values
            if self._whitener:
                hit = hit | grouped[units]
            rows = np.flatnonzero(hit & self._inside.values[units])
            if len(rows):
                yield sort, rows

    @property
    def n_rows(self) -> int:
        """Number of scalar rows."""
        return sum(
            int(self._inside.values[rows.unit.values].sum()) * rows.v.values.shape[1]
            for rows in self.sorts.values()
        )

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns that rows determine."""
        return int(self._size.values[self._alive.values].sum())

    @property
    def vtpv(self) -> float:
        """VᵀPv of the linear rows."""
        units = np.flatnonzero(self._inside.values)
        total = 0.0
        for terms, v in self._parts(units).values():
            r = v + sum(a @ self._delta.values[self._columns_of(k)] for k, a in terms.items())
            total += float(r @ r)
        return total

    def key(self, variable: Variable) -> int:
        """Return the key of a variable."""
        kind, name = variable
        return int(self.tables[kind].key.values[self.tables[kind].number[name]])

    def value(self, kind: VariableKind, name: str) -> Array:
        """Return the estimate of a variable, as in a state."""
        return np.asarray(self._moved(kind, np.array([self.tables[kind].number[name]]))[0])

    def columns(self, kind: VariableKind, name: str) -> Index:
        """Return the columns of the components of a variable, −1 for held ones."""
        table = self.tables[kind]
        return np.asarray(table.column.values[table.number[name]])

    def _columns_of(self, key: int) -> Index:
        first = int(self._first.values[key])
        return np.arange(first, first + int(self._size.values[key]))

    def weight(self, columns: Index) -> Array:
        """Return √N_jj of columns."""
        return np.asarray(np.sqrt(np.maximum(self._diagonal.values[columns], 0.0)))

"""Observations in iSAM2 as linear factors, evaluated anew where what they miss counts.

iSAM2 eliminates, this library linearises: rows of one sort are evaluated at once, whenever they
have arrived, and enter as linear containers. An unknown of the tree is the movement δ of a variable
from its point of linearisation θ, with x = θ ⊞ δ and rows v(θ) + A(θ) δ. Where a variable gets a
new θ, all rows that touch it are replaced in the same update, so that δ counts from the new θ.

What linear rows miss is measured and not supposed: the gap g = v(x) − (v(θ) + A(θ) δ) of whitened
rows moves no estimate by more than |g| times its standard deviation, as |Q^½ Aᵀ g| ≤ |g|.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import gtsam
import numpy as np

from ..errors import AdjustmentError
from ..frames import Frame
from ..graph.dependence import Variable
from ..graph.equations import Equations
from ..graph.variables import State, Variables
from ..models.variables import UNKNOWNS, VariableKind
from ..quality.leave_out import Tested
from ..types import NO_ROWS, Array, Index, Mask
from .rows import Grown, Rows, Sort, sort_of

MOST_TURNS = 10
"""Largest number of times that rows are evaluated anew after an arrival."""
MOVED = 0.1
"""Movement since the last look, in conditional standard deviations 1/√N_jj, from which on the rows
of a variable are looked at: below it they miss less than any accuracy that is asked for."""
KEPT = 0.25
"""Part of the accuracy that the gaps of rows may have together after some were evaluated anew."""
NEAR, SHRINKING = 1e-6, 0.9
"""Norm of all gaps, and ratio of it to the last one, from which on it is rounding."""
AT_REST = 1e-7
"""Norm of all gaps at which `Tree.settle` ends."""


class IndeterminateError(AdjustmentError):
    """Rows do not determine all of their unknowns; the tree is as it was before."""


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


class Member(NamedTuple):
    """An observation of a unit."""

    sort: Sort
    """Where it stands."""
    row: int
    """Its number there."""


class Mark(NamedTuple):
    """A tree before an arrival; iSAM2 is lost where an update fails."""

    version: int
    """Its version."""
    isam: gtsam.ISAM2
    """A copy."""
    forms: dict[Sort, tuple[Array, ...]]
    """Linear forms of each sort."""
    theta: dict[VariableKind, Array]
    """Points of linearisation."""
    n_units: int
    """Number of units."""
    unit: dict[str, int]
    """Units by id."""
    of_units: tuple[Array, ...]
    """What there is of each unit, key and column; copies."""


class Tree:
    """Observations in iSAM2."""

    def __init__(self, frame: Frame, *, accuracy: float = 1e-2) -> None:
        """Begin with nothing.

        Args:
            frame: frame of the coordinates.
            accuracy: largest deviation of an estimate from the minimum, in its σ.
        """
        params = gtsam.ISAM2Params()
        params.setFactorization("CHOLESKY")
        params.enableRelinearization = False
        params.findUnusedFactorSlots = True
        params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.0))
        self.isam = gtsam.ISAM2(params)
        self.frame, self.accuracy = frame, accuracy
        self.tables: dict[VariableKind, Table] = {}
        self.sorts: dict[Sort, Rows] = {}
        self.units: list[tuple[Member, ...]] = []
        """Observations of each unit."""
        self.unit: dict[str, int] = {}
        """Unit of the observation with an id; of weighted unknowns, by their names."""
        self.version = 0
        """Number of changes."""
        self._whitener: dict[int, Array] = {}
        """What whitens a correlated unit."""
        self._slot, self._gap = Grown(dtype=np.intp, fill=-1), Grown()
        """Slot of each unit in iSAM2, −1 without one, and the square of its gap."""
        self._inside = Grown(dtype=bool)
        """Whether each unit is in; those that touch constants alone have no slot."""
        self._first, self._size = Grown(dtype=np.intp), Grown(dtype=np.intp)
        """First column and number of columns of each key."""
        self._alive = Grown(dtype=bool)
        """Which keys have rows."""
        self._key = Grown(dtype=np.intp)
        """Key of each column."""
        self._delta, self._looked, self._diagonal = Grown(), Grown(), Grown()
        """δ, δ at the last look, and the diagonal of N, of each column."""
        self.relinearised = 0
        """Number of units that were evaluated anew."""

    # -- what enters and leaves ---------------------------------------------------------------

    def enter(self, arrivals: Iterable[Arriving]) -> Index:
        """Put observations in, with the variables that they are the first to touch.

        Returns:
            Numbers of the units.

        Raises:
            InputError: names observations whose geometry has no answer.
            IndeterminateError: not all of the new variables are determined.
        """
        before = self.mark()
        begin, first_key = len(self.units), self._first.n
        new: dict[Sort, list[Index]] = {}
        try:
            for arriving in arrivals:
                self._place(arriving, new)
            units = np.arange(begin, len(self.units))
            self._slot.extend(np.full(len(units), -1))
            self._gap.extend(np.zeros(len(units)))
            self._inside.extend(np.ones(len(units), dtype=bool))
            theta = self._theta()
            for sort, rows in new.items():
                self.sorts[sort].linearise(np.concatenate(rows), self.frame, theta)
                self._weigh(sort, np.concatenate(rows), 1.0)
            graph, having = self._factors(units)
            values = gtsam.Values()
            for key in range(first_key, self._first.n):
                if self._alive.values[key]:
                    values.insert(key, np.zeros(int(self._size.values[key])))
            self._update(graph, having, values, [])
        except RuntimeError as error:
            self.restore(before)
            raise IndeterminateError(str(error).strip().splitlines()[0]) from error
        except AdjustmentError:
            self.restore(before)
            raise
        return units

    @property
    def _numbered(self) -> tuple[Grown, ...]:
        of_keys = self._first, self._size, self._alive
        of_columns = self._key, self._delta, self._looked, self._diagonal
        return self._slot, self._gap, self._inside, *of_keys, *of_columns

    def mark(self) -> Mark:
        """Return what `restore` needs to undo what is done from now on."""
        return Mark(
            self.version,
            gtsam.ISAM2(self.isam),
            {sort: rows.forms() for sort, rows in self.sorts.items()},
            {kind: table.theta.values.copy() for kind, table in self.tables.items()},
            len(self.units),
            dict(self.unit),
            tuple(each.values.copy() for each in self._numbered),
        )

    def restore(self, mark: Mark) -> None:
        """Undo what was done since a mark was made; the mark serves once."""
        self.isam, self.version = mark.isam, mark.version
        for sort in [s for s in self.sorts if s not in mark.forms]:
            del self.sorts[sort]
        for sort, forms in mark.forms.items():
            self.sorts[sort].put_back(forms)
        for kind, table in self.tables.items():
            before = mark.theta.get(kind)
            n = 0 if before is None else len(before)
            for name in list(table.number)[n:]:
                del table.number[name]
            for each in (table.theta, table.column, table.key):
                each.cut(n)
            if before is not None:
                table.theta.values[:, : before.shape[1]] = before
        for unit in range(mark.n_units, len(self.units)):
            self._whitener.pop(unit, None)
        del self.units[mark.n_units :]
        self.unit = mark.unit
        for each, copied in zip(self._numbered, mark.of_units, strict=True):
            each.put_back(copied)

    def leave(self, units: Index) -> None:
        """Take units out; what they alone determine must have left before."""
        slots = self._slot.values[units]
        gone = slots[slots >= 0].tolist()
        for unit in units[slots >= 0].tolist():
            for sort, row in self.units[unit]:
                self._weigh(sort, np.array([row]), -1.0)
        self._slot.values[units] = -1
        self._inside.values[units] = False
        self._gap.values[units] = 0.0
        self._update(gtsam.NonlinearFactorGraph(), NO_ROWS, gtsam.Values(), gone)

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
                self.unit[ident] = of_unit[name]
                units.append(of_unit[name])
            numbers = [places[kind][index] for kind, index in block.variables]
            at = rows.extend(block, numbers, np.array(units), joint >= 0)
            for unit, row in zip(units, at.tolist(), strict=True):
                self.units[unit] += (Member(sort, row),)
            new.setdefault(sort, []).append(at)
        for number, cluster in enumerate(equations.clusters):
            self._whitener[of_unit[number]] = cluster.whitener[:, np.argsort(cluster.rows)]

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
        stored = np.zeros(mine.theta.values.shape[1])
        stored[: len(value)] = value
        mine.theta.extend(stored[None])
        mine.column.extend(column[None])
        return int(mine.key.extend(np.array([key]))[0])

    # -- linear forms -------------------------------------------------------------------------

    def _theta(self) -> State:
        return {kind: table.theta.values for kind, table in self.tables.items()}

    def state(self) -> State:
        """Return the values of all variables, by kind and number."""
        return {
            kind: self._moved(kind, np.arange(table.theta.n)) for kind, table in self.tables.items()
        }

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
        """Add rows to the diagonal of N, or take them from it."""
        for a, columns in self._forms(sort, rows):
            on = columns >= 0
            np.add.at(self._diagonal.values, columns[on], sign * (a**2).sum(axis=1)[on])

    def _factors(self, units: Index) -> tuple[gtsam.NonlinearFactorGraph, Index]:
        """Return the factors of units, and which units have one: the others touch constants."""
        graph, having = gtsam.NonlinearFactorGraph(), []
        parts = self._parts(units)
        for unit in units.tolist():
            terms, v = parts[unit]
            if not terms:
                continue
            keys = list(terms)
            at = gtsam.Values()
            for key in keys:
                at.insert(key, np.zeros(terms[key].shape[1]))
            unit_noise = gtsam.noiseModel.Unit.Create(len(v))
            # A JacobianFactor takes three keys at most in Python; a conditional takes any number.
            linear = gtsam.GaussianConditional(list(terms.items()), 1, -v, unit_noise)
            graph.add(gtsam.LinearContainerFactor(linear, at))
            having.append(unit)
            self._alive.values[keys] = True
        return graph, np.array(having, dtype=np.intp)

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

    def _update(
        self,
        graph: gtsam.NonlinearFactorGraph,
        units: Index,
        values: gtsam.Values,
        gone: list[int],
    ) -> None:
        self.version += 1
        result = self.isam.update(graph, values, gone)
        self._slot.values[units] = list(result.getNewFactorsIndices())
        present = np.flatnonzero(self._alive.values[self._key.values])
        self._delta.values[present] = self.isam.getDelta().vector()

    # -- what they miss -----------------------------------------------------------------------

    def follow(self, accuracy: float | None = None, most: int = MOST_TURNS) -> int:
        """Evaluate rows anew until their gaps are small; return the number of updates."""
        allowed = self.accuracy if accuracy is None else accuracy
        moved = MOVED if accuracy is None else 0.0
        last = np.inf
        for turn in range(most):
            self._look(moved)
            gap = self._gap.values
            whole = float(np.sqrt(gap.sum()))
            if whole <= allowed or (whole <= NEAR and whole > SHRINKING * last):
                return turn
            last = whole
            self._anew(_largest(gap, (KEPT * allowed) ** 2), moved)
        return most

    def settle(self) -> int:
        """Evaluate rows anew until nothing is missed; return the number of updates."""
        return self.follow(AT_REST, 3 * MOST_TURNS)

    def _look(self, moved: float) -> None:
        """Measure the gaps of rows whose variables have moved since the last look."""
        weight = np.sqrt(np.maximum(self._diagonal.values, 0.0))
        columns = np.abs(self._delta.values - self._looked.values) * weight > moved
        if not columns.any():
            return
        self._looked.values[columns] = self._delta.values[columns]
        state = self.state()
        gaps: dict[int, list[Array]] = {}
        for sort, rows in self._touching(columns):
            own = self.sorts[sort]
            linear = own.v.values[rows].copy()
            for a, at in self._forms(sort, rows):
                step = np.where(at >= 0, self._delta.values[at], 0.0)
                linear += np.einsum("nij,nj->ni", a, step)
            gap = own.residuals(rows, self.frame, state) - linear
            units = own.unit.values[rows]
            alone = ~own.joint.values[rows]
            self._gap.values[units[alone]] = (gap[alone] ** 2).sum(axis=1)
            for unit, g in zip(units[~alone].tolist(), gap[~alone], strict=True):
                gaps.setdefault(unit, []).append(g)
        for unit, parts in gaps.items():  # all of a group are looked at together
            whole = np.concatenate(parts)
            w = self._whitener[unit]
            if len(whole) == len(w):
                self._gap.values[unit] = float(np.sum((w @ whole) ** 2))

    def _anew(self, units: Index, moved: float) -> None:
        """Give variables of units that have moved new points of linearisation.

        All rows that touch them are replaced.
        """
        weight = np.sqrt(np.maximum(self._diagonal.values, 0.0))
        far = np.abs(self._delta.values) * weight > moved
        keys = np.zeros(self._first.n, dtype=bool)
        for unit in units.tolist():
            for sort, row in self.units[unit]:
                for _, columns in self._forms(sort, np.array([row])):
                    own = columns[columns >= 0]
                    keys[self._key.values[own[far[own]]]] = True
        columns = keys[self._key.values]
        for kind, table in self.tables.items():
            own_keys = table.key.values
            numbers = np.flatnonzero((own_keys >= 0) & keys[own_keys])
            if len(numbers):
                table.theta.values[numbers] = self._moved(kind, numbers)
        self._delta.values[columns] = 0.0
        self._looked.values[columns] = 0.0
        theta = self._theta()
        touched: list[Index] = []
        for sort, rows in list(self._touching(columns)):
            self._weigh(sort, rows, -1.0)
            self.sorts[sort].linearise(rows, self.frame, theta)
            self._weigh(sort, rows, 1.0)
            touched.append(self.sorts[sort].unit.values[rows])
        touching = np.unique(np.concatenate([NO_ROWS, *touched]))
        graph, having = self._factors(touching)
        gone = self._slot.values[having].tolist()
        self.relinearised += len(having)
        self._update(graph, having, gtsam.Values(), gone)
        self._gap.values[touching] = 0.0

    def _touching(self, columns: Mask) -> Iterable[tuple[Sort, Index]]:
        """Iterate over the rows in the tree that touch flagged columns, by sort."""
        for sort, own in self.sorts.items():
            on = self._slot.values[own.unit.values] >= 0
            hit = np.zeros(own.index.n, dtype=bool)
            for j, kind in enumerate(own.kinds):
                at = self.tables[kind].column.values
                touched = ((at >= 0) & columns[at]).any(axis=1)
                hit |= touched[own.index.values[:, j]]
            rows = np.flatnonzero(hit & on)
            if len(rows):
                yield sort, rows

    # -- figures ------------------------------------------------------------------------------

    def tested(self, units: Index) -> Tested:
        """Return units, to be tested against everything else: M = I − A Q Aᵀ after the update."""
        rows, m, v = self._joint(units)
        return Tested(rows, v, lambda u: m[:, u])

    def _joint(self, units: Index) -> tuple[list[Index], Array, Array]:
        """Return the rows of units among those of all, their M, and their residuals."""
        parts = self._parts(units)
        keys = sorted({key for terms, _ in parts.values() for key in terms})
        sizes = self._size.values[keys]
        place = dict(zip(keys, (np.cumsum(sizes) - sizes).tolist(), strict=True))
        n = sum(len(v) for _, v in parts.values())
        every, v, rows, at = np.zeros((n, int(sizes.sum()))), np.zeros(n), [], 0
        for terms, own in parts.values():
            inside = np.arange(at, at + len(own))
            for key, a in terms.items():
                every[inside, place[key] : place[key] + a.shape[1]] += a
            v[inside] = own
            rows.append(inside)
            at += len(own)
        columns = np.concatenate([NO_ROWS, *(self._columns_of(k) for k in keys)])
        q = self.covariance_of(keys)
        m = np.eye(n) - every @ q @ every.T
        return rows, m, v + every @ self._delta.values[columns]

    def least_redundancy(self, units: Index) -> float:
        """Return the smallest eigenvalue of M of all rows of units: 0 where only they tell."""
        m = self._joint(units)[1]
        return float(np.linalg.eigvalsh(0.5 * (m + m.T))[0]) if len(m) else 1.0

    def covariance_of(self, keys: Sequence[int]) -> Array:
        """Return the joint covariance of keys, in their order."""
        if not len(keys):
            return np.zeros((0, 0))
        return np.asarray(self.isam.jointMarginalCovariance(list(keys)).fullMatrix())

    def _columns_of(self, key: int) -> Index:
        first = int(self._first.values[key])
        return np.arange(first, first + int(self._size.values[key]))

    def columns(self, kind: VariableKind, name: str) -> Index:
        """Return the columns of the components of a variable, −1 for held ones."""
        table = self.tables[kind]
        return np.asarray(table.column.values[table.number[name]])

    def weight(self, columns: Index) -> Array:
        """Return √N_jj of columns."""
        return np.asarray(np.sqrt(np.maximum(self._diagonal.values[columns], 0.0)))

    def spread(self, unit: int, columns: Index) -> Array:
        """Return Q Aᵀ of columns (−1: held, 0) with the rows of a unit, (m, d)."""
        terms, v = self._parts(np.array([unit]))[unit]
        keys = sorted({*terms, *self._key.values[columns[columns >= 0]].tolist()})
        of_keys = np.concatenate([NO_ROWS, *(self._columns_of(k) for k in keys)])
        place = np.full(self._key.n, -1)
        place[of_keys] = np.arange(len(of_keys))
        a = np.zeros((len(v), len(of_keys)))
        for key, own in terms.items():
            a[:, place[self._columns_of(key)]] += own
        out = np.zeros((len(columns), len(v)))
        found = self.covariance_of(keys) @ a.T
        out[columns >= 0] = found[place[columns[columns >= 0]]]
        return out

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

    def follow_to_rest(self) -> bool:
        """Evaluate rows anew until their gaps are small; return whether they are."""
        return self.follow() < MOST_TURNS

    def key(self, variable: Variable) -> int:
        """Return the key of a variable."""
        kind, name = variable
        return int(self.tables[kind].key.values[self.tables[kind].number[name]])

    def value(self, kind: VariableKind, name: str) -> Array:
        """Return the estimate of a variable, as in a state."""
        return np.asarray(self._moved(kind, np.array([self.tables[kind].number[name]]))[0])

    def covariance(self, variable: Variable) -> Array:
        """Return the covariance of the free components of a variable."""
        return np.asarray(self.isam.marginalCovariance(self.key(variable)))

    @property
    def vtpv(self) -> float:
        """VᵀPv of the linear rows."""
        units = np.flatnonzero(self._inside.values)
        total = 0.0
        for terms, v in self._parts(units).values():
            r = v + sum(a @ self._delta.values[self._columns_of(k)] for k, a in terms.items())
            total += float(r @ r)
        return total


def _largest(gap: Array, left: float) -> Index:
    """Return the units with the largest gaps, without which the others have no more than left."""
    order = np.argsort(-gap)
    rest = float(gap.sum()) - np.cumsum(gap[order])
    n = int(np.argmax(rest <= left)) + 1
    return order[:n]

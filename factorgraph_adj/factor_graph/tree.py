"""Observations in iSAM2 as linear factors, evaluated anew where what they miss counts.

iSAM2 eliminates, this library linearises: all rows of some observations are evaluated at once, and
enter as linear containers. An unknown of the tree is the movement δ of a variable from its point
of linearisation θ, with x = θ ⊞ δ and rows v(θ) + A(θ) δ. Where a variable gets a new θ, all rows
that touch it are replaced in the same update, so that δ counts from the new θ everywhere.

What linear rows miss is measured and not supposed: the gap v(x) − (v(θ) + A(θ) δ) of whitened rows
moves no estimate by more than its norm times the σ of the estimate, as |Q^½ Aᵀ g| ≤ |g|.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from ..errors import AdjustmentError
from ..graph.dependence import Variable
from ..graph.equations import Equations
from ..graph.variables import State, Variables
from ..models.variables import UNKNOWNS, VariableKind
from ..quality.leave_out import Tested
from ..solve.linear import LinearSystem
from ..types import NO_ROWS, Array, Index, Mask

MOST_TURNS = 10
"""Largest number of times that rows are evaluated anew after an arrival."""
MOVED = 0.1
"""Movement since the last look, in conditional standard deviations 1/√N_jj, from which on the rows
of a variable are looked at: below it they miss less than any accuracy that is asked for."""
KEPT = 0.25
"""Part of the accuracy that the gaps of rows may have together after some were evaluated anew."""
CAPACITY = 64
"""First number of places of arrays that grow."""
AT_REST = 1e-7
"""Norm of all gaps at which `Tree.settle` ends."""
_UNITS = tuple(gtsam.noiseModel.Unit.Create(d) if d else None for d in range(64))


class Indeterminate(AdjustmentError):
    """Rows do not determine all of their unknowns; the tree is as it was before."""


class Grown:
    """An array whose first axis grows."""

    def __init__(self, *shape: int, dtype: type = float, fill: float = 0.0) -> None:
        self._fill = fill
        self._all = np.full((CAPACITY, *shape), fill, dtype=dtype)
        self.n = 0

    @property
    def values(self) -> Array:
        """The array, (n, …); a view."""
        return self._all[: self.n]

    def extend(self, more: Array) -> Index:
        """Append rows, and return their numbers."""
        end = self.n + len(more)
        if end > len(self._all):
            size = (max(end, 2 * len(self._all)), *self._all.shape[1:])
            bigger = np.full(size, self._fill, dtype=self._all.dtype)
            bigger[: self.n] = self.values
            self._all = bigger
        self._all[self.n : end] = more
        numbers = np.arange(self.n, end)
        self.n = end
        return numbers


class Table:
    """The variables of one kind in a tree."""

    def __init__(self, like: Variables) -> None:
        """Begin a table with the widths of another one."""
        self.kind = like.kind
        self.number: dict[str, int] = {}
        self.theta = Grown(like.values.shape[1])
        """Points of linearisation θ, as in a state."""
        self.column = Grown(like.free.shape[1], dtype=np.intp, fill=-1)
        """Column of each component; −1 for held ones."""
        self.key = Grown(dtype=np.intp)

    def names(self) -> list[str]:
        """Return all names, in order."""
        return list(self.number)


@dataclass(eq=False)
class Chunk:
    """Observations that were compiled together."""

    equations: Equations
    """The observations and what they touch."""
    rows: tuple[Index, ...]
    """Rows of each unit: of observations that leave together."""
    places: dict[VariableKind, Index]
    """Numbers of its variables among those of the tree; −1 for constants."""
    columns: Index
    """Columns of the tree of its own columns, (m,); −1 for held components."""
    first: int
    """Number of the first of its units among all units of the tree."""
    a: Array
    """Partials by its free columns at θ, (k, f)."""
    v: Array
    """Residuals at θ, (k,)."""

    @property
    def free(self) -> Index:
        """Columns of the tree that it touches, (f,)."""
        return np.asarray(self.columns[self.columns >= 0])


class Tree:
    """Observations in iSAM2."""

    def __init__(self, *, accuracy: float = 1e-2) -> None:
        """Begin with nothing.

        Args:
            accuracy: largest deviation of an estimate from the minimum, in its σ.
        """
        params = gtsam.ISAM2Params()
        params.setFactorization("CHOLESKY")
        params.enableRelinearization = False
        params.findUnusedFactorSlots = True
        params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.0))
        self.isam = gtsam.ISAM2(params)
        self.accuracy = accuracy
        self.tables: dict[VariableKind, Table] = {}
        self.chunks: list[Chunk] = []
        self._first, self._size = Grown(dtype=np.intp), Grown(dtype=np.intp)
        """First column and number of columns of each key."""
        self._key = Grown(dtype=np.intp)
        """Key of each column."""
        self._delta, self._looked, self._diagonal = Grown(), Grown(), Grown()
        """δ, δ at the last look, and the diagonal of N, of each column."""
        self._alive = Grown(dtype=bool)
        """Which keys have rows."""
        self._chunk, self._own = Grown(dtype=np.intp), Grown(dtype=np.intp)
        """Chunk of each unit, and its number there."""
        self._slot, self._gap = Grown(dtype=np.intp, fill=-1), Grown()
        """Slot of each unit in iSAM2, −1 without one, and the square of its gap."""
        self._touch_unit, self._touch_key = Grown(dtype=np.intp), Grown(dtype=np.intp)
        """Which units touch which keys."""
        self.relinearised = 0
        """Number of units that were evaluated anew."""

    # -- what enters and leaves ---------------------------------------------------------------

    def enter(self, equations: Equations, state: State, units: Sequence[Index]) -> Index:
        """Put observations in, with the variables that they are the first to touch.

        Args:
            equations: the observations, and what they touch.
            state: values of variables that are new; those that are known stay where they are.
            units: rows of each unit, all rows once.

        Returns:
            Numbers of the units.

        Raises:
            InputError: names observations whose geometry has no answer.
            Indeterminate: not all of the new variables are determined.
        """
        undo = gtsam.ISAM2(self.isam)
        places, columns, new = self._placed(equations, state)
        chunk = Chunk(
            equations, tuple(units), places, columns, self._chunk.n, np.zeros((0, 0)), NO_ROWS
        )
        numbers = self._chunk.extend(np.full(len(units), len(self.chunks)))
        self._own.extend(np.arange(len(units)))
        self._slot.extend(np.full(len(units), -1))
        self._gap.extend(np.zeros(len(units)))
        self.chunks.append(chunk)
        self._linearise(chunk)
        graph, with_factor = self._factors(numbers)
        values = gtsam.Values()
        for key in new:
            if self._alive.values[key]:
                values.insert(key, np.zeros(int(self._size.values[key])))
        try:
            self._update(graph, with_factor, values, [])
        except RuntimeError as error:
            self.isam = undo
            raise Indeterminate(str(error).strip().splitlines()[0]) from error
        return numbers

    def leave(self, units: Index) -> None:
        """Take units out; what they alone determine must have left before."""
        slots = self._slot.values[units]
        gone = slots[slots >= 0].tolist()
        self._slot.values[units] = -1
        self._gap.values[units] = 0.0
        self._update(gtsam.NonlinearFactorGraph(), NO_ROWS, gtsam.Values(), gone)

    def _placed(
        self, equations: Equations, state: State
    ) -> tuple[dict[VariableKind, Index], Index, list[int]]:
        """Return the places of variables in the tree, of columns, and the keys that are new."""
        unknowns = equations.unknowns
        places: dict[VariableKind, Index] = {}
        columns = np.full(unknowns.n_columns, -1)
        new: list[int] = []
        for kind, table in unknowns.tables.items():
            on = np.flatnonzero(table.offset >= 0)
            place = np.full(len(table.names), -1)
            places[kind] = place
            if not len(on):
                continue
            mine = self.tables.setdefault(kind, Table(table))
            for i in on.tolist():
                number = mine.number.get(table.names[i])
                if number is None:
                    number = self._new(mine, table, i, state[kind][i])
                    new.append(int(mine.key.values[number]))
                place[i] = number
                size = int(table.size[i])
                at = mine.column.values[number, :size]
                columns[table.offset[i] : table.offset[i] + size] = np.where(
                    table.free[i, :size], at, -1
                )
        return places, columns, new

    def _new(self, mine: Table, table: Variables, i: int, value: Array) -> int:
        """Return the number of a variable that is added to a table."""
        key = len(self._first.values)
        free = np.flatnonzero(table.free[i, : table.size[i]])
        self._first.extend(np.array([self._key.n]))
        self._size.extend(np.array([len(free)]))
        self._alive.extend(np.array([False]))
        column = np.full(mine.column.values.shape[1], -1)
        column[free] = self._key.extend(np.full(len(free), key))
        for each in (self._delta, self._looked, self._diagonal):
            each.extend(np.zeros(len(free)))
        number = len(mine.number)
        mine.number[table.names[i]] = number
        mine.theta.extend(value[None])
        mine.column.extend(column[None])
        mine.key.extend(np.array([key]))
        return number

    # -- linear forms -------------------------------------------------------------------------

    def _state(self, chunk: Chunk, *, moved: bool) -> State:
        """Return the values of the variables of a chunk: x, or θ."""
        state = chunk.equations.unknowns.start()
        for kind, place in chunk.places.items():
            known = place >= 0
            if known.any():
                numbers = place[known]
                values = self.tables[kind].theta.values[numbers]
                state[kind][known] = self._retracted(kind, numbers, values) if moved else values
        return state

    def _retracted(self, kind: VariableKind, numbers: Index, theta: Array) -> Array:
        columns = self.tables[kind].column.values[numbers]
        step = np.where(columns >= 0, self._delta.values[columns], 0.0)
        return UNKNOWNS[kind].retract(theta, step)

    def _linearise(self, chunk: Chunk) -> None:
        """Evaluate the rows of a chunk and their partials at θ."""
        state = self._state(chunk, moved=False)
        system = LinearSystem(chunk.equations.weighted_at(state), state)
        every = np.arange(chunk.equations.n_rows)
        a = system.sparse(every).toarray()[:, chunk.columns >= 0]
        free = chunk.free
        if len(chunk.v):
            np.subtract.at(self._diagonal.values, free, (chunk.a**2).sum(axis=0))
        np.add.at(self._diagonal.values, free, (a**2).sum(axis=0))
        chunk.a, chunk.v, chunk.equations = a, system.residual, system.equations

    def _factors(self, units: Index) -> tuple[gtsam.NonlinearFactorGraph, Index]:
        """Return the factors of units, and which units have one: the others touch constants."""
        graph, having = gtsam.NonlinearFactorGraph(), []
        first, size = self._first.values, self._size.values
        touched: dict[int, list[int]] = defaultdict(list)
        for unit in units.tolist():
            chunk = self.chunks[self._chunk.values[unit]]
            rows = chunk.rows[self._own.values[unit]]
            a, free = chunk.a[rows], chunk.free
            on = np.flatnonzero(a.any(axis=0))
            if not len(on):
                continue
            keys = np.unique(self._key.values[free[on]])
            terms, at = [], gtsam.Values()
            for key in keys.tolist():
                wide = np.zeros((len(rows), int(size[key])), order="F")
                own = on[self._key.values[free[on]] == key]
                wide[:, free[own] - first[key]] = a[:, own]
                terms.append((key, wide))
                at.insert(key, np.zeros(int(size[key])))
            unit_noise = _unit(len(rows))
            linear = gtsam.GaussianConditional(terms, 1, -chunk.v[rows], unit_noise)
            graph.add(gtsam.LinearContainerFactor(linear, at))
            having.append(unit)
            touched[unit] = keys.tolist()
        self._touch(touched)
        return graph, np.array(having, dtype=np.intp)

    def _touch(self, touched: dict[int, list[int]]) -> None:
        """Note which keys units touch; those of a unit that was there before stay noted."""
        new = [u for u in touched if self._slot.values[u] < 0]
        pairs = [(u, k) for u in new for k in touched[u]]
        if pairs:
            units, keys = np.array(pairs).T
            self._touch_unit.extend(units)
            self._touch_key.extend(keys)
            self._alive.values[keys] = True

    def _update(
        self,
        graph: gtsam.NonlinearFactorGraph,
        units: Index,
        values: gtsam.Values,
        gone: list[int],
    ) -> None:
        result = self.isam.update(graph, values, gone)
        self._slot.values[units] = list(result.getNewFactorsIndices())
        found = self.isam.getDelta().vector()
        self._delta.values[self._present()] = found

    def _present(self) -> Index:
        """Return the columns of the keys in the tree, in their order."""
        alive: Mask = self._alive.values[self._key.values]
        return np.flatnonzero(alive)

    # -- what they miss -----------------------------------------------------------------------

    def follow(self, accuracy: float | None = None, most: int = MOST_TURNS) -> int:
        """Evaluate rows anew until their gaps are small; return the number of updates."""
        allowed = self.accuracy if accuracy is None else accuracy
        for turn in range(most):
            moved = MOVED if accuracy is None else 0.0
            self._look(moved)
            gap = self._gap.values
            if float(gap.sum()) <= allowed**2:
                return turn
            self._anew(_largest(gap, (KEPT * allowed) ** 2), moved)
        return most

    def settle(self) -> int:
        """Evaluate rows anew until nothing is missed; return the number of updates."""
        return self.follow(AT_REST, 3 * MOST_TURNS)

    def _look(self, moved: float) -> None:
        """Measure the gaps of rows whose variables have moved since the last look."""
        far = np.abs(self._delta.values - self._looked.values)
        columns = far * np.sqrt(np.maximum(self._diagonal.values, 0.0)) > moved
        self._looked.values[columns] = self._delta.values[columns]
        for number, own in self._by_chunk(self._touching(self._key.values[columns])):
            chunk = self.chunks[number]
            there = chunk.equations.residuals(self._state(chunk, moved=True))
            gap = there - (chunk.v + chunk.a @ self._delta.values[chunk.free])
            for i in own.tolist():
                self._gap.values[chunk.first + i] = float(np.sum(gap[chunk.rows[i]] ** 2))

    def _anew(self, units: Index, moved: float) -> None:
        """Give variables of units that have moved new points of linearisation.

        All rows that touch them are replaced.
        """
        inside = np.zeros(self._slot.n, dtype=bool)
        inside[units] = True
        keys = np.unique(self._touch_key.values[inside[self._touch_unit.values]])
        far = np.abs(self._delta.values) * np.sqrt(np.maximum(self._diagonal.values, 0.0)) > moved
        keys = np.intersect1d(keys, self._key.values[far])
        columns = np.isin(self._key.values, keys)
        for kind, table in self.tables.items():
            numbers = np.flatnonzero(np.isin(table.key.values, keys))
            if len(numbers):
                theta = table.theta.values
                theta[numbers] = self._retracted(kind, numbers, theta[numbers])
        self._delta.values[columns] = 0.0
        self._looked.values[columns] = 0.0
        touching = self._touching(keys)
        for number, _ in self._by_chunk(touching):
            self._linearise(self.chunks[number])
        graph, with_factor = self._factors(touching)
        gone = self._slot.values[with_factor].tolist()
        self.relinearised += len(with_factor)
        self._update(graph, with_factor, gtsam.Values(), gone)
        self._gap.values[touching] = 0.0

    def _touching(self, keys: Index) -> Index:
        """Return the units in the tree that touch some keys."""
        marked = np.zeros(self._first.n, dtype=bool)
        marked[keys] = True
        units = np.unique(self._touch_unit.values[marked[self._touch_key.values]])
        return units[self._slot.values[units] >= 0]

    def _by_chunk(self, units: Index) -> Iterable[tuple[int, Index]]:
        """Iterate over chunks with the numbers of their units among some."""
        chunks = self._chunk.values[units]
        for number in np.unique(chunks).tolist():
            yield number, self._own.values[units[chunks == number]]

    # -- figures ------------------------------------------------------------------------------

    def tested(self, units: Index) -> Tested:
        """Return units, to be tested against everything else: M = I − A Q Aᵀ after the update."""
        keys = np.unique(
            self._touch_key.values[np.isin(self._touch_unit.values, units)]
        )
        columns = np.concatenate([NO_ROWS, *(self._columns_of(k) for k in keys.tolist())])
        place = np.full(self._key.n, -1)
        place[columns] = np.arange(len(columns))
        a, v, rows, at = [], [], [], 0
        for unit in units.tolist():
            chunk = self.chunks[self._chunk.values[unit]]
            own = chunk.rows[self._own.values[unit]]
            wide = np.zeros((len(own), len(columns)))
            inside = place[chunk.free] >= 0
            wide[:, place[chunk.free[inside]]] = chunk.a[np.ix_(own, np.flatnonzero(inside))]
            a.append(wide)
            v.append(chunk.v[own])
            rows.append(np.arange(at, at + len(own)))
            at += len(own)
        q = self.covariance_of(keys)
        every = np.vstack(a)
        m = np.eye(at) - every @ q @ every.T
        residual = np.concatenate(v) + every @ self._delta.values[columns]
        return Tested(rows, residual, lambda u: m[:, u])

    def covariance_of(self, keys: Index) -> Array:
        """Return the joint covariance of keys, in their order."""
        if not len(keys):
            return np.zeros((0, 0))
        return np.asarray(self.isam.jointMarginalCovariance(keys.tolist()).fullMatrix())

    def _columns_of(self, key: int) -> Index:
        first = int(self._first.values[key])
        return np.arange(first, first + int(self._size.values[key]))

    def key(self, variable: Variable) -> int:
        """Return the key of a variable."""
        kind, name = variable
        return int(self.tables[kind].key.values[self.tables[kind].number[name]])

    def value(self, kind: VariableKind, name: str) -> Array:
        """Return the estimate of a variable, as in a state."""
        table = self.tables[kind]
        numbers = np.array([table.number[name]])
        return self._retracted(kind, numbers, table.theta.values[numbers])[0]

    def covariance(self, variable: Variable) -> Array:
        """Return the covariance of the free components of a variable."""
        return np.asarray(self.isam.marginalCovariance(self.key(variable)))

    @property
    def vtpv(self) -> float:
        """VᵀPv of the linear rows."""
        total = 0.0
        for chunk in self.chunks:
            v = chunk.v + chunk.a @ self._delta.values[chunk.free]
            for i, rows in enumerate(chunk.rows):
                unit = chunk.first + i
                if self._slot.values[unit] >= 0:
                    total += float(v[rows] @ v[rows])
        return total


def _unit(d: int) -> gtsam.noiseModel.Base:
    found = _UNITS[d] if d < len(_UNITS) else None
    return gtsam.noiseModel.Unit.Create(d) if found is None else found


def _largest(gap: Array, left: float) -> Index:
    """Return the units with the largest gaps, without which the others have no more than left."""
    order = np.argsort(-gap)
    rest = float(gap.sum()) - np.cumsum(gap[order])
    n = int(np.argmax(rest <= left)) + 1
    return order[:n]

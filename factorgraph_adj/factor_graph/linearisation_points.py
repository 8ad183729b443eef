"""Points of linearisation of variables: keys, columns, movements δ and bounds of their σ.

An unknown is the movement δ of a variable from its point of linearisation θ, with x = θ ⊞ δ.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..graph.dependence import Variable
from ..graph.variables import State, Unknowns, Variables
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..types import Array, Index
from .factor_tests import JointCovariance
from .row_arrays import Grown

MAX_SAME_PLACE_DISTANCE = 1e-2
"""Difference of two places, in conditional standard deviations, up to which they are one."""
MIN_MOVEMENT = 0.1
"""Movement in conditional standard deviations 1/√N_jj from which on a variable of a row that has a
gap gets a new point of linearisation in any case, see `linear_isam2.MIN_SHARE_OF_MOVEMENT`."""
WEAK_SIGMA_RATIO = 3.0
"""Standard deviation in conditional ones from which on less movement is enough: a movement that its
own rows hardly notice turns the direction in which a variable is weak."""


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


class LinearisationPoints:
    """Variables by kind, with columns for what of them is free."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self.tables: dict[VariableKind, Table] = {}
        self._first, self._size = Grown(dtype=np.intp), Grown(dtype=np.intp)
        """First column and number of columns of each key."""
        self._alive = Grown(dtype=bool)
        """Which keys have rows."""
        self._key = Grown(dtype=np.intp)
        """Key of each column."""
        self._delta, self._measured_at, self._diagonal = Grown(), Grown(), Grown()
        """δ, δ at the last look, and the diagonal of N, of each column."""
        self._loosened = 1.0
        """Largest factor by which standard deviations have grown since rows were measured."""
        self._bound = Grown(fill=np.nan)
        """Upper bound of the standard deviation of each column, as far as it is known."""

    def _numbers(self, kind: VariableKind, table: Variables, values: Array) -> Index:
        """Return the numbers of variables; those that are new get one."""
        mine = self.tables.get(kind)
        if mine is None:
            theta = Grown(values.shape[1])
            column = Grown(table.free.shape[1], dtype=np.intp, fill=-1)
            mine = self.tables[kind] = Table({}, theta, column, Grown(dtype=np.intp))
        mine.theta.widen(values.shape[1])
        mine.column.widen(table.free.shape[1])
        there = len(mine.number)
        names = mine.number
        out = np.array([names.setdefault(n, len(names)) for n in table.names], dtype=np.intp)
        if len(names) > there:
            self._extend(mine, table, values, np.flatnonzero(out >= there))
        return out

    def _extend(self, mine: Table, table: Variables, values: Array, new: Index) -> None:
        """Append variables to a table, with keys and columns where something of them is free."""
        width = np.arange(table.free.shape[1])
        free = table.free[new] & (width < table.size[new, None])
        size = free.sum(axis=1)
        own = size[size > 0]
        keys = np.where(size > 0, self._first.n + np.cumsum(size > 0) - 1, -1)
        self._first.extend(self._key.n + np.cumsum(own) - own)
        self._size.extend(own)
        self._alive.extend(np.zeros(len(own), dtype=bool))
        column = np.full((len(new), mine.column.values.shape[1]), -1)
        column[:, : len(width)][free] = self._key.extend(np.repeat(keys[size > 0], own))
        for each in (self._delta, self._measured_at, self._diagonal):
            each.extend(np.zeros(int(own.sum())))
        self._bound.extend(np.full(int(own.sum()), np.nan))
        stored = np.zeros((len(new), mine.theta.values.shape[1]))
        stored[:, : values.shape[1]] = values[new]
        mine.theta.extend(stored)
        mine.column.extend(column)
        mine.key.extend(keys)

    def _theta(self) -> State:
        return {kind: table.theta.values for kind, table in self.tables.items()}

    def state(self) -> State:
        """Return the values of all variables, by kind and number."""
        return {
            kind: self._moved(kind, np.arange(table.theta.n)) for kind, table in self.tables.items()
        }

    def carried(self, unknowns: Unknowns, state: State) -> State:
        """Return a state of some unknowns with the values of all variables that are here."""
        out, moving = dict(state), unknowns.moving()
        for kind, here, there in self._shared(unknowns):
            values, own = out[kind].copy(), self._moved(kind, there)
            width = min(values.shape[1], own.shape[1])
            values[here, :width] = np.where(
                moving[kind][here, :width], own[:, :width], values[here, :width]
            )
            out[kind] = values
        return out

    def agrees(self, unknowns: Unknowns, state: State) -> bool:
        """Return whether variables are where a state has them, within `MAX_SAME_PLACE_DISTANCE`.

        Args:
            unknowns: their unknowns.
            state: the state.
        """
        own = self.carried(unknowns, state)
        for kind, here, there in self._shared(unknowns):
            columns = self.tables[kind].column.values[there]
            weight = np.where(columns >= 0, self._diagonal.values[columns], 0.0)
            far = np.abs(own[kind][here] - state[kind][here]).max(axis=1, initial=0.0)
            far *= np.sqrt(weight.max(axis=1, initial=0.0))
            if not (far <= MAX_SAME_PLACE_DISTANCE).all():
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

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns that rows determine."""
        return int(self._size.values[self._alive.values].sum())

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

    def _moved_from(self) -> Array:
        """Return the movement of each column from which on it is linearised again in any case."""
        weight = np.sqrt(np.maximum(self._diagonal.values, 0.0))
        return np.asarray(
            MIN_MOVEMENT / np.fmax(1.0, self._bound.values * weight / WEAK_SIGMA_RATIO) ** 2
        )

    def bound(self, unknowns: Unknowns, sigma: Array) -> None:
        """Take over upper bounds of standard deviations, by the columns of some unknowns."""
        for kind, here, there in self._shared(unknowns):
            own = self.tables[kind].column.values[there]
            table = unknowns[kind]
            columns = np.where(table.has_column, 0, -1)
            columns[table.has_column] = np.arange(table.columns.start, table.columns.stop)
            n = min(own.shape[1], columns.shape[1])
            own, columns = own[:, :n], columns[here, :n]
            on = (own >= 0) & (columns >= 0)
            self._bound.values[own[on]] = sigma[columns[on]]

    def bound_new(self, entered: JointCovariance) -> None:
        """Take over the standard deviations of columns that had no bounds before units entered."""
        new = np.isnan(self._bound.values[entered.columns])
        variance = np.maximum(np.diag(entered.covariance), 0.0)
        self._bound.values[entered.columns[new]] = np.sqrt(variance[new])

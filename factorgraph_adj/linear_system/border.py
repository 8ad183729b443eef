"""Border of a base: unknowns that it does not have, and the validity of their rows' linear forms.

The unknowns border the low-rank update, see `factorgraph_adj.solve.low_rank_update`: only their own
rows determine them. Each has the value at which these rows were linearised; the update gives its
movement since. Rows are checked: the error of their linear forms moves estimates by at most √Σ|Δv|²
of σ.

"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..graph.dependence import Variable
from ..graph.variables import State, Unknowns
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..types import NO_ROWS, Array, Index
from .linear_system import LinearForms

PREDICTION_MARGIN = 4.0
"""Factor by which errors of forms may grow faster with movement than where they were examined."""


class NewUnknown(NamedTuple):
    """A variable that the base does not have."""

    value: Array
    """Its value as in a state, where its rows were linearised, (width,)."""
    columns: Index
    """Its columns among those of the border; none for a constant."""
    tangent: int
    """Largest number of components of its kind."""
    moving: Array
    """Flags of the values that an adjustment may change, (width,)."""


class LinearisationCheck(NamedTuple):
    """Range in which linear forms were found to hold."""

    movement: Array
    """Movement of new unknowns that they touch, (n,)."""
    gap: float
    """Their error, |Δv|."""
    change: float
    """Bound of the relative change of variances by the change of their partials."""


@dataclass(frozen=True, eq=False)
class WatchedRows:
    """Rows that touch new unknowns."""

    forms: LinearForms
    """Their linear forms."""
    new: Index
    """Which of their columns are free ones of new unknowns, (n,)."""
    place: Index
    """Numbers of these, (n,)."""
    last: LinearisationCheck | None = None
    """Their last examination; None: there was none."""
    half: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """R⁻¹ with the cofactors R Rᵀ of the new unknowns at the first examination, (n, n)."""
    bend: float = 0.0
    """Error of the forms after a movement of σ."""
    turn: float = 0.0
    """Change of variances after it."""

    @classmethod
    def of(cls, forms: LinearForms, border: Border, first: int) -> WatchedRows:
        """Return forms with their columns in a border, to be checked.

        Args:
            forms: the forms.
            border: the border with the new unknowns.
            first: number of columns before its own.
        """
        mine = np.flatnonzero(forms.columns >= first)
        place = border.place[forms.columns[mine] - first]
        return cls(forms, mine[place >= 0], place[place >= 0])

    def ahead(self, movement: Array) -> LinearisationCheck | None:
        """Return the expected check after a movement (m,); None: not known yet."""
        last, here = self.last, movement[self.new]
        if last is None:
            return None
        since = float(np.linalg.norm(self.half @ (here - last.movement)))
        gap = (np.sqrt(last.gap) + np.sqrt(PREDICTION_MARGIN * self.bend) * since) ** 2
        return LinearisationCheck(
            here, float(gap), last.change + PREDICTION_MARGIN * self.turn * since
        )

    def looked(self, movement: Array, cofactors: Array) -> WatchedRows:
        """Return the rows after their examination; see `Border.looked`."""
        values, vectors = np.linalg.eigh(cofactors[np.ix_(self.place, self.place)])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        now = self._look(movement, root)
        if self.last is not None:
            return replace(self, last=now)
        # Along every axis of their error ellipsoid by σ.
        size = np.sqrt(len(values))
        step = np.zeros(len(movement))
        step[self.new] = root.sum(axis=1)
        there = self._look(movement + step, root)
        half = vectors.T / np.sqrt(np.maximum(values, np.finfo(float).tiny))[:, None]
        bend, turn = max(there.gap, now.gap) / size**2, max(there.change, now.change) / size
        return replace(self, last=now, half=half, bend=bend, turn=turn)

    def _look(self, movement: Array, root: Array) -> LinearisationCheck:
        gap, change = self.forms.missed(movement)
        by_new = float(np.linalg.norm(change[:, self.new] @ root))
        relative = float(np.hypot(self.forms.relative(change), 2.0 * by_new))
        return LinearisationCheck(movement[self.new], gap, relative)


@dataclass(frozen=True, eq=False)
class Border:
    """New unknowns beside a base."""

    unknowns: Mapping[Variable, NewUnknown] = field(default_factory=dict)
    """The unknowns."""
    place: Index = field(default_factory=lambda: NO_ROWS)
    """Number of each column among the free ones, (k,); −1: it is held."""
    watched: tuple[WatchedRows, ...] = ()
    """Rows that touch them."""

    @property
    def n(self) -> int:
        """Number of free columns."""
        return int((self.place >= 0).sum())

    def names(self, kind: VariableKind) -> set[str]:
        """Return the names of the new unknowns of a kind."""
        return {name for k, name in self.unknowns if k == kind}

    def with_unknowns(
        self, unknowns: Unknowns, state: State, known: Callable[[VariableKind, str], bool]
    ) -> Border:
        """Return the border with those variables of a network that are not known yet.

        Args:
            unknowns: the unknowns of the network.
            state: their values.
            known: returns whether a variable is known.
        """
        moving, found, place = unknowns.moving(), dict(self.unknowns), self.place
        for kind, table in unknowns.tables.items():
            for number, name in enumerate(table.names):
                if known(kind, name):
                    continue
                at = unknowns.columns(kind, number)
                columns = len(place) + np.arange(len(at))
                free = unknowns.free[at]
                order = np.cumsum(free) + int((place >= 0).sum()) - 1
                place = np.append(place, np.where(free, order, -1))
                value, tangent = np.array(state[kind][number]), table.free.shape[1]
                new = NewUnknown(value, columns, tangent, moving[kind][number])
                found[kind, name] = new
        return replace(self, unknowns=found, place=place.astype(np.intp))

    def watching(self, rows: WatchedRows) -> Border:
        """Return the border with more rows to be checked, if they touch it."""
        return replace(self, watched=(*self.watched, rows)) if len(rows.new) else self

    def value(self, variable: Variable, movement: Array) -> Array:
        """Return the value of a new unknown after a movement of its columns."""
        new = self.unknowns[variable]
        if not len(movement):
            return np.array(new.value)
        step = np.zeros(new.tangent)
        step[: len(movement)] = movement
        return np.asarray(UNKNOWNS[variable[0]].retract(new.value[None], step[None])[0])

    def carried(
        self, unknowns: Unknowns, state: State, value: Callable[[VariableKind, str], Array | None]
    ) -> State:
        """Return a state with values of the new unknowns.

        Args:
            unknowns: the unknowns of the state.
            state: the state.
            value: returns the value of a variable.
        """
        out = dict(state)
        for kind in {kind for kind, _ in self.unknowns}:
            table, values = unknowns[kind], state[kind].copy()
            for name in self.names(kind) & table.number.keys():
                found, moving = value(kind, name), self.unknowns[kind, name].moving
                assert found is not None
                width = min(values.shape[1], len(found))
                row = values[table.number[name], :width]
                row[:] = np.where(moving[:width], found[:width], row)
            out[kind] = values
        return out

    def looked(
        self, moved: Callable[[Index], Array], cofactors: Array, gap: float, change: float
    ) -> tuple[Border, float, float]:
        """Examine the rows, unless their forms are known to hold.

        Args:
            moved: returns the movement of columns.
            cofactors: Q_bb, (n, n).
            gap: largest √Σ|Δv|² of the rows.
            change: largest relative change of variances.

        Returns:
            The border with the range in which the forms hold, √Σ|Δv|², and a bound of the relative
            change of variances.

        Raises:
            InputError: names observations that are degenerate there.
        """
        watched = list(self.watched)
        movements = [moved(w.forms.columns) for w in watched]
        checks = [w.ahead(m) for w, m in zip(watched, movements, strict=True)]
        looked: set[int] = set()
        while len(looked) < len(watched):
            sizes = [
                np.inf if t is None else np.hypot(t.gap / gap, t.change / change) for t in checks
            ]
            if np.linalg.norm(sizes) <= 1.0 or any(sizes[i] > 1.0 for i in looked):
                break
            i = max(set(range(len(watched))) - looked, key=sizes.__getitem__)
            watched[i] = watched[i].looked(movements[i], cofactors)
            checks[i] = watched[i].last
            looked.add(i)
        gaps = [np.inf if t is None else t.gap for t in checks]
        changes = [np.inf if t is None else t.change for t in checks]
        found = replace(self, watched=tuple(watched))
        return found, float(np.linalg.norm(gaps)), float(np.linalg.norm(changes))

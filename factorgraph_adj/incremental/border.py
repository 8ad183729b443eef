"""New unknowns beside a base: what has become known since it was made.

They border the low-rank update, see `factorgraph_adj.solve.update`: nothing is known of them but
what the rows say that touch them. Each stands at the value where these rows were linearised; the
update says how far it has moved since. Rows are watched: what their linear forms miss moves
estimates by at most √Σ|Δv|² of σ.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..graph.dependence import Variable
from ..graph.variables import State, Unknowns
from ..models.variables import UNKNOWNS, VariableKind
from ..types import NO_ROWS, Array, Index
from .forms import Forms

MOST_MOVED = 0.02
"""Movement, relative to σ, from which on rows are looked at again: what their forms miss grows with
its square."""


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


class Watched(NamedTuple):
    """Rows that touch new unknowns, and how far their forms were found to hold."""

    forms: Forms
    """The rows."""
    movement: Array | None = None
    """Movement of their columns at the last look, (m,); none: there was no look."""
    gap: float = 0.0
    """What their forms missed then, |Δv|."""
    change: float = 0.0
    """Bound of the relative change of variances by the change of their partials."""


@dataclass(frozen=True, eq=False)
class Border:
    """New unknowns beside a base."""

    unknowns: Mapping[Variable, NewUnknown] = field(default_factory=dict)
    """The unknowns."""
    place: Index = field(default_factory=lambda: NO_ROWS)
    """Number of each column among the free ones, (k,); −1: it is held."""
    watched: tuple[Watched, ...] = ()
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
        self, first: int, moved: Callable[[Index], Array], cofactors: Array
    ) -> tuple[Border, float, float]:
        """Look at the rows; return the border that knows how far their forms hold.

        The others are √Σ|Δv|², and a bound of the relative change of variances.

        Args:
            first: number of columns before those of the border.
            moved: returns the movement of columns.
            cofactors: Q_bb, (n, n).

        Raises:
            InputError: names observations whose geometry has no answer there.
        """
        values, vectors = np.linalg.eigh(cofactors)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        sigma = np.sqrt(np.maximum(np.diag(cofactors), 0.0))
        out = tuple(self._looked(w, first, moved, root, sigma) for w in self.watched)
        gap, change = (float(np.linalg.norm(x)) for x in zip(*(w[2:] for w in out), strict=True))
        return replace(self, watched=out), gap, change

    def _looked(
        self,
        watched: Watched,
        first: int,
        moved: Callable[[Index], Array],
        root: Array,
        sigma: Array,
    ) -> Watched:
        forms = watched.forms
        movement = moved(forms.columns)
        place = np.full(len(forms.columns), -1, dtype=np.intp)
        mine = forms.columns >= first
        place[mine] = self.place[forms.columns[mine] - first]
        new = place >= 0
        before = watched.movement
        if before is not None:
            since = np.abs(movement - before)[new] / sigma[place[new]]
            if np.max(since, initial=0.0) <= MOST_MOVED:
                return watched
        gap, change = forms.missed(movement)
        by_new = change[:, new] @ root[place[new]]
        relative = np.hypot(forms.relative(change), 2.0 * np.linalg.norm(by_new))
        return Watched(forms, movement, gap, float(relative))

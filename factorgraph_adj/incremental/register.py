"""The variables of the graph: numbers that stay, where they are, and how they are charted.

iSAM2 holds each variable as a plain vector δ of its free components, zero at a chart's origin:
x = origin ⊞ δ, with the tangents of `factorgraph_adj.models.variables.UnknownKind.retract`.
What is held altogether is a constant: it has a number and a value, and no key.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import gtsam
import numpy as np

from ..graph.equations import Equations
from ..graph.keys import KeyMap
from ..graph.variables import State
from ..models.variables import UNKNOWNS, VariableKind
from ..types import Array, Index, Mask
from .growing import Growing

FAR = 1e150
"""Where no variable ever is."""


class Table:
    """The variables of one kind."""

    def __init__(self, kind: VariableKind) -> None:
        """Start without variables."""
        self.kind = kind
        k, w = UNKNOWNS[kind].size, UNKNOWNS[kind].stored
        self.names: list[str] = []
        self.number: dict[str, int] = {}
        self.value = Growing(np.zeros((0, w)))
        """Where they are now."""
        self.origin = Growing(np.zeros((0, w)))
        """Origin of the chart."""
        self.given = Growing(np.zeros((0, w)))
        """Given or approximate values x₀."""
        self.delta = Growing(np.zeros((0, k)))
        """Components in the chart."""
        self.checked = Growing(np.zeros((0, k)))
        """δ where its observations were last compared with their linear form."""
        self.lined = Growing(np.zeros((0, k)))
        """δ where some of them were last linearised."""
        self.radius = Growing(np.zeros(0))
        """How far from ``checked`` it may be until they are compared again, in conditional σ."""
        self.free = Growing(np.zeros((0, k), dtype=bool))
        self.place = Growing(np.zeros((0, k), dtype=np.intp))
        """Place of each component in the vector of all, −1 for those held or not in the graph."""
        self.size = Growing(np.zeros(0, dtype=np.intp))
        self.known = Growing(np.zeros(0, dtype=bool))
        """In the graph, or a constant."""
        self.weight = Growing(np.zeros((0, k)))
        """Diagonal of N."""
        self.variance = Growing(np.zeros((0, k)))
        """Variances as far as they were worked out; further observations make them smaller."""

    def columns(self) -> tuple[Growing, ...]:
        """All arrays."""
        return (
            *(self.value, self.origin, self.given, self.delta, self.checked, self.lined),
            *(self.radius, self.free),
            *(self.place, self.size, self.known, self.weight, self.variance),
        )

    @property
    def n(self) -> int:
        """Number of variables."""
        return len(self.names)

    def far_from(self, point: Growing) -> Array:
        """Return how far the variables are from there, in conditional σ, (n,)."""
        far = np.abs(self.delta.view - point.view) * np.sqrt(self.weight.view)
        return np.asarray(far.max(axis=1, initial=0.0))


class Register:
    """All variables that the graph has or had."""

    def __init__(self) -> None:
        """Start empty."""
        self.tables: dict[VariableKind, Table] = {kind: Table(kind) for kind in UNKNOWNS}
        self.keys: list[int] = []
        """Keys in the graph, in the order of their places."""
        self.n_places = 0
        self.state: State = {}
        self.renew()

    def renew(self) -> None:
        """Take the state from the tables."""
        self.state = {kind: t.value.view for kind, t in self.tables.items()}

    def __getitem__(self, kind: VariableKind) -> Table:
        """Return the variables of a kind."""
        return self.tables[kind]

    def known(self, kind: VariableKind, name: str) -> bool:
        """Return whether it is in the graph, or a constant."""
        table = self.tables[kind]
        number = table.number.get(name)
        return number is not None and bool(table.known.view[number])

    # -- coming and going ---------------------------------------------------------------------

    def absorb(self, equations: Equations, state: State, given: State) -> dict[VariableKind, Index]:
        """Take the variables of some equations over that are not known yet.

        Args:
            equations: whose variables.
            state: their values, which become the origins of their charts.
            given: x₀ of them.

        Returns:
            The number here of every variable there, by kind; −1 for refractions that nothing
            depends on: that of the network stands in all equations, held at zero in such ones.
        """
        out: dict[VariableKind, Index] = {}
        refractions = {
            int(i)
            for block in equations.blocks
            for kind, index in block.variables
            if kind == "refraction"
            for i in np.unique(index)
        }
        for kind, theirs in equations.unknowns.tables.items():
            table = self.tables[kind]
            numbers = np.empty(len(theirs.names), dtype=np.intp)
            fresh = []
            for i, name in enumerate(theirs.names):
                number = table.number.get(name)
                if number is None and kind == "refraction" and i not in refractions:
                    number = -1
                elif number is None:
                    number = table.n
                    table.number[name] = number
                    table.names.append(name)
                    fresh.append(i)
                elif not table.known.view[number]:
                    self._enter(table, np.array([number]), theirs.free[[i]], state[kind][[i]])
                    table.given.view[number, : given[kind].shape[1]] = given[kind][i]
                numbers[i] = number
            if fresh:
                self._append(table, theirs, fresh, state[kind], given[kind])
            out[kind] = numbers
        self.renew()
        return out

    def _append(
        self, table: Table, theirs: object, rows: list[int], state: Array, given: Array
    ) -> None:
        free, size = theirs.free[rows], theirs.size[rows]  # type: ignore[attr-defined]
        for column in (table.value, table.origin, table.given):
            column.widen(state.shape[1], 0.0)
        for column in (table.delta, table.checked, table.lined, table.weight, table.variance):
            column.widen(free.shape[1], 0.0)
        table.free.widen(free.shape[1], False)
        table.place.widen(free.shape[1], -1)
        m = len(rows)
        k, w = table.free.view.shape[1], table.value.view.shape[1]
        first = table.value.n

        def padded(a: Array, width: int) -> Array:
            out = np.zeros((m, width), dtype=a.dtype)
            out[:, : a.shape[1]] = a
            return out

        for column, rows_ in (
            (table.value, padded(state[rows], w)),
            (table.origin, padded(state[rows], w)),
            (table.given, padded(given[rows], w)),
            (table.delta, np.zeros((m, k))),
            (table.checked, np.zeros((m, k))),
            (table.lined, np.zeros((m, k))),
            (table.radius, np.zeros(m)),
            (table.free, padded(free, k)),
            (table.place, np.full((m, k), -1)),
            (table.size, size),
            (table.known, np.zeros(m, dtype=bool)),
            (table.weight, np.zeros((m, k))),
            (table.variance, np.zeros((m, k))),
        ):
            column.append(rows_)
        self._enter(table, np.arange(first, first + m), free, state[rows])

    def _enter(self, table: Table, numbers: Index, free: Mask, values: Array) -> None:
        """Give variables that were not known their places; their charts start at ``values``."""
        k = free.shape[1]
        table.free.view[numbers] = False
        table.free.view[numbers, :k] = free
        for column in (table.value, table.origin):
            column.view[numbers, : values.shape[1]] = values
        for column in (table.delta, table.checked, table.lined, table.weight, table.variance):
            column.view[numbers] = 0.0
        table.radius.view[numbers] = 0.0
        table.known.view[numbers] = True
        count = free.sum(axis=1)
        inside = np.flatnonzero(count)
        if not len(inside):
            return
        place = np.full(table.place.view[numbers].shape, -1, dtype=np.intp)
        place[:, :k][free] = self.n_places + np.arange(int(count.sum()))
        table.place.view[numbers] = place
        self.n_places += int(count.sum())
        self.keys += [KeyMap.of(table.kind, int(i)) for i in numbers[inside]]

    def leave(self, variables: Iterable[tuple[VariableKind, int]]) -> None:
        """Take variables out of the graph."""
        for kind, number in variables:
            table = self.tables[kind]
            table.known.view[number] = False
            table.place.view[number] = -1
        self._lay_out()

    def _lay_out(self) -> None:
        """Number the places anew."""
        self.keys, self.n_places = [], 0
        for table in self.tables.values():
            if not table.n:
                continue
            place, free = table.place.view, table.free.view
            inside = table.known.view & free.any(axis=1)
            place[:] = -1
            mask = free & inside[:, None]
            place[mask] = self.n_places + np.arange(int(mask.sum()))
            self.n_places += int(mask.sum())
            self.keys += [KeyMap.of(table.kind, i) for i in np.flatnonzero(inside).tolist()]

    def marks(self) -> dict[VariableKind, int]:
        """Return how many variables there are, for `forget`."""
        return {kind: t.n for kind, t in self.tables.items()}

    def forget(
        self, marks: dict[VariableKind, int], left: Iterable[tuple[VariableKind, int]]
    ) -> None:
        """Drop the variables beyond ``marks``, and take ``left`` out of the graph."""
        gone = list(left)
        for kind, table in self.tables.items():
            # Places are numbered anew only where some are lost: others may have noted theirs.
            gone += [
                (kind, i) for i in range(marks[kind], table.n) if (table.place.view[i] >= 0).any()
            ]
        for kind, table in self.tables.items():
            for name in table.names[marks[kind] :]:
                del table.number[name]
            del table.names[marks[kind] :]
            for column in table.columns():
                column.truncate(marks[kind])
        if gone:
            self.leave([(kind, i) for kind, i in gone if i < self.tables[kind].n])
        self.renew()

    # -- values -------------------------------------------------------------------------------

    def values(self, keys: Iterable[int] | None = None) -> gtsam.Values:
        """Return the origins as iSAM2 wants them: zero vectors of the free components."""
        out = gtsam.Values()
        for key in self.keys if keys is None else keys:
            out.insert(key, np.zeros(self.dimension(key)))
        return out

    def dimension(self, key: int) -> int:
        """Return the number of free components of a key."""
        kind, number = self.variable(key)
        return int(self.tables[kind].free.view[number].sum())

    @staticmethod
    def variable(key: int) -> tuple[VariableKind, int]:
        """Return kind and number of a key."""
        return _kind_of(key >> 56), key & ((1 << 56) - 1)

    def move_to(self, delta: Array) -> None:
        """Set δ of all variables (n_places,), and their values."""
        x = np.append(delta, 0.0)
        for kind, table in self.tables.items():
            if not table.n:
                continue
            new = x[table.place.view]
            old = table.delta.view
            rows = np.flatnonzero((new != old).any(axis=1))
            if not len(rows):
                continue
            old[rows] = new[rows]
            self._retract(kind, rows)

    def _retract(self, kind: VariableKind, rows: Index) -> None:
        table = self.tables[kind]
        delta, origin = table.delta.view[rows], table.origin.view[rows]
        table.value.view[rows] = UNKNOWNS[kind].retract(origin, delta)

    def note_variances(self, keys: Iterable[int], diagonal: Array) -> None:
        """Note variances of the free components of some variables, one after the other."""
        at = 0
        for key in keys:
            kind, number = self.variable(key)
            table = self.tables[kind]
            free = table.free.view[number]
            n = int(free.sum())
            table.variance.view[number, free] = diagonal[at : at + n]
            at += n

    def variances(self, keys: Iterable[int]) -> Array:
        """Return the variances of the free components of some variables, as they were noted."""
        out = []
        for key in keys:
            kind, number = self.variable(key)
            table = self.tables[kind]
            out.append(table.variance.view[number, table.free.view[number]])
        return np.concatenate(out or [np.zeros(0)])

    def all_variances(self) -> Array:
        """Return the variances of all variables, as they were noted, (n_places,)."""
        out = np.zeros(self.n_places)
        for table in self.tables.values():
            inside = table.place.view >= 0
            out[table.place.view[inside]] = table.variance.view[inside]
        return out

    def lose_variances(self, loss: Array) -> None:
        """Make the variances of all variables smaller, by (n_places,)."""
        padded = np.append(loss, 0.0)
        for table in self.tables.values():
            left = table.variance.view - padded[table.place.view]
            table.variance.view[:] = np.maximum(left, 0.0)

    def vector(self) -> Array:
        """Return δ of all variables, (n_places,)."""
        out = np.zeros(self.n_places)
        for table in self.tables.values():
            inside = table.place.view >= 0
            out[table.place.view[inside]] = table.delta.view[inside]
        return out

    def set_variances(self, diagonal: Array) -> None:
        """Set the variances of all variables, (n_places,)."""
        padded = np.append(diagonal, 0.0)
        for table in self.tables.values():
            table.variance.view[:] = padded[table.place.view]

    def places(self, key: int) -> Index:
        """Return the places of the free components of a variable."""
        kind, number = self.variable(key)
        places = self.tables[kind].place.view[number]
        return np.asarray(places[places >= 0], dtype=np.intp)

    def recentre(self) -> None:
        """Put the origins of all charts where the variables are."""
        for table in self.tables.values():
            table.origin.view[:] = table.value.view
            for column in (table.delta, table.checked, table.lined, table.radius):
                column.view[:] = 0.0

    def turned(self, far: float) -> dict[VariableKind, Index]:
        """Return what is turned from the origin of its chart by more than ``far``, by kind.

        The covariance of a rotation is about the axes of the camera, which turn with it.
        """
        out: dict[VariableKind, Index] = {}
        for kind, table in self.tables.items():
            if UNKNOWNS[kind].rotates:
                turn = np.abs(table.delta.view[:, :3]).max(axis=1, initial=0.0)
                out[kind] = np.flatnonzero(turn > far)
        return {kind: numbers for kind, numbers in out.items() if len(numbers)}

    def recentre_turned(self, turned: Mapping[VariableKind, Index]) -> None:
        """Put the origins of the charts of some variables where these are."""
        for kind, numbers in turned.items():
            table = self.tables[kind]
            table.origin.view[numbers] = table.value.view[numbers]
            for column in (table.delta, table.checked, table.lined, table.radius):
                column.view[numbers] = 0.0

    def moved(self, least: float) -> dict[VariableKind, Mask]:
        """Return which variables moved so far that their observations are to be looked at.

        That is by ``least``, and by as much as they were away from their linearisation when that
        was last done: what a linear form misses grows with the square of the distance, and so is
        known to a factor of four. Distances are in conditional standard deviations 1/√N_ii, which
        are less than any other.
        """
        out: dict[VariableKind, Mask] = {}
        for kind, table in self.tables.items():
            if table.n:
                mask = table.far_from(table.checked) > np.maximum(table.radius.view, least)
                if mask.any():
                    out[kind] = mask
        return out

    def looked_at(self, moved: dict[VariableKind, Mask]) -> None:
        """Note that the observations of variables were compared with their linear forms."""
        for kind, mask in moved.items():
            table = self.tables[kind]
            table.checked.view[mask] = table.delta.view[mask]
            table.radius.view[mask] = table.far_from(table.lined)[mask]

    def doubt_grown(self, before: Mapping[VariableKind, Array]) -> None:
        """Have the observations of variables looked at whose variances have more than doubled.

        What their forms miss was noted relative to what they were before.
        """
        for kind, variance in before.items():
            table = self.tables[kind]
            grown = (table.variance.view > 2.0 * variance).any(axis=1)
            table.checked.view[grown] = FAR

    def line_up(self, kind: VariableKind, numbers: Index) -> None:
        """Note that observations of variables were linearised anew.

        What their forms missed when they were looked at last tells nothing any more.
        """
        table = self.tables[kind]
        table.lined.view[numbers] = table.delta.view[numbers]
        table.radius.view[numbers] = 0.0

    def start_from_here(self) -> None:
        """Count distances from where the variables are now."""
        for table in self.tables.values():
            for column in (table.checked, table.lined):
                column.view[:] = table.delta.view


def _kind_of(letter: int) -> VariableKind:
    """Return the kind whose keys begin with a letter, by its code."""
    return next(k.name for k in UNKNOWNS.values() if ord(k.letter) == letter)

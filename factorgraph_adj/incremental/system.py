"""The linear system: an adjusted network, and the rows that joined or left it since.

The base is a batch solution at a minimum. Beside it stands one low-rank update
(`factorgraph_adj.solve.update`) with the rows of arrivals between known variables and of removals.
Estimates and cofactors are those of both together, to first order; `System.within` says how far
that holds. A system is a value: every change returns another one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..graph.dependence import Variable
from ..graph.equations import compile_rows
from ..graph.variables import Unknowns
from ..models.variables import UNKNOWNS, VariableKind
from ..solve.drift import Drift, missed, turned
from ..solve.lifted import ROOM, Lifted
from ..solve.linear import LinearSystem
from ..solve.solution import Solution
from ..solve.update import Update
from ..types import Array, Index
from .excerpt import excerpt
from .forms import Forms
from .judging import MOVES, TIED
from .ledger import Ledger

MOST_BESIDE = 256
"""Largest number of rows beside a base; with more of them a new base takes less time."""
SHARE = 0.5
"""Part of the promised accuracy that the step that is left may be, where σ̂0 is 1 or less. Where
residuals are large the minimum is further away than such a step, as second partials count too:
there it is this divided by σ̂0."""
TURNED = 1.3
"""Part of the promised accuracy that the relative error of a variance may be. The error of a
standard deviation is half of it; the rest is room for what the power iteration misses."""


@dataclass(frozen=True, eq=False)
class System:
    """A network at its minimum, to first order."""

    base: Solution
    """The adjusted network."""
    lifted: Lifted
    """Its cofactors."""
    update: Update
    """Rows that joined or left."""
    joined: Mapping[str, Index] = field(default_factory=dict)
    """Rows of the update that joined, by id."""
    slots: Mapping[int, int] = field(default_factory=dict)
    """Slots of points that only cameras see, by their numbers in the first layer."""
    offset: Array | None = None
    """Movement of the base itself, which followed its gradient, (n_columns,); none: it did not."""
    followed: Array | None = None
    """The gradient that it followed, (n_columns,)."""
    shifted: float = 0.0
    """Bound of its length, relative to σ."""
    drift: Drift | None = None
    """The last look at how far the linear forms of the base hold; none: there was none."""
    doubt: str = ""
    """Why this is not the minimum of everything in the graph; empty if it is."""

    @classmethod
    def of(cls, base: Solution, doubt: str = "") -> System:
        """Return the system of a solution.

        Raises:
            SingularError: an unknown is determined too weakly for covariances.
        """
        lifted = Lifted(base)
        return cls(base, lifted, Update.of(lifted), doubt=doubt)

    def prepared(self) -> System:
        """Work out now what the first arrival would wait for.

        Covariances of all points of photos are left: few of them are ever asked for.
        """
        _ = self.lifted.sigma
        if self.base.factor.points is None:
            _ = self.base.factor.selected
        return self

    # -- what is known ------------------------------------------------------------------------

    def known(self, kind: VariableKind, name: str) -> bool:
        """Return whether a variable is determined, or a constant."""
        return name in self.base.equations.unknowns[kind].number

    def value(self, kind: VariableKind, name: str) -> Array | None:
        """Return the value of a variable as in a state; none: it is not known."""
        table = self.base.equations.unknowns[kind]
        number = table.number.get(name)
        if number is None:
            return None
        stored = self.base.state[kind][number]
        if not self.changed or table.offset[number] < 0:
            return np.array(stored)
        columns = self.columns(kind, name)
        step = np.zeros(table.free.shape[1])
        step[: len(columns)] = self.moved(columns)
        return np.asarray(UNKNOWNS[kind].retract(stored[None], step[None])[0])

    def columns(self, kind: VariableKind, name: str) -> Index:
        """Return the columns of a variable in the base; none for constants."""
        unknowns = self.unknowns
        return unknowns.columns(kind, unknowns[kind].number[name])

    # -- the movement from the base -----------------------------------------------------------

    @cached_property
    def weights(self) -> Array:
        """D⁻¹ v of the update, (k,)."""
        return np.asarray(self.update.inverse @ self.update.residuals)

    def moved(self, columns: Index) -> Array:
        """Return the movement of some unknowns from the base, (m,)."""
        step = self.step_at(columns)
        return step if self.offset is None else np.asarray(step + self.offset[columns])

    def step_at(self, columns: Index) -> Array:
        """Return the part of the movement that the update makes, (m,)."""
        if not len(self.update.signs):
            return np.zeros(len(columns))
        f = self.lifted.expand(columns, np.eye(len(columns)), self.slots)
        return np.asarray(-f.b @ (self.update.spread[f.at] @ self.weights))

    @cached_property
    def movement(self) -> Array:
        """Movement of all unknowns from the base, (n_columns,)."""
        if not len(self.update.signs):
            return self._offset
        step = self.lifted.unknowns(-(self.update.spread @ self.weights), self.slots)
        return np.asarray(self._offset + step)

    @property
    def _offset(self) -> Array:
        return np.zeros(len(self.lifted.place)) if self.offset is None else self.offset

    @cached_property
    def state(self) -> dict[VariableKind, Array]:
        """Values of all variables of the base."""
        if not self.changed:
            return self.base.state
        return self.base.equations.unknowns.retract(self.base.state, self.movement)

    @property
    def changed(self) -> bool:
        """Whether anything has changed since the base was made."""
        return len(self.update.signs) > 0 or self.offset is not None

    @property
    def vtpv(self) -> float:
        """VᵀPv of the linear forms."""
        return self.base.vtpv + self.update.vtpv

    @property
    def redundancy(self) -> int:
        """Redundancy."""
        return self.base.redundancy + int(self.update.signs.sum())

    @property
    def n_rows(self) -> int:
        """Number of scalar rows, weighted unknowns among them."""
        return self.base.n_observations + int(self.update.signs.sum())

    # -- cofactors ----------------------------------------------------------------------------

    def cofactors(self, a: Variable, b: Variable) -> Array:
        """Return the joint cofactors of the components of two variables, (i, j)."""
        columns = [self.columns(*v) for v in (a, b)]
        f, g = (self.lifted.expand(c, np.eye(len(c)), self.slots) for c in columns)
        if a == b and not self.lifted.touched(columns[0]):
            # The selected inverse has the blocks of all variables.
            size = len(columns[0])
            out = self.base.variable_covariance(a)[:size, :size]
            out = out - self.update.loss(f.b @ self.update.spread[f.at])
        else:
            out = f.b @ self.update.times(g.at, g.b)[f.at]
            if a == b:
                out = out + f.own
        free = self.base.equations.unknowns.free
        return np.where(np.outer(free[columns[0]], free[columns[1]]), out, 0.0)

    # -- rows beside the base -----------------------------------------------------------------

    def forms(self, ledger: Ledger, rows: Index) -> Forms:
        """Linearise observations between known variables at the present state.

        Raises:
            InputError: names observations whose geometry has no answer.
        """
        equations = compile_rows(excerpt(ledger, self, rows, hold=False))
        return Forms.of(ledger.units(rows), equations, self.unknowns, self.step_at)

    def within(self, accuracy: float, arrived: Forms | None = None) -> System | None:
        """Return the system, moved if need be, within ``accuracy`` of the minimum.

        None: only a new base is. Estimates follow the gradient at the present state; cofactors
        stay those of the base.

        Args:
            accuracy: largest deviation, relative to σ.
            arrived: forms that the system has just taken in.

        Raises:
            InputError: names observations whose geometry has no answer at the present state.
        """
        r = self.redundancy
        sigma0 = float(np.sqrt(self.vtpv / r)) if r > 0 else 1.0
        bound = SHARE * accuracy / max(1.0, sigma0)
        # Without the rows that left, cofactors are at most this much larger: N' ≥ M_min N.
        larger = 1.0 / self.update.condition
        step, changed = 0.0, 0.0
        if arrived is not None:
            step, changed = arrived.missed(self.step_at(arrived.columns))
            if step > bound or changed > TURNED * accuracy:
                return None
        if self.drift is not None:
            ahead = self._length(self.drift.weights)
            left, turned = self.drift.predicted(ahead, self._gained)
            if step + np.sqrt(larger) * left <= bound and larger * turned <= TURNED * accuracy:
                return self
        looked, g = self._look()
        assert looked.drift is not None
        if larger * looked.drift.turned > TURNED * accuracy:
            return None
        if step + looked.drift.left <= bound:
            return looked
        moved = looked._follow(g)
        again, _ = moved._look()
        assert again.drift is not None
        return again if step + again.drift.left <= bound else None

    def _look(self) -> tuple[System, Array]:
        """Look at the linear forms; return the system that knows how far they hold, and g."""
        here = self.base.normal().system
        there = LinearSystem(here.equations, self.state)
        g = missed(here, there, self.movement)
        if self.followed is not None:
            g = g - self.followed
        left = self._left(g)
        length = self._length(np.zeros(0)) + self.shifted
        before = self.drift
        curvature = left / length**2 if length > 0 else 0.0
        if before is not None:
            curvature = before.curvature if self.shifted else max(before.curvature, curvature)
        start = None if before is None else before.direction
        size, direction = turned(here, there, self.lifted.factor, start)
        drift = Drift(self.weights, left, size, length, curvature, self._gained, direction)
        return replace(self, drift=drift), g

    def _left(self, g: Array) -> float:
        """Return the largest step −Q g of an unknown, relative to its own σ."""
        h = self.lifted.factor.solve(g[:, None])[:, 0]
        along = self.update.spread.T @ self.lifted.gradient(g, self.slots)
        h -= self.lifted.unknowns(self.update.spread @ (self.update.inverse @ along), self.slots)
        sigma = self.lifted.sigma
        far = float(np.max(np.abs(h) / np.where(sigma > 0, sigma, np.inf), initial=0.0))
        return far * float(np.sqrt(self._gained))

    @cached_property
    def _gained(self) -> float:
        """Largest factor by which rows that joined make a variance smaller: ‖D₊‖."""
        joined = self.update.signs > 0
        if not joined.any():
            return 1.0
        return float(np.linalg.norm(self.update.inner[np.ix_(joined, joined)], 2))

    def _follow(self, g: Array) -> System:
        """Return the system moved by the step that a gradient asks for, with the cofactors as is.

        The gradient moves the base by −Q g, where its rows have other residuals.
        """
        h = self.lifted.factor.solve(g[:, None])[:, 0]
        along = self.update.spread.T @ self.lifted.gradient(g, self.slots)
        update = replace(self.update, residuals=self.update.residuals - along)
        shifted = self.shifted + float(np.sqrt(max(float(g @ h), 0.0)))
        followed = g if self.followed is None else self.followed + g
        offset = self._offset - h
        return replace(self, update=update, offset=offset, followed=followed, shifted=shifted)

    def _length(self, since: Array) -> float:
        """Return √(dxᵀN dx) of the movement by the update since its weights were ``since``."""
        w = self.weights.copy()
        w[: len(since)] -= since
        square = float(w @ (self.update.inner @ w)) - float(w @ (self.update.signs * w))
        return float(np.sqrt(max(square, 0.0)))

    def without(self, ids: Sequence[str]) -> System | None:
        """Return the system without observations; none where an update cannot tell.

        Args:
            ids: first ids of units, ids of image points, and names of weighted unknowns.
        """
        found = self._reduced(ids)
        if found is None or not found.update.trusted or found.update.condition <= TIED:
            return None
        return found

    def _reduced(self, ids: Sequence[str]) -> System | None:
        """Return the system without observations, determined or not; none: they are too many."""
        joined = dict(self.joined)
        gone = [joined.pop(i) for i in ids if i in joined]
        update = self.update
        if gone:
            stays = np.ones(len(update.signs), dtype=bool)
            stays[np.concatenate(gone)] = False
            update = update.only(np.flatnonzero(stays))
            new = np.cumsum(stays) - 1
            joined = {i: new[rows] for i, rows in joined.items()}
        own = [i for i in ids if i not in self.joined]
        equations = self.base.equations
        rows = np.concatenate([np.zeros(0, dtype=np.intp), *equations.find(own)])
        for c in equations.clusters:
            if np.isin(c.rows, rows).any():
                rows = np.union1d(rows, c.rows)
        slots = dict(self.slots)
        if len(rows):
            if len(update.signs) + len(rows) > MOST_BESIDE:
                return None
            a = self.base.normal().system.sparse(rows)
            columns: Index = np.unique(a.indices).astype(np.intp)
            for point in self.lifted.touched(columns):
                slots.setdefault(point, len(slots))
            if len(slots) > ROOM:
                return None
            f = self.lifted.expand(columns, a[:, columns].toarray(), slots)
            v = self.base.normal().system.residual[rows]
            if self.offset is not None:
                v = v + a @ self.offset
            update = update.with_rows(f.at, f.b, v, sign=-1.0)
        return replace(self, update=update, joined=joined, slots=slots, drift=None)

    def loosened(self, ids: Sequence[str]) -> set[Variable] | None:
        """Return the variables that observations alone determine; none where that is not known.

        With M of the rows that leave, a null vector z of M is a motion x = Q Aᵀ z that only these
        rows see.
        """
        found = self._reduced(ids)
        if found is None:
            return None
        update = found.update
        leave = update.signs < 0
        inner, spread = update.inner, update.spread
        e, g = inner[np.ix_(leave, leave)], spread[:, leave]
        if (~leave).any():
            gain = np.linalg.solve(inner[np.ix_(~leave, ~leave)], inner[np.ix_(~leave, leave)])
            e = e - inner[np.ix_(leave, ~leave)] @ gain
            g = g - spread[:, ~leave] @ gain
        values, vectors = np.linalg.eigh(-0.5 * (e + e.T))
        weight = np.sqrt(np.where(found.unknowns.free, self.base.normal().diagonal, 0.0))
        far = np.zeros(len(weight))
        for z in vectors[:, values <= TIED].T:
            far = np.maximum(far, np.abs(self.lifted.unknowns(g @ z, found.slots)) * weight)
        unknowns = self.unknowns
        return {
            (kind, unknowns[kind].names[number])
            for kind, number in unknowns.active()
            if (far[unknowns.columns(kind, number)] > MOVES).any()
        }

    @property
    def unknowns(self) -> Unknowns:
        """Unknowns of the base."""
        return self.base.equations.unknowns

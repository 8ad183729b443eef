"""Observations in iSAM2 as linear factors, evaluated anew where what they miss counts.

iSAM2 eliminates, this library linearises (`linear_rows`): rows enter as linear containers. Where a
variable gets a new point of linearisation, all rows that touch it are replaced in the same update,
so that δ counts from there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from itertools import count
from typing import NamedTuple

import gtsam
import numpy as np

from ..errors import AdjustmentError
from ..frames import Frame
from ..graph.dependence import Variable
from ..graph.variables import Unknowns
from ..models.variables import VariableKind
from ..types import NO_ROWS, Array, Index, Mask
from .linear_rows import Arriving, LinearRows
from .rows import Grown, Sort
from .together import Together

MOST_TURNS = 10
"""Largest number of times that rows are evaluated anew after an arrival."""
MOVED = 0.1
"""Movement since the last look, in conditional standard deviations 1/√N_jj, from which on the rows
of a variable are looked at: below it they miss less than any accuracy that is asked for."""
KEPT = 0.25
"""Part of the accuracy that the gaps of rows may have together after some were evaluated anew."""
NEAR, SHRINKING = 1e-6, 0.9
"""Norm of all gaps, and ratio of it to the last one, from which on it is rounding."""
MOST_MISFIT = 1e9
"""Largest residual of a row that enters, in its σ: what it adds hides 10⁻⁷ σ of the others."""
AT_REST = 1e-7
"""Norm of all gaps at which `Tree.settle` ends."""


_VERSIONS = count()


class IndeterminateError(AdjustmentError):
    """Rows do not determine all of their unknowns."""


class Snapshot(NamedTuple):
    """Everything that arrivals change; copies."""

    isam: gtsam.ISAM2
    """The tree."""
    forms: dict[Sort, tuple[Array, ...]]
    """Linear forms of each sort."""
    theta: dict[VariableKind, Array]
    """Points of linearisation."""
    of_units: tuple[Array, ...]
    """What there is of each unit, key and column."""


class Mark(NamedTuple):
    """A tree before an arrival."""

    version: int
    """Its version."""
    changes: int
    """Number of its changes other than rows between known variables."""
    counts: dict[VariableKind, int]
    """Number of variables of each kind."""
    n_keys: int
    """Number of keys."""
    inside: Mask
    """Which units are in."""
    diagonal: Array
    """Diagonal of N."""
    snapshot: Snapshot | None
    """The tree then, or after rows had entered between known variables; none: there is no copy."""


class Tree(LinearRows):
    """Observations in iSAM2."""

    def __init__(self, frame: Frame, *, accuracy: float = 1e-2) -> None:
        """Begin with nothing.

        Args:
            frame: frame of the coordinates.
            accuracy: largest deviation of an estimate from the minimum, in its σ.
        """
        super().__init__(frame)
        params = gtsam.ISAM2Params()
        params.setFactorization("CHOLESKY")
        params.enableRelinearization = False
        params.findUnusedFactorSlots = True
        params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.0))
        self.isam = gtsam.ISAM2(params)
        self.accuracy = accuracy
        self.version = next(_VERSIONS)
        """Number that no other state of any tree has."""
        self._slot = Grown(dtype=np.intp, fill=-1)
        """Slot of each unit in iSAM2; −1: it is out, or touches constants alone."""
        self.relinearised = 0
        """Number of units that were evaluated anew."""
        self._changes = 0
        """Number of changes other than rows that entered between known variables."""
        self._lost = False
        """Whether an update has failed, which leaves iSAM2 without use."""

    # -- what enters and leaves ---------------------------------------------------------------

    def enter(self, arrivals: Iterable[Arriving]) -> Index:
        """Put observations in, with the variables that they are the first to touch.

        Returns:
            Numbers of the units.

        Raises:
            InputError: names observations whose geometry has no answer.
            IndeterminateError: not all of the new variables are determined.
            AdjustmentError: a residual is beyond `MOST_MISFIT`. After an error the tree has to be
                restored.
        """
        self.version = next(_VERSIONS)
        begin, first_key = len(self.units), self._first.n
        new: dict[Sort, list[Index]] = {}
        for arriving in arrivals:
            self._place(arriving, new)
        units = np.arange(begin, len(self.units))
        self._slot.extend(np.full(len(units), -1))
        self._gap.extend(np.zeros(len(units)))
        self._inside.extend(np.ones(len(units), dtype=bool))
        theta = self._theta()
        for sort, rows in new.items():
            own = np.concatenate(rows)
            self.sorts[sort].linearise(own, self.frame, theta)
            if not (np.abs(self.sorts[sort].v.values[own]) < MOST_MISFIT).all():
                raise AdjustmentError("a reading is too far from everything else for iSAM2")
            self._weigh(sort, own, 1.0)
        self._weigh_groups(units, 1.0)
        graph, having = self._factors(units)
        self._changes += self._first.n > first_key
        values = gtsam.Values()
        for key in range(first_key, self._first.n):
            if self._alive.values[key]:
                values.insert(key, np.zeros(int(self._size.values[key])))
        self._update(graph, having, values, [])
        return units

    @property
    def _numbered(self) -> tuple[Grown, ...]:
        of_keys = self._first, self._size, self._alive
        of_columns = self._key, self._delta, self._looked, self._diagonal, self._bound
        return self._slot, self._gap, self._inside, *of_keys, *of_columns

    def mark(self, *, whole: bool = True) -> Mark:
        """Return what `restore` needs to undo what is done from now on.

        Args:
            whole: whether to copy everything. Without a copy rows between known variables leave by
                their factors; where anything else was done the tree is planted anew.
        """
        return Mark(
            self.version,
            self._changes,
            {kind: len(table.number) for kind, table in self.tables.items()},
            self._first.n,
            self._inside.values.copy(),
            self._diagonal.values.copy(),
            self._snapshot() if whole else None,
        )

    def completed(self, mark: Mark) -> Mark:
        """Return a mark with a copy, after rows have entered between known variables."""
        same = mark.snapshot is not None or mark.changes != self._changes
        return mark if same else mark._replace(snapshot=self._snapshot())

    def _snapshot(self) -> Snapshot:
        return Snapshot(
            self.copied(),
            {sort: rows.forms() for sort, rows in self.sorts.items()},
            {kind: table.theta.values.copy() for kind, table in self.tables.items()},
            tuple(each.values.copy() for each in self._numbered),
        )

    def restore(self, mark: Mark) -> None:
        """Undo what was done since a mark was made; the mark serves once.

        Raises:
            IndeterminateError: the tree was lost, and what was in it is too weak for Cholesky.
        """
        n = len(mark.inside)
        if mark.snapshot is not None:
            self._put_back(mark.snapshot)
        entered = np.arange(n, self._slot.n)
        planted = mark.snapshot is not None or self._changes == mark.changes
        if planted and not self._lost:
            with suppress(IndeterminateError):
                if (self._slot.values[entered] >= 0).any():
                    self.leave(entered)
        self._forget(n)
        for each in (self._slot, self._gap, self._inside):
            each.cut(n)
        if self._lost or not planted:
            self._cut(mark)
            self._plant(np.flatnonzero(mark.inside))
        elif mark.snapshot is None:
            self._diagonal.put_back(mark.diagonal)
        self.version, self._changes = mark.version, mark.changes

    def _cut(self, mark: Mark) -> None:
        """Drop the variables that are new since a mark, and put in what was in then."""
        for kind, table in self.tables.items():
            table.cut(mark.counts.get(kind, 0))
        for each in (self._first, self._size, self._alive):
            each.cut(mark.n_keys)
        for each in (self._key, self._delta, self._looked, self._diagonal, self._bound):
            each.cut(len(mark.diagonal))
        self._inside.put_back(mark.inside)
        self._diagonal.values[:] = 0.0
        for sort, rows in self.sorts.items():
            self._weigh(sort, np.flatnonzero(self._inside.values[rows.unit.values]), 1.0)
        self._weigh_groups(np.flatnonzero(mark.inside), 1.0)

    def _put_back(self, snapshot: Snapshot) -> None:
        self.isam, self._lost = snapshot.isam, False
        for sort in [s for s in self.sorts if s not in snapshot.forms]:
            del self.sorts[sort]
        for sort, forms in snapshot.forms.items():
            self.sorts[sort].put_back(forms)
        for kind, table in self.tables.items():
            before = snapshot.theta.get(kind)
            table.cut(0 if before is None else len(before))
            if before is not None:
                table.theta.values[:, : before.shape[1]] = before
        for each, copied in zip(self._numbered, snapshot.of_units, strict=True):
            each.put_back(copied)
        self._forget(self._slot.n)

    def _plant(self, units: Index) -> None:
        """Put units into a new tree."""
        self.isam, self._lost = gtsam.ISAM2(self.isam.params()), False
        graph, having = self._factors(units)
        values = gtsam.Values()
        for key in np.flatnonzero(self._alive.values).tolist():
            values.insert(key, np.zeros(int(self._size.values[key])))
        self._update(graph, having, values, [])

    def bound(self, unknowns: Unknowns, sigma: Array) -> None:
        """Take over upper bounds of standard deviations, by the columns of some unknowns."""
        for kind, here, there in self._shared(unknowns):
            for i, number in zip(here.tolist(), there.tolist(), strict=True):
                own = self.tables[kind].column.values[number]
                columns = unknowns.columns(kind, i)
                n = min(len(own), len(columns))
                on = np.flatnonzero(own[:n] >= 0)
                self._bound.values[own[on]] = sigma[columns[on]]

    def bound_new(self, entered: Together) -> None:
        """Take over the standard deviations of columns that had no bounds before units entered."""
        new = np.isnan(self._bound.values[entered.columns])
        variance = np.maximum(np.diag(entered.covariance), 0.0)
        self._bound.values[entered.columns[new]] = np.sqrt(variance[new])

    def _bounds(self, columns: Index) -> Array:
        """Return upper bounds of the standard deviations of columns."""
        bound = self._bound.values
        for key in np.unique(self._key.values[columns[np.isnan(bound[columns])]]).tolist():
            variance = np.diag(self.covariance_of([key]))
            bound[self._columns_of(key)] = np.sqrt(np.maximum(variance, 0.0))
        return np.asarray(bound[columns])

    def leave(self, units: Index, redundancy: float = 1.0) -> None:
        """Take units out; what they alone determine must have left before.

        Args:
            units: their numbers.
            redundancy: their `Together.least_redundancy`: no variance grows by more than 1/it.

        Raises:
            IndeterminateError: the rest is too weak for Cholesky; `restore` brings the tree back.
        """
        self._changes += 1
        slots = self._slot.values[units]
        gone = slots[slots >= 0].tolist()
        for unit in units[slots >= 0].tolist():
            for sort, row in self.units[unit]:
                self._weigh(sort, np.array([row]), -1.0)
        self._weigh_groups(units[slots >= 0], -1.0)
        self._slot.values[units] = -1
        self._inside.values[units] = False
        self._gap.values[units] = 0.0
        self._bound.values[:] /= np.sqrt(redundancy)
        self._update(gtsam.NonlinearFactorGraph(), NO_ROWS, gtsam.Values(), gone)

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

    def _update(
        self,
        graph: gtsam.NonlinearFactorGraph,
        units: Index,
        values: gtsam.Values,
        gone: list[int],
    ) -> None:
        self.version = next(_VERSIONS)
        try:
            result = self.isam.update(graph, values, gone)
        except RuntimeError as error:
            self._lost = True
            raise IndeterminateError(str(error).strip().splitlines()[0]) from error
        self._slot.values[units] = list(result.getNewFactorsIndices())
        present = np.flatnonzero(self._alive.values[self._key.values])
        self._delta.values[present] = self.isam.getDelta().vector()

    def copied(self) -> gtsam.ISAM2:
        """Return a copy of iSAM2."""
        return gtsam.ISAM2(self.isam)

    # -- what linear rows miss ----------------------------------------------------------------

    def follow(
        self,
        accuracy: float | None = None,
        before: Callable[[], None] = lambda: None,
    ) -> int:
        """Evaluate rows anew until their gaps are small; return the number of updates.

        Args:
            accuracy: largest norm of all gaps; none: that of the tree.
            before: what is called before the first of them.
        """
        allowed = self.accuracy if accuracy is None else accuracy
        moved = MOVED if accuracy is None else 0.0
        last = np.inf
        for turn in range(MOST_TURNS):
            self._look(moved, self._bounds)
            gap = self._gap.values
            whole = float(np.sqrt(gap.sum()))
            if whole <= allowed or (whole <= NEAR and whole > SHRINKING * last):
                return turn
            last = whole
            if not turn:
                before()
            self._anew(_largest(gap, (KEPT * allowed) ** 2), moved)
        return MOST_TURNS

    def settle(self) -> int:
        """Evaluate rows anew until nothing is missed; return the number of updates."""
        return self.follow(AT_REST)

    def follow_to_rest(self, before: Callable[[], None] = lambda: None) -> bool:
        """Evaluate rows anew until their gaps are small; return whether they are.

        Where they are not, the tree may be lost: `restore` brings it back.
        """
        with suppress(IndeterminateError):
            return self.follow(before=before) < MOST_TURNS
        return False

    def _anew(self, units: Index, moved: float) -> None:
        """Give variables of units that have moved new points of linearisation.

        All rows that touch them are replaced.
        """
        self._changes += 1
        weight = np.sqrt(np.maximum(self._diagonal.values, 0.0))
        far = np.abs(self._delta.values) * weight > moved
        keys, touched = np.zeros((2, self._first.n), dtype=bool)
        for unit in units.tolist():
            for sort, row in self.units[unit]:
                for _, columns in self._forms(sort, np.array([row])):
                    own = columns[columns >= 0]
                    touched[self._key.values[own]] = True
                    keys[self._key.values[own[far[own]]]] = True
        keys = keys if keys.any() else touched
        columns = keys[self._key.values]
        for kind, table in self.tables.items():
            own_keys = table.key.values
            numbers = np.flatnonzero((own_keys >= 0) & keys[own_keys])
            if len(numbers):
                table.theta.values[numbers] = self._moved(kind, numbers)
        self._delta.values[columns] = 0.0
        self._looked.values[columns] = 0.0
        theta = self._theta()
        anew = list(self._touching(columns))
        found = [self.sorts[sort].unit.values[rows] for sort, rows in anew]
        touching = np.unique(np.concatenate([NO_ROWS, *found]))
        self._weigh_groups(touching, -1.0)
        for sort, rows in anew:
            self._weigh(sort, rows, -1.0)
            self.sorts[sort].linearise(rows, self.frame, theta)
            self._weigh(sort, rows, 1.0)
        self._weigh_groups(touching, 1.0)
        graph, having = self._factors(touching)
        gone = self._slot.values[having].tolist()
        self.relinearised += len(having)
        self._update(graph, having, gtsam.Values(), gone)
        self._gap.values[touching] = 0.0

    # -- figures ------------------------------------------------------------------------------

    def together(self, units: Index) -> Together:
        """Return units with the joint covariance of what they touch."""
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
        v = v + every @ self._delta.values[columns]
        return Together(rows, columns, every, v, self.covariance_of(keys))

    def covariance_of(self, keys: Sequence[int]) -> Array:
        """Return the joint covariance of keys, in their order."""
        if not len(keys):
            return np.zeros((0, 0))
        try:
            return np.asarray(self.isam.jointMarginalCovariance(list(keys)).fullMatrix())
        except RuntimeError as error:
            raise IndeterminateError(str(error).strip().splitlines()[0]) from error

    def covariance(self, variable: Variable) -> Array:
        """Return the covariance of the free components of a variable."""
        return np.asarray(self.isam.marginalCovariance(self.key(variable)))


def _largest(gap: Array, left: float) -> Index:
    """Return the units with the largest gaps, without which the others have no more than left."""
    order = np.argsort(-gap)
    rest = float(gap.sum()) - np.cumsum(gap[order])
    n = int(np.argmax(rest <= left)) + 1
    return order[:n]

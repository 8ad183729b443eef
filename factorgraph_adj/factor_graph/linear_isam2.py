"""Linear factors in iSAM2: entry, removal, undoing, relinearisation and covariances.

iSAM2 eliminates, this library linearises (`linear_rows`): rows enter as linear containers. Where a
variable gets a new point of linearisation, all rows that touch it are replaced in the same update,
so that δ counts from there.

"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from itertools import count

import gtsam
import numpy as np

from ..errors import AdjustmentError
from ..frames import Frame
from ..graph.dependence import Variable
from ..solve.gauss_newton_steps import Extrapolation
from ..types import NO_ROWS, Array, Index
from .factor_tests import JointCovariance
from .linear_rows import TINY
from .normal_matrix import RowsWithNormals
from .row_arrays import Arriving, Grown, Mark

MAX_TURNS = 10
"""Largest number of times that rows are evaluated again after an arrival."""
REMAINING_GAP_SHARE = 0.25
"""Part of the accuracy that the gaps of rows may have together after some were evaluated again."""
UNMEASURED_SHARE = 0.5
"""Part of the accuracy that rows may miss, by their curvature, before they are examined: beside
gaps as large as the accuracy, which is half of what is promised, a quarter of that is left."""
MIN_SHARE_OF_MOVEMENT = 0.1
"""Movement of a variable, relative to the largest one of its row in conditional standard
deviations, from which on it gets a new point of linearisation where the row has a gap."""
NEAR, SHRINKING = 1e-6, 0.9
"""Norm of all gaps, and ratio of it to the last one, from which on it is rounding."""
SLOW = 0.3
"""Ratio of the norm of all gaps to the last one from which on steps are extrapolated."""
MAX_MISFIT = 1e9
"""Largest residual of a row that enters, in its σ: what it adds hides 10⁻⁷ σ of the others."""
MAX_KEYS_OF_JOINT_COVARIANCE = 8
"""Largest number of keys of which what rows miss together counts with their joint covariance."""
MAX_KEYS_OF_ONE_CALL = 3
"""Largest number of keys with which iSAM2 takes a factor in one call from Python."""
CONVERGED_GAP = 1e-7
"""Norm of all gaps at which `LinearISAM2.settle` ends."""


_VERSIONS = count()


class IndeterminateError(AdjustmentError):
    """Rows do not determine all of their unknowns."""


class LinearISAM2(RowsWithNormals):
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
        """Number of units that were evaluated again."""
        self.lost = False
        """Whether an update has failed, which leaves iSAM2 without use."""
        self._before = np.zeros(0)
        """δ of each column before the last update."""

    # -- what enters and leaves ---------------------------------------------------------------

    def enter(self, arrivals: Iterable[Arriving]) -> Index:
        """Put observations in, with the variables that they are the first to touch.

        Returns:
            Numbers of the units.

        Raises:
            InputError: names observations whose geometry has no answer.
            IndeterminateError: not all of the new variables are determined.
            AdjustmentError: a residual is beyond `MAX_MISFIT`. After an error the tree has to be
                restored.
        """
        self.version = next(_VERSIONS)
        begin = self._slot.n
        new: dict[int, list[Index]] = {}
        for arriving in arrivals:
            self._place(arriving, new)
        units = np.arange(begin, self._first_member.n)
        self._slot.extend(np.full(len(units), -1))
        self._gap.extend(np.zeros(len(units)))
        self._inside.extend(np.ones(len(units), dtype=bool))
        theta = self._theta()
        for sort, rows in new.items():
            own = np.concatenate(rows)
            self.rows[sort].linearise(own, self.frame, theta)
            if not (np.abs(self.rows[sort].v.values[own]) < MAX_MISFIT).all():
                raise AdjustmentError("a reading is too far from everything else for iSAM2")
            self._weigh(sort, own, 1.0)
        self._weigh_groups(units, 1.0)
        self._update(units, [])
        return units

    # -- what is undone -----------------------------------------------------------------------

    @property
    def _by_unit(self) -> tuple[Grown, ...]:
        return self._inside, self._gap

    @property
    def _by_column(self) -> tuple[Grown, ...]:
        return self._delta, self._measured_at, self._diagonal, self._bound

    def mark(self) -> Mark:
        """Return what `restore` needs to undo what is done from now on."""
        mark = Mark(
            self.version,
            {kind: len(table.number) for kind, table in self.tables.items()},
            _copies(self._by_unit),
            _copies((self._alive,)),
            _copies(self._by_column),
            self._loosened,
        )
        self._marks.add(mark)
        return mark

    def restore(self, mark: Mark) -> None:
        """Undo what was done since a mark was made; the mark serves once.

        Rows that have entered leave, those that have left enter, and those that were evaluated
        again are replaced by what they were, in one update. Where an update has failed the tree is
        rebuilt; where that fails, too, values are as they were and the tree is `lost`.
        """
        n, inside = len(mark.of_units[0]), mark.of_units[0]
        for grown, rows, values in reversed(mark.replaced):
            grown.values[rows] = values
        for kind, numbers, theta in reversed(mark.theta):
            self.tables[kind].theta.values[numbers] = theta
        changed = self._inside.values.copy()
        changed[:n] ^= inside
        changed[np.concatenate([NO_ROWS, *mark.units])] = True
        slots = self._slot.values[changed]
        gone = slots[slots >= 0].tolist()
        again = np.flatnonzero(changed[:n] & inside)
        self._slot.values[changed] = -1
        self._forget(n)
        self._slot.cut(n)
        for kind, table in self.tables.items():
            table.cut(mark.counts.get(kind, 0))
        for each in (self._first, self._size):
            each.cut(len(mark.of_keys[0]))
        self._key.cut(len(mark.of_columns[0]))
        every = *self._by_unit, self._alive, *self._by_column
        before = *mark.of_units, *mark.of_keys, *mark.of_columns
        for grown, values in zip(every, before, strict=True):
            grown.put_back(values)
        self._marks.clear()
        self._loosened = mark.loosened
        with suppress(IndeterminateError):
            if not self.lost and (len(gone) or len(again)):
                self._update(again, gone)
        if self.lost:
            self._plant()
        if self.lost:
            self._delta.put_back(mark.of_columns[0])
        self.version = mark.version

    def _plant(self) -> None:
        """Put what is in into a new tree."""
        self.isam, self.lost = gtsam.ISAM2(self.isam.params()), False
        self._alive.values[:] = False
        with suppress(IndeterminateError):
            self._update(np.flatnonzero(self._inside.values), [])

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
            redundancy: their `JointCovariance.least_redundancy`: variances grow by at most 1/it.

        Raises:
            IndeterminateError: the rest is too weak for Cholesky; `restore` brings the tree back.
        """
        self.version = next(_VERSIONS)
        slots = self._slot.values[units]  # units between constants have none, and count
        _, sort, row = self._members_of(units)
        for each, rows, _ in self._by_sort(sort, row):
            self._weigh(each, rows, -1.0)
        self._weigh_groups(units, -1.0)
        self._slot.values[units] = -1
        self._inside.values[units] = False
        self._gap.values[units] = 0.0
        self._bound.values[:] /= np.sqrt(redundancy)
        self._loosened /= float(np.sqrt(redundancy))
        self._update(NO_ROWS, slots[slots >= 0].tolist())

    # -- factors ------------------------------------------------------------------------------

    def _factors(self, units: Index) -> tuple[gtsam.NonlinearFactorGraph, Index]:
        """Return the factors of units, and which units have one: the others touch constants."""
        graph, having = gtsam.GaussianFactorGraph(), [NO_ROWS]
        place, sort, row = self._members_of(units)
        alone = np.bincount(place, minlength=len(units)) == 1
        if self._whitener:
            alone &= ~np.isin(units, self._groups(units))
        on = alone[place]
        for each, rows, at in self._by_sort(sort[on], row[on]):
            own = units[place[on][at]]
            for these, terms in self._terms(each, rows):
                self._add(graph, terms, -self.rows[each].v.values[rows[these]])
                having.append(own[these])
        for group in self._correlated(units[~alone]):
            if group.variables:
                self._add(graph, [(k, group.a[:, :, on]) for k, on in group.variables], -group.v)
                having.append(group.units)
        # They need no point of linearisation, as they are never evaluated elsewhere.
        return gtsam.LinearContainerFactor.ConvertLinearGraph(graph), np.concatenate(having)

    def _terms(self, sort: int, rows: Index) -> Iterable[tuple[Index, list[tuple[Index, Array]]]]:
        """Iterate over rows of a sort that touch variables of equal numbers of columns.

        Returns:
            Places of the rows, and for each variable that is no constant keys and partials (k, d,
            s) by all of its columns.
        """
        slots, code = self._wide_forms(sort, rows), np.zeros(len(rows), dtype=np.intp)
        for _, wide, size in slots:
            code = code * (wide.shape[2] + 1) + size
        for each in np.unique(code).tolist():
            at = np.flatnonzero(code == each)
            sizes = [int(size[at[0]]) for _, _, size in slots]
            found = [
                (keys[at], wide[at, :, :size])
                for (keys, wide, _), size in zip(slots, sizes, strict=True)
                if size
            ]
            if found:
                yield at, found

    def _add(
        self, graph: gtsam.GaussianFactorGraph, terms: list[tuple[Index, Array]], b: Array
    ) -> None:
        """Add a factor for each row (k, d) of b, with its keys (k,) and partials (k, d, s)."""
        noise = gtsam.noiseModel.Unit.Create(b.shape[1])
        for keys, _ in terms:
            self._alive.values[keys] = True
        if len(terms) <= MAX_KEYS_OF_ONE_CALL:
            lists = [each for keys, a in terms for each in (keys.tolist(), a)]
            add: Callable[..., None] = graph.add
            for *parts, own in zip(*lists, b, strict=True):
                add(*parts, own, noise)
            return
        named = [list(zip(keys.tolist(), a, strict=True)) for keys, a in terms]
        for *of_keys, own in zip(*named, b, strict=True):
            graph.push_back(gtsam.GaussianConditional(of_keys, 1, own, noise))

    def _update(self, units: Index, gone: list[int]) -> None:
        """Put units into iSAM2, and take factors out; `lost` is set where that fails.

        Raises:
            IndeterminateError: not everything is determined.
        """
        self.version = next(_VERSIONS)
        if self.lost:
            raise IndeterminateError("the tree is lost")
        there = self._alive.values.copy()
        graph, having = self._factors(units)
        values = gtsam.Values()
        for key in np.flatnonzero(self._alive.values & ~there).tolist():
            values.insert(key, np.zeros(int(self._size.values[key])))
        self.lost = True  # an error, or an interruption, leaves no tree
        try:
            result = self.isam.update(graph, values, gone)
        except RuntimeError as error:
            raise IndeterminateError(str(error).strip().splitlines()[0]) from error
        self._slot.values[having] = list(result.getNewFactorsIndices())
        present = np.flatnonzero(self._alive.values[self._key.values])
        self._delta.values[present] = self.isam.getDelta().vector()
        self.lost = False

    def copied(self) -> gtsam.ISAM2:
        """Return a copy of iSAM2."""
        return gtsam.ISAM2(self.isam)

    # -- what linear rows miss ----------------------------------------------------------------

    def follow(self, accuracy: float | None = None) -> int:
        """Evaluate rows again until their gaps are small; return the number of updates.

        Args:
            accuracy: largest norm of all gaps, and of what they miss together; none: that of the
                tree.
        """
        allowed = self.accuracy if accuracy is None else accuracy
        moved = self._moved_from() if accuracy is None else np.zeros(len(self._delta.values))
        curvatures = np.zeros(0)
        if accuracy is None:
            self._measure_curvatures(self._bounds)
            curvatures = self._curvatures()
        last, beyond = np.inf, Extrapolation()
        for turn in range(MAX_TURNS):
            columns = self._delta.values != self._measured_at.values
            if accuracy is None:
                squares = self._unmeasured(curvatures)
                columns[:] = False
                columns[_largest(squares, (UNMEASURED_SHARE * allowed) ** 2)] = True
            self._measure_gaps(columns, self._bounds)
            gap = self._gap.values
            together, shares = self._joint_gradient_error(allowed)
            whole = max(float(np.sqrt(gap.sum())), together)
            if whole <= allowed or (whole <= NEAR and whole > SHRINKING * last):
                return turn
            units = _largest(gap, (REMAINING_GAP_SHARE * allowed) ** 2)
            units = np.union1d(units, _largest(shares, REMAINING_GAP_SHARE * allowed))
            if turn:
                self._extrapolate(beyond, slow=whole > SLOW * last)
            last = whole
            self._relinearise(units, moved)
        return MAX_TURNS

    def _joint_gradient_error(self, allowed: float) -> tuple[float, Array]:
        """Return √gᵀQg of the gradient that all rows miss, or more, and shares of units in it.

        That is Σ|g_c| σ_c with bounds of σ; where it is beyond what is allowed, the keys with most
        of it count with their joint covariance: √gᵀQg is a norm, so that parts may be added.
        """
        g, sizes = self._gradient_errors()
        columns = np.flatnonzero(g)
        figure = np.zeros(len(g))
        figure[columns] = np.abs(g[columns]) * self._bounds(columns)
        together = float(figure.sum())
        if together <= allowed:
            return together, np.zeros(self._gap.n)
        of_keys = np.bincount(self._key.values, figure, self._first.n)
        keys = np.argsort(-of_keys)[:MAX_KEYS_OF_JOINT_COVARIANCE]
        keys = keys[of_keys[keys] > 0.0].tolist()
        mine = np.concatenate([self._columns_of(key) for key in keys])
        q = self.covariance_of(keys)
        self._bound.values[mine] = np.sqrt(np.maximum(np.diag(q), 0.0))
        joint = float(np.sqrt(max(g[mine] @ q @ g[mine], 0.0)))
        together += joint - float(figure[mine].sum())
        figure[mine] = np.abs(g[mine]) * self._bound.values[mine]
        return together, self._gradient_error_shares(figure / np.maximum(sizes, TINY))

    def _extrapolate(self, beyond: Extrapolation, *, slow: bool) -> None:
        """Move further in the way of the last steps, where gaps shrink slowly.

        Their metric is the diagonal of N.
        """
        step = self._delta.values - self._before
        weight = np.sqrt(np.maximum(self._diagonal.values, 0.0))
        movement = beyond.beyond(step, lambda dx: weight * dx)
        if movement is None or not slow:
            movement = step
        beyond.moved(movement)
        self._delta.values[:] += movement - step

    def settle(self) -> int:
        """Evaluate rows again until nothing is missed; return the number of updates."""
        return self.follow(CONVERGED_GAP)

    def follow_to_rest(self) -> bool:
        """Evaluate rows again until their gaps are small; return whether they are.

        Where they are not, the tree may be lost: `restore` brings it back.
        """
        with suppress(IndeterminateError):
            return self.follow() < MAX_TURNS
        return False

    def _relinearise(self, units: Index, moved: Array) -> None:
        """Give variables of units that have moved, or moved most, new points of linearisation.

        All rows that touch them are replaced.
        """
        weight = np.sqrt(np.maximum(self._diagonal.values, 0.0))
        far = np.append(np.abs(self._delta.values) * weight, 0.0)  # the last one is held
        moved = np.append(moved, np.inf)
        keys = np.zeros(self._first.n, dtype=bool)
        place, sort, row = self._members_of(units)
        members = [
            (place[at], columns)
            for each, rows, at in self._by_sort(sort, row)
            for _, columns in self._forms(each, rows)
        ]
        farthest = np.zeros(len(units))
        for of_unit, columns in members:
            np.maximum.at(farthest, of_unit, far[columns].max(axis=1))
        for of_unit, columns in members:
            least = np.minimum(moved[columns], MIN_SHARE_OF_MOVEMENT * farthest[of_unit, None])
            moving = (far[columns] >= least) & (columns >= 0)
            keys[self._key.values[columns[moving]]] = True
        columns = keys[self._key.values]
        for kind, table in self.tables.items():
            own_keys = table.key.values
            numbers = np.flatnonzero((own_keys >= 0) & keys[own_keys])
            if len(numbers):
                for mark in self._marks:
                    mark.theta.append((kind, numbers, table.theta.values[numbers]))
                table.theta.values[numbers] = self._moved(kind, numbers)
        self._delta.values[columns] = 0.0
        self._measured_at.values[columns] = 0.0
        self._before = self._delta.values.copy()
        theta = self._theta()
        anew = list(self._touching(columns))
        found = [self.rows[sort].unit.values[rows] for sort, rows in anew]
        touching = np.unique(np.concatenate([NO_ROWS, *found]))
        for mark in self._marks:
            mark.units.append(touching)
            for of_sort, rows in anew:
                forms = (self.rows[of_sort].v, *self.rows[of_sort].a)
                mark.replaced += [(form, rows, form.values[rows]) for form in forms]
        self._weigh_groups(touching, -1.0)
        for of_sort, rows in anew:
            self._weigh(of_sort, rows, -1.0)
            self.rows[of_sort].linearise(rows, self.frame, theta)
            self._weigh(of_sort, rows, 1.0)
        self._weigh_groups(touching, 1.0)
        slots = self._slot.values[touching]
        self.relinearised += int((slots >= 0).sum())
        self._update(touching, slots[slots >= 0].tolist())
        self._gap.values[touching] = 0.0

    # -- figures ------------------------------------------------------------------------------

    def joint_covariance(self, units: Index) -> JointCovariance:
        """Return units with the joint covariance of what they touch."""
        a, v, columns, rows = self._stacked(units)
        keys = np.unique(self._key.values[columns]).tolist()
        v = v + a @ self._delta.values[columns]
        return JointCovariance(rows, columns, a, v, self.covariance_of(keys))

    def covariance_of(self, keys: Sequence[int]) -> Array:
        """Return the joint covariance of keys, in their order."""
        if not len(keys):
            return np.zeros((0, 0))
        if self.lost:
            raise IndeterminateError("the tree is lost")
        try:
            return np.asarray(self.isam.jointMarginalCovariance(list(keys)).fullMatrix())
        except RuntimeError as error:
            raise IndeterminateError(str(error).strip().splitlines()[0]) from error

    def covariance(self, variable: Variable) -> Array:
        """Return the covariance of the free components of a variable."""
        return self.covariance_of([self.key(variable)])


def _copies(grown: Iterable[Grown]) -> tuple[Array, ...]:
    return tuple(each.values.copy() for each in grown)


def _largest(gap: Array, left: float) -> Index:
    """Return the units with the largest gaps, without which the others have no more than left."""
    order = np.argsort(-gap)
    rest = float(gap.sum()) - np.cumsum(gap[order])
    n = int(np.argmax(rest <= left)) + 1
    return order[: n if float(gap.sum()) > left else 0]

"""Choice of the observations that a snooping round rejects, by test values and correlations.

The candidates are the observations whose test value exceeds the critical value, in descending
order; those with equal test values in the order of the network. Correlated observations that are
parts of one reading, such as vector and turn of an edge, are one candidate, with the test of all
its components together (`factorgraph_adj.quality.joint_readings`). A candidate is rejected if

1. its test value is at least ``share`` of the largest test value that can be rejected;
2. none of its test values is correlated by more than `MAX_TEST_CORRELATION` with a test value of an
   observation rejected earlier in this round, whose error may explain the candidate's;
3. its test value, T² of a joint reading, in the linear model without the observations rejected
   earlier in this round still exceeds the critical value;
4. the remaining observations still determine all unknowns;
5. it is no condition that the user states as such.

A candidate that fails condition 4 stays in the adjustment. Conditions 2 and 3 treat it as rejected,
so that no other observation is rejected because of its error.

With the correlations R of the test values w, the test values without the set S are

    w_j' = (w_j − R_jS R_SS⁻¹ w_S) / √(1 − R_jS R_SS⁻¹ R_Sj),

and all unknowns are determined as long as R_SS is regular.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..graph.equations import Equations
from ..observations import KINDS
from ..observations.base import is_condition
from ..solve.low_rank_update import Update
from ..solve.solution import Solution
from ..statistical_tests import EQUAL_TEST_VALUES, descending
from ..types import Array, Index, Mask
from .group_tests import MIN_CONTROLLED_SHARE, t2_statistic
from .joint_readings import JointTests, has_joint_readings

MAX_TEST_CORRELATION = 0.5
"""Correlation of two test values above which the smaller one waits for the next round."""
INSEPARABLE_CORRELATION = 0.9
"""Correlation of two test values from which on their observations count as inseparable."""
MAX_ROWS_OF_ROUND = 400
"""Maximum number of rows (components of observations) examined in one round, largest first."""
MAX_ROWS_OF_WHOLE_ROUND = 3000
"""Maximum number of rows examined in a round that rejects all outliers at once (``every``)."""
EIGENVALUE_MARGIN = 100.0
"""Factor by which an eigenvalue must differ from `MIN_CONTROLLED_SHARE` for a choice with a
margin."""
MAX_CORRELATION_ELEMENTS = 2_500_000
"""Maximum number of elements of the correlation matrix that are computed at once; with eight times
as many the time doubles, as they do not stay in the cache."""
FLAT_EIGENVALUE_RATIO = 1e-10
"""Ratio of the smallest to the largest eigenvalue of a point's normal matrix up to which its rays
leave the point undetermined."""


@dataclass(frozen=True)
class RowGroups:
    """The readings of a solution; each is a unit that is rejected with all its rows.

    A reading is an observation, or several that are parts of one (`Equations.reading_of_row`).
    """

    number: Index
    """Number of the reading of each scalar row, (n,)."""
    order: Index | None
    """Rows in the order of the readings, (n,); None: they are in this order."""
    first: Index
    """Place of the first row of each reading in this order, (m,)."""
    size: Index
    """Number of rows of each reading, (m,)."""

    @classmethod
    def of(cls, equations: Equations) -> RowGroups:
        """Return the readings of a network."""
        number = equations.reading_of_row
        order = np.argsort(number, kind="stable") if has_joint_readings(equations) else None
        first = np.flatnonzero(np.diff(number if order is None else number[order], prepend=-1))
        return cls(number, order, first, np.diff(np.append(first, len(number))))

    def rows(self, unit: int) -> Index:
        """Return the rows of one reading, ascending."""
        places = np.arange(self.first[unit], self.first[unit] + self.size[unit])
        return places if self.order is None else self.order[places]

    def worst_row(self, unit: int, values: Array) -> int:
        """Return the row of one reading with the largest of |values| (n,)."""
        rows = self.rows(unit)
        return int(rows[descending(np.nan_to_num(np.abs(values[rows])))[0]])

    def largest(self, values: Array) -> Array:
        """Return the largest of |values| (n,) of each reading, (m,); NaN counts as 0."""
        size = np.nan_to_num(np.abs(values))
        ordered = size if self.order is None else size[self.order]
        return np.asarray(np.maximum.reduceat(ordered, self.first))


@dataclass(frozen=True)
class Outlier:
    """An observation that a round rejects, or that is blocked."""

    unit: int
    """Number of the observation."""
    row: int
    """Row of its largest test value."""
    test: float
    """Largest test value of the observation."""
    inseparable: tuple[tuple[int, float], ...]
    """Rows of inseparable other observations, with their correlations."""
    point: int | None = None
    """Number of the point that is removed with the observation, since its other rays cannot
    determine it; None: no point is removed."""


@dataclass(frozen=True)
class Choice:
    """Result of one round."""

    chosen: tuple[Outlier, ...]
    """Rejected observations, the largest first."""
    blocked: tuple[Outlier, ...]
    """Observations above the critical value that some unknown needs to be determined."""
    margin: float = np.inf
    """Smallest relative change of a test value, a correlation or a limit that may change the
    choice."""


class TestedModel(Protocol):
    """Test values of a linear model: a `Reliability`, or an update of one."""

    @property
    def solution(self) -> Solution:
        """The solution to whose rows the test values belong."""
        ...

    @property
    def w(self) -> Array:
        """Test values of Baarda, (n,)."""
        ...

    @property
    def controlled(self) -> Mask:
        """Whether a row has a test value, (n,)."""
        ...

    def correlations_with(self, rows: Index) -> Array:
        """Return the correlations of all test values with those of ``rows``, (n, k)."""
        ...


def choose_outliers(
    rel: TestedModel,
    test: Array,
    *,
    scale: float,
    critical: float,
    share: float,
    stuck: Collection[int] = (),
    every: bool = False,
    gone: Collection[int] = (),
    joint: JointTests | None = None,
) -> Choice:
    """Choose the observations to reject.

    Args:
        rel: the test values and their correlations.
        test: the test values that decide, (n,); NaN for rows without a test value.
        scale: ``rel.w`` / test.
        critical: critical value of ``test``.
        share: part of the largest test value that others must reach to be rejected in this round.
        stuck: blocked observations; they stay, but explain others as if they were rejected.
        every: reject every observation above the critical value, as long as the rest determines
            all unknowns: conditions 2 and 3 are left out.
        gone: observations of the solution that an update has taken out.
        joint: tests of joint readings; None: there are none, or their largest test values decide.
    """
    most_rows = MAX_ROWS_OF_WHOLE_ROUND if every else MAX_ROWS_OF_ROUND
    units = RowGroups.of(rel.solution.equations)
    size = units.largest(test)
    if joint is not None:
        size = joint.in_units_of(critical, size)
    kept = [unit for unit in stuck if size[unit] > critical]
    margin = _margin(size[list(stuck)], critical)
    size[list(stuck)] = 0.0
    size[stated_conditions(rel.solution.equations, units)] = 0.0
    order = descending(size)
    least = share * (1.0 - EQUAL_TEST_VALUES) * size.max()
    order = order[(size[order] > critical) & (size[order] >= least)]
    # Blocked observations were removed above: the share refers to the largest one that can go.
    candidates = order[np.cumsum(units.size[order]) <= max(most_rows, int(units.size.max()))]
    ordered = np.sort(size)
    margin = min(margin, _margin(ordered[-1:], critical))
    margin = min(margin, _margin(ordered[:-1], max(critical, share * float(ordered[-1]))))
    if not len(candidates):
        return Choice((), (), margin)
    if len(candidates) < len(order):
        margin = min(margin, _margin(size[order[len(candidates) :]], size[candidates[-1]]))
    looked_at = np.concatenate([np.array(kept, dtype=np.intp), candidates])
    search = _OutlierSearch(rel, units, looked_at, test, scale, gone)
    search.limits = {} if joint is None else joint.limits()
    for unit in kept:
        search.explain_by(unit)
    for unit in candidates.tolist():
        if every or search.stands_out(unit, critical):
            search.consider(unit)
    chosen, blocked, margin = search.chosen, search.blocked, min(margin, search.margin)
    if not chosen and blocked and len(candidates) < int(np.sum(size > critical)):
        others = choose_outliers(
            rel,
            test,
            scale=scale,
            critical=critical,
            share=share,
            stuck=[*stuck, *(b.unit for b in blocked)],
            every=every,
            gone=gone,
            joint=joint,
        )
        return Choice(others.chosen, (*blocked, *others.blocked), min(margin, others.margin))
    return Choice(tuple(chosen), tuple(blocked), margin)


def stated_conditions(equations: Equations, units: RowGroups) -> Mask:
    """Return which observations are conditions, which are never rejected, (m,)."""
    stated = equations.network.observations
    out = np.zeros(len(units.first), dtype=bool)
    for block in equations.blocks:
        record = KINDS.get(block.kind)
        if record is None or "condition" not in record.attributes:
            continue
        is_one = np.array([is_condition(stated.get(i)) for i in block.ids], dtype=bool)
        out[units.number[block.rows][:: block.dimension][is_one]] = True
    return out


def _margin(values: Array, limit: float) -> float:
    """Return how near any of the values comes to a limit, relative to it."""
    return float(np.abs(values / limit - 1.0).min(initial=np.inf)) if limit > 0 else np.inf


class _OutlierSearch:
    """The linear model, from which one candidate after the other is removed."""

    def __init__(
        self,
        rel: TestedModel,
        units: RowGroups,
        candidates: Index,
        test: Array,
        scale: float,
        before: Collection[int] = (),
    ) -> None:
        self.rel, self.units, self.test = rel, units, test
        self.rows = np.concatenate([units.rows(int(u)) for u in candidates])
        self.place = {int(row): i for i, row in enumerate(self.rows)}
        self.rho, self.partners = _correlations(rel, self.rows, units)
        self.left = self.rho.copy()
        self.w = np.nan_to_num(rel.w[self.rows]) / scale
        self.gone: list[int] = []
        self.before = frozenset(before)
        """Observations that have gone in earlier rounds."""
        self.limits: Mapping[int, float] = {}
        """Critical values of T² of joint readings, by their numbers."""
        self.margin = np.inf
        self.only_images = _only_images(rel.solution.equations)
        self.lost_points: set[int] = set()
        self.chosen: list[Outlier] = []
        self.blocked: list[Outlier] = []

    def stands_out(self, unit: int, critical: float) -> bool:
        """Return whether a unit meets conditions 2 and 3."""
        at = self._at(unit)
        rho = np.nan_to_num(np.abs(self.rho[at][:, self.gone]))
        self._decided(rho.max(axis=0, initial=0.0), MAX_TEST_CORRELATION)
        alike = np.any(rho > MAX_TEST_CORRELATION, axis=0)
        if alike.any():
            # The larger of two that are alike goes first.
            size = np.nan_to_num(np.abs(self.test[self.rows]))
            self._decided(size[self.gone][alike], float(size[at].max()))
            return False
        if unit in self.limits:
            left = np.nan_to_num(self.left[np.ix_(at, at)])
            t2, _ = t2_statistic(self.w[at], left, MIN_CONTROLLED_SHARE)
            ratio = float(np.sqrt(np.nan_to_num(t2) / self.limits[unit]))
            self._decided(np.array([ratio]), 1.0)
            return ratio > 1.0
        left = np.diag(self.left)[at]
        still = np.abs(self.w[at]) / np.sqrt(np.where(left > MIN_CONTROLLED_SHARE, left, np.inf))
        self._decided(np.nan_to_num(still).max(keepdims=True), critical)
        return bool(np.nanmax(still, initial=0.0) > critical)

    def _decided(self, values: Array, limit: float) -> None:
        """Note how near values came to a limit."""
        self.margin = min(self.margin, _margin(values, limit))

    def explain_by(self, unit: int) -> None:
        """Treat a unit that stays as removed, so that it explains other test values."""
        self._let_go(self._at(unit))

    def consider(self, unit: int) -> None:
        """Remove a unit, alone or with its point, if the rest determines all other unknowns."""
        at = self._at(unit)
        row = self.units.worst_row(unit, self.test)
        partners = self.partners[self.place[row]]
        if unit in self.limits:
            partners = self._inseparable(unit)
        candidate = Outlier(unit, row, float(self.test[row]), partners)
        point = _tie_point(self.rel.solution.equations, row, self.only_images)
        if point is not None and point in self.lost_points:
            return
        block = self.left[np.ix_(at, at)]
        whole = bool(np.isfinite(block).all())
        if whole:
            least = float(np.linalg.eigvalsh(block)[0])
            whole = least > MIN_CONTROLLED_SHARE
            if (
                MIN_CONTROLLED_SHARE / EIGENVALUE_MARGIN
                < least
                < MIN_CONTROLLED_SHARE * EIGENVALUE_MARGIN
            ):
                self.margin = 0.0
        if not whole:
            if point is not None and not self._determined(point, row):
                self.lost_points.add(point)
                candidate = replace(candidate, point=point)
            else:
                if not self.chosen:
                    self.blocked.append(candidate)
                    self._let_go(at)
                return
        self.chosen.append(candidate)
        self._let_go(at)

    def _inseparable(self, unit: int) -> tuple[tuple[int, float], ...]:
        """Return the worst rows of joint readings that no direction of an error tells apart.

        With canonical correlations: the smallest of a pair is at least `INSEPARABLE_CORRELATION`.
        An edge of a chain that only the loop of one closure controls is inseparable from it.
        """
        found: list[tuple[int, float]] = []
        own = self._root(unit)
        for other in (u for u in self.limits if u != unit and self._is_candidate(u)):
            cross = self.rho[np.ix_(self._at(unit), self._at(other))]
            whitened = own @ np.nan_to_num(cross) @ self._root(other).T
            least = float(np.linalg.svd(whitened, compute_uv=False)[-1])
            if least >= INSEPARABLE_CORRELATION:
                found.append((self.units.worst_row(other, self.test), least))
        order = descending(np.array([rho for _, rho in found]))
        return tuple(found[i] for i in order.tolist())

    def _root(self, unit: int) -> Array:
        """Return W with Wᵀ W = R⁺ of the correlations of a reading."""
        at = self._at(unit)
        values, vectors = np.linalg.eigh(np.nan_to_num(self.rho[np.ix_(at, at)]))
        on = values > MIN_CONTROLLED_SHARE
        scale = np.where(on, 1.0 / np.sqrt(np.where(on, values, 1.0)), 0.0)
        return np.asarray(scale[:, None] * vectors.T)

    def _is_candidate(self, unit: int) -> bool:
        return int(self.units.rows(unit)[0]) in self.place

    def _at(self, unit: int) -> Index:
        return np.array([self.place[int(row)] for row in self.units.rows(unit)], dtype=np.intp)

    def _let_go(self, at: Index) -> None:
        """Update the test values and correlations of the others for the removed rows."""
        at = at[np.isfinite(np.diag(self.rho)[at])]
        # An additional unknown for the error of each row makes its residual, and w, zero.
        update = Update.of(self.left).with_rows(at, np.eye(len(at)), self.w[at], sign=0)
        self.w = self.w + update.step
        self.left = self.left - update.loss(update.spread)
        self.gone.extend(at.tolist())

    def _determined(self, point: int, row: int) -> bool:
        """Return whether the remaining rays of a point, without ``row``, determine it."""
        solution = self.rel.solution
        number = self.units.number
        gone = {int(number[r]) for r in self.rows[self.gone]} | {int(number[row])} | self.before
        normal = np.zeros((3, 3))
        for lb in solution.normal().system.blocks:
            if not lb.block.image:
                continue
            for i in np.flatnonzero(lb.block.variables[2][1] == point).tolist():
                if int(number[lb.block.first_row + 2 * i]) not in gone:
                    normal += lb.a[2][i].T @ lb.a[2][i]
        values = np.linalg.eigvalsh(normal)
        return bool(values[0] > FLAT_EIGENVALUE_RATIO * values[-1])


def _correlations(
    rel: TestedModel, rows: Index, units: RowGroups
) -> tuple[Array, list[tuple[tuple[int, float], ...]]]:
    """Return the correlations (k, k) of test values, and the inseparable rows of each row.

    The correlations of uncontrolled rows are NaN.
    """
    n = len(rel.w)
    step = max(1, MAX_CORRELATION_ELEMENTS // max(1, n))
    rho, partners = [], []
    for start in range(0, len(rows), step):
        part = rows[start : start + step]
        every = rel.correlations_with(part)
        rho.append(every[rows])
        for j, row in enumerate(part.tolist()):
            close = np.flatnonzero(np.abs(every[:, j]) >= INSEPARABLE_CORRELATION)
            close = close[units.number[close] != units.number[row]]
            close = close[descending(np.abs(every[close, j]))]
            partners.append(tuple((int(i), float(every[i, j])) for i in close))
    out = np.concatenate(rho, axis=1)
    out[~rel.controlled[rows]] = np.nan
    return out, partners


def _tie_point(equations: Equations, row: int, only_images: Mask) -> int | None:
    """Return the point of an image ray, if it is free and only images observe it."""
    block = next(b for b in equations.blocks if b.rows.start <= row < b.rows.stop)
    if not block.image:
        return None
    point = int(block.variables[2][1][(row - block.first_row) // 2])
    if not equations.unknowns["point"].free[point].all():
        return None
    return point if only_images[point] else None


def _only_images(equations: Equations) -> Mask:
    """Return a mask of the points that only images observe."""
    out = np.ones(len(equations.unknowns["point"].names), dtype=bool)
    for block in equations.blocks:
        if not block.image:
            for kind, index in block.variables:
                if kind == "point":
                    out[index] = False
    return out

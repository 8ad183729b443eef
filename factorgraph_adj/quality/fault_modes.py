"""Fault modes: gross errors in one or two readings, and the largest bias that no test sees.

A fault mode F is one reading, or two, with gross errors of any sizes in all their components. A
reading is what data snooping rejects as one: an observation with all its components, or the parts
of a joint reading (`Equations.reading_of_row`). With M = P Q_vv P of the rows of F, g = WᵀÃ Q d the
effects of unit errors on a coordinate dᵀx, and an error f of the rows

    test values     w_k ~ N((M f)_k/√M_kk, 1)
                    T² of a joint reading A ~ χ'²((M f)_Aᵀ M_AA⁻¹ (M f)_A)
    bias            b = gᵀf

the slope of the mode is the largest |b| where no test has a noncentrality above 1,

    G_F = max |gᵀf|,    |(M f)_k| ≤ √M_kk,    (M f)_Aᵀ M_AA⁻¹ (M f)_A ≤ 1.

It is a convex problem, whose dual gives upper bounds: with y = M_FF⁻¹ g the tests of F alone give

    G_F ≤ Σ_k |y_k| √M_kk   (w)     and     √(y_Aᵀ M_AA y_A)   for a joint reading A.

For one reading with one component this is |g|/√M, exactly: by Cauchy and Schwarz no other test sees
more of it. For two such readings with the correlation ρ of their test values it is
(|γ_1 − ργ_2| + |γ_2 − ργ_1|)/(1 − ρ²), γ = g/√M. Where ρ is large the test of a third reading sees
more of the difference of the two errors. It takes the place of one of the two tests; each choice of
tests gives an upper bound, and the smallest counts. For the worst mode of each figure the tests are
chosen by the simplex method (`factorgraph_adj.quality.bounding_tests`), and another mode becomes
the worst, until the bound is that of the linear programme. Vectors and joint readings keep an upper
bound.

Large networks. With whitened components C = T M Tᵀ, C_AA = I, and κ the norm of C_AB,

    G_AB ≤ G_A + G_B + s κ/(1 − κ) (|γ_A| + |γ_B|),    |γ_A| ≤ G_A,    s = 1 for single components.

So all pairs with κ ≤ κ0 are bounded by the two largest slopes of single readings, and only pairs
above κ0, which share unknowns, are computed; of these only such whose bound exceeds what has been
found. In a network with few readings κ0 is 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array, csr_array

from ..types import Array, Index, Mask
from .bounding_tests import bounding_tests
from .causes.shared_error_tests import whitening_matrix
from .group_tests import least_share
from .reliability import ROUNDING_EFFECT_M, Reliability
from .tested_readings import TestedReadings, tested_readings

DENSE_ROWS = 1500
"""Number of rows up to which all pairs of readings are computed."""
LEAST_COHERENCE = 0.05
"""κ0 of larger networks: their slopes are too large by up to κ0/(1 − κ0), 5 %, where the worst pair
shares no unknown."""
COHERENCE_OF_THIRD_TEST = 0.3
"""Coherence of two readings from which the test of a third one may see more of their difference."""
ELEMENTS_AT_ONCE = 4_000_000
"""Number of elements of arrays that are computed at once."""
ENTRIES_AT_ONCE = 200_000
"""Number of slopes of pairs that are computed at once."""
FIRST_PAIRS = 200
"""Number of pairs that are computed first, those with the largest bounds."""
RELATIVE_ROUNDING = 1e-9
"""Effect of an error of one σ, relative to σ of a coordinate, that is rounding."""
CANCELLED_EFFECT = 1e-7
"""Effect of errors that cancel in all residuals, relative to that of each, that is rounding."""
LARGEST_INSEPARABLE = 0.01
"""Largest share of a difference of two errors in the residuals at which it counts as unseen."""
LEAST_DETERMINANT = 1e-9
"""Determinant of the responses of two tests above which they bound both errors."""
MAX_REFINEMENTS = 30
"""Largest number of times that the tests of the worst pairs are chosen anew."""
MAX_CONDITION = 1e8
"""Largest condition of the responses of the tests of a pair for which others are chosen."""
LARGEST = 1e30
"""Number that stands for infinity, as infinity times zero is not zero."""


@dataclass(frozen=True, eq=False)
class WorstModes:
    """The fault mode with the largest slope of each figure; arrays (m,)."""

    slope: Array
    """Slopes G, metres for each unit of noncentrality; infinite where no test sees an error."""
    first: Index
    """Number of a reading of the mode."""
    second: Index
    """Number of the other reading; −1: the mode has one."""


class FaultModes:
    """The fault modes of an adjustment: slopes of single readings and of pairs."""

    def __init__(self, rel: Reliability, *, faults: int) -> None:
        """Take over the reliability of an adjustment; ``faults`` is 1 or 2."""
        self.solution = rel.solution
        self.readings = r = tested_readings(rel)
        system = self.solution.normal().system
        a = system.sparse(np.arange(self.solution.equations.n_rows))
        errors = csr_array(whitening_matrix(self.solution.equations)[:, r.order])
        normal = csr_array(a.T @ errors)
        self._normal = csr_array((normal @ r.whitening).T)
        self._hidden = csr_array((normal @ r.hidden).T)
        self._errors = csr_array(errors @ r.whitening)
        self.pairs = self._pairs() if faults > 1 and r.n > 1 else None

    @property
    def dof(self) -> int:
        """Largest degrees of freedom of a test."""
        r = self.readings
        size = np.diff(np.append(r.first, len(r.order)))
        return int(np.max(size[r.joint], initial=1))

    def effects(self, axes: Array) -> tuple[Array, Array]:
        """Return γ (n, k) and effects of uncontrolled errors of one σ (h, k) on axes, metres.

        Args:
            axes: Q d of the axes, (n_columns, k).
        """
        return self._normal @ axes, self._hidden @ axes

    def worst(self, effects: Array, unseen: Array, sigma: Array) -> WorstModes:
        """Return the worst fault modes of figures.

        Args:
            effects: γ of the axes of each figure, (n, figures, axes), zero where it has fewer.
            unseen: effects of uncontrolled errors, (h, figures, axes).
            sigma: largest standard deviation of each figure, (figures,).
        """
        r, figures = self.readings, effects.shape[1]
        single = r.single(effects)
        lost = np.sqrt(np.einsum("hfa,hfa->hf", unseen, unseen))
        rounding = np.maximum(ROUNDING_EFFECT_M, RELATIVE_ROUNDING * sigma)
        lost = lost > rounding
        direction, figure = np.nonzero(lost)
        single[r.hidden_of[direction], figure] = np.inf
        first = np.argmax(single, axis=0)
        every = np.arange(figures)
        worst = WorstModes(single[first, every], first, np.full(figures, -1))
        if self.pairs is None:
            return worst
        return self.pairs.worst(effects, single, worst, rounding)

    def _pairs(self) -> Pairs:
        """Return the coherent pairs of readings."""
        r = self.readings
        n = len(r.order)
        least = 0.0 if n <= DENSE_ROWS else LEAST_COHERENCE
        unit = np.repeat(np.arange(r.n), np.diff(np.append(r.first, n)))
        own = csr_array(self._errors.T @ self._errors)
        rows: list[Index] = []
        columns: list[Index] = []
        values: list[Array] = []
        norms: list[tuple[Index, Index, Array]] = []
        at_once = max(1, ELEMENTS_AT_ONCE // max(n, self._normal.shape[1]))
        cuts = _cuts(r.first, n, at_once)
        for begin, end in pairwise(cuts):
            x = self.solution.factor.solve(self._normal[begin:end].T.toarray())
            c = own[:, begin:end].toarray() - self._normal @ x
            here = np.unique(unit[begin:end], return_index=True)[1]
            norm = np.sqrt(np.add.reduceat(r.sums(c**2), here, axis=1))
            a, b = np.nonzero(norm > least)
            b_unit = b + unit[begin]
            keep = a < b_unit
            norms.append((a[keep], b_unit[keep], norm[a[keep], b[keep]]))
            near = norm[np.ix_(unit, unit[begin:end] - unit[begin])] > least
            i, j = np.nonzero(near)
            rows.append(i)
            columns.append(j + begin)
            values.append(c[near])
        at = np.concatenate(rows), np.concatenate(columns)
        coherence = csr_array(coo_array((np.concatenate(values), at), shape=(n, n)))
        a, b, norm = (np.concatenate(x) for x in zip(*norms, strict=True))
        return Pairs.of(r, coherence, (a, b, norm), least, least_share(self.solution))


def _cuts(first: Index, n: int, at_once: int) -> list[int]:
    """Return places at which rows are cut between readings, about ``at_once`` rows apart."""
    out, begins = [0], np.append(first, n)
    while out[-1] < n:
        next_ = begins[np.searchsorted(begins, out[-1] + at_once, side="right") - 1]
        out.append(int(next_ if next_ > out[-1] else begins[begins > out[-1]][0]))
    return out


@dataclass(frozen=True, eq=False)
class PairClass:
    """Pairs of readings with the same numbers of rows, p pairs with m rows together."""

    first: Index
    """First reading of each pair, (p,)."""
    second: Index
    """Second reading, (p,)."""
    rows: Index
    """Rows of both, (p, m)."""
    parts: tuple[tuple[slice, Mask], ...]
    """Rows of the first and of the second reading among the m, and which pairs test it by T²."""
    dual: Array
    """F C⁻¹ of both, (p, m, m): times γ it gives the part of each test in the upper bound."""
    inseparable: Mask
    """Pairs with errors that cancel in all residuals, (p,)."""
    cancelling: Array
    """Projectors on such errors, (number of them, m, m), in their order."""
    alternatives: tuple[Array, ...]
    """The same as ``dual`` with other choices of tests, (p, m, m) each; those of pairs that have
    none are ``dual``."""
    amplification: Array
    """Largest ratio of the slope of each pair to the sum of both, (p,)."""
    better: dict[int, list[Array]] = field(default_factory=dict)
    """Further choices of tests of single pairs, (m, m) each, as in ``alternatives``."""

    def slopes(self, pairs: Index, figures: Index, effects: Array, rounding: Array) -> Array:
        """Return upper bounds of the slopes of some pairs for some figures, (e,).

        Args:
            pairs: numbers of pairs, (e,).
            figures: numbers of figures, (e,).
            effects: γ of the axes of each figure, (n, figures, axes).
            rounding: effects on each figure that are rounding, (figures,).
        """
        gamma = effects[self.rows[pairs], figures[:, None]]
        out = np.full(len(pairs), np.inf)
        for dual in (self.dual, *self.alternatives):
            y = dual[pairs] @ gamma
            size = np.sqrt(np.einsum("ema,ema->em", y, y))
            total = np.zeros(len(pairs))
            for part, joint in self.parts:
                own = size[:, part]
                together = np.sqrt(np.einsum("em,em->e", own, own))
                total += np.where(joint[pairs], together, own.sum(axis=1))
            out = np.minimum(out, total)
        if self.better:
            known = np.flatnonzero(np.isin(pairs, list(self.better)))
            for pair in np.unique(pairs[known]).tolist():
                own = known[pairs[known] == pair]
                for dual in self.better[pair]:
                    size = np.linalg.norm(dual @ gamma[own], axis=2).sum(axis=1)
                    out[own] = np.minimum(out[own], size)
        lost = np.flatnonzero(self.inseparable[pairs])
        if len(lost):
            number = np.cumsum(self.inseparable) - 1
            moved = self.cancelling[number[pairs[lost]]] @ gamma[lost]
            size, every = (np.sqrt(np.einsum("ema,ema->e", x, x)) for x in (moved, gamma[lost]))
            seen = np.maximum(rounding[figures[lost]], CANCELLED_EFFECT * every)
            out[lost[size > seen]] = np.inf
        return out


@dataclass(frozen=True, eq=False)
class Pairs:
    """Coherent pairs of readings; all others are bounded together."""

    readings: TestedReadings
    """The readings."""
    classes: tuple[PairClass, ...]
    """The pairs by the numbers of their rows."""
    coherence: csr_array
    """C of all rows in pairs, (n, n)."""
    rest: float
    """Largest ratio of the slope of any other pair to the sum of both; 0: there is none."""

    @classmethod
    def of(
        cls,
        readings: TestedReadings,
        coherence: csr_array,
        pairs: tuple[Index, Index, Array],
        least: float,
        least_share: float,
    ) -> Pairs:
        """Prepare pairs.

        Args:
            readings: the readings.
            coherence: C of all rows in pairs and of all readings, (n, n).
            pairs: both readings and the norm of C_AB of each pair, (p,) each.
            least: κ0.
            least_share: share of an error in the residuals above which it is controlled.
        """
        r = readings
        size = np.diff(np.append(r.first, len(r.order)))
        spread = r.dual_norms()
        a, b, _ = pairs
        swap = size[a] > size[b]
        a, b = np.where(swap, b, a), np.where(swap, a, b)
        code = size[a] * (size.max() + 1) + size[b]
        classes = [
            _pair_class(r, coherence, (a[code == k], b[code == k]), spread, least_share)
            for k in np.unique(code)
        ]
        every = r.n * (r.n - 1) // 2
        rest = 1.0 + spread * least / (1.0 - least) if len(a) < every else 0.0
        return cls(r, tuple(classes), coherence, rest)

    def worst(
        self, effects: Array, single: Array, worst: WorstModes, rounding: Array
    ) -> WorstModes:
        """Return the worst fault modes of one or two readings.

        The tests that bound the worst pair are chosen anew, and the search is repeated with the
        smaller bound, until it is the best one or `MAX_REFINEMENTS` is reached.

        Args:
            effects: γ of the axes of each figure, (n, figures, axes).
            single: slopes of single readings, (m, figures).
            worst: the worst modes of one reading.
            rounding: effects on each figure that are rounding, (figures,).
        """
        slope, first, second = worst.slope.copy(), worst.first.copy(), worst.second.copy()
        active = np.arange(single.shape[1])
        done: set[tuple[int, int, int]] = set()
        for _ in range(1 + MAX_REFINEMENTS):
            part = WorstModes(worst.slope[active], worst.first[active], worst.second[active])
            found, place = self._search(
                effects[:, active], single[:, active], part, rounding[active]
            )
            slope[active], first[active], second[active] = found.slope, found.first, found.second
            again = []
            for i in np.flatnonzero((place[:, 0] >= 0) & np.isfinite(found.slope)).tolist():
                key = (*place[i].tolist(), int(active[i]))
                if key not in done and self._refine(key[0], key[1], effects[:, active[i]]):
                    again.append(i)
                done.add(key)
            if not again:
                break
            active = active[again]
        return WorstModes(slope, first, second)

    def _refine(self, number: int, pair: int, effects: Array) -> bool:
        """Choose the tests of a pair for a figure with effects (n, axes); return whether any."""
        pairs = self.classes[number]
        if any(joint[pair] for _, joint in pairs.parts) or pairs.inseparable[pair]:
            return False
        rows = pairs.rows[pair]
        gamma = effects[rows]
        c = self.coherence[:, rows].toarray()
        units = np.searchsorted(self.readings.first, rows, side="right")
        known = np.ones(len(c), dtype=bool)
        for unit in np.unique(units).tolist():
            # A coherence that is not stored is small, but unknown.
            stored = self.readings.sums(np.abs(c[:, units == unit])).any(axis=1)
            known &= np.repeat(stored, np.diff(np.append(self.readings.first, len(c))))
        seen = np.where(known[:, None] | (self.rest == 0.0), self.readings.responses @ c, 0.0)
        own = seen[rows]
        if not np.linalg.cond(own) < MAX_CONDITION:
            return False
        main = np.linalg.svd(gamma, full_matrices=False)[2][0]
        dual = bounding_tests(seen, rows, gamma @ main)
        if dual is None:
            return False
        pairs.better.setdefault(pair, []).append(dual)
        return True

    def _search(
        self, effects: Array, single: Array, worst: WorstModes, rounding: Array
    ) -> tuple[WorstModes, Index]:
        """Return the worst modes, and class and number of the pair of each, (figures, 2)."""
        figures = np.arange(single.shape[1])
        finite = np.where(np.isfinite(single), single, 0.0)
        two = np.argpartition(finite, -2, axis=0)[-2:]
        sums = finite[two[0], figures] + finite[two[1], figures]
        slope, first, second = worst.slope.copy(), worst.first.copy(), worst.second.copy()
        place = np.full((len(figures), 2), -1, dtype=np.intp)
        open_ = np.isfinite(slope) & (slope > rounding)
        far = open_ & (self.rest * sums > slope)
        slope[far] = self.rest * sums[far]
        first[far], second[far] = two[1][far], two[0][far]
        for kind, pairs in enumerate(self.classes):
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = np.where(open_, finite / slope, 0.0).max(axis=1, initial=0.0)
            reach = (ratio[pairs.first] + ratio[pairs.second]) * np.minimum(
                pairs.amplification, LARGEST
            )
            order = np.argsort(-reach)
            order = order[reach[order] > 1.0]
            at_once = max(1, ELEMENTS_AT_ONCE // (len(figures) * 4))
            begin = 0
            while begin < len(order):
                # The first few pairs raise what the others have to reach.
                some = order[begin : begin + (FIRST_PAIRS if begin == 0 else at_once)]
                begin += len(some)
                total = finite[pairs.first[some]] + finite[pairs.second[some]]
                bound = total * np.minimum(pairs.amplification[some], LARGEST)[:, None]
                pair, figure = np.nonzero((bound > slope) & open_ & np.isfinite(slope))
                found = np.zeros_like(bound)
                for part in np.array_split(np.arange(len(pair)), 1 + len(pair) // ENTRIES_AT_ONCE):
                    p, f = some[pair[part]], figure[part]
                    found[pair[part], f] = pairs.slopes(p, f, effects, rounding)
                best = np.argmax(found, axis=0)
                better = found[best, figures] > slope
                slope[better] = found[best, figures][better]
                first[better] = pairs.first[some[best[better]]]
                second[better] = pairs.second[some[best[better]]]
                place[better, 0], place[better, 1] = kind, some[best[better]]
        return WorstModes(slope, first, second), place


def _pair_class(
    r: TestedReadings,
    coherence: csr_array,
    pairs: tuple[Index, Index],
    spread: float,
    least_share: float,
) -> PairClass:
    """Return the pairs of one class, all with the same numbers of rows."""
    a, b = pairs
    size = np.diff(np.append(r.first, len(r.order)))
    da, db = int(size[a[0]]), int(size[b[0]])
    m, p = da + db, len(a)
    rows = np.concatenate(
        [r.first[a, None] + np.arange(da), r.first[b, None] + np.arange(db)], axis=1
    )
    i, j = np.broadcast_arrays(rows[:, :da, None], rows[:, None, da:])
    cross = np.asarray(coherence[i.ravel(), j.ravel()]).reshape(p, da, db)
    c = np.tile(np.eye(m), (p, 1, 1))
    c[:, :da, da:] = cross
    c[:, da:, :da] = cross.transpose(0, 2, 1)
    if m == 2:
        rho = cross[:, 0, 0]
        norm = np.abs(rho)
        root = np.full((p, 2, 2), np.sqrt(0.5))
        root[:, 1, 0] = -root[:, 1, 0]
        values = np.stack([1.0 - rho, 1.0 + rho], axis=1)
        vectors = root
    else:
        norm = np.linalg.norm(cross, ord=2, axis=(1, 2))
        values, vectors = np.linalg.eigh(c)
    limit = np.minimum(least_share / np.minimum(r.share[a], r.share[b]), LARGEST_INSEPARABLE)
    on = values > limit[:, None]
    inverse = np.where(on, 1.0 / np.where(on, values, 1.0), 0.0)
    inverse = (vectors * inverse[:, None, :]) @ vectors.transpose(0, 2, 1)
    dual = inverse
    if da > 1 or db > 1:
        own = np.zeros((p, m, m))
        for part in (slice(0, da), slice(da, m)):
            i, j = np.broadcast_arrays(rows[:, part, None], rows[:, None, part])
            own[:, part, part] = np.asarray(r.dual[i.ravel(), j.ravel()]).reshape(i.shape)
        dual = own @ inverse
    inseparable = np.asarray(np.any(~on, axis=1))
    lost = np.where(on, 0.0, 1.0)[inseparable]
    vectors = vectors[inseparable]
    alternatives = _alternatives(r, coherence, rows, dual, inseparable) if m == 2 else ()
    with np.errstate(divide="ignore"):
        amplification = 1.0 + spread * np.where(norm < 1.0, norm / (1.0 - norm), np.inf)
    amplification[inseparable] = np.inf
    return PairClass(
        a,
        b,
        rows,
        ((slice(0, da), r.joint[a]), (slice(da, m), r.joint[b])),
        dual,
        inseparable,
        (vectors * lost[:, None, :]) @ vectors.transpose(0, 2, 1),
        alternatives,
        amplification,
    )


def _alternatives(
    r: TestedReadings, coherence: csr_array, rows: Index, dual: Array, inseparable: Mask
) -> tuple[Array, ...]:
    """Return C⁻¹ of pairs of single rows with a third test instead of that of either row."""
    size = np.diff(np.append(r.first, len(r.order)))
    single = np.repeat(size == 1, size)
    rho = np.asarray(coherence[rows[:, 0], rows[:, 1]])
    close = np.flatnonzero((np.abs(rho) > COHERENCE_OF_THIRD_TEST) & ~inseparable)
    if not len(close):
        return ()
    whole = coherence.toarray() if len(single) <= DENSE_ROWS else None
    at_once = max(1, ELEMENTS_AT_ONCE // len(single))
    third = np.zeros((len(close), 2))
    for begin in range(0, len(close), at_once):
        some = close[begin : begin + at_once]
        sign = np.sign(rho[some])[:, None]
        by_first, by_second = (
            (whole if whole is not None else coherence)[rows[some, k]] for k in (0, 1)
        )
        if whole is None:
            # A coherence that is not stored is small, but unknown.
            known = by_first.astype(bool).multiply(by_second.astype(bool))
            by_first, by_second = (x.multiply(known).toarray() for x in (by_first, by_second))
        seen = np.abs(by_first - sign * by_second) * single
        best = np.argmax(seen, axis=1)
        at = np.arange(len(some))
        third[begin : begin + len(some)] = np.stack(
            [by_first[at, best], by_second[at, best]], axis=1
        )
    out = []
    for own in (0, 1):
        tests = np.empty((len(close), 2, 2))
        tests[:, 0, own], tests[:, 0, 1 - own] = 1.0, rho[close]
        tests[:, 1] = third
        good = np.abs(np.linalg.det(tests)) > LEAST_DETERMINANT
        other = dual.copy()
        other[close[good]] = np.linalg.inv(tests[good]).transpose(0, 2, 1)
        out.append(other)
    return tuple(out)

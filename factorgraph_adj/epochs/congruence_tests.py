"""Congruence tests, and the search for points that moved: backward, combinations, robust.

For differences d with cofactors Q and open motions G the weight

    W = Q̃⁻¹ − Q̃⁻¹G (GᵀQ̃⁻¹G)⁻¹GᵀQ̃⁻¹,  Q̃ = Q + c G Gᵀ,

does not depend on c, nor on the datum in which Q was computed: Q̃ is regular where Q lacks the
motions. Ω = dᵀ W d with h = rows − rank G degrees of freedom is the sum of squares by which the two
epochs differ in shape. Under the hypothesis that the points of the columns C moved,

    ∇ = (CᵀWC)⁻¹ CᵀW d,  Q_∇ = (CᵀWC)⁻¹,  T = ∇ᵀ(CᵀWC)∇,

where Ω − T is the Ω of the other points alone: the Gauss decomposition of Pelzer and Niemeier, and
the test of several gross errors in data snooping.

The reference points that moved are found in one of three ways:

- backward (Pelzer 1971, Niemeier 2008): while the congruence test of the points that are left
  rejects, the point leaves whose hypothesis has the largest test value.
- combinations (Velsink 2015, Nowel 2020): the smallest set of points leaves without which the test
  accepts; of sets of one size that with the smallest Ω of the others. Points that moved together
  do not smear over those that did not, as they can one by one.
- robust: the similarity transformation of the open motions that minimises Σ |d_i| over the points
  (iteratively weighted, Chen 1983) shows which displacements are significant; these points leave
  at first, and come back where the test of all that are left accepts with them.

Where the datum of both epochs leaves no motion open, all reference points may leave: what held
points, or observations of coordinates, say of the displacements is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from math import comb
from typing import Literal, TypeAlias, get_args

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from ..errors import DatumError, InputError, known
from ..statistical_tests import (
    chi2_quantile,
    chi2_upper_probability,
    fisher_quantile,
    fisher_upper_probability,
    noncentrality_of_power,
)
from ..types import Array, Index
from .differences import Differences

MIN_EIGENVALUE_RATIO = 1e-12
"""Ratio of the smallest to the largest eigenvalue of Q̃ below which d has no weight."""
MAX_COMBINATIONS = 20_000
"""Largest number of sets of one size that are tried; a larger number is searched backward."""
MAX_ROBUST_ITERATIONS = 100
"""Largest number of iterations of the robust transformation."""
MIN_ROBUST_STEP_M = 1e-10
"""Change of the differences, metres, at which the robust transformation ends."""


def weight_of_differences(q: Array, g: Array) -> Array:
    """Return W (n, n) of differences with cofactors Q (n, n) and open motions G (n, g).

    Raises:
        InputError: Q lacks more than the motions.
        DatumError: the points do not determine the motions.
    """
    size = float(np.trace(q)) / max(len(q), 1)
    full = q + size * (g @ g.T)
    scale = np.sqrt(np.diag(full))
    if (scale <= 0).any():
        raise InputError("a coordinate has no standard deviation in either epoch")
    even = full / np.outer(scale, scale)
    values = np.linalg.eigvalsh(even)
    if values[0] < MIN_EIGENVALUE_RATIO * values[-1]:
        raise InputError(
            "the covariance of the differences is singular beyond the datum defect: coordinates "
            "of the two epochs depend on each other"
        )
    factor = cho_factor(even)
    p = cho_solve(factor, np.eye(len(q))) / np.outer(scale, scale)
    if g.shape[1] == 0:
        return np.asarray((p + p.T) / 2.0)
    pg = p @ g
    try:
        inner = cho_factor(g.T @ pg)
        if np.linalg.cond(g) > 1e8:
            raise LinAlgError
    except LinAlgError:
        raise DatumError(
            f"the points do not determine the {g.shape[1]} motions that the observations leave "
            "open: take more points as reference",
            defect=int(g.shape[1] - np.linalg.matrix_rank(g)),
        ) from None
    w = p - pg @ cho_solve(inner, pg.T)
    return np.asarray((w + w.T) / 2.0)


def motion_rank(g: Array) -> int:
    """Return the number of motions that move some points, (n, g)."""
    return int(np.linalg.matrix_rank(g, tol=1e-7)) if g.size else 0


def motion_basis(g: Array) -> Array:
    """Return an orthonormal basis of the motions of some points, (n, rank)."""
    if not g.size:
        return g[:, :0]
    u, s, _ = np.linalg.svd(g, full_matrices=False)
    return np.asarray(u[:, s > 1e-7])


def held_and_open_directions(own: Array, others: Array) -> tuple[Array, Array]:
    """Return directions in which other points hold a point against motions, and the rest.

    A motion that moves the point alone leaves its displacement open in that direction.

    Args:
        own: the motions of the point, (k, g).
        others: the motions of the points that stay, (n, g).

    Returns:
        Orthonormal bases of the directions that are held, (k, f), and of the others, (k, k − f).
    """
    _, s, v = np.linalg.svd(others)
    free = own @ v[int((s > 1e-7).sum()) :].T
    u, s, _ = np.linalg.svd(free)
    left = int((s > 1e-7).sum())
    return np.asarray(u[:, left:]), np.asarray(u[:, :left])


@dataclass(frozen=True)
class HypothesisTest:
    """A test of a hypothesis: accepted where the value does not exceed the critical one."""

    __test__ = False  # no test case of pytest

    value: float
    """Test value T: a sum of squares divided by its degrees of freedom and σ0²."""
    critical: float
    """Critical value of T."""
    freedom: tuple[int, float]
    """Degrees of freedom of the distribution F; the second is infinite where σ0 is known."""
    p_value: float
    """Probability of a larger T if the hypothesis is true."""

    @property
    def accepted(self) -> bool:
        """Whether T does not exceed the critical value."""
        return self.value <= self.critical


@dataclass(frozen=True)
class UnitVariance:
    """Variance of unit weight of the tests."""

    variance: float
    """σ0² by which sums of squares are divided."""
    freedom: float
    """Degrees of freedom of σ0²; infinite where it is known."""

    def test(self, omega: float, h: int, alpha: float) -> HypothesisTest:
        """Test a sum of squares of h degrees of freedom: T = Ω/(h σ0²).

        A hypothesis of no degree of freedom is never rejected.
        """
        if h == 0:
            return HypothesisTest(0.0, float("inf"), (0, self.freedom), 1.0)
        value = omega / (h * self.variance)
        return HypothesisTest(
            value, self.quantile(1.0 - alpha, h), (h, self.freedom), self.above(value, h)
        )

    def quantile(self, p: float, h: int) -> float:
        """Return the quantile of T."""
        if np.isinf(self.freedom):
            return chi2_quantile(p, h) / h
        return fisher_quantile(p, h, self.freedom)

    def above(self, value: float, h: int) -> float:
        """Return the probability of a larger T."""
        if np.isinf(self.freedom):
            return chi2_upper_probability(value * h, h)
        return fisher_upper_probability(value, h, self.freedom)

    def noncentrality(self, alpha: float, power: float, h: int) -> float:
        """Return λ for which a test with ``alpha`` rejects with the probability ``power``."""
        return _noncentrality(self.freedom, self.quantile(1.0 - alpha, h), power, h)


@lru_cache(maxsize=512)
def _noncentrality(freedom: float, critical: float, power: float, h: int) -> float:
    """Return λ for which T of h degrees of freedom exceeds a value with a probability."""
    from scipy.stats import ncf, ncx2  # imported here, because the import is slow

    def power_at(value: float) -> float:
        if np.isinf(freedom):
            return float(ncx2.sf(critical * h, h, value))
        return float(ncf.sf(critical, h, freedom, value))

    return noncentrality_of_power(power_at, power)


def displacement_of_rows(w: Array, d: Array, columns: Index) -> tuple[Array, Array, float]:
    """Return ∇ (c,), Q_∇ (c, c) and T·(degrees of freedom) if some rows of d moved.

    Args:
        w: the weight W, (n, n).
        d: differences, (n,).
        columns: rows of d that may have moved, (c,).
    """
    normal = w[np.ix_(columns, columns)]
    u = w[columns] @ d
    q = np.linalg.inv(normal)
    nabla = q @ u
    return nabla, (q + q.T) / 2.0, float(u @ nabla)


LocalisationMethod: TypeAlias = Literal["backward", "combinations", "robust"]
"""How the points that moved are found."""


@dataclass(frozen=True)
class LocalisationStep:
    """One step of the search: what left, and the test of what is left."""

    left: tuple[str, ...]
    """Points that left the reference in this step; empty for the first test of all."""
    back: tuple[str, ...]
    """Points that came back in this step."""
    test: HypothesisTest
    """Congruence test of the points that are still in the reference."""


@dataclass(frozen=True)
class LocalisationResult:
    """Result of a search."""

    stable: tuple[str, ...]
    """Points that are left in the reference."""
    steps: tuple[LocalisationStep, ...]
    """The steps of the search."""


def localise(
    found: Differences,
    names: Sequence[str],
    scale: UnitVariance,
    *,
    alpha: float,
    method: LocalisationMethod,
) -> LocalisationResult:
    """Find the reference points that moved.

    Args:
        found: the differences of the epochs.
        names: the reference points.
        scale: variance of unit weight.
        alpha: probability of a false alarm of each test.
        method: how to search.

    Raises:
        InputError: an unknown method.
        DatumError: the points do not determine the open motions.
    """
    if method not in get_args(LocalisationMethod):
        raise InputError(f"unknown method {method!r}; valid: {known(get_args(LocalisationMethod))}")
    search = _Search(found, tuple(names), scale, alpha)
    if not search.testable(search.names):
        raise DatumError(
            f"{len(search.names)} reference points have no shape to test: take more of them",
            defect=motion_rank(found.motions),
        )
    first = search.test(search.names)
    steps = [LocalisationStep((), (), first)]
    if first.accepted:
        return LocalisationResult(search.names, tuple(steps))
    if method == "robust":
        stable = search.robust(steps)
    elif method == "combinations":
        stable = search.combined(steps)
    else:
        stable = search.backward(search.names, steps)
    return LocalisationResult(stable, tuple(steps))


class _Search:
    """The search for stable points among the reference points of two epochs."""

    def __init__(
        self, found: Differences, names: tuple[str, ...], scale: UnitVariance, alpha: float
    ) -> None:
        self.found, self.names, self.scale, self.alpha = found, names, scale, alpha
        self.k = len(found.axes)

    def _of(self, names: Sequence[str]) -> tuple[Array, Array, Array]:
        """Return d, W and G of some points alone."""
        rows = self.found.rows(names)
        g = motion_basis(self.found.motions[rows])
        w = weight_of_differences(self.found.cofactor[np.ix_(rows, rows)], g)
        return self.found.d[rows], w, g

    def test(self, names: Sequence[str]) -> HypothesisTest:
        """Return the congruence test of some points; no points have nothing to reject."""
        if not names:
            return self.scale.test(0.0, 0, self.alpha)
        d, w, g = self._of(names)
        h = len(d) - motion_rank(g)
        return self.scale.test(float(d @ w @ d), h, self.alpha)

    def testable(self, names: Sequence[str]) -> bool:
        """Return whether the shape of some points is overdetermined, and holds all motions.

        Where no motion is open, the datum of both epochs is left when all points have moved.
        """
        if not names:
            return motion_rank(self.found.motions) == 0
        g = self.found.motions[self.found.rows(names)]
        every = motion_rank(self.found.motions[self.found.rows(self.names)])
        return len(g) - motion_rank(g) > 0 and motion_rank(g) == every

    def backward(self, names: tuple[str, ...], steps: list[LocalisationStep]) -> tuple[str, ...]:
        """Take one point after the other, that with the largest test value."""
        while True:
            d, w, _ = self._of(names)
            gains = [
                displacement_of_rows(w, d, np.arange(i * self.k, (i + 1) * self.k))[2]
                if self.testable(names[:i] + names[i + 1 :])
                else -np.inf
                for i in range(len(names))
            ]
            worst = int(np.argmax(gains))
            if not np.isfinite(gains[worst]):
                return names
            left = names[worst]
            names = names[:worst] + names[worst + 1 :]
            test = self.test(names)
            steps.append(LocalisationStep((left,), (), test))
            if test.accepted:
                return names

    def combined(self, steps: list[LocalisationStep]) -> tuple[str, ...]:
        """Take the smallest set of points without which the others did not change their shape."""
        d, w, _ = self._of(self.names)
        n = len(self.names)
        for size in range(1, n + 1):
            if comb(n, size) > MAX_COMBINATIONS:
                return self.backward(self.names, steps)
            best: tuple[float, tuple[int, ...]] | None = None
            for some in combinations(range(n), size):
                rest = [m for i, m in enumerate(self.names) if i not in some]
                if not self.testable(rest):
                    continue
                rows = (np.array(some)[:, None] * self.k + np.arange(self.k)).ravel()
                gain = displacement_of_rows(w, d, rows)[2]
                if best is None or gain > best[0]:
                    best = gain, some
            if best is None:
                break
            left = tuple(self.names[i] for i in best[1])
            stable = tuple(m for m in self.names if m not in left)
            test = self.test(stable)
            if test.accepted:
                steps.append(LocalisationStep(left, (), test))
                return stable
        return self.backward(self.names, steps)

    def robust(self, steps: list[LocalisationStep]) -> tuple[str, ...]:
        """Take what the robust transformation tells, then let come back what fits."""
        moves, q = robust_differences(self.found, self.names)
        values = []
        for i in range(len(self.names)):
            rows = slice(i * self.k, (i + 1) * self.k)
            values.append(float(moves[rows] @ np.linalg.pinv(q[rows, rows]) @ moves[rows]))
        limit = self.k * self.scale.variance * self.scale.quantile(1.0 - self.alpha, self.k)
        order = np.argsort(values)[::-1]
        left: list[str] = []
        for i in order.tolist():
            rest = [n for n in self.names if n not in left and n != self.names[i]]
            if values[i] <= limit or not self.testable(rest):
                break
            left.append(self.names[i])
        stable = tuple(n for n in self.names if n not in left)
        test = self.test(stable)
        steps.append(LocalisationStep(tuple(left), (), test))
        if not test.accepted:
            return self.backward(stable, steps)
        for name in reversed(left):
            wider = tuple(n for n in self.names if n in stable or n == name)
            test = self.test(wider)
            if test.accepted:
                stable = wider
                steps.append(LocalisationStep((), (name,), test))
        return stable


def robust_differences(found: Differences, names: Sequence[str]) -> tuple[Array, Array]:
    """Return differences after the robust transformation, and their cofactors.

    The motions t of G minimise Σ |d_i − (G t)_i| over points i: t = (GᵀPG)⁻¹GᵀPd with the weights
    P = 1/(|d_i − (G t)_i| + ε), ε = 10⁻³ of the median σ.

    Args:
        found: the differences of two epochs.
        names: the points.
    """
    rows = found.rows(names)
    d, q, g = found.d[rows], found.cofactor[np.ix_(rows, rows)], motion_basis(found.motions[rows])
    if g.shape[1] == 0:
        return d, q
    k = len(found.axes)
    least = 1e-3 * float(np.sqrt(np.median(np.diag(q))))
    p = np.ones(len(d))
    moves = np.full(len(d), np.inf)
    s = np.eye(len(d))
    for _ in range(MAX_ROBUST_ITERATIONS):
        pg = p[:, None] * g
        s = np.eye(len(d)) - g @ np.linalg.solve(g.T @ pg, pg.T)
        new = s @ d
        size = np.linalg.norm(new.reshape(-1, k), axis=1)
        p = np.repeat(1.0 / (size + least), k)
        p /= p.max()
        change = float(np.abs(new - moves).max())
        moves = new
        if change < MIN_ROBUST_STEP_M:
            break
    return moves, s @ q @ s.T

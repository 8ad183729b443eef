"""Tests of points that may have moved: hypotheses on parts of d that no datum changes.

For differences d with cofactors Q and open motions G the weight

    W = Q̃⁻¹ − Q̃⁻¹G (GᵀQ̃⁻¹G)⁻¹GᵀQ̃⁻¹,  Q̃ = Q + c G Gᵀ,

does not depend on c, nor on the datum in which Q was computed: Q̃ is regular where Q lacks the
motions. Ω = dᵀ W d with h = rows − rank G degrees of freedom is the sum of squares by which the
two epochs differ in shape. Under the hypothesis that the points of the columns C moved,

    ∇ = (CᵀWC)⁻¹ CᵀW d,  Q_∇ = (CᵀWC)⁻¹,  T = ∇ᵀ(CᵀWC)∇,

where Ω − T is the Ω of the other points alone: the Gauss decomposition of Pelzer and Niemeier, and
the test of several gross errors in data snooping.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from ..errors import DatumError, InputError
from ..quality.distributions import chi2_quantile, fisher_quantile
from ..types import Array, Index

REGULAR = 1e-12
"""Ratio of the smallest to the largest eigenvalue of Q̃ below which d has no weight."""


def weight(q: Array, g: Array) -> Array:
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
    if values[0] < REGULAR * values[-1]:
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


def rank(g: Array) -> int:
    """Return the number of motions that move some points, (n, g)."""
    return int(np.linalg.matrix_rank(g, tol=1e-7)) if g.size else 0


def spanning(g: Array) -> Array:
    """Return an orthonormal basis of the motions of some points, (n, rank)."""
    if not g.size:
        return g[:, :0]
    u, s, _ = np.linalg.svd(g, full_matrices=False)
    return np.asarray(u[:, s > 1e-7])


def unheld(own: Array, others: Array) -> tuple[Array, Array]:
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
class Test:
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
class Scale:
    """Variance of unit weight of the tests."""

    variance: float
    """σ0² by which sums of squares are divided."""
    freedom: float
    """Degrees of freedom of σ0²; infinite where it is known."""

    def test(self, omega: float, h: int, alpha: float) -> Test:
        """Test a sum of squares of h degrees of freedom: T = Ω/(h σ0²).

        A hypothesis of no degree of freedom is never rejected.
        """
        if h == 0:
            return Test(0.0, float("inf"), (0, self.freedom), 1.0)
        value = omega / (h * self.variance)
        return Test(value, self.quantile(1.0 - alpha, h), (h, self.freedom), self.above(value, h))

    def quantile(self, p: float, h: int) -> float:
        """Return the quantile of T."""
        if np.isinf(self.freedom):
            return chi2_quantile(p, h) / h
        return fisher_quantile(p, h, self.freedom)

    def above(self, value: float, h: int) -> float:
        """Return the probability of a larger T."""
        from scipy.stats import chi2, f

        if np.isinf(self.freedom):
            return float(chi2.sf(value * h, h))
        return float(f.sf(value, h, self.freedom))

    def noncentrality(self, alpha: float, power: float, h: int) -> float:
        """Return λ for which a test with ``alpha`` rejects with the probability ``power``."""
        from scipy.optimize import brentq
        from scipy.stats import ncf, ncx2

        critical = self.quantile(1.0 - alpha, h)

        def missing(value: float) -> float:
            if np.isinf(self.freedom):
                return float(ncx2.sf(critical * h, h, value)) - power
            return float(ncf.sf(critical, h, self.freedom, value)) - power

        top = 10.0
        while missing(top) < 0:
            top *= 2.0
        return float(brentq(missing, 1e-9, top, xtol=1e-10))


def moved(w: Array, d: Array, columns: Index) -> tuple[Array, Array, float]:
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

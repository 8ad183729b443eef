"""A cause of misfits: size, unit, test and evidence, and whether people make such an error.

An error with q components makes vᵀPv smaller by T². Without an error

    T² / σ0² ~ χ²_q,                                      σ0 known,
    F = (T² / q) / ((vᵀPv − T²) / (r − q)) ~ F(q, r−q),   σ0 estimated, with the redundancy r.

vᵀPv − T² is what is left with the error as an unknown. It does not contain the error, where
T² r / vᵀPv does and cannot exceed r: a gross error hides itself there. The evidence of an error is
minus the logarithm of the probability that good readings make as much or more,

    −ln P(χ²_q > T² / σ0²)   or   −ln P(F(q, r−q) > F) = −ln I_x((r−q)/2, q/2),  x = 1 − T² / vᵀPv,

with the incomplete beta function I. Of two errors with as many components the difference of
evidence is nearly the logarithm of the ratio of their likelihoods, ½ ΔT² / σ0² or
(r − q)/2 · Δ ln(vᵀPv − T²). With r = q nothing is left that determines σ0, and there is no
evidence. With r = q + 1 one residual does: of two errors whose tests have a correlation of 0.9 or
0.99, the wrong one is ahead by `MIN_T2_DIFFERENCE` in 27 to 31 % of the cases in which one is
shown: there is none either.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csc_array
from scipy.special import betainc, betaln, gammaincc, gammaln, hyp2f1

from ...solve.solution import Solution
from ...statistical_tests import chi2_quantile, fisher_quantile
from ...types import Array
from ...units import ANGLE, FOOT, GON, significant
from .shared_error_tests import GivenValue
from .shared_errors import ErrorQuantity

MIN_FREEDOM_OF_SIGMA0 = 2
"""Smallest number of degrees of freedom with which an estimate of σ0 may show an error."""
ROUNDING_VTPV_SHARE = 1e-10
"""Share of vᵀPv below which what is left of it is rounding."""
MAX_USUAL_HEIGHT_M = 3.0
"""Height, metres, above which the recorded height of an instrument or a target may be wrong by as
much as itself: it is stated in another unit, or belongs to something else."""
USUAL_HEIGHT_M = 1.5
"""Usual height of an instrument or a target, metres."""
MAX_PLAUSIBLE_ERRORS: dict[ErrorQuantity, float] = {
    "length": 2.5,
    "angle": GON,
    "turn": np.inf,
    "ppm": 1e4,
    "ratio": np.inf,
    "image": np.inf,
    "number": np.inf,
    "curvature": 3.0,
}
"""Largest error, SI, that heights, constants and centring have in the field: 2.5 m (the height of a
target that is forgotten, or counted twice), a gon, one percent. Where an error would have to be
larger, readings belong to something else."""
HEIGHT_UNITS = {"centimetres": 100.0, "millimetres": 1000.0, "feet": 1.0 / FOOT}
"""Units in which a height may have been recorded in place of metres, by what a metre is in them."""
_QUANTITY_UNITS: dict[ErrorQuantity, tuple[float, str]] = {
    "length": (1e-3, "mm"),
    "angle": (ANGLE["mgon"], "mgon"),
    "turn": (ANGLE["mgon"], "mgon"),
    "ppm": (1.0, "ppm"),
    "ratio": (0.01, "%"),
    "image": (1.0, ""),
    "number": (1.0, ""),
    "curvature": (1.0, ""),
}
MOST_COMPONENTS_NAMED = 20
"""Largest number of components that a cause names; rational polynomials have about a hundred, which
the table of given values lists."""


@dataclass(frozen=True)
class VarianceFactor:
    """The variance σ0² of unit weight by which T² is judged."""

    variance: float = 1.0
    """σ0², or its estimate."""
    freedom: float = np.inf
    """Degrees of freedom of the estimate; infinite where σ0 is known, 0 where there are fewer than
    `MIN_FREEDOM_OF_SIGMA0`: there is no test."""

    @classmethod
    def left_by(
        cls, solution: Solution, *, estimated: bool, t2: float = 0.0, dof: int = 0
    ) -> VarianceFactor:
        """Return the variance with an error as an unknown.

        Args:
            solution: the adjustment without the error as an unknown.
            estimated: whether σ0 is estimated; otherwise it is 1.
            t2: T² of the error, σ0 = 1.
            dof: number of its components q.
        """
        if not estimated:
            return cls()
        freedom = solution.redundancy - dof
        if freedom < MIN_FREEDOM_OF_SIGMA0 or not solution.vtpv > 0.0:
            return cls(np.inf, 0.0)
        return cls(max(solution.vtpv - t2, ROUNDING_VTPV_SHARE * solution.vtpv) / freedom, freedom)

    def limit(self, dof: int, alpha: float) -> float:
        """Return T², σ0 = 1, that good readings exceed with probability alpha; 0: no test."""
        return self.variance * self.critical(dof, alpha) if self.freedom > 0 else 0.0

    def critical(self, dof: int, alpha: float) -> float:
        """Return T² / σ0² that good readings exceed with probability alpha; infinite: no test."""
        if self.freedom <= 0:
            return np.inf
        if np.isinf(self.freedom):
            return chi2_quantile(1.0 - alpha, dof)
        return dof * fisher_quantile(1.0 - alpha, dof, self.freedom)


def evidence(t2: float, dof: int, freedom: float = np.inf) -> float:
    """Return −ln P(χ² > T²), or −ln P(F > T² / q), without an error.

    Where the probability underflows, its expansion takes its place.

    Args:
        t2: T² / σ0², of an estimated σ0 the estimate without the error.
        dof: degrees of freedom q of T².
        freedom: degrees of freedom of the estimate of σ0.
    """
    if freedom <= 0:
        return 0.0
    half = 0.5 * dof
    if np.isinf(freedom):
        found = float(gammaincc(half, 0.5 * t2))
        first = gammaln(half) + 0.5 * t2 - (half - 1.0) * np.log(max(0.5 * t2, 1.0))
    else:
        a, x = 0.5 * freedom, freedom / (freedom + t2)
        found = float(betainc(a, half, x))
        first = np.log(a) + betaln(a, half) - a * np.log(x)
        first -= np.log(hyp2f1(a, 1.0 - half, a + 1.0, x)) if x < 1.0 else 0.0
    return -float(np.log(found)) if found > 0.0 else float(first)


def three_digits(value: float) -> str:
    """Return a number with three significant digits, or as a whole number."""
    return significant(value, 3)


@dataclass(frozen=True, eq=False)
class Cause:
    """A cause that explains misfits."""

    cause: str
    """What is wrong: ``the height of the instrument``."""
    where: str
    """The place, and of an exchange what is right: ``at 'S3' (1.454 m)``."""
    components: tuple[str, ...]
    """Names of the components of its size, (q,); empty for a single one, and for an exchange."""
    sizes: tuple[ErrorQuantity, ...]
    """Quantity of each component, (q,)."""
    error: Array
    """Estimated error, recorded − true, (q,): metres, radians, image units or ppm; empty for an
    exchange."""
    sigma: Array
    """Its standard deviations, with the σ0 of T², (q,)."""
    t2: float
    """T² / σ0²: by how much less vᵀPv would be with it as an unknown, or after the exchange. An
    estimated σ0 is that of the adjustment with it as an unknown."""
    dof: int
    """Degrees of freedom of T²."""
    critical: float
    """Critical value of T²."""
    ids: tuple[str, ...]
    """Ids of the observations that share it."""
    rank: int = 0
    """Place among causes that explain as much: what one set-up makes comes first."""
    given: GivenValue | None = None
    """The held value that is wrong; None for other causes."""
    same: tuple[str, ...] = ()
    """Other places of an exchange, after which all readings would fit as well."""
    freedom: float = np.inf
    """Degrees of freedom of an estimated σ0; infinite where it is known."""
    recorded: float = np.nan
    """Height that was recorded, metres; NaN for other causes."""
    columns: csc_array | None = field(default=None, repr=False)
    """C of readings that share it, (n_rows, q); None for other causes."""

    def __str__(self) -> str:
        """Return the cause, its size and its test, in millimetres and milligons."""
        return self.said(_QUANTITY_UNITS.__getitem__, three_digits)

    def said(
        self,
        unit: Callable[[ErrorQuantity], tuple[float, str]],
        figure: Callable[[float], str],
        *,
        space: str = " ",
    ) -> str:
        """Return the cause, its size and its test as a sentence without a stop.

        Args:
            unit: returns the unit of a size, SI, and its name.
            figure: writes a number.
            space: what divides numbers and units.
        """
        sizes = []
        for name, size, error, sigma, alone in self.estimates:
            one, symbol = unit(size)
            parts = (name, figure(error / one), "±", figure(sigma / one), symbol)
            sizes.append(space.join(p for p in parts if p) + (" if it alone is wrong" * alone))
        test = f"T² {figure(self.t2)}"
        if self.sizes:
            test += f", {self.dof} degree{'s' * (self.dof != 1)} of freedom, critical "
            test += f"{self.critical:.1f}"
        text = f"{self.cause} {self.where}{self.hint}"
        if self.same:
            text += f", or {', or '.join(self.same)}: the observations do not determine which"
        return (f"{text}: {', '.join(sizes)}" if sizes else text) + f" ({test})"

    @property
    def estimates(self) -> Iterator[tuple[str, ErrorQuantity, float, float, bool]]:
        """Name, quantity, error and σ of each component that the residuals determine.

        Of components of a given value that they determine only jointly, each is estimated as if it
        alone were wrong, which the last element says. There are none of more components than
        `MOST_COMPONENTS_NAMED`.
        """
        if len(self.components) > MOST_COMPONENTS_NAMED:
            return
        named = zip(self.components or ("",), self.sizes, self.error, self.sigma, strict=False)
        for i, (name, size, error, sigma) in enumerate(named):
            if np.isfinite(error):
                yield name, size, float(error), float(sigma), False
            elif self.given is not None and (one := self.given.apart[i]).dof:
                scale = np.sqrt(self.given.together.t2 / self.t2)
                yield name, size, float(one.error[0]), float(one.sigma[0] * scale), True

    @property
    def plausible(self) -> bool:
        """Whether an error of this size is one that people make, see `MAX_PLAUSIBLE_ERRORS`."""
        limits = np.array([MAX_PLAUSIBLE_ERRORS[size] for size in self.sizes])
        return not np.any(np.abs(self.error) > limits) or self.other_unit

    @property
    def other_unit(self) -> bool:
        """Whether a recorded height is wrong by about itself, and larger than a usual one.

        An error of that size bends an adjustment, so that its estimate is right by the order alone.
        """
        high = abs(self.recorded) > MAX_USUAL_HEIGHT_M
        return high and bool(np.all(np.abs(np.log2(np.abs(self.error / self.recorded))) < 1.0))

    @property
    def hint(self) -> str:
        """The unit in which a recorded height would be a usual one; empty for other causes."""
        if not self.other_unit:
            return ""
        heights = {unit: abs(self.recorded) / f for unit, f in HEIGHT_UNITS.items()}
        unit = min(heights, key=lambda u: abs(np.log(heights[u] / USUAL_HEIGHT_M)))
        if abs(np.log(heights[unit] / USUAL_HEIGHT_M)) > np.log(10.0):
            return ""
        return f", which is {heights[unit]:.4g} m if it was recorded in {unit}"

    @property
    def possible(self) -> bool:
        """Whether it may be a likely cause: a given value of any size may have been mistyped."""
        return self.given is not None or self.plausible

    @property
    def evidence(self) -> float:
        """−ln of the probability of so large a T² without an error, see `evidence`.

        It compares causes of different numbers of unknowns.
        """
        return evidence(self.t2, self.dof, self.freedom)

    @property
    def likelihood(self) -> float:
        """Evidence as if T² were of one unknown.

        Of two causes it differs by nearly the logarithm of the ratio of their likelihoods, whatever
        their numbers of unknowns: of those that are the same to all readings, by nothing.
        """
        return evidence(self.t2, 1, self.freedom)

"""Positional accuracy at check points: ASPRS edition 2 (2023/24) and NSSDA (FGDC 1998).

With differences d = product − check point of n check points,

    RMSE_x = √(Σ d_x² / n)                  no mean removed (FGDC-STD-007.3-1998, 3.2.1)
    mean, s = √(Σ (d − mean)² / (n − 1)), skewness, kurtosis of each axis

ASPRS Positional Accuracy Standards, edition 2 (2023, version 2 of 2024), section 7.11 and annex D:
the survey error of the check points counts,

    RMSE_H1² = RMSE_x² + RMSE_y²            fit to the check points
    RMSE_H²  = RMSE_H1² + RMSE_H2²          H2: survey error of the check points, √(σ_x² + σ_y²)
    RMSE_V²  = RMSE_V1² + RMSE_V2²
    RMSE_3D² = RMSE_H² + RMSE_V²

NSSDA (FGDC 1998), accuracy at 95 %, of the fit alone:

    Accuracy_r = 2.4477 (RMSE_x + RMSE_y) / 2   where 0.6 ≤ RMSE_min / RMSE_max ≤ 1
    Accuracy_z = 1.9600 RMSE_z

For a smaller ratio, for which NSSDA states no formula, the radius r is that of 95 % of two normal
errors without correlation, P(d_x² + d_y² ≤ r²) = 0.95.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from ..errors import InputError, Problem, refuse_other_types
from ..quality.point_precision import CheckPoints, check_points
from ..result_display import Rows, Shown
from ..solve.solution import Solution
from ..types import Array

MIN_CHECK_POINTS_ASPRS = 30
"""Least number of check points of ASPRS edition 2, section 7.12 and annex C.2."""
MAX_CHECK_POINTS_ASPRS = 120
"""Number of check points of ASPRS edition 2 for the largest areas."""
AREA_OF_FEWEST_KM2, AREA_STEP_KM2, CHECK_POINTS_OF_STEP = 1000.0, 1000.0, 10
"""Area up to which the least number is enough, km², and how many points each further step adds."""
MIN_CHECK_POINTS_NSSDA = 20
"""Least number of check points of NSSDA."""
CIRCULAR_95, LINEAR_95 = 2.4477, 1.9600
"""Factors of NSSDA to 95 %: √(−2 ln 0.05), and that of one normal error."""
MIN_CIRCULAR_RATIO = 0.6
"""Least ratio RMSE_min / RMSE_max of the circular approximation of NSSDA."""
ANGLES, BISECTIONS = 4000, 60
"""Numbers of angles of the mean, and of halvings of the radius of 95 %."""
ASPRS, NSSDA = "ASPRS edition 2", "NSSDA"
"""Names of the standards in messages."""
SurveyDirection: TypeAlias = Literal["horizontal", "vertical"]
"""Direction of a survey error."""
LEAST_SURVEY_RATIO = 2.0
"""Check points are to be this many times more accurate than the product (ASPRS edition 2, 7.11)."""


@dataclass(frozen=True, repr=False)
class PositionalAccuracy(Shown):
    """Accuracy at check points, metres; NaN where no coordinate of an axis is known."""

    names: tuple[str, ...]
    """Names of the check points, n."""
    differences: Array
    """Product − check point, (n, 3); NaN where unknown."""
    counts: tuple[int, int, int]
    """Number of known coordinates of each axis."""
    mean: Array
    """Mean difference of each axis, (3,)."""
    standard_deviation: Array
    """s of each axis with n − 1, (3,)."""
    skewness: Array
    """Bias-corrected skewness of each axis, (3,)."""
    kurtosis: Array
    """Bias-corrected excess kurtosis of each axis, (3,)."""
    rmse: Array
    """RMSE of each axis with n, (3,)."""
    survey: tuple[float, float]
    """RMSE_H2 and RMSE_V2: horizontal and vertical survey error of the check points."""
    percentile_95: float
    """95th percentile of |d_z|, interpolated at rank 0.95 (n − 1) + 1: vegetated vertical accuracy
    of ASPRS edition 1."""

    @property
    def rmse_fit(self) -> tuple[float, float]:
        """RMSE_H1 and RMSE_V1: of the fit to the check points alone."""
        return math.hypot(self.rmse[0], self.rmse[1]), float(self.rmse[2])

    @property
    def rmse_horizontal(self) -> float:
        """RMSE_H of ASPRS edition 2."""
        return math.hypot(self.rmse_fit[0], self.survey[0])

    @property
    def rmse_vertical(self) -> float:
        """RMSE_V of ASPRS edition 2."""
        return math.hypot(self.rmse_fit[1], self.survey[1])

    @property
    def rmse_3d(self) -> float:
        """RMSE_3D of ASPRS edition 2."""
        return math.hypot(self.rmse_horizontal, self.rmse_vertical)

    @property
    def nssda(self) -> tuple[float, float]:
        """Accuracy_r and Accuracy_z of NSSDA, 95 %."""
        return circular_95(self.rmse[0], self.rmse[1]), LINEAR_95 * float(self.rmse[2])

    @property
    def number(self) -> int:
        """Number of check points: the least number of known coordinates of an axis that has any."""
        return min((c for c in self.counts if c), default=0)

    def shortfalls(self, area_km2: float | None = None) -> tuple[tuple[str, int], ...]:
        """Return the standards that ask for more check points, and how many they ask for.

        Args:
            area_km2: area of the project, by which ASPRS states the number of check points; None:
                the least number.
        """
        asked = (ASPRS, check_points_needed(area_km2)), (NSSDA, MIN_CHECK_POINTS_NSSDA)
        return tuple((name, least) for name, least in asked if self.number < least)

    @property
    def coarse_surveys(self) -> tuple[tuple[SurveyDirection, float, float], ...]:
        """Directions in which the survey error is more than half of the RMSE, with both, metres."""
        both: tuple[tuple[SurveyDirection, float, float], ...] = (
            ("horizontal", self.survey[0], self.rmse_horizontal),
            ("vertical", self.survey[1], self.rmse_vertical),
        )
        return tuple(x for x in both if x[1] > 0 and x[1] * LEAST_SURVEY_RATIO > x[2])

    def remarks(self, area_km2: float | None = None) -> tuple[str, ...]:
        """Return what the standards ask for and these check points lack, as sentences.

        Args:
            area_km2: as for `shortfalls`.
        """
        out = [
            f"{self.number} check points are fewer than the {least} of {name}"
            for name, least in self.shortfalls(area_km2)
        ]
        if self.survey == (0.0, 0.0):
            out.append("the survey error of the check points is not stated: it counts as 0")
        out += [
            f"the {what} survey error of the check points, {own:.4g} m, is more than half "
            f"of the {what} RMSE, {total:.4g} m"
            for what, own, total in self.coarse_surveys
        ]
        return tuple(out)

    def statement(self) -> str:
        """Return the statements of accuracy of ASPRS edition 2 and NSSDA, lines of text."""
        n = self.number
        r, z = self.nssda
        sentences = [
            f"Tested with {n} check points, survey errors {self.survey[0]:.3f} m horizontal and "
            f"{self.survey[1]:.3f} m vertical (ASPRS Positional Accuracy Standards, edition 2):",
            f"  RMSE_H {self.rmse_horizontal:.4f} m, RMSE_V {self.rmse_vertical:.4f} m, "
            f"RMSE_3D {self.rmse_3d:.4f} m",
            f"Tested {r:.4f} m horizontal accuracy at 95 % confidence level, {z:.4f} m vertical "
            "(NSSDA)",
        ]
        return "\n".join([*sentences, *(f"  note: {remark}" for remark in self.remarks())])

    def headline(self) -> str:
        """Return the RMSE of ASPRS edition 2."""
        return (
            f"PositionalAccuracy: {len(self.names)} check points, RMSE_H "
            f"{self.rmse_horizontal:.4g} m, RMSE_V {self.rmse_vertical:.4g} m"
        )

    def first_rows(self) -> Rows:
        """Return the figures of each axis, metres."""
        figures = (
            ("number", self.counts),
            ("mean", self.mean),
            ("s", self.standard_deviation),
            ("RMSE", self.rmse),
            ("skewness", self.skewness),
            ("kurtosis", self.kurtosis),
        )
        return Rows(
            ("figure", "x", "y", "z"),
            [(name, *map(float, values)) for name, values in figures],
            len(figures),
        )


def positional_accuracy(
    found: Solution | CheckPoints | Array,
    *,
    survey: float | tuple[float, float] = 0.0,
    names: Sequence[str] | None = None,
) -> PositionalAccuracy:
    """Return the accuracy at check points by ASPRS edition 2 and NSSDA.

    With differences d = product − check point of n check points::

        RMSE_x = √(Σ d_x² / n)                      no mean removed; RMSE_y, RMSE_z likewise
        RMSE_H = √(RMSE_x² + RMSE_y² + RMSE_H2²)    ASPRS
        RMSE_V = √(RMSE_z² + RMSE_V2²)              ASPRS
        RMSE_3D = √(RMSE_H² + RMSE_V²)              ASPRS
        Accuracy_r = 2.4477 (RMSE_x + RMSE_y) / 2   NSSDA, 95 %, without the survey error
        Accuracy_z = 1.9600 RMSE_z                  NSSDA, 95 %, without the survey error

    where RMSE_H2 and RMSE_V2 are the survey error of the check points. If the smaller one of RMSE_x
    and RMSE_y is less than 0.6 of the larger one, Accuracy_r is the radius that has 95 % of two
    normal errors without correlation.

    Args:
        found: an adjustment whose points have ``check`` coordinates, its check points, of which
            both are compared along east, north and up at each point; or differences product −
            check point, (n, 3) metres, NaN where one is not known.
        survey: σ of the survey of the check points, metres: horizontal RMSE_H2 and vertical
            RMSE_V2; one number counts for each of the three axes, RMSE_H2 is then √2 of it. 0
            means that it is not stated.
        names: names of the check points, where ``found`` has none.

    Raises:
        InputError: there is no check point, a difference is infinite, or σ is negative.
    """
    if isinstance(found, list | tuple):
        found = np.asarray(found, dtype=float)
    refuse_other_types(found, Solution | CheckPoints | np.ndarray, "positional_accuracy")
    if isinstance(found, Solution):
        found = check_points(found)
    if isinstance(found, CheckPoints):
        names, d = found.names, found.east_north_up
    else:
        d = np.asarray(found, dtype=float)
    problems = []
    if d.ndim != 2 or d.shape[1] != 3:
        problems.append(Problem(f"differences must be (n, 3), not {d.shape}"))
    elif not np.isfinite(d).any():
        what = "no coordinate of a check point is known; valid: check of points (check_x …)"
        problems.append(Problem(what))
    elif np.isinf(d).any():
        problems.append(Problem("a difference is infinite"))
    own = (math.sqrt(2) * survey, survey) if isinstance(survey, int | float) else tuple(survey)
    if len(own) != 2 or not all(math.isfinite(s) and s >= 0 for s in own):
        what = f"survey must be σ ≥ 0, or horizontal and vertical σ, metres, not {survey!r}"
        problems.append(Problem(what))
    if problems:
        raise InputError(problems)
    known = [d[np.isfinite(d[:, i]), i] for i in range(3)]
    z = np.abs(known[2])
    return PositionalAccuracy(
        tuple(names or (str(i + 1) for i in range(len(d)))),
        d,
        (len(known[0]), len(known[1]), len(known[2])),
        _of_axes(known, lambda v: float(np.mean(v)), 1),
        _of_axes(known, lambda v: float(np.std(v, ddof=1)), 2),
        _of_axes(known, _skewness, 3),
        _of_axes(known, _kurtosis, 4),
        _of_axes(known, lambda v: math.sqrt(np.mean(v**2)), 1),
        (float(own[0]), float(own[1])),
        float(np.percentile(z, 95)) if len(z) else math.nan,
    )


def _of_axes(known: Sequence[Array], figure: Callable[[Array], float], least: int) -> Array:
    """Return a figure of each axis that has the least number of differences, otherwise NaN."""
    return np.array([figure(v) if len(v) >= least else math.nan for v in known])


def _skewness(v: Array) -> float:
    """Return √(n (n − 1)) / (n − 2) · m₃ / m₂^1.5 with central moments m; 0 of equal values."""
    n, m2, m3 = len(v), *(float(np.mean((v - v.mean()) ** k)) for k in (2, 3))
    return math.sqrt(n * (n - 1)) / (n - 2) * m3 / m2**1.5 if m2 > 0 else 0.0


def _kurtosis(v: Array) -> float:
    """Return (n − 1) / ((n − 2)(n − 3)) · ((n + 1) m₄/m₂² − 3 (n − 1)); 0 of equal values."""
    n, m2, m4 = len(v), *(float(np.mean((v - v.mean()) ** k)) for k in (2, 4))
    if m2 == 0:
        return 0.0
    return (n - 1) / ((n - 2) * (n - 3)) * ((n + 1) * m4 / m2**2 - 3 * (n - 1))


def check_points_needed(area_km2: float | None = None) -> int:
    """Return the number of check points of ASPRS edition 2, annex C.2, for an area in km²."""
    if area_km2 is None or area_km2 <= AREA_OF_FEWEST_KM2:
        return MIN_CHECK_POINTS_ASPRS
    steps = math.ceil((area_km2 - AREA_OF_FEWEST_KM2) / AREA_STEP_KM2)
    return min(MIN_CHECK_POINTS_ASPRS + CHECK_POINTS_OF_STEP * steps, MAX_CHECK_POINTS_ASPRS)


def circular_95(rmse_x: float, rmse_y: float) -> float:
    """Return the horizontal accuracy at 95 % of NSSDA, see the module; NaN for a NaN."""
    small, large = sorted((abs(float(rmse_x)), abs(float(rmse_y))))
    if math.isnan(small) or math.isnan(large) or large == 0.0:
        return math.nan if large != 0.0 else 0.0
    if small >= MIN_CIRCULAR_RATIO * large:
        return CIRCULAR_95 * 0.5 * (small + large)
    return large * _radius_of_95(small / large)


def _radius_of_95(ratio: float) -> float:
    """Return r of P(u² + q² w² ≤ r²) = 0.95 for standard normal u, w and a ratio q < 1.

    In polar coordinates of (u, w), P(r) = 1 − mean over φ of exp(−r² / 2 (cos² φ + q² sin² φ)).
    """
    phi = (np.arange(ANGLES) + 0.5) * (np.pi / 2 / ANGLES)
    size = np.cos(phi) ** 2 + (ratio * np.sin(phi)) ** 2
    low, high = 1.0, 3.0
    for _ in range(BISECTIONS):
        middle = (low + high) / 2.0
        outside = np.mean(np.exp(-(middle**2) / 2.0 / size))
        low, high = (middle, high) if outside > 0.05 else (low, middle)
    return (low + high) / 2.0

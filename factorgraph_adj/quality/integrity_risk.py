"""Integrity risk: probability that an error is large and no test rejects, at the worst fault.

In a linear model the error of a function of the unknowns, e = b + ε with ε ~ N(0, σ²), and the
residuals are independent, because AᵀP v = 0 for every v. With a fault (gross errors of any sizes)

    P(|e| > L, no test rejects) = P(|b + ε| > L) · P(no test rejects).

Let λ be the largest noncentrality √(nᵀM_kn) that the fault n gives any test k. No test rejects with
a probability of at most that of this one test,

    h(λ) = P(χ'²_d(λ²) ≤ χ²_d,1−α),          d = 1: h(λ) = Φ(c − λ) − Φ(−c − λ),

and the largest bias is |b| ≤ G λ with the slope G of the kind of fault, see
`factorgraph_adj.quality.fault_modes`. P(|b + ε| > L) grows with |b|. So for all sizes at once

    P(|e| > L, no test rejects) ≤ max_λ h(λ) [Φ((Gλ − L)/σ) + Φ((−Gλ − L)/σ)],

and the protection level is the smallest L at which the right side is at most the risk. It is the
largest quantile of |Gλ + ε| for the tail τ = risk/h(λ), over all λ with h(λ) ≥ risk. A quantile of
a folded normal distribution is convex in its mean (Prékopa: P(|β + ε| ≤ L) is log-concave in β and
L together), and so is the level in G: linear interpolation between nodes is an upper bound.

A vector of two or three coordinates has |e| ≤ G λ + |ε|, so that its level is
max_λ Gλ + (quantile of |ε| for the tail risk/h(λ)).

The h of tests with more degrees of freedom is the larger one (Das Gupta & Perlman 1974), so that
the h of the largest d is valid for all tests. Brown & Chin (1998) and Teunissen (2018) have the
same product for one fault; Blanch, Walter, Enge et al. (2015) for several.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import special

from ..statistical_tests import chi2_quantile
from ..types import Array

TAIL_NODES = 1200
"""Number of tails τ at which a level is sought; between them the largest value is interpolated."""
LARGEST_TAIL_QUANTILE = 8.0
"""Quantile Φ⁻¹(τ) of the largest tail; beyond it τ is 1 to 15 digits."""
SLOPE_NODES = 400
"""Number of slopes at which a level is computed."""
SLOPES = (1e-3, 1e7)
"""Smallest and largest of these slopes above 0, relative to σ. Larger ones are extrapolated: the
level is a straight line there."""
NEWTON_STEPS = 60
"""Largest number of steps to a quantile."""
SHAPES = 16
"""Number of steps in which the ratio of two axes of an error ellipsoid is rounded up."""
LONGEST = 17.0
"""Longest vector whose probability is computed, relative to σ along its longest axis."""
SMALLEST_RISK = 1e-60
"""Smallest risk of which a level is computed: `LONGEST` and the laws of tests reach no farther."""
TAIL_ACCURACY = 1e-12
"""Accuracy of a tail whose quantile is computed, relative to it."""
LENGTHS = 1700
"""Number of lengths between which quantiles of lengths are interpolated."""
DIRECTIONS = 24
"""Number of directions over a quarter of an ellipse, or over an octant in each of two angles."""


def missed_detection(noncentrality: Array, alpha: float, dof: int = 1) -> Array:
    """Return h(λ), the probability that a test does not reject.

    Args:
        noncentrality: λ ≥ 0, of any shape.
        alpha: probability α0 of a false alarm.
        dof: degrees of freedom of the test.
    """
    critical = chi2_quantile(1.0 - alpha, dof)
    if dof == 1:
        c = np.sqrt(critical)
        below = special.ndtr(c - noncentrality)
        return np.asarray(below - special.ndtr(-c - noncentrality))
    return np.asarray(special.chndtr(critical, dof, np.square(noncentrality)))


@lru_cache(maxsize=64)
def hidden_noncentralities(risk: float, alpha: float, dof: int = 1) -> tuple[Array, Array]:
    """Return tails τ and the λ with h(λ) = risk/τ, the largest tail last, (n,) each.

    The first tail has λ = 0. A risk that h(0) = 1 − α does not reach gives empty arrays: then
    every level holds.
    """
    first = risk / (1.0 - alpha)
    if not first < special.ndtr(LARGEST_TAIL_QUANTILE):
        return np.zeros(0), np.zeros(0)
    # λ rises like a root from the first tail: nodes are dense there.
    begin, share = special.ndtri(first), np.linspace(0.0, 1.0, TAIL_NODES) ** 2
    tail = special.ndtr(begin + (LARGEST_TAIL_QUANTILE - begin) * share)
    tail[0] = first
    low, high = np.zeros(len(tail)), np.full(len(tail), 100.0)
    for _ in range(100):
        middle = 0.5 * (low + high)
        seen = missed_detection(middle, alpha, dof) < risk / tail
        low, high = np.where(seen, low, middle), np.where(seen, middle, high)
    high[0] = 0.0
    return tail, high  # from above, as larger λ are safe


def folded_quantile(mean: Array, tail: Array) -> Array:
    """Return ℓ with P(|β + ε| > ℓ) = τ for ε ~ N(0, 1), from means β ≥ 0 and tails τ."""
    out = mean - special.ndtri(tail)  # only one side of the tail: too small
    out = np.maximum(out, 0.0)
    for _ in range(NEWTON_STEPS):
        excess = special.ndtr(mean - out) + special.ndtr(-mean - out) - tail
        slope = np.exp(-0.5 * (mean - out) ** 2) + np.exp(-0.5 * (mean + out) ** 2)
        step = excess * np.sqrt(2.0 * np.pi) / np.maximum(slope, 1e-300)
        step = np.clip(step, -1.0, 1.0)
        step = np.where(np.abs(excess) > TAIL_ACCURACY * tail, step, 0.0)
        out = np.maximum(out + step, 0.0)
        if not np.any(np.abs(step) > 1e-10):
            break
    return np.asarray(out)


@lru_cache(maxsize=64)
def _level_nodes(risk: float, alpha: float, dof: int) -> tuple[Array, Array]:
    """Return slopes, relative to σ, and their levels, relative to σ."""
    slopes = np.append(0.0, np.geomspace(*SLOPES, SLOPE_NODES))
    tail, hidden = hidden_noncentralities(risk, alpha, dof)
    if not len(tail):
        return slopes, np.zeros(len(slopes))
    levels = [_largest(folded_quantile(s * hidden, tail)) for s in slopes.tolist()]
    return slopes, np.array(levels)


def _largest(values: Array) -> float:
    """Return the largest of equidistant values (n,) with that of the parabola through it."""
    at = int(np.argmax(values))
    if not 0 < at < len(values) - 1:
        return float(values[at])
    before, here, after = values[at - 1 : at + 2].tolist()
    bend = 2.0 * here - before - after
    return float(here + (0.125 * (after - before) ** 2 / bend if bend > 0.0 else 0.0))


def protection_level(
    sigma: Array, slope: Array, risk: float, alpha: float, *, dof: int = 1
) -> Array:
    """Return the levels L of single coordinates, in the units of σ.

    Args:
        sigma: standard deviations, (n,); 0: the coordinate is held, and its level is 0.
        slope: slopes G, largest bias for each unit of λ, (n,); infinite ones give infinite levels.
        risk: risk that L keeps whatever the size of the fault; below `SMALLEST_RISK` levels are
            infinite.
        alpha: probability α0 of a false alarm of one test.
        dof: largest degrees of freedom of a test.
    """
    moving = sigma > 0.0
    if risk < SMALLEST_RISK:
        return np.where(moving, np.inf, 0.0)
    nodes, levels = _level_nodes(risk, alpha, dof)
    if not levels[-1]:  # no test rejects less often than the risk allows: every level holds
        return np.zeros(len(sigma))
    ratio = np.where(moving, slope, 0.0) / np.where(moving, sigma, 1.0)
    with np.errstate(invalid="ignore"):
        at = np.interp(ratio, nodes, levels)
        beyond = levels[-1] + (ratio - nodes[-1]) * levels[-1] / nodes[-1]
    out = np.where(ratio > nodes[-1], beyond, at) * sigma
    return np.where(moving, out, 0.0)


def risk_at(level: Array, sigma: Array, slope: Array, alpha: float, *, dof: int = 1) -> Array:
    """Return max_λ P(|e| > L, no test rejects) for levels L, the inverse of `protection_level`.

    Args:
        level: L, (n,).
        sigma: standard deviations > 0, (n,).
        slope: slopes G, (n,).
        alpha: probability α0 of a false alarm of one test.
        dof: largest degrees of freedom of a test.
    """
    size = np.linspace(0.0, 20.0 + dof, 4000)
    hidden = missed_detection(size, alpha, dof)
    out = np.empty(len(level))
    for i, (one, s, g) in enumerate(
        zip(level.tolist(), sigma.tolist(), slope.tolist(), strict=True)
    ):
        mean = g * size / s
        out[i] = np.max(hidden * (special.ndtr(mean - one / s) + special.ndtr(-mean - one / s)))
    return out


def vector_level(axes: Array, slope: Array, risk: float, alpha: float, *, dof: int = 1) -> Array:
    """Return the levels of lengths of vectors, such as horizontal errors, (n,).

    Args:
        axes: standard deviations along the principal axes, (n, k), k = 2 or 3, in any order.
        slope: slopes G, largest length of the bias for each unit of λ, (n,).
        risk: as for `protection_level`.
        alpha: as there.
        dof: as there.
    """
    ordered = np.sort(axes, axis=1)[:, ::-1]
    largest = ordered[:, 0]
    if risk < SMALLEST_RISK:
        return np.where(largest > 0.0, np.inf, 0.0)
    tail, hidden = hidden_noncentralities(risk, alpha, dof)
    out = np.zeros(len(axes))
    if not len(tail):
        return out
    safe = np.where(largest > 0.0, largest, 1.0)
    shapes = np.ceil(np.round(SHAPES * ordered[:, 1:] / safe[:, None], 9)).astype(int)
    for shape in np.unique(shapes, axis=0).tolist():
        quantiles = length_quantiles(tuple(shape), risk, alpha, dof)
        for i in np.flatnonzero((shapes == shape).all(axis=1) & (largest > 0.0)).tolist():
            if not np.isfinite(slope[i]):
                out[i] = np.inf
            else:
                out[i] = _largest(slope[i] * hidden + largest[i] * quantiles)
    return out


@lru_cache(maxsize=512)
def length_quantiles(shape: tuple[int, ...], risk: float, alpha: float, dof: int) -> Array:
    """Return the quantiles of |ε| for all tails of `hidden_noncentralities`, (n,).

    Args:
        shape: ratios of the other axes to the largest, in steps of 1/`SHAPES`.
        risk: as for `protection_level`.
        alpha: as there.
        dof: as there.
    """
    tail, _ = hidden_noncentralities(risk, alpha, dof)
    axes = np.append(1.0, np.array(shape) / SHAPES)
    length = np.linspace(0.0, LONGEST, LENGTHS)
    beyond = special.ndtri(np.clip(length_tail(length, axes), 1e-300, 1.0 - 1e-16))
    return np.interp(-special.ndtri(tail), -beyond, length)


def length_tail(length: Array, axes: Array) -> Array:
    """Return P(|ε| > t) of lengths t (n,), ε normal with standard deviations ``axes`` (k,).

    In the plane it is the mean over all directions φ of exp(−t²/2s²), s² = a²cos²φ + b²sin²φ, in
    space that over the sphere of the tail of χ_3 at t/s.
    """
    angle, weight = np.polynomial.legendre.leggauss(DIRECTIONS)
    angle, weight = 0.25 * np.pi * (angle + 1.0), 0.5 * weight
    c, s = np.cos(angle) ** 2, np.sin(angle) ** 2
    if len(axes) == 2:
        spread = axes[0] ** 2 * c + axes[1] ** 2 * s
        return np.asarray(np.exp(-0.5 * length[:, None] ** 2 / spread) @ weight)
    # Equal parts of the sphere have equal heights along the last axis.
    height, part = np.polynomial.legendre.leggauss(DIRECTIONS)
    height, part = (0.5 * (height + 1.0)) ** 2, 0.5 * part
    plane = axes[0] ** 2 * c + axes[1] ** 2 * s
    spread = (plane[:, None] * (1.0 - height) + axes[2] ** 2 * height).ravel()
    t = length[:, None] / np.sqrt(spread)
    tails = special.erfc(t * np.sqrt(0.5)) + np.sqrt(2.0 / np.pi) * t * np.exp(-0.5 * t * t)
    return np.asarray(tails @ np.outer(weight, part).ravel())

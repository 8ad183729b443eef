"""Tests of the factors that a user added, each against everything else.

A factor has k whitened rows with the residuals v and the redundancy matrix M = I − A Q Aᵀ. Its rows
count in standard deviations of the noise model that the user gave it:

    redundancy numbers    r_i = M_ii
    test values           w_i = v_i / √M_ii
    of all rows           T² = vᵀ M⁻¹ v, χ² with rank(M) degrees of freedom
    smallest detectable   ∇_i = δ0 / √r_i, in σ of the row
    external reliability  δ̄_i = δ0 √((1 − r_i)/r_i)

The rows of a factor without a Jacobian are those of a square root of its information, see
`factorgraph_adj.graph.extra`: their T² has a meaning, their single figures have none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..solve.leverage import ClusterLeverage
from ..solve.linear import ExtraRows
from ..types import Array
from .distributions import ChiSquareTest, chi2_quantile

UNSEEN = 1e-6
"""Redundancy number, or eigenvalue of M, up to which nothing else controls a row; the value is that
of `factorgraph_adj.quality.reliability.UNCONTROLLED`."""


@dataclass(frozen=True, eq=False)
class FactorReliability(ChiSquareTest):
    """Reliability of a factor that the user added; arrays over its k rows."""

    name: str
    """Its name; ``factor 1 (RangeFactor3)`` where the user gave none."""
    residuals: Array
    """v, in σ of the noise model, computed − observed, (k,)."""
    redundancy_numbers: Array
    """r, from 0 to 1, (k,)."""
    e1: Array
    """Part of an error that goes into all unknowns except object points, (k,)."""
    w: Array
    """Test values of Baarda, (k,); NaN where nothing else controls a row."""
    mdb: Array
    """Smallest detectable error ∇, in σ of the row, (k,); infinite where nothing controls it."""
    delta_bar: Array
    """External reliability δ̄, (k,)."""
    t2: float
    """T² of all rows; NaN where nothing else controls any of them."""
    dof: int
    """Its degrees of freedom."""
    critical: float
    """Critical value of T²; NaN without degrees of freedom."""


def factor_reliability(
    rows: ExtraRows, found: ClusterLeverage, alpha: float, delta0: float, sigma0: float
) -> FactorReliability:
    """Return the figures of a factor.

    Args:
        rows: its rows.
        found: their leverages.
        alpha: probability α0 of a false alarm.
        delta0: δ0 of a single test.
        sigma0: σ0 of the smallest detectable errors.
    """
    m = np.eye(len(found.hat)) - found.hat
    r = np.diag(m).copy()
    on = r > UNSEEN
    root = np.sqrt(np.where(on, r, np.nan))
    t2, dof = statistic(rows.residual, m)
    return FactorReliability(
        name=rows.name,
        residuals=rows.residual,
        redundancy_numbers=r,
        e1=np.diag(found.others).copy(),
        w=rows.residual / root,
        mdb=np.where(on, delta0 * sigma0 / root, np.inf),
        delta_bar=np.where(on, delta0 * np.sqrt(np.maximum(1.0 - r, 0.0)) / root, np.inf),
        t2=t2,
        dof=dof,
        critical=chi2_quantile(1.0 - alpha, dof) if dof else np.nan,
    )


def statistic(v: Array, m: Array) -> tuple[float, int]:
    """Return T² = vᵀ M⁺ v and rank(M); NaN where M vanishes.

    Args:
        v: residuals with their own covariance M, (k,), such as those of the rows of a factor.
        m: M, (k, k).
    """
    values, vectors = np.linalg.eigh(0.5 * (m + m.T))
    on = values > UNSEEN
    dof = int(on.sum())
    if not dof:
        return np.nan, 0
    return float(np.sum((vectors[:, on].T @ v) ** 2 / values[on])), dof

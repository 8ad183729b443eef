"""Tests of factors against all others, from the joint covariances of their variables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np

from ..graph.factors import Part
from ..graph.user_factors import dimension
from ..quality.group_tests import (
    MIN_CONTROLLED_SHARE,
    LeaveOneOutTests,
    critical_t2,
    noncentrality_of_group,
)
from ..types import Array, Index


@dataclass(frozen=True, eq=False)
class EnteredFactor:
    """A factor in iSAM2."""

    factor: gtsam.NonlinearFactor
    """The factor."""
    arrival: int
    """Number of the update with which it came."""
    ids: tuple[str, ...] = ()
    """Ids of its observations; none of your own factors."""
    sigmas: tuple[Array, ...] = ()
    """Their standard deviations with the lengths of sights at which the factor was made."""
    keeps: int | None = None
    """Key of the variable whose held components it keeps."""
    slot: int = -1
    """Index in iSAM2."""

    def weighs_as(self, parts: Sequence[Part]) -> bool:
        """Return whether its standard deviations are those of observations, within 1e-7."""
        return all(
            np.allclose(a, b, rtol=1e-7, atol=0.0)
            for a, b in zip(self.sigmas, sigmas_of(parts), strict=True)
        )


def sigmas_of(parts: Sequence[Part]) -> tuple[Array, ...]:
    """Return the standard deviations of observations, part by part."""
    return tuple(part.block.sigma[part.chosen] for part in parts)


@dataclass(frozen=True, eq=False)
class FactorTests:
    """Tests of n factors with k whitened rows, each factor against everything else."""

    names: tuple[str, ...]
    """Names of the factors."""
    t2: Array
    """T² = vᵀ M⁺ v of all rows of a factor, with M = I − A Q Aᵀ, (n,)."""
    dof: Index
    """Its degrees of freedom, the rank of M, (n,)."""
    critical: Array
    """Its critical value, the quantile 1 − α of χ², (n,); NaN where nothing else controls it."""
    rows: tuple[Index, ...]
    """Rows of each factor."""
    w: Array
    """Test values v / √M_ii of the rows, (k,); NaN where nothing else controls them."""
    redundancy_numbers: Array
    """M_ii, (k,)."""
    mdb: Array
    """Smallest detectable errors δ0 / √M_ii of the rows, in their σ, (k,); infinite where nothing
    else controls them."""

    @property
    def suspects(self) -> tuple[str, ...]:
        """Names of the factors beyond their critical values, the worst first."""
        ratio = np.nan_to_num(self.t2 / self.critical)
        return tuple(self.names[i] for i in np.argsort(-ratio).tolist() if ratio[i] > 1.0)


def factor_tests(
    factors: Mapping[str, gtsam.NonlinearFactor],
    values: gtsam.Values,
    joint_covariance: Callable[[list[int]], gtsam.JointMarginal],
    *,
    alpha: float,
    power: float,
) -> FactorTests:
    """Test factors, each against everything else, the others among them in.

    With whitened residuals v and partials A at the estimate, and the joint covariance Q of all of
    their variables,

        M = I − A Q Aᵀ,   T² = vᵀ M⁺ v,   w_i = v_i/√M_ii,   r_i = M_ii.

    Args:
        factors: factors by name, which are in the graph.
        values: the estimate.
        joint_covariance: joint covariance of the variables with some keys.
        alpha: probability of a false alarm of one test.
        power: of the smallest detectable errors.
    """
    own_keys = {n: list(f.keys()) for n, f in factors.items()}
    keys = list(dict.fromkeys(k for own in own_keys.values() for k in own))
    first = dict(zip(keys, _starts(values, keys), strict=True))
    a, v, rows, at = [], [], [], 0
    size = sum(dimension(values, k) for k in keys)
    for name, factor in factors.items():
        part, b = gtsam.JacobianFactor(factor.linearize(values)).jacobian()
        wide = np.zeros((len(b), size))
        column = 0
        for key in own_keys[name]:
            own = dimension(values, key)
            wide[:, first[key] : first[key] + own] += part[:, column : column + own]
            column += own
        a.append(wide)
        v.append(-np.asarray(b))
        rows.append(np.arange(at, at + len(b)))
        at += len(b)
    q = joint_covariance(keys).fullMatrix()
    every = np.vstack(a)
    m = np.eye(at) - every @ q @ every.T
    residual = np.concatenate(v)
    tested = LeaveOneOutTests(rows, residual, lambda u: m[:, u])
    t2, dof = tested.statistics()
    r = np.diag(m)
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(np.where(r > MIN_CONTROLLED_SHARE, r, np.nan))
        w, mdb = residual / root, np.sqrt(noncentrality_of_group(alpha, power, 1)) / root
    critical = np.array([critical_t2(alpha, int(k)) for k in dof])
    return FactorTests(
        tuple(factors), t2, dof, critical, tuple(rows), w, r, np.nan_to_num(mdb, nan=np.inf)
    )


def _starts(values: gtsam.Values, keys: Sequence[int]) -> list[int]:
    ends = np.cumsum([dimension(values, k) for k in keys], dtype=np.intp)
    return [0, *(int(e) for e in ends[:-1])]


@dataclass(frozen=True, eq=False)
class JointCovariance:
    """Units with the joint covariance of what they touch."""

    rows: list[Index]
    """Rows of each unit."""
    columns: Index
    """Columns of what they touch, (m,)."""
    a: Array
    """Whitened partials, (k, m)."""
    v: Array
    """Whitened residuals, (k,)."""
    covariance: Array
    """Joint covariance of the columns, (m, m)."""

    @cached_property
    def m(self) -> Array:
        """M = I − A Q Aᵀ, with Q after the update, (k, k)."""
        return np.asarray(np.eye(len(self.a)) - self._spread.T @ self.a.T)

    @cached_property
    def _spread(self) -> Array:
        return np.asarray(self.covariance @ self.a.T)

    def tested(self) -> LeaveOneOutTests:
        """Return the units, to be tested against everything else."""
        return LeaveOneOutTests(self.rows, self.v, lambda u: self.m[:, u])

    @property
    def least_redundancy(self) -> float:
        """The smallest eigenvalue of M: 0 where only they determine something."""
        return float(np.linalg.eigvalsh(0.5 * (self.m + self.m.T))[0]) if len(self.m) else 1.0

    def spread(self, i: int, columns: Index) -> Array:
        """Return Q Aᵀ of columns that they touch (−1: held, 0) with the rows of a unit, (m, d)."""
        out = np.zeros((len(columns), len(self.rows[i])))
        free = columns >= 0
        out[free] = self._spread[np.ix_(self._at(columns[free]), self.rows[i])]
        return out

    def partials(self, columns: Index) -> Array:
        """Return the whitened partials by columns that they touch, (k, m)."""
        return np.asarray(self.a[:, self._at(columns)])

    def variance(self, columns: Index) -> Array:
        """Return the variances of columns that they touch (−1: held, 0), (m,)."""
        out = np.zeros(len(columns))
        free = columns >= 0
        out[free] = np.diag(self.covariance)[self._at(columns[free])]
        return out

    def _at(self, columns: Index) -> Index:
        return np.asarray(np.searchsorted(self.columns, columns))

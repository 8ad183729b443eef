"""Tests of factors, each against everything else, at the estimate of a factor graph."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from ..quality.groups import noncentrality_of_group
from ..quality.leave_out import Tested, critical_t2
from ..quality.reliability import UNCONTROLLED
from ..types import Array, Index


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
    size = sum(_size(values, k) for k in keys)
    for name, factor in factors.items():
        part, b = gtsam.JacobianFactor(factor.linearize(values)).jacobian()
        wide = np.zeros((len(b), size))
        column = 0
        for key in own_keys[name]:
            own = _size(values, key)
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
    tested = Tested(rows, residual, lambda u: m[:, u])
    t2, dof = tested.statistics()
    r = np.diag(m)
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(np.where(r > UNCONTROLLED, r, np.nan))
        w, mdb = residual / root, np.sqrt(noncentrality_of_group(alpha, power, 1)) / root
    critical = np.array([critical_t2(alpha, int(k)) for k in dof])
    return FactorTests(
        tuple(factors), t2, dof, critical, tuple(rows), w, r, np.nan_to_num(mdb, nan=np.inf)
    )


def _size(values: gtsam.Values, key: int) -> int:
    try:
        return len(values.atVector(key))
    except RuntimeError:
        return 6


def _starts(values: gtsam.Values, keys: Sequence[int]) -> list[int]:
    ends = np.cumsum([_size(values, k) for k in keys], dtype=np.intp)
    return [0, *(int(e) for e in ends[:-1])]

"""What arrives is tested against everything that is there, itself left out.

With the arriving rows whitened, their residuals v and redundancy matrix M = I − A Q Aᵀ after they
were put in (to first order, Q with them), every subset u of them is as if predicted by all the
others:

    d_u = M_uu⁻¹ v_u             innovation, computed − observed
    D_u = M_uu⁻¹                 its covariance
    w_i = (M_uu⁻¹v)_i/√(…)_ii = v_i/√M_ii for single observations
    T²  = v_uᵀ M_uu⁻¹ v_u        χ² with rank(M_uu) degrees of freedom
    r_i = M_ii                   redundancy number

For a single arrival this is innovation, its covariance Σ + A Q₀ Aᵀ and its test against the state
before. Where u is taken out again, the others follow without a new solution:

    M ← M − M_·u M_uu⁻¹ M_u·,    v ← v − M_·u M_uu⁻¹ v_u.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, TypeAlias

import numpy as np

from ..quality.distributions import chi2_quantile
from ..types import Array, Index

Policy: TypeAlias = Literal["accept", "flag", "reject"]
"""What becomes of an observation whose test value is beyond the critical value."""
Outcome: TypeAlias = Literal["accepted", "suspect", "rejected", "waiting"]
OUTCOMES: tuple[Outcome, ...] = ("accepted", "waiting", "suspect", "rejected")
"""Every outcome, in the order in which a line of the journal lists them."""
UNCONTROLLED = 1e-6
"""Eigenvalues of M below which an error in that direction does not show; see
`factorgraph_adj.quality.reliability.UNCONTROLLED`."""


@dataclass(frozen=True)
class Gain:
    """What an observation adds to a point."""

    point: str
    """Name of the point."""
    before: Array
    """Standard deviations without the observation, metres (3,); infinite where it is new."""
    after: Array
    """With it, (3,)."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """What became of an observation, and why; arrays over its k scalar components.

    Figures are none where nothing was tested: while it waits, and after `snoop`.
    """

    id: str
    """Its id."""
    kind: str
    """Its kind."""
    label: str
    """Readable name, with its source."""
    verdict: Outcome
    """``waiting``: something that it depends on is not determined yet."""
    components: tuple[str, ...] = ()
    """Names of the components."""
    innovation: Array | None = None
    """Computed from everything else − observed, SI or image units, (k,)."""
    sigma: Array | None = None
    """Standard deviations of the innovation (k,); infinite where nothing else controls it."""
    w: Array | None = None
    """Test values v/(σ√r), (k,); NaN where nothing else controls it."""
    redundancy_numbers: Array | None = None
    """The redundancy numbers that it has, or would have, (k,)."""
    t2: float = np.nan
    """T² of all components; of a correlated group, of all its observations."""
    dof: int = 0
    """Degrees of freedom of T²."""
    critical: float = np.nan
    """Critical value of T²."""
    entered: bool = False
    """Whether it had been waiting."""
    lacks: str = ""
    """What it waits for."""
    points: tuple[str, ...] = ()
    """Points that it touches."""
    gains: tuple[Gain, ...] = ()
    """What it adds to its points; empty for observations that are left out, and in free networks
    (there the standard deviations belong to all datum points together)."""

    @property
    def controlled(self) -> bool:
        """Whether anything else controls it."""
        return self.dof > 0

    @property
    def test(self) -> float:
        """√(T²/critical): beyond the critical value above 1; NaN where nothing controls it."""
        return float(np.sqrt(self.t2 / self.critical)) if self.dof else np.nan


@dataclass
class Judged:
    """M and v of the arriving rows, those left out removed from them."""

    m: Array
    """M, (rows, rows)."""
    v: Array
    """Residuals, whitened, (rows,)."""

    def take_out(self, u: Index) -> None:
        """Leave rows out."""
        inverse = pseudo_inverse(self.m[np.ix_(u, u)])[0]
        gain = self.m[:, u] @ inverse
        self.v = self.v - gain @ self.v[u]
        self.m = self.m - gain @ self.m[u]
        self.m[u] = self.m[:, u] = 0.0
        self.v[u] = 0.0

    def test(self, u: Index) -> tuple[float, int]:
        """Return T² and its degrees of freedom of some rows."""
        inverse, rank = pseudo_inverse(self.m[np.ix_(u, u)])
        with np.errstate(over="ignore"):  # a reading of 1e300 m is beyond every critical value
            return float(self.v[u] @ inverse @ self.v[u]), rank


def pseudo_inverse(m: Array) -> tuple[Array, int]:
    """Return M⁺ over the directions that are controlled, and their number."""
    if len(m) == 1:
        r = float(m[0, 0])
        return (np.array([[1.0 / r]]), 1) if r > UNCONTROLLED else (np.zeros((1, 1)), 0)
    values, vectors = np.linalg.eigh(m)
    on = values > UNCONTROLLED
    return (vectors[:, on] / values[on]) @ vectors[:, on].T, int(on.sum())


@lru_cache(maxsize=256)
def critical_t2(alpha: float, dof: int) -> float:
    """Return the critical value of T²: the quantile 1 − α of χ² with ``dof`` degrees."""
    return chi2_quantile(1.0 - alpha, dof) if dof else np.nan

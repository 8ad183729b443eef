"""Cumulative sums of the innovations of a point (CUSUM), for any direction, and their run length.

Crosier's multivariate CUSUM (Technometrics 30, 1988) of standardised innovations u_t ~ N(0, I) of
h coordinates:

    C_t = |S_{t−1} + u_t|,  S_t = (S_{t−1} + u_t) max(0, 1 − κ/C_t),  S_0 = 0

It signals when |S_t| exceeds the limit H. The allowance κ is half of the shift, in σ of an epoch,
that it shall find soonest. |S_t| is a Markov chain by itself, as no direction differs from another
while nothing moves: with f(c | s) the density of |s e + u|, a noncentral χ,

    L(s) = 1 + L(0) P(C ≤ κ | s) + ∫₀ᴴ L(y) f(y + κ | s) dy

is the average run length from |S| = s, solved by Gauss–Legendre nodes (`average_run_length`). The
innovations are those of the mean of all earlier epochs, see
`factorgraph_adj.monitoring.mean_estimates`: they do not depend on each other, so that no common
reference has part in the run length. After a displacement the mean follows it, slowly after many
epochs; a creep that goes on never comes to rest in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import special

from ..errors import InputError
from ..statistical_tests import root
from ..types import Array

NODES = 64
"""Least number of nodes of the integral equation; 32 give the same run lengths to 1e-6 for κ from
0.25 on."""
NODES_PER_UNIT = 2.5
"""Number of nodes for each unit of a large limit: the kernel is about 1 wide."""
MAX_LIMIT = 400.0
"""Largest limit H that is sought; the allowance of a larger one is next to 0."""


def next_sum(s: Array, u: Array, allowance: float) -> Array:
    """Return S_t (…, h) of S_{t−1} and the innovation u_t, both (…, h)."""
    total = s + u
    size = np.linalg.norm(total, axis=-1, keepdims=True)
    return np.asarray(total * np.maximum(0.0, 1.0 - allowance / np.maximum(size, 1e-300)))


@dataclass(frozen=True)
class CusumDesign:
    """Allowance and limit of a CUSUM of some coordinates."""

    freedom: int
    """Number of coordinates h."""
    allowance: float
    """κ, σ of an epoch."""
    limit: float
    """H."""

    def average_run_length(self) -> float:
        """Return the average number of epochs until it signals while nothing moves."""
        return average_run_length(self.freedom, self.allowance, self.limit)

    def steady_run_length(self, shift: float, *, trials: int = 20_000, seed: int = 1) -> float:
        """Return the average number of epochs until a lasting shift of the mean of u is found.

        Args:
            shift: |E u_t| in σ from the first epoch on, with S_0 = 0.
            trials: number of simulated runs; the result has the relative error 1/√trials or less.
            seed: seed of the runs.
        """
        rng = np.random.default_rng(seed)
        s = np.zeros((trials, self.freedom))
        total, epochs = 0, 0
        while len(s):
            u = rng.standard_normal(s.shape)
            u[:, 0] += shift
            s = next_sum(s, u, self.allowance)
            epochs += 1
            found = np.linalg.norm(s, axis=1) > self.limit
            total += epochs * int(found.sum())
            s = s[~found]
        return total / trials


def average_run_length(freedom: int, allowance: float, limit: float) -> float:
    """Return the average run length of a CUSUM from S = 0 while nothing moves.

    Args:
        freedom: number of coordinates h.
        allowance: κ > 0, σ of an epoch.
        limit: H > 0.
    """
    nodes = max(NODES, int(np.ceil(NODES_PER_UNIT * limit)))
    x, weight = np.polynomial.legendre.leggauss(nodes)
    y, weight = (x + 1.0) * limit / 2.0, weight * limit / 2.0
    s = np.append(0.0, y)
    kernel = np.empty((len(s), len(s)))
    kernel[:, 0] = _lower_probability(allowance, s, freedom)
    kernel[:, 1:] = weight * _density(y[None, :] + allowance, s[:, None], freedom)
    return float(np.linalg.solve(np.eye(len(s)) - kernel, np.ones(len(s)))[0])


def _lower_probability(c: float, s: Array, freedom: int) -> Array:
    """Return P(|s e + u| ≤ c)."""
    return np.where(
        s > 0,
        special.chndtr(c**2, freedom, np.maximum(s, 1e-12) ** 2),
        special.chdtr(freedom, c**2),
    )


def _density(c: Array, s: Array, freedom: int) -> Array:
    """Return the density of |s e + u| at c > 0.

    c (c/s)^{h/2−1} exp(−(c − s)²/2) I_{h/2−1}(cs) exp(−cs), and that of χ for s = 0.
    """
    order = freedom / 2.0 - 1.0
    safe = np.maximum(s, 1e-12)
    far = c * (c / safe) ** order * np.exp(-((c - s) ** 2) / 2.0) * special.ive(order, c * safe)
    centre = np.exp(-(c**2) / 2.0) * c ** (freedom - 1) / special.gamma(freedom / 2.0)
    return np.where(s > 0, far, centre * 2.0 ** (1.0 - freedom / 2.0))


@lru_cache(maxsize=256)
def limit_of_run_length(freedom: int, allowance: float, run_length: float) -> float:
    """Return the limit H with an average run length.

    Args:
        freedom: number of coordinates h.
        allowance: κ, σ of an epoch.
        run_length: average number of epochs until a false alarm.

    Raises:
        InputError: the allowance is not positive, or no limit up to `MAX_LIMIT` has this run
            length.
    """
    if not allowance > 0:
        raise InputError(f"the allowance of a CUSUM must be positive, not {allowance}")
    if not 2.0 < run_length < 1e9:
        raise InputError(
            f"a CUSUM with one false alarm in {run_length:.3g} epochs of a point: state a rate "
            "that asks for one in 2 to 10⁹"
        )
    # Without a limit, H = 0, it signals as soon as |u| exceeds κ.
    least = 1.0 / max(float(special.chdtrc(freedom, allowance**2)), 1e-300)
    if run_length <= least:
        raise InputError(
            f"a CUSUM with the allowance {allowance:g} has one false alarm in {least:.3g} epochs "
            f"of a point, or fewer, not one in {run_length:.3g}: state a smaller allowance, or a "
            "lower rate"
        )
    low, top = 0.0, 0.5
    while average_run_length(freedom, allowance, top) < run_length:
        low, top = top, 1.25 * top
        if top > MAX_LIMIT:
            raise InputError(
                f"a CUSUM with the allowance {allowance:g} and one false alarm in {run_length:.3g} "
                f"epochs of a point has a limit above {MAX_LIMIT:g} σ: state a larger allowance"
            )
    return root(
        lambda h: float(np.log(average_run_length(freedom, allowance, h) / run_length)),
        max(low, 1e-9),
        top,
        tolerance=1e-9,
    )

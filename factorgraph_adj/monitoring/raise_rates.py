"""How often an alarm of a test is raised by chance, and how soon by a displacement: exactly.

The test of a point in epoch t has T = |u_t|² with h degrees of freedom, and u_t = w + z_t in units
of its σ: w ~ N(0, ρ I) is the error of the reference, which all epochs share, and z_t ~ N(0,
(1 − ρ) I) is the epoch's own. The mean of b epochs as reference has ρ = 1/(1 + b). T has χ² with h
degrees of freedom in every epoch, and epochs are independent of each other once w is given. An
alarm is

- raised when T exceeds the critical value in at least k of the last n epochs,
- cleared when T stayed below the release value for m epochs in a row.

With w given, what was seen in the last n − 1 epochs is a Markov chain, whose steps have the
probabilities of a noncentral χ². `expected_raisings` is the expected number of raisings in a month
that begins with no alarm after the reference, averaged over w by Gauss–Legendre quadrature. There
is no further approximation where Q of epoch and reference are proportional, as those of equal
designs are; other designs change ρ alone, of which the number depends weakly. The expected number
of several points is the sum, however much their datum makes them move together: their alarms then
come at the same time, and rarely.

In later months fewer are raised: a reference that is far off has then raised its alarms already.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy import special

from ..errors import InputError, Problem
from ..statistical_tests import chi2_upper_quantile, root
from ..types import Array, Index

MONTH_S = 365.25 / 12 * 86400.0
"""Length of a month, seconds."""
MAX_WINDOW = 12
"""Largest number of epochs n that an alarm looks at: the chain has 2ⁿ⁻¹ states."""
NODES = 80
"""Number of nodes of the quadrature over the error of the reference, for shares up to 0.7. Larger
ones have more: the probabilities of an epoch change within its own σ, √((1 − ρ)/ρ) of that of the
reference."""
MAX_EPOCHS_TO_DETECTION = 10_000
"""Number of epochs in which a displacement is expected to raise an alarm, or none is stated."""
MIN_TAIL = 1e-15
"""Probability of errors of the reference beyond the last node."""
LOWEST_LEVEL = 1e-14
"""Smallest probability of a single test that is searched."""


@dataclass(frozen=True)
class AlarmLife:
    """When an alarm is raised, and when it is cleared: k of n epochs, and hysteresis.

    Raises:
        InputError: not 1 ≤ k ≤ n ≤ `MAX_WINDOW`, 0 < release ≤ 1, clear_after ≥ n.
    """

    k: int = 1
    """Number of epochs beyond the critical value that raise it …"""
    n: int = 1
    """… among this number of last epochs."""
    release: float = 0.7
    """Hysteresis: the release value of √T, relative to the critical one."""
    clear_after: int = 2
    """Number of epochs in a row below the release value that clear it, m ≥ n."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        wrong = []
        if not 1 <= self.k <= self.n <= MAX_WINDOW:
            wrong.append(f"k of n epochs: 1 ≤ k ≤ n ≤ {MAX_WINDOW}, not {self.k} of {self.n}")
        elif self.clear_after < self.n:
            wrong.append(f"clear_after must be at least n = {self.n}, not {self.clear_after}")
        if not 0 < self.release <= 1:
            wrong.append(f"release must be greater than 0 and at most 1, not {self.release}")
        if wrong:
            raise InputError(map(Problem, wrong))

    @cached_property
    def _seen(self) -> tuple[Index, Array]:
        """Successors of the patterns of the last n − 1 epochs, and how many of them exceeded.

        Returns:
            Successor without and with an exceedance, (2ⁿ⁻¹, 2), and the numbers, (2ⁿ⁻¹,).
        """
        size = 2 ** (self.n - 1)
        pattern = np.arange(size)
        after = np.stack([2 * pattern % size, (2 * pattern + 1) % size if self.n > 1 else pattern])
        number = np.array([bin(p).count("1") for p in pattern.tolist()])
        return after.T, number


@dataclass(frozen=True)
class RaiseRate:
    """Chance and power of the alarms of one point: h degrees of freedom, share ρ, life."""

    freedom: int
    """Degrees of freedom h of T."""
    share: float
    """Share ρ of the reference in the variance of a difference."""
    life: AlarmLife
    """When an alarm is raised and cleared."""

    def __post_init__(self) -> None:
        """Check the share."""
        if not 0 <= self.share < 1:
            raise InputError(f"the share of the reference must lie in [0, 1), not {self.share}")

    @property
    def _nodes(self) -> int:
        """Number of nodes of the quadrature over the error of the reference along an axis."""
        return int(np.ceil(NODES * max(1.0, np.sqrt(0.3 / (1.0 - self.share)))))

    @cached_property
    def _far(self) -> tuple[Array, Array]:
        """Return |w|² (nodes,) and their weights."""
        h, share = self.freedom, self.share
        if share == 0:
            return np.zeros(1), np.ones(1)
        top = float(np.sqrt(chi2_upper_quantile(MIN_TAIL, h)))
        x, weight = np.polynomial.legendre.leggauss(self._nodes)
        r = (x + 1.0) * top / 2.0
        density = 2.0 ** (1.0 - h / 2.0) * np.exp(-(r**2) / 2.0) * r ** (h - 1)
        density *= weight * top / 2.0 / special.gamma(h / 2.0)
        return share * r**2, density / density.sum()

    def expected_raisings(self, level: float, epochs: int) -> float:
        """Return the expected number of raisings in some epochs, beginning without alarm.

        Args:
            level: probability α of a single test.
            epochs: number of epochs.
        """
        critical = float(chi2_upper_quantile(level, self.freedom))
        far, weight = self._far
        above = self._tail(critical, far)
        below = 1.0 - self._tail(self.life.release**2 * critical, far)
        return float(weight @ _raisings(above, below, self.life, epochs))

    def _tail(self, value: float, far: Array) -> Array:
        """Return P(T > value), with correct digits where it is small."""
        own = 1.0 - self.share
        return noncentral_upper_probability(value / own, self.freedom, far / own)

    def power(self, level: float, size: float) -> float:
        """Return the probability that a displacement raises an alarm in the first n epochs after.

        Args:
            level: probability α of a single test.
            size: displacement in units of its σ, that of the difference to the reference.
        """
        critical = float(chi2_upper_quantile(level, self.freedom))
        far, weight = self._displaced(size)
        p = self._tail(critical, far)
        k, n = self.life.k, self.life.n
        return float(weight @ special.bdtrc(k - 1, n, p))

    def time_to_detection(self, level: float, size: float) -> float:
        """Return the median number of epochs until a lasting displacement raises an alarm.

        It is infinite where it is larger than `MAX_EPOCHS_TO_DETECTION`.

        Args:
            level: probability α of a single test.
            size: displacement in units of its σ, that of the difference to the reference.
        """
        critical = float(chi2_upper_quantile(level, self.freedom))
        far, weight = self._displaced(size)
        before, settled = 0.0, 10 * self.life.n
        for number, by in enumerate(_raised_by(self._tail(critical, far), self.life), start=1):
            total = float(weight @ by)
            if total >= 0.5:
                return float(number)
            # Fewer and fewer are left: no later epoch raises more than this one.
            left = MAX_EPOCHS_TO_DETECTION - number
            if left == 0 or (number > settled and total + left * (total - before) < 0.5):
                break
            before = total
        return float("inf")

    def _displaced(self, size: float) -> tuple[Array, Array]:
        """Return |w + δ|² and weights for a displacement δ; w along it and across it."""
        h, share = self.freedom, self.share
        if share == 0:
            return np.array([float(size) ** 2]), np.ones(1)
        x, weight = np.polynomial.legendre.leggauss(self._nodes)
        x = x * float(np.sqrt(chi2_upper_quantile(MIN_TAIL, 1)))
        weight = weight * np.exp(-(x**2) / 2.0)
        along, of_along = np.sqrt(share) * x + size, weight / weight.sum()
        if h == 1:
            return along**2, of_along
        across, of_across = RaiseRate(h - 1, share, self.life)._far
        return (
            np.add.outer(along**2, across).ravel(),
            np.multiply.outer(of_along, of_across).ravel(),
        )

    def detectable(self, level: float, power: float) -> float:
        """Return the displacement in units of its σ that raises an alarm with a probability."""
        top = 10.0
        while self.power(level, top) < power:
            top *= 2.0
        return root(lambda x: self.power(level, x) - power, 0.0, top, tolerance=1e-6)


def noncentral_upper_probability(value: float, freedom: float, shift: Array) -> Array:
    """Return P(χ²(h, λ) > value) for noncentralities λ (n,), with correct digits of small ones."""
    from scipy.stats import ncx2  # imported here, because the import is slow

    far = np.asarray(ncx2.sf(value, freedom, np.maximum(shift, 1e-9)), dtype=float)
    return np.where(shift > 1e-9, far, special.chdtrc(freedom, value))


def _raisings(above: Array, below: Array, life: AlarmLife, epochs: int) -> Array:
    """Return the expected number of raisings in some epochs, one for each node.

    Args:
        above: probability beyond the critical value, (nodes,).
        below: probability below the release value, (nodes,).
        life: when an alarm is raised and cleared.
        epochs: number of epochs.
    """
    after, number = life._seen
    states, m = len(number), life.clear_after
    calm = np.zeros((len(above), states))
    calm[:, 0] = 1.0
    raised = np.zeros((len(above), m))
    out = np.zeros(len(above))
    raises = number + 1 >= life.k
    for _ in range(epochs):
        new = np.zeros_like(calm)
        np.add.at(new.T, after[:, 0], (calm * (1.0 - above)[:, None]).T)
        hit = calm * above[:, None]
        np.add.at(new.T, after[~raises, 1], hit[:, ~raises].T)
        begun = hit[:, raises].sum(axis=1)
        out += begun
        kept = np.zeros_like(raised)
        kept[:, 0] = begun + raised.sum(axis=1) * (1.0 - below)
        kept[:, 1:] = raised[:, :-1] * below[:, None]
        new[:, 0] += raised[:, -1] * below
        calm, raised = new, kept
    return out


def _raised_by(above: Array, life: AlarmLife) -> Iterator[Array]:
    """Yield the probability, at each node, that an alarm is raised by each epoch."""
    after, number = life._seen
    calm = np.zeros((len(above), len(number)))
    calm[:, 0] = 1.0
    raises = number + 1 >= life.k
    while True:
        new = np.zeros_like(calm)
        np.add.at(new.T, after[:, 0], (calm * (1.0 - above)[:, None]).T)
        np.add.at(new.T, after[~raises, 1], (calm * above[:, None])[:, ~raises].T)
        calm = new
        yield 1.0 - calm.sum(axis=1)


@lru_cache(maxsize=256)
def level_of_rate(
    raisings: float, freedom: int, shares: tuple[float, ...], life: AlarmLife, epochs: int
) -> float:
    """Return the probability α of a single test that keeps a number of false alarms.

    Args:
        raisings: expected number of raisings of all points together in the epochs.
        freedom: degrees of freedom of the tests.
        shares: share ρ of the reference, of each point.
        life: when an alarm is raised and cleared.
        epochs: number of epochs.

    Raises:
        InputError: no level does.
    """
    each = sorted({round(s, 3) for s in shares})
    counts = [sum(round(s, 3) == e for s in shares) for e in each]
    rates = [RaiseRate(freedom, min(e, 0.999), life) for e in each]

    def excess(log: float) -> float:
        level = float(np.exp(log))
        found = sum(
            c * r.expected_raisings(level, epochs) for c, r in zip(counts, rates, strict=True)
        )
        return float(np.log(max(found, 1e-300) / raisings))

    low, high = np.log(LOWEST_LEVEL), np.log(0.2)
    if not excess(low) < 0 < excess(high):
        raise InputError(
            f"{raisings:.3g} false alarms in {epochs} epochs of {len(shares)} points cannot be "
            "kept: state a rate between those of tests with probabilities of 1e-14 and 0.2"
        )
    return float(np.exp(root(excess, low, high, tolerance=1e-4)))

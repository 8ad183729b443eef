"""Verdicts on arriving observations against predictions from the batch adjustment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj import IncrementalAdjustment, Network, Solution
from factorgraph_adj.errors import AdjustmentError
from factorgraph_adj.observations import AnyObservation, Correlated
from factorgraph_adj.quality.prediction import Prediction, Predictor
from factorgraph_adj.types import Array
from tests.networks.random_small import Drawn, handed_over
from tests.support.arrivals import bare, batch, ids_of, items

BOUND = 1e-3
"""Largest difference of a figure, see `Compared`."""


@dataclass(frozen=True)
class Compared:
    """How far the figures of a verdict are from those of the prediction.

    Differences are relative to the figures themselves; where these are less than one, to one.
    """

    when: str
    """The network, what arrived and how much was there."""
    w: float
    """Of the test values."""
    t2: float
    """Of √T²."""
    redundancy: float
    """Of the redundancy numbers."""
    innovation: float
    """Of the innovations, in units of their standard deviations."""
    sigma: float
    """Of the standard deviations of the innovations."""

    def __str__(self) -> str:
        """Return a line."""
        return (
            f"{self.when}: w {self.w:.1e}, √T² {self.t2:.1e}, r {self.redundancy:.1e}, "
            f"d/σ {self.innovation:.1e}, σ {self.sigma:.1e}"
        )

    @property
    def largest(self) -> float:
        """The largest of them."""
        return max(self.w, self.t2, self.redundancy, self.innovation, self.sigma)


def of_the_group(solution: Solution, expected: Prediction) -> tuple[Array, Array, float]:
    """Return w = D⁻¹d/√(D⁻¹)_ii, r = (Σ D⁻¹)_ii and T² = dᵀD⁻¹d of all rows together."""
    linear = Predictor(expected.equations, solution).innovations.linearise(expected.rows)
    a, covariance = linear.a.toarray(), linear.covariance.toarray()
    d = covariance + a @ solution.cofactor_times(a.T)
    inverse = np.linalg.inv(d)
    weighted = inverse @ expected.innovation
    return (
        weighted / np.sqrt(np.diag(inverse)),
        np.diag(covariance @ inverse),
        float(expected.innovation @ weighted),
    )


def compare_next(
    adjustment: IncrementalAdjustment, item: AnyObservation, name: str
) -> Compared | None:
    """Add an observation, and compare its verdict with the prediction from the batch adjustment.

    Returns:
        None where there is no prediction: it waits, or determines something new; where it fixes a
        motion that the datum of a free network left open, on which a prediction depends; or where
        there is no batch adjustment.
    """
    before = expected = None
    if len(adjustment):
        try:
            before = batch(adjustment)
            # `network()` leaves out what is not determined, which would be constants here.
            whole = handed_over(adjustment.described, [item])
            expected = fga.predict(before, whole, ids=ids_of(item)) if before.converged else None
        except AdjustmentError:
            expected = None
    there = len(adjustment)
    verdicts = {v.id: v for v in adjustment.add(item).verdicts}
    if before is None or expected is None:
        return None
    if adjustment.solution().datum_defect < before.datum_defect:
        return None
    found = [verdicts[i] for i in expected.ids]
    if any(v.verdict == "waiting" for v in found):
        return Compared(f"{name}: {expected.ids[0]} waits, {there} in", *(np.inf,) * 5)
    w, r, t2 = expected.w, expected.redundancy_numbers, float(expected.t2[0])
    if isinstance(item, Correlated):  # predicted one by one; a verdict is about all of them
        w, r, t2 = of_the_group(before, expected)
    innovation, sigma = (np.concatenate([getattr(v, n) for v in found]) for n in FIGURES[:2])
    own_w, own_r = (np.concatenate([getattr(v, n) for v in found]) for n in FIGURES[2:])
    controlled = r > NOTHING
    return Compared(
        f"{name}: {expected.ids[0]}, {there} in, T² {t2:.1f}",
        _off(own_w[controlled], w[controlled]),
        _off(np.sqrt([found[0].t2]), np.sqrt([t2])) if controlled.all() else 0.0,
        float(np.max(np.abs(own_r - r))),
        _off((innovation / sigma)[controlled], (expected.innovation / expected.sigma)[controlled]),
        float(np.max(np.abs(sigma / expected.sigma - 1.0)[controlled], initial=0.0)),
    )


FIGURES = ("innovation", "sigma", "w", "redundancy_numbers")
NOTHING = 1e-6
"""Redundancy numbers below it are rounding: nothing controls the observation."""


def _off(ours: Array, theirs: Array) -> float:
    if not len(theirs):
        return 0.0
    return float(np.max(np.abs(ours - theirs) / np.maximum(np.abs(theirs), 1.0)))


def verdicts_of(
    name: str, described: Network, some: Sequence[AnyObservation], seed: int, moments: int
) -> Iterator[Compared]:
    """Let observations arrive in a random order; compare at random moments.

    All moments are after half of the observations are there, when most is determined. What comes
    between two of them comes together.

    Args:
        name: of the network.
        described: the network without observations.
        some: its observations.
        seed: of the order and the moments.
        moments: number of observations that are compared, if there are so many.
    """
    rng = np.random.default_rng([seed, 11])
    order = rng.permutation(len(some)).tolist()
    half = len(some) // 2
    late = rng.choice(np.arange(half, len(some)), min(len(some) - half, moments), replace=False)
    adjustment = IncrementalAdjustment(described, policy="accept")
    at = 0
    for place in sorted(late.tolist()):
        adjustment.add([some[i] for i in order[at:place]])
        found = compare_next(adjustment, some[order[place]], name)
        if found is not None:
            yield found
        at = place + 1


def verdicts_of_drawn(drawn: Drawn, moments: int) -> Iterator[Compared]:
    """Compare verdicts of a random network."""
    name = f"network {drawn.seed}"
    return verdicts_of(name, drawn.bare, drawn.items, drawn.seed, moments)


def verdicts_of_network(name: str, network: Network, seed: int, moments: int) -> Iterator[Compared]:
    """Compare verdicts of a network that has its observations."""
    return verdicts_of(name, bare(network), items(network), seed, moments)

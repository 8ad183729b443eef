"""How sure it is which of two errors has happened.

An error that is tested by T² = uᵀS⁻¹u leaves vᵀPv smaller by T². Of two errors with one component
each, the test values w₁, w₂ have a correlation ρ, and if the first is the true one, T₁² exceeds T₂²
by (1 − ρ²) T₁² on the average. The difference is twice the logarithm of the likelihood ratio.
"""

from __future__ import annotations

SAME = 11.0
"""Difference of T² / σ0² below which two causes cannot be told apart: above it, one of them is
exp(11/2) = 245 times as likely as the other. A wrong one is ahead of the true one by so much with a
probability of at most 1 in 245. This holds for each rival: of k rivals, any is ahead by so much
with a probability of up to k in 245, less where they are like one another."""
FARTHEST = 1000.0
"""Largest test value of an error for which the linear model of the tests holds."""
SEPARABLE = SAME / FARTHEST**2
"""Smallest 1 − ρ² of test values that can tell two errors apart: with less, even an error of the
size of `FARTHEST` leaves T² of both different by less than `SAME`. Rounding is smaller by far."""


def separability_tolerance(evidence: float) -> float:
    """Return how much less evidence another error may have and still not be told from this one.

    max(½ `SAME`, `SEPARABLE` · evidence), in the unit of evidence, −ln of a probability.

    Evidence is half a T², so it is half of `SAME`. Of errors with one component it is reached where
    (1 − ρ²) T² is, so that it also decides whether something tells of two errors at all: with a
    correlation of ±1 their T² differ by rounding alone.
    """
    return max(0.5 * SAME, SEPARABLE * evidence)

"""Times of arrivals, and the peak of memory."""

from __future__ import annotations

import resource
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Spread:
    """What some seconds are."""

    n: int
    """How many they are."""
    median: float
    """Median, seconds."""
    high: float
    """99 per cent are not longer, seconds."""
    longest: float
    """Maximum, seconds."""

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Spread:
        """Return the spread of some seconds; NaN where there are none."""
        if not len(seconds):
            return cls(0, float("nan"), float("nan"), float("nan"))
        median, high = np.quantile(seconds, [0.5, 0.99])
        return cls(len(seconds), float(median), float(high), float(np.max(seconds)))

    def __str__(self) -> str:
        """Return a part of a line."""
        return (
            f"median {self.median:.3f} s, 99 % {self.high:.3f} s, maximum {self.longest:.3f} s "
            f"(n {self.n})"
        )


def peak() -> float:
    """Return the peak of the resident memory of this process, megabytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

"""Coverage of motions of photos: ``python -m tests.benchmarks.rolling_shutter [REPETITIONS]``.

Simulates and adjusts a drone block of a rolling shutter with other errors each time, and prints for
each component which share of intervals of 95 % covers the true motion, and the variance of the
errors divided by their standard deviations.
"""

from __future__ import annotations

import sys

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from tests.networks.rolling_drone import errors_of_motions, flown, measured

NORMAL_95 = 1.959964


def main(repetitions: int) -> None:
    """Print the figures."""
    plan = flown(4, 3, 200)
    found = np.array(
        [errors_of_motions(plan, fga.adjust(measured(plan, s))) for s in range(repetitions)]
    )
    covered = np.abs(found) < NORMAL_95
    n = covered[..., 0].size
    print(f"{repetitions} repetitions of {len(plan.photos)} photos")
    for i, name in enumerate(UNKNOWNS["photo_motion"].names()):
        share, variance = 100 * covered[..., i].mean(), (found[..., i] ** 2).mean()
        print(f"{name:5s} {share:6.2f} % ± {100 * np.sqrt(0.95 * 0.05 / n):.2f}, {variance:.3f}")
    print(f"all   {100 * covered.mean():6.2f} %, {(found**2).mean():.3f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 400)

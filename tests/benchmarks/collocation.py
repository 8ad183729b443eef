"""Collocation against known truth over many seeds: errors before and after, coverage of σ.

    python -m tests.benchmarks.collocation [SEEDS]

A block of heights that its rises determine up to a shift is placed on control with a signal, see
`tests/networks/deformed_heights.py`. Heights of the other points are corrected in SEEDS (200)
blocks: by point corrections with the true and with an estimated covariance function, and by
signals as variables. Printed are RMS errors, the mean square of error/σ, which is 1 for a right σ,
and how often an error is within 1.96 σ, which is 0.95.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

import factorgraph_adj as fga
from tests.networks.deformed_heights import SIGNAL, levelled


class Coverage(NamedTuple):
    """Errors of corrected points against their σ."""

    rms: float
    """RMS error, metres."""
    mean_square: float
    """Mean square of error/σ."""
    covered: float
    """Share of errors within 1.96 σ."""


WAYS = ("not corrected", "true function", "estimated function", "signals as variables")
"""What is done with each block."""


def coverage(seeds: range) -> dict[str, Coverage]:
    """Return errors of new points and how σ covers them, by what is done with the blocks."""
    new = np.arange(1, 30, 2)
    names = [f"P{i}" for i in new]
    errors: dict[str, list[np.ndarray]] = {way: [] for way in WAYS}
    sigmas: dict[str, list[np.ndarray]] = {way: [] for way in WAYS}
    for seed in seeds:
        network, _, truth = levelled(seed)
        solution = fga.adjust(network)
        errors[WAYS[0]].append(solution.state["point"][new, 2] - truth[new])
        sigmas[WAYS[0]].append(np.array([solution.standard_deviations(n)[2] for n in names]))
        for way, height in ((WAYS[1], SIGNAL), (WAYS[2], SIGNAL.kind)):
            found = fga.point_corrections(
                solution, covariance=None, height=height, trend="mean", alpha=1.0
            )
            errors[way].append(found.coordinates[new, 2] - truth[new])
            sigmas[way].append(found.sigmas[new, 2])
        at_once = fga.adjust(
            fga.with_signals(network, covariance=None, height=SIGNAL, points=names)
        )
        z = np.array([at_once.point(n + "+s")[2] for n in names])
        errors[WAYS[3]].append(z - truth[new])
        sigmas[WAYS[3]].append(np.array([at_once.standard_deviations(n + "+s")[2] for n in names]))
    out = {}
    for way in WAYS:
        e = np.array(errors[way])
        ratio = e / np.array(sigmas[way])
        out[way] = Coverage(
            float(np.sqrt(np.mean(e**2))),
            float(np.mean(ratio**2)),
            float(np.mean(np.abs(ratio) < 1.96)),
        )
    return out


def main(seeds: int) -> None:
    """Print the coverage over a number of seeds."""
    print(f"{'':22}{'rms mm':>9}{'mean square':>13}{'within 1.96 σ':>15}")
    for way, c in coverage(range(seeds)).items():
        print(f"{way:22}{1000 * c.rms:9.1f}{c.mean_square:13.2f}{c.covered:15.3f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)

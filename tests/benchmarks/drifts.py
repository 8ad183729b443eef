"""Drifts that stand at no point: ``python -m tests.benchmarks.drifts [DRIFTS …]``.

Every ten photos of a simulated aerial block have a shift and a drift of their own, and all share an
unknown lever arm. Prints CPU seconds of the adjustment and of its redundancy numbers, one run.
"""

from __future__ import annotations

import sys
import time

import factorgraph_adj as fga
from tests.networks.drifting_block import drifting_block

DRIFTS = (50, 100, 300)


def main() -> None:
    """Print a line for each number of drifts."""
    for drifts in map(int, sys.argv[1:] or DRIFTS):
        network = drifting_block(drifts)
        start = time.process_time()
        solution = fga.adjust(network)
        adjusted = time.process_time()
        numbers = fga.reliability(solution).redundancy_numbers
        quality = time.process_time() - adjusted
        print(
            f"  {drifts} drifts, {len(network.photos)} photos, u {solution.n_unknowns}: adjustment "
            f"{adjusted - start:.2f} s, {solution.iterations} iterations, quality {quality:.2f} s, "
            f"Σr − r {float(numbers.sum()) - solution.redundancy:.1e}",
            flush=True,
        )


if __name__ == "__main__":
    main()

"""Random small networks in many orders: ``python -m tests.benchmarks.orders FIRST N``.

Prints one line of JSON: what N networks from a seed on came to, see tests/support/orders.py.
Every network arrives in several ways, and once more with gross errors, which only must not end in
an error of the program. Findings go to standard error, one a line.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from dataclasses import asdict, dataclass
from time import perf_counter

from tests.networks.random_small import random_network
from tests.support.orders import Finding, errors, study


@dataclass(frozen=True)
class Orders:
    """What some networks came to."""

    networks: int
    observations: int
    inside: int
    """Observations that are in, in the end."""
    counts: dict[str, int]
    """Number of findings by what they are."""
    from_batch: float
    """Largest difference from the batch adjustment, relative to σ, where both have a minimum."""
    between: float
    """Largest difference between two ways that came to the same minimum, relative to σ."""
    findings: list[str]
    seconds: float


def run(first: int, n: int, *, orders: int = 1) -> Orders:
    """Let networks arrive."""
    begin = perf_counter()
    found: list[Finding] = []
    inside = observations = 0
    from_batch = between = 0.0
    for seed in range(first, first + n):
        result = study(random_network(seed), orders=orders)
        new = [*result.findings, *errors(seed)]
        for finding in new:
            print(finding, file=sys.stderr, flush=True)
        found += new
        inside, observations = inside + result.n_inside, observations + result.n_observations
        from_batch = max(from_batch, result.from_batch)
        between = max(between, result.between)
    return Orders(
        n,
        observations,
        inside,
        dict(Counter(f.what for f in found)),
        from_batch,
        between,
        [str(f) for f in found],
        perf_counter() - begin,
    )


def main() -> None:
    """Print one line of JSON."""
    first, n = map(int, sys.argv[1:])
    print(json.dumps(asdict(run(first, n))))


if __name__ == "__main__":
    main()

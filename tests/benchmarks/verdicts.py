"""Verdicts against predictions from the batch: ``python -m tests.benchmarks.verdicts …``.

``random FIRST N`` takes N random networks from a seed on, ``network NAME SEED`` a test network in a
random order. Prints one line of JSON: how far the figures of verdicts at random moments are from
those of `predict` on the batch adjustment, see tests/support/predicted.py. What is beyond `BOUND`
goes to standard error, one a line.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from time import perf_counter

from tests.networks.arriving import CASES
from tests.networks.random_small import random_network
from tests.support.predicted import BOUND, Compared, verdicts_of_drawn, verdicts_of_network

MOMENTS = 5
"""Observations of each network that are compared."""


@dataclass(frozen=True)
class Verdicts:
    """What the comparison came to; differences as in `Compared`."""

    moments: int
    w: float
    t2: float
    redundancy: float
    innovation: float
    sigma: float
    beyond: list[str]
    """Moments with a difference beyond `BOUND`."""
    errors: list[str]
    """Networks whose arrival ended in an error."""
    seconds: float


FIGURES = ("w", "t2", "redundancy", "innovation", "sigma")


def gather(networks: Iterable[tuple[str, Iterable[Compared]]]) -> Verdicts:
    """Compare verdicts of networks."""
    begin = perf_counter()
    found: list[Compared] = []
    errors: list[str] = []
    for name, compared in networks:
        try:
            for c in compared:
                found.append(c)
                if not c.largest <= BOUND:
                    print(c, file=sys.stderr, flush=True)
        except Exception as error:  # the rest of the networks is looked at all the same
            errors.append(f"{name}: {type(error).__name__}: {error}")
            print(errors[-1], file=sys.stderr, flush=True)
    largest = {n: max((getattr(c, n) for c in found), default=0.0) for n in FIGURES}
    beyond = [str(c) for c in found if not c.largest <= BOUND]
    return Verdicts(
        len(found), **largest, beyond=beyond, errors=errors, seconds=perf_counter() - begin
    )


def main() -> None:
    """Print one line of JSON."""
    what, name, number = sys.argv[1:]
    if what == "random":
        seeds = range(int(name), int(name) + int(number))
        drawn = (random_network(seed) for seed in seeds)
        found = gather((f"network {d.seed}", verdicts_of_drawn(d, MOMENTS)) for d in drawn)
    else:
        network = CASES[name].make()
        found = gather([(name, verdicts_of_network(name, network, int(number), MOMENTS))])
    print(json.dumps(asdict(found)))


if __name__ == "__main__":
    main()

"""Simulated causes of misfits: ``python -m tests.benchmarks.causes [CASES [CAUSE …]]``.

Each case is a building site with one error, at a random place, of ten times the smallest size that
a test detects there. Prints of how many cases the cause comes first, how often it is among the
first three, and in how many cases without an error anything is reported as likelier than a single
reading.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count as count_from

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Observation
from factorgraph_adj.quality.causes.search import Causes, explanations
from factorgraph_adj.quality.reliability import noncentrality
from tests.networks.building_site import site
from tests.support.spoiled import EXCHANGES, SIZED, Spoiled

CASES = 100
"""Number of cases of each cause."""
TIMES = 10.0
"""Size of an error, in units of the smallest one that a test detects."""
ALPHA, POWER = 0.001, 0.80


@dataclass(frozen=True)
class Counted:
    """What became of the cases of a cause."""

    cases: int
    first: int
    three: int
    named: int
    """Cases in which it was told to be likelier than any single reading."""


def adjusted(network: Network, readings: Sequence[Observation]) -> Network:
    """Return the network with its readings."""
    out = network.copy()
    out.add(*readings)
    return out


def searched(network: Network) -> Causes:
    """Return the causes that are found in a network."""
    found = fga.snoop(network, alpha=ALPHA).causes
    return Causes(fga.adjust(network), (), 0.0, 0, ALPHA) if found is None else found


def place_of(found: Causes, spoiled: Spoiled) -> int | None:
    """Return the place of the true cause in a list; none: it is not there."""
    for i, c in enumerate(found.found):
        if c.cause == spoiled.cause and spoiled.where in c.where:
            return i
    return None


def detectable(cause: str, seed: int) -> float:
    """Return the smallest size that is detected at the place where a seed puts a cause."""
    probe = spoiled(cause, seed, 0.0)
    solution = fga.adjust(adjusted(probe.network, probe.readings))
    for c in explanations(solution):
        if c.cause == probe.cause and probe.where in c.where:
            return noncentrality(ALPHA, POWER) * float(np.max(c.sigma))
    return np.nan


def spoiled(cause: str, seed: int, size: float) -> Spoiled:
    """Return a site with one error."""
    network, readings, true = site(seed)
    out = Spoiled(network, readings, true, np.random.default_rng([seed, 1]))
    (SIZED | EXCHANGES)[cause](out, size)
    return out


def count(cause: str, cases: int) -> Counted:
    """Look for a cause in simulated cases."""
    first = three = named = done = 0
    for seed in determined(cases):
        size = 0.0
        if cause in SIZED:
            size = TIMES * detectable(cause, seed)
            if not np.isfinite(size):
                continue
        case = spoiled(cause, seed, size)
        done += 1
        try:
            found = searched(adjusted(case.network, case.readings))
        except fga.AdjustmentError as error:
            print(f"  {cause}, seed {seed}: {str(error).splitlines()[0]}", file=sys.stderr)
            continue
        place = place_of(found, case)
        first += place == 0
        three += place is not None and place < 3
        named += place is not None and found.found[place] in found.likelier
        if place != 0:
            print(
                f"  {cause}, seed {seed}, size {size:.4g}, {case.where}: {place}", file=sys.stderr
            )
            for c in found.found[:3]:
                print(f"      {c.evidence:.1f} {c}", file=sys.stderr)
    return Counted(done, first, three, named)


def false_alarms(cases: int) -> int:
    """Return in how many cases without an error a cause is told."""
    found = (searched(adjusted(*site(seed)[:2])) for seed in determined(cases))
    return sum(bool(c.likelier) for c in found)


def determined(cases: int) -> Iterator[int]:
    """Iterate over seeds of sites whose readings determine every point."""
    found = 0
    for seed in count_from(0):
        if found == cases:
            return
        network, readings, true = site(seed)
        seen = {n for o in readings for n in o.points()}
        with suppress(fga.AdjustmentError):
            if seen == set(true) and fga.adjust(adjusted(network, readings)).converged:
                found += 1
                yield seed


def main() -> None:
    """Print the table."""
    cases = int(sys.argv[1]) if len(sys.argv) > 1 else CASES
    print(f"{'cause':20}{'cases':>6}{'first':>6}{'first 3':>8}{'told':>6}")
    for cause in sys.argv[2:] or [*SIZED, *EXCHANGES]:
        c = count(cause, cases)
        print(f"{cause:20}{c.cases:6}{c.first:6}{c.three:8}{c.named:6}", flush=True)
    if not sys.argv[2:]:
        print(f"without an error: a cause is told in {false_alarms(cases)} of {cases} cases")


if __name__ == "__main__":
    main()

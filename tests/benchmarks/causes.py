"""Simulated causes of misfits: ``python -m tests.benchmarks.causes [CASES [CAUSE …]]``.

Each case is a building site, or a photo block, with one error at a random place, of ten times the
smallest size that a test detects there. Prints of how many cases the cause comes first, how often
it is among the first three, how often it is told, and in how many cases without an error anything
is reported as more probable than a single reading.

What nothing tells of is no case: an error whose test has no redundancy, and an exchange of readings
that no others control. Where another cause changes the readings in the same way, so that both have
the same T² whatever was read, none comes first by right; these cases are counted apart as well
(``same``), whether the true one is listed first or not.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count as count_from

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Observation
from factorgraph_adj.quality.causes.cause_search import Causes, sized_causes
from factorgraph_adj.quality.reliability import noncentrality
from tests.networks.building_site import site
from tests.networks.photo_block import block
from tests.support.spoiled import EXCHANGES, PHOTOS, SIZED, Spoiled

CASES = 100
"""Number of cases of each cause."""
TIMES = 10.0
"""Size of an error, in units of the smallest one that a test detects."""
ALPHA, POWER = 0.001, 0.80
SAME = 1e-6
"""Largest relative difference of T² of causes that are the same to all readings."""


@dataclass(frozen=True)
class Counted:
    """What became of the cases of a cause."""

    cases: int
    first: int
    three: int
    same: int
    """Cases in which another cause is the same to all readings."""
    named: int
    """Cases in which it was told to be more probable than any single reading."""


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


def same(found: Causes, place: int) -> bool:
    """Return whether another cause changes the readings as the one at a place does."""
    true = found.found[place]
    others = (c for c in found.found if c is not true and c.cause != true.cause)
    return any(c.dof == true.dof and abs(c.t2 - true.t2) < SAME * true.t2 for c in others)


def detectable(cause: str, seed: int) -> float:
    """Return the smallest size that is detected at the place where a seed puts a cause."""
    probe = spoiled(cause, seed, 0.0)
    solution = fga.adjust(adjusted(probe.network, probe.readings))
    for c in sized_causes(solution):
        if c.cause == probe.cause and probe.where in c.where:
            return noncentrality(ALPHA, POWER) * float(np.max(c.sigma))
    return np.nan


def controlled(cause: str, seed: int) -> bool:
    """Return whether others control any of the readings that an exchange concerns."""
    places = spoiled(cause, seed, 0.0).ids
    network = without_error(cause, seed)
    ids = network.network.copy().add(*network.readings)
    solution = fga.adjust(adjusted(network.network, network.readings))
    rows = np.concatenate(solution.equations.find([ids[i] for i in places]))
    return bool(fga.reliability(solution).controlled[rows].any())


def without_error(cause: str, seed: int) -> Spoiled:
    """Return the site or the block of a seed."""
    return Spoiled.block(seed) if cause in PHOTOS else Spoiled.site(seed)


def spoiled(cause: str, seed: int, size: float) -> Spoiled:
    """Return a site or a block with one error."""
    out = without_error(cause, seed)
    (SIZED | EXCHANGES | PHOTOS)[cause](out, size)
    return out


def count(cause: str, seeds: Iterable[int]) -> Counted:
    """Look for a cause in simulated cases."""
    first = three = as_good = named = done = 0
    for seed in seeds:
        size = 0.0
        if cause in SIZED:
            size = TIMES * detectable(cause, seed)
            if not np.isfinite(size):
                continue
        if cause in EXCHANGES and not controlled(cause, seed):
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
        as_good += place is not None and same(found, place)
        named += place is not None and found.found[place] in found.more_probable
        if place != 0:
            told(f"{cause}, seed {seed}, size {size:.4g}, {case.where}: {place}", found)
    return Counted(done, first, three, as_good, named)


def told(what: str, found: Causes) -> None:
    """Print the first causes that were found."""
    print(f"  {what}", file=sys.stderr)
    for c in found.found[:3]:
        print(f"      {c.evidence:.1f} {c}", file=sys.stderr)


def false_alarms(cases: int, *, photos: bool = False) -> int:
    """Return in how many cases without an error a cause is told."""
    out = 0
    for seed in range(cases) if photos else determined(cases):
        network, readings = (block(seed), []) if photos else site(seed)[:2]
        found = searched(adjusted(network, readings))
        out += bool(found.more_probable)
        if found.more_probable:
            told(f"without an error, seed {seed}", found)
    return out


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
    print(f"{'cause':20}{'cases':>6}{'first':>6}{'first 3':>8}{'same':>5}{'told':>5}")
    for cause in sys.argv[2:] or [*SIZED, *EXCHANGES, *PHOTOS]:
        c = count(cause, range(cases) if cause in PHOTOS else determined(cases))
        print(f"{cause:20}{c.cases:6}{c.first:6}{c.three:8}{c.same:5}{c.named:5}", flush=True)
    if not sys.argv[2:]:
        for what, photos in (("sites", False), ("photo blocks", True)):
            told_of = false_alarms(cases, photos=photos)
            print(f"{what} without an error: a cause is told in {told_of} of {cases} cases")


if __name__ == "__main__":
    main()

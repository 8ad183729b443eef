"""Random days against the batch: ``python -m tests.benchmarks.days [FIRST N]``.

Plays 2 000 seeded days of small networks (`tests.support.days`): mixed kinds, groups, removals and
gross errors. Prints the largest deviation of a state from `adjust` of the same observations, in
σ, the number of moments outside the promise, and of those with a lower minimum; what is outside
goes to standard error, one a line.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from dataclasses import asdict, dataclass
from time import process_time

import numpy as np

from tests.support.days import Compared, play

DAYS = 2_000


@dataclass(frozen=True)
class Days:
    """What some days came to."""

    days: int
    moments: int
    compared: int
    """Moments with a minimum to compare with."""
    largest: float
    """Largest deviation of an estimate before `settle`, relative to σ."""
    largest_of_sigmas: float
    """The same of a standard deviation."""
    largest_settled: float
    """Largest deviation of either after `settle`."""
    outside: int
    """Moments outside the promise."""
    told: int
    """Moments beyond its bounds at which the solution tells that points fit at two places."""
    beyond: dict[str, int]
    """Moments before `settle` with a deviation of more than some shares of the promise."""
    lower: int
    """Moments before `settle` at which `adjust` from scratch ends in a lower minimum."""
    lower_settled: int
    """The same after `settle`."""
    errors: list[str]
    """Days that ended in an error of the program."""
    unlike: dict[str, int]
    """Why moments were not compared."""
    seconds: float


def run(first: int, n: int) -> Days:
    """Play days from a seed on."""
    begin = process_time()
    found: list[Compared] = []
    errors: list[str] = []
    for seed in range(first, first + n):
        try:
            for c in play(seed):
                found.append(c)
                if c.beyond or (c.lower and c.settled) or c.unlike.startswith("no solution"):
                    print(c, file=sys.stderr, flush=True)
        except Exception as error:  # the other days are played all the same
            errors.append(f"day {seed}: {type(error).__name__}: {error}")
            print(errors[-1][:300], file=sys.stderr, flush=True)
    like = [c for c in found if not c.unlike]
    alone = [c for c in like if not c.rounding and not (c.beyond and c.elsewhere)]
    early = [c for c in alone if not c.settled]
    late = [c for c in alone if c.settled]
    return Days(
        n,
        len(found),
        len(like),
        max((c.estimates for c in early), default=0.0),
        max((c.sigmas for c in early), default=0.0),
        max((c.largest for c in late), default=0.0),
        sum(c.outside for c in like),
        sum(c.beyond and c.elsewhere for c in like),
        {f"{x:g}": int(np.sum([c.largest > x for c in early])) for x in (1e-4, 1e-3, 5e-3, 1e-2)},
        sum(c.lower > 0 for c in like if not c.settled),
        sum(c.lower > 0 for c in like if c.settled),
        errors,
        dict(Counter(c.unlike.partition(":")[0] for c in found if c.unlike)),
        process_time() - begin,
    )


def main() -> None:
    """Print one line of JSON."""
    first, n = map(int, sys.argv[1:]) if sys.argv[1:] else (0, DAYS)
    print(json.dumps(asdict(run(first, n)), ensure_ascii=False))


if __name__ == "__main__":
    main()

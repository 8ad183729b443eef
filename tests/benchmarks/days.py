"""Random days against the batch: ``python -m tests.benchmarks.days [FIRST N [ENGINE]]``.

Plays 2 000 seeded days of small networks (`tests.support.days`): mixed kinds, groups, removals and
gross errors. Prints the largest deviation of a state from `adjust` of the same observations, in
σ, the number of moments outside the promise, and of those with a lower minimum; what is outside
goes to standard error, one a line.

ENGINE is ``isam2``, ``fronts``, or ``both``: every day is played on both, and their verdicts are
compared until they differ.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from time import process_time
from typing import get_args

import numpy as np

from factorgraph_adj.incremental.arrival import Arrival
from factorgraph_adj.ledger.command_input import ENGINES, Engine
from tests.support.days import Compared, play
from tests.support.two_engines import NEAR, Pair, pairs

DAYS = 2_000
BOTH: tuple[Engine, ...] = ("isam2", "fronts")


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


@dataclass(frozen=True)
class VerdictsCompared:
    """Verdicts of the same days on both engines."""

    verdicts: int
    """Verdicts on both."""
    largest: float
    """Largest difference of test values, in units of the critical value or of a larger one."""
    beyond: int
    """Test values that are further apart than `NEAR`."""
    near: int
    """Verdicts that differ within `NEAR` of the critical value."""
    unlike: list[str]
    """Other verdicts that differ."""


def gathered(found: Sequence[tuple[int, Pair]]) -> VerdictsCompared:
    """Compare verdicts of days."""
    for seed, p in found:
        if not p.same or not p.difference <= NEAR:
            print(f"day {seed}: {p}", file=sys.stderr, flush=True)
    finite = [p.difference for _, p in found if p.same]
    return VerdictsCompared(
        len(found),
        max(finite, default=0.0),
        sum(not d <= NEAR for d in finite),
        sum(not p.same and p.critical for _, p in found),
        [f"day {seed}: {p}" for seed, p in found if not p.same and not p.critical],
    )


def played(
    first: int, n: int, engines: Sequence[Engine]
) -> tuple[list[Days], list[tuple[int, Pair]]]:
    """Play days from a seed on, on some engines; return verdicts on the first two side by side."""
    found: dict[Engine, list[Compared]] = {e: [] for e in engines}
    errors: dict[Engine, list[str]] = {e: [] for e in engines}
    seconds = dict.fromkeys(engines, 0.0)
    verdicts: list[tuple[int, Pair]] = []
    for seed in range(first, first + n):
        arrivals: list[list[Arrival]] = [[] for _ in engines]
        for engine, mine in zip(engines, arrivals, strict=True):
            begin = process_time()
            try:
                for c in play(seed, engine, mine):
                    found[engine].append(c)
                    if c.beyond or (c.lower and c.settled) or c.unlike.startswith("no solution"):
                        print(f"{engine}: {c}", file=sys.stderr, flush=True)
            except Exception as error:  # the other days are played all the same
                errors[engine].append(f"day {seed}: {type(error).__name__}: {error}")
                print(f"{engine}: {errors[engine][-1][:300]}", file=sys.stderr, flush=True)
            seconds[engine] += process_time() - begin
        if len(engines) > 1:
            verdicts += [(seed, p) for p in pairs(*arrivals[:2])]
    return [_days(n, found[e], errors[e], seconds[e]) for e in engines], verdicts


def _days(n: int, found: list[Compared], errors: list[str], seconds: float) -> Days:
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
        seconds,
    )


def main() -> None:
    """Print one line of JSON for each engine, and one of their verdicts."""
    first, n = map(int, sys.argv[1:3]) if sys.argv[1:] else (0, DAYS)
    (asked,) = sys.argv[3:] or ("auto",)
    if asked not in (*ENGINES, "both"):
        raise SystemExit(f"unknown engine {asked}; known: {', '.join(ENGINES)}, both")
    engines = BOTH if asked == "both" else tuple(e for e in get_args(Engine) if e == asked)
    days, verdicts = played(first, n, engines)
    for engine, found in zip(engines, days, strict=True):
        print(json.dumps({"engine": engine, **asdict(found)}, ensure_ascii=False))
    if len(engines) > 1:
        print(json.dumps(asdict(gathered(verdicts)), ensure_ascii=False))


if __name__ == "__main__":
    main()

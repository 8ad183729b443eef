"""All networks in all orders against the batch: ``python -m tests.benchmarks.equality NAME ORDER``.

With ENGINE behind them one of the engines carries them instead of ``auto``. Prints one line of JSON
for one network in one order (``file`` or the seed of a random one): the largest differences while
it arrives, with observations taken out and put in again, and settled. See
tests/incremental/test_equality.py, whose networks they are.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import get_args

from factorgraph_adj.ledger.command_input import Engine
from tests.networks.arriving import CASES
from tests.support.arrivals import Moment


@dataclass(frozen=True)
class Equality:
    """What one network in one order came to."""

    moments: int
    arriving: tuple[float, float, float]
    """Largest difference of estimates and standard deviations, relative to σ, and of redundancy
    numbers, while it arrives."""
    settled: tuple[float, float, float]
    """The same after `settle`."""
    promise: float
    """The largest of them in units of what is promised."""
    without: int
    """Moments at which the batch adjustment does not come to rest."""
    waiting: int
    """Observations that wait in the end."""
    seconds: float


def networks() -> Iterator[tuple[str, tuple[int | None, ...]]]:
    """Return all networks, and the orders in which they arrive."""
    for name, case in CASES.items():
        yield name, case.orders


def worst(found: Sequence[Moment]) -> tuple[float, float, float]:
    """Return the largest differences."""
    return (
        max((m.estimates for m in found), default=0.0),
        max((m.sigmas for m in found), default=0.0),
        max((m.redundancy for m in found), default=0.0),
    )


def study(name: str, order: int | None, engine: Engine) -> Equality:
    """Let a network arrive."""
    begin = perf_counter()
    case = CASES[name]
    found = list(case.play(order, case.moments, engine=engine))
    return Equality(
        len(found),
        worst([m for m in found if not m.settled]),
        worst([m for m in found if m.settled]),
        max(m.promise for m in found),
        sum(bool(m.no_batch) for m in found),
        found[-1].n_waiting,
        perf_counter() - begin,
    )


def main() -> None:
    """Print one line of JSON."""
    name, order, *asked = sys.argv[1:]
    (engine,) = [e for e in get_args(Engine) if e in asked] or ("auto",)
    print(json.dumps(asdict(study(name, None if order == "file" else int(order), engine))))


if __name__ == "__main__":
    main()

"""A long life of one adjustment: seeded events, one after the other.

As a program: ``python -m tests.support.soak EVENTS [SEED]`` prints a line at every thousandth
event, with the deviations from the batch adjustment and the memory.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from typing import TypeVar

import numpy as np

from factorgraph_adj.ledger.verdicts import Policy
from tests.support.events import EVENTS
from tests.support.watched import Checked, Watched

MOST = 350
"""Observations that are there at a time, about."""
TRIES = 50
"""Draws after which no observation that fits is found."""
T = TypeVar("T")


class Seeded:
    """Choices of a seeded generator, see `tests.support.events.Choices`."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def whole(self, low: int, high: int) -> int:
        return int(self.rng.integers(low, high))

    def real(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def chance(self, probability: float) -> bool:
        return float(self.rng.random()) < probability

    def error(self) -> float:
        return float(self.rng.normal(0.0, 1.0))

    def fitting(self, what: Sequence[T], fits: Callable[[T], bool]) -> T | None:
        drawn = (what[self.whole(0, len(what))] for _ in range(TRIES))
        return next((item for item in drawn if fits(item)), None)


class Soak:
    """Seeded events on a site."""

    def __init__(self, seed: int, policy: Policy = "flag") -> None:
        self.choose = Seeded(seed)
        self.site = Watched(seed, policy)

    def step(self) -> None:
        """Play one event, drawn by its weight."""
        weights = np.array([w for w, _ in EVENTS])
        if len(self.site.there) > MOST:  # more goes than comes
            weights[0], weights[1] = weights[1], weights[0]
        drawn = self.choose.rng.choice(len(EVENTS), p=weights / weights.sum())
        event = EVENTS[int(drawn)][1]
        self.site.play(event.__name__, lambda: event(self.site, self.choose))

    def compare(self) -> Checked:
        """Compare with the batch adjustment."""
        return self.site.compare()


# -- as a program ---------------------------------------------------------------------------------

EVERY = 1000
"""Events between two comparisons."""


def resident() -> float:
    """Return the resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def main(events: int, seed: int = 1) -> None:
    """Play events, compare with the batch at every thousandth, and print."""
    soak = Soak(seed)
    begin = perf_counter()
    print(
        f"  {'events':>8}{'in graph':>10}{'wait':>6}{'x / σ':>10}{'σ':>10}"
        f"{'settled x':>11}{'σ':>10}{'MB':>7}{'s':>8}"
    )
    for _ in range(events):
        soak.step()
        if soak.site.n % EVERY == 0:
            c = soak.compare()
            print(
                f"  {c.event:8d}{c.observations:10d}{soak.site.inc.n_waiting:6d}{c.estimates:10.1e}"
                f"{c.sigmas:10.1e}{c.settled_estimates:11.1e}{c.settled_sigmas:10.1e}"
                f"{resident():7.0f}{perf_counter() - begin:8.0f}",
                flush=True,
            )
    print("  " + ", ".join(f"{k} {n}" for k, n in sorted(soak.site.done.items())))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))

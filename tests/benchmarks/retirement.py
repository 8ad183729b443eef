"""A survey vehicle that keeps its last photos, compared with the batch adjustment of its drive:
``python -m tests.benchmarks.retirement [SECONDS [KEEP [RAYS]]]``; and the bound of what linear rows
miss, compared with what they miss, in random networks: ``… --networks N``.

At some moments everything that has arrived until then is adjusted at once, from where it is, and
the estimates and standard deviations of what remains are compared with that, relative to σ; at the
end after `settle`, and after everything was taken back.

In each of N networks of every kind and movement (`tests.networks.moved_after_retirement`) the bound
is divided by the largest change of an unknown, relative to its σ, when everything is taken back.
Changes below `LEAST_MISSED` are those of convergence and are left out.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from time import process_time

import numpy as np

import factorgraph_adj as fga

from ..networks.moved_after_retirement import (
    KINDS,
    MOVEMENTS,
    moved_after_retirement,
    truly_missed,
)
from .vehicle import Drive

SECONDS, KEEP, RAYS = 240.0, 40, 40
MOMENTS = 6
"""Number of moments at which a batch adjustment is made."""
ACCURACY = 0.01
"""What is promised of estimates, σ."""
LEAST_MISSED = 1e-5
"""Smallest change that is compared with its bound, σ."""
QUANTILES = (0.0, 0.01, 0.1, 0.5, 0.9, 0.99, 1.0)
"""Quantiles of the ratios that are printed."""


def batch_of(inc: fga.IncrementalAdjustment) -> fga.Solution:
    """Return the batch adjustment of everything that is in the graph, and was retired."""
    return fga.adjust(inc.network(), tolerance=1e-8)


def off(
    inc: fga.IncrementalAdjustment, batch: fga.Solution, names: Iterable[str]
) -> tuple[float, float]:
    """Return the largest differences of estimates and of σ, relative to σ."""
    step = wider = 0.0
    for name in names:
        sigma = batch.standard_deviations(name)
        on = sigma > 0
        if on.any():
            there = np.abs(inc.estimate(name) - batch.point(name))[on] / sigma[on]
            step = max(step, float(there.max()))
            ratio = inc.standard_deviations(name)[on] / sigma[on]
            wider = max(wider, float(np.abs(ratio - 1.0).max()))
    return step, wider


def compared(inc: fga.IncrementalAdjustment, when: str, *, everything: bool = False) -> None:
    """Print how far an adjustment is from the batch."""
    try:
        batch = batch_of(inc)
    except fga.AdjustmentError as error:  # as it is, a weak point has no place to begin at
        print(f"  {when:>12}: no batch adjustment: {str(error).splitlines()[0]}")
        return
    names = batch.network.points if everything else inc.solution().network.points
    step, wider = off(inc, batch, names)
    retired, bound = inc.retired, inc.missed_step
    photos = 0 if retired is None else retired.photos
    print(
        f"  {when:>12}{photos:9d} photos retired; estimates {step:.1e} σ, σ {wider:.1e}; bound of "
        f"the linear rows {bound:.1e} σ; redundancy {inc.redundancy - batch.redundancy:+d}",
        flush=True,
    )


def study(seconds: float, keep: int, rays: int) -> None:
    """Drive, and print how far everything is from the batch."""
    road = Drive(seconds, rays=rays, seed=2)
    inc = fga.IncrementalAdjustment(road.network(), keep=keep)
    moments = list(np.linspace(0.4, 1.0, MOMENTS, endpoint=False) * seconds)
    for event in road.events():
        inc.add(event.observations, points=event.points, photos=event.photos)
        if moments and event.time >= moments[0]:
            compared(inc, f"{moments.pop(0):.0f} s")
    compared(inc, "the end")
    inc.settle()
    compared(inc, "settled")
    begin = process_time()
    inc.settle(all=True)
    print(f"  {process_time() - begin:.1f} s of CPU to take everything back")
    compared(inc, "taken back", everything=True)


def compare_bounds(number: int) -> None:
    """Print the bound of what linear rows miss over what they miss, in random networks."""
    every: list[tuple[float, float]] = []
    for kind in KINDS:
        for movement in MOVEMENTS:
            pairs = []
            for seed in range(number):
                inc = moved_after_retirement(seed, kind, movement)
                bound = inc.missed_step
                pairs.append((bound, truly_missed(inc)))
            _print_ratios(f"{kind}, {movement}", pairs)
            every += pairs
    _print_ratios("all of them", every)


def _print_ratios(what: str, pairs: Sequence[tuple[float, float]]) -> None:
    """Print the quantiles of bounds over what was missed."""
    bounds, missed = np.array([p for p in pairs if p[1] > LEAST_MISSED]).reshape(-1, 2).T
    if not len(missed):
        print(f"{what}: nothing was missed")
        return
    ratio = bounds / missed
    silent = int(((bounds <= ACCURACY) & (missed > ACCURACY)).sum())
    print(
        f"{what}: {len(ratio)} networks; missed {np.median(missed):.1e} σ (median), "
        f"{missed.max():.1e} (largest); bound/missed at {QUANTILES}: "
        f"{np.quantile(ratio, QUANTILES).round(2).tolist()}; bound below what was missed: "
        f"{int((ratio < 1.0).sum())}, of more than {ACCURACY} σ without a word: {silent}",
        flush=True,
    )


if __name__ == "__main__" and sys.argv[1:2] == ["--networks"]:
    compare_bounds(int(sys.argv[2]))
elif __name__ == "__main__":
    given = sys.argv[1:]
    study(
        float(given[0]) if given else SECONDS,
        int(given[1]) if len(given) > 1 else KEEP,
        int(given[2]) if len(given) > 2 else RAYS,
    )

"""A survey vehicle that keeps its last photos, compared with the batch adjustment of its drive:
``python -m tests.benchmarks.retirement [SECONDS [KEEP [RAYS]]]``.

At some moments everything that has arrived until then is adjusted at once, from where it is, and
the estimates and standard deviations of what remains are compared with that, relative to σ; at the
end after `settle`, and after everything was taken back.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from time import process_time

import numpy as np

import factorgraph_adj as fga

from .vehicle import Drive

SECONDS, KEEP, RAYS = 240.0, 40, 40
MOMENTS = 6
"""Number of moments at which a batch adjustment is made."""


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
    solution, retired = inc.solution(), inc.retired
    bound = 0.0 if retired is None else retired.missed_at(solution.equations, solution.state)
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


if __name__ == "__main__":
    given = sys.argv[1:]
    study(
        float(given[0]) if given else SECONDS,
        int(given[1]) if len(given) > 1 else KEEP,
        int(given[2]) if len(given) > 2 else RAYS,
    )

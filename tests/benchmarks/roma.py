"""Roma photo by photo: ``python -m tests.benchmarks.roma ORDER [PHOTOS]``.

ORDER is ``file``, the seed of a random order, or ``all``. The first `FIRST` photos, which hold the
datum between them, are there at the beginning; the others arrive one by one, each with all its
rays: in file order, or in a random one, where a photo that nothing joins to the rest yet waits.
With ``all`` all 90 561 rays are there at the beginning; then photos are taken out and come back.

After some arrivals the same network is adjusted by the batch from its solution, with the
reliability of every observation: what a user would do without the incremental adjustment. All
seconds are CPU seconds.
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Iterator, Sequence
from time import process_time

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint

from ..networks.dbat import read_roma
from .timing import Spread, peak
from .worker import ROMA

FIRST = 19
"""Photos that are there at the beginning: the first holds the datum, the last of them the scale."""
TAKEN_OUT = 10
"""Photos that are taken out and come back where all are there."""
EVERY = 5
"""Arrivals from one comparison with the batch to the next."""


def order_of(name: str, photos: int) -> list[int]:
    """Return the numbers of the photos that arrive, in their order.

    Args:
        name: ``file``, ``all`` or a seed.
        photos: number of photos.
    """
    if name == "all":
        return np.linspace(1, photos - 1, TAKEN_OUT).astype(int).tolist()
    late = np.arange(FIRST, photos)
    return (late if name == "file" else np.random.default_rng(int(name)).permutation(late)).tolist()


def first_part(network: Network, name: str) -> Network:
    """Return the network with the rays that are there at the beginning."""
    out = network.copy()
    if name != "all":
        photo, _, _, _ = network.images.columns()
        out.image_mask(photo < FIRST)
    return out


def batch(inc: fga.IncrementalAdjustment) -> tuple[float, float]:
    """Return the CPU seconds of a warm adjustment, and of the reliability after it."""
    start, network = inc.solution(), inc.network()
    begin = process_time()
    solution = fga.adjust(network, start=start)
    adjusted = process_time()
    found = fga.reliability(solution)
    assert len(found.redundancy_numbers)
    return adjusted - begin, process_time() - adjusted


def arrivals(
    network: Network, name: str, inc: fga.IncrementalAdjustment, *, most: int | None = None
) -> Iterator[tuple[str, int, float, float]]:
    """Let photos arrive.

    Args:
        network: all of it.
        name: ``file``, ``all`` or a seed.
        inc: the first part of it.
        most: how many photos; none: all of them.

    Yields:
        Name of the photo, number of its rays, CPU seconds for taking them out (``all``), and for
        their arrival.
    """
    photo, _, _, _ = network.images.columns()
    rows = list(network.image_points())
    names = list(network.photos)
    for k in order_of(name, len(names))[:most]:
        mine: Sequence[ImagePoint] = [rows[i] for i in np.flatnonzero(photo == k).tolist()]
        begin = process_time()
        if name == "all":
            inc.remove([f"{o.photo}/{o.point}" for o in mine])
        middle = process_time()
        inc.add(mine)
        yield names[k], len(mine), middle - begin, process_time() - middle


def main(name: str, most: int | None = None) -> None:
    """Let Roma arrive, and print what it takes."""
    network = read_roma(ROMA)
    whole = fga.adjust(network)
    begin = process_time()
    inc = fga.IncrementalAdjustment(first_part(network, name), start=whole)
    print(
        f"  order {name}: begins in {process_time() - begin:.2f} s, "
        f"{len(inc)} in, {inc.n_waiting} wait"
    )
    taken: list[float] = []
    removals: list[float] = []
    warm: list[tuple[float, float]] = []
    for number, (photo, rays, out, seconds) in enumerate(arrivals(network, name, inc, most=most)):
        taken.append(seconds)
        removals.append(out)
        compared = ""
        if number % EVERY == 0 and len(inc):
            warm.append(batch(inc))
            compared = "; adjust {:.2f} s, reliability {:.2f} s".format(*warm[-1])
        removed = f"out {out:.2f} s, " if name == "all" else ""
        print(
            f"  photo {photo:>3}: {rays:5d} rays, {removed}{seconds:5.2f} s; {len(inc)} in, "
            f"{inc.n_waiting} wait, {len(inc.suspects)} suspects{compared}",
            flush=True,
        )
    if name == "all":
        print(f"  taken out: {Spread.of(removals)}")
    print(f"  arrivals: {Spread.of(taken)}")
    middle, largest = statistics.median(map(sum, warm)), max(map(sum, warm))
    print(
        f"  adjust and reliability: median {middle:.2f} s, maximum {largest:.2f} s; arrivals take "
        f"{statistics.median(taken) / middle:.1f} times the median, at most "
        f"{max(taken) / largest:.1f} times the maximum; {peak():.0f} MB"
    )


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "file", *map(int, sys.argv[2:3]))

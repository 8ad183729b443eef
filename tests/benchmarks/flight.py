"""Cost of GNSS/INS, drifts and mounts in the block of IGN: python -m tests.benchmarks.flight.

The block of 68 photos is adjusted with weighted poses, then with the same information as observed
positions and attitudes, of which a mount, and a shift, a drift and a drift of attitudes of each of
five strips are unknown. Both run in turn; the ratio of the medians of their CPU times is printed,
which is to be at most 1.3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from statistics import median
from time import process_time

import factorgraph_adj as fga
from factorgraph_adj.observations import ControlPoint, NavigationAttitude
from tests.loaders.borea import Block, read_borea
from tests.networks.borea_flight import (
    SHIFTED,
    SIGMA_ATTITUDE,
    SIGMA_GNSS,
    TURNS,
    Flight,
    flown,
    plan_of,
)
from tests.support.places import data_dir

MOST = 1.3
"""Largest ratio."""
RUNS = 15


def with_flight(block: Block) -> fga.Network:
    """Return the block with observed positions and attitudes, a mount and drifts."""
    flight = Flight(mount=TURNS, control=11, drift=SHIFTED, navigation=True)
    network = flown(plan_of(block, flight), 1, measured_images=True)
    rates = ("rx_t", "ry_t", "rz_t")
    for strip in block.strips:
        network.set_attitude_drift(strip, free=rates)
    time = {p.name: (p.strip, float(p.number)) for p in block.photos.values()}
    for ident, o in network.observations.items():
        if isinstance(o, NavigationAttitude):
            strip, at = time[o.photo]
            middle = sum(p.number for p in block.strips[strip]) / len(block.strips[strip])
            network.observations[ident] = replace(o, drift=strip, time=at - middle)
    return network


def with_weights(block: Block) -> fga.Network:
    """Return the block with weighted poses."""
    flight = flown(plan_of(block, Flight(control=11)), 1, measured_images=True)
    network = block.network()
    network.add(*(o for o in flight.observations.values() if isinstance(o, ControlPoint)))
    weights = {"sigma_position": (SIGMA_GNSS,) * 3, "sigma_attitude": float(SIGMA_ATTITUDE)}
    network.photos = {n: replace(f, **weights) for n, f in network.photos.items()}
    return network


def seconds(work: Callable[[], object]) -> float:
    """Return the CPU time of a call."""
    begin = process_time()
    work()
    return process_time() - begin


def ratio(block: Block, runs: int = RUNS) -> tuple[float, float, float]:
    """Return the median CPU times with weights and with the flight, and their ratio."""
    weighted, flown_ = with_weights(block), with_flight(block)
    first, second = [], []
    for _ in range(runs + 1):
        first.append(seconds(lambda: fga.adjust(weighted)))
        second.append(seconds(lambda: fga.adjust(flown_)))
    one, other = median(first[1:]), median(second[1:])
    return one, other, other / one


if __name__ == "__main__":
    one, other, times = ratio(read_borea(data_dir("borea")))
    print(f"weighted poses {one:.3f} s, GNSS/INS with mount and drifts {other:.3f} s, CPU")
    print(f"ratio {times:.2f}, at most {MOST}: {'yes' if times <= MOST else 'NO'}")

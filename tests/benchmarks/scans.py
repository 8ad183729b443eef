"""Scanner stations with polar points: ``python -m tests.benchmarks.scans [STATIONS] [SIGHTS]``.

Stations stand on the floor of a hall, 10 m apart; each point is sighted from two, three or four of
the nearest stations with a direction, a zenith angle and a distance. Six points are held, nothing
else has approximate values. Prints CPU seconds of every stage, one run.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

import factorgraph_adj as fga
from factorgraph_adj.observations import FrameDirection, FrameDistance, FrameZenith
from factorgraph_adj.quality.reliability import Reliability
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC

STATIONS, SIGHTS = 200, 100_000
SPACING = 10.0
"""Distance between neighbouring stations, metres."""
CEILING = 6.0
"""Height of the hall, metres."""
SIGMA_ANGLE, SIGMA_DISTANCE = 5.0 * ARCSEC, 1e-3
HELD = 6


@dataclass
class Hall:
    """Where stations and points are, and who sights whom."""

    places: Array
    """True coordinates of the points, (p, 3) metres."""
    stations: Array
    """Stations, (s, 3) metres."""
    turns: Array
    """Rotations of the instruments, frame → object, (s, 3, 3)."""
    station: Array
    """Station of each sight, (n,)."""
    point: Array
    """Point of each sight, (n,)."""
    q: Array = field(init=False)
    """Targets in the frame of their instrument, (n, 3)."""

    def __post_init__(self) -> None:
        """Compute the targets in the frames."""
        d = self.places[self.point] - self.stations[self.station]
        self.q = np.einsum("nji,nj->ni", self.turns[self.station], d)


def hall(stations: int, sights: int, *, seed: int = 1) -> Hall:
    """Return a hall of a number of stations, in which there are a number of sights."""
    rng = np.random.default_rng(seed)
    rows = max(1, round(np.sqrt(stations / 2)))
    grid = np.array([(i // rows, i % rows) for i in range(stations)], dtype=float)
    at = np.column_stack(
        [SPACING * grid + rng.uniform(-1, 1, (stations, 2)), np.full(stations, 1.6)]
    )
    times = rng.integers(2, 5, sights)
    times = times[: np.searchsorted(np.cumsum(times), sights - 4)]
    low, high = at[:, :2].min(axis=0) - 5.0, at[:, :2].max(axis=0) + 5.0
    xy = rng.uniform(low, high, (len(times), 2))
    places = np.column_stack([xy, rng.uniform(0.0, CEILING, len(times))])
    near = cKDTree(at).query(places, k=4)[1]
    chosen = np.arange(4) < times[:, None]
    point, _ = np.nonzero(chosen)
    station = near[chosen]
    order = np.argsort(station, kind="stable")
    turns = exp_rotation(
        np.column_stack([0.02 * rng.normal(size=(stations, 2)), rng.uniform(-3, 3, stations)])
    )
    return Hall(places, at, turns, station[order], point[order])


def network_of(hall: Hall, *, seed: int = 1) -> fga.Network:
    """Return the network of a hall with simulated measurements."""
    rng = np.random.default_rng(seed)
    network = fga.Network("hall")
    near_ends = np.argsort(hall.places[:, 0])
    held = {*near_ends[: HELD // 2].tolist(), *near_ends[-HELD // 2 :].tolist()}
    first = np.flatnonzero(hall.station == 0)[:HELD]  # three of one station start the search
    held |= set(hall.point[first].tolist())
    for i, x in enumerate(hall.places.tolist()):
        network.add_point(f"P{i}", x if i in held else None, fixed="xyz" if i in held else "")
    for s, x in enumerate(np.round(hall.stations).tolist()):
        network.add_frame(f"S{s}", origin=x)
    q = hall.q
    across = np.hypot(q[:, 0], q[:, 1])
    n = len(q)
    length = np.linalg.norm(q, axis=1)
    directions = np.arctan2(q[:, 0], q[:, 1]) + SIGMA_ANGLE * rng.normal(size=n)
    directions %= 2 * np.pi
    zeniths = np.arctan2(across, q[:, 2]) + SIGMA_ANGLE * rng.normal(size=n)
    distances = length + SIGMA_DISTANCE * rng.normal(size=n)
    frames = [f"S{s}" for s in hall.station.tolist()]
    points = [f"P{p}" for p in hall.point.tolist()]
    for kind, values, sigma in (
        (FrameDirection, directions, SIGMA_ANGLE),
        (FrameZenith, zeniths, SIGMA_ANGLE),
        (FrameDistance, distances, SIGMA_DISTANCE),
    ):
        network.add(
            *(
                kind(f, p, v, sigma=sigma)
                for f, p, v in zip(frames, points, values.tolist(), strict=True)
            )
        )
    return network


def main() -> None:
    """Print what every stage takes."""
    given = [int(a) for a in sys.argv[1:]] + [STATIONS, SIGHTS][len(sys.argv) - 1 :]
    made = hall(*given)

    def timed(what: str, work: Callable[[], object]) -> object:
        start = time.process_time()
        found = work()
        print(f"  {what:24}{time.process_time() - start:8.2f} s", flush=True)
        return found

    network = timed("observations, network", lambda: network_of(made))
    assert isinstance(network, fga.Network)
    solution = timed("adjustment", lambda: fga.adjust(network))
    assert isinstance(solution, fga.Solution)
    rel = timed("redundancy numbers", lambda: fga.reliability(solution))
    assert isinstance(rel, Reliability)
    numbers = timed("  of all observations", lambda: rel.redundancy_numbers)
    print(
        f"  n {solution.n_observations}, u {solution.n_unknowns}, iterations "
        f"{solution.iterations}, σ̂0 {solution.sigma0:.4f}, Σr − r "
        f"{float(np.sum(numbers)) - solution.redundancy:.1e}"
    )


if __name__ == "__main__":
    main()

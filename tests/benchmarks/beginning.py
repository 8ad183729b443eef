"""Beginning with networks of which much is not determined.

An `IncrementalAdjustment` begins with a network; what is not determined waits. Compared with that
is the adjustment of the determined part, in one process, alternating, by medians of CPU time:

    python -m tests.benchmarks.beginning
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from time import process_time

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Direction, Observation, PhotoPosition, SlopeDistance
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from factorgraph_adj.units import ARCSEC

from ..networks.dbat import read_roma
from ..support.places import data_dir
from .grids import SPACING, simulate_grid

ROUNDS = 7
"""How often each is measured."""
SIGMA_DIRECTION = 2.0 * ARCSEC
SIGMA_DISTANCE = 1e-3


def half_of_roma() -> Network:
    """Return Roma with 30 of its 60 photos; 12 016 points have no ray yet, 1 820 one."""
    network = read_roma(data_dir("dbat_roma"))
    network.image_mask(network.images.columns()[0] < len(network.photos) // 2)
    return network


def _with(network: Network, kept: Callable[[Observation], bool]) -> Network:
    """Return a network with some of its observations."""
    network.observations = {i: o for i, o in network.observations.items() if kept(o)}
    return network


def grid_of_single_distances(points: int = 900) -> Network:
    """Return a grid, and half as many points more, which one distance alone reaches."""
    network = simulate_grid(1, points=points).network
    for i, name in enumerate(list(network.points)[: points // 2]):
        network.add_point(f"late {i}")
        network.add(SlopeDistance(name, f"late {i}", 40.0, sigma=SIGMA_DISTANCE))
    return network


def grid_of_directions(points: int = 900) -> Network:
    """Return a grid in whose last third only directions have been measured."""
    network = simulate_grid(1, points=points).network
    side = round(np.sqrt(points))
    late = {f"{i}-{j}" for i in range(side) for j in range(side - side // 3, side)}
    return _with(
        network,
        lambda o: isinstance(o, Direction) or late.isdisjoint(o.points()),
    )


def loose_strips(image_points: int = 40_000, in_photo: int = 500) -> Network:
    """Return a block whose last strips have neither GNSS positions nor tie points between them."""
    network = simulate_aerial_block(1, image_points=image_points, points_per_photo=in_photo).network
    x = np.array([p.position[0] for p in network.photos.values() if p.position is not None])
    gaps = np.sort(x)[1:][np.diff(np.sort(x)) > 20.0]
    strip = np.searchsorted(gaps, x + 1.0)
    loose = strip > strip.max() // 2
    photo, point, _, _ = network.images.columns()
    at = np.array([p.coordinates[0] for p in network.points.values()])
    middles = np.array([x[strip == s].mean() for s in range(strip.max() + 1)])
    home = np.abs(at[:, None] - middles).argmin(axis=1)
    late = loose[photo] | (home[point] > strip.max() // 2)
    network.image_mask(~late | (home[point] == strip[photo]))
    names = {n for n, out in zip(network.photos, loose, strict=True) if out}
    return _with(network, lambda o: not (isinstance(o, PhotoPosition) and o.photo in names))


def unknown_stations(points: int = 400, stations: int = 400) -> Network:
    """Return a grid and stations with directions to four of its points, whose height is unknown."""
    network = simulate_grid(1, points=points).network
    side = round(np.sqrt(points))
    rng = np.random.default_rng(points)
    for k in range(stations):
        i, j = rng.integers(0, side - 1, 2).tolist()
        network.add_point(f"S{k}")
        at = SPACING * np.array([i + 0.5, j + 0.4])
        turn = rng.uniform(0.0, 6.0)
        for a, b in ((i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)):
            d = np.array(network.points[f"{a}-{b}"].coordinates[:2]) - at
            value = float(np.arctan2(d[0], d[1]) - turn) % (2.0 * np.pi)
            network.add(Direction(f"S{k}", f"{a}-{b}", value, sigma=SIGMA_DIRECTION))
    return network


NETWORKS: dict[str, Callable[[], Network]] = {
    "Roma, 30 of 60 photos": half_of_roma,
    "grid of 1350 points, a third with one distance": grid_of_single_distances,
    "grid of 900 points, a third with directions alone": grid_of_directions,
    "aerial block, half of its strips not tied": loose_strips,
    "grid of 400 points, 400 stations without heights": unknown_stations,
}


def main() -> None:
    """Print the table."""
    for title, make in NETWORKS.items():
        network = make()
        begun = fga.IncrementalAdjustment(network)
        part = begun.network()
        times: tuple[list[float], list[float]] = ([], [])
        for _ in range(ROUNDS):
            for seconds, run in zip(times, (fga.IncrementalAdjustment, fga.adjust), strict=True):
                given = network if run is fga.IncrementalAdjustment else part
                start = process_time()
                run(given)
                seconds.append(process_time() - start)
        begin, adjust = map(median, times)
        print(
            f"{title:50} {len(begun):6} in, {begun.n_waiting:6} wait; begins in {begin:.2f} CPU s, "
            f"adjustment of the determined part {adjust:.2f} CPU s: {begin / adjust:.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()

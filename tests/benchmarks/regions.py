"""Networks of the size of a state, in parts: ``python -m tests.benchmarks.regions CASE …``.

CASE is ``states`` (stations with GNSS vectors and levelling) or ``photos`` (aerial photos, 70 %
overlap along and 40 % across). Every part is simulated by the process that adjusts it, so that no
process ever holds the whole network.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from functools import partial

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownForwardLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import GnssVector, HeightDifference
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.types import Array, Index

STATION = 2000.0
"""Metres between stations."""
SIGMA_VECTOR = (0.005, 0.005, 0.010)
"""Standard deviations of the components of GNSS vectors, metres."""
SIGMA_LEVELLED = 0.002
"""Standard deviation of levelled height differences, metres."""
EVERY = 4
"""Every how many columns vectors go north, and every how many rows lines are levelled east."""
CONTROL = 50
"""Every how many stations in each direction one is held."""

HEIGHT = 150.0
"""Flying height, metres."""
SENSOR = (36.0, 24.0)
"""Width of the sensor across and along the strip, mm."""
CALIBRATION = {"c": 35.1, "x0": 0.04, "y0": -0.03}
"""True calibration, mm; it is free, and all photos share it."""
BASE = np.array([0.6, 0.3]) * HEIGHT / CALIBRATION["c"] * np.array(SENSOR)
"""Distance of projection centres across and along the strips, metres."""
PER_PHOTO = 1000
"""Image points in a photo."""
SIGMA_IMAGE = 2e-3
"""Standard deviation of image coordinates, mm."""


def tile(number: int, tiles: tuple[int, int], sides: tuple[int, int]) -> tuple[range, range]:
    """Return the rows and columns of a tile of a grid."""
    out = []
    for at, k, n in zip(divmod(number, tiles[1]), tiles, sides, strict=True):
        cuts = np.linspace(0, n, k + 1).round().astype(int).tolist()
        out.append(range(cuts[at], cuts[at + 1]))
    return out[0], out[1]


def station(i: Index, j: Index) -> Array:
    """Return the true positions of stations (n, 3), metres."""
    x = STATION * (i + 0.2 * np.sin(12.9898 * i + 78.233 * j))
    y = STATION * (j + 0.2 * np.sin(39.425 * i + 27.169 * j))
    return np.stack([x, y, 500.0 + 300.0 * np.sin(0.05 * i) * np.cos(0.07 * j)], axis=1)


def states(number: int, tiles: tuple[int, int], side: int) -> Network:
    """Return a tile of a square of stations: vectors and levelled lines to its neighbours.

    The neighbours of the last row and column are stations of the next tiles.
    """
    rows, columns = tile(number, tiles, (side, side))
    rng = np.random.default_rng([1, number, side])
    network = Network(f"states {number}")
    i, j = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
    lines = {
        "east": (1, 0, np.ones(len(i), dtype=bool), True),
        "north": (0, 1, i % EVERY == 0, True),
        "levelled north": (0, 1, np.ones(len(i), dtype=bool), False),
        "levelled east": (1, 0, j % EVERY == 0, False),
    }
    ends = [(i, j)]
    for di, dj, on, _ in lines.values():
        on &= (i + di < side) & (j + dj < side)
        ends.append((i[on] + di, j[on] + dj))
    every = np.unique(np.concatenate([np.stack(e, axis=1) for e in ends]), axis=0)
    disturbed = station(*every.T) + np.sin(every.sum(axis=1) * 7.7)[:, None]
    for (a, b), at, true in zip(
        every.tolist(), disturbed.tolist(), station(*every.T).tolist(), strict=True
    ):
        held = a % CONTROL == 0 and b % CONTROL == 0
        network.add_point(f"{a}-{b}", true if held else at, fixed="xyz" if held else "")
    for di, dj, on, is_vector in lines.values():
        way = station(i[on] + di, j[on] + dj) - station(i[on], j[on])
        noise = rng.normal(size=way.shape)
        for a, b, v, e in zip(i[on].tolist(), j[on].tolist(), way, noise, strict=True):
            start, end = f"{a}-{b}", f"{a + di}-{b + dj}"
            if is_vector:
                x, y, z = (v + e * SIGMA_VECTOR).tolist()
                network.add(GnssVector(start, end, (x, y, z), sigma=SIGMA_VECTOR))
            else:
                dh = float(v[2] + e[2] * SIGMA_LEVELLED)
                network.add(HeightDifference(start, end, dh, sigma=SIGMA_LEVELLED))
    return network


def photos(number: int, tiles: tuple[int, int], sides: tuple[int, int]) -> Network:
    """Return the photos over a tile of ground, with their image points there.

    Photos at the edges of a tile see points of the next tiles too, and belong to several parts.
    """
    rows, columns = tile(number, tiles, sides)
    low = BASE * [rows.start - 0.5, columns.start - 0.5]
    high = BASE * [rows.stop - 0.5, columns.stop - 0.5]
    rng = np.random.default_rng([2, number, *sides])
    footprint = HEIGHT / CALIBRATION["c"] * np.array(SENSOR)
    n = round(PER_PHOTO * float(np.prod((high - low) / footprint)))
    points = np.column_stack([rng.uniform(low, high, (n, 2)), rng.uniform(-10.0, 10.0, n)])
    reach = np.ceil(0.5 * footprint / BASE).astype(int) + 1
    network = Network(f"photos {number}")
    network.add_camera(
        "camera",
        BrownForwardLens(),
        {"c": 35.0},
        free=["c", "x0", "y0"],
    )
    names = np.array([f"p{number}-{k}" for k in range(n)])
    order = np.lexsort((points[:, 1], np.floor((points[:, 0] - low[0]) / BASE[0])))
    points, names = points[order], names[order]
    seen = np.zeros(n, dtype=int)
    measured: list[tuple[str, Index, Array]] = []
    poses: list[tuple[str, Array, Array, Array]] = []
    for i in range(max(rows.start - reach[0], 0), min(rows.stop + reach[0], sides[0])):
        near = np.flatnonzero(np.abs(points[:, 0] - i * BASE[0]) < 0.7 * footprint[0])
        of_strip = points[near]
        for j in range(max(columns.start - reach[1], 0), min(columns.stop + reach[1], sides[1])):
            own = np.random.default_rng([3, i, j])
            centre = np.array([i * BASE[0], j * BASE[1], HEIGHT]) + own.normal(0, 0.5, 3)
            angles = own.normal(0, 0.005, 3)
            rotation = world_R_camera(*angles)
            on = np.flatnonzero(np.abs(of_strip[:, 1] - centre[1]) < 0.6 * footprint[1])
            d = (of_strip[on] - centre) @ rotation
            c, x0, y0 = CALIBRATION.values()
            xy = np.stack([x0 + c * d[:, 0] / d[:, 2], y0 - c * d[:, 1] / d[:, 2]], axis=1)
            inside = (np.abs(xy) < 0.5 * np.array(SENSOR)).all(axis=1)
            if not inside.any():
                continue
            at = near[on[inside]]
            seen[at] += 1
            name = f"{i}-{j}"
            measured.append((name, at, xy[inside] + rng.normal(0, SIGMA_IMAGE, (len(at), 2))))
            poses.append((name, centre, angles + own.normal(0, 0.003, 3), own.normal(0, 0.05, 3)))
    good = seen >= 2
    for (name, at, _), (_, centre, angles, error) in zip(measured, poses, strict=True):
        use = good[at]
        if not use.any():
            continue
        network.add_photo(
            name,
            "camera",
            position=centre + error,
            omega_phi_kappa=tuple(angles),
            sigma_position=0.05,
        )
    network.add_points(names[good].tolist(), points[good] + rng.normal(0, 0.3, (good.sum(), 3)))
    for name, at, xy in measured:
        use = good[at]
        if use.any():
            network.add_image_points(name, names[at[use]].tolist(), xy[use], sigma=SIGMA_IMAGE)
    return network


def run(
    name: str,
    make: Callable[[int], Network],
    n_parts: int,
    workers: int,
    memory: str,
) -> None:
    """Adjust simulated parts on a local cluster, and print what it takes."""
    from distributed import Client, LocalCluster

    parts = [fga.Part(f"{k + 1}", partial(make, k)) for k in range(n_parts)]
    with (
        LocalCluster(
            n_workers=workers, threads_per_worker=1, memory_limit=memory, dashboard_address=":0"
        ) as cluster,
        Client(cluster) as client,
    ):
        began = time.perf_counter()
        marks = [began]
        found = fga.adjust_parts(
            parts,
            client=client,
            name=name,
            progress=lambda *_: marks.append(time.perf_counter()),
        )
        seconds = time.perf_counter() - began
    each = np.diff(marks[1:])
    peak = max(p.memory for p in found.quality.parts) / 1e9
    root = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    largest = max(len(c) for c in found.junctions.columns)
    rest = began + seconds - marks[-1]
    print(
        f"  {name:14}{n_parts:6d}{workers:8d}{found.n_observations:13d}{found.n_unknowns:12d}"
        f"{found.junctions.n_columns:10d}{largest:9d}{found.iterations:6d}"
        f"{marks[1] - began:9.1f}{float(np.median(each)) if len(each) else 0.0:9.1f}{rest:9.1f}"
        f"{seconds:9.1f}{found.received / 1e6:10.0f}{found.sent / 1e6:9.0f}{peak:8.2f}{root:8.2f}"
        f"{found.sigma0:9.5f}{found.sum_of_redundancy_numbers - found.redundancy:10.1e}"
        f"  {'' if found.converged else found.reason}",
        flush=True,
    )


def heading() -> None:
    """Print the head of the table."""
    print(
        f"  {'':14}{'parts':>6}{'workers':>8}{'scalar obs.':>13}{'unknowns':>12}{'junctions':>10}"
        f"{'largest':>9}{'iter.':>6}{'first s':>9}{'s/iter.':>9}{'rest s':>9}{'total s':>9}"
        f"{'MB in':>10}{'MB out':>9}{'GB part':>8}{'GB root':>8}{'σ̂0':>9}{'Σr − r':>10}"
    )


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.regions")
    parser.add_argument("case", choices=("states", "photos"))
    parser.add_argument("--side", type=int, default=447, help="stations on each side")
    parser.add_argument("--photos", type=int, nargs=2, default=(100, 200), help="strips, in each")
    parser.add_argument("--tiles", type=int, nargs=2, default=(2, 4))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--memory", default="5GB", help="of each worker")
    o = parser.parse_args()
    tiles = (o.tiles[0], o.tiles[1])
    make: Callable[[int], Network]
    if o.case == "states":
        make = partial(states, tiles=tiles, side=o.side)
    else:
        make = partial(photos, tiles=tiles, sides=(o.photos[0], o.photos[1]))
    heading()
    run(o.case, make, tiles[0] * tiles[1], o.workers, o.memory)


if __name__ == "__main__":
    main()

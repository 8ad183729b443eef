"""Reading of large files: ``python -m tests.benchmarks.reading [ROWS [FORMAT …]]``.

Writes simulated files with a tenth of ROWS rows (100 000 if not stated) and with all of them, reads
them in a process that has read a small one before, and prints CPU seconds, microseconds of a row,
and by how much a row of the large file takes longer than one of the small file: 1 is linear.

A row is what the format has most of: an image point, an observation, a line of a table or of a
field book, a number of a covariance matrix.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.frames import GeocentricFrame
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint, GnssVector

from .blocks import simulate_photos_alone
from .grids import simulate_grid

ROWS = 100_000
SMALL = 10
"""By how much the small file is smaller than the large one."""
FEWEST = 10_000
"""Rows of the smallest file."""
ON_EARTH = np.array([6_378_000.0, 0.0, 0.0])
AWAY = np.array([0.0, 0.0, 9.0])
Made = tuple[int, Callable[[], Network]]
"""Number of rows of a file, and what reads it."""


def colmap(folder: Path, rows: int) -> Made:
    """Write a model of COLMAP in binary files; a row is an image point."""
    block = simulate_photos_alone(1, image_points=rows)
    fga.write_colmap(block, folder)
    return len(block.images), lambda: fga.read_colmap(folder)


def metashape(folder: Path, rows: int) -> Made:
    """Write the markers of a block as Metashape does; a row is a projection."""
    block = simulate_photos_alone(1, image_points=rows)
    fga.write_metashape(block, folder / "markers.xml")
    return len(block.images), lambda: fga.read_metashape(folder / "markers.xml")


def bal(folder: Path, rows: int) -> Made:
    """Write a problem of Bundle Adjustment in the Large; a row is an image point."""
    rng = np.random.default_rng(1)
    photos, points = max(rows // 500, 2), rows // 5
    seen = zip(rng.integers(0, photos, rows), rng.integers(0, points, rows), strict=True)
    pairs = sorted({(int(p), int(f)) for f, p in seen})
    lines = [f"{photos} {points} {len(pairs)}"]
    lines += [
        f"{f} {p} {x:.6e} {y:.6e}"
        for (p, f), (x, y) in zip(pairs, rng.normal(0, 300, (len(pairs), 2)), strict=True)
    ]
    lines += ["0\n0\n0\n0\n0\n0\n800\n0\n0"] * photos
    lines += ["\n".join(f"{v:.9e}" for v in xyz) for xyz in rng.normal(0, 1, (points, 3)) - AWAY]
    (folder / "problem.txt").write_text("\n".join(lines) + "\n")
    return len(pairs), lambda: fga.read_bal(folder / "problem.txt")


def project(folder: Path, rows: int) -> Made:
    """Write the tables of a terrestrial project; a row is an observation."""
    grid = simulate_grid(1, points=rows // 8).network
    fga.write_project(grid, folder / "project.toml")
    return len(grid.observations), lambda: fga.read_project(folder)


def dynaml(folder: Path, rows: int) -> Made:
    """Write GNSS vectors as DynaML; a row is a component of a vector."""
    rng = np.random.default_rng(1)
    n = rows // 6
    network = Network("vectors", frame=GeocentricFrame())
    at = rng.normal(0, 1000.0, (n, 3)) + ON_EARTH
    for i, xyz in enumerate(at.tolist()):
        network.add_point(f"P{i}", tuple(xyz), fixed="xyz" if i == 0 else "")
    for i in range(2 * n):
        a, b = i % n, (i + 1 + i // n) % n
        d = tuple((at[b] - at[a]).tolist())
        network.add(GnssVector(f"P{a}", f"P{b}", d, sigma=(0.004, 0.003, 0.005), id=f"v{i}"))
    fga.write_dynaml(network, folder / "net")
    return 6 * n, lambda: fga.read_dynaml(folder / "net")


def sinex(folder: Path, rows: int) -> Made:
    """Write positions with a joint covariance as SINEX; a row is one of its numbers."""
    rng = np.random.default_rng(1)
    n = int(np.sqrt(2 * rows) / 3)
    network = Network("positions", frame=GeocentricFrame())
    some = []
    for i, xyz in enumerate((rng.normal(0, 1000.0, (n, 3)) + ON_EARTH).tolist()):
        network.add_point(f"P{i:03d}", tuple(xyz))
        some.append(ControlPoint(f"P{i:03d}", tuple(xyz), sigma=(0.01, 0.01, 0.01)))
    a = rng.normal(0, 0.01, (3 * n, 3 * n))
    network.add(fga.Correlated(tuple(some), a @ a.T + 1e-4 * np.eye(3 * n)))
    fga.write_sinex(network, folder / "net.snx")
    return 3 * n * (3 * n + 1) // 2, lambda: fga.read_sinex(folder / "net.snx")


def gsi(folder: Path, rows: int) -> Made:
    """Write a field book in GSI-16; a row is a sight with three readings."""
    lines, stations = [], max(rows // 100, 1)
    for s in range(stations):
        lines.append(
            f"*110001+{f'S{s}':>016} 84..10+{100000 * s:016d} 85..10+{0:016d} "
            f"86..10+{0:016d} 88..10+{1500:016d}"
        )
        for t in range(rows // stations):
            lines.append(
                f"*110002+{f'T{s}x{t}':>016} 21.102+{t * 400000:016d} 22.102+{10000000:016d} "
                f"31..00+{50000 + t:016d} 87..10+{1500:016d}"
            )
    (folder / "book.gsi").write_text("\n".join(lines) + "\n")
    return len(lines), lambda: fga.read_gsi(folder / "book.gsi")


def columns(folder: Path, rows: int) -> Made:
    """Write a table of slope distances; a row is a line."""
    n = rows // 10
    text = "".join(f"P{i % n},P{(i + 1 + i // n) % n},{100 + i / 7:.4f},2\n" for i in range(rows))
    (folder / "list.csv").write_text("From,To,Obs,SD mm\n" + text)
    mapping = {
        "observations": {
            "station": "From",
            "target": "To",
            "kind": "=slope_distance",
            "value": "Obs",
            "sigma_mm": "SD mm",
        }
    }
    return rows, lambda: fga.read_columns(folder / "list.csv", mapping=mapping)


FORMATS: dict[str, Callable[[Path, int], Made]] = {
    f.__name__.replace("_", "-"): f
    for f in (colmap, metashape, bal, project, dynaml, sinex, gsi, columns)
}


def seconds(make: Callable[[Path, int], Made], rows: int) -> tuple[int, float]:
    """Return the rows of a file and the CPU seconds of reading it."""
    with TemporaryDirectory() as name:
        n, read = make(Path(name), rows)
        start = process_time()
        read()
        return n, process_time() - start


def main(arguments: list[str]) -> None:
    """Print the table."""
    rows = int(arguments[0]) if arguments else ROWS
    print("format       rows        s   µs a row   × the row of a small file")
    for name in arguments[1:] or FORMATS:
        seconds(FORMATS[name], min(FEWEST, rows // SMALL))  # imports
        few, quick = seconds(FORMATS[name], rows // SMALL)
        n, slow = seconds(FORMATS[name], rows)
        each = slow / n
        print(
            f"{name:10} {n:7d} {slow:8.2f} {1e6 * each:10.1f} {each / (quick / few):10.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])

"""The record: what fixed works have taken, version by version, in ``record.csv``.

``python -m tests.benchmarks record`` appends a row for each work. Iterations, linearisations,
fronts and bytes of a work are the same on every machine, so that a test compares them with the
newest row. Seconds depend on the machine; their ratios to a fixed work of numpy, and to pycolmap,
in the same run depend on it less.

``python -m tests.benchmarks.record figures WORK`` and ``… numpy`` are single measurements; each
prints one line of JSON.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.blas_threads import with_one_thread
from factorgraph_adj.io.photogrammetry.bundler import read_bal
from factorgraph_adj.network.network import Network
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from factorgraph_adj.solve.linearised_rays import LinearRays
from factorgraph_adj.version import __version__

from ..support.places import ROOT
from .grids import simulate_grid
from .worker import LADYBUG, ROMA, roma

TABLE = Path(__file__).with_name("record.csv")
"""The table of the repository."""
SPARE_CALLS = 1
"""Number of linearisations by which a work may exceed its record."""
PRODUCTS = 200
"""Number of products of matrices in the fixed work of numpy."""
SIDE = 300
"""Number of rows and columns of these matrices."""
PASSES = 120
"""Number of passes over a long array in the fixed work of numpy."""
LENGTH = 1_000_000
"""Number of elements of the long array."""


@dataclass(frozen=True)
class Work:
    """One network of the record."""

    name: str
    """Name of the work in the table."""
    make: Callable[[], Network]
    """Function that returns the network with its start values."""
    job: tuple[str, ...]
    """Job of ``tests.benchmarks.worker`` that adjusts the network, and its size."""
    data: Path | None = None
    """File or folder that the work reads; none: the network is simulated."""
    colmap: str | None = None
    """Job that adjusts the network with pycolmap; none: there is none."""

    @property
    def missing(self) -> bool:
        """Whether the data of the work are absent."""
        return self.data is not None and not self.data.exists()


def _aerial(size: int) -> Work:
    return Work(
        f"aerial {size}",
        lambda: simulate_aerial_block(1, image_points=size).network,
        ("aerial 70/40", str(size)),
    )


def _grid(size: int) -> Work:
    return Work(f"grid {size}", lambda: simulate_grid(1, points=size).network, ("grid", str(size)))


WORKS = {
    work.name: work
    for work in (
        Work("roma", roma, ("roma",), ROMA, "roma-colmap"),
        Work("ladybug", lambda: read_bal(LADYBUG), ("ladybug",), LADYBUG, "ladybug-colmap"),
        _aerial(10_000),
        _aerial(100_000),
        _grid(100),
        _grid(1_024),
    )
}
"""The works of the record by name."""


# -- what does not depend on the machine -----------------------------------------------------------


@dataclass(frozen=True)
class Figures:
    """The figures of an adjustment that do not depend on the machine."""

    iterations: int
    """Number of iterations."""
    calls: int
    """Number of times that all observations were linearised."""
    largest_front: int
    """Number of nodes of the largest front."""
    fronts: int
    """Number of fronts of the reduced normal matrix."""
    bytes_of_partials: int
    """Bytes of the partials of one linearisation."""


def figures(network: Network) -> Figures:
    """Adjust a network and return its figures."""
    with _counted() as calls:
        solution = adjust(network)
    linearised = len(calls)
    sizes = [front.size for front in solution.factor.fronts.fronts]
    held = 0
    for block in solution.normal().system.blocks:
        arrays = [part.a for part in block.parts] if isinstance(block, LinearRays) else block.a
        held += sum(a.nbytes for a in arrays)
    return Figures(solution.iterations, linearised, max(sizes, default=0), len(sizes), held)


@contextmanager
def _counted() -> Iterator[list[None]]:
    """Count linearisations; the list has one entry for each."""
    calls: list[None] = []
    plain = LinearisedEquations.__init__

    def counting(self: LinearisedEquations, *arguments: Any, **named: Any) -> None:
        calls.append(None)
        plain(self, *arguments, **named)

    with patch.object(LinearisedEquations, "__init__", counting):
        yield calls


# -- the table -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """One row of the table: one work at one version."""

    version: str
    """Version, and the commit where the repository has one."""
    date: str
    """Day of the measurement."""
    work: str
    """Name of the work."""
    iterations: int
    """See `LeaveOneOutFigures`, as the next four."""
    calls: int
    largest_front: int
    fronts: int
    bytes_of_partials: int
    cpu_s: float
    """CPU seconds of the adjustment, median of the rounds."""
    ratio_to_numpy: float
    """Ratio of these CPU seconds to those of the fixed work of numpy."""
    ratio_to_pycolmap: float | None
    """Ratio of these CPU seconds to those of pycolmap; none: pycolmap did not run."""
    quality_cpu_s: float
    """CPU seconds of reliability and covariances, median of the rounds."""
    megabytes: float
    """Peak resident memory of the process with quality."""


COLUMNS = tuple(f.name for f in fields(Row))
"""Columns of the table."""
DIGITS = {"cpu_s": 3, "ratio_to_numpy": 3, "ratio_to_pycolmap": 2, "quality_cpu_s": 3}
"""Decimals of the measured columns; others have none."""


def read(table: Path = TABLE) -> list[Row]:
    """Return the rows of a table, the oldest first; a table that does not exist has none."""
    if not table.exists():
        return []
    with table.open(encoding="utf-8", newline="") as file:
        lines = csv.DictReader(file)
        if tuple(lines.fieldnames or ()) != COLUMNS:
            raise ValueError(f"{table}: columns {lines.fieldnames}; expected: {COLUMNS}")
        return [_row(line) for line in lines]


def append(rows: Sequence[Row], table: Path = TABLE) -> None:
    """Append rows to a table; write its header first if it does not exist."""
    new = not table.exists()
    with table.open("a", encoding="utf-8", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        if new:
            out.writerow(COLUMNS)
        for row in rows:
            out.writerow(_text(name, value) for name, value in asdict(row).items())


def newest(rows: Sequence[Row]) -> dict[str, Row]:
    """Return the last row of each work."""
    return {row.work: row for row in rows}


def worse(found: Figures, record: Row) -> list[str]:
    """Return what got worse than the record, one sentence for each figure."""
    limits = {
        "iterations": (record.iterations, "at most"),
        "calls": (record.calls + SPARE_CALLS, "at most"),
        "largest_front": (record.largest_front, "at most"),
        "fronts": (record.fronts, "exactly"),
        "bytes_of_partials": (record.bytes_of_partials, "exactly"),
    }
    out = []
    for name, (limit, how) in limits.items():
        value = getattr(found, name)
        if value > limit or (how == "exactly" and value != limit):
            out.append(f"{record.work}: {name} is {value}; the record allows {how} {limit}")
    return out


def version() -> str:
    """Return the version, with the commit where the repository has one."""
    command = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return __version__
    return f"{__version__}+{done.stdout.strip()}"


def _row(line: dict[str, str]) -> Row:
    """Return a row from its texts."""
    made: dict[str, Any] = {}
    for f in fields(Row):
        text = line[f.name]
        if f.type == "int":
            made[f.name] = int(text)
        elif f.type == "str":
            made[f.name] = text
        else:
            made[f.name] = float(text) if text else None
    return Row(**made)


def _text(name: str, value: object) -> str:
    if isinstance(value, float):
        return f"{value:.{DIGITS.get(name, 0)}f}"
    return "" if value is None else str(value)


# -- single measurements ---------------------------------------------------------------------------


@with_one_thread
def numpy_work() -> float:
    """Return the CPU seconds of a fixed work: products of matrices, and passes over an array."""
    rng = np.random.default_rng(1)
    a = rng.standard_normal((SIDE, SIDE)) / np.sqrt(SIDE)
    x = rng.standard_normal(LENGTH)
    begin = process_time()
    b = a
    for _ in range(PRODUCTS):
        b = a @ b
        b /= np.linalg.norm(b)
    for _ in range(PASSES):
        x = np.sqrt(x * x + 1.0) - 0.5
    seconds = process_time() - begin
    assert np.isfinite(b).all()
    assert np.isfinite(x).all()
    return seconds


def main(what: str, work: str = "") -> dict[str, Any]:
    """Run one measurement."""
    if what == "numpy":
        return {"cpu": numpy_work()}
    if what == "figures":
        return asdict(figures(WORKS[work].make()))
    raise SystemExit(f"unknown measurement {what!r}")


if __name__ == "__main__":
    print(json.dumps(main(*sys.argv[1:])))

"""One measurement in a process of its own: ``python -m tests.benchmarks.worker JOB [SIZE]``.

Prints one line of JSON. Networks are ready, with approximate values, before the clock starts;
a small block has been adjusted before, so that nothing is imported while it runs.
"""

from __future__ import annotations

import json
import os
import resource
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from time import perf_counter, process_time

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.io.photogrammetry.bundler import read_bal
from factorgraph_adj.network.network import Network
from factorgraph_adj.quality.reliability import Reliability, reliability
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from factorgraph_adj.start.approximate_values import approximate

from ..networks.dbat import read_roma
from ..support.places import DATA
from . import colmap
from .blocks import OVERLAPS, simulate_photos_alone
from .grids import simulate_grid

ROMA = DATA / "dbat_roma"
LADYBUG = DATA / "bal" / "problem-49-7776-pre.txt"


@dataclass(frozen=True)
class Measured:
    """What one run took."""

    seconds: float
    """From the network to the solution."""
    cpu: float
    """The same in seconds of all its threads: fair where others use the machine too."""
    iterations: int
    vtpv: float
    how: str
    """Why it ended."""
    megabytes: float
    """Peak resident memory of the process."""
    idle: float = 0.0
    """The same before the network is made."""
    prepared: float = 0.0
    """Seconds for reading or simulating the network."""
    observations: int = 0
    unknowns: int = 0
    sigma0: float = 0.0
    quality: float = 0.0
    """Seconds for the reliability of every observation and the covariance of every point (ours),
    for the covariances of points, poses and cameras (theirs)."""
    quality_cpu: float = 0.0
    quality_megabytes: float = 0.0
    """Peak resident memory after that."""
    sum_r: float = 0.0
    """Sum of the redundancy numbers, less the redundancy."""

    @property
    def together(self) -> float:
        """CPU seconds of the adjustment and its quality."""
        return self.cpu + self.quality_cpu


def roma() -> Network:
    """Return Roma with points by intersection."""
    network = read_roma(ROMA)
    state = approximate(compile_network(network))
    network.points = {
        name: replace(p, coordinates=tuple(at))
        for (name, p), at in zip(network.points.items(), state["point"].tolist(), strict=True)
    }
    return network


def ours(make: Callable[[], Network]) -> Measured:
    """Time `adjust` and the quality."""
    return adjusted(make)[0]


def adjusted(make: Callable[[], Network]) -> tuple[Measured, Reliability]:
    """Time `adjust` and the quality; return the reliability with its solution too."""
    adjust(simulate_aerial_block(0, image_points=2000, points_per_photo=200).network)
    idle = _peak()
    begin = perf_counter()
    network = make()
    prepared = perf_counter() - begin
    begin, cpu = perf_counter(), process_time()
    solution = adjust(network)
    seconds, cpu = perf_counter() - begin, process_time() - cpu
    peak = _peak()
    begin, again = perf_counter(), process_time()
    found = reliability(solution)
    parts = found.e1, found.e2, found.e12, found.tau, solution.point_covariances
    assert all(len(p) for p in parts)
    quality, quality_cpu = perf_counter() - begin, process_time() - again
    measured = Measured(
        seconds,
        cpu,
        solution.iterations,
        solution.vtpv,
        solution.reason,
        peak,
        idle,
        prepared,
        solution.n_observations,
        solution.n_unknowns,
        solution.sigma0,
        quality,
        quality_cpu,
        _peak(),
        float(found.redundancy_numbers.sum()) - solution.redundancy,
    )
    return measured, found


def theirs(make: Callable[[], Network], *, principal_point: bool) -> Measured:
    """Time pycolmap."""
    threads = len(os.sched_getaffinity(0))
    network = make()
    done = colmap.solve(network, threads=threads, principal_point=principal_point)
    return Measured(
        done.seconds,
        done.cpu,
        done.iterations,
        done.vtpv,
        done.how,
        _peak(),
        quality=done.covariance,
        quality_cpu=done.covariance_cpu,
    )


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def aerial(overlap: str) -> Callable[[int], Measured]:
    """Return the job of a simulated aerial block of a number of image points."""
    return lambda size: ours(
        lambda: simulate_aerial_block(1, image_points=size, overlap=OVERLAPS[overlap]).network
    )


def both(size: int) -> Network:
    """Return the simulated block that pycolmap is given too."""
    return simulate_photos_alone(1, image_points=size)


JOBS: dict[str, Callable[[int], Measured]] = {
    "roma": lambda _: ours(roma),
    "roma-colmap": lambda _: theirs(roma, principal_point=True),
    "ladybug": lambda _: ours(lambda: read_bal(LADYBUG)),
    "ladybug-colmap": lambda _: theirs(lambda: read_bal(LADYBUG), principal_point=False),
    "both": lambda size: ours(lambda: both(size)),
    "both-colmap": lambda size: theirs(lambda: both(size), principal_point=False),
    "grid": lambda size: ours(lambda: simulate_grid(1, points=size).network),
} | {f"aerial {overlap}": aerial(overlap) for overlap in OVERLAPS}
"""What is measured, by name; the argument is the size of simulated networks."""


def main(job: str, size: int = 0) -> Measured:
    """Run one job."""
    if job not in JOBS:
        raise SystemExit(f"unknown job {job!r}; known: {', '.join(JOBS)}")
    return JOBS[job](size)


if __name__ == "__main__":
    print(json.dumps(asdict(main(sys.argv[1], *map(int, sys.argv[2:])))))

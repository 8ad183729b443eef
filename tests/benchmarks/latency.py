"""Time for one arriving observation: ``python -m tests.benchmarks.latency CASE POINTS``.

Some observations of a simulated network are held back and arrive one by one. In the same run and
after the same arrival, others do the work now and then: `adjust` from scratch, `adjust` from the
last state, and GTSAM's iSAM2 with its default options and the factors of `build_graph`, which is
asked for the joint covariance that a test needs. The batch is timed without a test, which flatters
it. Prints one line of JSON.
"""

from __future__ import annotations

import gc
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from time import perf_counter
from typing import Literal, TypeAlias

import gtsam
import numpy as np

from factorgraph_adj.factor_graph.build import build_graph
from factorgraph_adj.incremental.adjustment import IncrementalAdjustment
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint, Observation
from factorgraph_adj.simulation.simulate import SimulatedNetwork
from factorgraph_adj.solve.batch import adjust
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.types import Array, Mask

from .grids import simulate_grid, simulate_mixed

Case: TypeAlias = Literal["terrestrial", "mixed"]
Way: TypeAlias = Literal["arrival", "warm", "scratch", "naive"]
ARRIVALS = 100
SAMPLES: dict[Way, int] = {"warm": 15, "scratch": 5, "naive": 40}
"""How many of the arrivals the others see, up to `MANY` points."""
FEW: dict[Way, int] = {"warm": 5, "scratch": 2, "naive": 5}
"""The same beyond."""
MANY = 3000
RAYS = 4
"""Image points are held back from points with as many rays at least, so that none is lost."""


@dataclass
class Latency:
    """What was measured for one network."""

    case: Case
    points: int
    observations: int
    """Scalar rows."""
    unknowns: int
    loaded: float = 0.0
    """Seconds for the start from a solution."""
    naive_loaded: float = float("nan")
    """Seconds for the first update of naive iSAM2."""
    accepted: int = 0
    off: float = float("nan")
    """Largest difference of a point from the batch at the end, relative to its σ."""
    naive_off: float = float("nan")
    """The same for naive iSAM2."""
    naive_failed: str = ""
    """Why it ended early."""
    seconds: dict[Way, list[float]] = field(default_factory=dict)
    """Of every arrival, in each way."""


class Naive:
    """iSAM2 as its examples have it: default options, nonlinear factors, one update for each.

    What comes together with an observation is its prediction's joint covariance.
    """

    def __init__(self, network: Network, start: Solution, arriving: set[str]) -> None:
        """Load all factors but those of ``arriving``."""
        built = build_graph(network, state=start.state)
        self.keys = built.keys
        self.factor: dict[str, gtsam.NonlinearFactor] = {}
        first = gtsam.NonlinearFactorGraph()
        ids = [i for block in built.equations.blocks for i in block.ids]
        for number in range(built.graph.size()):
            factor = built.graph.at(number)
            if number < len(ids) and ids[number] in arriving:
                self.factor[ids[number]] = factor
            else:
                first.add(factor)
        self.isam = gtsam.ISAM2()
        begin = perf_counter()
        self.isam.update(first, built.values)
        self.estimate = self.isam.calculateEstimate()
        self.loaded = perf_counter() - begin

    def add(self, ident: str) -> None:
        """Let one observation arrive."""
        factor = self.factor[ident]
        factor.linearize(self.estimate)
        self.isam.jointMarginalCovariance(list(factor.keys())).fullMatrix()
        graph = gtsam.NonlinearFactorGraph()
        graph.add(factor)
        self.isam.update(graph, gtsam.Values())
        self.estimate = self.isam.calculateEstimate()

    def point(self, name: str) -> Array:
        """Return the coordinates of a point."""
        return np.array(self.estimate.atVector(self.keys.key("point", name)))


def measure(case: Case, points: int) -> Latency:
    """Time arrivals in one network.

    Args:
        case: terrestrial grid, or photos over a grid.
        points: number of points, about.
    """
    simulated: SimulatedNetwork = (
        simulate_grid(1, points=points)
        if case == "terrestrial"
        else simulate_mixed(1, points=points)
    )
    whole = simulated.network
    rest, arriving = held_back(whole, ARRIVALS)
    solution = adjust(rest)
    out = Latency(case, len(whole.points), whole_rows(solution, arriving), solution.n_unknowns)
    begin = perf_counter()
    inc = IncrementalAdjustment(rest, start=solution)
    out.loaded = perf_counter() - begin
    naive: Naive | None = None
    try:
        naive = Naive(whole, solution, {_id(o) for o in arriving})
        out.naive_loaded = naive.loaded
    except RuntimeError as error:
        out.naive_failed = _first_line(error)
    samples = SAMPLES if points <= MANY else FEW
    turns = {
        way: set(np.linspace(1, len(arriving) - 1, n).astype(int)) for way, n in samples.items()
    }
    seconds: dict[Way, list[float]] = {"arrival": [], "warm": [], "scratch": [], "naive": []}

    def clock(way: Way, begin: float) -> None:
        seconds[way].append(perf_counter() - begin)

    for number, observation in enumerate(arriving):
        gc.collect()
        begin = perf_counter()
        arrival = inc.add(observation)
        clock("arrival", begin)
        out.accepted += arrival.verdicts[0].verdict == "accepted"
        rest.add(observation)
        if number in turns["warm"]:
            begin = perf_counter()
            solution = adjust(rest, start=solution)
            clock("warm", begin)
        if number in turns["scratch"]:
            begin = perf_counter()
            adjust(rest)
            clock("scratch", begin)
        if naive is not None and not out.naive_failed and number < samples["naive"]:
            begin = perf_counter()
            try:
                naive.add(_id(observation))
            except RuntimeError as error:
                out.naive_failed = _first_line(error)
            else:
                clock("naive", begin)
            if number == samples["naive"] - 1 and not out.naive_failed:
                out.naive_off = _largest_difference(naive.point, adjust(rest, start=solution))
    out.seconds = seconds
    if out.accepted == len(arriving):
        out.off = _largest_difference(inc.estimate, adjust(rest, start=solution))
    return out


def held_back(network: Network, count: int) -> tuple[Network, list[Observation]]:
    """Return the network without some of its observations, and these, drawn at random."""
    rng = np.random.default_rng(4)
    _, point, _, _ = network.images.columns()
    rays = np.bincount(point, minlength=len(network.points))
    image = list(network.image_points())
    possible: list[Observation] = [
        *(replace(o, id=i) for i, o in network.observations.items()),  # type: ignore[call-arg]
        *(o for o, p in zip(image, point.tolist(), strict=True) if rays[p] >= RAYS),
    ]
    chosen = [possible[i] for i in rng.choice(len(possible), count, replace=False)]
    out = network.copy()
    gone = {_id(o) for o in chosen}
    out.observations = {i: o for i, o in network.observations.items() if i not in gone}
    stays: Mask = np.array([_id(o) not in gone for o in image], dtype=bool)
    out.image_mask(stays)
    return out, chosen


def whole_rows(solution: Solution, arriving: Sequence[Observation]) -> int:
    """Return the number of scalar rows at the end."""
    return solution.n_observations + sum(2 if isinstance(o, ImagePoint) else 1 for o in arriving)


def _id(o: Observation) -> str:
    return f"{o.photo}/{o.point}" if isinstance(o, ImagePoint) else str(getattr(o, "id"))  # noqa: B009


def _first_line(error: RuntimeError) -> str:
    return " ".join(str(error).split()[:6])


def _largest_difference(point: Callable[[str], Array], batch: Solution) -> float:
    """Return it over all points that are not held."""
    largest = 0.0
    for name in batch.network.points:
        sigma = batch.standard_deviations(name)
        free = sigma > 0
        if free.any():
            moved = np.abs(point(name) - batch.point(name))
            largest = max(largest, float((moved[free] / sigma[free]).max()))
    return largest


if __name__ == "__main__":
    measured = measure(sys.argv[1], int(sys.argv[2]))  # type: ignore[arg-type]
    print(json.dumps(asdict(measured)))

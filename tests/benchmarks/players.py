"""What takes a stream of arrivals: the engines of this library, its batch, and GTSAM alone.

As a program, ``python -m tests.benchmarks.players``, one of them plays one stream: it reads orders
from standard input, one in a line, and answers with JSON. So players of several versions of this
library alternate, each in a process of its own.
"""

from __future__ import annotations

import inspect
import json
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import process_time
from typing import Any, Protocol

import gtsam
import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.network.network import Network
from factorgraph_adj.rotation import log_rotation
from factorgraph_adj.types import Array

from . import pose_streams, streams
from .streams import Step, Stream, ident

STREAMS: dict[str, Callable[..., Stream]] = {
    "single": lambda n="100": streams.single(streams.simulate_grid(1, points=int(n)).network),
    "stations": lambda n="100": streams.stations(int(n)),
    "sphere2500": lambda n="2500": pose_streams.sphere(int(n)),
    "w10000": lambda n="5000": pose_streams.world(int(n)),
    "victoria": lambda n="10000": pose_streams.victoria(int(n)),
    "plaza": lambda n="2": pose_streams.plaza(int(n)),
    "single-mixed": lambda n="1024": streams.single_mixed(int(n)),
    "photos": lambda n="1024": streams.flown_over(int(n)),
    "industry": lambda: streams.industry(),
    "roma": lambda: streams.roma(),
}
"""Streams by name; some take a size, which stands behind a colon."""
PLAYERS = ("before", "isam2", "fronts", "gtsam", "gtsam 0.01", "batch")
"""Who plays: ``before`` is ``auto`` of an earlier version, ``batch`` a warm adjustment."""
PRECISE = 1e-9, 1e-7
"""Tolerances of the batch adjustment with which estimates are compared, relative to σ."""
ASKED = 200
"""Largest number of variables whose σ is compared at one moment, drawn at random."""
SMALLEST = 1e-12
"""Standard deviations below are the rounding of zero."""


@dataclass(frozen=True)
class Deviation:
    """How far estimates are from the batch adjustment of the same observations."""

    estimates: float
    """Largest difference of a component, in its σ."""
    sigmas: float
    """Largest relative difference of a σ."""
    worst: str
    """Which variable is furthest."""


class Player(Protocol):
    """One that takes a stream."""

    def begin(self, stream: Stream) -> None:
        """Take the beginning."""

    def take(self, step: Step) -> dict[str, Any]:
        """Take a step; return CPU seconds as ``cpu``, and what else there is to tell."""


class Incremental:
    """The incremental adjustment."""

    def __init__(self, engine: str) -> None:
        """Name an engine; ``before`` is that of a version that has no choice."""
        self._options: dict[str, Any] = {}
        if "engine" in inspect.signature(fga.IncrementalAdjustment.__init__).parameters:
            self._options["engine"] = "auto" if engine == "before" else engine
        self._asks_poses = engine != "before"  # it adjusts everything for an answer
        self._batch: fga.Solution | None = None

    def begin(self, stream: Stream) -> None:
        """Begin with a network; the first photo of a chain is held."""
        self._batch = stream.start
        self.inc = fga.IncrementalAdjustment(stream.begin, start=stream.start, **self._options)

    def take(self, step: Step) -> dict[str, Any]:
        """Let a step arrive, and ask for estimate and σ of a variable."""
        new = step.photos(self._place)
        begin = process_time()
        arrival = self.inc.add(step.observations, points=step.points, photos=new)
        middle = process_time()
        self._ask(*step.asked)
        end = process_time()
        return {
            "cpu": end - begin,
            "asking": end - middle,
            "suspect": sum(v.verdict == "suspect" for v in arrival.verdicts),
            "waiting": self.inc.n_waiting,
            "system": type(self.inc._state.system).__name__,
        }

    def _ask(self, kind: str, name: str) -> bool:
        """Ask for estimate and σ; return whether a variable is determined."""
        try:
            if kind == "point":
                self.inc.estimate(name), self.inc.standard_deviations(name)
            elif self._asks_poses:
                self.inc.pose(name)
        except InputError:
            return False
        return True

    def _place(self, photo: str) -> tuple[Array, Array]:
        """Return where a photo is; where it was said to be, as long as it waits."""
        given = self.inc.described.photos[photo]
        if not all(given.fixed):
            with suppress(InputError):
                there = self.inc.pose(photo)
                return there.rotation, there.position
        assert given.rotation is not None
        return given.rotation, np.array(given.position)

    def settle(self) -> float:
        """Settle; return CPU seconds."""
        begin = process_time()
        self.inc.settle()
        return process_time() - begin

    def compared(self, seed: int) -> Deviation:
        """Compare all estimates, and some σ, with the batch adjustment."""
        network = self.inc.network()
        for tolerance in PRECISE:
            found = fga.adjust(network, start=self._batch, tolerance=tolerance)
            if found.converged:
                break
        self._batch = found
        names = [
            (kind, n)
            for kind, every in (("point", network.points), ("pose", network.photos))
            for n in every
            if not all(every[n].fixed) and self._ask(kind, n)
        ]
        rng = np.random.default_rng(seed)
        chosen = rng.choice(len(names), min(ASKED, len(names)), replace=False).tolist()
        latest = range(max(0, len(names) - 10), len(names))
        off, off_sigma, worst = 0.0, 0.0, ""
        for kind, name in [names[k] for k in sorted({*chosen, *latest})]:
            moved, mine, theirs = (self._point if kind == "point" else self._pose)(name, found)
            free = theirs > SMALLEST
            if not free.any():
                continue
            most = float(np.max(np.abs(moved)[free] / theirs[free]))
            if most > off:
                off, worst = most, f"{kind} {name}"
            off_sigma = max(off_sigma, float(np.max(np.abs(mine[free] / theirs[free] - 1.0))))
        return Deviation(off, off_sigma, worst)

    def _point(self, name: str, batch: fga.Solution) -> tuple[Array, Array, Array]:
        moved = self.inc.estimate(name) - batch.point(name)
        return moved, self.inc.standard_deviations(name), batch.standard_deviations(name)

    def _pose(self, name: str, batch: fga.Solution) -> tuple[Array, Array, Array]:
        mine, theirs = self.inc.pose(name), batch.pose(name)
        turn = log_rotation((theirs.rotation.T @ mine.rotation)[None])[0]
        moved = np.concatenate([turn, mine.position - theirs.position])
        return moved, mine.sigmas, theirs.sigmas


class Batch:
    """A warm adjustment of everything with the reliability of every observation."""

    def begin(self, stream: Stream) -> None:
        """Adjust the beginning."""
        self.network = stream.begin.copy()
        self.solution = stream.start or fga.adjust(self.network, leave_out_undetermined=True)

    def take(self, step: Step) -> dict[str, Any]:
        """Adjust with a step."""
        self.network.add(*step.observations)
        begin = process_time()
        self.solution = fga.adjust(self.network, start=self.solution, leave_out_undetermined=True)
        fga.reliability(self.solution)
        return {"cpu": process_time() - begin}


class Alone:
    """GTSAM's iSAM2, with the covariance of the variable that is asked for."""

    def __init__(self, threshold: float | None) -> None:
        """Choose the threshold of relinearisation, at each update; none: GTSAM's defaults."""
        parameters = gtsam.ISAM2Params()
        if threshold is not None:
            parameters.setRelinearizeThreshold(threshold)
            parameters.relinearizeSkip = 1
        self.isam = gtsam.ISAM2(parameters)

    def begin(self, stream: Stream) -> None:
        """Take native factors, or those of `build_graph` for the whole network."""
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if stream.native:
            for factor in stream.native:
                graph.push_back(factor)
                _insert_first(values, factor)
        else:
            graph, values = self._of_network(stream)
        self.isam.update(graph, values)
        self.isam.calculateEstimate()

    def _of_network(self, stream: Stream) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        from factorgraph_adj.factor_graph.network_graph import build_graph, observation_parts
        from factorgraph_adj.graph.equations import compile_network
        from factorgraph_adj.orientation.choice_of_start import choose_start

        whole = whole_network(stream)
        first = stream.start or fga.adjust(stream.begin, leave_out_undetermined=True)
        equations = compile_network(whole)
        state = choose_start(equations, whole.datum, None).state
        state = equations.unknowns.carried(state, first.equations.unknowns, first.state)
        built = build_graph(equations, state=state)
        names = [name for name, *_ in observation_parts(built.equations)]
        late = {ident(o) for step in stream.steps for o in step.observations}
        self.keys, self.start = built.keys, built.values
        self.factors: dict[str, gtsam.NonlinearFactor] = {}
        self.held: dict[int, gtsam.NonlinearFactor] = {}
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for number in range(built.graph.size()):
            factor = built.graph.at(number)
            if number >= len(names):
                self.held[factor.keys()[0]] = factor
            elif names[number] in late:
                self.factors[names[number]] = factor
            else:
                graph.push_back(factor)
        known: set[int] = set()
        for number in range(graph.size()):
            known |= set(graph.at(number).keys())
        self.known: set[int] = set()
        self._with_new(graph, values, known)
        return graph, values

    def _with_new(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: set[int]
    ) -> None:
        """Add start values, and what holds components, of variables that are new."""
        for key in sorted(keys - self.known):
            insert_from(values, self.start, key)
            if key in self.held:
                graph.push_back(self.held[key])
        self.known |= keys

    def take(self, step: Step) -> dict[str, Any]:
        """Update, and ask for the covariance."""
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if step.native is not None:
            for factor in step.native.factors:
                graph.push_back(factor)
            values, key = step.native.start(self.isam), step.native.key
        else:
            keys: set[int] = set()
            for o in step.observations:
                factor = self.factors[ident(o)]
                graph.push_back(factor)
                keys.update(factor.keys())
            self._with_new(graph, values, keys)
            key = self.keys.key(*step.asked)
        begin = process_time()
        self.isam.update(graph, values)
        estimate_of(self.isam, key)
        middle = process_time()
        self.isam.marginalCovariance(key)
        end = process_time()
        return {"cpu": end - begin, "asking": end - middle}


def estimate_of(isam: gtsam.ISAM2, key: int) -> Any:
    """Return the estimate of one variable: a vector, or a pose."""
    for ask in (
        isam.calculateEstimatePose3,
        isam.calculateEstimatePose2,
        isam.calculateEstimateVector,
    ):
        with suppress(RuntimeError):
            return ask(key)
    raise AssertionError(key)


def insert_from(values: gtsam.Values, start: gtsam.Values, key: int) -> None:
    """Insert the value of a key of other values."""
    for at in (start.atVector, start.atPose3):
        try:
            values.insert(key, at(key))
        except RuntimeError:
            continue
        return
    raise AssertionError(key)


def _insert_first(values: gtsam.Values, factor: gtsam.NonlinearFactor) -> None:
    """Insert the mean of a prior."""
    values.insert(factor.keys()[0], factor.prior())


def whole_network(stream: Stream) -> Network:
    """Return the network with all that arrives."""
    out = stream.begin.copy()
    for step in stream.steps:
        for point in step.points:
            out.points[point.name] = point
        out.add(*step.observations)
    return out


def player(name: str) -> Player:
    """Return a player by name."""
    if name == "batch":
        return Batch()
    if name.startswith("gtsam"):
        _, _, threshold = name.partition(" ")
        return Alone(float(threshold) if threshold else None)
    return Incremental(name)


def players_of(stream: Stream) -> list[str]:
    """Return who plays a stream: only photos have a batch, and GTSAM alone none of their rays.

    Each ray is a factor in Python there, for which iSAM2 copies all values: minutes for a photo.
    """
    out = [*PLAYERS]
    for name in ("gtsam", "gtsam 0.01") if stream.photos_arrive else ("batch",):
        out.remove(name)
    return out


def stream(name: str) -> Stream:
    """Return a stream by name and size."""
    kind, _, size = name.partition(":")
    return STREAMS[kind](size) if size else STREAMS[kind]()


def main(arguments: Sequence[str]) -> None:
    """Play as standard input orders: ``begin``, ``take``, ``compare SEED``, ``settle``."""

    def tell(**found: Any) -> None:
        print(json.dumps(found), flush=True)

    playing, mine = stream(arguments[0]), player(arguments[1])
    steps = iter(playing.steps)
    tell(steps=len(playing.steps), players=players_of(playing))
    for line in sys.stdin:
        order, *rest = line.split()
        if order == "begin":
            begin = process_time()
            mine.begin(playing)
            tell(cpu=process_time() - begin)
        elif order == "take":
            tell(**mine.take(next(steps)))
        elif order == "compare":
            assert isinstance(mine, Incremental)
            found = mine.compared(int(rest[0]))
            tell(estimates=found.estimates, sigmas=found.sigmas, worst=found.worst)
        elif order == "settle":
            assert isinstance(mine, Incremental)
            tell(cpu=mine.settle())


if __name__ == "__main__":
    main(sys.argv[1:])

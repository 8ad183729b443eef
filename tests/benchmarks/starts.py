"""Poor starts against other solvers: ``python -m tests.benchmarks.starts [SHARE [FILE]]``.

Blocks of every sort of `tests.networks.poor_starts` (508; with SHARE a part of each sort) are
adjusted by this program, by scipy's ``least_squares(method="trf")`` and by GTSAM's Levenberg-
Marquardt with its native factors. FILE.npz receives the start values (default: starts.npz), one
array for each kind of unknowns, named sort/number/kind.

The other solvers begin twice: from the given values as they are, which is where this program begins
too, and from the start that this program has judged to be better ("trf+", "GTSAM+"). Where it
replaces nothing both are the same. Pose graphs have no values; they begin at a spanning tree.

All costs are vᵀPv by one function of ours with the same weights; a state with a point behind a
camera that sees it has none, as native factors count nothing there. The lowest cost is that of any
of the five; `LOWEST` says what counts as it. "Silent" counts adjustments that say that they
converged above the lowest cost and do not add that a lower minimum cannot be excluded.

A sum of squares of wrong pixels has no minimum. These blocks are therefore adjusted once more by
what each program has against gross errors: our data snooping, and Cauchy's loss of the others.
What counts there is whether all projection centres are within `MAX_OFF` σ of those of an
adjustment without the wrong pixels.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import process_time
from typing import TypeAlias

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.errors import AdjustmentError
from factorgraph_adj.graph.equations import Equations, compile_network
from factorgraph_adj.graph.variables import State
from factorgraph_adj.network.network import Network
from factorgraph_adj.orientation.choice_of_start import choose_start
from factorgraph_adj.solve.minimum import LOWER_MINIMUM_NOTE
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.start.start_values import approximate_start
from tests.networks.poor_starts import SORTS, WRONG, poor_start, right_pixels
from tests.support.other_solvers import by_gtsam, by_trf, cost

LOWEST = 1e-4
"""Excess over the lowest cost that counts as the lowest, relative to 1 + cost: trf and GTSAM stop
where the cost changes by 1e-8 and 1e-5."""
MAX_OFF = 5.0
"""Largest distance of a projection centre from the right one, in its standard deviations."""
Solver: TypeAlias = Callable[[Equations, State], State]
OTHERS: dict[str, tuple[Solver, int]] = {"trf": (by_trf, 3000), "GTSAM": (by_gtsam, 100_000)}
"""Other solvers, and the largest numbers of unknowns that they are asked to solve for: trf takes
minutes for more."""
NAMES = ("ours", *OTHERS, *(f"{name}+" for name in OTHERS))
ESTIMATORS = "15 % wrong pixels, gross errors sought"
"""Name of the comparison of estimators that resist gross errors."""


@dataclass
class Compared:
    """Counts of one sort."""

    blocks: int = 0
    lowest: dict[str, int] = field(default_factory=dict)
    """Blocks in which a solver reached the lowest cost, by solver."""
    seconds: dict[str, float] = field(default_factory=dict)
    converged: int = 0
    """Blocks that we say have converged at the lowest cost."""
    silent: list[int] = field(default_factory=list)
    """Numbers of blocks that we say have converged above it, without a word."""
    above: dict[int, float] = field(default_factory=dict)
    """Excess of the blocks that end above it, relative to it, by number; infinite: an error."""
    n_above: int = 0
    refused: int = 0
    """Blocks that end in an error."""
    iterations: list[int] = field(default_factory=list)

    def count(self, solver: str, *, reached: bool, seconds: float) -> None:
        """Count a block of a solver."""
        self.lowest[solver] = self.lowest.get(solver, 0) + reached
        self.seconds[solver] = self.seconds.get(solver, 0.0) + seconds


def compare(network: Network, number: int, found: Compared) -> State:
    """Adjust one block by all solvers and count; return its start."""
    equations = compile_network(network)
    given = approximate_start(equations, network.datum, None).state
    judged = choose_start(equations, network.datum, None)
    costs: dict[str, float] = {}
    taken: dict[str, float] = {}
    said, silent_if_above = False, False
    begin = process_time()
    try:
        solution = fga.adjust(network)
    except AdjustmentError:
        costs["ours"] = np.inf
        found.refused += 1
    else:
        costs["ours"] = cost(equations, solution.state)
        said = solution.converged
        silent_if_above = said and LOWER_MINIMUM_NOTE not in solution.reason
        found.iterations.append(solution.iterations)
    taken["ours"] = process_time() - begin
    for name, (solve, most) in OTHERS.items():
        if equations.unknowns.n_columns > most:
            continue
        begin = process_time()
        costs[name] = _cost_of(solve, equations, given)
        taken[name] = process_time() - begin
        plus = f"{name}+"
        costs[plus], taken[plus] = costs[name], 0.0
        if judged.instead_of is not None or judged.words:
            costs[plus] = _cost_of(solve, equations, judged.state)
            taken[plus] = process_time() - begin - taken[name]
    best = min(costs.values())
    found.blocks += 1
    for name, value in costs.items():
        reached = bool(np.isfinite(value)) and value <= best + LOWEST * (1.0 + best)
        found.count(name, reached=reached, seconds=taken[name])
        if name == "ours":
            found.converged += reached and said
            if not reached:
                found.above[number] = value / best - 1.0
                if silent_if_above:
                    found.silent.append(number)
    return given


def _cost_of(solve: Solver, equations: Equations, start: State) -> float:
    try:
        return cost(equations, solve(equations, start))
    except AdjustmentError:
        return np.inf


def compare_estimators(number: int, found: Compared) -> None:
    """Adjust one block with wrong pixels by what resists gross errors, and count."""
    network, right = poor_start(WRONG, number), fga.adjust(right_pixels(number))
    equations = compile_network(network)
    start = approximate_start(equations, network.datum, None).state
    found.blocks += 1

    def ours() -> State:
        return fga.snoop(network).solution.state

    solvers: dict[str, Callable[[], State]] = {
        "ours": ours,
        "trf": lambda: by_trf(equations, start, loss="cauchy"),
        "GTSAM": lambda: by_gtsam(equations, start, robust=True),
    }
    for name, solve in solvers.items():
        begin = process_time()
        try:
            reached = centres_off(solve(), right) < MAX_OFF
        except AdjustmentError:
            reached = False
            found.refused += name == "ours"
        found.count(name, reached=reached, seconds=process_time() - begin)
        if name == "ours":
            found.converged += reached
            if not reached:
                found.above[number] = np.nan


def centres_off(state: State, right: Solution) -> float:
    """Return how far projection centres are from those of an adjustment, in its σ; the largest."""
    number = right.equations.unknowns["pose"].number
    off = [
        (state["pose"][i, 9:] - right.pose(name).position) / right.pose(name).sigmas[3:]
        for name, i in number.items()
    ]
    largest = float(np.abs(off).max())
    return largest if np.isfinite(largest) else np.inf


@contextmanager
def silence() -> Iterator[None]:
    """Hold what libraries print: GTSAM prints a line for each point behind a camera."""
    kept, out = os.dup(1), os.dup(2)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.dup2(out, 2)
        os.close(kept)
        os.close(out)


def main() -> None:
    """Run the benchmark and print its table."""
    share = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
    file = sys.argv[2] if len(sys.argv) > 2 else "starts.npz"
    starts: dict[str, np.ndarray] = {}
    every = Compared()
    print(f"{'sort':38s} blocks | lowest: {' '.join(NAMES)} | converged there | ", end="")
    print(f"above, silent, errors | iterations | CPU s: {' '.join(NAMES)}", flush=True)
    for sort, (most, _) in SORTS.items():
        found = Compared()
        for number in range(max(round(share * most), 1)):
            with silence():
                start = compare(poor_start(sort, number), number, found)
            starts |= {f"{sort}/{number}/{kind}": v for kind, v in start.items() if v.size}
        show(sort, found)
        for name, seconds in found.seconds.items():
            every.lowest[name] = every.lowest.get(name, 0) + found.lowest[name]
            every.seconds[name] = every.seconds.get(name, 0.0) + seconds
        every.blocks += found.blocks
        every.converged += found.converged
        every.refused += found.refused
        every.silent += found.silent
        every.iterations += found.iterations
        every.n_above += len(found.above)
    print(line("all", every))
    percent = 100 * every.lowest["ours"] / every.blocks
    print(f"lowest: {percent:.1f} %", flush=True)
    np.savez_compressed(file, **starts)
    found = Compared()
    for number in range(max(round(share * SORTS[WRONG][0]), 1)):
        with silence():
            compare_estimators(number, found)
    show(ESTIMATORS, found)


def show(sort: str, found: Compared) -> None:
    """Print the row of a sort, and which of its blocks end above the lowest cost."""
    found.n_above = len(found.above)
    print(line(sort, found), flush=True)
    if found.above:
        listed = ", ".join(f"{n} ({excess:.1%})" for n, excess in found.above.items())
        print(f"  above: {listed}; silent: {found.silent}", flush=True)


def line(sort: str, found: Compared) -> str:
    """Return a row of the table."""
    lowest = "  ".join(f"{found.lowest.get(n, 0):4d}" for n in NAMES)
    seconds = "  ".join(f"{found.seconds.get(n, 0.0):6.1f}" for n in NAMES)
    median = int(np.median(found.iterations)) if found.iterations else 0
    return (
        f"{sort:38s} {found.blocks:6d} | {lowest} | {found.converged:5d} | {found.n_above:3d} "
        f"{len(found.silent):3d} {found.refused:3d} | {median:3d} | {seconds}"
    )


if __name__ == "__main__":
    main()

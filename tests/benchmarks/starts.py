"""Poor starts against other solvers: ``python -m tests.benchmarks.starts [SHARE [FILE]]``.

Blocks of every sort of `tests.networks.poor_starts` (500; with SHARE a part of each sort) are
adjusted by this program, by scipy's ``least_squares(method="trf")`` and by GTSAM's Levenberg-
Marquardt with its native factors, from the same start values. FILE.npz receives the start values
(default: starts.npz), one array for each kind of unknowns, named sort/number/kind.

All costs are vᵀPv by one function of ours with the same weights; a state with a point behind a
camera that sees it has none, as native factors count nothing there. `LOWEST` says what counts as
the lowest cost. "Silent" counts adjustments that say that they converged above the lowest cost and
do not add that a lower minimum cannot be excluded.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from time import process_time

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.block_orientation.begin import start_of
from factorgraph_adj.errors import AdjustmentError
from factorgraph_adj.graph.equations import Equations, compile_network
from factorgraph_adj.graph.variables import State
from factorgraph_adj.network.network import Network
from factorgraph_adj.solve.minimum import LOWER_MINIMUM_POSSIBLE
from factorgraph_adj.solve.solution import Solution
from tests.networks.poor_starts import SORTS, poor_start
from tests.support.other_solvers import by_gtsam, by_trf, cost

LOWEST = 1e-4
"""Excess over the lowest cost that counts as the lowest, relative to 1 + cost: trf and GTSAM stop
where the cost changes by 1e-8 and 1e-5."""
OTHERS: dict[str, Callable[[Equations, State], State]] = {"trf": by_trf, "GTSAM": by_gtsam}


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
    above: list[int] = field(default_factory=list)
    """Numbers of blocks that end above it."""
    refused: int = 0
    """Blocks that end in an error."""
    iterations: list[int] = field(default_factory=list)


def compare(network: Network, number: int, found: Compared) -> State:
    """Adjust one block by all solvers and count; return its start."""
    equations = compile_network(network)
    start = start_of(equations, network.datum, None).state
    costs: dict[str, float] = {}
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
        silent_if_above = said and LOWER_MINIMUM_POSSIBLE not in solution.reason
        found.iterations.append(solution.iterations)
    taken = {"ours": process_time() - begin}
    for name, solve in OTHERS.items():
        begin = process_time()
        costs[name] = cost(equations, solve(equations, start))
        taken[name] = process_time() - begin
    best = min(costs.values())
    found.blocks += 1
    for name, value in costs.items():
        reached = bool(np.isfinite(value)) and value <= best + LOWEST * (1.0 + best)
        found.lowest[name] = found.lowest.get(name, 0) + reached
        found.seconds[name] = found.seconds.get(name, 0.0) + taken[name]
        if name == "ours":
            found.converged += reached and said
            if not reached:
                found.above.append(number)
                if silent_if_above:
                    found.silent.append(number)
    return start


def centres_off(state: State, right: Solution) -> float:
    """Return how far projection centres are from those of an adjustment, in its σ; the largest."""
    number = right.equations.unknowns["pose"].number
    off = [
        (state["pose"][i, 9:] - right.pose(name).position) / right.pose(name).sigmas[3:]
        for name, i in number.items()
    ]
    largest = float(np.abs(off).max())
    return largest if np.isfinite(largest) else np.inf


def main() -> None:
    """Run the benchmark and print its table."""
    share = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
    file = sys.argv[2] if len(sys.argv) > 2 else "starts.npz"
    starts: dict[str, np.ndarray] = {}
    every = Compared()
    print(
        f"{'sort':38s} blocks | lowest: ours  trf GTSAM | converged there | above, silent | ",
        end="",
    )
    print("iterations | CPU s: ours trf GTSAM", flush=True)
    with open(os.devnull, "w") as nowhere:  # GTSAM prints a line for each point behind a camera
        for sort, (most, _) in SORTS.items():
            found = Compared()
            for number in range(max(round(share * most), 1)):
                kept, out = os.dup(1), os.dup(2)
                os.dup2(nowhere.fileno(), 1)
                os.dup2(nowhere.fileno(), 2)
                try:
                    start = compare(poor_start(sort, number), number, found)
                finally:
                    os.dup2(kept, 1)
                    os.dup2(out, 2)
                    os.close(kept)
                    os.close(out)
                starts |= {f"{sort}/{number}/{kind}": v for kind, v in start.items() if v.size}
            print(line(sort, found), flush=True)
            if found.above:
                print(f"  above: {found.above}, silent: {found.silent}", flush=True)
            for name in found.lowest:
                every.lowest[name] = every.lowest.get(name, 0) + found.lowest[name]
                every.seconds[name] = every.seconds.get(name, 0.0) + found.seconds[name]
            every.blocks += found.blocks
            every.converged += found.converged
            every.refused += found.refused
            every.silent += found.silent
            every.above += found.above
            every.iterations += found.iterations
    print(line("all", every))
    percent = 100 * every.lowest["ours"] / every.blocks
    print(f"ended in an error: {every.refused}; lowest: {percent:.1f} %")
    np.savez_compressed(file, **starts)


def line(sort: str, found: Compared) -> str:
    """Return a row of the table."""
    lowest = "  ".join(f"{found.lowest[n]:4d}" for n in ("ours", *OTHERS))
    seconds = "  ".join(f"{found.seconds[n]:6.1f}" for n in ("ours", *OTHERS))
    median = int(np.median(found.iterations)) if found.iterations else 0
    return (
        f"{sort:38s} {found.blocks:6d} | {lowest} | {found.converged:5d} | "
        f"{len(found.above):3d} {len(found.silent):3d} | {median:3d} | {seconds}"
    )


if __name__ == "__main__":
    main()

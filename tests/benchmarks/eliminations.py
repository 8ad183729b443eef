"""Eliminations of one linearisation compared: ``python -m tests.benchmarks.eliminations``.

For seeded levelling nets, grids of total stations and image blocks of several sizes it prints the
milliseconds of CPU of a factorisation with its selected inverse: by QR in fronts, by Cholesky in
fronts, by QR in GTSAM (factors, elimination and their Bayes tree, without an inverse), and by QR of
one dense matrix with the whole inverse. The last column is the largest difference of a standard
deviation by Cholesky from that by QR, relative to it. Medians of `RUNS` alternating runs.

The figures are behind `factorgraph_adj.solve.elimination_layers.RULE`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from time import process_time

import gtsam
import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import HeightDifference
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from factorgraph_adj.solve.factorisation import Factorisation
from factorgraph_adj.solve.normal_equations import NormalEquations, Solver
from tests.benchmarks.grids import simulate_grid
from tests.support.elimination_rules import rule
from tests.support.gtsam_elimination import gaussian_graph, order

RUNS = 5
"""Runs of which the median is taken."""
MAX_DENSE_UNKNOWNS = 1200
"""Largest number of unknowns of one dense matrix."""
MAX_GTSAM_UNKNOWNS = 20_000
"""Largest number of unknowns that are left to GTSAM."""
SIGMA_M = 1e-3
"""Standard deviation of height differences."""
POINTS_PER_PHOTO = 60
"""Image points of each photo of the blocks."""


def levelling(points: int) -> Network:
    """Return height differences between neighbours of a square grid, from one given height."""
    side = round(np.sqrt(points))
    plan = Network(f"levelling, {side} × {side}")
    number = np.arange(side * side).reshape(side, side)
    for (i, j), n in np.ndenumerate(number):
        at = (100.0 * i, 100.0 * j, float((7 * n) % 11))
        plan.add_point(str(n), at, fixed="xyz" if n == 0 else "xy")
    ways = ((number[:, :-1], number[:, 1:]), (number[:-1], number[1:]))
    for a, b in ways:
        for start, end in zip(a.ravel().tolist(), b.ravel().tolist(), strict=True):
            plan.add(HeightDifference(str(start), str(end), 0.0, sigma=SIGMA_M))
    return measure(plan, seed=1)


def networks(largest: int) -> Iterator[Network]:
    """Iterate over the networks of up to some number of points."""
    for points in (9, 25, 100, 400, 1024, 2025, 4900):
        if points <= largest:
            yield levelling(points)
            yield simulate_grid(1, points=points).network
    for size in (600, 3_000, 12_000):
        if size <= 5 * largest:
            made = simulate_aerial_block(1, image_points=size, points_per_photo=POINTS_PER_PHOTO)
            yield made.network


def timed(make: Callable[[], object]) -> float:
    """Return milliseconds of CPU of a call."""
    begin = process_time()
    make()
    return 1e3 * (process_time() - begin)


def by_gtsam(normal: NormalEquations) -> None:
    """Eliminate by GTSAM's QR, and read the factors out."""
    graph = gaussian_graph(normal.system, normal.system.residual)
    tree = graph.eliminateMultifrontal(order(graph), gtsam.EliminateQR)
    stack = list(tree.roots())
    while stack:
        clique = stack.pop()
        conditional = clique.conditional()
        np.array(conditional.R()), np.array(conditional.S())
        stack += [clique[i] for i in range(clique.nrChildren())]


def by_dense_qr(normal: NormalEquations) -> None:
    """Invert the whole by QR of one matrix."""
    free = normal.system.unknowns.free
    a = normal.system.sparse(np.arange(len(normal.system.residual)))[:, np.flatnonzero(free)]
    half = np.linalg.inv(np.linalg.qr(a.toarray(), mode="r"))
    half @ half.T


def sigmas(factor: Factorisation) -> np.ndarray:
    """Return the standard deviations of the coordinates of all points in the fronts."""
    offset = factor.layers.unknowns["point"].offset
    inside = (offset >= 0) & ~factor.layers.reduced
    found = factor.joint(offset[inside, None] + np.arange(3))
    rest = factor.point_covariances()
    every = np.zeros((len(offset), 3))
    every[inside] = np.einsum("nii->ni", found)
    every[factor.layers.reduced] = np.einsum("nii->ni", rest)
    return np.sqrt(every)


def compared(network: Network) -> str:
    """Return one line of the table."""
    solution = fga.adjust(network)
    added, state = solution.run.constraint, solution.state
    normals: dict[str, NormalEquations] = {}
    for name, size in (("qr", 10**9), ("cholesky", 0)):
        with rule(max_qr_variables=size):
            solver = Solver.of(solution.equations)
            if name == "qr":
                solver.turn_to_qr()
            normals[name] = NormalEquations(solver, state)
    by_qr, by_cholesky = normals["qr"], normals["cholesky"]

    def of(normal: NormalEquations) -> Callable[[], object]:
        def inverted() -> object:
            normal._elimination = None
            return normal._factorise(added).inverse

        return inverted

    unknowns = int(solution.equations.unknowns.free.sum())
    ways = {"qr": of(by_qr), "cholesky": of(by_cholesky)}
    free_net = solution.datum is not None
    if unknowns <= MAX_GTSAM_UNKNOWNS and not free_net:
        ways["gtsam"] = lambda: by_gtsam(by_qr)
    if unknowns <= MAX_DENSE_UNKNOWNS and not free_net:
        ways["dense"] = lambda: by_dense_qr(by_qr)
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(RUNS):
        for name, make in ways.items():
            times[name].append(timed(make))
    exact, other = (sigmas(n._factorise(added)) for n in (by_qr, by_cholesky))
    on = exact > 0
    worst = float((np.abs(other - exact)[on] / exact[on]).max())
    columns = [
        f"{np.median(times[name]):.2f}" if name in times else "" for name in ("qr", "cholesky")
    ]
    columns += [f"{np.median(times[n]):.2f}" if n in times else "–" for n in ("gtsam", "dense")]
    variables = sum(1 for _ in solution.equations.unknowns.active())
    name = network.name.removesuffix(", simulated")
    return " | ".join(
        ["", name, str(variables), str(unknowns), *columns, f"{worst:.0e}", ""]
    ).strip()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("largest", type=int, nargs="?", default=5_000, help="number of points")
    most = parser.parse_args().largest
    print("| network | variables | unknowns | QR, ms | Cholesky | GTSAM | dense | σ |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for network in networks(most):
        print(compared(network), flush=True)


if __name__ == "__main__":
    main()

"""Sequential algorithms of on-line triangulation on one stream of observations.

`python -m examples.papers.sequential_algorithms` compares the algorithms of `sequential_filters`
on a simulated aerial block with self-calibration: first two rays of each point with all positions
and control points are the base; the other image points follow one after the other, and a part of
them leaves again. It also compares where the block is linearised, and tables relaxations.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from time import process_time

import gtsam
import numpy as np
from scipy.linalg import solve_triangular

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import Equations, compile_network
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.graph.variables import State
from factorgraph_adj.ledger.command_input import Engine
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.report import layout
from factorgraph_adj.simulation.measurement import Seed
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from factorgraph_adj.types import Array, Index

from .sequential_filters import (
    GivensFilter,
    ISAM2Filter,
    KalmanFilter,
    LowRankUpdate,
    Rows,
    SequentialFilter,
    TriangularFactorUpdate,
    minimum,
)

RAYS_IN_BASE = 2
"""Rays of each point in the base: a point with two rays is determined."""
REMOVED_SHARE = 0.2
"""Part of the streamed image points that leave again."""
RELAXATIONS = (1.0, 1.8, 1.85, 1.9, 1.94)
"""Factors of over-relaxation; 1.8 to 1.94 are those of practice with blocks."""
ITERATION_LIMIT = 100_000
"""Largest number of iterations of a relaxation."""
RELAXED = 1e-3
"""Distance from the minimum, in σ, at which a relaxation ends."""


@dataclass(frozen=True, eq=False)
class Stream:
    """A linearised block as a base and a stream."""

    a: Array
    """Whitened partials of the base, (m, n)."""
    v: Array
    """Whitened residuals of the base at x = 0, (m,)."""
    changes: tuple[tuple[Rows, float], ...]
    """Rows of each image point that enters (1) or leaves (−1), in their order."""
    variables: list[Index]
    """Columns of each point, photo and calibration."""

    @classmethod
    def of(
        cls, equations: Equations, state: State, seed: Seed, *, removed: float = REMOVED_SHARE
    ) -> Stream:
        """Linearise a block whose image points are in one block of equations.

        Args:
            equations: the block.
            state: values of its unknowns.
            seed: seed of the order of the image points, and of the choice of those that leave.
            removed: part of the streamed image points that leave again.
        """
        system = LinearisedEquations(equations, state)
        free = np.flatnonzero(equations.unknowns.free)
        a = system.sparse(np.arange(equations.n_rows)).toarray()[:, free]
        (images,) = (b for b in equations.blocks if b.kind == "image")
        point = dict(images.variables)["point"]
        rng = np.random.default_rng(seed)
        order = rng.permutation(images.n)
        # Rank of each ray among those of its point, in the order of the stream.
        rank = np.zeros(images.n, dtype=np.intp)
        seen: dict[int, int] = {}
        for ray in order.tolist():
            rank[ray] = seen[int(point[ray])] = seen.get(int(point[ray]), -1) + 1
        streamed = order[rank[order] >= RAYS_IN_BASE]
        base = np.ones(len(a), dtype=bool)
        rows = []
        for number in streamed.tolist():
            own = images.first_row + 2 * number + np.arange(2)
            base[own] = False
            at = np.flatnonzero(a[own].any(axis=0))
            rows.append(Rows(number, at, a[np.ix_(own, at)], system.residual[own]))
        gone = rng.choice(len(rows), round(removed * len(rows)), replace=False)
        changes = [(r, 1.0) for r in rows] + [(rows[i], -1.0) for i in gone.tolist()]
        place = np.full(equations.unknowns.n_columns, -1)
        place[free] = np.arange(len(free))
        variables = []
        for kind, number in equations.unknowns.active():
            columns = place[equations.unknowns.columns(kind, number)]
            if (columns >= 0).any():
                variables.append(columns[columns >= 0])
        return cls(a[base], system.residual[base], tuple(changes), variables)

    def remaining(self) -> tuple[Array, Array]:
        """Return A and v of all rows that are in at the end."""
        there = {r.number: r for r, sign in self.changes if sign > 0}
        for r, sign in self.changes:
            if sign < 0:
                del there[r.number]
        a, v = [self.a], [self.v]
        for r in there.values():
            row = np.zeros((len(r.b), self.a.shape[1]))
            row[:, r.at] = r.b
            a.append(row)
            v.append(r.v)
        return np.concatenate(a), np.concatenate(v)


@dataclass(frozen=True)
class FilterRow:
    """An algorithm after the stream."""

    name: str
    """Name of the algorithm."""
    adding: float
    """CPU seconds of an image point that enters, with all unknowns after it; median."""
    removing: float
    """CPU seconds of an image point that leaves, with all unknowns after it; median."""
    operations: float
    """Multiplications of an image point that enters, without the unknowns; median, 0: unknown."""
    numbers: int
    """Stored numbers that are not zero, after the stream."""
    unknowns: float
    """Largest difference of an unknown from the batch solution, in its σ."""
    sigmas: float
    """Largest relative difference of a standard deviation."""
    cofactors: float
    """Largest difference of a cofactor q_ij, relative to σ_i σ_j."""
    vtv: float
    """Relative difference of vᵀv."""


def filters(stream: Stream) -> Mapping[str, SequentialFilter]:
    """Return all algorithms with the base of a stream."""
    a, v = stream.a, stream.v
    return {
        "Kalman form": KalmanFilter(a, v),
        "Givens rotations": GivensFilter(a, v),
        "triangular factor update": TriangularFactorUpdate(a, v),
        "low-rank update (ours)": LowRankUpdate(a, v),
        "iSAM2 (GTSAM)": ISAM2Filter(a, v, stream.variables),
    }


def run_filters(stream: Stream) -> list[FilterRow]:
    """Run all algorithms on a stream, alternating after each image point."""
    running = filters(stream)
    seconds: dict[str, dict[float, list[float]]] = {n: {1.0: [], -1.0: []} for n in running}
    operations: dict[str, list[int]] = {n: [] for n in running}
    for rows, sign in stream.changes:
        for name, one in running.items():
            before, begin = one.operations, process_time()
            one.change(rows, sign)
            one.x  # noqa: B018  iSAM2 and R find the unknowns only now
            seconds[name][sign].append(process_time() - begin)
            if sign > 0:
                operations[name].append(one.operations - before)
    x, r, vtv = minimum(*stream.remaining())
    half = solve_triangular(r, np.eye(len(r)))
    q = half @ half.T
    sigma = np.sqrt(np.diag(q))
    out = []
    for name, one in running.items():
        found = one.cofactors()
        adding, removing = (float(np.median(seconds[name][s] or [0.0])) for s in (1.0, -1.0))
        out.append(
            FilterRow(
                name=name,
                adding=adding,
                removing=removing,
                operations=float(np.median(operations[name])),
                numbers=one.numbers,
                unknowns=float((np.abs(one.x - x) / sigma).max()),
                sigmas=float(np.abs(np.sqrt(np.diag(found)) / sigma - 1.0).max()),
                cofactors=float(np.abs((found - q) / np.outer(sigma, sigma)).max()),
                vtv=abs(one.vtv / vtv - 1.0),
            )
        )
    return out


def linearisation_errors(network: Network, seed: Seed) -> dict[str, float]:
    """Return the largest error of a point in its σ by where the block is linearised.

    The reference is the adjustment of all observations. iSAM2 and the incremental adjustments begin
    with the base, and get the other image points photo by photo.
    """
    batch = fga.adjust(network)
    at, sigma = batch.state["point"], np.sqrt(np.diagonal(batch.point_covariances, 0, 1, 2))
    equations, names = batch.equations, batch.equations.unknowns["point"].names

    def error(points: Array) -> float:
        """Return the largest error of points (p, 3)."""
        return float(np.abs((points - at) / sigma).max())

    def linear(state: State) -> State:
        """Return the minimum of the rows that are linearised at a state."""
        stream = Stream.of(equations, state, seed, removed=0.0)
        step = np.zeros(equations.unknowns.n_columns)
        step[equations.unknowns.free] = minimum(*stream.remaining())[0]
        return equations.unknowns.retract(state, step)

    later: dict[str, list[ImagePoint]] = {}
    count: dict[str, int] = {}
    for o in network.image_points():
        count[o.point] = count.get(o.point, 0) + 1
        if count[o.point] > RAYS_IN_BASE:
            later.setdefault(o.photo, []).append(o)
    ids = [f"{o.photo}/{o.point}" for each in later.values() for o in each]
    base = fga.adjust(without(network, ids))
    start = linear(compile_network(network).unknowns.start())
    out = {
        "linear, at the approximate values": error(start["point"]),
        "linear, iterated once": error(linear(start)["point"]),
        "linear, at the minimum of the base": error(linear(base.state)["point"]),
    }
    defaults = gtsam.ISAM2Params()
    for name, params in (("GTSAM's defaults", defaults), ("threshold 0.01, each update", None)):
        isam = fga.Isam(base.as_network(), params=params)
        for each in later.values():
            isam.add(each)
        out[f"iSAM2, nonlinear factors, {name}"] = error(isam.state["point"])
    engines: tuple[Engine, ...] = ("isam2", "fronts")
    for engine in engines:
        inc = fga.IncrementalAdjustment(base.as_network(), policy="accept", engine=engine)
        for each in later.values():
            inc.add(each)
        out[f"incremental adjustment, {engine}"] = error(np.array([inc.estimate(n) for n in names]))
    return out


@dataclass(frozen=True)
class Relaxation:
    """A relaxation of the reduced normal equations of the photos."""

    name: str
    """Name of the method."""
    factor: float
    """Factor of over-relaxation; 1: none."""
    iterations: int
    """Iterations until the largest error of an unknown is `RELAXED` of its σ; −1: too many."""


def relaxations(
    n: Array, g: Array, blocks: Sequence[Index], factors: Sequence[float] = RELAXATIONS
) -> list[Relaxation]:
    """Solve N x = g by Gauss-Seidel, over-relaxation (SOR, by blocks BSOR), conjugate gradients.

    Args:
        n: symmetric positive definite matrix, (k, k).
        g: right side, (k,).
        blocks: columns of each photo.
        factors: factors of over-relaxation.
    """
    x, sigma = np.linalg.solve(n, g), np.sqrt(np.diag(np.linalg.inv(n)))
    block_of = np.empty(len(n), dtype=np.intp)
    for number, columns in enumerate(blocks):
        block_of[columns] = number
    same = block_of[:, None] == block_of
    later = block_of[:, None] > block_of

    def there(at: Array) -> bool:
        return bool((np.abs(at - x) <= RELAXED * sigma).all())

    def relaxed(own: Array, before: Array, factor: float) -> int:
        """Iterate x ← x + (D/w + L)⁻¹ (g − N x)."""
        at, step = np.zeros(len(n)), np.linalg.inv(own / factor + before)
        for iteration in range(1, ITERATION_LIMIT + 1):
            at += step @ (g - n @ at)
            if there(at):
                return iteration
        return -1

    def gradients(solve: Callable[[Array], Array]) -> int:
        """Take conjugate gradients with a preconditioner."""
        at, r = np.zeros(len(n)), g.copy()
        p = z = solve(r)
        for iteration in range(1, ITERATION_LIMIT + 1):
            moved = n @ p
            length = (r @ z) / (p @ moved)
            at, rest = at + length * p, r - length * moved
            if there(at):
                return iteration
            new = solve(rest)
            p, r, z = new + (rest @ new) / (r @ z) * p, rest, new
        return -1

    diagonal, of_photos = np.diag(np.diag(n)), np.where(same, n, 0.0)
    out = []
    for factor in factors:
        single = "Gauss-Seidel" if factor == 1.0 else "SOR"
        blockwise = "Gauss-Seidel by photos" if factor == 1.0 else "BSOR, photos"
        out.append(Relaxation(single, factor, relaxed(diagonal, np.tril(n, -1), factor)))
        out.append(Relaxation(blockwise, factor, relaxed(of_photos, np.where(later, n, 0), factor)))
    scale = 1.0 / np.diag(n)
    out.append(Relaxation("conjugate gradients, Jacobi", 1.0, gradients(lambda r: scale * r)))
    inverse = np.linalg.inv(of_photos)
    out.append(Relaxation("conjugate gradients, photos", 1.0, gradients(lambda r: inverse @ r)))
    return out


def relaxation_table(stream: Stream, n_points: int) -> list[Relaxation]:
    """Return the relaxations of the photos of a stream; points come first and are eliminated."""
    a, v = stream.remaining()
    n, g = a.T @ a, -a.T @ v
    e = np.concatenate(stream.variables[:n_points])
    k = np.concatenate(stream.variables[n_points:])
    t = np.linalg.solve(n[np.ix_(e, e)], n[np.ix_(e, k)]).T
    starts = np.cumsum([0] + [len(c) for c in stream.variables[n_points:]])
    blocks = [np.arange(i, j) for i, j in pairwise(starts.tolist())]
    return relaxations(n[np.ix_(k, k)] - t @ n[np.ix_(e, k)], g[k] - t @ g[e], blocks)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables of the command."""
    parser = argparse.ArgumentParser(
        prog="examples.papers.sequential_algorithms", description=__doc__
    )
    parser.add_argument("--image-points", type=int, nargs="+", default=[300, 600], help="(300 600)")
    parser.add_argument("--points-per-photo", type=int, default=50, help="(50)")
    parser.add_argument("--seed", type=int, default=1, help="(1)")
    options = parser.parse_args(arguments)
    for image_points in options.image_points:
        network = simulate_aerial_block(
            options.seed, image_points=image_points, points_per_photo=options.points_per_photo
        ).network
        equations = compile_network(network)
        stream = Stream.of(equations, equations.unknowns.start(), options.seed)
        rows = run_filters(stream)
        entering = sum(sign > 0 for _, sign in stream.changes)
        size = f"{len(network.photos)} photos, {stream.a.shape[1]} unknowns"
        moves = f"{entering} image points enter, {len(stream.changes) - entering} leave"
        print("\n".join(layout.title(f"{size}: {moves}")))
        head = [
            "",
            "enters ms",
            "leaves ms",
            "multiplications",
            "numbers",
            "x / σ",
            "σ",
            "q",
            "vᵀv",
        ]
        cells = [
            [
                r.name,
                f"{1e3 * r.adding:.2f}",
                f"{1e3 * r.removing:.2f}",
                f"{r.operations:.0f}" if r.operations else "–",
                str(r.numbers),
                *(f"{d:.0e}" for d in (r.unknowns, r.sigmas, r.cofactors, r.vtv)),
            ]
            for r in rows
        ]
        print("\n".join(layout.table(head, cells)))
        print()
    print("\n".join(layout.title("Largest error of a point in its σ, by linearisation")))
    errors = linearisation_errors(network, options.seed)
    print("\n".join(layout.table(["", "σ"], [[n, f"{e:.2g}"] for n, e in errors.items()])))
    print()
    print("\n".join(layout.title("Relaxations of the photos of the last block")))
    found = relaxation_table(stream, len(network.points))
    lines = [[r.name, f"{r.factor:g}", str(r.iterations)] for r in found]
    print("\n".join(layout.table(["", "factor", "iterations"], lines)))


if __name__ == "__main__":
    main()

"""Limits of the machine: σ and weight ratios in double precision, memory of an adjustment.

Coordinates have about 16 digits. A reading with a smaller standard deviation than the last digit of
the coordinates that it joins cannot be adjusted: its computed value is rounding. In the normal
matrix, too, the share of a row that is less than the last digit beside another row is lost.

The memory of an adjustment is estimated from its index lists before it is allocated.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, diags_array

from ..errors import AdjustmentError, InputError, Problem, known
from ..graph.equations import Equations
from ..graph.variables import State
from ..types import NO_ROWS, Array, Mask
from .conjugate_gradients import MAX_CLUSTER_NODES
from .factorisation import EliminationPlan
from .linearised_equations import LinearisedEquations

MAX_ROUNDING = 0.1
"""Largest rounding error of a computed value, relative to its σ."""
SAFE_ROUNDING = 0.01
"""Rounding error, relative to σ, with which an adjustment converges beside less precise readings;
above it vᵀPv may be too coarse to resolve a step of these."""
MAX_RATIO = 1e7
"""Largest ratio of the square roots of weights of two rows that share unknowns. At 1e8 the smaller
one keeps a digit or two in normal equations, at 1e9 none."""
EASED_RATIO = 1e4
"""Ratio to which weights are lowered, to see whether the network can be adjusted then."""
LARGE_SHARE = 0.1
"""Share of a row, in the root of a diagonal element of N, from which other rows are lost beside
it."""
ROWS_AT_ONCE = 100_000
"""Number of rows of which the partials are in memory at once."""
MAX_PROBLEMS = 50
"""Largest number of observations that are listed."""
_UNITS = {"m": " m", "rad": " rad"}
BYTES_PER_NUMBER = 8
"""Bytes of a number."""
GIGABYTE = 1e9
"""Bytes of a gigabyte."""
LIST_BYTES_PER_RAY = 120
"""Bytes of the index lists and observed values of each ray."""
CHUNK_BYTES = 12_000_000
"""Bytes of the temporary arrays while one chunk of rays is evaluated."""
BYTES_PER_POINT = 900
"""Bytes of the factors, cross products and right sides of each object point."""
BYTES_PER_ROW = 300
"""Bytes of the partials and index lists of each terrestrial row."""
PRODUCT_BYTES_PER_ROW = 24
"""Bytes of the products of each terrestrial row, for each element of a block."""
RELIABILITY_BYTES_PER_ROW = 2000
"""Bytes of the leverages, tests and detectable errors of each terrestrial row."""
RELIABILITY_NUMBERS_PER_RAY = 30
"""Numbers of the reliability of each image point: its leverages, tests and detectable errors."""
BYTES_PER_PAIR = 40
"""Bytes of each pair of rays to one point while the pairs are sorted by their photos."""
MIN_BYTES_CHECKED = 1e8
"""Bytes below which an adjustment is not compared with the free memory."""


def check_numerical_precision(system: LinearisedEquations, resolution: float) -> None:
    """Refuse observations whose σ is below what double precision carries at their coordinates.

    The computed value of row i has a rounding error of ½ √(Σⱼ aᵢⱼ² δⱼ²) σ, with the whitened
    partials a and the units δ in the last digits of the unknowns. Rows are examined only where the
    sum of all squares is large.

    Args:
        system: observations, linearised where an adjustment begins.
        resolution: root of the sum of aᵢⱼ² δⱼ² over all rows, see `NormalEquations.resolution`.

    Raises:
        InputError: rounding errors are above `MAX_ROUNDING` σ; the error names the observations,
            and the smallest σ that double precision carries safely.
    """
    if 0.5 * resolution <= MAX_ROUNDING:
        return
    errors = _rounding(system)
    if (errors > MAX_ROUNDING).any():
        raise _rounded(system, errors, MAX_ROUNDING)


def _rounded(system: LinearisedEquations, errors: Array, limit: float) -> InputError:
    """Return the error that names rows with rounding errors above a limit."""
    equations, state = system.equations, system.state
    worst = _worst(equations, errors > limit, errors)
    size = float(np.abs(state["point"]).max(initial=0.0))
    problems = []
    for row in worst[:MAX_PROBLEMS]:
        sigma, unit = _sigma(equations, row)
        error = float(errors[row]) * sigma
        problems.append(
            Problem(
                f"its σ of {sigma:.2g}{unit} is below what double precision carries: with "
                f"coordinates of up to {size:.2g} m its computed value is rounded by "
                f"{error:.1g}{unit}; valid: σ of at least {_up(error / SAFE_ROUNDING)}{unit}, or "
                "coordinates from a nearer origin; what is known without error is to be held",
                equations.label(row),
            )
        )
    return InputError(_listed(problems, len(worst)))


def _rounding(system: LinearisedEquations) -> Array:
    """Return the rounding error of the computed value of each row, relative to its σ, (n_rows,)."""
    squares = system.unknowns.spacing(system.state) ** 2
    return np.concatenate([0.5 * np.sqrt(a.power(2) @ squares) for a in _pieces(system)])


def error_of_weight_ratios(
    equations: Equations,
    state: State,
    weights: Array | None,
    works: Callable[[Array], bool],
) -> InputError | None:
    """Return why a network could not be adjusted, if its weights are too different.

    Args:
        equations: the network, with the standard deviations of ``state``.
        state: values of its variables.
        weights: factors on the weights of all rows with which it could not be adjusted, (n_rows,).
        works: whether it can be adjusted with other factors.

    Returns:
        The observations of which rounding is more than `SAFE_ROUNDING`; otherwise those with large
        weights, and those that are lost beside them; None: there are none, or smaller weights do
        not help.
    """
    if weights is not None:
        equations = equations.reweighted(weights)
    try:
        system = LinearisedEquations(equations, state)
    except InputError:
        return None

    def helps(eased: Array) -> bool:
        try:
            return works(eased if weights is None else eased * weights)
        except AdjustmentError:
            return False

    errors = _rounding(system)
    rough = errors > SAFE_ROUNDING
    if rough.any() and helps(np.where(rough, (SAFE_ROUNDING / errors.max()) ** 2, 1.0)):
        return _rounded(system, errors, SAFE_ROUNDING)
    root = np.sqrt(system.diagonal())
    scale = np.divide(1.0, root, out=np.zeros_like(root), where=root > 0)
    share = _largest(system, scale)
    lost = (share > 0.0) & (share < 1.0 / MAX_RATIO)
    if not lost.any():
        return None
    touched = np.zeros(len(scale))
    for rows in np.array_split(np.flatnonzero(lost), 1 + int(lost.sum()) // ROWS_AT_ONCE):
        touched[system.sparse(rows).indices] = 1.0
    heavy = _largest(system, scale * touched) > LARGE_SHARE
    ratio = 1.0 / float(share[lost].min())
    eased = np.where(heavy, (EASED_RATIO / ratio) ** 2, 1.0)
    if not helps(eased):
        return None
    names = known((equations.label(row) for row in _worst(equations, lost, -share)), most=3)
    worst = _worst(equations, heavy, np.ones(len(share)))
    problems = []
    for row in worst[:MAX_PROBLEMS]:
        sigma, unit = _sigma(equations, row)
        problems.append(
            Problem(
                f"its σ of {sigma:.2g}{unit} gives it {ratio:.0e} times the effect of others, "
                "which are lost beside it in double precision, so that they determine nothing: "
                f"{names}; valid: at most {MAX_RATIO:.0e} times, σ of at least "
                f"{_up(sigma * ratio / MAX_RATIO)}{unit}; what is known without error is to be "
                "held",
                equations.label(row),
            )
        )
    return InputError(_listed(problems, len(worst)))


def _pieces(system: LinearisedEquations) -> Iterator[csr_array]:
    """Return the whitened partials of all rows, some at a time."""
    n = system.equations.n_rows
    for first in range(0, n, ROWS_AT_ONCE):
        yield system.sparse(np.arange(first, min(first + ROWS_AT_ONCE, n)))


def _largest(system: LinearisedEquations, scale: Array) -> Array:
    """Return the largest element |aᵢⱼ| sⱼ of each row, (n_rows,)."""
    by_column = diags_array(scale)
    parts = [abs(a @ by_column).max(axis=1).toarray().ravel() for a in _pieces(system)]
    return np.concatenate(parts)


def _worst(equations: Equations, wrong: Mask, size: Array) -> list[int]:
    """Return the row of each observation that is wrong by the largest size, in their order."""
    out: dict[int, int] = {}
    for row in np.flatnonzero(wrong).tolist():
        of = int(equations.observation_of_row[row])
        if of not in out or size[row] > size[out[of]]:
            out[of] = row
    return list(out.values())


def _sigma(equations: Equations, row: int) -> tuple[float, str]:
    """Return the standard deviation of a scalar row, and its unit after a blank."""
    for block in equations.blocks:
        if block.rows.start <= row < block.rows.stop:
            return float(block.sigma.ravel()[row - block.first_row]), _UNITS.get(block.unit, "")
    raise IndexError(row)


def _up(value: float) -> str:
    """Return a number, rounded up to one digit."""
    step = 10.0 ** np.floor(np.log10(value))
    return f"{np.ceil(value / step) * step:.0e}"


def _listed(problems: list[Problem], count: int) -> list[Problem]:
    if count > len(problems):
        problems.append(Problem(f"and {count - len(problems)} further observations of such a σ"))
    return problems


@dataclass(frozen=True)
class MemoryEstimate:
    """Bytes that an adjustment takes beside the network itself, by what takes them."""

    partials: int
    """Partials and residuals of one linearisation, with the lists of its rays and rows."""
    points: int
    """Factors of the object points, and their products with the cameras (W)."""
    fronts: int
    """Fronts of the reduced system."""
    reliability: int
    """What reliability takes besides: products with covariances, leverages, tests."""

    @property
    def adjustment(self) -> int:
        """Bytes of the adjustment."""
        return self.partials + self.points + self.fronts

    @property
    def total(self) -> int:
        """Bytes of adjustment and reliability."""
        return self.adjustment + self.reliability

    def __str__(self) -> str:
        """Return both in gigabytes."""
        return (
            f"{self.adjustment / GIGABYTE:.2f} GB, {self.total / GIGABYTE:.2f} GB with reliability"
        )


def estimate_memory(
    plan: EliminationPlan, equations: Equations, state: State, *, iterative: bool = False
) -> MemoryEstimate:
    """Estimate the memory of an adjustment from its index lists.

    Args:
        plan: the layers of the elimination.
        equations: the network.
        state: any state; the fronts depend on where photos and points are.
        iterative: whether conjugate gradients are to take the place of the fronts; a plan for
            them is always estimated so.
    """
    rays = pairs = spokes = 0
    columns = 8
    if equations.rays:
        rays = sum(c.block.n for c in equations.rays.values())
        columns = 2 * max(2 + c.own + len(c.lens_free) for c in equations.rays.values())
    rows = equations.n_rows - 2 * rays
    points = 0
    width, side = plan.nodes.width, plan.nodes.side
    if plan.rays is not None:
        points, pairs = plan.rays.n_points, len(plan.rays.left)
        if plan.rays.spokes is not None:
            spokes = len(plan.rays.spokes.points)
    if iterative or plan.clusters:
        own, pairs = width * MAX_CLUSTER_NODES, 0
        # Blocks of clusters and their inverses, and W of one cluster as a matrix of its points.
        rays_of_nodes = NO_ROWS if plan.rays is None else np.bincount(plan.rays.node_of_ray)
        most = np.sort(rays_of_nodes)[-MAX_CLUSTER_NODES:].sum()
        fronts = 2 * plan.nodes.n * width * own + 3 * int(most) * own + 2 * side * side
        fronts += 6 * plan.nodes.n * width * (width + side)
    else:
        _, order = plan.nodes.structure(plan.pair_codes, lambda: plan.nodes.positions(state))
        sizes = [(width * len(f.own), width * f.size + side) for f in order]
        # Factors, and what waits for the parent at the same time: at most once more.
        fronts = 2 * sum(own * whole for own, whole in sizes) + max((w * w for _, w in sizes))
    w = 3 * width * (rays + spokes) * BYTES_PER_NUMBER
    of_rays = rays * (columns * BYTES_PER_NUMBER + LIST_BYTES_PER_RAY) + (
        CHUNK_BYTES if rays else 0
    )
    return MemoryEstimate(
        partials=of_rays + rows * (BYTES_PER_ROW + PRODUCT_BYTES_PER_ROW * width**2),
        points=points * (BYTES_PER_POINT + 6 * side * BYTES_PER_NUMBER)
        + w
        + pairs * BYTES_PER_NUMBER,
        fronts=fronts * BYTES_PER_NUMBER,
        reliability=w
        + rays * RELIABILITY_NUMBERS_PER_RAY * BYTES_PER_NUMBER
        + 6 * points * side * BYTES_PER_NUMBER
        + rows * RELIABILITY_BYTES_PER_ROW,
    )


def free_memory_bytes() -> float:
    """Return the bytes of memory that are free; infinite where the system does not report them."""
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            for line in lines:
                if line.startswith("MemAvailable:"):
                    return 1024.0 * float(line.split()[1])
        return float(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (OSError, ValueError, AttributeError):
        return float("inf")


GRADIENTS_HINT = (
    "or solve by conjugate gradients (adjust --solver conjugate-gradients, in Python "
    "solver='conjugate-gradients'), without the covariances of all unknowns"
)
"""What to do where fronts, or pairs of photos, do not fit in memory."""


def refuse_too_many_pairs(equations: Equations) -> None:
    """Refuse a direct solution whose pairs of rays to common points do not fit in memory.

    Their number grows with the square of the rays to a point, and they are listed before anything
    else is known of the memory.

    Raises:
        InputError: the pairs take more memory than is free; it states both figures.
    """
    counts = np.zeros(len(equations.unknowns["point"].names))
    for place in equations.rays:
        points = equations.blocks[place].variables[2][1]
        counts += np.bincount(points, minlength=len(counts))
    pairs = float(np.sum(counts * (counts - 1.0))) / 2.0
    needed, free = BYTES_PER_PAIR * pairs, free_memory_bytes()
    if MIN_BYTES_CHECKED < needed > free:
        raise InputError(
            f"the adjustment of network {equations.network.name!r} takes about "
            f"{needed / GIGABYTE:.2f} GB, for {pairs:.2g} pairs of rays to common points alone, "
            f"and {free / GIGABYTE:.2f} GB of memory are free: end other programs, divide the "
            f"network into parts, measure fewer points in the photos, {GRADIENTS_HINT}"
        )


def refuse_too_large(plan: EliminationPlan, equations: Equations, state: State) -> None:
    """Refuse an adjustment that takes more memory than there is.

    Raises:
        InputError: the adjustment takes more memory than is free; it states both figures.
    """
    # Pairs and fronts take long to count; small networks are let through without them.
    rays = sum(c.block.n for c in equations.rays.values())
    if rays * 500 + equations.n_rows * BYTES_PER_ROW < MIN_BYTES_CHECKED:
        return
    needed, free = estimate_memory(plan, equations, state), free_memory_bytes()
    if needed.adjustment > free:
        other = ""
        if plan.rays is not None and not plan.clusters:
            less = estimate_memory(plan, equations, state, iterative=True).adjustment
            if less < free:
                other = f", {GRADIENTS_HINT} ({less / GIGABYTE:.2f} GB)"
        raise InputError(
            f"the adjustment of network {equations.network.name!r} takes about {needed}, and "
            f"{free / GIGABYTE:.2f} GB of memory are free: end other programs, divide the network "
            f"into parts, or measure fewer points in the photos{other}"
        )

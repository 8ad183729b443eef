"""Cofactors of a solved base in reduced coordinates; errors of its linear forms, also predicted.

Cofactors. A point that only cameras see follows the other unknowns, x_p = C x + L⁻ᵀ e, where e is
independent of them and of all other points and has the covariance I (`ReducedPoints.carried`). The
coordinates here are the unknowns of the reduced system, then a slot of three coordinates e for each
such point that a function touches. Their cofactors are those of the reduced system, and I: large
blocks of points cost nothing until they are touched.

Linear forms. With v and A of the observations of the base at the present state, and v₀ + A₀ dx
their linear forms,

    g = Aᵀv − A₀ᵀ(v₀ + A₀ dx)      what the linear forms miss of the gradient
    dx' = −Q g                     the step that is left
    t = ‖Q^½ (AᵀA − A₀ᵀA₀) Q^½‖    largest relative error of a variance, by power iteration.

An examination costs a few linearisations. Between two of them both are predicted from the length
‖dx‖ = √(dxᵀN dx) of the movement: the step, relative to σ, grows at most with the square of the
length, as its part from the residuals v₀ grows with the length, and t grows with the length. What
moves after an examination is mostly elsewhere. Step and t of both are composed as the lengths are,
with the cosine of their angle in the metric of N; where what they miss has one direction all the
same, these laws allow twice the step that is predicted, and √2 times t. Along combinations of
unknowns that hardly any observation determines, t grows with the square too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..types import NO_ROWS, Array, Index
from .factorisation import Factorisation
from .linearised_equations import LinearisedEquations
from .normal_equations import PROBE_SEED, estimates_from_noise
from .solution import Solution

POWER_ITERATION_SEED = 1
"""Seed of the first vector of the power iteration."""
FIRST_POWER_STEPS = 4
"""Number of steps of the power iteration at the first examination. A later one makes one step, from
the vector at which the previous one ended."""
REACH_FACTOR = 2.0
"""Length, relative to that of an examined movement, from which its prediction is enlarged."""
MAX_GAIN_GROWTH = 4.0
"""Factor by which ``gained`` may grow since an examination."""
SIGMA_SAMPLES = 16
"""Number of samples from which standard deviations are estimated."""
MAX_RANDOM_NUMBERS = 4_000_000
"""Number of random numbers for which samples are computed at once."""
POINT_SLOTS = 256
"""Number of slots: a limit for rows beside a base, of which few touch two points each."""


@dataclass(frozen=True, eq=False)
class LinearisationDrift:
    """Examined errors of the linear forms, and their prediction."""

    weights: Array
    """D⁻¹v of the update at that moment, (k,)."""
    left: float
    """Largest step that was left, relative to its own σ."""
    turned: float
    """Largest relative error of a variance, t."""
    length: float
    """Length of the movement from the base, ‖dx‖."""
    curvature: float
    """Step that is left, relative to σ, for the square of the length of the movement."""
    rate: float
    """Relative error of a variance for the length of the movement."""
    reach: float
    """Length of the movement at which curvature and rate were seen."""
    gained: float
    """Largest factor by which rows that joined had made a variance smaller."""
    direction: Array | None
    """The last vector of the power iteration, (n_columns,); None: there was none."""

    def predicted(self, ahead: float, gained: float, inner: float = np.inf) -> tuple[float, float]:
        """Return bounds of left step and t after a movement since the examination.

        Both are infinite where a row has determined something that was known far less before: the
        movement along it shows nothing of the curvature there. Where the movement is longer than
        `REACH_FACTOR` times the examined one, both are multiplied by the square of the excess
        ratio.

        Args:
            ahead: length of the movement.
            gained: largest factor by which rows that joined make a variance smaller.
            inner: dxᵀN dx' of the movements before the examination and since; infinite: they have
                one direction.
        """
        if gained > MAX_GAIN_GROWTH * self.gained or (ahead > 0 and not self.reach > 0):
            return np.inf, np.inf
        most = self.length * ahead
        along = min(max(inner / most, 0.0), 1.0) if most > 0 else 1.0
        left = self.left + self.curvature * (2.0 * along * most + ahead**2)
        left = max(left, 0.5 * (self.left + self.curvature * (2.0 * most + ahead**2)))
        more = self.rate * ahead
        square = self.turned**2 + 2.0 * along * self.turned * more + more**2
        seen = REACH_FACTOR * self.reach
        farther = max(1.0, (self.length + ahead) / seen) ** 2 if seen > 0 else 1.0
        return left * farther, float(np.sqrt(square)) * farther

    def renewed(self) -> LinearisationDrift:
        """Return the expected errors of a new base of nearly the same observations."""
        out = replace(self, left=0.0, turned=0.0, length=0.0, gained=1.0)
        return replace(out, weights=self.weights[:0], direction=None)


def missed_gradient(
    here: LinearisedEquations, there: LinearisedEquations, movement: Array, apart: Index = NO_ROWS
) -> Array:
    """Return the error of the gradient by the linear forms, (n_columns,).

    Args:
        here: the base, linearised.
        there: the same observations at the present state.
        movement: movement of the unknowns between them, (n_columns,).
        apart: rows that are not examined.
    """
    linear = here.every_residual + here.times(movement[:, None])[:, 0]
    now = there.every_residual
    linear[apart] = now[apart] = 0.0
    return np.asarray(there.transposed(now[:, None])[:, 0] - here.transposed(linear[:, None])[:, 0])


def largest_variance_error(
    here: LinearisedEquations,
    there: LinearisedEquations,
    factor: Factorisation,
    start: Array | None,
    apart: Index = NO_ROWS,
) -> tuple[float, Array]:
    """Return t, and the vector of the power iteration with Q (AᵀA − A₀ᵀA₀).

    Args:
        here: the base, linearised.
        there: the same observations at the present state.
        factor: the factorised base.
        start: the vector of an earlier examination; None: there was none.
        apart: rows that are not examined.
    """
    steps = 1
    if start is None:
        steps = FIRST_POWER_STEPS
        noise = np.random.default_rng(POWER_ITERATION_SEED).standard_normal(
            (len(here.every_residual), 1)
        )
        start = factor.solve(here.transposed(noise))[:, 0]
    x, size = start[:, None], 0.0
    for _ in range(steps):
        ahead = here.times(x)
        length = float(np.linalg.norm(ahead))
        if not length > 0:
            return 0.0, start
        ahead, now = ahead / length, there.times(x / length)
        ahead[apart] = now[apart] = 0.0
        change = there.transposed(now) - here.transposed(ahead)
        y = factor.solve(change)
        # √(yᵀ N y) of y = Q δN x, with N y = δN x.
        size = float(np.sqrt(max(float(change[:, 0] @ y[:, 0]), 0.0)))
        if not size > 0:
            return 0.0, start
        x = y
    return size, np.asarray(x[:, 0])


class ReducedCofactors:
    """Cofactors Q of the coordinates, as `factorgraph_adj.solve.low_rank_update.Cofactors`."""

    def __init__(self, base: Solution) -> None:
        """Take the factorised system of a solution over."""
        self.base = base
        factor = base.factor
        n = factor.layers.unknowns.n_columns
        self.columns: Index = factor.reduced_columns
        """Columns of the reduced system, (r,)."""
        self.place: Index = np.full(n, -1, dtype=np.intp)
        """Coordinate of each column, −1 for columns of points that only cameras see."""
        self.place[self.columns] = np.arange(len(self.columns))
        self.slots = POINT_SLOTS if factor.points is not None else 0

    @property
    def factor(self) -> Factorisation:
        """The factorised system."""
        return self.base.factor

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self.columns) + 3 * self.slots

    def times(self, at: Index, b: Array) -> Array:
        """Return Q Bᵀ, see `factorgraph_adj.solve.low_rank_update.Cofactors`."""
        r = len(self.columns)
        out = np.zeros((self.size, len(b)))
        inner = at < r
        y = np.zeros((r, len(b)))
        y[at[inner]] = b[:, inner].T
        out[:r] = self.factor.solve_reduced(y)
        out[at[~inner]] = b[:, ~inner].T
        return out

    @cached_property
    def sigma(self) -> Array:
        """Standard deviations of all unknowns from samples, to about a fifth, (n_columns,)."""
        system, source = self.base.normal().system, np.random.default_rng(PROBE_SEED)
        n = max(1, min(SIGMA_SAMPLES, MAX_RANDOM_NUMBERS // system.equations.n_rows))
        total = np.zeros(len(self.place))
        for first in range(0, SIGMA_SAMPLES, n):
            found = estimates_from_noise(system, self.factor, min(n, SIGMA_SAMPLES - first), source)
            total += np.einsum("ij,ij->i", found, found)
        return np.sqrt(total / SIGMA_SAMPLES)

    @cached_property
    def _local(self) -> Index:
        """Number in the first layer of the point of each column; −1: none."""
        out = np.full(len(self.place), -1, dtype=np.intp)
        columns = self.factor.layers.point_columns
        out[columns] = np.arange(len(columns))[:, None]
        return out

    def expand(self, columns: Index, a: Array, slots: Mapping[int, int]) -> ReducedFunctions:
        """Return functions of the unknowns as functions of the coordinates.

        Args:
            columns: columns that the functions touch, each once, (m,).
            a: the functions, (k, m).
            slots: slots of points, by their numbers in the first layer.
        """
        place = self.place[columns]
        inner = place >= 0
        if inner.all():
            return ReducedFunctions(place, a, np.zeros((len(a),) * 2))
        at, parts = [place[inner]], [a[:, inner]]
        own = np.zeros((len(a),) * 2)
        points = self.factor.points
        assert points is not None
        local = self._local[columns]
        first = self.factor.layers.point_columns[:, 0]
        for point in np.unique(local[~inner]).tolist():
            mine = np.flatnonzero(local == point)
            axes = columns[mine] - first[point]
            others, carried, half = points.carried(point)
            part = a[:, mine]
            at.append(self.place[others])
            parts.append(part @ carried[axes])
            of_point = part @ half[axes]
            if point in slots:
                at.append(len(self.columns) + 3 * slots[point] + np.arange(3))
                parts.append(of_point)
            else:
                own += of_point @ of_point.T
        places, which = np.unique(np.concatenate(at), return_inverse=True)
        out = np.zeros((len(a), len(places)))
        np.add.at(out.T, which, np.concatenate(parts, axis=1).T)
        return ReducedFunctions(places, out, own)

    def unknowns(self, z: Array, slots: Mapping[int, int]) -> Array:
        """Return all unknowns (n_columns,) from the coordinates, those without a slot zero."""
        factor, r = self.factor, len(self.columns)
        out = np.zeros(len(self.place))
        out[self.columns] = z[:r]
        points, nodes = factor.points, factor.nodes
        if points is None:
            return out
        places = np.where(nodes.columns >= 0, out[np.maximum(nodes.columns, 0)], 0.0)
        e = np.zeros((3, 1, len(factor.layers.point_columns)))
        for point, slot in slots.items():
            e[:, 0, point] = z[r + 3 * slot : r + 3 * slot + 3]
        out[factor.layers.point_columns] = points.backward(e, places[:, None])[:, :, 0]
        return out

    def gradient(self, g: Array, slots: Mapping[int, int]) -> Array:
        """Return a gradient by all unknowns (n_columns,) as one by the coordinates."""
        factor, r = self.factor, len(self.columns)
        out = np.zeros(self.size)
        out[:r] = g[self.columns]
        points, nodes = factor.points, factor.nodes
        if points is None:
            return out
        reduced = np.zeros((len(nodes.columns), 1))
        e = points.forward(np.where(factor.free, g, 0.0)[:, None], reduced)
        on = nodes.columns >= 0
        out[self.place[nodes.columns[on]]] += reduced[on, 0]
        for point, slot in slots.items():
            out[r + 3 * slot : r + 3 * slot + 3] = e[:, 0, point]
        return out

    def with_slots(self, columns: Index, slots: Mapping[int, int]) -> dict[int, int]:
        """Return slots, and beside them new ones of the points that columns belong to."""
        out = dict(slots)
        for point in self.touched(columns):
            out.setdefault(point, len(out))
        return out

    def touched(self, columns: Index) -> list[int]:
        """Return the numbers of the points in the first layer that columns belong to."""
        if not self.slots:
            return []
        found = self._local[columns]
        return list(np.unique(found[found >= 0]).tolist())


@dataclass(frozen=True)
class ReducedFunctions:
    """k linear functions of the coordinates."""

    at: Index
    """Coordinates that they touch, each once, (m,)."""
    b: Array
    """The functions, (k, m)."""
    own: Array
    """Cofactors of the parts that depend on points without a slot, (k, k)."""

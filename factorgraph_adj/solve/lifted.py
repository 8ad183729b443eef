"""Cofactors of an adjusted network in the coordinates of its reduced system.

A point that only cameras see follows the other unknowns, x_p = C x + L⁻ᵀ e, where e is independent
of them and of all other points and has the covariance I (`ReducedPoints.carried`). The coordinates
here are the unknowns of the reduced system, then a slot of three coordinates e for each such point
that a function touches. Their cofactors are those of the reduced system, and I: large blocks of
points cost nothing until they are touched.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..types import Array, Index
from .factor import Factor
from .solution import Solution
from .trust import SEED, sample

SAMPLES = 16
"""Number of samples from which standard deviations are estimated."""
AT_ONCE = 4_000_000
"""Number of random numbers for which samples are worked out at once."""
ROOM = 256
"""Number of slots: a limit for rows beside a base, of which few touch two points each."""


class Lifted:
    """Cofactors Q of the coordinates, as `factorgraph_adj.solve.update.Cofactors`."""

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
        self.slots = ROOM if factor.points is not None else 0

    @property
    def factor(self) -> Factor:
        """The factorised system."""
        return self.base.factor

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self.columns) + 3 * self.slots

    def times(self, at: Index, b: Array) -> Array:
        """Return Q Bᵀ, see `factorgraph_adj.solve.update.Cofactors`."""
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
        system, source = self.base.normal().system, np.random.default_rng(SEED)
        n = max(1, min(SAMPLES, AT_ONCE // system.equations.n_rows))
        total = np.zeros(len(self.place))
        for first in range(0, SAMPLES, n):
            found = sample(system, self.factor, min(n, SAMPLES - first), source)
            total += np.einsum("ij,ij->i", found, found)
        return np.sqrt(total / SAMPLES)

    @cached_property
    def _local(self) -> Index:
        """Number in the first layer of the point of each column; −1: none."""
        out = np.full(len(self.place), -1, dtype=np.intp)
        columns = self.factor.layers.point_columns
        out[columns] = np.arange(len(columns))[:, None]
        return out

    def expand(self, columns: Index, a: Array, slots: Mapping[int, int]) -> Function:
        """Return functions of the unknowns as functions of the coordinates.

        Args:
            columns: columns that the functions touch, each once, (m,).
            a: the functions, (k, m).
            slots: slots of points, by their numbers in the first layer.
        """
        place = self.place[columns]
        inner = place >= 0
        if inner.all():
            return Function(place, a, np.zeros((len(a),) * 2))
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
        return Function(places, out, own)

    def unknowns(self, z: Array, slots: Mapping[int, int]) -> Array:
        """Return all unknowns (n_columns,) from the coordinates, those without a slot zero."""
        factor, r = self.factor, len(self.columns)
        out = np.zeros(len(self.place))
        out[self.columns] = z[:r]
        points, nodes = factor.points, factor.nodes
        if points is None or nodes is None:
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
        if points is None or nodes is None:
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
class Function:
    """k linear functions of the coordinates."""

    at: Index
    """Coordinates that they touch, each once, (m,)."""
    b: Array
    """The functions, (k, m)."""
    own: Array
    """Cofactors of the parts that depend on points without a slot, (k, k)."""

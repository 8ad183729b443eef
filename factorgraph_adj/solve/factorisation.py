"""Factorisation of N in two layers by Cholesky or QR: plan, pivots, solutions, covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..blas_threads import with_one_thread
from ..graph.equations import Equations
from ..types import NO_ROWS, Array, Index
from .block_matrix import BlockMatrix
from .conjugate_gradients import MAX_CLUSTER_NODES, ConjugateGradients, visibility_clusters
from .elimination_layers import Layers
from .fronts import Fronts
from .linearised_equations import LinearisedEquations
from .nested_dissection import MAX_LEAF_NODES, BlockPattern
from .node_rows import NodeRows
from .point_elimination import RayCovariances, ReducedPoints
from .point_rays import PointRays, RaySums
from .qr_fronts import RowElements, fronts_by_qr
from .reduced_system import DenseNormals, Nodes, joined_node_pairs


@dataclass(frozen=True)
class EliminationPlan:
    """The layers of an elimination and their index lists; a network makes them once."""

    layers: Layers
    """The layers."""
    nodes: Nodes
    """Places in the second layer."""
    rays: PointRays | None
    """Rays to the points of the first layer; None: it is empty."""
    rows: NodeRows | None
    """Places of the observations in the second layer; None: it is one front by QR, whose nodes are
    all joined."""
    clusters: tuple[Index, ...] = ()
    """Clusters of nodes with common points, where conjugate gradients take the place of fronts."""

    @classmethod
    def of(cls, equations: Equations, layers: Layers) -> EliminationPlan:
        """Make the index lists of a network."""
        nodes = Nodes(equations, layers)
        rays = PointRays(equations, nodes) if layers.reduced.any() else None
        return cls.joining(equations, nodes, rays)

    @classmethod
    def by_gradients(
        cls, equations: Equations, layers: Layers, cluster_size: int = MAX_CLUSTER_NODES
    ) -> EliminationPlan:
        """Make the index lists of a network that conjugate gradients solve; it has a first layer.

        Args:
            equations: the network.
            layers: the layers.
            cluster_size: largest number of nodes in a block of the preconditioner.
        """
        nodes = Nodes(equations, layers)
        rays = PointRays(equations, nodes, paired=False)
        clusters = visibility_clusters(rays, cluster_size)
        return cls(layers, nodes, rays, NodeRows(equations, nodes), clusters)

    @classmethod
    def joining(cls, equations: Equations, nodes: Nodes, rays: PointRays | None) -> EliminationPlan:
        """Find the places of the observations; ``rays``: to the points of the first layer."""
        one = nodes.layers.by_qr and nodes.n <= MAX_LEAF_NODES
        if one:
            nodes.leaves = NO_ROWS
        return cls(nodes.layers, nodes, rays, None if one else NodeRows(equations, nodes))

    @cached_property
    def pair_codes(self) -> Index:
        """Pairs of nodes that observations and points of the first layer join, n a + b each."""
        n = self.nodes.n
        if self.rows is None:
            first, second = np.triu_indices(n, 1)
            return np.asarray(first * n + second, dtype=np.intp)
        if self.rays is None:
            return self.rows.pair_codes
        return np.concatenate([self.rows.pair_codes, self.rays.pair_codes])

    def sums(self, system: LinearisedEquations) -> RaySums | None:
        """Return the products of the rays of a linearisation; None: there is no first layer."""
        return None if self.rays is None else RaySums(self.rays, system)


class Factorisation:
    """N + diag(extra) of one linearisation, factorised in two `Layers`.

    Held components have a one on the diagonal and zeros elsewhere, so that their steps and
    covariances are zero after masking.
    """

    uncertainty: float = 0.0
    """Relative error of variances by random probes, see `probed_variance_error`; zero before."""
    _inner: Array | None = None
    points: ReducedPoints | None = None
    """The first layer; None: it is empty."""

    def __init__(self, prepared: PreparedElimination, extra: Array) -> None:
        """Factorise.

        Args:
            prepared: layers, index lists and products of one linearisation.
            extra: added to the diagonal (damping, minimal datum), (n_columns,).

        Raises:
            SingularError: a pivot vanished.
        """
        plan, system = prepared.plan, prepared.system
        self.layers, self.nodes = plan.layers, plan.nodes
        """``nodes``: places of the unknowns in the second layer."""
        self.free = plan.layers.unknowns.free
        nodes = plan.nodes
        diagonal = np.where(self.free, extra, 1.0)
        if prepared.sums is not None:
            self.points = ReducedPoints(prepared.sums, diagonal)
        dense = [DenseNormals(e.columns, e.a.T @ e.a) for e in system.extra]
        codes = plan.pair_codes
        if dense or system.clusters:
            of_clusters = (nodes.pairs_of(c.columns) for c in system.clusters)
            codes = np.concatenate([codes, *of_clusters, joined_node_pairs(nodes, dense)])
        if plan.clusters:
            first, second = np.divmod(np.unique(codes), nodes.n)
            pattern = BlockPattern(nodes.n, nodes.width, nodes.side, first, second)
            matrix = self._matrix(prepared, pattern, diagonal, dense)
            assert self.points is not None
            self.fronts: Fronts | ConjugateGradients = ConjugateGradients(
                matrix, self.points, nodes.held, plan.clusters
            )
            """The second layer."""
            return
        pattern, fronts = nodes.structure(codes, lambda: nodes.positions(system.state))
        if prepared.rows is not None:
            rows = _with_diagonal(prepared.rows, nodes, diagonal)
            self.fronts = fronts_by_qr(fronts, pattern, rows, nodes.held)
            return
        matrix = self._matrix(prepared, pattern, diagonal, dense)
        self.fronts = Fronts.of(fronts, matrix, nodes.kept)

    def _matrix(
        self,
        prepared: PreparedElimination,
        pattern: BlockPattern,
        diagonal: Array,
        dense: Sequence[DenseNormals],
    ) -> BlockMatrix:
        """Return the matrix of the second layer in the blocks of a pattern."""
        plan, system, nodes = prepared.plan, prepared.system, self.nodes
        matrix = BlockMatrix.zeros(pattern) if self.points is None else self.points.matrix(pattern)
        if plan.rows is not None:
            plan.rows.add_to(matrix, system)
        for c in system.clusters:
            nodes.add_normals(matrix, c.columns, c.a.transpose(0, 2, 1) @ c.a)
        for d in dense:
            d.add_to(nodes, matrix)
        nodes.add_diagonal(matrix, diagonal)
        nodes.hold(matrix)
        return matrix

    def smallest_pivot(self, diagonal: Array, *, fronts: float = 1.0, points: float = 1.0) -> float:
        """Return the smallest of the `relative_pivots`."""
        out = self.relative_pivots(diagonal, fronts=fronts, points=points)
        return float(out[self.free].min()) if self.free.any() else 1.0

    def relative_pivots(
        self, diagonal: Array, *, fronts: float = 1.0, points: float = 1.0
    ) -> Array:
        """Return all pivots relative to their diagonal elements before the elimination.

        Pivots of columns that are not eliminated are infinite.

        Args:
            diagonal: diagonal of N with the added terms, (n_columns,).
            fronts: factor on the pivots of the fronts: QR resolves more than normal equations.
            points: factor on the pivots of single points.
        """
        free = self.free
        safe = np.where(free, np.maximum(diagonal, np.finfo(float).tiny), 1.0)
        out = np.ones(len(free))
        if self.points is not None:
            out[self.layers.point_columns] = self.points.cholesky.pivots.T * points
        columns = self.nodes.columns
        on = columns >= 0
        pivots = self.fronts.pivots
        with np.errstate(invalid="ignore"):  # a kept column may have no observations
            left = np.where(np.isinf(pivots), np.inf, pivots * self.fronts.diagonal)
        out[columns[on]] = left[on] / safe[columns[on]] * fronts
        return out

    @with_one_thread
    def solve(self, y: Array, kept: Array | None = None) -> Array:
        """Return x of (N + diag) x = y for y (n_columns, k); held components are zero.

        Args:
            y: right sides.
            kept: solution of the columns that are not eliminated, (m, k); None: it follows from
                their covariances, where there are such columns.
        """
        y = np.where(self.free[:, None], y, 0.0)
        x = np.zeros_like(y)
        reduced, z = self._forward(y)
        columns = self.nodes.columns
        on = columns >= 0
        solved = self.fronts.solve(reduced, kept)
        x[columns[on]] = solved[on]
        if self.points is not None and z is not None:
            x[self.layers.point_columns] = self.points.backward(z, solved)
        x[~self.free] = 0.0
        return x

    @cached_property
    def reduced_columns(self) -> Index:
        """Columns of the reduced system: all but those of the points of the first layer, (r,)."""
        inside = np.ones(self.layers.unknowns.n_columns, dtype=bool)
        if self.points is not None:
            inside[self.layers.point_columns] = False
        return np.flatnonzero(inside)

    @with_one_thread
    def solve_reduced(self, y: Array) -> Array:
        """Return x (r, k) of the system without the points of the first layer, eliminated.

        Args:
            y: right sides at `reduced_columns`, (r, k).
        """
        on = self.nodes.columns >= 0
        at = np.searchsorted(self.reduced_columns, self.nodes.columns[on])
        reduced = np.zeros((len(on), y.shape[1]))
        reduced[on] = y[at]
        x = np.zeros_like(y)
        x[at] = self.fronts.solve(reduced)[on]
        return x

    @with_one_thread
    def remaining(self, y: Array) -> Array:
        """Return what the elimination of y (n_columns, k) leaves at the kept columns, (m, k)."""
        y = np.where(self.free[:, None], y, 0.0)
        return self.fronts.remaining(self._forward(y)[0])

    def _forward(self, y: Array) -> tuple[Array, Array | None]:
        """Eliminate the first layer from right sides; return the reduced ones, and L⁻¹ y_p."""
        columns = self.nodes.columns
        on = columns >= 0
        reduced = np.zeros((len(columns), y.shape[1]))
        z = None if self.points is None else self.points.forward(y, reduced)
        reduced[on] += y[columns[on]]
        reduced[~on] = 0.0
        return reduced, z

    # -- covariances ----------------------------------------------------------------------------

    @cached_property
    @with_one_thread
    def inverse(self) -> BlockMatrix:
        """Covariances of the second layer at the blocks of its fronts; zero at held places."""
        out = self.fronts.inverse()
        free = (~self.nodes.held).astype(float)
        return out if free.all() else out.scaled(free)

    def joint(self, columns: Index) -> Array:
        """Return the joint covariances (n, k, k) of sets of columns (n, k) of the second layer.

        The columns of a set belong to variables of one observation; −1 and held components give
        zeros.
        """
        places = np.where(columns >= 0, self.nodes.place_of[np.maximum(columns, 0)], -1)
        out = np.zeros((*places.shape, places.shape[1]))
        on = (places[:, :, None] >= 0) & (places[:, None, :] >= 0)
        if on.any():
            rows, others = np.broadcast_arrays(places[:, :, None], places[:, None, :])
            out[on] = self.inverse.at(rows[on], others[on])
        return out

    @with_one_thread
    def squares(self, columns: Index, a: Array) -> Array:
        """Return A Σ Aᵀ (n, d, d) of observations of the second layer, from half the solution.

        No digits cancel in |L⁻¹Aᵀ|² if Σ is large along a direction that an observation hardly
        measures, such as to a far point.

        Args:
            columns: columns that each observation touches, −1: none, (n, k).
            a: partials by them, (n, d, k).
        """
        if len(self.nodes.kept):  # the root is not factorised
            return np.asarray(a @ self.joint(columns) @ a.transpose(0, 2, 1))
        n, d, _ = a.shape
        places = np.where(columns >= 0, self.nodes.place_of[np.maximum(columns, 0)], -1)
        y = np.zeros((len(self.nodes.columns), n, d))
        row, on = np.nonzero(places >= 0)
        np.add.at(y, (places[row, on], row), a[row, :, on])
        half = self.fronts.half(y.reshape(len(y), n * d)).reshape(len(y), n, d)
        return np.asarray(np.einsum("pni,pnj->nij", half, half))

    @with_one_thread
    def ray_covariances(self) -> RayCovariances | None:
        """Return the joint covariances of the first layer with the second; None: it is empty.

        They have 24 numbers for each ray, and are not kept.
        """
        if self.points is None:
            return None
        joint = self.points.joint(self.inverse)
        self._inner = joint.inner
        return joint

    @with_one_thread
    def point_covariances(self) -> Array:
        """Return the covariance of every point of the first layer, (p, 3, 3)."""
        if self.points is None:
            return np.zeros((0, 3, 3))
        if self._inner is None:
            self._inner = self.points.joint(self.inverse).inner
        return self.points.covariances(self._inner)


@dataclass(frozen=True)
class PreparedElimination:
    """What all factorisations of one linearisation have in common."""

    plan: EliminationPlan
    """Layers and index lists."""
    system: LinearisedEquations
    """The linearisation."""
    sums: RaySums | None
    """Products of the rays; None: there is no first layer."""
    rows: RowElements | None
    """Rows of all observations by the places of the second layer, for QR; None: the fronts are
    factorised by Cholesky."""

    @classmethod
    def of(cls, system: LinearisedEquations, plan: EliminationPlan) -> PreparedElimination:
        """Return that of a linearisation."""
        rows = _rows(system, plan.nodes) if plan.layers.by_qr else None
        return cls(plan, system, plan.sums(system), rows)

    def factorised(self, extra: Array) -> Factorisation:
        """Return N + diag(extra); see `Factorisation`.

        Raises:
            SingularError: a pivot vanished.
        """
        return Factorisation(self, extra)


def _rows(system: LinearisedEquations, nodes: Nodes) -> RowElements:
    """Return the whitened rows of all observations by the places of the second layer."""
    parts = []
    for number, lb in enumerate(system.blocks):
        block = lb.block
        clustered = system.equations.in_cluster.get(number)
        for offset, a in zip(lb.offsets, lb.a, strict=True):
            if not len(a):
                continue
            columns = offset[:, None] + np.arange(a.shape[2])
            at = nodes.place_of[np.clip(columns, 0, len(nodes.place_of) - 1)]
            on = (a != 0.0) & ((offset[:, None] >= 0) & (at >= 0))[:, None, :]
            if clustered is not None:
                on[clustered] = False
            i, d, j = np.nonzero(on)
            row = block.first_row + block.dimension * i + d
            parts.append(RowElements(row, at[i, j], a[i, d, j], 0))
    for c in system.clusters:
        places = nodes.place_of[c.columns]
        i, d, j = np.nonzero((c.a != 0.0) & (places >= 0)[:, None, :])
        row = c.batch.rows[i, d]
        parts.append(RowElements(row, places[i, j], c.a[i, d, j], 0))
    parts.append(RowElements(NO_ROWS, NO_ROWS, np.zeros(0), system.equations.n_rows))
    for columns, a in ((e.columns, e.a) for e in system.extra):
        d, j = np.nonzero((a != 0.0) & (nodes.place_of[columns] >= 0))
        parts.append(RowElements(d, nodes.place_of[columns[j]], a[d, j], len(a)))
    return RowElements.joined(parts)


def _with_diagonal(rows: RowElements, nodes: Nodes, diagonal: Array) -> RowElements:
    """Return rows and those of terms (n_columns,) on the diagonal of the normal matrix."""
    added = np.where(nodes.held, 0.0, diagonal[np.maximum(nodes.columns, 0)])
    at = np.flatnonzero(added > 0.0)
    more = RowElements(np.arange(len(at)), at, np.sqrt(added[at]), len(at))
    return RowElements.joined([rows, more]) if len(at) else rows

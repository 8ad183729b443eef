"""The factorised normal equations of a network: pivots, solutions and covariances."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..blas_threads import with_one_thread
from ..graph.equations import Equations
from ..types import Array, Index
from .bayes_tree import (
    Clique,
    SelectedInverse,
    TreeFactors,
    back_substitution,
    forward_substitution,
)
from .elimination_layers import Layers
from .fronts import BlockMatrix, Fronts
from .linearised_equations import LinearisedEquations
from .point_elimination import RayCovariances, ReducedPoints
from .point_rays import PointRays, RaySums
from .reduced_system import EliminationRemainder, Nodes, joined_node_pairs
from .terrestrial_rows import NodeRows


@dataclass(frozen=True)
class EliminationPlan:
    """The layers of an elimination and their index lists; a network makes them once."""

    layers: Layers
    """The layers."""
    nodes: Nodes | None = None
    """Places in the third layer; none: it is empty."""
    rays: PointRays | None = None
    """Rays to the points of the first layer; none: it is empty."""
    rows: NodeRows | None = None
    """Places of the terrestrial observations, where they are in the third layer."""

    @classmethod
    def of(cls, equations: Equations, layers: Layers) -> EliminationPlan:
        """Make the index lists of a network."""
        if not layers.has_cameras and not layers.reduced.any():
            return cls(layers)
        nodes = Nodes(equations, layers)
        rays = PointRays(equations, nodes) if layers.reduced.any() else None
        rows = NodeRows(equations, nodes) if layers.in_fronts else None
        return cls(layers, nodes, rays, rows)

    def sums(self, system: LinearisedEquations) -> RaySums | None:
        """Return the products of the rays of a linearisation; none: there is no first layer."""
        return None if self.rays is None else RaySums(self.rays, system)


class Factorisation:
    """N + diag(extra) of one linearisation, factorised in three `Layers`.

    Held components have a one on the diagonal and zeros elsewhere, so that their steps and
    covariances are zero after masking.
    """

    uncertainty: float = 0.0
    """Relative error of variances by random probes, see `probed_variance_error`; zero before."""
    _inner: Array | None = None
    points: ReducedPoints | None = None
    """The first layer; none: it is empty."""
    nodes: Nodes | None = None
    """Places of the unknowns in the third layer; none: it is empty."""
    fronts: Fronts | None = None
    """The third layer; none: it is empty."""

    def __init__(
        self,
        plan: EliminationPlan,
        sums: RaySums | None,
        factors: TreeFactors,
        extra: Array,
        *,
        qr: bool,
    ) -> None:
        """Factorise.

        Args:
            plan: the layers and their index lists.
            sums: products of the rays to points of the first layer; none: it is empty.
            factors: GTSAM's factors of the network.
            extra: added to the diagonal (damping, minimal datum), (n_columns,).
            qr: whether the tree is eliminated by QR.

        Raises:
            SingularError: a pivot vanished.
        """
        self.layers = plan.layers
        self.free = plan.layers.unknowns.free
        self.nodes = plan.nodes
        diagonal = np.where(self.free, extra, 1.0)
        self.cliques, rest = factors.eliminate(diagonal, qr=qr)
        if sums is not None:
            self.points = ReducedPoints(sums, diagonal)
        if self.nodes is not None:
            self.fronts = self._factorised(self.nodes, plan, factors.system, rest, diagonal)

    def _factorised(
        self,
        nodes: Nodes,
        plan: EliminationPlan,
        system: LinearisedEquations,
        rest: list[EliminationRemainder],
        extra: Array,
    ) -> Fronts:
        """Factorise the reduced system with what the elimination of the tree leaves."""
        codes = [joined_node_pairs(nodes, rest)]
        if plan.rays is not None:
            codes.append(plan.rays.pair_codes)
        if plan.rows is not None:
            rest = [EliminationRemainder(c, a.T @ a) for c, a in system.cluster_rows()]
            rest += [EliminationRemainder(e.columns, e.a.T @ e.a) for e in system.extra]
            codes += [plan.rows.pair_codes, joined_node_pairs(nodes, rest)]
        pattern, fronts = nodes.structure(np.concatenate(codes), nodes.positions(system.state))
        matrix = BlockMatrix.zeros(pattern) if self.points is None else self.points.matrix(pattern)
        if plan.rows is not None:
            plan.rows.add_to(matrix, system)
        for r in rest:
            r.add_to(nodes, matrix)
        nodes.add_diagonal(matrix, extra)
        nodes.hold(matrix)
        return Fronts(fronts, matrix, nodes.kept)

    def smallest_pivot(self, diagonal: Array, *, tree: float, point: float) -> float:
        """Return the smallest of the `relative_pivots`."""
        out = self.relative_pivots(diagonal, tree=tree, point=point)
        return float(out[self.free].min()) if self.free.any() else 1.0

    def relative_pivots(self, diagonal: Array, *, tree: float, point: float) -> Array:
        """Return all pivots relative to their diagonal elements before the elimination.

        Pivots of columns that are not eliminated are infinite.

        Args:
            diagonal: diagonal of N with the added terms, (n_columns,).
            tree: factor on the pivots of the tree, whose QR resolves more than normal equations.
            point: factor on the pivots of single points.
        """
        free = self.free
        safe = np.where(free, np.maximum(diagonal, np.finfo(float).tiny), 1.0)
        out = np.ones(len(free))
        for c in self.cliques:
            out[c.frontal] = np.diag(c.r) ** 2 / safe[c.frontal]
            out[c.frontal] *= np.where(free[c.frontal], tree, 1.0)
        if self.points is not None:
            out[self.layers.point_columns] = self.points.cholesky.pivots.T * point
        if self.nodes is not None and self.fronts is not None:
            columns = self.nodes.columns
            on = columns >= 0
            pivots = self.fronts.pivots
            with np.errstate(invalid="ignore"):  # a kept column may have no observations
                left = np.where(np.isinf(pivots), np.inf, pivots * self.fronts.diagonal)
            out[columns[on]] = left[on] / safe[columns[on]]
        return out

    @with_one_thread
    def solve(self, y: Array, kept: Array | None = None) -> Array:
        """Return x of (N + diag) x = y for y (n_columns, k); held components are zero.

        Args:
            y: right sides.
            kept: solution of the columns that are not eliminated, (m, k); none: it follows from
                their covariances, where there are such columns.
        """
        y = np.where(self.free[:, None], y, 0.0)
        x = np.zeros_like(y)
        if self.nodes is None or self.fronts is None:
            back_substitution(self.cliques, forward_substitution(self.cliques, y), x)
            x[~self.free] = 0.0
            return x
        reduced, z, halves = self._forward(self.nodes, y)
        columns = self.nodes.columns
        on = columns >= 0
        solved = self.fronts.solve(reduced, kept)
        x[columns[on]] = solved[on]
        back_substitution(self.cliques, halves, x)
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

    @cached_property
    def _inside(self) -> tuple[list[Clique], Index, Index]:
        """Cliques by places among `reduced_columns`, and places of the third layer in it."""
        place = np.full(self.layers.unknowns.n_columns, -1, dtype=np.intp)
        place[self.reduced_columns] = np.arange(len(self.reduced_columns))
        cliques = [
            replace(c, frontal=place[c.frontal], separator=place[c.separator]) for c in self.cliques
        ]
        if self.nodes is None:
            return cliques, place[:0], place[:0]
        on = np.flatnonzero(self.nodes.columns >= 0)
        return cliques, on, place[self.nodes.columns[on]]

    @with_one_thread
    def solve_reduced(self, y: Array) -> Array:
        """Return x (r, k) of the system without the points of the first layer, eliminated.

        Args:
            y: right sides at `reduced_columns`, (r, k).
        """
        held = ~self.free[self.reduced_columns]
        cliques, on, at = self._inside
        y = np.where(held[:, None], 0.0, y)
        x = np.zeros_like(y)
        halves = forward_substitution(cliques, y)
        if self.nodes is not None and self.fronts is not None:
            reduced = np.zeros((len(self.nodes.columns), y.shape[1]))
            reduced[on] = y[at]
            x[at] = self.fronts.solve(reduced)[on]
        back_substitution(cliques, halves, x)
        x[held] = 0.0
        return x

    @with_one_thread
    def remaining(self, y: Array) -> Array:
        """Return what the elimination of y (n_columns, k) leaves at the kept columns, (m, k)."""
        assert self.nodes is not None and self.fronts is not None
        y = np.where(self.free[:, None], y, 0.0)
        return self.fronts.remaining(self._forward(self.nodes, y)[0])

    def _forward(self, nodes: Nodes, y: Array) -> tuple[Array, Array | None, list[Array]]:
        """Eliminate points and tree from right sides; return the reduced ones, and the halves."""
        columns = nodes.columns
        on = columns >= 0
        reduced = np.zeros((len(columns), y.shape[1]))
        z = None if self.points is None else self.points.forward(y, reduced)
        halves = forward_substitution(self.cliques, y)
        reduced[on] += y[columns[on]]
        reduced[~on] = 0.0
        return reduced, z, halves

    # -- covariances ----------------------------------------------------------------------------

    @cached_property
    @with_one_thread
    def inverse(self) -> BlockMatrix:
        """Covariances of the third layer at the blocks of its fronts; zero at held places."""
        assert self.nodes is not None and self.fronts is not None
        out = self.fronts.inverse()
        free = (~self.nodes.held).astype(float)
        return out if free.all() else out.scaled(free)

    @with_one_thread
    def ray_covariances(self) -> RayCovariances | None:
        """Return the joint covariances of the first layer with the third; none: it is empty.

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

    @cached_property
    def selected(self) -> SelectedInverse:
        """Joint covariances of tree and cameras between the variables of one observation."""
        place = np.full(self.layers.unknowns.n_columns, -1, dtype=np.intp)
        inverse = None
        if self.nodes is not None:
            place, inverse = self.nodes.place_of, self.inverse
        return SelectedInverse(self.cliques, inverse, place, len(place))


@dataclass(frozen=True)
class PreparedElimination:
    """What all factorisations of one linearisation have in common."""

    plan: EliminationPlan
    """Layers and index lists."""
    sums: RaySums | None
    """Products of the rays; none: there is no first layer."""
    factors: TreeFactors
    """Factors of the second layer."""

    @classmethod
    def of(cls, system: LinearisedEquations, plan: EliminationPlan) -> PreparedElimination:
        """Return that of a linearisation."""
        return cls(plan, plan.sums(system), TreeFactors(plan.layers, system))

    def factorised(self, extra: Array, *, qr: bool) -> Factorisation:
        """Return N + diag(extra); see `Factorisation`.

        Raises:
            SingularError: a pivot vanished.
        """
        return Factorisation(self.plan, self.sums, self.factors, extra, qr=qr)

"""The factorised normal equations of a whole network: solutions and covariances."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..types import Array
from .elimination import Layers
from .fronts import BlockMatrix, Fronts
from .ray_sums import RaySums
from .reduction import RayCovariances, ReducedPoints
from .remainder import Remainder, joined
from .selected_inverse import SelectedInverse
from .tree import TreeFactors, down, up


class Factor:
    """N + diag(extra) of one linearisation, factorised in three `Layers`.

    Held components have a one on the diagonal and zeros elsewhere, so that their steps and
    covariances are zero after masking.
    """

    uncertainty: float = 0.0
    """Relative error of variances that random probes have shown, see `trust`; zero before them."""
    points: ReducedPoints | None = None
    """The first layer; none: it is empty."""
    fronts: Fronts | None = None
    """The third layer; none: it is empty."""

    def __init__(
        self, layers: Layers, sums: RaySums | None, factors: TreeFactors, extra: Array, *, qr: bool
    ) -> None:
        """Factorise.

        Args:
            layers: the layers of the elimination.
            sums: products of the rays to the points of the first layer; none: it is empty.
            factors: GTSAM's factors of the network.
            extra: added to the diagonal (damping, minimal datum), (n_columns,).
            qr: whether the tree is eliminated by QR.

        Raises:
            SingularError: a pivot vanished.
        """
        self.layers = layers
        self.free = layers.unknowns.free
        diagonal = np.where(self.free, extra, 1.0)
        self.cliques, rest = factors.eliminate(diagonal, qr=qr)
        if sums is not None:
            self.points = ReducedPoints(sums, diagonal)
            self.fronts = self._factorised(self.points, rest)

    def _factorised(self, points: ReducedPoints, rest: list[Remainder]) -> Fronts:
        """Factorise the reduced system with what the elimination of the tree leaves."""
        rays = points.rays
        centres = points.system.state["pose"][rays.photos, 9:]
        pattern, fronts = rays.structure(joined(rays, rest), centres)
        matrix = points.matrix(pattern)
        for r in rest:
            r.add_to(rays, matrix)
        rays.hold(matrix)
        return Fronts(fronts, matrix)

    def smallest_pivot(self, diagonal: Array, *, tree: float, point: float) -> float:
        """Return the smallest pivot relative to its diagonal element before the elimination.

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
        if self.points is not None and self.fronts is not None:
            out[self.layers.point_columns] = self.points.cholesky.pivots.T * point
            columns = self.points.rays.columns
            on = columns >= 0
            left = self.fronts.pivots * self.fronts.diagonal
            out[columns[on]] = left[on] / safe[columns[on]]
        return float(out[free].min()) if free.any() else 1.0

    def solve(self, y: Array) -> Array:
        """Return x of (N + diag) x = y for y (n_columns, k); held components are zero."""
        y = np.where(self.free[:, None], y, 0.0)
        x = np.zeros_like(y)
        halves = None
        if self.points is None or self.fronts is None:
            halves = down(self.cliques, y)
            up(self.cliques, halves, x)
            x[~self.free] = 0.0
            return x
        columns = self.points.rays.columns
        on = columns >= 0
        reduced = np.zeros((len(columns), y.shape[1]))
        z = self.points.forward(y, reduced)
        halves = down(self.cliques, y)
        reduced[on] += y[columns[on]]
        reduced[~on] = 0.0
        solved = self.fronts.solve(reduced)
        x[columns[on]] = solved[on]
        up(self.cliques, halves, x)
        x[self.layers.point_columns] = self.points.backward(z, solved)
        x[~self.free] = 0.0
        return x

    # -- covariances ----------------------------------------------------------------------------

    @cached_property
    def inverse(self) -> BlockMatrix:
        """Covariances of the third layer at the blocks of its fronts; zero at held places."""
        assert self.points is not None and self.fronts is not None
        out = self.fronts.inverse()
        free = (~self.points.rays.held).astype(float)
        return out if free.all() else out.scaled(free)

    @cached_property
    def ray_covariances(self) -> RayCovariances | None:
        """Joint covariances of the first layer with the third; none: there is no first layer."""
        return None if self.points is None else self.points.joint(self.inverse)

    def point_covariances(self) -> Array:
        """Return the covariance of every point of the first layer, (p, 3, 3)."""
        if self.points is None or self.ray_covariances is None:
            return np.zeros((0, 3, 3))
        return self.points.covariances(self.ray_covariances.inner)

    @cached_property
    def selected(self) -> SelectedInverse:
        """Joint covariances of tree and cameras between the variables of one observation."""
        place = np.full(self.layers.unknowns.n_columns, -1, dtype=np.intp)
        inverse = None
        if self.points is not None:
            place, inverse = self.points.rays.place_of, self.inverse
        return SelectedInverse(self.cliques, inverse, place, len(place))

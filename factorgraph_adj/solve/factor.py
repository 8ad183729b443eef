"""The factorised normal equations of a whole network: solutions and covariances."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.linalg import lapack

from ..types import Array
from .elimination import Layers
from .linear import LinearSystem
from .rays import Rays
from .reduction import RayCovariances, ReducedPoints
from .selected_inverse import SelectedInverse
from .tree import SingularError, TreeFactors, down, up
from .triangular import lower_solve


class Factor:
    """N + diag(extra) of one linearisation, factorised in three `Layers`.

    Held components have a one on the diagonal and zeros elsewhere, so that their steps and
    covariances are zero after masking.
    """

    uncertainty: float = 0.0
    """Relative error of variances that random probes have shown, see `trust`; zero before them."""

    def __init__(
        self,
        layers: Layers,
        rays: Rays | None,
        system: LinearSystem,
        factors: TreeFactors,
        extra: Array,
        *,
        qr: bool,
    ) -> None:
        """Factorise.

        Args:
            layers: the layers of the elimination.
            rays: index lists of the first layer; none: the layer is empty.
            system: the linearised network.
            factors: GTSAM's factors of the network.
            extra: added to the diagonal (damping, minimal datum), (n_columns,).
            qr: whether the tree is eliminated by QR.

        Raises:
            SingularError: a pivot vanished.
        """
        self.layers = layers
        self.free = layers.unknowns.free
        diagonal = np.where(self.free, extra, 1.0)
        self.points = None if rays is None else ReducedPoints(rays, system, diagonal)
        self.cliques, border = factors.eliminate(diagonal, qr=qr)
        if self.points is not None:
            border += self.points.normal
        self.border = border
        self._factor_border()
        self._border_covariance: Array | None = None
        self._inner: Array | None = None

    def _factor_border(self) -> None:
        n = len(self.border)
        self.scale = 1.0 / np.sqrt(np.maximum(np.diag(self.border), np.finfo(float).tiny))
        if not n:
            self.root = np.zeros((0, 0))
            return
        with np.errstate(over="ignore", invalid="ignore"):  # coordinates may have diverged
            scaled = self.border * self.scale[:, None] * self.scale
        if not np.isfinite(scaled).all():
            raise SingularError("the cameras' normal equations have no pivots")
        self.root, info = lapack.dpotrf(scaled, lower=1, clean=1)
        if info != 0:
            raise SingularError(f"pivot {info} of the cameras' normal equations")

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
        if self.points is not None:
            out[self.layers.point_columns] = self.points.cholesky.pivots * point
        for c in self.cliques:
            out[c.frontal] = np.diag(c.r) ** 2 / safe[c.frontal]
            out[c.frontal] *= np.where(free[c.frontal], tree, 1.0)
        if len(self.border):
            left = (np.diag(self.root) / self.scale) ** 2
            out[self.layers.border] = left / safe[self.layers.border]
        return float(out[free].min()) if free.any() else 1.0

    def solve(self, y: Array) -> Array:
        """Return x of (N + diag) x = y for y (n_columns, k); held components are zero."""
        y = np.where(self.free[:, None], y, 0.0)
        x = np.zeros_like(y)
        z = None
        border = y[self.layers.border].copy()
        if self.points is not None:
            z = self.points.forward(y, border)
        y[self.layers.border] = border
        halves = down(self.cliques, y)
        if len(self.layers.border):
            b = self.scale[:, None] * y[self.layers.border]
            solved = lower_solve(self.root, lower_solve(self.root, b), transposed=True)
            x[self.layers.border] = self.scale[:, None] * solved
        up(self.cliques, halves, x)
        if self.points is not None and z is not None:
            x[self.layers.point_columns] = self.points.backward(z, x[self.layers.border])
        x[~self.free] = 0.0
        return x

    # -- covariances ----------------------------------------------------------------------------

    def border_covariance(self) -> Array:
        """Return the covariance of the border (b, b)."""
        if self._border_covariance is None:
            n = len(self.border)
            if n:
                inverse, _ = lapack.dpotri(self.root, lower=1)
                inverse = np.tril(inverse) + np.tril(inverse, -1).T
                self._border_covariance = inverse * self.scale[:, None] * self.scale
            else:
                self._border_covariance = np.zeros((0, 0))
        return self._border_covariance

    def ray_covariances(self) -> RayCovariances | None:
        """Return the joint covariances of the first layer with the border; none: no first layer."""
        if self.points is None:
            return None
        joint = self.points.joint(self.border_covariance())
        self._inner = joint.inner
        return joint

    def point_covariances(self) -> Array:
        """Return the covariance of every point of the first layer, (p, 3, 3)."""
        if self.points is None:
            return np.zeros((0, 3, 3))
        if self._inner is None:
            self._inner = self.points.joint(self.border_covariance()).inner
        return self.points.covariances(self._inner)

    @cached_property
    def selected(self) -> SelectedInverse:
        """Joint covariances of tree and border between the variables of one observation."""
        layers = self.layers
        return SelectedInverse(
            self.cliques, self.border_covariance(), layers.in_border, layers.unknowns.n_columns
        )

"""Conjugate gradients on the reduced normal equations, with clusters of photos as preconditioner.

S = U − WᵀW of the photos is never formed: with M for S without the blocks of two photos,

    S x = M x − Σ_p Σ_{i≠j} w_iᵀ w_j x_j

needs W of each ray alone, which is summed to the points and spread to the photos again. Memory
grows with the rays and not with the pairs of photos that share points. The preconditioner has the
principal blocks of S that belong to clusters of nodes with the most common points (visibility,
Kushal & Agarwal 2012; one node each: block-Jacobi), and the border of what many photos share. As
principal blocks they are positive definite. Residuals are measured by the preconditioner, which
has no units: √(rᵀP⁻¹r) ≤ 10⁻⁸ of that at the start.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array

from ..errors import SingularError
from ..types import Array, Index, Mask
from .block_matrix import BlockMatrix
from .fronts import cholesky_lower, inverse_from_cholesky
from .point_elimination import ReducedPoints
from .point_rays import PointRays

MAX_CLUSTER_NODES = 16
"""Largest number of nodes of a cluster: a block of 96 poses' columns fits in the cache."""
RESIDUAL = 1e-8
"""Norm of the residual, relative to the first one, at which a solution ends: errors of a step are
the square root of that of vᵀPv, and the next step corrects them."""
MAX_GRADIENTS = 5000
"""Largest number of conjugate gradients of a solution."""
MAX_COUNTED_PAIRS = 5_000_000
"""Number of pairs of rays to common points that are counted for clusters; of more points an evenly
spaced part is enough to see which photos belong together."""
NO_INVERSE = (
    "the normal equations were solved by conjugate gradients, which leave no inverse; valid: "
    "covariances of single unknowns (solution.covariance, variable_covariance), each of which is "
    "solved for, estimates of all standard deviations (fga.estimate_precision), or an adjustment "
    "with solver='direct'"
)
"""Reason why covariances of all unknowns, and what needs them, are refused."""


def visibility_clusters(rays: PointRays, size: int = MAX_CLUSTER_NODES) -> tuple[Index, ...]:
    """Return clusters of nodes, each grown by the node with the most points in common with it.

    Args:
        rays: rays to the points of the first layer.
        size: largest number of nodes of a cluster; 1: none are joined.
    """
    n = rays.places.n
    if size == 1:
        return tuple(np.arange(n)[:, None])
    points = rays.point_of_ray
    counts = np.bincount(points, minlength=rays.n_points).astype(float)
    step = max(1, int(np.ceil(float(counts @ counts) / MAX_COUNTED_PAIRS)))
    on = points % step == 0
    ones = np.ones(int(on.sum()))
    shape = (n, rays.n_points)
    sees = csr_array((ones, (rays.node_of_ray[on], points[on])), shape=shape)
    common = csr_array(sees @ sees.T)
    left = np.ones(n, dtype=bool)
    out = []
    for first in range(n):
        if not left[first]:
            continue
        cluster: list[int] = []
        shared, at = np.zeros(n), first
        while len(cluster) < size:
            cluster.append(at)
            left[at] = False
            own = slice(common.indptr[at], common.indptr[at + 1])
            shared[common.indices[own]] += common.data[own]
            at = int(np.argmax(np.where(left, shared, 0.0)))
            if not left[at] or not shared[at]:
                break
        out.append(np.sort(np.array(cluster, dtype=np.intp)))
    return tuple(out)


class ConjugateGradients:
    """The reduced system, solved by preconditioned conjugate gradients in place of `Fronts`."""

    def __init__(
        self,
        matrix: BlockMatrix,
        points: ReducedPoints,
        held: Mask,
        clusters: Sequence[Index],
    ) -> None:
        """Factorise the preconditioner.

        Args:
            matrix: M, with a one on the diagonal of held places.
            points: the first layer, with W of each ray.
            held: places that are held or padding, (n w + k,).
            clusters: nodes of each cluster, each node once.

        Raises:
            SingularError: a block of the preconditioner is not positive definite.
        """
        self.matrix, self.points, self.clusters = matrix, points, clusters
        self.free = (~held).astype(float)[:, None]
        self.diagonal = matrix.diagonals
        """Diagonal of S, (n w + k,)."""
        self.pivots = np.ones(len(self.diagonal))
        """Pivots of the preconditioner relative to the diagonal, (n w + k,): those of S are not
        larger."""
        self.gradients = 0
        """Number of conjugate gradients so far."""
        n, w = matrix.pattern.n, matrix.pattern.width
        self._blocks: list[tuple[Index, Array]] = []
        cluster_of = np.empty(n, dtype=np.intp)
        for number, nodes in enumerate(clusters):
            cluster_of[nodes] = number
        first, second = matrix.pattern.first, matrix.pattern.second
        pairs = np.flatnonzero(cluster_of[first] == cluster_of[second])
        by_cluster = pairs[np.argsort(cluster_of[first[pairs]], kind="stable")]
        ends = np.searchsorted(cluster_of[first[by_cluster]], np.arange(len(clusters) + 1))
        for number, nodes in enumerate(clusters):
            places = (w * nodes[:, None] + np.arange(w)).ravel()
            block = np.zeros((len(nodes), w, len(nodes), w))
            if len(nodes) > 1:
                seen = points.partials_of(nodes)
                block -= (seen.T @ seen).reshape(block.shape)
            d = np.arange(len(nodes))
            block[d, :, d, :] = matrix.diagonal[nodes]
            for k in by_cluster[ends[number] : ends[number + 1]].tolist():
                i, j = np.searchsorted(nodes, [first[k], second[k]])
                block[i, :, j, :] += matrix.pairs[k]
                block[j, :, i, :] += matrix.pairs[k].T
            self._add_block(places, block.reshape(len(places), len(places)))
        if matrix.pattern.side:
            self._add_block(n * w + np.arange(matrix.pattern.side), matrix.corner)

    def _add_block(self, places: Index, block: Array) -> None:
        """Factorise a principal block of S at some places."""
        free = self.free[places, 0]
        block = block * np.outer(free, free) + np.diag(1.0 - free)
        diagonal = np.diag(block)
        if not (diagonal > 0.0).all():
            raise SingularError("the photos' normal equations have no pivots")
        scale = 1.0 / np.sqrt(diagonal)
        root = cholesky_lower(block * np.outer(scale, scale))
        self.pivots[places] = np.diag(root) ** 2
        inverse = inverse_from_cholesky(root) * np.outer(scale, scale)
        self._blocks.append((places, inverse))

    def times(self, x: Array) -> Array:
        """Return S x for x (n w + k, r); held places are zero."""
        n, w = self.matrix.pattern.n, self.matrix.pattern.width
        r = x.shape[1]
        x = x * self.free
        nodes, border = x[: n * w].reshape(n, w, r), x[n * w :]
        y = self.matrix.diagonal @ nodes
        first, second = self.matrix.pattern.first, self.matrix.pattern.second
        np.add.at(y, first, self.matrix.pairs @ nodes[second])
        np.add.at(y, second, self.matrix.pairs.transpose(0, 2, 1) @ nodes[first])
        y -= self.points.between_nodes(nodes)
        y += self.matrix.side @ border
        below = self.matrix.corner @ border
        below += np.tensordot(self.matrix.side, nodes, axes=((0, 1), (0, 1)))
        return np.asarray(np.concatenate([y.reshape(n * w, r), below]) * self.free)

    def preconditioned(self, r: Array) -> Array:
        """Return P⁻¹ r for r (n w + k, m)."""
        out: Array = np.empty_like(r)
        for places, inverse in self._blocks:
            out[places] = inverse @ r[places]
        return out

    def solve(self, y: Array, kept: Array | None = None) -> Array:
        """Return S⁻¹ y for y (n w + k, r); arguments as of `Fronts.solve`, without kept places.

        Raises:
            SingularError: S is not positive definite, or the gradients do not converge.
        """
        r = y * self.free
        x: Array = np.zeros_like(r)
        p = z = self.preconditioned(r)
        size = np.einsum("ij,ij->j", r, z)
        limit = RESIDUAL**2 * size
        for _ in range(MAX_GRADIENTS):
            on = size > limit
            if not on.any():
                return x
            self.gradients += 1
            moved = self.times(p)
            curvature = np.einsum("ij,ij->j", p, moved)
            if not (curvature[on] > 0.0).all():
                raise SingularError("the photos' normal equations are not positive definite")
            length = np.where(on, size / np.where(on, curvature, 1.0), 0.0)
            x += length * p
            r -= length * moved
            z = self.preconditioned(r)
            new = np.einsum("ij,ij->j", r, z)
            p = z + np.where(on, new / np.where(on, size, 1.0), 0.0) * p
            size = np.where(on, new, size)
        left = float(np.sqrt((size / np.maximum(limit, 1e-300)).max())) * RESIDUAL
        raise SingularError(
            f"{MAX_GRADIENTS} conjugate gradients leave {left:.1g} of the residual "
            f"({RESIDUAL:.0e} ends a solution): the block is too weak for them; valid: "
            "solver='direct'"
        )

    def inverse(self) -> BlockMatrix:
        """Raise an error: there is no inverse.

        Raises:
            SingularError: always.
        """
        raise SingularError(NO_INVERSE)

    def half(self, y: Array) -> Array:
        """Raise an error: there is no factor of S.

        Raises:
            SingularError: always.
        """
        raise SingularError(NO_INVERSE)

    def remaining(self, y: Array) -> Array:
        """Raise an error: nothing can be kept.

        Raises:
            SingularError: always.
        """
        raise SingularError(NO_INVERSE)

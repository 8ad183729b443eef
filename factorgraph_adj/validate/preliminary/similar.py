"""Places that two systems of coordinates have in common, and the similarity between them.

A system is what was measured in one frame, or the given coordinates of the network. With common
places a_i, b_i (n, d), d = 3 or, where heights are missing, 2,

    b ≈ t + s R a,   v_i = b_i − t − s R a_i,   S_i = P_i⁻¹ − A_i N⁻¹ A_iᵀ,   ∇_i = P_i⁻¹ S_i⁻¹ v_i

with the covariance S_i of v_i, weights P_i = 1/(s² σ_a² + σ_b²), and the error ∇_i that place i
has if it alone is wrong. v_iᵀ S_i⁻¹ v_i then follows χ² with d degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...rotation import nearest_rotation, skew
from ...types import Array, Index

LINE = 1e-3
"""Smallest ratio of the second extent of places to the first at which they fix all turns."""
PLANE = 1e-2
"""Smallest ratio of the third extent to the first at which a mirror is told from a rotation."""
UNCONTROLLED = 1e-3
"""Redundancy below which a direction of a place counts as not controlled."""


@dataclass(frozen=True, eq=False)
class System:
    """Places with coordinates."""

    name: str
    """Name in messages."""
    keys: Index
    """Number of each place, sorted, (n,)."""
    x: Array
    """Coordinates, (n, 3); NaN where a height is missing."""
    sigma: Array
    """Standard deviation of a coordinate of each place, (n,); NaN: roughly given."""
    upright: bool
    """Whether its z axis is upright, so that its plan can be compared alone."""
    fixed_scale: float
    """ln of the metres per unit; NaN if it is unknown."""
    horizon: Array | None = None
    """Horizon (east, north, up) from which its axes are turned, (3, 3); none: it is not level."""


@dataclass(frozen=True, eq=False)
class Pair:
    """Common places of two systems."""

    first: System
    """System of a."""
    second: System
    """System of b."""
    keys: Index
    """Numbers of the common places, (n,)."""
    a: Array
    """Coordinates in the first system, (n, d)."""
    b: Array
    """Coordinates in the second system, (n, d)."""
    variance_a: Array
    """Variances of a coordinate in the first system, (n,)."""
    variance_b: Array
    """Variances of a coordinate in the second system, (n,)."""

    @property
    def size(self) -> int:
        """Number of dimensions, 2 or 3."""
        return int(self.a.shape[1])

    def extents(self) -> Array:
        """Return the extents of the places along their principal axes, the largest first, (d,)."""
        singular = np.linalg.svd(self.b - self.b.mean(axis=0), compute_uv=False)
        return np.asarray(np.append(singular, np.zeros(self.size - len(singular))))

    @property
    def determined(self) -> bool:
        """Whether the places fix a similarity: they do not lie in one place, or in one line."""
        if len(self.a) < self.size:
            return False
        extents = self.extents()
        return bool(extents[self.size - 2] > LINE * extents[0])

    def of_unknown_scale(self) -> Pair:
        """Return the pair with a scale that is to be found."""
        return replace(self, first=replace(self.first, fixed_scale=float("nan")))

    def exchanged(self, i: int, j: int) -> Pair:
        """Return the pair with the places i and j of the first system exchanged."""
        rows = np.arange(len(self.a))
        rows[[i, j]] = j, i
        return replace(self, a=self.a[rows], variance_a=self.variance_a[rows])

    def without(self, i: int) -> Pair:
        """Return the pair without its place i."""
        rows = np.delete(np.arange(len(self.a)), i)
        return Pair(
            self.first,
            self.second,
            self.keys[rows],
            self.a[rows],
            self.b[rows],
            self.variance_a[rows],
            self.variance_b[rows],
        )

    def fitted(self, *, mirrored: bool = False) -> Similarity:
        """Return the similarity a → b, with a mirror if it is asked for."""
        ln_scale = self.first.fixed_scale - self.second.fixed_scale
        weight = np.ones(len(self.a))
        for _ in range(2):  # the weights take the scale of the first fit
            total = weight.sum()
            a0, b0 = weight @ self.a / total, weight @ self.b / total
            a, b = self.a - a0, self.b - b0
            rotation = nearest_rotation((b * weight[:, None]).T @ a, mirrored=mirrored)
            turned = a @ rotation.T
            scale = float(np.exp(ln_scale))
            if np.isnan(ln_scale):
                scale = float(np.sum(weight[:, None] * turned * b) / np.sum(weight[:, None] * a**2))
            variance = scale**2 * self.variance_a + self.variance_b
            weight = 1.0 / variance
        v = b - scale * turned
        return Similarity(self, rotation, scale, scale * turned, v, 1.0 / weight)


@dataclass(frozen=True, eq=False)
class Similarity:
    """A similarity between two systems, and its residuals."""

    pair: Pair
    """The places."""
    rotation: Array
    """R, (d, d)."""
    scale: float
    """s."""
    turned: Array
    """s R (a − ā), (n, d)."""
    v: Array
    """Residuals b − t − s R a, (n, d)."""
    variance: Array
    """P⁻¹, (n,)."""

    @property
    def rms(self) -> float:
        """Root mean square of the residuals."""
        return float(np.sqrt(np.mean(self.v**2)))

    @cached_property
    def design(self) -> Array:
        """A (n, d, k): shifts, turn and, where it is unknown, ln of the scale."""
        n, d = self.v.shape
        shift = np.broadcast_to(np.eye(d), (n, d, d))
        turn = -skew(self.turned) if d == 3 else self.turned[:, ::-1, None] * [[-1.0], [1.0]]
        known = np.isfinite(self.pair.first.fixed_scale - self.pair.second.fixed_scale)
        scale = self.turned[:, :, None][:, :, : 0 if known else 1]
        return np.concatenate([shift, turn, scale], axis=2)

    @cached_property
    def cofactor(self) -> Array:
        """N⁻¹ (k, k)."""
        weighted = self.design / self.variance[:, None, None]
        return np.asarray(np.linalg.inv(np.einsum("nij,nik->jk", weighted, self.design)))

    def tests(self) -> tuple[Array, Array, Index]:
        """Return ∇ (n, d), its test value (n,) and its degrees of freedom (n,) of every place."""
        moved = np.einsum("nij,jk,nlk->nil", self.design, self.cofactor, self.design)
        s = self.variance[:, None, None] * np.eye(self.pair.size) - moved
        values, vectors = np.linalg.eigh(s)
        controlled = values > UNCONTROLLED * self.variance[:, None]
        inverse = np.where(controlled, 1.0 / np.where(controlled, values, 1.0), 0.0)
        along = np.einsum("nij,ni->nj", vectors, self.v)
        error = self.variance[:, None] * np.einsum("nij,nj->ni", vectors, inverse * along)
        return error, np.sum(inverse * along**2, axis=1), controlled.sum(axis=1)

    def turn(self) -> tuple[Array, Array]:
        """Return R as a rotation in space (3, 3), and the covariance of its turn and ln s (4, 4).

        The turn is about the axes of the second system; in the plane it is about z.
        """
        d, k = self.pair.size, self.cofactor.shape[0]
        rotation, covariance = np.eye(3), np.zeros((4, 4))
        rotation[:d, :d] = self.rotation
        own = [0, 1, 2, 3] if d == 3 else [2, 3]
        own = own[: k - d]
        covariance[np.ix_(own, own)] = self.cofactor[d:, d:]
        return rotation, covariance


def common(first: System, second: System, *, rough: bool = False) -> Pair | None:
    """Return the common places of two systems; none if they fix no similarity.

    Args:
        first: system of a.
        second: system of b.
        rough: whether places without a standard deviation take part.
    """
    keys, i, j = np.intersect1d(first.keys, second.keys, assume_unique=True, return_indices=True)
    a, b = first.x[i], second.x[j]
    sound = np.isfinite(a + b)
    known = np.isfinite(first.sigma[i] + second.sigma[j]) | rough
    plan_alone = first.upright and second.upright and not sound[known, 2].any()
    d = 2 if plan_alone else 3
    rows = np.flatnonzero(sound[:, :d].all(axis=1) & known)
    variances = (np.nan_to_num(s) ** 2 for s in (first.sigma[i[rows]], second.sigma[j[rows]]))
    pair = Pair(first, second, keys[rows], a[rows, :d], b[rows, :d], *variances)
    return pair if pair.determined else None

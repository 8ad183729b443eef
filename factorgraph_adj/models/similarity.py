"""Similarity transformations X = s R x + t, and their least-squares fit to common places.

With weights p_i, weighted means x̄, X̄ and reduced places a = x − x̄, b = X − X̄ of Σ p_i |X_i − s R
x_i − t|² → min: R is the rotation nearest to Σ p b aᵀ, s = Σ p bᵀR a / Σ p aᵀa, t = X̄ − s R x̄ (S.
Umeyama, Least-squares estimation of transformation parameters between two point patterns, IEEE
PAMI 13 (1991), 376–380, eqs. 34 to 43).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..rotation import nearest_rotation
from ..types import Array


@dataclass(frozen=True, eq=False)
class Similarity:
    """X = s R x + t."""

    scale: float
    """s."""
    rotation: Array
    """R, (d, d)."""
    shift: Array
    """t, (d,)."""

    def of(self, places: Array) -> Array:
        """Return transformed places, (…, d)."""
        return np.asarray(self.scale * places @ self.rotation.T + self.shift)

    def of_poses(self, poses: Array) -> Array:
        """Return transformed stored poses, (n, 12)."""
        turned = self.rotation @ poses[:, :9].reshape(-1, 3, 3)
        return np.concatenate([turned.reshape(-1, 9), self.of(poses[:, 9:])], axis=1)


def fit_similarity(
    x: Array,
    to: Array,
    weights: Array | None = None,
    *,
    scale: float | None = None,
    mirrored: bool = False,
) -> Similarity:
    """Return the similarity that carries places x to others with least squares.

    Places in one line leave the rotation about it open, see `extent_ratio`.

    Args:
        x: places, (n, d).
        to: the same places in the other system, (n, d).
        weights: weights of the places, (n,); all are 1 by default.
        scale: the scale where it is known. A scale that is found is not positive where the places
            of one system coincide.
        mirrored: whether R is a rotation with a mirror.
    """
    p = np.ones((len(x), 1)) if weights is None else weights[:, None]
    a, b = reduced(x, weights), reduced(to, weights)
    rotation = nearest_rotation((b * p).T @ a, mirrored=mirrored)
    if scale is None:
        size = float(np.sum(p * a**2))
        scale = float(np.sum(p * (a @ rotation.T) * b)) / size if size > 0 else 0.0
    return Similarity(scale, rotation, _mean(to, weights) - scale * rotation @ _mean(x, weights))


def reduced(x: Array, weights: Array | None = None) -> Array:
    """Return places (n, d) from their mean, which may be weighted."""
    return np.asarray(x - _mean(x, weights))


def _mean(x: Array, weights: Array | None) -> Array:
    return np.asarray(x.mean(axis=0) if weights is None else weights @ x / weights.sum())


def near_median(x: Array, most: float) -> Array:
    """Return the places (n, 3) near their median: x and y differ by ``most``; all if none are."""
    near = np.abs(x[:, :2] - np.median(x[:, :2], axis=0)).max(axis=1) <= most
    return x[near] if near.any() else x


def extent_ratio(x: Array) -> float:
    """Return the second extent of places (n, d) along principal axes, relative to the first.

    It is zero for places in one line or in one place, and for fewer than three.
    """
    if len(x) < 3:
        return 0.0
    extents = np.linalg.svd(reduced(x), compute_uv=False)
    return float(extents[1] / extents[0]) if extents[0] > 0 else 0.0

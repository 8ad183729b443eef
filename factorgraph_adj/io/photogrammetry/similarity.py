"""Similarity from a model of structure from motion to a reference system, for start values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...types import Array

FLAT = 1e-3
"""Ratio of the second to the first extent of places below which they lie on a line."""


@dataclass(frozen=True)
class Similarity:
    """X = s R x + t."""

    scale: float
    """s."""
    rotation: Array
    """R, (3, 3)."""
    shift: Array
    """t, (3,)."""

    def places(self, x: Array) -> Array:
        """Return transformed places (n, 3)."""
        return np.asarray(self.scale * x @ self.rotation.T + self.shift)


NOTHING = Similarity(1.0, np.eye(3), np.zeros(3))
"""The similarity that moves nothing."""


def fitted(x: Array, to: Array) -> Similarity | None:
    """Return the similarity that maps places (n, 3) to others by least squares; None: undetermined.

    R and s by the singular values of the covariance of both (S. Umeyama, Least-squares estimation
    of transformation parameters between two point patterns, IEEE PAMI 13 (1991), 376–380).
    """
    if len(x) < 3:
        return None
    a, b = x - x.mean(axis=0), to - to.mean(axis=0)
    for places in (a, b):
        extent = np.linalg.svd(places, compute_uv=False)
        if not extent[1] > FLAT * extent[0]:
            return None
    u, d, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(sign) @ vt
    scale = float(np.sum(d * sign) / np.sum(a * a))
    if not scale > 0:
        return None
    return Similarity(scale, rotation, to.mean(axis=0) - scale * rotation @ x.mean(axis=0))

"""Latitude, longitude and ellipsoidal height of points, and their σ in east, north and up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..frames import Frame
from ..types import Array


@dataclass(frozen=True, eq=False)
class Geographic:
    """Geodetic coordinates of n points on the ellipsoid of their frame."""

    latitude: Array
    """φ, (n,) radians, north positive."""
    longitude: Array
    """λ, (n,) radians in (−π, π], east positive."""
    height: Array
    """Ellipsoidal height, (n,) metres."""
    sigma: Array
    """Standard deviations along east, north and up at each point, (n, 3) metres."""


def geographic(frame: Frame, xyz: Array, covariances: Array) -> Geographic | None:
    """Return geodetic coordinates of positions; None for a local frame, which has no ellipsoid.

    σ² = diag(E Σ Eᵀ), E the rows east, north, up of the ellipsoid's normal at the point.

    Args:
        frame: frame of the network.
        xyz: positions (n, 3), metres.
        covariances: their covariances Σ, (n, 3, 3) metres².
    """
    found = frame.geodetic(xyz)
    if found is None:
        return None
    enu = frame.basis(xyz, np.zeros((len(xyz), 2))).enu
    variances = np.einsum("nai,nij,naj->na", enu, covariances, enu)
    return Geographic(*found, np.sqrt(np.maximum(variances, 0.0)))

"""Places with covariances from the frame to grid coordinates and to WGS 84, for tables and maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, Problem
from ..frames import Frame, LocalFrame
from ..types import Array
from . import proj
from .reference_system import ReferenceSystem

DERIVATIVE_STEP_M = 10.0
"""Distance over which derivatives are taken, metres: PROJ is smooth to some 1e-9 m."""
WGS84_GEODETIC_3D = "EPSG:4979"


@dataclass(frozen=True, eq=False)
class GridPlaces:
    """Grid coordinates of n places with their covariances."""

    coordinates: Array
    """Easting, northing, height of the reference system, (n, 3) metres."""
    covariances: Array
    """Covariances J Σ Jᵀ of E, N, H with J = ∂(E, N, H)/∂X, (n, 3, 3) metres²."""
    jacobians: Array
    """J, (n, 3, 3)."""
    convergence: Array
    """γ, azimuth of grid north, (n,) radians: grid bearing = azimuth − γ, without the curvature
    of the projected line."""
    scale: Array
    """Scale of the projection on the ellipsoid, (n,): length in the grid / length on the
    ellipsoid; in projections that are not conformal the root of the ratio of areas."""
    combined: Array
    """Combined factor, (n,): length in the grid / level length at the height of the place."""
    undulation: Array
    """N, (n,) metres: height above the ellipsoid of the datum less H."""

    @property
    def sigma(self) -> Array:
        """Standard deviations of E, N, H, (n, 3) metres."""
        return np.asarray(np.sqrt(np.maximum(np.einsum("nii->ni", self.covariances), 0.0)))


@dataclass(frozen=True, eq=False)
class Wgs84Places:
    """Longitude, latitude and ellipsoidal height of n places in WGS 84 (EPSG:4979)."""

    longitude_deg: Array
    """λ, (n,) degrees, east positive."""
    latitude_deg: Array
    """φ, (n,) degrees, north positive."""
    height: Array
    """Height above the ellipsoid WGS 84, (n,) metres."""
    covariances_enu: Array
    """Covariances along east, north, up at each place, (n, 3, 3) metres²."""
    operation: str
    """Name of the operation from the datum of the network, in the words of PROJ."""
    accuracy: float
    """Accuracy of the operation, metres: often 1 m or worse, whatever σ is; NaN if unknown."""


def grid_places(
    system: ReferenceSystem,
    frame: Frame,
    xyz: Array,
    covariances: Array | None = None,
    names: Sequence[str] | None = None,
) -> GridPlaces:
    """Return grid coordinates of places with covariances, convergence and scale.

    J is taken by central differences over STEP, along east, north and up at each place.

    Args:
        system: the reference system; it must have grid coordinates.
        frame: frame of the coordinates. Those of a local frame are grid coordinates themselves.
        xyz: coordinates, (n, 3) metres.
        covariances: their covariances Σ, (n, 3, 3) metres²; None: 0.
        names: names of the places, for messages and for a geoid of named points.

    Raises:
        InputError: the system has no grid, pyproj or a geoid is missing, or a place is outside.
    """
    xyz = np.asarray(xyz, dtype=float).reshape(-1, 3)
    sigma = np.zeros((len(xyz), 3, 3)) if covariances is None else np.asarray(covariances)
    latitude, longitude, height = system.geodetic(frame, xyz)
    grid = system.from_geodetic(latitude, longitude, height, names)
    e = system.ellipsoid
    m, n = e.radii(latitude)
    by_enu = np.zeros((len(xyz), 3, 3))
    steps = (
        (np.zeros_like(latitude), DERIVATIVE_STEP_M / ((n + height) * np.cos(latitude)), 0.0),
        (DERIVATIVE_STEP_M / (m + height), np.zeros_like(latitude), 0.0),
        (np.zeros_like(latitude), np.zeros_like(latitude), DERIVATIVE_STEP_M),
    )
    for k, (a, b, c) in enumerate(steps):
        after, before = (
            system.from_geodetic(latitude + s * a, longitude + s * b, height + s * c, names)
            for s in (1.0, -1.0)
        )
        by_enu[:, :, k] = (after - before) / (2.0 * DERIVATIVE_STEP_M)
    if isinstance(frame, LocalFrame):
        grid = system.from_frame(frame, xyz)
        east, north = frame.east_north
        jacobians = np.broadcast_to(np.array([east, north, [0.0, 0.0, 1.0]]), by_enu.shape).copy()
    else:
        jacobians = by_enu @ frame.basis(xyz, np.zeros((len(xyz), 2))).enu
    # A step along the horizon at height h is shorter on the ellipsoid by M/(M+h), N/(N+h).
    plan = by_enu[:, :2, :2]
    on_ellipsoid = plan * np.stack([(n + height) / n, (m + height) / m], axis=1)[:, None, :]
    areas = np.abs(np.linalg.det(on_ellipsoid)), np.abs(np.linalg.det(plan))
    return GridPlaces(
        grid,
        jacobians @ sigma @ jacobians.transpose(0, 2, 1),
        jacobians,
        np.arctan2(by_enu[:, 1, 0], by_enu[:, 0, 0]),
        np.sqrt(areas[0]),
        np.sqrt(areas[1]),
        system.geoid_at(latitude, longitude, names).undulation,
    )


def wgs84_places(
    system: ReferenceSystem, frame: Frame, xyz: Array, covariances: Array | None = None
) -> Wgs84Places:
    """Return longitude, latitude and height in WGS 84, which GeoJSON and KML need.

    The operation from the datum of the network is the most accurate one that is installed; a
    ballpark one is never taken. Its name and its accuracy belong beside what is shown.

    Args:
        system: the reference system, projected or not.
        frame: frame of the coordinates. Those of a local frame are grid coordinates.
        xyz: coordinates, (n, 3) metres.
        covariances: their covariances, (n, 3, 3) metres²; None: 0.

    Raises:
        InputError: pyproj is missing, or PROJ knows no operation to WGS 84.
    """
    xyz = np.asarray(xyz, dtype=float).reshape(-1, 3)
    sigma = np.zeros((len(xyz), 3, 3)) if covariances is None else np.asarray(covariances)
    if len(xyz) == 0:
        none = np.zeros(0)
        return Wgs84Places(none, none, none, sigma, "none", np.nan)
    latitude, longitude, height = system.geodetic(frame, xyz)
    if not np.isfinite(latitude).all():
        raise InputError(Problem("places must have coordinates", f"reference system {system.name}"))
    there = np.column_stack([np.degrees(longitude), np.degrees(latitude), height])
    op = proj.best_available(system.chain.datum, proj.crs(WGS84_GEODETIC_3D), there[:, :2])
    out = proj.transformed(op, there, what=f"{system.name} to WGS 84")
    if isinstance(frame, LocalFrame):
        turn = grid_places(system, frame, xyz).convergence
        cosine, sine = np.cos(turn), np.sin(turn)
        axes = np.zeros((len(xyz), 3, 3))
        # Grid east has the azimuth 90° + γ: rows are east, north, up in E, N, H.
        axes[:, 0, 0], axes[:, 0, 1] = cosine, sine
        axes[:, 1, 0], axes[:, 1, 1] = -sine, cosine
        axes[:, 2, 2] = 1.0
        axes = axes @ np.vstack([frame.east_north, [0.0, 0.0, 1.0]])
    else:
        axes = frame.basis(xyz, np.zeros((len(xyz), 2))).enu
    return Wgs84Places(
        out[:, 0],
        out[:, 1],
        out[:, 2],
        axes @ sigma @ axes.transpose(0, 2, 1),
        op.description,
        op.accuracy if op.accuracy >= 0 else np.nan,
    )

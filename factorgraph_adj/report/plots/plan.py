"""The plane a network is drawn in, and standard ellipses in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from ...frames import Frame, GeocentricFrame, LocalFrame
from ...solve.solution import Solution
from ...solve.tree import SingularError
from ...types import Array

View: TypeAlias = Literal["above", "south", "east"]
"""Where a network is seen from."""
VIEWS = ("above", "south", "east")


@dataclass(frozen=True)
class DrawingPlane:
    """A horizontal plane: (e, n, u) = axes · (X − origin); or, seen from a side, a vertical one."""

    origin: Array
    """What lies at e = n = u = 0, (3,) metres."""
    axes: Array
    """Unit vectors to the right, upwards in the figure, and across it: east, north, up, (3, 3)."""
    names: tuple[str, str, str]
    """Names of the three, for labels."""
    note: str
    """Which plane it is, where the names do not say so."""

    def coordinates(self, xyz: Array) -> Array:
        """Return the three coordinates (n, 3) of points (n, 3), metres."""
        return np.asarray((xyz - self.origin) @ self.axes.T)

    def covariance(self, sigma: Array) -> Array:
        """Return covariances (n, 3, 3) by these of those by X, Y, Z."""
        return np.asarray(self.axes @ sigma @ self.axes.T)

    def seen_from(self, view: View) -> DrawingPlane:
        """Return the plane as seen from above, from the south or from the east."""
        rows = {"above": [0, 1, 2], "south": [0, 2, 1], "east": [1, 2, 0]}[view]
        a, b, c = (self.names[i] for i in rows)
        return replace(self, axes=self.axes[rows], names=(a, b, c))


def plan_of(frame: Frame, xyz: Array) -> DrawingPlane:
    """Return the plan of points (n, 3).

    Local frames: their X, Y plane with north up, whichever way the axes point, left-handed ones
    included. Topocentric: east and north of the frame. Geocentric: the horizon (normal of the
    ellipsoid) of the centre of the points.
    """
    if isinstance(frame, LocalFrame):
        east, north = frame.east_north
        where = {letter: axis for axis, letter in zip("XY", frame.axes, strict=True)}
        names = (
            f"{where['e']} (east)" if "e" in where else f"−{where['w']} (east)",
            f"{where['n']} (north)" if "n" in where else f"−{where['s']} (north)",
            "Z (up)",
        )
        return DrawingPlane(np.zeros(3), np.stack([east, north, [0.0, 0.0, 1.0]]), names, "")
    if not isinstance(frame, GeocentricFrame):
        return DrawingPlane(np.zeros(3), np.eye(3), ("east", "north", "up"), "")
    centre = (xyz.min(axis=0) + xyz.max(axis=0)) / 2
    latitude, longitude, _ = (float(v[0]) for v in frame.ellipsoid.to_geodetic(centre[None]))
    axes = frame.basis(centre[None], np.zeros((1, 2))).enu[0]
    note = f"horizon at {_degrees(latitude, 'NS')} {_degrees(longitude, 'EW')}"
    return DrawingPlane(centre, axes, ("east of the centre", "north of the centre", "up"), note)


def _degrees(angle: float, letters: str) -> str:
    return f"{abs(np.degrees(angle)):.4f}° {letters[angle < 0]}"


def covariances(solution: Solution) -> tuple[Array, Array] | None:
    """Return covariances of points (n, 3, 3) and projection centres (m, 3, 3), metres².

    There are none where an iteration stopped half-way at singular normal equations.
    """
    photos = solution.equations.unknowns["pose"].names
    try:
        centres = [solution.pose_covariance(n)[3:, 3:] for n in photos]
        return solution.point_covariances, np.array(centres).reshape(-1, 3, 3)
    except SingularError:
        return None


def ellipses(sigma: Array) -> tuple[Array, Array]:
    """Return semi-axes (n, 2), largest first, and directions of the first of covariances (n, 2, 2).

    In any plane, and in one plane for the whole network; those of `quality.ellipses` lie in the
    horizon of each point. Directions count from the first coordinate to the second, radians, (n,).
    """
    values, vectors = np.linalg.eigh(sigma)
    semi = np.sqrt(np.maximum(values[:, ::-1], 0.0))
    return semi, np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])

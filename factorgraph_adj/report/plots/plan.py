"""The drawing plane of a network, and the standard ellipses in this plane."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from ...frames import Frame, GeocentricFrame, LocalFrame
from ...solve.singular import SingularError
from ...solve.solution import Solution
from ...types import Array

View: TypeAlias = Literal["above", "south", "east"]
"""Direction from which a network is seen."""
VIEWS = ("above", "south", "east")


@dataclass(frozen=True)
class DrawingPlane:
    """A horizontal or (seen from a side) vertical plane: (e, n, u) = axes · (X − origin)."""

    origin: Array
    """Point with e = n = u = 0, (3,) metres."""
    axes: Array
    """Unit vectors to the right, upwards and across the figure; from above e, n, u; (3, 3)."""
    names: tuple[str, str, str]
    """Names of the three axes, for labels."""
    note: str
    """Description of the plane, if the names of the axes are not sufficient."""

    def coordinates(self, xyz: Array) -> Array:
        """Return e, n, u (n, 3) of points (n, 3), metres."""
        return np.asarray((xyz - self.origin) @ self.axes.T)

    def covariance(self, sigma: Array) -> Array:
        """Return covariances (n, 3, 3) of e, n, u from those of X, Y, Z."""
        return np.asarray(self.axes @ sigma @ self.axes.T)

    def seen_from(self, view: View) -> DrawingPlane:
        """Return the plane for a view from above, from the south or from the east."""
        rows = {"above": [0, 1, 2], "south": [0, 2, 1], "east": [1, 2, 0]}[view]
        a, b, c = (self.names[i] for i in rows)
        return replace(self, axes=self.axes[rows], names=(a, b, c))


def plan_of(frame: Frame, xyz: Array) -> DrawingPlane:
    """Return the plan of points (n, 3).

    Local frames: the X, Y plane with north up, for axes in any direction and of either hand.
    Topocentric: east and north of the frame. Geocentric: the horizon (perpendicular to the normal
    of the ellipsoid) at the centre of the points.
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

    Return None if the iteration stopped early at singular normal equations.
    """
    photos = solution.equations.unknowns["pose"].names
    try:
        centres = [solution.pose_covariance(n)[3:, 3:] for n in photos]
        return solution.point_covariances, np.array(centres).reshape(-1, 3, 3)
    except SingularError:
        return None


def ellipses(sigma: Array) -> tuple[Array, Array]:
    """Return semi-axes (n, 2), largest first, and directions (n,) of the first axes.

    ``sigma`` are covariances (n, 2, 2) in one plane for the whole network; the ellipses of
    `quality.ellipses` lie in the horizon of each point. Directions count from the first
    coordinate to the second, radians.
    """
    values, vectors = np.linalg.eigh(sigma)
    semi = np.sqrt(np.maximum(values[:, ::-1], 0.0))
    return semi, np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])

"""Similarity of seven parameters between two geocentric systems."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from ..constructors import ChecksArguments
from ..errors import InputError
from ..types import Array

ARCSEC = np.pi / 648000.0


@dataclass(frozen=True)
class SevenParameters(metaclass=ChecksArguments):
    """X' = t + (1 + m) R X, with small rotations of the position vector.

    R = [[1, −r_z, r_y], [r_z, 1, −r_x], [−r_y, r_x, 1]] (EPSG method 1033, as ``+towgs84`` of
    PROJ). Lists with the coordinate frame rotation (method 1032) have the opposite signs of
    rotations. R is used as it stands, and its inverse is the inverse of the matrix.
    """

    tx: float
    """Shift in X, metres."""
    ty: float
    """Shift in Y, metres."""
    tz: float
    """Shift in Z, metres."""
    rx_arcsec: float = 0.0
    """Rotation about X, seconds of arc."""
    ry_arcsec: float = 0.0
    """Rotation about Y, seconds of arc."""
    rz_arcsec: float = 0.0
    """Rotation about Z, seconds of arc."""
    scale_ppm: float = 0.0
    """m, parts per million."""

    def __post_init__(self) -> None:
        """Check that all are numbers."""
        if not np.isfinite(np.array(astuple(self), dtype=float)).all():
            raise InputError(f"parameters of a similarity must be finite numbers, not {self}")

    @property
    def matrix(self) -> Array:
        """(1 + m) R, (3, 3)."""
        x, y, z = (v * ARCSEC for v in (self.rx_arcsec, self.ry_arcsec, self.rz_arcsec))
        turn = np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
        return (1.0 + self.scale_ppm * 1e-6) * turn

    @property
    def shift(self) -> Array:
        """T, (3,) metres."""
        return np.array([self.tx, self.ty, self.tz])

    def forward(self, xyz: Array) -> Array:
        """Return coordinates in the target, (n, 3) metres."""
        return xyz @ self.matrix.T + self.shift

    def inverse(self, xyz: Array) -> Array:
        """Return coordinates in the source, (n, 3) metres."""
        return np.asarray(np.linalg.solve(self.matrix, (xyz - self.shift).T).T)

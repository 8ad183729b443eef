"""Adjusted unknowns with their precision, as a solution hands them out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError, known
from ..rotation import omega_phi_kappa
from ..types import Array


@dataclass(frozen=True)
class Estimate:
    """A small vector unknown and its precision."""

    names: tuple[str, ...]
    """Names of the components."""
    values: Array
    """Estimates, SI."""
    sigmas: Array
    """Standard deviations; zero where held."""
    correlation: Array
    """Correlations; zero with held components."""

    def __getitem__(self, name: str) -> float:
        """Return the estimate of one component."""
        return float(self.values[self._index(name)])

    def sigma(self, name: str) -> float:
        """Return the standard deviation of one component."""
        return float(self.sigmas[self._index(name)])

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise InputError(f"unknown component {name!r}; known: {known(self.names, meant=name)}")
        return self.names.index(name)


@dataclass(frozen=True)
class CalibrationEstimate(Estimate):
    """Calibration of a camera, in image units."""

    unit: str = "mm"
    """Unit of image coordinates."""


@dataclass(frozen=True)
class PoseEstimate:
    """Exterior orientation of a photo."""

    position: Array
    """Projection centre, (3,) metres."""
    rotation: Array
    """world_R_camera (3, 3), camera axes x right, y down, z forward."""
    sigmas: Array
    """Standard deviations of rotations about the camera's axes (rad) and X, Y, Z (m), (6,)."""

    @property
    def omega_phi_kappa(self) -> Array:
        """ω, φ, κ, radians."""
        return np.array(omega_phi_kappa(self.rotation))

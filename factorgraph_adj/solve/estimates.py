"""Adjusted unknowns with their precision, as a solution hands them out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError, known
from ..graph.variables import State, Unknowns
from ..models.variables import VariableKind
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
    """Standard deviations of the estimates; zero where they are held."""
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


def estimate(
    unknowns: Unknowns, state: State, kind: VariableKind, number: int, tangent: Array
) -> Estimate:
    """Return one unknown with the precision of its values.

    Args:
        unknowns: all unknowns.
        state: their values.
        kind: its kind.
        number: its number.
        tangent: covariance of its columns, (k, k); those of a rotation are turns about its axes.
    """
    covariance = unknowns.covariance_of_given(state, kind, number, tangent)
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(sigmas > 0, sigmas, 1.0)
    return Estimate(
        unknowns.component_names(kind, number),
        unknowns.shown(state, kind, number),
        sigmas,
        covariance / np.outer(safe, safe),
    )


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

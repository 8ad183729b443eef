"""Rolling shutters: times of image rows, and rays from a camera that moves while it reads them.

A sensor with a rolling shutter is read row by row. With the readout time T of the whole sensor and
the middle row at the time zero, a row is read at

    t = T (row − middle row) / rows.

During the readout the camera moves and turns evenly, with the velocity v in the axes of the network
(m/s) and the turn ω about its own axes (rad/s); its pose R, X₀ is that at the middle row:

    X₀(t) = X₀ + v t,    R(t) = R Exp(ω t),    p = Exp(ω t)ᵀ q,  q = Rᵀ (X − X₀ − v t).

The time is that of the measured row, so that the weights stay those of measured coordinates, as in
lens models from measured to ideal coordinates. With g = ∂v/∂p and g' = Exp(ω t) g the partials by
pose and point are those of a ray q with g'; those by v are t times those by X₀, and

    ∂v/∂ω = t J_r(ω t)ᵀ (g × p).

(Vautherin et al. 2016, Photogrammetric accuracy and modeling of rolling shutter cameras, ISPRS
Annals III-3, 139–146, has the shift; the turn is added here.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from ..rotation import exp_rotation, right_jacobian
from ..types import Array

Towards: TypeAlias = Literal["down", "up", "right", "left"]
"""Side of the image to which the readout proceeds, as one looks at the image."""
TOWARDS: tuple[Towards, ...] = get_args(Towards)
"""The four sides."""
UNKNOWN_READOUT = 1.0
"""Readout time that stands for an unknown one: motions are then those of the whole readout."""
VELOCITY = 3
"""Number of components of the velocity of a projection centre, the first of a motion."""
MOTION = 6
"""Number of components of the motion of a photo: velocity, turn."""
_ALONG: dict[Towards, tuple[int, float]] = {
    "down": (1, -1.0),
    "up": (1, 1.0),
    "right": (0, 1.0),
    "left": (0, -1.0),
}
"""Image axis of each side, x right and y up, and the sign of times along it."""


@dataclass(frozen=True)
class Readout:
    """The times at which a sensor reads the places of its image."""

    axis: int
    """Image coordinate on which the time depends: 0 for x, 1 for y."""
    middle: float
    """Its value where the time is zero, image units."""
    rate: float
    """Time by image unit, seconds; negative if the readout proceeds against the axis."""

    @classmethod
    def of(cls, seconds: float, towards: Towards, low: Array, high: Array) -> Readout:
        """Return the readout of a sensor.

        Args:
            seconds: readout time of the whole sensor, s.
            towards: side to which the readout proceeds.
            low: lower left corner of the sensor, (2,) image units.
            high: upper right corner, (2,) image units.
        """
        axis, sign = _ALONG[towards]
        extent = float(high[axis] - low[axis])
        return cls(axis, float(low[axis] + high[axis]) / 2, sign * seconds / extent)

    def times(self, x: Array, y: Array) -> Array:
        """Return the times t (n,) of image coordinates x and y (n,), seconds."""
        return np.asarray(self.rate * ((x, y)[self.axis] - self.middle))


@dataclass(frozen=True)
class Turns:
    """Turns Exp(ω t) of a camera since its middle row, at the times of n rays."""

    time: Array
    """t, (n,) seconds."""
    vector: Array
    """ω t, (n, 3) radians."""
    matrix: Array
    """Exp(ω t), (n, 3, 3)."""

    @classmethod
    def of(cls, omega: Array, time: Array) -> Turns:
        """Return the turns with angular velocities ω (n, 3) or (3,), rad/s, at times (n,)."""
        vector = np.asarray(omega) * time[:, None]
        return cls(time, vector, exp_rotation(vector))

    def to_camera(self, q: Array) -> Array:
        """Return p = Exp(ω t)ᵀ q (3, n) of rays q (3, n)."""
        return np.asarray(np.einsum("nji,jn->in", self.matrix, q))

    def to_middle(self, g: Array) -> Array:
        """Return g' = Exp(ω t) g (3, …, n) of partials g = ∂v/∂p (3, …, n)."""
        return np.asarray(np.einsum("nij,j...n->i...n", self.matrix, g))

    def by_turn(self, by_rotation: Array) -> Array:
        """Return ∂v/∂ω (3, …, n) from the partials by a turn at the time of the ray, likewise."""
        jacobian = right_jacobian(self.vector) * self.time[:, None, None]
        return np.asarray(np.einsum("nji,j...n->i...n", jacobian, by_rotation))

    def of_moved_pose(self, by_moved: Array) -> tuple[Array, Array]:
        """Return the partials by the pose and by the motion from those by the moved pose.

        Args:
            by_moved: partials by the tangent of R Exp(ω t), X₀ + v t, (n, d, 6).

        Returns:
            Those by the tangent of R, X₀, and those by v, ω, (n, d, 6) each.
        """
        by_turn, by_centre = by_moved[:, :, :3], by_moved[:, :, 3:]
        by_pose = np.concatenate([by_turn @ self.matrix.transpose(0, 2, 1), by_centre], axis=2)
        time = self.time[:, None, None]
        by_omega = by_turn @ right_jacobian(self.vector) * time
        return by_pose, np.concatenate([by_centre * time, by_omega], axis=2)

"""Rolling shutters: times of image rows, and rays from a camera that moves while it reads them.

A sensor with a rolling shutter is read row by row. With the readout time T of the whole sensor and
the middle row at the time zero, a row is read at

    t = T (row − middle row) / rows.

During the readout the camera moves with the velocity v in the axes of the network (m/s) and turns
by ω about its own axes (rad/s); its pose R, X₀ is that at the middle row. Scenes that take seconds,
of line scanners and panoramic cameras, have terms of higher powers of t too:

    X₀(t) = X₀ + v t + v₂ t² + …,    R(t) = R Exp(ω t + ω₂ t² + …) = R Exp(w),

    p = Exp(w)ᵀ q,    q = Rᵀ (X − X₀(t)).

The time is that of the measured row, and weights stay those of measured coordinates (B = I). With
g = ∂v/∂p and g' = Exp(w) g the partials by pose and point are those of a ray q with g'; those by
v_j are tʲ times those by X₀, and

    ∂v/∂ω_j = tʲ J_r(w)ᵀ (g × p).

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
"""Number of components of the motion of a photo for each power of t: a velocity, a turn."""
HIGHEST_POWER = 3
"""Highest power of t in the motion of a photo."""
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
    components: int = MOTION
    """Number of components of the motions of its photos: six for each power of t."""

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
    """Turns Exp(Σ ω_j tʲ) of a camera since its middle row, at the times of n rays."""

    powers: tuple[Array, ...]
    """t, t², … of the motion, (n,) each."""
    vector: Array
    """Σ ω_j tʲ, (n, 3) radians."""
    matrix: Array
    """Exp of these, (n, 3, 3)."""

    @classmethod
    def of(cls, motion: Array, time: Array) -> tuple[Turns, Array]:
        """Return the turns and the shifts Σ v_j tʲ (n, 3) of motions.

        Args:
            motion: v_1, ω_1, v_2, ω_2 …, (n, 6 d) or (6 d,).
            time: t, (n,) seconds.
        """
        degree = motion.shape[-1] // MOTION
        powers = tuple(time**j for j in range(1, degree + 1))
        shift, vector = (
            sum(
                (t[:, None] * motion[..., first + MOTION * j : first + MOTION * j + 3])
                for j, t in enumerate(powers)
            )
            for first in (0, VELOCITY)
        )
        return cls(powers, np.asarray(vector), exp_rotation(np.asarray(vector))), np.asarray(shift)

    def to_camera(self, q: Array) -> Array:
        """Return p = Exp(Σ ω_j tʲ)ᵀ q (3, n) of rays q (3, n)."""
        return np.asarray(np.einsum("nji,jn->in", self.matrix, q))

    def to_middle(self, g: Array) -> Array:
        """Return g' = Exp(Σ ω_j tʲ) g (3, …, n) of partials g = ∂v/∂p (3, …, n)."""
        return np.asarray(np.einsum("nij,j...n->i...n", self.matrix, g))

    def by_vector(self, by_rotation: Array) -> Array:
        """Return ∂v/∂ the vector Σ ω_j tʲ, (3, …, n), from those by a turn of the ray, likewise.

        Those by ω_j are tʲ times these.
        """
        return np.asarray(np.einsum("nji,j...n->i...n", right_jacobian(self.vector), by_rotation))

    def of_moved_pose(self, by_moved: Array) -> tuple[Array, Array]:
        """Return the partials by the pose and by the motion from those by the moved pose.

        Args:
            by_moved: partials by the tangent of R Exp(Σ ω_j tʲ), X₀ + Σ v_j tʲ, (n, d, 6).

        Returns:
            Those by the tangent of R, X₀, (n, d, 6), and those by the motion, (n, d, k).
        """
        by_turn, by_centre = by_moved[:, :, :3], by_moved[:, :, 3:]
        by_pose = np.concatenate([by_turn @ self.matrix.transpose(0, 2, 1), by_centre], axis=2)
        by_first = np.concatenate([by_centre, by_turn @ right_jacobian(self.vector)], axis=2)
        return by_pose, np.concatenate([by_first * t[:, None, None] for t in self.powers], axis=2)

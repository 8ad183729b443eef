"""Relative rotation and relative position of two photos: odometry, pairs, members of rigs."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from .base import VectorObservation

RELATIVE_POSE = "relative pose"
"""Reading whose parts are a position and a turn of one body relative to another."""
RIGID_TURN, RIGID_SHIFT = 1e-6, 1e-5
"""Standard deviations, radians and metres, below which a relative pose on a mount is the tie of a
rigid mount: a play of 10 µm lets a member that slipped show, and none was measured better."""


@dataclass(frozen=True)
class _RelativePose(VectorObservation):
    """Base of what was measured of one photo relative to another."""

    rigid_sigma: ClassVar[float]
    """Standard deviation below which the observation ties a member of a rig to a rigid mount."""
    photo: str
    """Photo A, in whose axes the value is given: the earlier one, or the carrier."""
    photo2: str
    """Photo B: the later one, or the member of a rig."""
    _: KW_ONLY
    mount: str | None = None
    """Mount of B on A; None: the whole relative pose is observed."""

    @property
    def is_constraint(self) -> bool:
        """Whether it ties the member of a rig to a rigid mount, and was not measured."""
        if self.mount is None:
            return False
        covariance, sigma = self.covariance, getattr(self, "sigma", None)
        variances = np.square(sigma or 0.0) if covariance is None else np.diag(covariance)
        return bool((variances < self.rigid_sigma**2).all())

    def _check(self) -> None:
        super()._check()
        if self.photo == self.photo2:
            self._fail("photo and photo2 are the same: a relative pose joins two photos")


@dataclass(frozen=True)
class RelativeRotation(_RelativePose):
    """Rotation of a photo B relative to a photo A: Log R_obs with R_Aᵀ R_B = B_m R_obs.

    R leads from photogrammetric axes of a camera (x right, y up, z backwards) to the object: ry and
    rz have the opposite sign to those of `PhotoTurn`, whose axes are x right, y down, z forward.
    With a mount B_m the value is the small rotation by which B differs from its place on the mount.
    """

    kind: ClassVar[str] = "relative_rotation"
    components: ClassVar[tuple[str, ...]] = ("rx", "ry", "rz")
    rigid_sigma: ClassVar[float] = RIGID_TURN
    value: tuple[float, float, float]
    """Rotation vector of R_obs, radians, photogrammetric axes."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations of turns about the axes of B, radians; None if ``covariance`` is
    given."""


@dataclass(frozen=True)
class RelativePosition(_RelativePose):
    """Position of a photo B relative to a photo A: R_Aᵀ (X_B − X_A) − b, metres in axes of A.

    The axes are photogrammetric: x right, y up, z backwards. With a mount the value is the small
    vector by which B differs from its place b on the mount.
    """

    kind: ClassVar[str] = "relative_position"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    rigid_sigma: ClassVar[float] = RIGID_SHIFT
    value: tuple[float, float, float]
    """Observed vector, metres, or in the unit of the odometer."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations of the components, unit of the value; None if ``covariance`` is given."""
    instrument: str | None = None
    """Distance meter whose scale is that of the vector: (1 + scale) (t − b). An odometer of unknown
    scale has a free one; one of its own for each pair leaves only the direction."""

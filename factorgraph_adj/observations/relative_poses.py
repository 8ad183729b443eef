"""Relative rotation and relative position of two photos: odometry, pairs, members of rigs."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from ..types import Array
from .base import Observation, checked_covariance

RIGID_TURN, RIGID_SHIFT = 1e-6, 1e-5
"""Standard deviations, radians and metres, below which a relative pose on a mount is the tie of a
rigid mount: a play of 10 µm lets a member that slipped show, and none was measured better."""


@dataclass(frozen=True)
class RelativeRotation(Observation):
    """Rotation of a photo B relative to a photo A: Log R_obs with R_Aᵀ R_B = B_m R_obs.

    R leads from photogrammetric axes of a camera (x right, y up, z backwards) to the object. With a
    mount B_m the value is the small rotation by which B differs from its place on the mount.
    """

    kind: ClassVar[str] = "relative_rotation"
    components: ClassVar[tuple[str, ...]] = ("rx", "ry", "rz")
    photo: str
    """Photo A, to which the rotation refers: the earlier one, or the carrier."""
    photo2: str
    """Photo B: the later one, or the member of a rig."""
    value: tuple[float, float, float]
    """Rotation vector of R_obs, radians, photogrammetric axes."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations of turns about the axes of B, radians; None if ``covariance`` is
    given."""
    covariance: Array | None = None
    """Covariance (3, 3) of turns about the axes of B, radians²; None if ``sigma`` is given."""
    mount: str | None = None
    """Mount of B on A; None: R_obs is the whole rotation."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    @property
    def stated(self) -> bool:
        """Whether it ties the member of a rig to a rigid mount, and was not measured."""
        return _ties(self, RIGID_TURN)

    def __post_init__(self) -> None:
        """Check the observation."""
        _check(self)


@dataclass(frozen=True)
class RelativePosition(Observation):
    """Position of a photo B relative to a photo A: R_Aᵀ (X_B − X_A) − b, metres in axes of A.

    The axes are photogrammetric: x right, y up, z backwards. With a mount the value is the small
    vector by which B differs from its place b on the mount.
    """

    kind: ClassVar[str] = "relative_position"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    photo: str
    """Photo A, in whose axes the vector is given: the earlier one, or the carrier."""
    photo2: str
    """Photo B: the later one, or the member of a rig."""
    value: tuple[float, float, float]
    """Observed vector, metres, or in the unit of the odometer."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations of the components, unit of the value; None if ``covariance`` is given."""
    covariance: Array | None = None
    """Covariance (3, 3) of the components; None if ``sigma`` is given."""
    mount: str | None = None
    """Mount of B on A; None: the whole vector is observed."""
    instrument: str | None = None
    """Distance meter whose scale is that of the vector: (1 + scale) (t − b). An odometer of unknown
    scale has a free one; one of its own for each pair leaves only the direction."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    @property
    def stated(self) -> bool:
        """Whether it ties the member of a rig to a rigid mount, and was not measured."""
        return _ties(self, RIGID_SHIFT)

    def __post_init__(self) -> None:
        """Check the observation."""
        _check(self)


def _ties(o: RelativeRotation | RelativePosition, limit: float) -> bool:
    """Return whether a relative pose on a mount has standard deviations below a limit."""
    if o.mount is None:
        return False
    variances = np.square(o.sigma or 0.0) if o.covariance is None else np.diag(o.covariance)
    return bool((variances < limit**2).all())


def _check(o: RelativeRotation | RelativePosition) -> None:
    """Check what both kinds share."""
    o._check()
    if np.shape(o.value) != (3,):
        o._fail(f"value must have 3 components, not {o.value}")
    if o.photo == o.photo2:
        o._fail("photo and photo2 are the same: a relative pose joins two photos")
    checked_covariance(o, 3)

"""Attitudes of photos, single angles, and distances and vectors of their antennas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

import numpy as np

from ..types import Array
from .base import Observation, checked_covariance

ABOUT = ("body", "angles")
"""What standard deviations, covariances and residuals of an attitude may belong to."""
ANGLES = ("omega", "phi", "kappa", "roll", "pitch", "heading")
"""Single angles of a photo or of its carrier."""


@dataclass(frozen=True)
class PhotoAttitude(Observation):
    """Attitude of a photo, or of what carries it, by ω, φ, κ from the axes of the frame, radians.

        R1(ω) R2(φ) R3(κ) = (Eᵀ Exp(ψ) E)ᵀ R B

    R is the rotation from photogrammetric camera axes to the object, B that of the ``mount``, from
    the body to the camera: the boresight, with body axes nominally those of the camera (x right, y
    up, z backwards). ψ is the drift of the attitudes, about east, north and up at the photo. The
    residual is the rotation vector of the difference of both sides, for attitudes of any size.
    """

    kind: ClassVar[str] = "photo_attitude"
    components: ClassVar[tuple[str, ...]] = ("omega", "phi", "kappa")
    photo: str
    """The photo."""
    value: tuple[float, float, float]
    """ω, φ, κ, radians."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations, radians; None if ``covariance`` is given."""
    covariance: Array | None = None
    """Covariance (3, 3), radians²; None if ``sigma`` is given."""
    about: str = "body"
    """What these belong to, and the residuals: ``body``, rotations about x, y, z of the body, which
    for photos with κ near 0 are nearly those of ω, φ, κ; or ``angles``, the angles themselves."""
    mount: str | None = None
    """Mount with the boresight B; None: B = I."""
    drift: str | None = None
    """Drift of the attitudes ψ of the strip or flight; None: none."""
    time: float = field(default=0.0, metadata={"quantity": "number"})
    """Time t of the drift, counted best from the middle of the strip."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        if np.shape(self.value) != (3,):
            self._fail(f"value must have 3 components, not {self.value}")
        if self.about not in ABOUT:
            self._fail(f"about must be {' or '.join(ABOUT)}, not {self.about!r}")
        checked_covariance(self, 3)

    @property
    def by_angles(self) -> float:
        """1 where rows are those of the angles, 0 where they are rotations of the body."""
        return float(self.about == "angles")


@dataclass(frozen=True)
class NavigationAttitude(PhotoAttitude):
    """Attitude of a carrier by roll, pitch and heading from the horizon at the photo, radians.

        Eᵀ Exp(ψ) N R3(heading) R2(pitch) R1(roll) T = R B

    Roll, pitch and heading are those of axes forward, right, down against north, east, down (N). T
    turns these axes to right, forward, up, which are nominally those of the camera: x to the right
    of the flight, y forward, z up. B of the ``mount`` is then near the identity. E is the horizon
    at the projection centre, whose tilt against the frame is part of the model.
    """

    kind: ClassVar[str] = "navigation_attitude"
    components: ClassVar[tuple[str, ...]] = ("roll", "pitch", "heading")


@dataclass(frozen=True)
class PhotoAngle(Observation):
    """One angle of a photo or of its carrier, radians: ω, φ, κ, roll, pitch or heading.

    Angles are those of `PhotoAttitude` and `NavigationAttitude`, of the rotation R B.
    """

    kind: ClassVar[str] = "photo_angle"
    photo: str
    """The photo."""
    value: float
    """Observed angle, radians."""
    _: KW_ONLY
    angle: str
    """Which angle: omega, phi, kappa, roll, pitch or heading."""
    sigma: float
    """Standard deviation, radians."""
    mount: str | None = None
    """Mount with the boresight B; None: B = I."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        if self.angle not in ANGLES:
            self._fail(f"angle must be one of {', '.join(ANGLES)}, not {self.angle!r}")

    def names(self) -> Sequence[str]:  # type: ignore[override]
        """Return the photo and the angle."""
        return (self.photo, self.angle)

    @property
    def which(self) -> float:
        """Number of the angle."""
        return float(ANGLES.index(self.angle)) if self.angle in ANGLES else 0.0


@dataclass(frozen=True)
class PhotoRange(Observation):
    """Distance from a point to the antenna of a photo, metres: (1 + m) |X₀ + R (a + b) − X| + z."""

    kind: ClassVar[str] = "photo_range"
    nonnegative: ClassVar[bool] = True
    point: str
    """Point of the ground station."""
    photo: str
    """The photo."""
    value: float
    """Observed distance, metres."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, metres."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Vector a from the projection centre to the antenna, metres, as in `PhotoPosition`."""
    mount: str | None = None
    """Mount whose arm b adds to the lever arm; None: none."""
    instrument: str | None = None
    """Distance meter with scale m and zero constant z; None: m = z = 0."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        if np.shape(self.lever_arm) != (3,):
            self._fail(f"lever_arm must have 3 components, not {self.lever_arm}")


@dataclass(frozen=True)
class PhotoBase(Observation):
    """Distance between the antennas of two photos, metres, by Doppler or an odometer."""

    kind: ClassVar[str] = "photo_base"
    nonnegative: ClassVar[bool] = True
    photo: str
    """First photo."""
    photo2: str
    """Second photo."""
    value: float
    """Observed distance, metres."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, metres."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Vector a from the projection centre to the antenna, metres, as in `PhotoPosition`."""
    mount: str | None = None
    """Mount whose arm b adds to the lever arm; None: none."""
    instrument: str | None = None
    """Distance meter with scale m and zero constant z; None: m = z = 0."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        if self.photo == self.photo2:
            self._fail("an observation cannot join a photo to itself")
        if np.shape(self.lever_arm) != (3,):
            self._fail(f"lever_arm must have 3 components, not {self.lever_arm}")


@dataclass(frozen=True)
class AntennaVector(Observation):
    """Vector between two antennas of the carrier of a photo, metres: R (a + b), in the frame.

    It gives the attitude of the carrier about all axes but its own.
    """

    kind: ClassVar[str] = "antenna_vector"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    photo: str
    """The photo."""
    value: tuple[float, float, float]
    """Observed vector from the first antenna to the second, metres."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations of the components, metres; None if ``covariance`` is given."""
    covariance: Array | None = None
    """Covariance (3, 3) of the components, metres²; None if ``sigma`` is given."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Vector a from the first antenna to the second in photogrammetric axes of the camera."""
    mount: str | None = None
    """Mount whose arm b adds to it; None: none."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        for name in ("value", "lever_arm"):
            if np.shape(getattr(self, name)) != (3,):
                self._fail(f"{name} must have 3 components, not {getattr(self, name)}")
        if self.mount is None and not any(self.lever_arm):
            self._fail("give the vector between the antennas as lever_arm, or a mount")
        checked_covariance(self, 3)

"""Observations of photos and carriers: attitudes, ranges, antennas, tilts, bodies at infinity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

import numpy as np

from ..frames import Frame
from ..models.attitude import FORWARD_RIGHT_DOWN, from_omega_phi_kappa, from_roll_pitch_heading
from ..types import Array
from .base import AxesObservation, Observation, VectorObservation

ABOUT = ("body", "angles")
"""What standard deviations, covariances and residuals of an attitude may belong to."""
ANGLES = ("omega", "phi", "kappa", "roll", "pitch", "heading")
"""Single angles of a photo or of its carrier."""
UNIT_TOLERANCE = 1e-6
"""Tolerance of the length of a unit vector."""


@dataclass(frozen=True)
class PhotoAttitude(VectorObservation):
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
    about: str = "angles"
    """What these belong to, and the residuals: ``angles``, to the angles; or ``body``, to rotations
    about x, y, z of the body, in place of ω, φ, κ (forward, right and down, in place of roll, pitch
    and heading). Only the latter is possible where φ or the pitch is ±90°."""
    mount: str | None = None
    """Mount with the boresight B; None: B = I."""
    drift: str | None = None
    """Drift of the attitudes ψ of the strip or flight; None: none."""
    time: float = field(default=0.0, metadata={"quantity": "number"})
    """Time t of the drift, counted best from the middle of the strip."""

    def _check(self) -> None:
        super()._check()
        if self.about not in ABOUT:
            self._fail(f"about must be {' or '.join(ABOUT)}, not {self.about!r}")

    @property
    def by_angles(self) -> float:
        """1 where rows are those of the angles, 0 where they are rotations of the body."""
        return float(self.about == "angles")

    def object_R_body(self, frame: Frame, position: Array) -> Array:
        """Return the observed rotation (3, 3) of the body, without drift.

        Args:
            frame: frame of the network.
            position: projection centre, (3,) metres.
        """
        return np.asarray(from_omega_phi_kappa(np.array([self.value]))[0])


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

    def object_R_body(self, frame: Frame, position: Array) -> Array:
        """Return the observed rotation (3, 3) of the body, without drift; see `PhotoAttitude`."""
        enu = frame.basis(position[None], np.zeros((1, 2))).enu[0]
        body = from_roll_pitch_heading(np.array([self.value]))[0]
        return np.asarray(enu.T @ FORWARD_RIGHT_DOWN @ body @ FORWARD_RIGHT_DOWN)


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

    def _check(self) -> None:
        super()._check()
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

    def _check(self) -> None:
        super()._check()
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

    def _check(self) -> None:
        super()._check()
        if self.photo == self.photo2:
            self._fail("an observation cannot join a photo to itself")
        if np.shape(self.lever_arm) != (3,):
            self._fail(f"lever_arm must have 3 components, not {self.lever_arm}")


@dataclass(frozen=True)
class AntennaVector(VectorObservation):
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
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Vector a from the first antenna to the second in photogrammetric axes of the camera."""
    mount: str | None = None
    """Mount whose arm b adds to it; None: none."""

    def _check(self) -> None:
        super()._check()
        if np.shape(self.lever_arm) != (3,):
            self._fail(f"lever_arm must have 3 components, not {self.lever_arm}")
        if self.mount is None and not any(self.lever_arm):
            self._fail("give the vector between the antennas as lever_arm, or a mount")


@dataclass(frozen=True)
class PhotoTilt(AxesObservation):
    """Inclinations of an instrument that a camera carries: atan2(q_x, q_z) and atan2(q_y, q_z).

    Horizon cameras, clinometers, levels of a plotter and accelerometers measure them, in radians.
    q = Bᵀ Rᵀ u is the zenith at the projection centre in the axes of the instrument. That of x is
    positive if the x axis points above the horizon: it is the inclination about y, and that of y
    is about x. Without a mount the axes are photogrammetric ones of the camera, x right, y up, z
    backwards, so that a photo that looks straight down has 0, 0; the mount of an oblique camera
    turns an instrument so that its z axis points roughly up.
    """

    kind: ClassVar[str] = "photo_tilt"
    components: ClassVar[tuple[str, ...]] = ("x", "y")
    photo: str
    """The photo."""
    value: tuple[float, ...]
    """Inclinations of ``axes``, radians."""
    _: KW_ONLY
    axes: str = "xy"
    """Inclined axes: x, y or both."""
    mount: str | None = None
    """Mount whose rotation turns the axes of the instrument to those of the camera; None: they are
    the same."""
    sigma: tuple[float, ...] | None = None
    """Standard deviations of the axes, radians; None if ``covariance`` is given."""


@dataclass(frozen=True)
class PhotoSight(AxesObservation):
    """Direction to a body at infinity in the axes of an instrument that a camera carries.

    Solar periscopes, sun compasses and star trackers measure it. The residuals are the angles from
    the measured direction ``seen`` to the body, radians, along the two directions perpendicular to
    it that are nearest to the x and y axes of the instrument. See
    `factorgraph_adj.frames.direction_of` for the vector of a body of known azimuth and altitude.
    """

    kind: ClassVar[str] = "photo_sight"
    components: ClassVar[tuple[str, ...]] = ("x", "y")
    photo: str
    """The photo."""
    body: tuple[float, float, float] = field(metadata={"quantity": "number"})
    """Unit vector to the body in the frame of the network; refraction of its altitude is that of
    the ray that was measured."""
    seen: tuple[float, float, float] = field(metadata={"quantity": "number"})
    """Measured unit vector to the body in the axes of the instrument; without a mount these are
    photogrammetric axes of the camera, x right, y up, z backwards."""
    value: tuple[float, ...] = (0.0, 0.0)
    """Corrections of ``seen`` along ``axes``, radians; usually zero."""
    _: KW_ONLY
    axes: str = "xy"
    """Measured components: x, y or both. A compass measures one of them."""
    mount: str | None = None
    """Mount whose rotation turns the axes of the instrument to those of the camera; None: they are
    the same."""
    sigma: tuple[float, ...] | None = None
    """Standard deviations of the components, radians; None if ``covariance`` is given."""

    def __post_init__(self) -> None:
        """Take one zero as the default of one component, and check the observation."""
        if self.value == (0.0, 0.0) and len(self.axes) == 1:
            object.__setattr__(self, "value", (0.0,))
        super().__post_init__()

    def _check(self) -> None:
        super()._check()
        for name in ("body", "seen"):
            vector: Sequence[float] = getattr(self, name)
            if (
                np.shape(vector) != (3,)
                or abs(float(np.linalg.norm(vector)) - 1.0) > UNIT_TOLERANCE
            ):
                self._fail(f"{name} must be a unit vector of three numbers, not {vector}")

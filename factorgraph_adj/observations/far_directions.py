"""Directions measured by instruments that a camera carries, and azimuths of gyrotheodolites."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

import numpy as np

from ..types import Array
from .base import Observation, Sight, Sigma, checked_covariance

UNIT = 1e-6
"""Tolerance of the length of a unit vector."""


class _TwoAxes(Observation):
    """Base of observations with one or both of two components, x and y."""

    components: ClassVar[tuple[str, ...]] = ("x", "y")
    value: tuple[float, ...]
    """Values of ``axes``, radians."""
    axes: str
    """Observed components."""

    def _check_axes(self) -> None:
        if self.axes not in ("xy", "yx", "x", "y"):
            self._fail(f"axes must be x, y or both, not {self.axes!r}")
        if np.shape(self.value) != (len(self.axes),):
            self._fail(f"value has {np.size(self.value)} components, axes {self.axes!r}")
        checked_covariance(self, len(self.axes))

    def component_names(self) -> tuple[str, ...]:
        """Return the observed components."""
        return tuple(self.axes)


@dataclass(frozen=True)
class PhotoTilt(_TwoAxes):
    """Inclinations of an instrument that a camera carries: atan2(q_x, q_z) and atan2(q_y, q_z).

    Horizon cameras, clinometers, levels of a plotter and accelerometers measure them, in radians.
    q = Bᵀ Rᵀ u is the zenith at the projection centre in the axes of the instrument. That of x is
    positive if the x axis points above the horizon: it is the inclination about y, and that of y
    is about x. Without a mount the axes are photogrammetric ones of the camera, x right, y up, z
    backwards, so that a photo that looks straight down has 0, 0; the mount of an oblique camera
    turns an instrument so that its z axis points roughly up.
    """

    kind: ClassVar[str] = "photo_tilt"
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
    covariance: Array | None = None
    """Covariance of the axes, radians²; None if ``sigma`` is given."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        self._check_axes()


@dataclass(frozen=True)
class PhotoSight(_TwoAxes):
    """Direction to a body at infinity in the axes of an instrument that a camera carries.

    Solar periscopes, sun compasses and star trackers measure it. The residuals are the angles from
    the measured direction ``seen`` to the body, radians, along the two directions perpendicular to
    it that are nearest to the x and y axes of the instrument. See
    `factorgraph_adj.frames.direction_of` for the vector of a body of known azimuth and altitude.
    """

    kind: ClassVar[str] = "photo_sight"
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
    covariance: Array | None = None
    """Covariance of the components, radians²; None if ``sigma`` is given."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def __post_init__(self) -> None:
        """Check the observation."""
        if self.value == (0.0, 0.0) and len(self.axes) == 1:  # the default of one component
            object.__setattr__(self, "value", (0.0,))
        self._check()
        self._check_axes()
        for name in ("body", "seen"):
            vector: Sequence[float] = getattr(self, name)
            if np.shape(vector) != (3,) or abs(float(np.linalg.norm(vector)) - 1.0) > UNIT:
                self._fail(f"{name} must be a unit vector of three numbers, not {vector}")


@dataclass(frozen=True)
class GyroAzimuth(Sight):
    """Azimuth read with a gyrotheodolite, radians: α − E, with the constant E of the instrument."""

    kind: ClassVar[str] = "gyro_azimuth"
    _: KW_ONLY
    sigma: Sigma
    """Standard deviation, radians, or its parts."""
    gyro: str | None = None
    """Gyrotheodolite, see `Network.set_gyro`; None: E is 0."""

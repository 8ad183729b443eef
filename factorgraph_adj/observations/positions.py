"""Observed coordinates of points and photos, GNSS vectors; formulas: `models.positions`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import ClassVar

import numpy as np

from ..frames import Frame
from .base import AxesObservation, VectorObservation, checked_covariance


@dataclass(frozen=True)
class GnssVector(VectorObservation):
    """GNSS vector X_j − X_i, metres, with a full covariance."""

    kind: ClassVar[str] = "gnss_vector"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    station: str
    """Start point of the vector, i."""
    target: str
    """End point of the vector, j."""
    value: tuple[float, float, float]
    """X_j − X_i between the antennas, metres."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations of the components, metres; None if ``covariance`` is given."""
    instrument_height: float = 0.0
    """Height of the antenna at i, metres."""
    target_height: float = 0.0
    """Height of the antenna at j, metres."""


@dataclass(frozen=True)
class ControlPoint(VectorObservation):
    """Known coordinates of a point with their precision: 3-D, plan or height.

    x, y, z are the axes of the frame; e, n, u are the axes of the horizon at the given position.
    """

    kind: ClassVar[str] = "control"
    point: str
    """The point."""
    value: tuple[float, ...]
    """Known coordinates, metres: those of ``axes`` for x, y, z; all of X, Y, Z for e, n, u."""
    _: KW_ONLY
    axes: str = "xyz"
    """Known components: any of x, y, z, or any of e, n, u."""
    sigma: tuple[float, ...] | None = None
    """Standard deviations of the components, metres; None if ``covariance`` is given."""

    def _check_components(self) -> None:
        local = set(self.axes) <= set("enu")
        if (
            not self.axes
            or len(set(self.axes)) != len(self.axes)
            or not (local or set(self.axes) <= set("xyz"))
        ):
            self._fail(f"axes must be some of x, y, z or some of e, n, u, not {self.axes!r}")
        if np.shape(self.value) != (3 if local else len(self.axes),):
            self._fail(f"value has {np.size(self.value)} components, axes {self.axes!r}")
        checked_covariance(self, len(self.axes))

    @property
    def local(self) -> bool:
        """Whether the known components are some of east, north, up; ``value`` is then X, Y, Z."""
        return set(self.axes) <= set("enu")

    def component_names(self) -> tuple[str, ...]:
        """Return the known axes."""
        return tuple(self.axes)

    def with_reading(self, values: Sequence[float], frame: Frame) -> ControlPoint:
        """Return the control point with new coordinates; values in e, n, u are shifts."""
        if not self.local:
            return replace(self, value=tuple(values))
        at = np.array(self.value, dtype=float)
        enu = frame.basis(at[None], np.zeros((1, 2))).enu[0]
        at = at + np.array(values) @ enu[["enu".index(a) for a in self.axes]]
        return replace(self, value=tuple(at.tolist()))


@dataclass(frozen=True)
class GnssPosition(ControlPoint):
    """Position of a point by GNSS, metres, with a full covariance."""

    kind: ClassVar[str] = "gnss_position"


@dataclass(frozen=True)
class PhotoPosition(AxesObservation):
    """Position of the antenna of a photo (GNSS), metres: X₀ + R (a + b) + s + d t + e t² + Ẋ τ.

    X₀ is the projection centre, R the rotation of ω, φ, κ from the photogrammetric axes of the
    camera to the object, and a the lever arm: the vector from the projection centre to the antenna
    in these axes, x to the right and y to the top of the image, z backwards, away from what the
    camera sees. An antenna 1.2 m above a camera that looks vertically down has a = (0, 0, 1.2).
    The arm b of a ``mount`` adds to it. The shift and drift of a ``drift`` and the velocity are in
    the axes of the frame of the network.
    """

    kind: ClassVar[str] = "photo_position"
    photo: str
    """The photo."""
    value: tuple[float, ...]
    """Observed position, metres: the coordinates of ``axes``. A position in plan has ``xy``, a
    height ``z``."""
    _: KW_ONLY
    sigma: tuple[float, ...] | None = None
    """Standard deviations of the coordinates, metres; None if ``covariance`` is given."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Vector a from the projection centre to the antenna, metres, in photogrammetric axes of the
    camera: x right, y up, z backwards. Its sign is that of antenna − projection centre."""
    mount: str | None = None
    """Mount whose arm b adds to the lever arm; None: none. See `Network.set_mount`."""
    drift: str | None = None
    """Shift and drift s, d, e of the strip or flight; None: none. See `Network.set_drift`."""
    time: float = field(default=0.0, metadata={"quantity": "number"})
    """Time t of the drift, counted best from the middle of the strip: in seconds, exposures or
    kilometres."""
    shutter: str | None = None
    """Shutter with a time error τ; None: none. See `Network.set_shutter`."""
    velocity: tuple[float, float, float] = field(
        default=(0.0, 0.0, 0.0), metadata={"quantity": "number"}
    )
    """Recorded velocity Ẋ of the antenna, metres per second; for ``shutter``."""

    def _check(self) -> None:
        super()._check()
        for name in ("lever_arm", "velocity"):
            if np.shape(getattr(self, name)) != (3,):
                self._fail(f"{name} must have 3 components, not {getattr(self, name)}")
        if self.shutter is not None and not any(self.velocity):
            self._fail("a shutter needs the velocity of the antenna, and it is zero")

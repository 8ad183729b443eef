"""Observations in a frame of their own."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from ..types import Array
from .base import Observation, checked_covariance


@dataclass(frozen=True)
class FrameCoordinate(Observation):
    """Coordinates of a point or of a projection centre in a frame: q = e^{−ℓ} Rᵀ E (X − O) − c.

    They are model coordinates of independent models, coordinates of scanners, trackers and
    coordinate measuring machines, or of another network. All numbers have the unit of the frame,
    e^ℓ metres: metres where the scale is held at ln_scale = 0. See `Network.add_frame`.
    """

    kind: ClassVar[str] = "frame_coordinate"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    frame: str
    """The frame."""
    point: str | None
    """The point; None if ``photo`` is given."""
    value: tuple[float, ...]
    """Measured coordinates of ``axes``, unit of the frame."""
    _: KW_ONLY
    photo: str | None = None
    """The photo whose projection centre was measured; None if ``point`` is given."""
    axes: str = "xyz"
    """Measured axes of the frame: some of x, y, z."""
    sigma: tuple[float, ...] | None = None
    """Standard deviations of the axes, unit of the frame; None if ``covariance`` is given."""
    covariance: Array | None = None
    """Covariance of the axes, its unit squared; None if ``sigma`` is given."""
    deformation: str | None = None
    """Deformation of the model, which a group of models shares; None: there is none."""
    base: float = 1.0
    """Length to which the deformation refers, such as the base of the model, unit of the frame."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        if (self.point is None) == (self.photo is None):
            self._fail("give either a point or a photo")
        if not self.frame:
            self._fail("frame must name a frame")
        if not self.base > 0:
            self._fail(f"base must be greater than zero, not {self.base}")
        if (
            not self.axes
            or not set(self.axes) <= set("xyz")
            or len(set(self.axes)) < len(self.axes)
        ):
            self._fail(f"axes must be some of x, y, z, not {self.axes!r}")
        if np.shape(self.value) != (len(self.axes),):
            self._fail(f"value has {np.size(self.value)} components, axes {self.axes!r}")
        checked_covariance(self, len(self.axes))

    def component_names(self) -> tuple[str, ...]:
        """Return the measured axes."""
        return tuple(self.axes)


@dataclass(frozen=True)
class FrameVector(Observation):
    """Vector between two points along the axes of a frame: e^{−ℓ} Rᵀ E (X_j − X_i).

    It is a GNSS vector whose reference frame differs from that of the network by an unknown, held
    or weighted rotation and scale (`Network.add_frame` with free = ("rotation", "scale")); the
    offset of the frame has no part in it. E is the identity; in a frame that is ``level`` it is the
    horizon (east, north, up) at the first point. GNSS frames are turned by seconds of arc: state
    values 0 for free rotations, which vectors alone do not place. The axes of the frame are then
    nearly those of the network: geocentric vectors of a topocentric network are turned into its
    axes first, which `factorgraph_adj.vectors_in_own_datum` does with those of a network.
    """

    kind: ClassVar[str] = "frame_vector"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    frame: str
    """The frame."""
    station: str
    """First point, i."""
    target: str
    """Second point, j."""
    value: tuple[float, float, float]
    """Measured components along the axes of the frame, unit of the frame."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations, unit of the frame; None if ``covariance`` is given."""
    covariance: Array | None = None
    """Covariance (3, 3), its unit squared; None if ``sigma`` is given."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        if not self.frame:
            self._fail("frame must name a frame")
        if np.shape(self.value) != (3,):
            self._fail(f"value must have three components, not {np.size(self.value)}")
        checked_covariance(self, 3)

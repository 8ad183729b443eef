"""Relations of points (ratios, right angles, directions, differences), of shapes; images of lines.

Their observed values are zero as a rule; points and shapes come from other observations.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

import numpy as np

from .base import AxesObservation, Condition, VectorObservation, share_sigma

# -- two pairs of points --------------------------------------------------------------------------


@dataclass(frozen=True)
class _Pairs(Condition):
    """Base of relations of a pair of points, A and B, with another pair, C and D.

    Where the pairs have a point in common it becomes A, and C is None.
    """

    directed: ClassVar[bool] = False
    """Whether a pair the other way round has the opposite sign."""
    station: str
    """First point of the first pair, A."""
    target: str
    """Second point of the first pair, B."""
    station2: str | None
    """First point of the second pair, C; None: A."""
    target2: str
    """Second point of the second pair, D."""
    value: float = 0.0
    """Difference of both, metres."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, metres."""
    ratio: float = field(default=1.0, metadata={"quantity": "number"})
    """What the second pair is multiplied with."""

    def __post_init__(self) -> None:
        """Begin both pairs with the point that they have in common, and check the observation."""
        a, b, c, d = self.station, self.target, self.station2, self.target2
        if c is not None and a != b and c != d:
            sign = -1.0 if self.directed else 1.0
            if {a, b} == {c, d}:
                self._fail("both pairs are the same two points")
            elif a == c:
                self._set(a, b, d, 1.0, 1.0)
            elif b == d:
                self._set(b, a, c, sign, 1.0)
            elif b == c:
                self._set(b, a, d, sign, sign)
            elif a == d:
                self._set(a, b, c, 1.0, sign)
        super().__post_init__()

    def _set(self, common: str, first: str, second: str, value: float, ratio: float) -> None:
        """Set the points; ``value`` and ``ratio`` are the signs of both."""
        names = {"station": common, "target": first, "station2": None, "target2": second}
        new = {**names, "value": value * self.value, "ratio": ratio * self.ratio}
        for name, what in new.items():
            object.__setattr__(self, name, what)


@dataclass(frozen=True)
class EqualDistance(_Pairs):
    """Two distances in space are equal, or have a ratio: |AB| − ratio · |CD|."""

    kind: ClassVar[str] = "equal_distance"


@dataclass(frozen=True)
class EqualHeightDifference(_Pairs):
    """Two height differences are equal, or have a ratio: (h_B − h_A) − ratio · (h_D − h_C)."""

    kind: ClassVar[str] = "equal_height_difference"
    directed: ClassVar[bool] = True


# -- points ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RightAngle(Condition):
    """The angle in space at a point is right: the cosine of the angle, radians."""

    kind: ClassVar[str] = "right_angle"
    station: str
    """The point of the angle, B."""
    target: str
    """First other point, A."""
    target2: str
    """Second other point, C."""
    value: float = 0.0
    """Cosine of the angle: near a right angle π/2 less the angle, radians."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, radians."""


@dataclass(frozen=True)
class PointDirection(Condition, VectorObservation):
    """The direction in space from one point to another: its components across a given vector."""

    kind: ClassVar[str] = "point_direction"
    components: ClassVar[tuple[str, ...]] = ("across", "beside")
    station: str
    """The first point."""
    target: str
    """The second point."""
    ux: float = field(metadata={"quantity": "number"})
    """Component along x of a vector of any length that has the direction."""
    uy: float = field(metadata={"quantity": "number"})
    """Component along y."""
    uz: float = field(metadata={"quantity": "number"})
    """Component along z."""
    value: tuple[float, ...] = (0.0, 0.0)
    """Components of the direction in two directions across the vector, radians."""
    _: KW_ONLY
    sigma: tuple[float, ...] | float | None = None
    """Standard deviations, radians, one for both or one for each; None with ``covariance``."""

    def __post_init__(self) -> None:
        """Take one standard deviation for both components, and check the observation."""
        share_sigma(self, 2)
        super().__post_init__()

    def _check(self) -> None:
        super()._check()
        if not np.hypot(np.hypot(self.ux, self.uy), self.uz) > 0:
            self._fail("ux, uy, uz must be a vector that is not zero")


@dataclass(frozen=True)
class CoordinateDifference(Condition, AxesObservation):
    """Differences of coordinates of two points, in axes of the network or in a horizon."""

    kind: ClassVar[str] = "coordinate_difference"
    station: str
    """The first point, i."""
    target: str
    """The second point, j."""
    value: tuple[float, ...]
    """Differences of ``axes``, j less i, metres."""
    _: KW_ONLY
    horizon: bool = field(default=False, metadata={"quantity": "number"})
    """Whether x, y, z are east, north, up at the first point, and not the axes of the network."""
    sigma: tuple[float, ...] | float | None = None
    """Standard deviations, metres, one for all or one for each; None with ``covariance``."""

    def __post_init__(self) -> None:
        """Take one standard deviation for all axes, and check the observation."""
        object.__setattr__(self, "horizon", bool(self.horizon))
        share_sigma(self, len(self.axes))
        super().__post_init__()


# -- shapes ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _OfShapes(Condition):
    """Base of relations of two shapes."""

    shape: str
    """The frame of the first shape."""
    shape2: str
    """The frame of the second shape."""

    def _check(self) -> None:
        super()._check()
        if not self.shape or not self.shape2 or self.shape == self.shape2:
            self._fail("shape and shape2 must name two frames, see add_shape")


@dataclass(frozen=True)
class ParallelAxes(_OfShapes, VectorObservation):
    """The z axes of two shapes are parallel: normals of planes, axes of cylinders.

    The two components are the inclinations of the second axis to the first one, radians.
    """

    kind: ClassVar[str] = "parallel_axes"
    components: ClassVar[tuple[str, ...]] = ("rx", "ry")
    value: tuple[float, ...] = (0.0, 0.0)
    """Inclinations, radians."""
    _: KW_ONLY
    sigma: tuple[float, ...] | float | None = None
    """Standard deviations, radians, one for both or one for each; None with ``covariance``."""

    def __post_init__(self) -> None:
        """Take one standard deviation for both inclinations, and check the observation."""
        share_sigma(self, 2)
        super().__post_init__()


@dataclass(frozen=True)
class AxisAngle(_OfShapes):
    """The angle between the z axes of two shapes, without sense; right without another value."""

    kind: ClassVar[str] = "axis_angle"
    value: float = np.pi / 2
    """The angle, radians, from 0 to π/2."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, radians."""


@dataclass(frozen=True)
class PlaneDistance(_OfShapes):
    """The distance of a second shape from a plane: of the zero place of its frame.

    It is the place of a parallel plane nearest to the origin of its frame, the centre of a circle,
    sphere or torus, the apex of a cone or paraboloid.
    """

    kind: ClassVar[str] = "plane_distance"
    value: float
    """The distance, metres; zero or less: with the sense of the z axis of the plane."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, metres."""


# -- images ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ImageLine(Condition):
    """A measured point of the image of a straight line, without a point of the object.

    Observed is the distance of the measured point from the imaged line, zero, in units of the
    camera; x right, y up, as in `ImagePoint`.
    """

    kind: ClassVar[str] = "image_line"
    photo: str
    """The photo."""
    line: str
    """The frame of the line, see `Network.add_shape`."""
    x: float = field(metadata={"quantity": "number"})
    """Measured coordinate x, unit of the camera."""
    y: float = field(metadata={"quantity": "number"})
    """Measured coordinate y, unit of the camera."""
    value: float = 0.0
    """Distance of the measured point from the line, unit of the camera."""
    _: KW_ONLY
    sigma: float
    """Standard deviation of the corrected point across the line, unit of the camera: for lens
    models from measured to ideal coordinates the distance is in the plane of ideal ones."""

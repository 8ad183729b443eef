"""Observations that points lie on shapes, planes to paraboloids; the distances: `models.shapes`.

Each is an observation of the distance of a point from the shape, zero as a rule, with the tolerance
of its form as standard deviation. `Network.add_shape` states the shape.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

from ..models.shapes import SHAPES
from .base import Condition, VectorObservation, share_sigma


@dataclass(frozen=True)
class _OnShape(Condition):
    """Base of points on shapes."""

    shape_name: ClassVar[str] = ""
    """Name of the shape, a key of `factorgraph_adj.models.shapes.SHAPES`."""
    shape: str
    """The frame of the shape."""
    point: str
    """The point."""

    def __post_init__(self) -> None:
        """Name the sizes that are not named after the shape, and check the observation."""
        for size in SHAPES[self.shape_name].sizes:
            if getattr(self, size.attribute) is None and size.suffix is not None:
                object.__setattr__(self, size.attribute, f"{self.shape}{size.suffix}")
        super().__post_init__()

    def _check(self) -> None:
        super()._check()
        if not self.shape:
            self._fail("shape must name a frame, see add_shape")


@dataclass(frozen=True)
class _OnSurface(_OnShape):
    """Base of points on surfaces, with one distance along the normal."""

    value: float = 0.0
    """Distance from the surface, metres, positive outwards (of a plane: along its z axis)."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, metres: the tolerance of the form."""


@dataclass(frozen=True)
class _OnCurve(_OnShape, VectorObservation):
    """Base of points on curves, with two distances across the curve."""

    value: tuple[float, ...] = (0.0, 0.0)
    """Distances from the curve, metres."""
    _: KW_ONLY
    sigma: tuple[float, ...] | float | None = None
    """Standard deviations, metres, one for both or one for each; None with ``covariance``."""

    def __post_init__(self) -> None:
        """Take one standard deviation for both distances, and check the observation."""
        share_sigma(self, 2)
        super().__post_init__()


@dataclass(frozen=True)
class OnPlane(_OnSurface):
    """Distance of a point from a plane: q₃."""

    kind: ClassVar[str] = "on_plane"
    shape_name: ClassVar[str] = "plane"


@dataclass(frozen=True)
class OnLine(_OnCurve):
    """Distances of a point from a straight line, in two directions across it: q₁, q₂."""

    kind: ClassVar[str] = "on_line"
    shape_name: ClassVar[str] = "line"
    components: ClassVar[tuple[str, ...]] = ("x", "y")


@dataclass(frozen=True)
class OnCircle(_OnCurve):
    """Distances of a point from a circle, along its axis and outwards: q₃ − h, ρ − r.

    Targets of one turning instrument have an axis in common, and each a radius and a height of its
    own; the offset z of the frame is then held.
    """

    kind: ClassVar[str] = "on_circle"
    shape_name: ClassVar[str] = "circle"
    components: ClassVar[tuple[str, ...]] = ("axial", "radial")
    radius: str | None = None
    """The size r; None: that with the name of the shape."""
    height: str | None = None
    """The size h, the place of the circle along the z axis; None: 0."""


@dataclass(frozen=True)
class OnCylinder(_OnSurface):
    """Distance of a point from a cylinder: ρ − r."""

    kind: ClassVar[str] = "on_cylinder"
    shape_name: ClassVar[str] = "cylinder"
    radius: str | None = None
    """The size r; None: that with the name of the shape."""


@dataclass(frozen=True)
class OnSphere(_OnSurface):
    """Distance of a point from a sphere: |q| − r."""

    kind: ClassVar[str] = "on_sphere"
    shape_name: ClassVar[str] = "sphere"
    radius: str | None = None
    """The size r; None: that with the name of the shape."""


@dataclass(frozen=True)
class OnCone(_OnSurface):
    """Distance of a point from a cone: ρ cos α − q₃ sin α, with the apex at q = 0."""

    kind: ClassVar[str] = "on_cone"
    shape_name: ClassVar[str] = "cone"
    angle: str | None = None
    """The angle α between axis and cone; None: that with the name of the shape."""


@dataclass(frozen=True)
class OnTorus(_OnSurface):
    """Distance of a point from a torus: √((ρ − A)² + q₃²) − r."""

    kind: ClassVar[str] = "on_torus"
    shape_name: ClassVar[str] = "torus"
    radius: str | None = None
    """The size r of the tube; None: that with the name of the shape."""
    ring: str | None = None
    """The size A, the radius of the ring of the centres; None: that named ``SHAPE ring``."""


@dataclass(frozen=True)
class OnParaboloid(_OnSurface):
    """Distance of a point from a paraboloid of revolution, of first order.

    (q₃ − ρ²/4F) / √(1 + ρ²/4F²), with the apex at q = 0.
    """

    kind: ClassVar[str] = "on_paraboloid"
    shape_name: ClassVar[str] = "paraboloid"
    focal: str | None = None
    """The size F, the focal length; None: that with the name of the shape."""

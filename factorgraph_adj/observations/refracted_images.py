"""Image points seen through water surfaces, planes and flat ports; refractive indices, ports."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

from ..models import datum_motions, refracted_rays
from ..models.unknown_registry import Component, UnknownKind, UnknownTable
from .base import VectorObservation, share_sigma
from .registry import ObservationKind, Quantity


@dataclass(frozen=True)
class _ThroughInterface(VectorObservation):
    """Base of image coordinates of points in another medium than the camera."""

    components: ClassVar[tuple[str, ...]] = ("x", "y")
    photo: str
    """The photo."""
    point: str
    """The point, in the other medium."""
    value: tuple[float, float]
    """Measured coordinates, units of the camera, x right, y up."""
    _: KW_ONLY
    sigma: tuple[float, float] | float | None = None
    """Standard deviations of x and y, or one for both, units of the camera; None if ``covariance``
    is given."""
    medium: str
    """The refractive index of the medium, see `Network.set_refractive_index`."""

    def __post_init__(self) -> None:
        """Let one standard deviation apply to x and y, and check the observation."""
        share_sigma(self, 2)
        self._check()

    def _check(self) -> None:
        super()._check()
        for kind, attribute in self.record.parameters:
            if kind != "photo_motion" and not getattr(self, attribute):
                self._fail(f"{attribute} must be the name of a {kind.replace('_', ' ')}")


@dataclass(frozen=True)
class ImageThroughLevel(_ThroughInterface):
    """Image coordinates of a point beyond a level surface, such as the bottom of a lake.

    The surface is curved as heights are in the frame of the network. The camera may be above it
    and the point below, or the other way round.
    """

    kind: ClassVar[str] = "image_through_level"
    _: KW_ONLY
    level: str
    """The level surface, see `Network.set_level`."""
    geoid: float = 0.0
    """Geoid undulation at the point less that at the place of the level's height, metres."""


@dataclass(frozen=True)
class ImageThroughPlane(_ThroughInterface):
    """Image coordinates of a point beyond a plane, such as the water surface or wall of a tank."""

    kind: ClassVar[str] = "image_through_plane"
    _: KW_ONLY
    plane: str
    """The frame of the plane, see `Network.add_shape`; its z axis is the normal."""


@dataclass(frozen=True)
class ImageThroughPort(_ThroughInterface):
    """Image coordinates of a point beyond the flat port of a camera's housing."""

    kind: ClassVar[str] = "image_through_port"
    _: KW_ONLY
    port: str
    """The port, see `Network.set_port`."""


THROUGH_INTERFACE: Quantity = "image of a point through an interface"
"""Quantity of the kinds of this module."""
UNKNOWNS_IN_MODULE = (
    UnknownKind(
        "refractive_index",
        "refractive index",
        "N",
        (Component("index", "number", 4.0 / 3.0, sign="n", column="value"),),
        late=2,
        table=UnknownTable("refractive_indices"),
        additional=True,
        reference="given",
        remedy=(
            "near-vertical rays through a plane surface tell the index and the depths together: "
            "rays of large angles, a length or a height under water, or the height of the surface "
            "separate them; or hold the index, or weight it"
        ),
        titles={"de": "Brechzahl"},
    ),
    UnknownKind(
        "port",
        "flat port",
        "P",
        (
            Component("slope_x"),
            Component("slope_y"),
            Component("distance", "length"),
            Component("thickness", "length"),
            Component("glass_index", start=1.5),
        ),
        short="port",
        motions=datum_motions.of_ports,
        late=2,
        table=UnknownTable("ports", held_unless_free=True),
        additional=True,
        reference="given",
        instrument=True,
        remedy=(
            "distance, glass and index of the medium act alike on photos of points at one "
            "distance, as the principal distance and radial distortion do: calibrate the camera "
            "in air, hold the glass, and see points at different distances and large angles"
        ),
        titles={"de": "Planscheibe"},
    ),
)
"""The index of a medium relative to that of the camera, and the plane port of a housing."""
_RAY = (
    ("pose", "photo"),
    ("calibration", "photo"),
    ("point", "point"),
    ("photo_motion", "photo"),
)
_MEDIUM = ("refractive_index", "medium")
KINDS_IN_MODULE = (
    ObservationKind(
        ImageThroughLevel,
        (*_RAY, ("level", "level"), _MEDIUM),
        refracted_rays.image_through_level,
        ("geoid",),
        unit="image",
        quantity=THROUGH_INTERFACE,
        titles={"de": "Bildpunkt durch Wasseroberfläche"},
    ),
    ObservationKind(
        ImageThroughPlane,
        (
            *_RAY,
            ("frame", "plane"),
            ("point", "plane.origin"),
            ("vertical", "plane.origin"),
            _MEDIUM,
        ),
        refracted_rays.image_through_plane,
        unit="image",
        quantity=THROUGH_INTERFACE,
        titles={"de": "Bildpunkt durch Ebene"},
    ),
    ObservationKind(
        ImageThroughPort,
        (*_RAY, ("port", "port"), _MEDIUM),
        refracted_rays.image_through_port,
        unit="image",
        quantity=THROUGH_INTERFACE,
        titles={"de": "Bildpunkt durch Planscheibe"},
    ),
)
"""The records."""

"""Small networks with every kind of observation, in every frame and lens model.

A new kind of observation is one entry in `EXAMPLES`, a new frame one in `FRAMES`, a new lens model
one in `LENSES_USED`; the tests that use these tables then check it. The examples are also in the
network of everything and in the networks drawn by chance, see `add_examples`; these have kinds of
`OBSERVED` in places of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from factorgraph_adj import observations as o
from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.frames import Frame, GeocentricFrame, LocalFrame, TopocentricFrame
from factorgraph_adj.graph.equations import Equations, compile_network
from factorgraph_adj.models import lens, place_lens, ray_lens, scanner_lens
from factorgraph_adj.models.deformation import DEFORMATIONS, HEIGHT_TERMS
from factorgraph_adj.models.film_lens import FilmLens
from factorgraph_adj.models.grid_lens import GridLens
from factorgraph_adj.models.normalised_lens import (
    AffineNormalisedLens,
    CentredBrownLens,
    FraserNormalisedLens,
    RationalLens,
)
from factorgraph_adj.models.orthogonal_lens import EbnerLens, GruenLens, OrthogonalLens
from factorgraph_adj.models.positions import heights
from factorgraph_adj.models.rolling_shutter import Towards
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import KINDS
from factorgraph_adj.observations.airborne_observations import ANGLES
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.types import Array

ARCSEC = np.pi / 180 / 3600
HEIGHTS = {"instrument_height": 1.53, "target_height": 1.21}
SIGHT = {"sigma": 0.01, **HEIGHTS}
BODY, SEEN = (0.36, -0.48, 0.8), (-0.6, 0.0, -0.8)
"""Unit vectors towards a body in the horizon and in the axes of an instrument."""
COVARIANCE = np.array([[4.0, 1.0, -0.5], [1.0, 3.0, 0.7], [-0.5, 0.7, 5.0]])
SMALL_ANGLES = 1e-6 * COVARIANCE[:2, :2]
"""Covariance of two components of directions, rad²: measured unit vectors remain unit vectors."""

WIRE: dict[str, Any] = {"sag": "sag", "length": 90.0}
SORTS_OF_FRAMES = ("body", "tripod", "slanted", "leaning")
"""Frames with a constant origin, at the point i and level, there and not level, constant and level.
"""
PLACE = {"along": 1.3, "across": -0.4}
BENT = {"deformation": "film", "base": 3e4}
ARM = {"lever_arm": (0.2, 0.3, -0.4), "mount": "imu"}
DRIFTED = {"drift": "strip", "time": 1.7}
TURNED = {"drift": "platform", "time": -1.3}
SHUTTER = {"shutter": "shutter", "velocity": (55.0, -20.0, 3.0), **DRIFTED}

TURNS_AND_ARM = ("rx", "ry", "rz", "x", "y", "z")
MOUNTED = dict(zip(TURNS_AND_ARM, (0.02, -0.03, 0.05, 0.1, -0.04, 0.07), strict=True))
"""Mount of an instrument, rad and metres."""


@dataclass(frozen=True)
class Stated:
    """An unknown of a kind that only examples have."""

    kind: str
    """Its kind."""
    name: str
    """Its name, to which observations refer."""
    values: tuple[float, ...]
    """Its true values, SI."""
    steps: tuple[float, ...]
    """Steps along its components for differences, or one for all of them."""


@dataclass(frozen=True)
class Example:
    """Observations of a kind between the points i, j, k, l, and of the photos f, g."""

    observations: Callable[[], list[o.Observation]]
    """Makes them."""
    unknowns: tuple[Stated, ...] = ()
    """What they need besides points and photos."""


MOVING = Stated("photo_motion", "f", (8.0, -3.0, 0.5, 0.2, -0.1, 0.3), (1.0,) * 3 + (0.1,) * 3)
"""Motion of the photo f, m/s and rad/s."""

ORBIT = Stated(
    "arc",
    "orbit",
    (900.0, 240.0, -300.0, -2.0, 7.0, 1.0, 5e4, 1e-2),
    (1.0,) * 3 + (0.1,) * 3 + (1e3, 1e-3),
)
"""Arc of an orbit about a small body that turns: m, m/s, m³/s², rad/s."""

TRACK = Stated("point_motion", "track", (7.0, -4.0, 3.0, 0.4, 0.3, -0.2), (0.05,) * 3 + (0.01,) * 3)
"""Motion of a moving point, m/s and m/s²."""

EXAMPLES: dict[str, Example] = {
    "photo_on_arc": Example(
        lambda: [
            o.PhotoOnArc("f", "orbit", covariance=COVARIANCE, time=-31.0),
            o.PhotoOnArc("g", "orbit", (0.1, 0.0, 0.2), sigma=(1.0, 2.0, 3.0), time=-12.0),
            o.PhotoOnArc("f", "orbit", sigma=(1.0, 2.0, 3.0), time=0.0),
            o.PhotoOnArc("g", "orbit", sigma=(1.0, 2.0, 3.0), time=29.0),
        ],
        (ORBIT,),
    ),
    "ellipsoid_distance": Example(
        lambda: [
            o.EllipsoidDistance("i", "j", 1.0, sigma=0.01, station_surface=31.0, target_surface=30),
            o.EllipsoidDistance("i", "k", 1.0, sigma=0.01, line="chord", station_surface=-7.0),
        ]
    ),
    "mean_height_distance": Example(lambda: [o.MeanHeightDistance("i", "k", 1.0, **SIGHT)]),
    "geodetic_azimuth": Example(lambda: [o.GeodeticAzimuth("i", "j", 0.0, **SIGHT)]),
    "ellipsoid_height": Example(lambda: [o.EllipsoidHeight("j", 0.0, sigma=0.01, surface=31.0)]),
    "ellipsoid_height_difference": Example(
        lambda: [
            o.EllipsoidHeightDifference(
                "i", "j", 0.0, station_surface=31.0, target_surface=30.0, **SIGHT
            )
        ]
    ),
    "photo_shift": Example(
        lambda: [
            o.PhotoShift("f", "f", "g", (0.0, 0.0, 0.0), covariance=COVARIANCE, interval=2.5),
            o.PhotoShift("f", "g", "f", (0.1, 0.0, 0.2), sigma=(1.0, 2.0, 3.0), interval=1.5),
        ],
        (MOVING,),
    ),
    "photo_turn": Example(
        lambda: [
            o.PhotoTurn("f", "f", "g", (0.0, 0.0, 0.0), covariance=COVARIANCE, interval=2.5),
            o.PhotoTurn("f", "g", "f", (0.1, 0.0, 0.2), sigma=(1.0, 2.0, 3.0), interval=1.5),
        ]
    ),
    "moved_point": Example(
        lambda: [
            o.MovedPoint("i", "j", covariance=COVARIANCE, motion="track", time=1.7, gravity=9.81),
            o.MovedPoint("i", "k", sigma=(1.0, 2.0, 3.0), motion="track", time=-2.3),
        ],
        (TRACK,),
    ),
    "radar_range": Example(
        lambda: [o.RadarRange("i", "k", 1.0, sigma=0.1, motion="track", time=-1.2)]
    ),
    "radar_squint": Example(
        lambda: [o.RadarSquint("i", "l", 0.0, sigma=0.01, motion="track", time=0.7)]
    ),
    "body_vector": Example(
        lambda: [
            o.BodyVector("f", "j", (0.0, 0.0, 0.0), covariance=COVARIANCE),
            o.BodyVector("g", "k", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0)),
        ]
    ),
}
"""An example of each kind that no other network of the tests states. A kind in frames of its own,
or with parameters of `OBSERVED`, has its line there, in `everything` and in `random_more`."""

OBSERVED: dict[str, Callable[[], list[o.Observation]]] = {
    "slope_distance": lambda: [o.SlopeDistance("i", "j", 1.0, instrument="edm", **SIGHT)],
    "horizontal_distance": lambda: [o.HorizontalDistance("i", "j", 1.0, instrument="edm", **SIGHT)],
    "vertical_angle": lambda: [o.VerticalAngle("i", "j", 0.0, refraction="ray", **SIGHT)],
    "zenith_angle": lambda: [
        o.ZenithAngle("i", "j", 1.6, refraction="ray", **SIGHT),
        o.ZenithAngle("i", "j", 1.6, refraction="ray", index_error="circle", **SIGHT),
        o.ZenithAngle("i", "j", 4.7, face=2, refraction="ray", index_error="circle", **SIGHT),
    ],
    "direction": lambda: [
        o.Direction("i", "j", 0.0, **SIGHT),
        o.Direction("i", "k", 0.0, collimation_error="telescope", **SIGHT),
        o.Direction("i", "k", 3.0, face=2, collimation_error="telescope", **SIGHT),
    ],
    "azimuth": lambda: [o.Azimuth("i", "j", 0.0, **SIGHT)],
    "horizontal_angle": lambda: [
        o.HorizontalAngle("i", "j", "k", 0.0, target2_height=1.7, **SIGHT)
    ],
    "height_difference": lambda: [o.HeightDifference("i", "j", 0.0, **SIGHT)],
    "astronomic_latitude": lambda: [o.AstronomicLatitude("i", 0.0, sigma=1e-6)],
    "astronomic_longitude": lambda: [o.AstronomicLongitude("i", 0.0, sigma=1e-6)],
    "gnss_vector": lambda: [
        o.GnssVector("i", "j", (0.0, 0.0, 0.0), covariance=COVARIANCE, **HEIGHTS),
        o.GnssVector("j", "k", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0), **HEIGHTS),
    ],
    "control": lambda: [
        o.ControlPoint("i", (0.0, 0.0), axes="xz", sigma=(0.1, 0.2)),
        o.ControlPoint("j", (4e6, 1e6, 4e6), axes="un", sigma=(0.1, 0.2)),
    ],
    "gnss_position": lambda: [o.GnssPosition("k", (0.0, 0.0, 0.0), covariance=COVARIANCE)],
    "photo_position": lambda: [
        o.PhotoPosition("f", (0.0, 0.0, 0.0), covariance=COVARIANCE, lever_arm=(0.1, -0.4, 0.7)),
        o.PhotoPosition("f", (0.0, 0.0), axes="zx", sigma=(1.0, 2.0), **ARM, **DRIFTED),
        o.PhotoPosition("f", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0), **SHUTTER),
    ],
    "relative_rotation": lambda: [
        o.RelativeRotation("f", "g", (0.0, 0.0, 0.0), covariance=COVARIANCE, mount="imu"),
        o.RelativeRotation("g", "f", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0)),
    ],
    "relative_position": lambda: [
        o.RelativePosition("f", "g", (0.0, 0.0, 0.0), covariance=COVARIANCE, mount="imu"),
        o.RelativePosition("g", "f", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0), instrument="edm"),
    ],
    "photo_attitude": lambda: [
        o.PhotoAttitude("f", (0.0, 0.0, 0.0), covariance=COVARIANCE),
        o.PhotoAttitude("f", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0), mount="imu", **TURNED),
        o.PhotoAttitude("f", (0.0, 0.0, 0.0), covariance=COVARIANCE, about="body", **TURNED),
    ],
    "navigation_attitude": lambda: [
        o.NavigationAttitude("f", (0.0, 0.0, 0.0), covariance=COVARIANCE, mount="imu"),
        o.NavigationAttitude("f", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0), mount="imu", **TURNED),
        o.NavigationAttitude("f", (0.0,) * 3, covariance=COVARIANCE, about="body", **TURNED),
    ],
    "photo_angle": lambda: [
        *(o.PhotoAngle("f", 0.0, angle=a, sigma=0.01, mount="imu") for a in ANGLES),
        o.PhotoAngle("f", 0.0, angle="heading", sigma=0.01),
    ],
    "photo_range": lambda: [
        o.PhotoRange("i", "f", 0.0, sigma=0.1, instrument="edm", **ARM),
        o.PhotoRange("i", "f", 0.0, sigma=0.1),
    ],
    "photo_base": lambda: [o.PhotoBase("f", "g", 0.0, sigma=0.1, instrument="edm", **ARM)],
    "antenna_vector": lambda: [o.AntennaVector("f", (0.0, 0.0, 0.0), covariance=COVARIANCE, **ARM)],
    "frame_coordinate": lambda: [
        o.FrameCoordinate("body", "j", (0.0, 0.0, 0.0), covariance=COVARIANCE),
        o.FrameCoordinate("body", "k", (0.0, 0.0), axes="zx", sigma=(1.0, 2.0)),
        o.FrameCoordinate("tripod", "j", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0)),
        o.FrameCoordinate("slanted", "k", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0)),
        o.FrameCoordinate("body", "j", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0), **BENT),
        o.FrameCoordinate("tripod", "k", (0.0, 0.0), axes="yx", sigma=(1.0, 2.0), **BENT),
    ],
    "frame_vector": lambda: [
        o.FrameVector("body", "i", "j", (0.0, 0.0, 0.0), covariance=COVARIANCE),
        o.FrameVector("tripod", "j", "k", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0)),
        o.FrameVector("slanted", "k", "i", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0)),
    ],
    "strip_coordinate": lambda: [
        o.StripCoordinate("fourth", "j", (0.0, 0.0, 0.0), covariance=COVARIANCE, **PLACE),
        o.StripCoordinate("fourth", "k", (0.0, 0.0), axes="zx", sigma=(1.0, 2.0), **PLACE),
        o.StripCoordinate("first", "k", (0.0, 0.0, 0.0), sigma=(1.0, 2.0, 3.0), **PLACE),
    ],
    **{
        cls.kind: lambda cls=cls: [  # type: ignore[misc]
            cls("body", "j", sigma=0.01),
            cls("tripod", "k", sigma=0.02),
            cls("slanted", "j", sigma=0.02),
        ]
        for cls in (o.OnPlane, o.OnLine, o.OnCylinder, o.OnSphere, o.OnCone, o.OnTorus)
    },
    "on_paraboloid": lambda: [o.OnParaboloid("body", "j", sigma=0.01)],
    "on_circle": lambda: [
        o.OnCircle("body", "j", sigma=(0.01, 0.02)),
        o.OnCircle("tripod", "k", covariance=COVARIANCE[:2, :2], height="tripod"),
    ],
    "equal_distance": lambda: [
        o.EqualDistance("i", "j", "j", "k", sigma=0.01),
        o.EqualDistance("i", "j", "k", "l", sigma=0.01, ratio=0.7),
    ],
    "equal_height_difference": lambda: [
        o.EqualHeightDifference("i", "j", "j", "k", sigma=0.01, ratio=0.7),
        o.EqualHeightDifference("i", "j", "k", "l", sigma=0.01),
    ],
    "right_angle": lambda: [o.RightAngle("i", "j", "k", sigma=1e-4)],
    "point_direction": lambda: [o.PointDirection("i", "j", 0.3, -2.0, 0.4, sigma=1e-4)],
    "coordinate_difference": lambda: [
        o.CoordinateDifference("i", "j", (0.0, 0.0), axes="zx", sigma=0.01),
        o.CoordinateDifference("i", "j", (0.0, 0.0, 0.0), horizon=True, covariance=COVARIANCE),
    ],
    "parallel_axes": lambda: [
        o.ParallelAxes("body", "turned", sigma=1e-4),
        o.ParallelAxes("turned", "slanted", covariance=SMALL_ANGLES),
    ],
    "axis_angle": lambda: [
        o.AxisAngle("tripod", "turned", sigma=1e-4),
        o.AxisAngle("turned", "body", 0.2, sigma=1e-4),
    ],
    "plane_distance": lambda: [
        o.PlaneDistance("body", "tripod", 1.0, sigma=0.01),
        o.PlaneDistance("tripod", "turned", 0.0, sigma=0.01),
    ],
    "image_line": lambda: [
        o.ImageLine("f", "edge", 5.0, 3.0, sigma=0.01),
        o.ImageLine("f", "edge", -2.0, 0.3, sigma=0.01),
    ],
    "image_through_level": lambda: [
        o.ImageThroughLevel("f", "j", (0.0, 0.0), sigma=0.01, level="surface", medium="water"),
        o.ImageThroughLevel(
            *("g", "k", (0.0, 0.0)),
            covariance=COVARIANCE[:2, :2],
            level="surface",
            medium="water",
            geoid=3.0,
        ),
    ],
    "image_through_plane": lambda: [
        o.ImageThroughPlane("f", p, (0.0, 0.0), sigma=0.01, plane=f, medium="water")
        for p, f in (("j", "body"), ("k", "tripod"), ("i", "slanted"))
    ],
    "image_through_port": lambda: [
        o.ImageThroughPort("f", "j", (0.0, 0.0), sigma=0.01, port="window", medium="water"),
        o.ImageThroughPort("g", "k", (0.0, 0.0), sigma=(1, 2), port="window", medium="glycerol"),
    ],
    "plane_offset": lambda: [o.PlaneOffset(f, "j", 0.0, sigma=0.01) for f in SORTS_OF_FRAMES],
    "plumb_offset": lambda: [
        *(o.PlumbOffset(f, "k", 1.0, sigma=0.01) for f in SORTS_OF_FRAMES[:-1]),
        o.PlumbOffset("leaning", "j", 1.0, sigma=0.01),
    ],
    "line_offset": lambda: [o.LineOffset("k", "i", "j", 1.0, sigma=0.01)],
    "sight_plane_offset": lambda: [o.SightPlaneOffset("i", "k", 0.0, horizontal=0.7, **SIGHT)],
    "sight_offset": lambda: [o.SightOffset("i", "k", 1.0, horizontal=2.5, zenith=1.4, **SIGHT)],
    "radial_offset": lambda: [
        o.RadialOffset(
            "j", 0.0, bearing=0.9, reference_x=4e6, reference_y=1e6, reference_z=4e6, sigma=0.01
        )
    ],
    "hydrostatic_reading": lambda: [
        o.HydrostaticReading("i", "water", 0.1, sigma=0.01),
        o.HydrostaticReading("j", "water", 0.1, mount="cup", sigma=0.01, undulation=0.02),
        o.HydrostaticReading("k", "water", 0.1, mount="cup", sigma=0.01, side=-1, expansion=0.01),
    ],
    "wire_reading": lambda: (
        [
            o.WireReading(f, "j", (0.0, 0.0), mount="cup", sigma=(1.0, 2.0), **WIRE)
            for f in SORTS_OF_FRAMES
        ]
        + [o.WireReading("body", "k", (0.0,), axes="z", sigma=(2.0,), **WIRE)]
    ),
    "wire_reading_on_body": lambda: [
        o.WireReadingOnBody(
            wire, "k", (0.0, 0.0), body=body, mount="cup", covariance=COVARIANCE[:2, :2], **WIRE
        )
        # Wire and body have the same rotation, nearly: no wire lies in the plane of its sensor.
        for wire, body in (
            ("tripod", "leaning"),
            ("leaning", "tripod"),
            ("body", "slanted"),
            ("slanted", "body"),
        )
    ],
    "frame_inclination": lambda: [
        o.FrameInclination(f, "j", 0.0, mount="cup", sigma=1e-6) for f in SORTS_OF_FRAMES
    ],
    "frame_roll": lambda: [
        o.FrameRoll(f, "j", 0.0, mount="cup", sigma=1e-6) for f in SORTS_OF_FRAMES
    ],
    "unit_vector": lambda: [
        o.UnitVector(f, "k", "j", (0.0, 0.0), mount="cup", covariance=SMALL_ANGLES)
        for f in SORTS_OF_FRAMES
    ],
    "frame_direction": lambda: [
        o.FrameDirection("body", "j", 0.0, sigma=0.01),
        o.FrameDirection("tripod", "j", 0.0, collimation_error="telescope", sigma=0.01),
        o.FrameDirection("slanted", "k", 3, collimation_error="telescope", sigma=0.01, face=2),
    ],
    "frame_zenith": lambda: [
        o.FrameZenith("body", "j", 1.0, sigma=0.01),
        o.FrameZenith("tripod", "j", 1.0, index_error="circle", sigma=0.01),
        o.FrameZenith("slanted", "k", 5.0, index_error="circle", sigma=0.01, face=2),
    ],
    "frame_distance": lambda: [
        o.FrameDistance("body", "j", 1.0, sigma=0.01),
        o.FrameDistance("tripod", "j", 1.0, instrument="edm", sigma=0.01),
        o.FrameDistance("slanted", "k", 1.0, instrument="edm", sigma=0.01),
    ],
    "profile_height": lambda: [
        o.ProfileHeight("j", 300.0, sigma=0.3, profile="flight", time=-1.7),
        o.ProfileHeight("k", 300.0, sigma=0.3),
        o.ProfileHeight(None, 20.0, photo="f", sigma=0.3, profile="flight", time=0.7, **ARM),
    ],
    "level_height": lambda: [
        o.LevelHeight("j", "lake", sigma=0.1, slope=1e-3, along=200.0, geoid=0.03)
    ],
    "photo_tilt": lambda: [
        o.PhotoTilt("f", (0.0, 0.0), covariance=COVARIANCE[:2, :2], mount="imu"),
        o.PhotoTilt("f", (0.0,), axes="y", sigma=(0.1,)),
    ],
    "photo_sight": lambda: [
        o.PhotoSight("f", BODY, SEEN, covariance=COVARIANCE[:2, :2], mount="imu"),
        o.PhotoSight("f", BODY, SEEN, axes="y", sigma=(0.1,)),
    ],
    "planar_vector": lambda: [
        o.PlanarVector("i", "j", (0.0, 0.0), covariance=COVARIANCE[:2, :2]),
        o.PlanarVector("j", "k", (0.0, 0.0), sigma=(1.0, 2.0)),
    ],
    "heading_difference": lambda: [o.HeadingDifference("i", "j", 0.0, sigma=0.1)],
    "gyro_azimuth": lambda: [o.GyroAzimuth("i", "j", 0.0, gyro="gyro", **SIGHT)],
    "fiducial_mark": lambda: [
        o.FiducialMark("scan", "1", (0, 0), film_x=11.0, film_y=9.0, sigma=(0.1, 0.2)),
        o.FiducialMark("scan", "2", (0, 0), film_x=-8.0, film_y=3.0, covariance=COVARIANCE[:2, :2]),
    ],
}
"""Observations of each kind between the points i, j, k, l, of frames, and of the photos f, g."""
OBSERVED |= {kind: example.observations for kind, example in EXAMPLES.items()}


def add_unknowns(
    network: Network,
    *,
    sigma: float | None = None,
    photos: Mapping[str, str] | None = None,
) -> dict[str, tuple[float, ...]]:
    """State the unknowns of `EXAMPLES`, free or weighted; return steps by kind.

    Args:
        network: gets the unknowns; those of photos that it does not have are left out.
        sigma: standard deviation of all components; None: they are free.
        photos: names of the photos in the network; None: their own.
    """
    stated = [x for example in EXAMPLES.values() for x in example.unknowns]
    for x in stated:
        name = (photos or {}).get(x.name, x.name) if UNKNOWNS[x.kind].in_photo else x.name
        if UNKNOWNS[x.kind].in_photo:
            if name not in network.photos:
                continue
            _give_readout(network, network.photos[name].camera)
        network.set_unknown(x.kind, name, x.values, sigma=sigma)
    return {x.kind: x.steps for x in stated}


def _give_readout(network: Network, name: str) -> None:
    """Give a camera a rolling shutter, and a format if it has none."""
    camera = network.cameras[name]
    if camera.times() is None:
        c = abs(camera.values[0])
        network.cameras[name] = replace(
            camera, format=camera.format or (1.3 * c, c), readout=READOUT
        )


def add_examples(network: Network, points: Sequence[str], photos: Sequence[str] = ()) -> None:
    """Add `EXAMPLES` to a network with other points and photos than i, j, k, l and f, g.

    Args:
        network: gets the unknowns of the examples and their observations.
        points: names for i, j, k and l; kinds of more points are left out.
        photos: names for f and g, likewise.
    """
    called = dict(zip("ijkl", points, strict=False)) | dict(zip("fg", photos, strict=False))
    add_unknowns(network, photos=called)
    for example in EXAMPLES.values():
        added = 0
        for x in (whole := example.observations()):
            own = [a for k, a in KINDS[x.kind].parameters if UNKNOWNS[k].in_photo]
            named = {a: getattr(x, a) for a in (*KINDS[x.kind].named, *own)}
            if set(named.values()) <= {*called, None}:
                there = {a: name and called[name] for a, name in named.items()}
                network.add(replace(x, **there))
                added += 1
        for x in example.unknowns:
            if added < len(whole) and not UNKNOWNS[x.kind].in_photo:
                # Fewer observations than the example has do not determine its unknowns.
                network.set_unknown(x.kind, x.name, x.values, fixed=True)


_GRS80 = ellipsoid("GRS80")


def _geocentric(latitude: float, longitude: float, height: float = 300.0) -> Array:
    at = (np.radians([latitude]), np.radians([longitude]), np.array([height]))
    return np.asarray(_GRS80.to_cartesian(*at)[0])


FRAMES: dict[str, tuple[Frame, Array]] = {
    "flat": (LocalFrame(), np.array([12.0, -35.0, 110.0])),
    "left-handed": (LocalFrame(axes="ne"), np.array([12.0, -35.0, 110.0])),
    "curved": (
        LocalFrame(curvature=True, origin=(100.0, 200.0, 0.0)),
        np.array([5012.0, -3035.0, 110.0]),
    ),
    "curved, axes south and east": (
        LocalFrame(curvature=True, axes="se"),
        np.array([-812.0, 435.0, 110.0]),
    ),
    "geocentric": (GeocentricFrame(), _geocentric(47.3, 11.2)),
    "geocentric, south and west": (GeocentricFrame(), _geocentric(-33.0, -70.5)),
    "geocentric, near a pole": (GeocentricFrame(), _geocentric(89.9, 40.0)),
    "geocentric, across 180°": (GeocentricFrame("International1924"), _geocentric(-20.0, 180.0)),
    "topocentric": (
        TopocentricFrame(np.radians(47.0), np.radians(11.0), 250.0),
        np.array([1500.0, 800.0, 60.0]),
    ),
}
"""Frames, each with the position of the station i."""


@dataclass(frozen=True)
class Geometry:
    """Where the targets are, seen from the station."""

    azimuth: float
    """Azimuth of j, degrees; k is 70° further."""
    elevation: float
    """Vertical angle of both, degrees."""
    length: float
    """Slope distance, metres."""

    @property
    def reach(self) -> float:
        """Horizontal part of the sight, metres."""
        return self.length * np.cos(np.radians(self.elevation))

    def offset(self, turn: float = 0.0) -> Array:
        """Return east, north, up, metres."""
        a, e = np.radians(self.azimuth + turn), np.radians(self.elevation)
        return self.length * np.array([np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e)])


GEOMETRIES: dict[str, Geometry] = {
    "ordinary": Geometry(35.0, 8.0, 150.0),
    "downhill to the south-west": Geometry(215.0, -12.0, 400.0),
    "due north": Geometry(0.0, 0.0, 100.0),
    "due south": Geometry(180.0, 1.0, 100.0),
    "short, 1 m": Geometry(120.0, 20.0, 1.0),
    "far, 100 km": Geometry(300.0, 0.3, 100_000.0),
    "steep, 89.9°": Geometry(75.0, 89.9, 200.0),
    "steep downwards, 89.9°, 5 m": Geometry(75.0, -89.9, 5.0),
}
"""Geometries of the sights."""


def sight_equations(frame_name: str, geometry: Geometry) -> tuple[Equations, Array]:
    """Return equations of every terrestrial kind, everything free, and a step for each column."""
    frame, station = FRAMES[frame_name]
    network = Network(frame_name, frame=frame)
    there = frame.basis(station[None], np.zeros((1, 2)))
    basis, cos_latitude = there.enu[0], float(there.cos_latitude[0])
    to_axis = cos_latitude * frame.radius
    network.add_point("i", station)
    # Heights of instrument and target cancel, so that near-degenerate sights stay so.
    lift = HEIGHTS["instrument_height"] - HEIGHTS["target_height"]
    for name, turn in (("j", 0.0), ("k", 70.0), ("l", 150.0)):
        offset = geometry.offset(turn) + np.array([0.0, 0.0, lift])
        network.add_point(name, station + basis.T @ offset)
    for n, name in enumerate("ijk"):
        network.set_vertical(name, xi=(12.0 - n) * ARCSEC, eta=(-9.0 + 2 * n) * ARCSEC)
    network.set_refraction("ray", value=0.17)
    network.set_distance_meter("edm", scale=3e-5, zero=0.02, free=("scale", "zero"))
    network.set_orientation("i", value=0.3)
    for name, azimuth in (("i", 0.7), ("j", 3.4)):
        network.set_unknown("heading", name, (azimuth,))
    network.set_unknown("index_error", "circle", (2e-4,))
    network.set_unknown("collimation_error", "telescope", (3e-4,))
    network.set_mount("cup", free=TURNS_AND_ARM, values=MOUNTED)
    network.set_size("sag", 0.004)
    network.set_level("water", 0.4)
    add_frames(network, tuple((station + geometry.length).tolist()))
    add_sizes(network, 0.3 * geometry.length)
    network.set_polynomial("fourth", plan=4, height=HEIGHT_TERMS[-1])
    network.set_polynomial("first", plan=1, height=("z", "z_y"))
    add_profile(network)
    network.set_level("lake", 110.0)
    network.set_gyro("gyro", 0.02)
    steps_of_examples = add_unknowns(network)
    for kind, make in OBSERVED.items():
        local = isinstance(frame, LocalFrame)
        if kind.startswith("astronomic") and local:
            continue
        for observation in make():
            if observation.photos():
                continue  # see `flight_equations`
            if local and isinstance(observation, o.ControlPoint) and observation.axes == "un":
                observation = o.ControlPoint("j", (1.0, 2.0, 3.0), axes="un", sigma=(0.1, 0.2))
            network.add(observation)
    equations = compile_network(network)
    steps = {
        "point": (0.01 * min(geometry.reach, to_axis),),
        # A deflection moves the line of sight, the instrument, and near a pole the azimuth.
        "vertical": (
            0.01 * cos_latitude * geometry.reach / (geometry.length + sum(HEIGHTS.values())),
        ),
        "orientation": (0.01,),
        "heading": (0.01,),
        "refraction": (0.1,),
        "edm": (1e-3, 1e-2),
        "index_error": (1e-3,),
        # Of a steep sight the reading changes by c/sin z.
        "collimation_error": (1e-3 * geometry.reach / geometry.length,),
        "mount": (1e-3,) * 3 + (1e-2 * geometry.length,) * 3,
        "polynomial": (1e-2,),
        "model_deformation": (1e-2,),
        # Directions in a frame change more where a target stands near its z axis.
        "frame": (1e-3,) * 3 + (1e-3 * geometry.length,) * 3 + (1e-3,),
        "size": (1e-3 * geometry.length,),
        "angle": (1e-3,),
        "level": (1.0,),
        "profile": (1.0, 1.0, 1.0, 1e-3),
        "gyro": (0.01,),
        **steps_of_examples,
    }
    return equations, _steps(equations, steps)


def flight_equations(frame_name: str, *, turned: float = 0.0) -> tuple[Equations, Array]:
    """Return equations of every kind of a photo flight, and a step for each column.

    Args:
        frame_name: name of a right-handed frame.
        turned: angle by which observed attitudes are wrong, radians.
    """
    frame, station = FRAMES[frame_name]
    network = Network(frame_name, frame=frame)
    basis = frame.basis(station[None], np.zeros((1, 2)))
    enu = basis.enu[0]
    network.add_camera("camera", lens.NoDistortion(), {"c": 28.4})
    network.add_point("i", station)
    for name, offset in (("j", (20.0, 60.0, 10.0)), ("k", (-30.0, 40.0, 5.0))):
        network.add_point(name, station + enu.T @ offset)
    for name, offset, angles in (("f", (40, 30, 900), (0.2, -0.4, 1.9)), ("g", (90, 35, 905), A2)):
        rotation = enu.T @ world_R_camera(*angles)
        network.add_photo(name, "camera", position=station + enu.T @ offset, rotation=rotation)
    add_flight(network)
    network.add_camera("film", FilmLens(pixel=0.5), FILM, free=tuple(FILM)[1:], per_photo=True)
    network.add_photo("scan", "film", position=station, rotation=enu.T)
    add_profile(network)
    network.set_distance_meter("edm", scale=3e-5, zero=0.02, free=("scale", "zero"))
    network.set_level("surface", float(heights(frame, station[None])[0][0]) + 100.0)
    add_media(network)
    steps_of_examples = add_unknowns(network)
    for make in OBSERVED.values():
        # Lines in images have equations of their own, see `line_equations`.
        for x in (x for x in make() if x.photos() and set(x.frames()) <= {*network.frames}):
            if isinstance(x, o.PhotoSight):  # far from opposite, where angles change fast
                x = replace(x, body=tuple((enu.T @ x.body).tolist()))
            network.add(x)
    equations = compile_network(network)
    equations = observed_at(equations, turned)
    # Near a pole the horizon turns fast.
    far = min(1.0, 0.01 * float(basis.cos_latitude[0]) * frame.radius)
    steps = {
        "point": (1.0,),
        "pose": (7e-3,) * 3 + (min(0.4, far),) * 3,
        "edm": (1e-3, 1e-2),
        "mount": (1e-2,) * 3 + (0.1,) * 3,
        "drift": (0.1,),
        "attitude_drift": (1e-2,),
        "shutter": (1e-2,),
        "calibration": (1.0, 0.1, 0.1, *(1e-3,) * 4, *(1e-4,) * 4),
        "profile": (1.0, 1.0, 1.0, 1e-3),
        "level": (1.0,),
        **MEDIA_STEPS,
        **steps_of_examples,
    }
    return equations, _steps(equations, steps)


MEDIA_STEPS = {
    "refractive_index": (5e-3,),
    "port": (1e-3, 1e-3, 1e-2, 1e-2, 5e-3),
}
"""Steps along what image rays pass."""
A2 = (0.1, 0.05, 1.7)
"""ω, φ, κ of a second photo."""


def add_media(network: Network) -> None:
    """State the refractive indices and the port of `OBSERVED`, everything free."""
    network.set_refractive_index("water", 1.34)
    network.set_refractive_index("glycerol", 1.47)
    free = UNKNOWNS["port"].names()
    network.set_port("window", distance=3.0, thickness=2.0, slopes=(0.03, -0.02), free=free)


def add_flight(network: Network) -> None:
    """State the mount, drifts and shutter of `OBSERVED`, everything free."""
    turns, offsets = ("rx", "ry", "rz"), ("x", "y", "z")
    network.set_mount(
        "imu",
        free=(*turns, *offsets),
        values=dict(zip((*turns, *offsets), (0.3, -0.5, 0.9, 0.4, -0.2, 1.1), strict=True)),
    )
    powers = tuple(a + p for p in ("", "_t", "_tt") for a in offsets)
    network.set_drift("strip", free=powers, values={"x": 0.3, "y_t": -0.2, "z_tt": 0.1})
    rates = (*turns, *(a + "_t" for a in turns))
    network.set_attitude_drift("platform", free=rates, values={"rx": 0.02, "ry_t": 0.03, "rz": 0.1})
    network.set_shutter("shutter", error=0.01)


def observed_at(equations: Equations, turned: float) -> Equations:
    """Return the equations with readings as computed; those of attitudes are turned by an angle."""
    frame, state = equations.network.frame, equations.unknowns.start()
    blocks = []
    for block in equations.blocks:
        v = block.evaluate(frame, state, jacobians=False).residual
        block = replace(block, observed=block.moved(v))
        if block.composed is not None:
            by = turned * np.array([0.48, -0.6, 0.64])
            block = replace(block, observed=block.moved(np.tile(by, (block.n, 1))))
        blocks.append(block)
    return replace(equations, blocks=tuple(blocks))


def add_frames(network: Network, origin: tuple[float, float, float], *, size: float = 20.0) -> None:
    """Add a frame with a constant origin and, at the point i if there is one, two others.

    A deformation is added too. Shifts and deformations are parts of ``size``, metres.
    """
    every = ("rx", "ry", "rz", "x", "y", "z", "ln_scale")
    shift = (0.15 * size, -0.25 * size, 0.1 * size)
    values = dict(zip(every, (0.4, -0.7, 1.1, *shift, 0.2), strict=True))
    network.add_frame("body", free=every, values=values, origin=origin)
    bends = size * np.linspace(-0.1, 0.15, len(DEFORMATIONS))
    bent = dict(zip(DEFORMATIONS, bends.tolist(), strict=True))
    network.set_model_deformation("film", free=DEFORMATIONS, values=bent)
    if "i" in network.points:
        network.add_frame("tripod", free=every, values=values, origin="i", level=True)
        network.add_frame("slanted", free=every, values=values, origin="i")
        network.add_frame("leaning", free=every, values=values, origin=origin, level=True)


def add_sizes(network: Network, size: float) -> None:
    """Add the sizes of shapes in the frames, and a frame across them."""
    for name in ("body", "tripod", "slanted"):
        network.set_size(name, size)
        network.set_size(f"{name} ring", 0.3 * size)
        network.set_unknown("angle", name, (0.4,))
    frame = network.frames["body"]
    names = ("rx", "ry", "rz", "x", "y", "z")
    turned = dict(zip(names, (1.4, 0.2, 0.3, 0.4, 0.7, 0.1), strict=True))
    free = (*turned, "ln_scale")
    network.add_frame("turned", free=free, values=turned, origin=frame.constants[:3], level=True)


def add_profile(network: Network) -> None:
    """Add a height profile of which everything is free."""
    every = ("height", "height_t", "height_tt", "scale")
    values = dict(zip(every, (3.0, -0.4, 0.2, 0.01), strict=True))
    network.set_profile("flight", free=every, values=values)


def _steps(equations: Equations, by_kind: dict[str, tuple[float, ...]]) -> Array:
    out = np.zeros(equations.unknowns.n_columns)
    for kind, number in equations.unknowns.active():
        out[equations.unknowns.columns(kind, number)] = by_kind[kind]
    return out


@dataclass(frozen=True)
class Calibrated:
    """A lens model with values of its parameters."""

    lens: lens.Lens
    values: dict[str, float]
    longest: float = np.inf
    """Longest step along a parameter of the lens on which the image depends by a high power."""


_INTERIOR = {"c": 28.4, "x0": 0.11, "y0": -0.07}
_BROWN = {"k1": 2e-4, "k2": -3e-7, "k3": 1e-10, "p1": 2e-5, "p2": -3e-5}
_STRONG = {"k1": 1e-3, "k2": -8e-7, "k3": 3e-9, "p1": 4e-4, "p2": -2e-4}
_AFFINITY = {"b1": 3e-4, "b2": -2e-4}
_HARMONIC = dict(
    zip(lens.HarmonicLens().names[3:], np.linspace(-0.004, 0.005, 10).tolist(), strict=True)
)


FILM = _INTERIOR | {"m": 2e-3, "r": 0.2} | _AFFINITY
FILM |= {"h1": 1e-4, "h2": -2e-4, "g1": 3e-4, "g2": -1e-4}
"""Interior orientation of a photo on film."""
TABLE = FilmLens(
    0.5,
    (1.5, 4.0, 7.0, 18.0),
    ((0.02, 0.05, -0.03, -0.1), (0.03, 0.04, -0.05, -0.2), (0.0, 0.01, -0.02, -0.3)),
    ((0.01, -0.02, 0.03, 0.05),) * 2 + ((0.0, 0.03, 0.03, -0.05),),
    (0.4, 2.1, 4.5),
)
"""A lens with distortions along three directions, radial and tangential."""


def _orthogonal(model: OrthogonalLens, largest: float) -> Calibrated:
    """Return an orthogonal lens with parameters of both signs up to ``largest``, mm."""
    names = model.names[3:]
    values = np.linspace(-largest, 0.9 * largest, len(names))
    return Calibrated(model, _INTERIOR | dict(zip(names, values.tolist(), strict=True)))


LENSES_USED: dict[str, Calibrated] = {
    "pinhole": Calibrated(lens.NoDistortion(), _INTERIOR),
    "harmonic": Calibrated(lens.HarmonicLens(reference_radius=10.0), _INTERIOR | _HARMONIC),
    "brown": Calibrated(lens.BrownLens(), _INTERIOR | _BROWN | _AFFINITY),
    "brown, affinity after": Calibrated(
        lens.BrownLens(affine="after"), _INTERIOR | _BROWN | _AFFINITY
    ),
    "brown, ideal residuals": Calibrated(
        lens.BrownLens(residuals="ideal"), _INTERIOR | _STRONG | {"b1": 0.02, "b2": -0.03}
    ),
    "brown, strong": Calibrated(lens.BrownLens(), _INTERIOR | _STRONG | {"b1": 0.02, "b2": -0.03}),
    "brown, centred": Calibrated(
        CentredBrownLens(), _INTERIOR | _BROWN | {"b1": 0.6, "b2": -0.5, "xd": 0.4, "yd": -0.3}
    ),
    "brown forward": Calibrated(lens.BrownForwardLens(), _INTERIOR | _BROWN),
    "brown forward, strong": Calibrated(lens.BrownForwardLens(), _INTERIOR | _STRONG),
    "normalised": Calibrated(
        lens.NormalisedLens(),
        _INTERIOR | {"k1": -0.2, "k2": 0.08, "k3": -0.02, "p1": 2e-3, "p2": -1e-3},
    ),
    "normalised, affine": Calibrated(
        AffineNormalisedLens(),
        _INTERIOR
        | {"k1": -0.2, "k2": 0.08, "k3": -0.02, "k4": 0.01, "p1": 2e-3, "p2": -1e-3}
        | {"b1": 0.02, "b2": -0.03},
    ),
    "normalised, affinity before": Calibrated(
        FraserNormalisedLens(),
        _INTERIOR
        | {"k1": -0.2, "k2": 0.08, "k3": -0.02, "p1": 2e-3, "p2": -1e-3, "b1": 0.02, "b2": -0.03},
    ),
    "balanced": Calibrated(
        lens.BalancedLens(zero_radius=9.0),
        _INTERIOR
        | {"A1": -1e-4, "A2": 2e-7, "A3": -1e-10, "B1": 2e-5, "B2": 1e-5, "C1": 3e-4, "C2": 1e-4},
    ),
    "affine": Calibrated(lens.AffineLens(), _INTERIOR | _AFFINITY),
    "ebner": _orthogonal(EbnerLens(image_base=10.0), 0.02),
    "gruen": _orthogonal(GruenLens(image_base=10.0), 0.02),
    "rational": Calibrated(
        RationalLens(),
        _INTERIOR
        | {"k1": 0.3, "k2": -0.1, "k3": 0.02, "k4": 0.5, "k5": 0.1, "k6": 0.03}
        | {"p1": 2e-3, "p2": -1e-3, "b1": 0.02, "b2": -0.03},
    ),
    "grid": Calibrated(
        GridLens(
            lens.BrownForwardLens(),
            (-14.0, 0.0, 5.0, 14.0),
            (-10.0, 1.0, 10.0),
            ((0.01, -0.02, 0.01, 0.0), (0.02, 0.01, -0.01, 0.02), (0.0, 0.01, 0.02, -0.01)),
            ((-0.01, 0.01, 0.02, 0.01), (0.0, -0.02, 0.01, 0.0), (0.01, 0.02, 0.0, 0.01)),
        ),
        _INTERIOR | _BROWN,
    ),
    "grid with modes": Calibrated(
        GridLens(
            lens.BrownForwardLens(),
            (-14.0, 0.0, 5.0, 14.0),
            (-10.0, 1.0, 10.0),
            ((0.01, -0.02, 0.01, 0.0), (0.02, 0.01, -0.01, 0.02), (0.0, 0.01, 0.02, -0.01)),
            ((-0.01, 0.01, 0.02, 0.01), (0.0, -0.02, 0.01, 0.0), (0.01, 0.02, 0.0, 0.01)),
            ((0.9, 0.8, -0.3, 0.2) * 3, (0.5, -0.6, 0.4, -0.7, 0.1, 0.3) * 2),
        ),
        _INTERIOR | _BROWN | {"sx1": 0.01, "sx2": -0.02, "sy1": 0.015, "sy2": 0.01},
    ),
    "fisheye": Calibrated(
        ray_lens.FisheyeLens(),
        _INTERIOR
        | {"k1": 0.03, "k2": -0.01, "k3": 2e-3, "k4": -1e-4, "p1": 2e-3, "p2": -1e-3}
        | {"s1": 1e-3, "s2": -2e-3, "b1": 0.02, "b2": -0.03},
    ),
    "fov": Calibrated(ray_lens.FovLens(), _INTERIOR | {"w": 0.9} | _AFFINITY, 0.005),
    "fov, narrow": Calibrated(ray_lens.FovLens(), _INTERIOR | {"w": 0.005} | _AFFINITY, 1e-3),
    "division": Calibrated(ray_lens.DivisionLens(), _INTERIOR | {"k1": -0.2} | _AFFINITY),
    "eucm": Calibrated(ray_lens.UnifiedLens(), _INTERIOR | {"alpha": 0.6, "beta": 1.1} | _AFFINITY),
    "line": Calibrated(
        scanner_lens.LineLens(),
        _INTERIOR | {"k1": 2e-4, "k2": -3e-7, "t1": 3e-3, "t2": -2e-4},
    ),
    "cylindrical": Calibrated(scanner_lens.CylindricalLens(), _INTERIOR),
    "equirectangular": Calibrated(ray_lens.EquirectangularLens(), _INTERIOR),
    "parallel": Calibrated(place_lens.ParallelLens(), _INTERIOR | _BROWN | _AFFINITY | {"c": 3.0}),
    "film": Calibrated(FilmLens(), FILM),
    "film, table": Calibrated(TABLE, FILM),
}
"""Lens models, image units mm."""
CENTRAL = [name for name, used in LENSES_USED.items() if used.lens.takes != "places"]
"""Those of a central projection, in which lines have planes."""


@dataclass(frozen=True)
class View:
    """Where the points lie in the image, and how far away."""

    at: tuple[tuple[float, float], ...]
    """Ideal image coordinates relative to the principal point, mm."""
    depth: float
    """Depth in front of the camera, metres."""


VIEWS: dict[str, View] = {
    "ordinary": View(((5.0, 3.0), (-7.0, 2.0), (4.0, -6.0)), 20.0),
    "corners": View(((12.0, 8.0), (-12.0, 8.0), (12.0, -8.0)), 20.0),
    "near the image centre": View(((0.01, 0.02), (-0.02, 0.005)), 20.0),
    "close, 0.5 m": View(((5.0, 3.0), (-7.0, 2.0)), 0.5),
    "far, 100 km": View(((5.0, 3.0), (-7.0, 2.0)), 100_000.0),
    "90° across": View(((28.0, 3.0), (-7.0, 27.0)), 20.0),
}
"""Views of points."""


def image_equations(lens_name: str, view: View) -> tuple[Equations, Array]:
    """Return image coordinates with everything free, and a step for each column."""
    camera = LENSES_USED[lens_name]
    network = Network(lens_name)
    network.add_camera("camera", camera.lens, camera.values, free=camera.lens.names)
    rotation, centre = world_R_camera(0.2, -0.4, 1.9), np.array([30.0, -12.0, 8.0])
    network.add_photo("f", "camera", position=centre, rotation=rotation)
    c = camera.values["c"]
    seen = []
    for n, (x, y) in enumerate(view.at):
        ray = np.array([x / c, -y / c, 1.0])
        network.add_point(f"P{n}", centre + rotation @ (view.depth * ray))
        seen.append((x + camera.values["x0"], y + camera.values["y0"]))
    network.add_image_points("f", list(network.points), np.array(seen), sigma=0.005)
    # Frames, deformations and their bases are as long as the view: so are the steps of the photo.
    beside = centre + view.depth * np.array([-0.25, 0.1, -0.15])
    add_frames(network, tuple(beside.tolist()), size=view.depth)
    for more in ({}, {"deformation": "film", "base": view.depth}):
        at = (0.0, 0.0, 0.0)
        network.add(o.FrameCoordinate("body", None, at, photo="f", covariance=COVARIANCE, **more))
    equations = compile_network(network)
    steps = _image_steps(equations, camera, view, share_of_radius(camera.lens))
    return equations, _steps(equations, steps)


def share_of_radius(used: lens.Lens) -> float:
    """Return by which share of the image radius steps along a lens's parameters move its points.

    Measured coordinates follow from corrections by an inverse, with strong curvature.
    """
    return 0.0002 if getattr(used, "residuals", "") == "measured" else 0.005


def moving_image_equations(
    lens_name: str, towards: Towards, powers: int = 1
) -> tuple[Equations, Array]:
    """Return image coordinates of a photo that moves as it is read, and a step for each column."""
    view = VIEWS["ordinary"]
    network = image_equations(lens_name, view)[0].network.copy()
    give_motion(network, towards, powers)
    equations = compile_network(network)
    camera = LENSES_USED[lens_name]
    steps = _image_steps(equations, camera, view, share_of_radius(camera.lens))
    pose = np.array(steps["pose"])
    # At the edges of the image the motion moves the pose by half the readout time as much.
    steps["photo_motion"] = _motion_steps(np.roll(pose, 3), powers)
    return equations, _steps(equations, steps)


def _image_steps(
    equations: Equations, camera: Calibrated, view: View, share: float
) -> dict[str, tuple[float, ...]]:
    """Return steps by kind; along the parameters of a lens what moves an image point by a share."""
    c = camera.values["c"]
    radius = min(np.hypot(x, y) for x, y in view.at)
    ray = min(radius / c, 0.25)
    block = next(b for b in equations.blocks if b.kind == "image")
    frame = equations.network.frame
    by_lens = np.abs(block.evaluate(frame, equations.unknowns.start()).jacobians[1])
    largest = by_lens.max(axis=(0, 1))
    return {
        "point": (0.01 * view.depth * ray,),
        "pose": (0.01 * ray,) * 3 + (0.01 * view.depth * ray,) * 3,
        "frame": (1e-3,) * 3 + (1e-3 * view.depth,) * 3 + (1e-3,),
        "mount": (1e-3,) * 3 + (1e-2,) * 3,
        "edm": (1e-3, 1e-2),
        "model_deformation": (5e-4 * view.depth,),
        "calibration": (
            *(along := share * radius / np.where(largest > 0, largest, 1.0))[:3],
            *np.minimum(along[3:], camera.longest),
        ),
    }


def _motion_steps(first: Array, powers: int) -> tuple[float, ...]:
    """Return steps along a motion that move the pose at the edges of the image as ``first``."""
    half = READOUT / 2.0
    return tuple(np.concatenate([first / half**j for j in range(1, powers + 1)]).tolist())


def moving_line_equations(towards: Towards, powers: int = 1) -> tuple[Equations, Array]:
    """Return measured points of a line in an image that moves as it is read, and steps."""
    equations, steps = line_equations("brown", VIEWS["ordinary"])
    network = equations.network.copy()
    give_motion(network, towards, powers)
    moving = compile_network(network)
    here, there = equations.unknowns, moving.unknowns
    out = np.zeros(there.n_columns)
    for kind, table in here.tables.items():
        for name, number in table.number.items():
            if table.offset[number] >= 0:
                mine = there.columns(kind, there[kind].number[name])
                out[mine] = steps[here.columns(kind, number)]
    pose = there.columns("pose", there["pose"].number["f"])
    motion = there.columns("photo_motion", there["photo_motion"].number["f"])
    out[motion] = _motion_steps(np.roll(out[pose], 3), powers)
    return moving, out


READOUT = 0.03
"""Readout time of cameras whose photos move, seconds."""


def give_motion(network: Network, towards: Towards, powers: int = 1) -> None:
    """Give the photo f a motion that is free, and its camera a rolling shutter."""
    network.cameras["camera"] = replace(
        network.cameras["camera"], format=(36.0, 24.0), readout=READOUT, readout_towards=towards
    )
    motion = (9.0, -4.0, 2.0, 3.0, -2.0, 4.0)
    terms = [v / READOUT**j for j in range(powers) for v in motion]
    network.set_unknown("photo_motion", "f", terms)


def line_equations(lens_name: str, view: View) -> tuple[Equations, Array]:
    """Return measured points of a line in an image, everything free, and steps.

    The ideal coordinates of a measured point depend on the parameters of some lenses by an inverse,
    whose length of change is shorter than that of the lens.
    """
    network = image_equations(lens_name, view)[0].network.copy()
    camera, photo = LENSES_USED[lens_name], network.photos["f"]
    edge = {"rx": 0.3, "ry": 0.2, "rz": -0.1}
    edge |= dict.fromkeys("xyz", 0.1 * view.depth) | {"ln_scale": 0.1}
    middle = np.array(photo.position) + view.depth * photo.rotation @ [0.2, 0.1, 1.1]
    network.add_frame("edge", free=tuple(edge), values=edge, origin=middle.tolist())
    k = np.array([[camera.values.get(name, 0.0) for name in camera.lens.names]])
    xy = np.array(view.at[:2])
    tangents = xy / camera.values["c"]
    for _ in range(60):  # measured coordinates of ideal ones
        xy = xy + camera.lens.residual(*tangents.T, xy, k, jacobians=False)[0]
    for line, (x, y) in zip(OBSERVED["image_line"](), xy.tolist(), strict=True):
        network.add(replace(line, x=x, y=y))
    equations = compile_network(network)
    return equations, _steps(equations, _image_steps(equations, camera, view, 0.0002))

"""A photo flight over a lake, whose bottom is seen through the water; a camera in a housing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.frames import Frame
from factorgraph_adj.models.lens import BrownForwardLens
from factorgraph_adj.rotation import world_R_camera

FLYING_HEIGHT, SHORE = 80.0, 3.0
"""Heights of the photos and of the highest ground above the water, metres."""
C, PIXEL_SIGMA = 3650.0, 0.5
"""Principal distance and standard deviation of image points, px."""
FORMAT = (5472.0, 3648.0)
"""Sides of the image, px."""
HELD: Mapping[str, Any] = {"fixed": True}
INDEX = 1.337
"""Refractive index of the water."""


@dataclass(frozen=True)
class Flight:
    """A flight of crossing strips, and what is known of the water."""

    depth: float = 10.0
    """Largest depth, metres."""
    index: Mapping[str, Any] = field(default_factory=lambda: HELD)
    """How the index is stated."""
    level: Mapping[str, Any] = field(default_factory=lambda: HELD)
    """How the height of the lake is stated."""
    gauge: bool = False
    """Whether shore points are observed to be at the water's edge."""
    bottom_control: int = 0
    """Number of points, the deepest, with a known height."""
    frame: Frame | None = None
    """Frame, flat if none; the lake is at height 0 of its origin."""
    exposures: int = 4
    """Photos along each strip."""
    strips: int = 2
    """Strips in each direction."""


def ground(x: float, y: float, depth: float) -> float:
    """Return the height of the ground above the water, metres: a valley under water."""
    return SHORE - (SHORE + depth) * float(np.exp(-((x - 45.0) ** 2 + (y - 30.0) ** 2) / 40.0**2))


def lake(flight: Flight = Flight()) -> fga.Network:
    """Return the plan of a flight: points on a grid, those under water through the surface."""
    network = fga.Network("lake", frame=flight.frame)
    values = {"c": C, "k1": -2e-9}
    network.add_camera("drone", BrownForwardLens(), values, unit="px", format=FORMAT)
    base = 90.0 / max(flight.exposures - 1, 1)
    exposures = [
        (base * i, 60.0 * s, 1.5) for s in range(flight.strips) for i in range(flight.exposures)
    ]
    exposures += [
        (90.0 * s, 20.0 * i, 0.0) for s in range(flight.strips) for i in range(flight.exposures)
    ]
    for i, (x, y, kappa) in enumerate(exposures):
        angles = (0.1 * np.sin(i), 0.1 * np.cos(2 * i), kappa)
        at = (x, y, FLYING_HEIGHT + np.sin(3.0 * i))
        network.add_photo(f"F{i}", "drone", position=at, omega_phi_kappa=angles)
    under = []
    for i, x in enumerate(np.linspace(-15.0, 105.0, 9).tolist()):
        for j, y in enumerate(np.linspace(-15.0, 75.0, 7).tolist()):
            z = ground(x, y, flight.depth)
            corner = i in (0, 8) and j in (0, 6)
            name = f"{'W' if z < 0 else 'G'}{i}{j}"
            under += [name] if z < 0 else []
            network.add_point(name, (x, y, z), fixed="xyz" if corner else "")
    network.set_refractive_index("water", INDEX, **flight.index)
    network.set_level("lake", 0.0, **flight.level)
    for i in range(flight.bottom_control):
        name = sorted(under, key=lambda n: network.points[n].coordinates[2])[i]
        z = network.points[name].coordinates[2]
        network.add(o.ControlPoint(name, (z,), axes="z", sigma=(0.005,)))
    if flight.gauge:
        for i, (x, y) in enumerate(((-10.0, 30.0), (45.0, -12.0), (100.0, 30.0))):
            network.add_point(f"edge {i}", (x, y, 0.0))
            network.add(o.LevelHeight(f"edge {i}", "lake", sigma=0.02))
    see_all(network)
    network.refract_images(medium="water", level="lake", points=under)
    return network


def see_all(network: fga.Network, *, sigma: float = PIXEL_SIGMA) -> None:
    """Add an image point, not measured yet, of each point that a photo has in its format."""
    for photo in network.photos.values():
        camera = network.cameras[photo.camera]
        assert photo.rotation is not None
        assert camera.format is not None
        half = np.array(camera.format) / 2.0
        seen = []
        for name, point in network.points.items():
            p = photo.rotation.T @ (np.array(point.coordinates) - photo.position)
            inside = np.abs(camera.values[0] * p[:2] / p[2]) < 0.97 * half
            seen += [name] if p[2] > 0 and inside.all() else []
        network.add_image_points(photo.name, seen, np.zeros((len(seen), 2)), sigma=sigma)


def under_water(network: fga.Network) -> list[str]:
    """Return the names of the points under water."""
    return [name for name in network.points if name.startswith("W")]


def as_in_air(network: fga.Network) -> fga.Network:
    """Return a network whose image points under water are taken as seen in air."""
    out = network.copy()
    out.observations = {}
    media = ("port", "refractive_index")
    out.parameters = {k: v for k, v in network.parameters.items() if k not in media}
    for ident, x in network.observations.items():
        if isinstance(x, o.ImageThroughLevel | o.ImageThroughPort):
            (u, v), sigma = x.value, x.sigma
            assert sigma is not None
            out.add_image_points(x.photo, [x.point], np.array([[u, v]]), sigma=np.atleast_1d(sigma))
        else:
            out.observations[ident] = x
    return out


def housing(
    *,
    free: Sequence[str] = ("slope_x", "slope_y", "distance"),
    thickness: float = 0.01,
    index: Mapping[str, Any] = {},
    in_air: bool = False,
) -> fga.Network:
    """Return the plan of a calibration of a port: a frame of targets, near and far, from all sides.

    Args:
        free: free components of the port.
        thickness: of its glass, metres.
        index: how the index of the water is stated; None: free.
        in_air: whether some photos see the targets before the water comes, and without the port.
    """
    network = fga.Network("housing")
    values = {"c": 2800.0, "k1": -4e-9}
    network.add_camera("diver", BrownForwardLens(), values, unit="px", format=FORMAT)
    for i in range(6):
        for j in range(6):
            for k in range(3):
                name, known = f"T{i}{j}{k}", (i, j) in ((0, 0), (0, 5), (5, 0), (5, 5))
                at = (0.2 * i + 0.02 * k, 0.2 * j - 0.03 * k, 0.25 * ((i + 2 * j) % 3 == k) * k)
                network.add_point(name, at, fixed="xyz" if known else "")
    for i in range(10):
        angle = 2.0 * np.pi * i / 10
        away = 0.8 if i % 2 else 1.6
        tilt = 0.35 if i % 3 else 0.0
        at = np.array([0.5, 0.5, 0.0])
        rotation = world_R_camera(tilt * np.sin(angle), tilt * np.cos(angle), angle)
        at = at - away * rotation[:, 2]
        network.add_photo(f"D{i}", "diver", position=tuple(at), rotation=rotation)
    network.set_port("port", distance=0.06, thickness=thickness, slopes=(0.01, -0.02), free=free)
    network.set_refractive_index("water", 1.34, **index)
    see_all(network, sigma=0.3)
    photos = list(network.photos)
    network.refract_images(medium="water", port="port", photos=photos[2:] if in_air else photos)
    return network

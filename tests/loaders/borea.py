"""The aerial block of IGNF/Borea, test/data/dataset2 (MIT), commit 4a1d5a5b: UltraCam Eagle M3.

What was found about its data:

- Photos have altitudes, points and control have ellipsoidal heights. RAF20 is the geoid.
- The map is enlarged by m − 1 = 3·10⁻⁴. So that rays intersect in the map, the delivered Z of a
  photo has its height above the ground enlarged too: Z' = Z + (m − 1) (Z − Z_ground).
- ω, φ, κ count from the axes of the map: grid north, and the vertical at the photo.
- Rows of pixels count down.

`read_borea` sets all of it right and gives everything in one topocentric frame, where the
curvature of the Earth needs no correction.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.frames import TopocentricFrame
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.rotation import TURN_ABOUT_X, world_R_photogrammetric
from factorgraph_adj.types import Array
from tests.loaders import lambert_93

CAMERA = "UCE-M3"
PRINCIPAL_DISTANCE = 30975.0
PRINCIPAL_POINT = np.array([13210.0, 8502.0])
FORMAT = 26460.0, 17004.0
"""Pixels."""


@dataclass(frozen=True)
class Oriented:
    """A photo with its delivered orientation."""

    name: str
    position: Array
    """Projection centre, topocentric, metres."""
    rotation: Array
    """world_R_camera in the topocentric axes."""

    @property
    def strip(self) -> str:
        """Name of the strip."""
        return self.name[9:14]

    @property
    def number(self) -> int:
        """Number of the exposure, which serves as time."""
        return int(self.name[15:])


@dataclass(frozen=True)
class Block:
    """The block in a topocentric frame."""

    frame: TopocentricFrame
    photos: dict[str, Oriented]
    """Photos with rays, by name."""
    rays: dict[str, tuple[list[str], Array]]
    """Points and image coordinates (n, 2) by photo, pixels: x right, y up, from the principal
    point."""
    points: dict[str, Array]
    """Delivered points, topocentric, metres."""
    control: dict[str, Array]
    """Control points, topocentric, metres."""

    @cached_property
    def strips(self) -> dict[str, list[Oriented]]:
        """Photos of each strip in the order of their exposures."""
        out: dict[str, list[Oriented]] = {}
        for photo in sorted(self.photos.values(), key=lambda p: p.number):
            out.setdefault(photo.strip, []).append(photo)
        return dict(sorted(out.items()))

    @cached_property
    def seen(self) -> dict[str, int]:
        """Number of rays by point."""
        out: dict[str, int] = {}
        for names, _ in self.rays.values():
            for name in names:
                out[name] = out.get(name, 0) + 1
        return out

    def network(
        self,
        *,
        points: Iterable[str] | None = None,
        held: bool = False,
        sigma: float = 0.2,
        coordinates: bool = True,
        poses: bool = True,
    ) -> fga.Network:
        """Return photos, points and rays.

        Args:
            points: names of the points; None: all with two or more rays.
            held: whether the delivered orientation is held.
            sigma: standard deviation of image coordinates, pixels.
            coordinates: whether delivered points have their coordinates as start values.
            poses: whether photos have the delivered orientation as start values.
        """
        wanted = [n for n, k in self.seen.items() if k >= 2] if points is None else list(points)
        network = fga.Network("IGN block", frame=self.frame)
        network.add_camera(
            CAMERA, NoDistortion(), {"c": PRINCIPAL_DISTANCE}, unit="px", format=FORMAT
        )
        for p in self.photos.values():
            given = {"position": p.position, "rotation": p.rotation} if poses else {}
            network.add_photo(p.name, CAMERA, **given, fixed=held)
        here = self.points if coordinates else {}
        for name in wanted:
            network.add_point(name, here.get(name))
        known = set(wanted)
        for photo, (names, xy) in self.rays.items():
            rows = [i for i, n in enumerate(names) if n in known]
            network.add_image_points(photo, [names[i] for i in rows], xy[rows], sigma=sigma)
        return network


def map_plane(folder: Path) -> fga.Network:
    """Return photos, points and rays in the map as delivered, everything held; heights: altitudes.

    The delivered Z of photos has the scale of the map, see this module.
    """
    rays = _rays(folder)
    geoid = Geoid(folder / "fr_ign_RAF20.tif")
    points = {
        r[0]: np.array(r[1:4], dtype=float) for r in _rows(folder / "all_liaisons2_world.mes")
    }
    for r in _rows(folder / "23FD1305_Biais2.app"):
        points[r[0].strip('"')] = np.array(r[2:5], dtype=float)
    network = fga.Network("IGN block in the map")
    network.add_camera(CAMERA, NoDistortion(), {"c": PRINCIPAL_DISTANCE}, unit="px", format=FORMAT)
    for r in _rows(folder / "23FD1305_alt_2.OPK"):
        if r[0] in rays:
            turns = np.radians(np.array(r[4:7], dtype=float))
            turn = world_R_photogrammetric(*turns) @ TURN_ABOUT_X
            at = np.array(r[1:4], dtype=float)
            network.add_photo(r[0], CAMERA, position=at, rotation=turn, fixed=True)
    for name, at in points.items():
        latitude, longitude = lambert_93.from_grid(at[None, 0], at[None, 1])
        altitude = at[2] - float(geoid(latitude, longitude)[0])
        network.add_point(name, (at[0], at[1], altitude), fixed="xyz")
    for photo in network.photos:
        names, xy = rays[photo]
        rows = [i for i, n in enumerate(names) if n in points]
        network.add_image_points(photo, [names[i] for i in rows], xy[rows], sigma=0.2)
    return network


def read_borea(folder: Path, *, projection_scale: bool = True) -> Block:
    """Read the block.

    Args:
        folder: the data set.
        projection_scale: whether the scale of the projection is taken out of Z of the photos.
    """
    geoid = Geoid(folder / "fr_ign_RAF20.tif")
    rays = _rays(folder)
    control = {
        r[0].strip('"'): np.array(r[2:5], dtype=float)
        for r in _rows(folder / "23FD1305_Biais2.app")
    }
    points = {
        r[0]: np.array(r[1:4], dtype=float) for r in _rows(folder / "all_liaisons2_world.mes")
    }
    opk = [r for r in _rows(folder / "23FD1305_alt_2.OPK") if r[0] in rays]
    middle = np.mean(list(points.values()), axis=0)
    latitude, longitude = (a[0] for a in lambert_93.from_grid(middle[None, 0], middle[None, 1]))
    frame = TopocentricFrame(float(latitude), float(longitude), float(middle[2]))
    ground = float(middle[2] - geoid(np.array([latitude]), np.array([longitude]))[0])
    return Block(
        frame,
        _photos(opk, frame, geoid, ground if projection_scale else None),
        rays,
        _topocentric(points, frame),
        _topocentric(control, frame),
    )


class Geoid:
    """RAF20: heights of the geoid above the ellipsoid in a grid of latitude and longitude."""

    def __init__(self, file: Path) -> None:
        from PIL import Image

        with Image.open(file) as image:
            tags = image.tag_v2  # type: ignore[attr-defined]
            self.heights = np.array(image, dtype=float)
            self.step = tags[33550][0], tags[33550][1]
            self.corner = tags[33922][3], tags[33922][4]

    def __call__(self, latitude: Array, longitude: Array) -> Array:
        """Return bilinearly interpolated heights, metres, of latitudes and longitudes, radians."""
        x = (np.degrees(longitude) - self.corner[0]) / self.step[0]
        y = (self.corner[1] - np.degrees(latitude)) / self.step[1]
        i, j = np.floor(y).astype(int), np.floor(x).astype(int)
        v, u = y - i, x - j
        h = self.heights
        upper = (1 - u) * h[i, j] + u * h[i, j + 1]
        lower = (1 - u) * h[i + 1, j] + u * h[i + 1, j + 1]
        return np.asarray((1 - v) * upper + v * lower)


def _rows(file: Path) -> list[list[str]]:
    return [w for line in file.read_text(encoding="utf-8").splitlines() if (w := line.split())]


def _rays(folder: Path) -> dict[str, tuple[list[str], Array]]:
    found: dict[str, tuple[list[str], list[Array]]] = {}
    for file in ("all_liaisons2.mes", "all_terrains2.mes"):
        for point, photo, column, row in _rows(folder / file):
            names, xy = found.setdefault(photo, ([], []))
            names.append(point.strip('"'))
            at = np.array([float(column), float(row)]) - PRINCIPAL_POINT
            xy.append(at * [1.0, -1.0])
    return {photo: (names, np.array(xy)) for photo, (names, xy) in sorted(found.items())}


def _topocentric(grid: dict[str, Array], frame: TopocentricFrame) -> dict[str, Array]:
    at = np.array(list(grid.values()))
    latitude, longitude = lambert_93.from_grid(at[:, 0], at[:, 1])
    xyz = frame.geocentric.ellipsoid.to_cartesian(latitude, longitude, at[:, 2])
    return dict(zip(grid, frame.from_geocentric(xyz), strict=True))


def _photos(
    opk: list[list[str]], frame: TopocentricFrame, geoid: Geoid, ground: float | None
) -> dict[str, Oriented]:
    """Return the photos; ``ground`` is the altitude of the ground, None: Z is taken as it is."""
    numbers = np.array([r[1:7] for r in opk], dtype=float)
    latitude, longitude = lambert_93.from_grid(numbers[:, 0], numbers[:, 1])
    altitude = numbers[:, 2]
    if ground is not None:
        altitude = ground + (altitude - ground) / lambert_93.scale(latitude)
    height = altitude + geoid(latitude, longitude)
    xyz = frame.geocentric.ellipsoid.to_cartesian(latitude, longitude, height)
    position = frame.from_geocentric(xyz)
    level = frame.basis(position, np.zeros_like(position[:, :2])).enu.transpose(0, 2, 1)
    to_frame = level @ lambert_93.enu_from_grid(longitude)
    turns = [world_R_photogrammetric(*np.radians(r[3:])) @ TURN_ABOUT_X for r in numbers]
    return {
        r[0]: Oriented(r[0], at, e @ turn)
        for r, at, e, turn in sorted(
            zip(opk, position, to_frame, turns, strict=True), key=lambda row: row[0][0]
        )
    }

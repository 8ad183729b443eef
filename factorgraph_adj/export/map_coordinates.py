"""Map coordinates of an exported file: grid, WGS 84 or local; conversion of places to them.

A network has its places in the axes of its frame. A file for other programs has them

- in the grid of the reference system: easting, northing, height;
- as longitude, latitude and height in WGS 84, which GeoJSON and KML demand;
- as east, north, up of a local or topocentric frame, where no reference system is known;
- as longitude, latitude and height on the ellipsoid of a geocentric frame of unknown datum.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from ..crs.grid_places import wgs84_places
from ..crs.reference_system import ReferenceSystem
from ..errors import InputError, Problem
from ..frames import Frame, GeocentricFrame, LocalFrame
from ..network.grid.model_coordinates import refuse_model_coordinates
from ..network.network import Network
from ..solve.grid_coordinates import reference_system_of
from ..types import Array

CoordinateKind: TypeAlias = Literal["grid", "wgs84", "plane", "ellipsoid"]
"""What map coordinates are; `MapCoordinates` has the words."""
COORDINATE_WORDS: dict[CoordinateKind, str] = {
    "grid": "easting, northing, height of the reference system, metres",
    "wgs84": "longitude, latitude (degrees) and ellipsoidal height (metres) in WGS 84",
    "plane": "east, north, up of the frame of the network, metres; no reference system is known",
    "ellipsoid": "longitude, latitude (degrees) and height (metres) on the ellipsoid of the frame; "
    "no reference system is known",
}


@dataclass(frozen=True, eq=False)
class MapCoordinates:
    """Map coordinates of places of a network."""

    kind: CoordinateKind
    """What the coordinates are."""
    frame: Frame
    """Frame of the network."""
    system: ReferenceSystem | None = None
    """Reference system of the network; None: unknown."""

    @property
    def in_degrees(self) -> bool:
        """Whether the first two coordinates are longitude and latitude, degrees."""
        return self.kind in ("wgs84", "ellipsoid")

    @property
    def words(self) -> str:
        """What the coordinates are, in words."""
        return COORDINATE_WORDS[self.kind]

    @cached_property
    def name(self) -> str:
        """Name of the reference system of the coordinates."""
        if self.kind == "wgs84":
            return "WGS 84"
        return self.system.name if self.kind == "grid" and self.system else "unknown"

    @cached_property
    def heights(self) -> str:
        """What the heights are above, in words."""
        if self.kind == "grid" and self.system is not None:
            return self.system.vertical
        return "Z of the frame" if self.kind == "plane" else "ellipsoid"

    def way(self, xyz: Array) -> tuple[str, float]:
        """Return name and accuracy (m, NaN if unknown) of the operation to WGS 84 at places."""
        there = np.asarray(xyz, dtype=float).reshape(-1, 3)
        there = there[np.isfinite(there).all(axis=1)]
        if self.kind != "wgs84" or self.system is None or not len(there):
            return "", float("nan")
        found = wgs84_places(self.system, self.frame, there)
        return found.operation, found.accuracy

    def of(self, xyz: Array) -> Array:
        """Return the map coordinates (n, 3) of places (n, 3) in the frame of the network.

        A place that is not finite gives NaN.

        Raises:
            InputError: pyproj or a geoid is missing, or a place is outside of it.
        """
        xyz = np.asarray(xyz, dtype=float).reshape(-1, 3)
        out = np.full(xyz.shape, np.nan)
        there = np.isfinite(xyz).all(axis=1)
        if there.any():
            out[there] = self._of(xyz[there])
        return out

    def _of(self, xyz: Array) -> Array:
        if self.kind == "grid" and self.system is not None:
            return self.system.from_frame(self.frame, xyz)
        if self.kind == "wgs84" and self.system is not None:
            found = wgs84_places(self.system, self.frame, xyz)
            return np.column_stack([found.longitude_deg, found.latitude_deg, found.height])
        if self.kind == "ellipsoid":
            geodetic = self.frame.geodetic(xyz)
            assert geodetic is not None
            latitude, longitude, height = geodetic
            return np.column_stack([np.degrees(longitude), np.degrees(latitude), height])
        if isinstance(self.frame, LocalFrame):
            return np.asarray(xyz @ np.vstack([self.frame.east_north, [0.0, 0.0, 1.0]]).T)
        return xyz.copy()


def best_map_coordinates(network: Network) -> MapCoordinates:
    """Return the best map coordinates of a network: those of its grid, or what there is.

    A reference system without a grid gives WGS 84. Without a reference system, local and
    topocentric networks are a plane, and geocentric ones have longitude and latitude on their
    ellipsoid.

    Raises:
        InputError: the network has a reference system, and coordinates of a model.
    """
    system, frame = network.crs, network.frame
    if system is not None:
        refuse_model_coordinates(network, system)
        return MapCoordinates("grid" if system.projected else "wgs84", frame, system)
    return MapCoordinates("ellipsoid" if isinstance(frame, GeocentricFrame) else "plane", frame)


def wgs84_map_coordinates(network: Network, format: str) -> MapCoordinates:
    """Return longitude, latitude and height in WGS 84.

    Raises:
        InputError: the network has no reference system, or coordinates of a model, so that nobody
            knows where it is.
    """
    try:
        return MapCoordinates("wgs84", network.frame, reference_system_of(network))
    except InputError as error:
        known = f"{format} has longitude and latitude in WGS 84 only"
        raise InputError([Problem(f"{known}; {p.what}", p.where) for p in error.problems]) from None


def refuse_unknown_place(network: Network) -> None:
    """Raise that longitude and latitude of a network are not known.

    Raises:
        InputError: the network has no reference system.
    """
    wgs84_map_coordinates(network, "the format")


def drawing_coordinates(network: Network, format: str) -> MapCoordinates:
    """Return coordinates of a plan in metres.

    Raises:
        InputError: the network is geocentric and has no reference system with a grid.
    """
    found = best_map_coordinates(network)
    if found.in_degrees:
        raise InputError(
            f"{format} has a plan in metres, which a geocentric network without a grid has not; "
            "state a projected reference system, such as Network(crs='EPSG:25832+7837'), or adjust "
            "in a topocentric frame"
        )
    return found

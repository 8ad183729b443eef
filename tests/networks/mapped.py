"""The small block somewhere on the Earth, with or without a reference system."""

from __future__ import annotations

from functools import cache

import numpy as np

import factorgraph_adj as fga
from tests.networks.small_block import small_block

PLACE = (48.137, 11.575, 520.0)
"""Latitude, longitude (degrees) and ellipsoidal height (metres) of the origin, in Munich."""


def mapped(
    crs: fga.ReferenceSystem | None, place: tuple[float, float, float] = PLACE
) -> fga.Network:
    """Return the small block with east, north, up at a place on GRS80."""
    network = small_block()
    latitude, longitude, height = place
    network.frame = fga.TopocentricFrame(
        float(np.radians(latitude)), float(np.radians(longitude)), height
    )
    network.crs = crs
    return network


@cache
def in_utm() -> fga.Solution:
    """Return the adjusted block in UTM 32 with ellipsoidal heights."""
    return fga.adjust(mapped(fga.ReferenceSystem("EPSG:25832", heights="ellipsoidal")))


@cache
def in_plane() -> fga.Solution:
    """Return the adjusted block in its local frame."""
    return fga.adjust(small_block())


def geocentric() -> fga.Network:
    """Return a triangle of distances between geocentric points of an unknown datum."""
    place = np.radians(PLACE[:2])
    frame = fga.TopocentricFrame(float(place[0]), float(place[1]), PLACE[2])
    plan = {"A": (0.0, 0.0, 0.0), "B": (900.0, 0.0, 20.0), "C": (0.0, 800.0, 40.0)}
    plan |= {"D": (400.0, 500.0, 90.0), "P": (300.0, 200.0, 10.0)}
    at = frame.to_geocentric(np.array(list(plan.values())))
    network = fga.Network("geocentric", frame=fga.GeocentricFrame())
    for name, xyz in zip(plan, at, strict=True):
        network.add_point(name, xyz, fixed="xyz" if name != "P" else "")
    for i, name in enumerate("ABCD"):
        value = float(np.linalg.norm(at[i] - at[-1])) + 0.001 * (-1) ** i
        network.add(fga.SlopeDistance(name, "P", value, sigma=0.002))
    return network

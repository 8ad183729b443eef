"""Latitude and longitude exchanged: of points, or of the origin of a topocentric frame.

Exchanged, a place lies elsewhere on the Earth. It is told where points are far from the others, or
do not fit the lengths that were observed, and would not be with their latitude and longitude
exchanged; and where all points are far from the origin of their frame.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...errors import known
from ...frames import Frame, GeocentricFrame, TopocentricFrame
from ...graph.equations import Equations
from ...types import Array, Index
from .finding import Finding
from .given_rows import BETTER

FAR = 20.0
"""Smallest distance from the middle of the network at which a place is far from it, relative to
the median distance of the points."""
NEAR = 3.0
"""Largest such distance at which a place belongs to the network."""
WITH_LENGTHS = ("slope_distance", "horizontal_distance", "gnss_vector")
"""Kinds that tell how far points are apart."""
LEAST_EXTENT = 1000.0
"""Smallest median distance that counts, metres: small networks may have far targets."""


def exchanged_latitudes(equations: Equations) -> Iterator[Finding]:
    """Iterate over places whose latitude and longitude are exchanged."""
    frame = equations.network.frame
    table = equations.unknowns["point"]
    given = np.flatnonzero(np.isfinite(table.values).all(axis=1))
    places = _geocentric(frame, table.values[given])
    if places is None or not len(given):
        return
    earth, inside = places
    other = exchanged(earth, inside)
    middle = np.median(inside, axis=0)
    away = np.linalg.norm(inside - middle, axis=1)
    extent = max(float(np.median(away)), LEAST_EXTENT)
    back = np.linalg.norm(other - middle, axis=1)
    what = "would be among the others with latitude and longitude exchanged"
    wrong = np.flatnonzero((away > FAR * extent) & (back < NEAR * extent))
    if not len(wrong):
        wrong = _against_lengths(equations, given, inside, other)
        what = "or what they were measured to, would fit the observed lengths with latitude and "
        what += "longitude exchanged"
    if len(wrong):
        names = [table.names[int(i)] for i in given[wrong]]
        yield Finding(
            f"{len(names)} point{'s' * (len(names) > 1)}, far away as given, {what}: "
            f"{known(names)}",
            "exchange latitude and longitude (latitude is north, longitude east)",
            float(np.linalg.norm(inside - other, axis=1)[wrong].max()) / 1e3,
            unit="km",
        )
    if isinstance(frame, TopocentricFrame):
        origin = frame.to_geocentric(np.zeros((1, 3)))
        turned = exchanged(earth, origin)
        now, then = (float(np.linalg.norm(x[0] - middle)) for x in (origin, turned))
        if now > FAR * extent and then * FAR < now:
            yield Finding(
                "the points lie far from the origin of the frame, and would not with latitude "
                f"and longitude of the origin exchanged ({then / 1e3:.3g} km)",
                "exchange latitude and longitude of the origin, or of all points",
                now / 1e3,
                unit="km",
            )


def _geocentric(frame: Frame, xyz: Array) -> tuple[GeocentricFrame, Array] | None:
    """Return the geocentric frame and coordinates (n, 3); None: a local frame is nowhere."""
    if isinstance(frame, TopocentricFrame):
        return frame.geocentric, frame.to_geocentric(xyz)
    if isinstance(frame, GeocentricFrame):
        return frame, xyz
    return None


def exchanged(earth: GeocentricFrame, xyz: Array) -> Array:
    """Return places (n, 3) with latitude and longitude exchanged; infinitely far: there is none."""
    with np.errstate(all="ignore"):  # a place may be unknown, or the centre of the Earth
        latitude, longitude, height = earth.ellipsoid.to_geodetic(xyz)
    out = earth.ellipsoid.to_cartesian(longitude, latitude, height)
    return np.where(np.abs(longitude[:, None]) <= np.pi / 2, out, np.inf)


def _against_lengths(equations: Equations, given: Index, inside: Array, other: Array) -> Index:
    """Return places among ``given`` that fit observed lengths better exchanged, the worst first.

    Args:
        equations: the observation equations.
        given: numbers of the points with given coordinates, (n,).
        inside: their geocentric coordinates, (n, 3).
        other: the same with latitude and longitude exchanged, (n, 3).
    """
    place = np.full(len(equations.unknowns["point"].names), -1, dtype=np.intp)
    place[given] = np.arange(len(given))
    ends, lengths = [np.zeros((0, 2), dtype=np.intp)], [np.zeros(0)]
    for block in equations.blocks:
        if block.kind in WITH_LENGTHS:
            ends.append(np.column_stack([place[i] for k, i in block.variables if k == "point"]))
            lengths.append(np.linalg.norm(block.observed, axis=1))
    pair, length = np.concatenate(ends), np.concatenate(lengths)
    pair, length = pair[(pair >= 0).all(axis=1)], length[(pair >= 0).all(axis=1)]

    def misfit(a: Array, b: Array) -> Array:
        off = np.linalg.norm(a[pair[:, 0]] - b[pair[:, 1]], axis=1) - length
        return np.asarray(np.abs(off))

    now, by_end = misfit(inside, inside), (misfit(other, inside), misfit(inside, other))
    left = now > length  # by more than the length itself
    found: list[int] = []
    while left.any():
        worst = int(np.bincount(pair[left].ravel()).argmax())
        own = [(pair[:, end] == worst) & ~np.isin(pair[:, 1 - end], found) for end in range(2)]
        before = np.concatenate([now[mine] for mine in own])
        after = np.concatenate([by_end[end][mine] for end, mine in enumerate(own)])
        if float(np.median(after)) * BETTER < float(np.median(before)):
            found.append(worst)
        left &= (pair != worst).all(axis=1)
    return np.array(found, dtype=np.intp)

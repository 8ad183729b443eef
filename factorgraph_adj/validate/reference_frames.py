"""Exchanged latitude and longitude; GNSS vectors, zones and heights of another reference frame.

Latitude and longitude exchanged: the place lies elsewhere on the Earth. It is reported where points
are far from the others, or do not fit the lengths that were observed, and would not be with their
latitude and longitude exchanged; and where all points are far from the origin of their frame.

Vectors in other axes: in a topocentric frame they may be geocentric, in a geocentric one they may
be east, north, up; how to turn them is known then. The sums of vectors from one point with given
coordinates to others are compared, so that points between them need none. In a local frame nobody
knows how it lies on the Earth: there the lengths of vectors fit given coordinates, and their
components do not.

Heights above the ellipsoid beside heights above a geoid are tens of metres apart.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..crs.reference_system import ReferenceSystem
from ..errors import AdjustmentError, known
from ..frames import Frame, GeocentricFrame, LocalFrame, TopocentricFrame
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..network.network import Network
from ..observations.base import of_quantities
from ..observations.registry import DISTANCE_QUANTITIES, Quantity
from ..types import Array, Index, Mask
from .findings import MIN_FIT_IMPROVEMENT, Finding, computed_values, given_rows, median_size

MIN_FAR_EXTENT_RATIO = 20.0
"""Smallest distance from the middle of the network at which a place is far from it, relative to
the median distance of the points."""
MAX_NEAR_EXTENT_RATIO = 3.0
"""Largest such distance at which a place belongs to the network."""
LENGTH_QUANTITIES: frozenset[Quantity] = DISTANCE_QUANTITIES | {"vector"}
"""Quantities that give the distance of two points."""
MIN_EXTENT_M = 1000.0
"""Smallest median distance that counts, metres: small networks may have far targets."""
MIN_FRAME_MISFIT = 0.05
"""Smallest misfit of components, relative to the length, that another frame explains."""
MIN_ZONE_OFFSET_M = 1e4
"""Smallest difference of coordinates, metres, that another zone explains."""
MIN_GNSS_CONTROL_POINTS = 2
"""Smallest number of control points that GNSS has measured, of which the same offset is
reported."""
MIN_HEIGHT_OFFSET_M = 1.0
"""Smallest offset of heights, metres, that is reported: undulations of a few decimetres are rare,
and so are errors of heights of a metre that all control points share."""
MAX_UNDULATION_DIFFERENCE = 0.1
"""Part of the undulation by which an offset may differ from it and be explained by it: a geoid of
one site is not that of the datum."""


def exchanged_latitudes(equations: Equations) -> Iterator[Finding]:
    """Iterate over places whose latitude and longitude are exchanged."""
    frame = equations.network.frame
    table = equations.unknowns["point"]
    given = np.flatnonzero(np.isfinite(table.values).all(axis=1))
    places = _geocentric(frame, table.values[given])
    if places is None or not len(given):
        return
    earth, inside = places
    other = exchanged_geodetic(earth, inside)
    middle = np.median(inside, axis=0)
    away = np.linalg.norm(inside - middle, axis=1)
    extent = max(float(np.median(away)), MIN_EXTENT_M)
    back = np.linalg.norm(other - middle, axis=1)
    what = "would be among the others with latitude and longitude exchanged"
    wrong = np.flatnonzero(
        (away > MIN_FAR_EXTENT_RATIO * extent) & (back < MAX_NEAR_EXTENT_RATIO * extent)
    )
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
        turned = exchanged_geodetic(earth, origin)
        now, then = (float(np.linalg.norm(x[0] - middle)) for x in (origin, turned))
        if now > MIN_FAR_EXTENT_RATIO * extent and then * MIN_FAR_EXTENT_RATIO < now:
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


def exchanged_geodetic(earth: GeocentricFrame, xyz: Array) -> Array:
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
        if block.quantity in LENGTH_QUANTITIES:
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
        if float(np.median(after)) * MIN_FIT_IMPROVEMENT < float(np.median(before)):
            found.append(worst)
        left &= (pair != worst).all(axis=1)
    return np.array(found, dtype=np.intp)


def vector_frames(equations: Equations) -> Iterator[Finding]:
    """Iterate over groups of vectors that are given in another frame."""
    points = equations.unknowns["point"].values
    given = np.asarray(np.isfinite(points).all(axis=1))
    found: list[Finding] = []
    for block in equations.blocks:
        if block.quantity == "vector" and given.any():
            found += _of_known_axes(equations, block, given)
    yield from found or _by_lengths(equations)


@dataclass(frozen=True)
class _Other:
    """What vectors, or the points that they join, may be."""

    what: str
    """What it is, said of the vectors."""
    remedy: str
    """What is to be done then."""
    vectors: Array
    """The vectors in the frame of the network if it is so, (n, 3)."""
    points: Array
    """The points if it is so, (p, 3)."""


def _others(frame: Frame, vectors: Array, points: Array, given: Mask) -> Iterator[_Other]:
    """Iterate over what vectors (n, 3) between points (p, 3) may be in a frame on the Earth."""
    if isinstance(frame, TopocentricFrame):
        yield _Other(
            "as geocentric X, Y, Z, in a topocentric frame",
            "turn them into east, north, up at its origin, or give the network that frame",
            frame.from_geocentric(frame.to_geocentric(np.zeros((1, 3))) + vectors),
            points,
        )
    elif isinstance(frame, GeocentricFrame):
        at = points[given].mean(axis=0, keepdims=True)
        yield _Other(
            "as east, north, up, in a geocentric frame",
            "turn them into geocentric X, Y, Z, or give the network a topocentric frame",
            vectors @ frame.basis(at, np.zeros((1, 2))).enu[0],
            points,
        )
        elsewhere = exchanged_geodetic(frame, points)
        if np.isfinite(elsewhere[given]).all():
            yield _Other(
                "with latitude and longitude of all points exchanged",
                "exchange latitude and longitude (latitude is north, longitude east)",
                vectors,
                elsewhere,
            )


def _of_known_axes(equations: Equations, block: Block, given: Mask) -> Iterator[Finding]:
    """Report what the vectors of a block fit as, where they do not fit as they are."""
    points = equations.unknowns["point"].values
    off, length = _misfit(equations, block, block.observed, points, given)
    if off <= MIN_FRAME_MISFIT * length:
        return
    for other in _others(equations.network.frame, block.observed, points, given):
        left, _ = _misfit(equations, block, other.vectors, other.points, given)
        if left * MIN_FIT_IMPROVEMENT < off:
            yield Finding(
                f"{block.n} GNSS vectors fit the given coordinates "
                f"{off / max(left, 1e-12):.0f} times better {other.what}",
                other.remedy,
                off,
                left,
                "m",
            )
            return


def _misfit(
    equations: Equations, block: Block, vectors: Array, points: Array, given: Mask
) -> tuple[float, float]:
    """Return how far sums of vectors are from given points, and their length, medians, metres."""
    ends, sums = _sums(equations, block, vectors, given)
    if not len(ends):
        return 0.0, 0.0
    between = points[ends[:, 1]] - points[ends[:, 0]]
    off, length = (np.linalg.norm(x, axis=1) for x in (sums - between, between))
    return median_size(off), median_size(length)


def _sums(equations: Equations, block: Block, vectors: Array, given: Mask) -> tuple[Index, Array]:
    """Return pairs of given points that vectors join, (m, 2), and the sums of vectors, (m, 3).

    Sums run from the first given point of each connected part along the shortest ways.
    """
    start, end = (i for k, i in block.variables if k == "point")
    frame, some = equations.network.frame, np.flatnonzero(given)[:1]
    up = frame.basis(equations.unknowns["point"].values[some], np.zeros((1, 2))).enu[0, 2]
    rise = block.constants["instrument_height"] - block.constants["target_height"]
    d = vectors + rise[:, None] * up
    ways: dict[int, list[tuple[int, Array]]] = {}
    for a, b, v in zip(start.tolist(), end.tolist(), d, strict=True):
        ways.setdefault(a, []).append((b, v))
        ways.setdefault(b, []).append((a, -v))
    reached: set[int] = set()
    ends, sums = [], []
    for root in [p for p in ways if given[p]]:
        if root in reached:
            continue
        reached.add(root)
        waiting = deque([(root, np.zeros(3))])
        while waiting:
            at, so_far = waiting.popleft()
            for other, v in ways[at]:
                if other in reached:
                    continue
                reached.add(other)
                waiting.append((other, so_far + v))
                if given[other]:
                    ends.append((root, other))
                    sums.append(so_far + v)
    return np.array(ends, dtype=np.intp).reshape(-1, 2), np.array(sums).reshape(-1, 3)


def _by_lengths(equations: Equations) -> Iterator[Finding]:
    """Vectors whose lengths fit given coordinates, and whose components do not."""
    for block, rows in given_rows(equations, "gnss_vector"):
        observed, computed = computed_values(equations, block, rows)
        length = np.linalg.norm(computed, axis=1)
        by_length = median_size(np.linalg.norm(observed, axis=1) - length)
        by_components = median_size(np.linalg.norm(observed - computed, axis=1))
        if (
            by_components > MIN_FRAME_MISFIT * median_size(length)
            and by_length * MIN_FIT_IMPROVEMENT < by_components
        ):
            yield Finding(
                f"{len(rows)} GNSS vectors have the lengths of the given coordinates, but other "
                "components",
                "they are geocentric, or in another frame: give the frame of the network, or turn "
                "the vectors into it" + other_zone_text(equations.network.crs),
                by_components,
                by_length,
                "m",
            )


def other_zone_text(system: ReferenceSystem | None, size: float = np.inf) -> str:
    """Return that grid coordinates may be those of another zone; empty if they are of none.

    Args:
        system: the reference system.
        size: how far coordinates are off, metres: less than `MIN_ZONE_OFFSET_M` is no other zone.
    """
    return (
        ""
        if system is None or size < MIN_ZONE_OFFSET_M
        else f"; or the coordinates are not those of {system.name}: look at its zone and datum"
    )


def mixed_heights(network: Network) -> Iterator[Finding]:
    """Report that positions of GNSS lie above or below control points, and agree with them in plan.

    Control points are those that are held, and those with observed coordinates of another origin.
    """
    control = of_quantities(network.observations.values(), "coordinates")
    weighted = {o.point for o in control}
    ids, observed, given = [], [], []
    satellite: dict[str, Any] = {
        i: o
        for i, o in network.observations.items()
        if o.record.quantity == "GNSS coordinates" and o.component_names() == ("x", "y", "z")
    }
    for ident, o in satellite.items():
        point = network.points[o.point]
        if all(point.fixed) or point.sigma is not None or o.point in weighted:
            ids.append(ident)
            observed.append(o.value)
            given.append(point.coordinates)
    at = np.array(given, dtype=float).reshape(-1, 3)
    d = np.array(observed, dtype=float).reshape(-1, 3) - at
    there = np.isfinite(at).all(axis=1)
    if there.sum() < MIN_GNSS_CONTROL_POINTS:
        return
    at, d = at[there], d[there]
    d = np.einsum("nij,nj->ni", network.frame.basis(at, np.zeros((len(at), 2))).enu, d)
    offset = float(np.median(d[:, 2]))
    rest = max(median_size(np.hypot(d[:, 0], d[:, 1])), median_size(d[:, 2] - offset))
    if abs(offset) < MIN_HEIGHT_OFFSET_M or rest * MIN_FIT_IMPROVEMENT > abs(offset):
        return
    side = "below" if offset < 0 else "above"
    yield Finding(
        f"{len(at)} GNSS positions are {side} the given heights of their points, and agree with "
        f"them in plan{_undulation(network, at, offset)}",
        "heights above the ellipsoid and above a geoid are mixed: state for the reference system "
        "which of them the given heights are",
        abs(offset),
        rest,
        "m",
        ids=tuple(i for i, t in zip(ids, there.tolist(), strict=True) if t),
    )


def _undulation(network: Network, at: Array, offset: float) -> str:
    """Return that the offset is the undulation of the reference system, where it is."""
    if network.crs is None or isinstance(network.frame, LocalFrame):
        return ""
    try:
        latitude, longitude, _ = network.crs.geodetic(network.frame, at)
        found = network.crs.geoid_at(latitude, longitude).undulation
    except AdjustmentError:  # the geoid ends before
        return ""
    undulation = float(np.median(found))
    if abs(abs(offset) - abs(undulation)) > MAX_UNDULATION_DIFFERENCE * abs(undulation):
        return ""
    return f" (the undulation is {undulation:.2f} m there)"

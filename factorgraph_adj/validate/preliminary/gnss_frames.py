"""GNSS vectors in the axes of another frame than that of the network.

In a topocentric frame vectors may be geocentric, in a geocentric one they may be east, north, up;
how to turn them is known then. What is compared are the sums of vectors from one point with given
coordinates to others, so that points between them need none. In a local frame nobody knows how it
lies on the Earth: there the lengths of vectors fit given coordinates, and their components do not.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...crs.system import ReferenceSystem
from ...frames import Frame, GeocentricFrame, TopocentricFrame
from ...graph.blocks import Block
from ...graph.equations import Equations
from ...types import Array, Index, Mask
from .finding import Finding
from .geographic import exchanged
from .given_rows import BETTER, computed_values, given_rows, median

OTHER = 0.05
"""Smallest misfit of components, relative to the length, that another frame explains."""
ZONE_APART = 1e4
"""Smallest difference of coordinates, metres, that another zone explains."""


def vector_frames(equations: Equations) -> Iterator[Finding]:
    """Iterate over groups of vectors that are given in another frame."""
    points = equations.unknowns["point"].values
    given = np.asarray(np.isfinite(points).all(axis=1))
    found: list[Finding] = []
    for block in equations.blocks:
        if block.kind == "gnss_vector" and given.any():
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
        elsewhere = exchanged(frame, points)
        if np.isfinite(elsewhere[given]).all():
            yield _Other(
                "with latitude and longitude of all points exchanged",
                "exchange latitude and longitude (latitude is north, longitude east)",
                vectors,
                elsewhere,
            )


def _of_known_axes(equations: Equations, block: Block, given: Mask) -> Iterator[Finding]:
    """Tell what the vectors of a block fit as, where they do not fit as they are."""
    points = equations.unknowns["point"].values
    off, length = _misfit(equations, block, block.observed, points, given)
    if off <= OTHER * length:
        return
    for other in _others(equations.network.frame, block.observed, points, given):
        left, _ = _misfit(equations, block, other.vectors, other.points, given)
        if left * BETTER < off:
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
    return median(off), median(length)


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
        by_length = median(np.linalg.norm(observed, axis=1) - length)
        by_components = median(np.linalg.norm(observed - computed, axis=1))
        if by_components > OTHER * median(length) and by_length * BETTER < by_components:
            yield Finding(
                f"{len(rows)} GNSS vectors have the lengths of the given coordinates, but other "
                "components",
                "they are geocentric, or in another frame: give the frame of the network, or turn "
                "the vectors into it" + other_zone(equations.network.crs),
                by_components,
                by_length,
                "m",
            )


def other_zone(system: ReferenceSystem | None, size: float = np.inf) -> str:
    """Return that grid coordinates may be those of another zone; empty if they are of none.

    Args:
        system: the reference system.
        size: how far coordinates are off, metres: less than `ZONE_APART` is no other zone.
    """
    return (
        ""
        if system is None or size < ZONE_APART
        else f"; or the coordinates are not those of {system.name}: look at its zone and datum"
    )

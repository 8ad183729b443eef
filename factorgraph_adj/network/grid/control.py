"""Points of a grid in a frame on the Earth: held and weighted coordinates, control.

A component of the grid is no component of the frame. Points that are held in all three stay held.
A weighted position is an observation along east, north and up with the covariance K Σ Kᵀ,
K = ∂(e, n, u)/∂(E, N, H). Easting and northing without a height are one along
east and north, whatever the height. A height is one of the height above the ellipsoid, or above a
level surface that stands for the offset of the geoid.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import InputError, Problem
from ...observations import Observation
from ...observations.positions import ControlPoint
from ...observations.vertical import LevelHeight, ProfileHeight
from ...types import Array
from ..entities import Point
from .move import HELD, OFFSET, GridMove, Moved, no_place

PLAN, HEIGHT = slice(0, 2), 2


@dataclass(frozen=True, eq=False)
class Known:
    """Known coordinates of a point in the grid."""

    point: str
    """Name of the point."""
    coordinates: Array
    """x, y, z in the grid, (3,) metres; NaN where unknown."""
    covariance: Array
    """Covariance of x, y, z, (3, 3) metres²; infinite variances where nothing is known."""
    where: str
    """For messages."""
    source: str | None = None
    """File and line."""

    @property
    def known(self) -> tuple[bool, bool, bool]:
        """Which components are known."""
        x, y, z = (bool(np.isfinite(v)) for v in np.diag(self.covariance))
        return x, y, z


def observed(
    known: Known, move: GridMove, place: Moved, row: int, cls: type[ControlPoint] = ControlPoint
) -> tuple[list[Observation], Array]:
    """Return the observations that known coordinates of the grid are in the frame.

    The heights of a GNSS position take no part in the offset of the geoid.

    Args:
        known: the coordinates.
        move: the change of frames.
        place: places that have this one.
        row: number of the place.
        cls: class of an observed position.

    Returns:
        The observations, and the matrix (m, m) from errors of the known components to errors of
        theirs.

    Raises:
        InputError: only one of two plan coordinates is known, the place is needed and unknown, or
            plan and height are correlated where the geoid has an offset.
    """
    x, y, z = known.known
    if x != y:
        what = "easting and northing are known together, or neither: axes of the frame are others"
        raise InputError(Problem(what, known.where))
    offset = move.options.geoid_offset is not None and cls is ControlPoint
    if not place.there(row) and (x or not move.level):
        raise InputError(no_place(known.where))
    covariance = known.covariance
    if x and z and not offset:
        k = place.horizon[row] @ place.partials[row]
        sigma = _symmetric(k @ covariance @ k.T)
        at = tuple(place.xyz[row].tolist())
        return [cls(known.point, at, axes="enu", covariance=sigma, source=known.source)], k
    out: list[Observation] = []
    matrix = np.zeros((0, 0))
    if x and z and np.any(covariance[PLAN, HEIGHT]):
        what = "plan and height are correlated: a network with an offset of the geoid takes no such"
        raise InputError(Problem(what, known.where))
    if x:
        # Rows e, n of the horizon: the height has no part in them.
        k = (place.horizon[row] @ place.partials[row])[PLAN, PLAN]
        sigma = _symmetric(k @ covariance[PLAN, PLAN] @ k.T)
        at = tuple(place.xyz[row].tolist())
        out.append(cls(known.point, at, axes="en", covariance=sigma, source=known.source))
        matrix = k
    if z:
        out.append(_height(known, move, place, row, offset=offset))
        matrix = np.block(
            [[matrix, np.zeros((len(matrix), 1))], [np.zeros((1, len(matrix))), np.eye(1)]]
        )
    return out, matrix


def _height(known: Known, move: GridMove, place: Moved, row: int, *, offset: bool) -> Observation:
    value = float(known.coordinates[HEIGHT])
    n = float(place.undulation[row])
    if np.isnan(n):
        zero = np.zeros(1)
        n = float(move.system.geoid_at(zero, zero, [known.point]).undulation[0])
    sigma = float(np.sqrt(known.covariance[HEIGHT, HEIGHT]))
    if offset:
        return LevelHeight(known.point, OFFSET, value, sigma=sigma, geoid=n, source=known.source)
    return ProfileHeight(known.point, value + n, sigma=sigma, source=known.source)


def _symmetric(matrix: Array) -> Array:
    return np.asarray((matrix + matrix.T) / 2.0)


def moved_point(
    point: Point, move: GridMove, place: Moved, row: int, check: Moved, source: str | None
) -> tuple[Point, list[Observation]]:
    """Return a point in the frame, and the observations of its held and weighted coordinates.

    Args:
        point: the point in the grid.
        move: the change of frames.
        place: places of the points; a missing height is that of the middle of the network.
        row: number of the point.
        check: places of the check coordinates.
        source: file and line of the point.

    Raises:
        InputError: as `observed`, or check coordinates lack a component that the point lacks too.
    """
    where = f"point {point.name!r}"
    xyz = np.array(point.coordinates)
    at = place.xyz[row]
    fixed = np.array(point.fixed)
    sigma = np.full(3, np.inf) if point.sigma is None else np.array(point.sigma, dtype=float)
    sigma = np.where(fixed, HELD, sigma)
    if fixed.any() and not fixed.all():
        # Letters of the old axes that are one plan component alone are refused by `observed`.
        fixed[:] = False
    held = bool(fixed.all()) and move.options.geoid_offset is None
    observations: list[Observation] = []
    if held and not place.there(row):
        raise InputError(no_place(where))
    if not held and np.isfinite(sigma).any():
        variance = np.diag(sigma**2)
        observations, _ = observed(
            Known(point.name, xyz, variance, where, source), move, place, row
        )
    compared = None
    if point.check is not None:
        given = np.isfinite(point.check)
        if not check.there(row):
            what = (
                "check coordinates without one component need an approximate value of it in x, y, z"
            )
            raise InputError(Problem(what, where))
        if not given.all() and given[0] != given[1]:
            what = "check coordinates have easting and northing together, or neither"
            raise InputError(Problem(what, where))
        compared = _triple(np.where(given, check.xyz[row], np.nan))
    return (
        replace(
            point,
            coordinates=_triple(at),
            fixed=(held, held, held),
            sigma=None,
            check=compared,
        ),
        observations,
    )


def _triple(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z

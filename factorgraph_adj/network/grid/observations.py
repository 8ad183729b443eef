"""Observations of a grid in a frame on the Earth: conversion class by class, refusals.

What was measured between points stays: slope distances, directions, angles, image coordinates.
What counts from the axes or the heights of the grid is converted by a function for its class. A
kind that says of itself that it fixes coordinates, a direction or an attitude, and has no such
function, is refused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import singledispatch
from typing import Any

import numpy as np

from ...errors import InputError, Problem
from ...observations import Observation
from ...observations.airborne_observations import (
    NavigationAttitude,
    PhotoAngle,
    PhotoAttitude,
    PhotoSight,
)
from ...observations.ellipsoidal_observations import (
    EllipsoidDistance,
    EllipsoidHeight,
    GeodeticAzimuth,
)
from ...observations.offsets import HydrostaticReading
from ...observations.photo_motions import PhotoShift
from ...observations.positions import ControlPoint, GnssVector, PhotoPosition
from ...observations.refracted_images import ImageThroughLevel
from ...observations.relations import CoordinateDifference, PointDirection
from ...observations.surface_heights import LevelHeight, ProfileHeight
from ...observations.terrestrial_observations import (
    AstronomicLatitude,
    AstronomicLongitude,
    Azimuth,
    GyroAzimuth,
    HeightDifference,
    HorizontalDistance,
)
from ...rotation import angles_by_rotation, omega_phi_kappa, world_R_camera
from ...types import Array
from .projected_lines import scale_of_line, turn_of_line
from .transformation import GridMove, Moved, no_place
from .unknowns import Known, observed

Converted = tuple[list[Observation], Array]
"""Observations, and the matrix from errors of the components to errors of theirs."""


@dataclass(frozen=True, eq=False)
class Context:
    """What observations of a grid are converted with."""

    move: GridMove
    """The change of frames."""
    points: Moved
    """Places of the points."""
    point_number: Mapping[str, int]
    """Rows of the points."""
    photos: Moved
    """Places of the photos."""
    photo_number: Mapping[str, int]
    """Rows of the photos."""
    deflections: Mapping[str, tuple[float, float]]
    """(ξ, η) of the stations that have any, radians."""
    remarks: list[str]
    """What the conversion had to leave out, for the report."""

    def point(self, name: str, where: str) -> int:
        """Return the row of a point that must have a place."""
        row = self.point_number[name]
        if not self.points.there(row):
            raise InputError(no_place(f"{where}: point {name!r}"))
        return row

    def photo(self, name: str, where: str) -> int:
        """Return the row of a photo that must have a place."""
        row = self.photo_number[name]
        if not self.photos.there(row):
            raise InputError(no_place(f"{where}: photo {name!r}"))
        return row


# -- where an observation has a place of its own --------------------------------------------------


@singledispatch
def own_place(o: Observation, old: Any) -> Array | None:
    """Return the coordinates in the grid that an observation has itself, (3,); None for most."""
    return None


@own_place.register
def _(o: ControlPoint, old: Any) -> Array | None:
    if o.local or o.axes == "xyz":
        return np.array(o.value, dtype=float)
    return None


@own_place.register
def _(o: PhotoPosition, old: Any) -> Array | None:
    return np.array(o.value, dtype=float) if o.axes == "xyz" else None


# -- conversion -----------------------------------------------------------------------------------


@singledispatch
def converted(o: Observation, c: Context, place: Moved, row: int) -> Converted:
    """Return what an observation of the grid is in the frame.

    Args:
        o: the observation.
        c: places of points and photos.
        place: places that observations have themselves, see `own_place`.
        row: number of the place of this one.

    Raises:
        InputError: it cannot be converted.
    """
    if o.record.fixes != "nothing":
        what = (
            f"{o.kind.replace('_', ' ')} counts from axes of the network, and cannot be converted "
            "from a grid: give it in a topocentric frame"
        )
        raise InputError(Problem(what, o.label()))
    return [o], _same(o)


def _same(o: Observation) -> Array:
    return np.eye(len(o.component_names()))


@converted.register(AstronomicLatitude)
@converted.register(AstronomicLongitude)
@converted.register(EllipsoidHeight)
@converted.register(GeodeticAzimuth)
def _(o: Observation, c: Context, place: Moved, row: int) -> Converted:
    return [o], _same(o)


def _of_axes(o: Any) -> Array:
    """Return the covariance of an observation with σ or a covariance, in its components."""
    if o.covariance is not None:
        return np.array(o.covariance, dtype=float)
    return np.diag(np.array(o.sigma, dtype=float) ** 2)


@converted.register
def _(o: ControlPoint, c: Context, place: Moved, row: int) -> Converted:
    cls = type(o)
    number = c.point_number[o.point]
    own = place.there(row)
    axes = np.eye(3)
    if o.local:
        # e, n, u are the axes of the grid: rows of x, y, z for each component.
        axes = c.move.axes[["enu".index(a) for a in o.axes]]
    else:
        axes = axes[["xyz".index(a) for a in o.axes]]
    if not np.isin(np.abs(axes), (0.0, 1.0)).all():
        raise InputError(Problem("its axes are not those of the grid", o.label()))
    at = np.abs(axes).argmax(axis=1)
    covariance = np.diag(np.full(3, np.inf))
    covariance[np.ix_(at, at)] = _of_axes(o) * np.outer(axes.sum(axis=1), axes.sum(axis=1))
    value = np.full(3, np.nan)
    if o.local:
        value[:] = o.value
    else:
        value[at] = o.value
    known = Known(o.point, value, covariance, o.label(), o.source)
    if own:
        found, k = observed(known, c.move, place, row, cls)
    else:
        plan = ~np.isnan(value[:2])
        if plan.any():
            partly = _at(c, o, value, number)
            found, k = observed(known, c.move, partly, 0, cls)
        else:
            found, k = observed(known, c.move, c.points, number, cls)
    # Errors come in the order of the components; those of `observed` in that of x, y, z.
    order = np.argsort(at)
    return _named(o, found), k @ np.eye(len(at))[order] @ np.diag(axes.sum(axis=1))


def _at(c: Context, o: ControlPoint, value: Array, number: int) -> Moved:
    """Return the place of known easting and northing, at the height of the point."""
    if not c.points.there(number):
        raise InputError(no_place(f"{o.label()}: point {o.point!r}"))
    height = c.move.system.from_frame(c.move.new, c.points.xyz[number : number + 1], [o.point])
    z = float(height[0, 2])
    return c.move.places(np.array([[value[0], value[1], z]]), [o.point])


def _named(o: Observation, found: list[Observation]) -> list[Observation]:
    """Return observations of which the first has the id of the one that they represent."""
    ident = o.id
    return [replace(f, id=ident) if i == 0 else f for i, f in enumerate(found)]


@converted.register
def _(o: PhotoPosition, c: Context, place: Moved, row: int) -> Converted:
    if not place.there(row):
        what = "positions of photos have easting, northing and height together: axes change"
        raise InputError(Problem(what, o.label()))
    k = place.partials[row]
    covariance = k @ _of_axes(o) @ k.T
    velocity = place.turn[row] @ np.array(o.velocity, dtype=float)
    return [
        replace(
            o,
            value=tuple(place.xyz[row].tolist()),
            sigma=None,
            covariance=(covariance + covariance.T) / 2.0,
            velocity=tuple(velocity.tolist()),
        )
    ], k


@converted.register
def _(o: PhotoShift, c: Context, place: Moved, row: int) -> Converted:
    k = c.photos.partials[c.photo(o.moving_photo, o.label())]
    covariance = k @ _of_axes(o) @ k.T
    value = tuple((k @ np.array(o.value)).tolist())
    return [replace(o, value=value, sigma=None, covariance=(covariance + covariance.T) / 2.0)], k


@converted.register
def _(o: PhotoAttitude, c: Context, place: Moved, row: int) -> Converted:
    at = c.photo(o.photo, o.label())
    before = world_R_camera(*o.value)
    after = c.photos.turn[at] @ before
    matrix = np.eye(3)
    if o.about == "angles":
        matrix = angles_by_rotation(after) @ np.linalg.inv(angles_by_rotation(before))
        if not np.isfinite(matrix).all():
            what = "φ is ±90°, where angles have no standard deviations: give those about the body"
            raise InputError(Problem(what, o.label()))
    covariance = matrix @ _of_axes(o) @ matrix.T
    turned = replace(
        o,
        value=omega_phi_kappa(after),
        sigma=None,
        covariance=(covariance + covariance.T) / 2.0,
    )
    return [turned], matrix


@converted.register
def _(o: NavigationAttitude, c: Context, place: Moved, row: int) -> Converted:
    """Roll, pitch and heading count from the horizon and from north at the photo."""
    return [o], _same(o)


@converted.register
def _(o: PhotoAngle, c: Context, place: Moved, row: int) -> Converted:
    if o.angle in ("roll", "pitch", "heading"):
        return [o], _same(o)
    what = f"{o.angle} alone cannot be turned from the axes of a grid: give all three angles"
    raise InputError(Problem(what, o.label()))


@converted.register
def _(o: PhotoSight, c: Context, place: Moved, row: int) -> Converted:
    at = c.photo(o.photo, o.label())
    body = c.photos.turn[at] @ np.array(o.body)
    return [replace(o, body=tuple(body.tolist()))], _same(o)


@converted.register(Azimuth)
@converted.register(GyroAzimuth)
def _(o: Any, c: Context, place: Moved, row: int) -> Converted:
    """Turn a bearing of the grid by convergence and t − T: those of its line where it begins.

    The bearing is geodetic. Where its station has deflections, an azimuth would be astronomic.
    """
    if c.move.options.azimuths == "true":
        return [o], _same(o)
    if c.move.options.azimuths is None:
        what = (
            "does the azimuth count from grid north or from true north? say azimuths = 'grid' or "
            "'true'"
        )
        raise InputError(Problem(what, o.label()))
    ends = [c.point(o.station, o.label()), c.point_number[o.target]]
    if c.points.there(ends[1]):
        turn = turn_of_line(c.move.new, c.points.xyz[ends], c.points.grid[ends])
    else:
        turn = float(c.points.convergence[ends[0]])
        c.remarks.append(
            f"{o.label()}: {o.target} has no approximate coordinates, so that t − T, the curvature "
            "of the line in the grid, is left out"
        )
    found = replace(o, value=(o.value + turn) % (2.0 * math.pi))
    if type(o) is Azimuth and o.station in c.deflections:
        found = GeodeticAzimuth(**{f.name: getattr(found, f.name) for f in fields(found)})
    return [found], _same(o)


@converted.register
def _(o: GnssVector, c: Context, place: Moved, row: int) -> Converted:
    if c.move.options.vectors is None:
        what = (
            "is the vector geocentric (X, Y, Z of the Earth), or along easting, northing and "
            "height? say vectors = 'geocentric' or 'grid'"
        )
        raise InputError(Problem(what, o.label()))
    if c.move.options.vectors == "geocentric":
        k = c.move.from_earth
    else:
        k = c.points.turn[c.point(o.station, o.label())]
    covariance = k @ _of_axes(o) @ k.T
    return [
        replace(
            o,
            value=tuple((k @ np.array(o.value)).tolist()),
            sigma=None,
            covariance=(covariance + covariance.T) / 2.0,
        )
    ], k


@converted.register
def _(o: HeightDifference, c: Context, place: Moved, row: int) -> Converted:
    """ΔH + ΔN + ½ (ξ_i + ξ_j) Δn + ½ (η_i + η_j) Δe: the verticals have the slope already."""
    if c.move.level:
        return [o], _same(o)
    i, j = (c.point(n, o.label()) for n in (o.station, o.target))
    p = c.points
    slope = 0.0
    for name, row_of in ((o.station, i), (o.target, j)):
        xi, eta = c.deflections.get(name, (0.0, 0.0))
        east, north, _ = p.horizon[row_of] @ (p.xyz[j] - p.xyz[i])
        slope += 0.5 * (xi * north + eta * east)
    more = float(p.undulation[j] - p.undulation[i] + slope)
    return [replace(o, value=o.value + more)], _same(o)


@converted.register(LevelHeight)
@converted.register(ImageThroughLevel)
def _(o: Any, c: Context, place: Moved, row: int) -> Converted:
    """The water follows the geoid: its height stays one above it."""
    at = c.point(o.point, o.label())
    return [replace(o, geoid=o.geoid + float(c.points.undulation[at]))], _same(o)


@converted.register
def _(o: HydrostaticReading, c: Context, place: Moved, row: int) -> Converted:
    at = c.point(o.point, o.label())
    return [replace(o, undulation=o.undulation + float(c.points.undulation[at]))], _same(o)


@converted.register
def _(o: ProfileHeight, c: Context, place: Moved, row: int) -> Converted:
    """Pressure follows the geoid: the reading z = (1 + s)(h − a …) grows by N."""
    at, n = (
        (c.point(o.point, o.label()), c.points)
        if o.point is not None
        else (c.photo(str(o.photo), o.label()), c.photos)
    )
    return [replace(o, value=o.value + float(n.undulation[at]))], _same(o)


@converted.register
def _(o: HorizontalDistance, c: Context, place: Moved, row: int) -> Converted:
    """Restate a reduced distance as an arc on the ellipsoid or at sea level.

    One in the grid is longer than its arc by the scale of the projection along the line, which
    both have where the line begins.
    """
    kind = c.move.options.horizontal_distances
    if kind == "measured":
        return [o], _same(o)
    p, ends = c.points, [c.point(n, o.label()) for n in (o.station, o.target)]
    on_grid = kind == "grid"
    factor = 1.0 / scale_of_line(c.move.new, p.xyz[ends], p.grid[ends]) if on_grid else 1.0
    surfaces = p.undulation[ends] if kind == "sea_level" else np.zeros(2)
    distance = EllipsoidDistance(
        *(o.station, o.target, o.value * factor),
        sigma=o.sigma,
        station_surface=float(surfaces[0]),
        target_surface=float(surfaces[1]),
        instrument=o.instrument,
        id=o.id,
        source=o.source,
    )
    return [distance], _same(o) * factor


@converted.register
def _(o: PointDirection, c: Context, place: Moved, row: int) -> Converted:
    at = c.point(o.station, o.label())
    ux, uy, uz = (c.points.turn[at] @ np.array([o.ux, o.uy, o.uz])).tolist()
    return [replace(o, ux=ux, uy=uy, uz=uz)], _same(o)


@converted.register
def _(o: CoordinateDifference, c: Context, place: Moved, row: int) -> Converted:
    if o.horizon and o.axes == "z":
        return [o], _same(o)
    if not set("xy" if o.horizon else "xyz") <= set(o.axes):
        what = (
            "differences of some coordinates of a grid are others in the frame: give x, y and z, "
            "or with horizon = 1 x and y together"
        )
        raise InputError(Problem(what, o.label()))
    at = c.point(o.station, o.label())
    order = ["xyz".index(a) for a in o.axes]
    turn = c.points.turn[at]
    k = (c.points.horizon[at] @ turn if o.horizon else turn)[np.ix_(order, order)]
    covariance = k @ _of_axes(o) @ k.T
    value = tuple((k @ np.array(o.value)).tolist())
    return [replace(o, value=value, sigma=None, covariance=(covariance + covariance.T) / 2.0)], k

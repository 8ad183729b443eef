"""Points, photos and other unknowns of a grid in a frame; known values become observations.

A component of the grid is no component of the frame. Points that are held in all three stay held.
A weighted position is an observation along east, north and up with the covariance K Σ Kᵀ,
K = ∂(e, n, u)/∂(E, N, H). Easting and northing without a height are one along
east and north, whatever the height. A height is one of the height above the ellipsoid, or above a
level surface that represents the offset of the geoid.

ω, φ, κ of a photo in a grid count from its easting, its northing and the vertical at the photo.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...entities import Key, Parameter, Photo, Point, parameter_name
from ...errors import InputError, Problem
from ...models.rolling_shutter import MOTION, VELOCITY
from ...models.unknown_registry import UNKNOWNS, UnknownKind
from ...observations import Observation
from ...observations.positions import ControlPoint, PhotoPosition
from ...observations.surface_heights import LevelHeight, ProfileHeight
from ...rotation import exp_rotation, log_rotation
from ...types import Array
from .transformation import HELD, OFFSET, GridMove, Moved, no_place

PLAN, HEIGHT = slice(0, 2), 2
CURVATURE_WITHIN = -0.5
"""Coefficients of refraction below are k − 1: halfway between the usual k of 0 to 0.2 and it."""
POSITION = slice(3, 6)


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


Convert = Callable[[Parameter, GridMove, Moved, int], Parameter]
"""(parameter, change of frames, places, row of its point or photo or −1) → the parameter."""


def moved_parameter(
    kind: UnknownKind,
    key: Key,
    parameter: Parameter,
    move: GridMove,
    places: Moved,
    number: Mapping[str, int],
) -> Parameter:
    """Return an unknown of the grid in the frame.

    Args:
        kind: its kind.
        key: its name.
        parameter: the unknown in the grid.
        move: the change of frames.
        places: places of the points, or of the photos if the unknown belongs to a photo.
        number: their rows by name.

    Raises:
        InputError: its values count from axes of the grid and are held or weighted, or its kind
            moves with the object and nothing says how it is converted.
    """
    where = f"{kind.noun} {parameter_name(key)!r}"
    convert = CONVERSIONS.get(kind.name)
    if convert is None and kind.motions is None:
        return parameter
    if convert is None:
        what = (
            f"a {kind.noun} counts from axes of the network, and cannot be converted from a grid: "
            "state it in a topocentric frame"
        )
        raise InputError(Problem(what, where))
    name = key if isinstance(key, str) else key[0]
    try:
        return convert(parameter, move, places, number.get(name, -1))
    except InputError as error:
        raise InputError(p.at(where) for p in error.problems) from None


def _kept(parameter: Parameter, move: GridMove, places: Moved, row: int) -> Parameter:
    return parameter


def _without_curvature(parameter: Parameter, move: GridMove, places: Moved, row: int) -> Parameter:
    """Refraction: κ = k − 1 of a flat frame has the curvature of the Earth in it, k has not.

    In a flat frame a zenith angle above the curved Earth takes κ = k − 1; the new frame is curved
    by itself, and the curvature would count twice. A coefficient below ``CURVATURE_WITHIN`` is
    taken for k − 1; one above it is k already.
    """
    kappa = parameter.values[0]
    return replace(parameter, values=(kappa + 1.0,)) if kappa < CURVATURE_WITHIN else parameter


def _stated(parameter: Parameter) -> bool:
    """Return whether any component is held or weighted at a value that is not 0."""
    rows = zip(parameter.values, parameter.fixed, parameter.sigma, strict=True)
    return any((fixed or np.isfinite(s)) and v != 0 for v, fixed, s in rows)


def _turned(parameter: Parameter, move: GridMove, places: Moved, row: int) -> Parameter:
    """Orientations count from north: o = o_grid + γ."""
    if row < 0 or not places.there(row):
        if np.isnan(parameter.values[0]):
            return parameter
        raise InputError(no_place(""))
    value = np.mod(parameter.values[0] + places.convergence[row], 2.0 * np.pi)
    return replace(parameter, values=(float(value),))


def _axes_alike(parameter: Parameter, move: GridMove, places: Moved, row: int) -> Parameter:
    """Shifts along axes: the same in all axes, or none at all, stays as axes turn."""
    values = np.array(parameter.values).reshape(-1, 3)
    sigma = np.array(parameter.sigma).reshape(-1, 3)
    fixed = np.array(parameter.fixed).reshape(-1, 3)
    alike = all((a == a[:, :1]).all() for a in (sigma, fixed)) and not np.nan_to_num(values).any()
    if alike:
        return parameter
    what = (
        "has components along axes of the grid that are others in the frame: state values 0, and "
        "the same standard deviation in all axes"
    )
    raise InputError(Problem(what))


def _motion(parameter: Parameter, move: GridMove, places: Moved, row: int) -> Parameter:
    """Motions of photos: v = K v_grid, K = ∂X/∂x; the turn is about the axes of the camera.

    A σ that is the same along all axes of the grid is nearly so along those of the frame: that of
    each is taken from K Kᵀ σ², and correlations of less than a hundredth are left out. So are terms
    of higher powers of time.
    """
    k = places.partials[row]
    values, sigmas = list(parameter.values), list(parameter.sigma)
    for first in range(0, len(values), MOTION):
        own = slice(first, first + VELOCITY)
        velocity, sigma, fixed = np.array(values[own]), sigmas[own], parameter.fixed[own]
        if not places.there(row):
            if velocity.any() or np.isfinite(sigma).any():
                raise InputError(no_place(""))
            continue
        if len(set(sigma)) > 1 or len(set(fixed)) > 1:
            what = (
                "its velocity is held or weighted along axes of the grid that are others in the "
                "frame: hold all of it or nothing, with the same standard deviation in all axes"
            )
            raise InputError(Problem(what))
        values[own] = (k @ velocity).tolist()
        if np.isfinite(sigma[0]):
            sigmas[own] = (sigma[0] * np.sqrt(np.diag(k @ k.T))).tolist()
    return replace(parameter, values=tuple(values), sigma=tuple(sigmas))


def _frame(parameter: Parameter, move: GridMove, places: Moved, row: int) -> Parameter:
    """Frames of their own: R and O are turned and moved at O, or in the middle of the network."""
    values: Any = np.array(parameter.values, dtype=float)
    constants = np.array(parameter.constants, dtype=float)
    turns = values[:3]
    if np.isnan(values[:6]).all() and (parameter.origin or not constants[:3].any()):
        return parameter
    held = np.array(parameter.fixed[:6]) | np.isfinite(parameter.sigma[:6])
    motion = replace(
        parameter,
        values=parameter.values[:6],
        fixed=parameter.fixed[:6],
        sigma=parameter.sigma[:6],
    )
    if held.any() and _stated(motion):
        what = "is held or weighted in axes of the grid: state it in a topocentric frame"
        raise InputError(Problem(what))
    if not parameter.origin:
        at = move.places(constants[None, :3])
        constants[:3] = at.xyz[0]
        turn = at.turn[0]
    else:
        middle = np.nanmean(places.xyz, axis=0)
        turn = places.turn[int(np.nanargmin(np.linalg.norm(places.xyz - middle, axis=1)))]
    if constants[3]:  # R leads to the horizon: from that of the grid to the true one
        turn = move.new.basis(constants[None, :3], np.zeros((1, 2))).enu[0] @ turn
    if np.isfinite(turns).all():
        values[:3] = log_rotation((turn @ exp_rotation(turns[None])[0])[None])[0]
    return replace(parameter, values=tuple(values.tolist()), constants=tuple(constants.tolist()))


CONVERSIONS: dict[str, Convert] = {
    "refraction": _without_curvature,
    "orientation": _turned,
    "vertical": _kept,
    "edm": _kept,
    "frame": _frame,
    "mount": _kept,
    "photo_motion": _motion,
    "drift": _axes_alike,
    "attitude_drift": _axes_alike,
    "size": _kept,
    "level": _kept,
    "profile": _kept,
    "gyro": _kept,
    "port": _kept,
}
"""How unknowns that move with the object are converted, by kind; those that are kept count from
the vertical, from north, or along nothing. Heights of levels and profiles stay above the geoid,
because their observations get its undulation."""
assert set(CONVERSIONS) <= set(UNKNOWNS)


def moved_photo(photo: Photo, place: Moved, row: int) -> tuple[Photo, list[Observation]]:
    """Return a photo in the frame, and the observation of its weighted position.

    Args:
        photo: the photo in the grid.
        place: places of the photos.
        row: number of the photo.

    Raises:
        InputError: its attitude has no place to be turned at; some coordinates of its position are
            held or weighted, and others are not.
    """
    where = f"photo {photo.name!r}"
    there = place.there(row)
    fixed = photo.fixed[POSITION]
    if any(fixed) and not all(fixed):
        what = "coordinates of its position are held all together, or none: axes change"
        raise InputError(Problem(what, where))
    rotation = photo.rotation
    if rotation is not None:
        if not there:
            raise InputError(no_place(where))
        rotation = place.turn[row] @ rotation
    observations: list[Observation] = []
    if photo.sigma_position is not None and not all(fixed):
        sigma = np.array(photo.sigma_position, dtype=float)
        if not np.isfinite(sigma).all():
            what = "coordinates of its position are weighted all together, or none: axes change"
            raise InputError(Problem(what, where))
        if not there:
            raise InputError(no_place(where))
        k = place.partials[row]
        covariance = k @ np.diag(sigma**2) @ k.T
        at = tuple(place.xyz[row].tolist())
        observations.append(
            PhotoPosition(photo.name, at, covariance=(covariance + covariance.T) / 2.0)
        )
    x, y, z = place.xyz[row].tolist()
    return (
        replace(
            photo,
            position=(x, y, z) if there else None,
            rotation=rotation,
            sigma_position=None,
        ),
        observations,
    )

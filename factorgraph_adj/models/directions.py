"""Directions of the object in a frame of its own: the vertical, a line between two points.

    g = Rᵀ E d

d is a vector of the object (n, 3), R and E those of the frame, see `sub_frame`. Neither the origin
nor the scale of the frame takes part, except that the horizon E of a level frame is that of its
origin.

| partial of g by | value |
| --- | --- |
| d | Rᵀ E |
| ω | [g]× |
| O and (ξ, η) at O, of a level frame | what the horizon at O turns |
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..frames import Frame
from ..rotation import skew
from ..types import Array
from .sight import turned_by_angles, up_by_angles
from .sub_frame import COMPONENTS, horizons, split_frame

MOUNT = 6
"""Components of a mount: three rotations, three of the arm."""


class Directions(NamedTuple):
    """n vectors g in frames, and their partials."""

    g: Array
    """The vectors, (n, 3)."""
    by_frame: Array
    """∂g/∂(ω, c, ℓ), (n, 3, 7)."""
    by_vector: Array
    """∂g/∂d = Rᵀ E, (n, 3, 3)."""
    by_origin: Array
    """∂g/∂O, (n, 3, 3)."""
    by_vertical: Array
    """∂g/∂(ξ, η) at O, (n, 3, 2)."""


def direction_in_frame(
    frame: Frame,
    stored: Array,
    vector: Array,
    near: Array,
    origin: Array | None,
    vertical: Array | None,
) -> Directions:
    """Return vectors d (n, 3) of the object in the axes of frames (n, 17).

    Args:
        frame: frame of the network.
        stored: stored values of the frames.
        vector: d, any unit.
        near: a place of the network for each vector, metres, (n, 3); frames that are not level
            have no horizon of their own.
        origin: O where it is a point, (n, 3); None: the constants of the frames.
        vertical: deflections (ξ, η) of the vertical at O, (n, 2); None: zero.
    """
    rotation, _, _, constant, level = split_frame(stored)
    at = constant if origin is None else origin
    n = len(vector)
    is_level = (level != 0)[:, None]
    somewhere = np.where(is_level, at, near)
    basis = frame.basis(somewhere, np.zeros((n, 2)) if vertical is None else vertical)
    horizon = horizons(basis, level)
    turned = rotation.transpose(0, 2, 1)
    by_vector = turned @ horizon
    g = np.einsum("nij,nj->ni", by_vector, vector)
    by_frame = np.zeros((n, 3, COMPONENTS))
    by_frame[:, :, :3] = skew(g)
    in_horizon = np.einsum("nij,nj->ni", horizon, vector)
    by_angles = is_level[:, :, None] * (turned @ turned_by_angles(in_horizon, basis))
    return Directions(
        g,
        by_frame,
        by_vector,
        by_angles @ basis.angles_by_position,
        by_angles @ basis.angles_by_vertical,
    )


class Verticals(NamedTuple):
    """The vertical at n places in frames, and its partials."""

    g: Array
    """Unit vectors up, (n, 3)."""
    by_frame: Array
    """∂g/∂(ω, c, ℓ), (n, 3, 7)."""
    by_place: Array
    """∂g/∂X, (n, 3, 3)."""
    by_deflection: Array
    """∂g/∂(ξ, η) at X, (n, 3, 2)."""
    by_origin: Array
    """∂g/∂O, (n, 3, 3)."""
    by_vertical: Array
    """∂g/∂(ξ, η) at O, (n, 3, 2)."""


def vertical_in_frame(
    frame: Frame,
    stored: Array,
    place: Array,
    deflection: Array,
    origin: Array | None,
    vertical: Array | None,
) -> Verticals:
    """Return the vertical u(X) at places X (n, 3) in the axes of frames (n, 17).

    Args:
        frame: frame of the network.
        stored: stored values of the frames.
        place: X, metres.
        deflection: deflections (ξ, η) of the vertical at X, (n, 2).
        origin: O where it is a point, (n, 3); None: the constants of the frames.
        vertical: deflections at O, (n, 2); None: zero.
    """
    basis = frame.basis(place, deflection)
    d = direction_in_frame(frame, stored, basis.enu[:, 2], place, origin, vertical)
    turned = d.by_vector @ up_by_angles(basis)
    return Verticals(
        d.g,
        d.by_frame,
        turned @ basis.angles_by_position,
        turned @ basis.angles_by_vertical,
        d.by_origin,
        d.by_vertical,
    )


def split_mount(mount: Array) -> tuple[Array, Array]:
    """Return B (n, 3, 3), instrument → carrier, and the arm b (n, 3) of stored mounts (n, 12)."""
    return mount[:, :9].reshape(-1, 3, 3), mount[:, 9:12]


def in_instrument(mount: Array, g: Array) -> tuple[Array, Array, Array]:
    """Return g' = Bᵀ g (n, 3) of directions g in the carrier, ∂g'/∂mount and ∂g'/∂g = Bᵀ."""
    turned = split_mount(mount)[0].transpose(0, 2, 1)
    seen = np.einsum("nij,nj->ni", turned, g)
    by_mount = np.zeros((len(g), 3, MOUNT))
    by_mount[:, :, :3] = skew(seen)
    return seen, by_mount, turned


def of_those_there(
    partials: tuple[tuple[Array | None, Array], ...],
) -> tuple[Array, ...]:
    """Return the partials of the variables that are there, from pairs of variable and partial."""
    return tuple(partial for variable, partial in partials if variable is not None)

"""Photos of a grid in a frame on the Earth.

ω, φ, κ of a photo in a grid count from its easting, its northing and the vertical at the photo.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...errors import InputError, Problem
from ...observations import Observation
from ...observations.positions import PhotoPosition
from ..entities import Photo
from .move import Moved, no_place

POSITION = slice(3, 6)


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

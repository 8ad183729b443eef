"""Addition of finished points, photos and cameras to a network, with the usual checks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..errors import InputError, Problem
from .entities import Camera, Photo, Point
from .network import Network


def add_entities(
    network: Network,
    *,
    points: Sequence[Point],
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
) -> list[Problem]:
    """Add entities to a network; return all problems.

    Entities without a problem are added even if other entities have problems.
    """
    problems: list[Problem] = []
    adders: tuple[tuple[Callable[[Network, Any], None], Sequence[Any]], ...] = (
        (_add_camera, cameras),
        (_add_point, points),
        (_add_photo, photos),
    )
    for add, items in adders:
        for item in items:
            try:
                add(network, item)
            except InputError as error:
                problems.extend(error.problems)
            except (AttributeError, TypeError, ValueError) as error:
                problems.append(Problem(f"is no such thing: {error}", repr(item)[:80]))
    return problems


def _add_camera(network: Network, camera: Camera) -> None:
    parts = list(zip(camera.lens.names, camera.fixed, camera.sigma, strict=True))
    network.add_camera(
        camera.name,
        camera.lens,
        camera.values,
        free=[n for n, fixed, s in parts if not fixed and np.isinf(s)],
        sigma={n: s for n, fixed, s in parts if not fixed and np.isfinite(s)},
        unit=camera.unit,
        per_photo=camera.per_photo,
        format=camera.format,
        origin=camera.origin,
        y_down_in_files=camera.y_down_in_files,
    )


def _add_point(network: Network, point: Point) -> None:
    fixed: Any = point.fixed
    if not isinstance(fixed, str):
        fixed = point.held
    network.add_point(
        point.name,
        point.coordinates,
        fixed=fixed,
        sigma=point.sigma,
        datum=point.datum,
        check=point.check,
        side_shot=point.side_shot,
    )


def _add_photo(network: Network, photo: Photo) -> None:
    network.add_photo(
        photo.name,
        photo.camera,
        position=photo.position,
        rotation=photo.rotation,
        fixed=photo.fixed,
        sigma_position=photo.sigma_position,
        sigma_attitude=photo.sigma_attitude,
    )

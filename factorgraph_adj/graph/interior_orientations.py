"""Interior orientations of photos on film, as their fiducial marks give them to start with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..entities import Camera
from ..models.film_lens import FilmLens, start_of_interior_orientation
from ..network.network import Network
from ..observations.base import of_quantities
from ..types import Array, Mask


def start_interior_orientations(
    network: Network,
    cameras: Sequence[Camera],
    names: Sequence[str],
    calibration_name: Callable[[Network, str], str],
    values: Array,
    unknown: Mask,
) -> None:
    """Fit the unknown parameters of interior orientations, in place, to the marks of their photos.

    A photo can lie anywhere in a scanner, so that what a camera states of its parameters is no
    start of them.

    Args:
        network: network with the marks.
        cameras: camera of each calibration, (n,).
        names: names of the calibrations, (n,).
        calibration_name: returns the name of the calibration of a photo.
        values: parameters of the calibrations, (n, k).
        unknown: which of these are free and have no weight, (n, k).
    """
    if not any(isinstance(camera.lens, FilmLens) for camera in cameras):
        return
    marks: dict[str, list[Any]] = {}
    for o in of_quantities(network.observations.values(), "mark of a film"):
        marks.setdefault(calibration_name(network, o.photo), []).append(o)
    for i, (name, camera) in enumerate(zip(names, cameras, strict=True)):
        lens, own = camera.lens, marks.get(name)
        if own and isinstance(lens, FilmLens) and unknown[i].any():
            k = len(lens.names)
            film = np.array([(o.film_x, o.film_y) for o in own])
            measured = np.array([o.value for o in own])
            if not np.ptp(measured, axis=0).any():  # a plan, in which nothing is read yet
                continue
            values[i, :k] = start_of_interior_orientation(
                lens, values[i, :k], unknown[i, :k], film, measured
            )

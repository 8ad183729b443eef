"""Footprints of photos: where the edge of the sensor meets the ground."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..graph.variables import calibration_name
from ..models.inverse import directions
from ..report.plots.image_rows import ImageRows, image_rows
from ..solve.solution import Solution
from ..types import Array

STEPS = 8
"""Parts of each edge of the sensor: the distortion bends the edges of a footprint."""
FLATTEST = 0.05
"""Smallest sine of the angle between a ray and the ground; beyond it the photo looks over the
horizon, and has no footprint."""


@dataclass(frozen=True, eq=False)
class Footprints:
    """Footprints of the photos that have one."""

    names: list[str]
    """Names of the photos."""
    cameras: list[str]
    """Names of their cameras."""
    rings: list[Array | None]
    """Closed rings (m, 3), counter-clockwise seen from above, metres in the frame."""


def footprints(solution: Solution) -> Footprints:
    """Return the footprints of photos on the ground.

    The ground of a photo is the plane level at the mean of its object points, at the median of
    their heights. A photo without points has none, and so have photos that look along the ground
    (terrestrial and oblique ones with the horizon in the picture). The sensor is that of the
    camera, or the area of its image points where no format is stated.
    """
    network = solution.network
    rows = image_rows(solution)
    points = solution.state["point"]
    found = Footprints([], [], [])
    order = np.argsort(rows.photo, kind="stable")
    start = np.searchsorted(rows.photo[order], np.arange(len(network.photos) + 1))
    number = solution.equations.unknowns["pose"].number
    edges = {name: _edge(rows, name) for name in network.cameras}
    for name, photo in network.photos.items():
        i = number[name]
        seen = points[rows.point[order[start[i] : start[i + 1]]]]
        seen = seen[np.isfinite(seen).all(axis=1)]
        edge = edges[photo.camera]
        if not len(seen) or edge is None:
            continue
        ring = _ring(solution, name, i, edge, seen)
        if ring is not None:
            found.names.append(name)
            found.cameras.append(photo.camera)
            found.rings.append(ring)
    return found


def _edge(rows: ImageRows, camera: str) -> Array | None:
    """Return points of the edge of the sensor, (4 STEPS, 2) image units."""
    stated = rows.solution.network.cameras[camera]
    corners = stated.corners() or rows.areas.get(camera)
    if corners is None or not np.all(corners[1] > corners[0]):
        return None
    (left, low), (right, high) = corners
    around = np.array([[left, low], [right, low], [right, high], [left, high], [left, low]])
    t = np.arange(STEPS) / STEPS
    return np.concatenate([a + t[:, None] * (b - a) for a, b in pairwise(around)])


def _ring(solution: Solution, name: str, pose: int, edge: Array, seen: Array) -> Array | None:
    """Return the footprint of a photo; None if a ray does not meet the ground."""
    network, state = solution.network, solution.state
    lens = network.cameras[network.photos[name].camera].lens
    number = solution.number("calibration", calibration_name(network, name))
    k = state["calibration"][None, number, : len(lens.names)]
    stored = state["pose"][pose]
    rays = directions(lens, edge, k) @ stored[:9].reshape(3, 3).T
    middle = seen.mean(axis=0)
    east, north, up = network.frame.basis(middle[None], np.zeros((1, 2))).enu[0]
    ground = float(np.median((seen - middle) @ up))
    centre = stored[9:12]
    down = rays @ up
    below = ground - float((centre - middle) @ up)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = below / down
    if not (np.isfinite(t).all() and (t > 0).all() and (np.abs(down) > FLATTEST).all()):
        return None
    ring = centre + t[:, None] * rays
    x, y = (ring - centre) @ east, (ring - centre) @ north
    if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) < 0:
        ring = ring[::-1]
    return np.asarray(np.concatenate([ring, ring[:1]]))

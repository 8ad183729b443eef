"""Numerical radial triangulation: image points as directions in plan (FRAMES F14; method 16).

    v = atan2(E_j − E_i, N_j − N_i) − o_i − r_ij

Each photo i is a station in plan with unknown coordinates and orientation; its directions r_ij,
clockwise, are those from its radial centre to the images. Two control points in plan give scale and
rotation; no heights take part. The standard deviation of a direction is that of the image
coordinate across it over the radius, σ / r: rays near the radial centre weigh little, and those
nearer than ``least_radius`` are left out.

| radial centre | its directions are those on the ground |
| --- | --- |
| ``horizon`` | exactly, if the tilt is known: rays are turned to the horizon, from the nadir |
| ``nadir`` | of points in one vertical plane, whatever the relief; angles change by t²/4 at most |
| ``isocentre`` | on flat ground exactly |
| ``principal`` | up to t²/4 on flat ground; relief Δh adds (Δh / H) (c t / r) sin α |

The station in plan is the place on the ground that the radial centre shows. t is the tilt, α the
angle from the principal line. For all but the last the tilts of the photos must be known: those of
the poses are taken.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, TypeAlias, get_args

import numpy as np

from ..approximate.rays import read_rays
from ..errors import InputError, Problem, known
from ..graph.equations import compile_network
from ..network.network import Network
from ..observations import ControlPoint, Direction
from ..types import Array
from .relative import start_values

RadialCentre: TypeAlias = Literal["horizon", "nadir", "isocentre", "principal"]
"""Point of a photo from which its directions are taken."""
CENTRES: tuple[RadialCentre, ...] = get_args(RadialCentre)
LEAST_RADIUS = 0.05
"""Smallest radius of a ray, in principal distances."""
TO_PHOTO = np.array([1.0, -1.0, -1.0])
"""Signs from the axes of a camera (y down, z forward) to photogrammetric ones."""


def station_of(photo: str) -> str:
    """Return the name of the station in plan of a photo."""
    return f"centre {photo}"


def radial_observations(
    network: Network,
    *,
    centre: RadialCentre = "horizon",
    least_radius: float = LEAST_RADIUS,
) -> Network:
    """Turn the image points of a block into directions in plan.

    Args:
        network: a block of near-vertical photos in a frame whose x, y are the plan. Poses give
            approximate stations and tilts. Of the points, given coordinates, held and weighted
            components in plan, and control points in plan take part.
        centre: radial centre of the photos.
        least_radius: rays nearer to the radial centre are left out, principal distances.

    Returns:
        A network in plan: a point ``centre …`` for each photo, all heights held. Points with one
        direction that are not control are left out.

    Raises:
        InputError: an unknown radial centre, or a photo without an approximate pose.
    """
    if centre not in CENTRES:
        there = known(CENTRES, meant=str(centre))
        raise InputError(Problem(f"unknown radial centre {centre!r}; valid: {there}"))
    state = start_values(network)
    name = f"{network.name}, directions in plan"
    out = Network(name, frame=network.frame, datum=network.datum, crs=network.crs)
    for name, p in network.points.items():
        x, y = state["point"][network.point_number[name], :2].tolist()
        on = tuple(f or a == "z" for f, a in zip(p.fixed, "xyz", strict=True))
        sigma = None if p.sigma is None else (*p.sigma[:2], np.inf)
        out.points[name] = replace(
            p, coordinates=(x, y, 0.0), fixed=(on[0], on[1], on[2]), sigma=sigma
        )
        out.point_number[name] = len(out.point_number)
    for name in network.photos:
        pose = state["pose"][network.photo_number[name]]
        if np.isnan(pose).any():
            raise InputError(Problem("it has no approximate pose", f"photo {name!r}"))
        out.add_point(station_of(name), (float(pose[9]), float(pose[10]), 0.0), fixed="z")
    _add_directions(network, out, state["pose"], centre, least_radius)
    for o in network.observations.values():
        if isinstance(o, ControlPoint) and (axes := "".join(a for a in o.axes if a in "xy")):
            out.add(_in_plan(o, axes))
    seen = {p for o in out.observations.values() for p in o.points()}
    for name in [n for n in out.points if n not in seen]:
        del out.points[name]
    out.point_number = {n: i for i, n in enumerate(out.points)}
    return out


def _add_directions(
    network: Network, out: Network, poses: Array, centre: RadialCentre, least_radius: float
) -> None:
    """Add the directions of all image points."""
    rays = read_rays(compile_network(network))
    photo, point, _, sigmas = network.images.columns()
    sigma_of = {(i, j): s for i, j, s in zip(photo.tolist(), point.tolist(), sigmas, strict=True)}
    photos, points = list(network.photos), list(network.points)
    p = rays.direction / rays.direction[:, 2:] * TO_PHOTO  # (x, y, −c) / c
    rotation = poses[:, :9].reshape(-1, 3, 3)[rays.photo] * TO_PHOTO
    distance = np.array([network.cameras[f.camera].values[0] for f in network.photos.values()])
    angle, radius, across = directions_of(p, rotation, centre)
    far = radius >= least_radius
    observed = {o.point for o in network.observations.values() if isinstance(o, ControlPoint)}
    held = np.array(
        [
            all(p.fixed[:2]) or p.sigma is not None or n in observed
            for n, p in network.points.items()
        ]
    )
    enough = held | (np.bincount(rays.point[far], minlength=len(points)) >= 2)
    for k in np.flatnonzero(far & enough[rays.point]).tolist():
        i, j = int(rays.photo[k]), int(rays.point[k])
        a, b = across[k]
        sx, sy = sigma_of[i, j]
        sigma = float(np.hypot(a * sx, b * sy)) / float(distance[i])
        out.add(Direction(station_of(photos[i]), points[j], float(angle[k]), sigma=sigma))


def directions_of(p: Array, rotation: Array, centre: RadialCentre) -> tuple[Array, Array, Array]:
    """Return directions from a radial centre.

    Args:
        p: rays (x, y, −c) / c in photogrammetric axes, (n, 3).
        rotation: rotations from these axes to the object of their photos, (n, 3, 3).
        centre: the radial centre.

    Returns:
        Directions clockwise from +y in [0, 2π), (n,); radii in principal distances, (n,); partials
        of a direction by x / c and y / c, (n, 2).
    """
    down = -rotation[:, 2]  # the vertical in the axes of the photo
    if centre == "horizon":
        # Turn about a horizontal axis that makes the photo level and keeps its +y in its azimuth.
        x_axis, y_axis = _level_axes(rotation)
        level = np.stack([x_axis, y_axis, -down], axis=1)
        q = np.einsum("nij,nj->ni", level, p)
        planar = q[:, :2] / -q[:, 2:]
        slopes = (level[:, :2, :2] * -q[:, 2:, None] + q[:, :2, None] * level[:, 2:, :2]) / (
            q[:, 2:, None] ** 2
        )
    else:
        planar = p[:, :2] - _centre(down, centre)
        slopes = np.broadcast_to(np.eye(2), (len(p), 2, 2))
    squared = np.sum(planar**2, axis=1)
    radius = np.sqrt(squared)
    # r = atan2(x, y): ∂r/∂(x, y) = (y, −x) / r².
    safe = np.where(squared > 0, squared, 1.0)
    by_planar = np.stack([planar[:, 1], -planar[:, 0]], axis=1) / safe[:, None]
    across = np.einsum("ni,nij->nj", by_planar, slopes)
    return np.arctan2(planar[:, 0], planar[:, 1]) % (2 * np.pi), radius, across


def _level_axes(rotation: Array) -> tuple[Array, Array]:
    """Return horizontal axes, in those of the photo: y next to its +y, x to the right of it."""
    up = rotation[:, 2]
    y = np.array([0.0, 1.0, 0.0]) - up * up[:, 1:2]
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.cross(y, up), y


def _centre(down: Array, centre: RadialCentre) -> Array:
    """Return a radial centre in the photo, principal distances, (n, 2)."""
    nadir = down[:, :2] / -down[:, 2:]
    if centre == "principal":
        return np.zeros_like(nadir)
    if centre == "nadir":
        return np.asarray(nadir)
    tangent = np.linalg.norm(nadir, axis=1, keepdims=True)
    # The isocentre is tan(t/2) from the principal point, the nadir tan t.
    half = np.tan(0.5 * np.arctan(tangent))
    return np.asarray(nadir * np.divide(half, tangent, out=np.ones_like(half), where=tangent > 0))


def _in_plan(o: ControlPoint, axes: str) -> ControlPoint:
    """Return the coordinates in plan of a control point."""
    keep = [o.axes.index(a) for a in axes]
    covariance = None if o.covariance is None else o.covariance[np.ix_(keep, keep)]
    sigma = None if o.sigma is None else tuple(o.sigma[i] for i in keep)
    value = tuple(o.value[i] for i in keep)
    return replace(o, axes=axes, value=value, sigma=sigma, covariance=covariance, id=None)

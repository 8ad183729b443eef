"""Image rays; points by intersection, by one ray and a height or length, far ones at scene depth.

Two rays or more of photos of known pose intersect in space. A single ray determines a point
together with a height, a plan coordinate or a length (monoplotting). The depth of a point with
nearly parallel rays is that of the scene.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..models.inverse_lens import sight_lines
from ..models.lens import Lens
from ..models.refracted_rays import rays_behind_port
from ..models.rolling_shutter import Turns
from ..observations.refracted_images import THROUGH_INTERFACE
from ..types import Array, Index, Mask
from .intersection import MIN_COMPARED_MISFIT
from .search_state import SearchState
from .terrestrial_readings import group_median

GOOD_PARALLAX_RAD = 0.1
"""Smallest angle between rays, radians, of an intersection that is used at once."""
MIN_PARALLAX_RAD = 1e-3
"""Smallest angle between rays, radians, at which the rays determine a point."""
REWEIGHTINGS = 5
"""Number of reweighting steps towards the least sum of misses if a ray misses by much."""


@dataclass(frozen=True)
class ImageRays:
    """Rays of all image points in the axes of their cameras."""

    photo: Index
    """Number of the photo, (n,)."""
    point: Index
    """Number of the point, (n,)."""
    direction: Array
    """Unit vectors in camera axes (x right, y down, z forward), (n, 3)."""
    start: Array
    """Where they begin in camera axes, metres, (n, 3): zero but for lens models of places."""
    shift: Array
    """Shift of the projection centre since the middle row, axes of the network, metres, (n, 3)."""


def read_rays(equations: Equations) -> ImageRays:
    """Turn the image coordinates of a network into rays.

    Rays through a surface of the object are taken as straight: the points then are where they seem
    to be, the bottom of a lake at three quarters of its depth. Rays through the port of a camera
    are those beyond it.
    """
    photos, points = [np.zeros(0, np.intp)], [np.zeros(0, np.intp)]
    starts, found, shifts = ([np.zeros((0, 3))] for _ in range(3))
    for block in equations.blocks:
        lens = block.lens or _lens_beyond_interface(equations, block)
        if lens is None:
            continue
        k = len(lens.names)
        values = equations.unknowns["calibration"].values
        (_, photo), (_, number), (_, point), *others = block.arguments
        calibration = values[:, :k] if len(values) == 1 else values[number, :k]
        start, rays = sight_lines(lens, block.observed, calibration)
        index = dict(others)
        if "port" in index:
            beyond = ("port", "refractive_index")
            port, n = (equations.unknowns[kind].values[index[kind]] for kind in beyond)
            start, rays = rays_behind_port(rays, port, n)
        shift = np.zeros_like(rays)
        if block.readout is not None:
            motion = equations.unknowns["photo_motion"].values[index["photo_motion"]]
            time = block.readout.times(*block.observed.T)
            turns, shift = Turns.of(motion[:, : block.readout.components], time)
            start, rays = (np.einsum("nij,nj->ni", turns.matrix, d) for d in (start, rays))
        photos.append(photo)
        points.append(point)
        starts.append(start)
        found.append(rays)
        shifts.append(shift)
    return ImageRays(
        np.concatenate(photos),
        np.concatenate(points),
        np.concatenate(found),
        np.concatenate(starts),
        np.concatenate(shifts),
    )


def _lens_beyond_interface(equations: Equations, block: Block) -> Lens | None:
    """Return the lens of image points that are seen through an interface; None: others."""
    if block.quantity != THROUGH_INTERFACE:
        return None
    network = equations.network
    photo = equations.unknowns["pose"].names[block.arguments[0][1][0]]
    return network.cameras[network.photos[photo].camera].lens


def posed_photos(progress: SearchState) -> Mask:
    """Return the photos whose pose is known, (f,)."""
    return np.asarray(np.isfinite(progress.pose).all(axis=1))


def world_rays(progress: SearchState, rays: ImageRays, rows: Index) -> tuple[Array, Array]:
    """Return starts and unit vectors in the frame, (n, 3) each, of some rays."""
    pose = progress.pose[rays.photo[rows]]
    r = pose[:, :9]

    def turned(seen: Array) -> Array:
        return r[:, 0::3] * seen[:, :1] + r[:, 1::3] * seen[:, 1:2] + r[:, 2::3] * seen[:, 2:]

    start, centre = rays.start[rows], pose[:, 9:] + rays.shift[rows]
    return centre + turned(start) if start.any() else centre, turned(rays.direction[rows])


def nearest_to_rays(
    centre: Array, direction: Array, group: Index, n: int, weight: Array | None = None
) -> tuple[Array, Array]:
    """Return the point nearest to the rays of each group, and the strength of its intersection.

    Minimises Σ w |(I − d dᵀ)(X − X₀)|².

    Args:
        centre: X₀, (m, 3), metres.
        direction: unit vectors d, (m, 3).
        group: number of the group of each ray, (m,).
        n: number of groups.
        weight: w, (m,); none: 1.

    Returns:
        X (n, 3), metres, NaN where the rays are parallel, and the strength: the angle between two
        rays that would be as strong, radians, √(2 λ/m) with the smallest eigenvalue λ of the
        normal matrix.
    """
    w = np.ones(len(group)) if weight is None else weight
    shift = centre.mean(axis=0) if len(centre) else np.zeros(3)
    x0 = centre - shift
    along = np.einsum("ni,ni->n", direction, x0)
    normal = np.empty((n, 3, 3))
    right = np.empty((n, 3))
    for i in range(3):
        wd = w * direction[:, i]
        right[:, i] = np.bincount(group, w * x0[:, i] - wd * along, n)
        for j in range(i, 3):
            off = np.bincount(group, -wd * direction[:, j] + (w if i == j else 0.0), n)
            normal[:, i, j] = normal[:, j, i] = off
    count = np.bincount(group, w, n)
    # Eigenvalues lie in [0, m]; if two are near m, the determinant gives the smallest one.
    a, b, c = normal[:, 0], normal[:, 1], normal[:, 2]
    ab, bc, ca = np.cross(a, b), np.cross(b, c), np.cross(c, a)
    det = np.einsum("ni,ni->n", a, bc)
    largest = ab[:, 2] + bc[:, 0] + ca[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (bc * right[:, :1] + ca * right[:, 1:2] + ab * right[:, 2:]) / det[:, None]
        strength = np.sqrt(np.maximum(2.0 * det / (largest * count), 0.0))
    strength = np.nan_to_num(strength)
    x[strength <= 1e-7] = np.nan
    return x + shift, strength


def _misses(x: Array, centre: Array, direction: Array) -> tuple[Array, Array]:
    """Return depths along the rays (n,) and distances from the rays relative to the depth, (n,)."""
    d = x - centre
    depth = np.einsum("ni,ni->n", d, direction)
    off = np.sqrt(np.maximum(np.einsum("ni,ni->n", d, d) - depth**2, 0.0))
    return depth, np.asarray(off / np.maximum(np.abs(depth), 1e-12))


def intersect_rays(
    progress: SearchState, rays: ImageRays, *, parallax: float = GOOD_PARALLAX_RAD, wanted: Mask
) -> bool:
    """Fill unknown points that two or more photos of known pose see.

    If a ray misses by much, the point with the least sum of misses is used. A point must lie in
    front of the photos.

    Args:
        progress: is filled.
        rays: the image rays.
        parallax: smallest strength of an intersection, radians, see `nearest_to_rays`.
        wanted: points to intersect, (n,).

    Returns:
        Whether any point was found.
    """
    rows = np.flatnonzero(wanted[rays.point] & posed_photos(progress)[rays.photo])
    if not len(rows):
        return False
    count = np.bincount(rays.point[rows], minlength=len(wanted))
    rows = rows[count[rays.point[rows]] >= 2]
    if not len(rows):
        return False
    points = np.flatnonzero(count >= 2)
    number = np.zeros(len(wanted), dtype=np.intp)
    number[points] = np.arange(len(points))
    group = number[rays.point[rows]]
    centre, direction = world_rays(progress, rays, rows)
    x, strength = nearest_to_rays(centre, direction, group, len(points))

    depth, miss = _misses(x[group], centre, direction)
    typical = float(np.nanmedian(miss)) if np.isfinite(miss).any() else 0.0
    bad = (miss > 10.0 * typical + 1e-9) & (count[rays.point[rows]] >= 3)
    if bad.any():
        again = np.unique(group[bad])
        position = np.full(len(points), -1, dtype=np.intp)
        position[again] = np.arange(len(again))
        part = np.flatnonzero(position[group] >= 0)
        own = position[group[part]]
        for _ in range(REWEIGHTINGS):
            weight = 1.0 / np.maximum(miss[part], typical + 1e-12)
            weight /= np.bincount(own, weight)[own]
            x[again], _ = nearest_to_rays(centre[part], direction[part], own, len(again), weight)
            _, miss[part] = _misses(x[group[part]], centre[part], direction[part])
        depth, _ = _misses(x[group], centre, direction)
    in_front = np.bincount(group, depth > 0, len(points)) > 0.5 * np.bincount(
        group, minlength=len(points)
    )
    good = in_front & (strength >= parallax) & np.isfinite(x).all(axis=1)
    if not good.any():
        return False
    plan = progress.horizon.to_plan(x[good])
    placed = progress.set_plan(points[good], plan[:, :2])
    return progress.set_height(points[good], plan[:, 2]) or placed


def intersect_single_rays(progress: SearchState, rays: ImageRays) -> bool:
    """Fill points that one ray of a known photo and a height, a plan or a length determine.

    Returns:
        Whether any point was found.
    """
    rows = np.flatnonzero(~progress.complete[rays.point] & posed_photos(progress)[rays.photo])
    if not len(rows):
        return False
    _, first = np.unique(rays.point[rows], return_index=True)
    rows = rows[first]
    # Of many points that only rays reach, none has a length or a known component.
    edges = progress.survey.edges
    helped: Mask = np.any(np.isfinite(progress.plan), axis=1)
    helped[edges.a] = helped[edges.b] = True
    rows = rows[helped[rays.point[rows]]]
    if not len(rows):
        return False
    centre, direction = world_rays(progress, rays, rows)
    found_any = False
    for p, x0, d in zip(rays.point[rows].tolist(), centre, direction, strict=True):
        plan = progress.plan[p]
        ends = progress.horizon.to_plan(np.stack([x0, x0 + d]))
        step = ends[1] - ends[0]
        known = np.isfinite(plan)
        s = (
            _depth_by_components(ends[0], step, plan, known)
            if known.any()
            else _depth_by_lengths(progress, p, x0, d)
        )
        if s > 0:
            at = progress.horizon.to_plan((x0 + s * d)[None])
            placed = progress.set_plan(np.array([p]), at[:, :2])
            found_any |= progress.set_height(np.array([p]), at[:, 2]) or placed
    return found_any


def _depth_by_components(start: Array, step: Array, plan: Array, known: Mask) -> float:
    """Return the distance along the ray to its point nearest to the known components."""
    length2 = float(np.sum(step[known] ** 2))
    if length2 < 1e-4:
        return np.nan
    return float(np.sum((plan - start)[known] * step[known]) / length2)


def _depth_by_lengths(progress: SearchState, p: int, x0: Array, d: Array) -> float:
    """Return the distance along the ray at which slope distances to known points fit."""
    e = progress.survey.edges
    complete = progress.complete
    other = np.where(e.a == p, e.b, e.a)
    rows = np.flatnonzero(((e.a == p) | (e.b == p)) & np.isfinite(e.slope) & complete[other])
    if not len(rows):
        return np.nan
    to = progress.horizon.from_plan(progress.plan[other[rows]]) - x0
    foot = to @ d
    gap2 = np.sum(to * to, axis=1) - foot**2
    half = np.sqrt(np.maximum(e.slope[rows] ** 2 - gap2, 0.0))
    options = np.concatenate([foot - half, foot + half])
    options = options[options > 0]
    if not len(options):
        return np.nan
    at = x0 + options[:, None] * d
    known = x0 + to
    off = np.abs(np.linalg.norm(at[:, None] - known[None], axis=2) - e.slope[rows]).mean(axis=1)
    best = int(np.argmin(off))
    apart = np.abs(options - options[best]) > 0.02 * e.slope[rows].max()
    if np.any(off[apart] < 3 * off[best] + MIN_COMPARED_MISFIT * e.slope[rows].max()):
        return np.nan
    return float(options[best])


def place_far_points(progress: SearchState, rays: ImageRays) -> bool:
    """Place points with nearly parallel rays, or behind the photos, at the depth of the scene.

    Two or more rays determine the position of such a point across the rays. Noise hides the depth;
    the median depth of the known points of the photos replaces it. An adjustment improves the
    depth, or reports that the point is not determined.

    Returns:
        Whether any point was found.
    """
    complete = progress.complete
    usable = posed_photos(progress)[rays.photo]
    rows = np.flatnonzero(usable & ~complete[rays.point])
    rows = rows[np.bincount(rays.point[rows], minlength=len(complete))[rays.point[rows]] >= 2]
    seen = np.flatnonzero(usable & complete[rays.point])
    if not len(rows) or not len(seen):
        return False
    centre, direction = world_rays(progress, rays, seen)
    x = progress.horizon.from_plan(progress.plan[rays.point[seen]])
    distance = np.einsum("ni,ni->n", x - centre, direction)
    scene = group_median(rays.photo[seen], distance, len(progress.pose))
    scene = np.where(scene > 0, scene, np.median(np.abs(distance)))
    centre, direction = world_rays(progress, rays, rows)
    at = centre + scene[rays.photo[rows]][:, None] * direction
    points = np.unique(rays.point[rows])
    number = np.searchsorted(points, rays.point[rows])
    count = np.bincount(number)
    mean = np.stack([np.bincount(number, at[:, c]) / count for c in range(3)], 1)
    plan = progress.horizon.to_plan(mean)
    placed = progress.set_plan(points, plan[:, :2])
    return progress.set_height(points, plan[:, 2]) or placed

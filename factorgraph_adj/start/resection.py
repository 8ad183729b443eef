"""Resection of photos and of instruments in frames; points by intersection of instruments.

Three points each give candidate poses (Grunert's quartic, as in Haralick et al. 1994, eqs. 8–10),
without a special case for points in a plane. The best candidate has the smallest misses of all
known points of the photo, on the side of their rays; Gauss-Newton on the unit vectors of the rays
refines it. If the projection centre or the attitude is given, the other follows directly.

An instrument that stands on a known point is turned to its targets; any other one is placed by a
resection from four points or more. The sights of two known instruments or more intersect.
"""

from __future__ import annotations

import numpy as np

from ..models.base import circular_mean
from ..models.sub_frame import horizons, split_frame
from ..rotation import exp_rotation, log_rotation, nearest_rotation
from ..types import Array, Index, Mask
from .frame_places import FramePlaces, frame_horizon, frame_origins
from .image_rays import ImageRays, nearest_to_rays, posed_photos
from .search_state import SearchState

MAX_TRIPLES_OF_PHOTO = 60
"""Largest number of triples of points that are tried for one photo."""
MAX_SCORED_POINTS = 60
"""Largest number of points by which candidates are compared."""
MAX_RAY_MISS_RAD = 0.02
"""Miss of a ray, radians, above which an image point does not support a pose."""
MIN_POINTS_OF_UNIQUE_POSE = 8
"""Number of points from which a pose that fits well is unique."""
MIN_SIGHTS_OF_INSTRUMENT = 4
"""Smallest number of known points of a resection in space."""
MIN_SINE_BETWEEN_SIGHTS = 1e-3
"""Smallest sine of the angle between two sights that fix a rotation."""


def three_point_poses(x: Array, d: Array) -> tuple[Array, Array]:
    """Return the poses from which three points appear in given directions.

    Args:
        x: points, (m, 3, 3): m triples of points.
        d: unit vectors to the points in camera axes, (m, 3, 3).

    Returns:
        world_R_camera (k, 3, 3) and projection centres (k, 3) of all real solutions.
    """
    a2 = np.sum((x[:, 1] - x[:, 2]) ** 2, axis=1)
    b2 = np.sum((x[:, 0] - x[:, 2]) ** 2, axis=1)
    c2 = np.sum((x[:, 0] - x[:, 1]) ** 2, axis=1)
    ca, cb, cg = (np.sum(d[:, i] * d[:, j], axis=1) for i, j in ((1, 2), (0, 2), (0, 1)))
    with np.errstate(divide="ignore", invalid="ignore"):
        q, ra, rc = (a2 - c2) / b2, a2 / b2, c2 / b2
        s = ra + rc
        quartic = np.stack(
            [
                (q - 1) ** 2 - 4 * rc * ca**2,
                4 * (q * (1 - q) * cb - (1 - s) * ca * cg + 2 * rc * ca**2 * cb),
                2
                * (
                    q**2
                    - 1
                    + 2 * q**2 * cb**2
                    + 2 * (1 - rc) * ca**2
                    - 4 * s * ca * cb * cg
                    + 2 * (1 - ra) * cg**2
                ),
                4 * (-q * (1 + q) * cb + 2 * ra * cg**2 * cb - (1 - s) * ca * cg),
                (1 + q) ** 2 - 4 * ra * cg**2,
            ],
            1,
        )
    usable = np.isfinite(quartic).all(axis=1) & (
        np.abs(quartic[:, 0]) > 1e-12 * np.abs(quartic).max(axis=1)
    )
    quartic, q, ca, cb, cg, b2, x, d = (v[usable] for v in (quartic, q, ca, cb, cg, b2, x, d))
    companion = np.zeros((len(x), 4, 4))
    companion[:, 0] = -quartic[:, 1:] / quartic[:, :1]
    companion[:, [1, 2, 3], [0, 1, 2]] = 1.0
    roots = np.linalg.eigvals(companion)
    # Noise moves a double root off the real axis; its real part still serves as a start.
    v = np.where(np.abs(roots.imag) < 0.05 * np.abs(roots), roots.real, np.nan)
    ca, cb, cg, q, b2 = (w[:, None] for w in (ca, cb, cg, q, b2))
    with np.errstate(divide="ignore", invalid="ignore"):
        u = ((q - 1) * v**2 - 2 * q * cb * v + 1 + q) / (2 * (cg - v * ca))
        s1 = np.sqrt(b2 / (1 + v**2 - 2 * v * cb))
        sides = np.stack([s1, u * s1, v * s1], -1)
    triple, which = np.nonzero(np.isfinite(sides).all(axis=2) & (sides > 0).all(axis=2))
    if not len(triple):
        return np.zeros((0, 3, 3)), np.zeros((0, 3))
    seen = sides[triple, which][:, :, None] * d[triple]
    return rotation_and_shift(seen, x[triple])


def rotation_and_shift(camera: Array, world: Array) -> tuple[Array, Array]:
    """Return R (k, 3, 3) and X₀ (k, 3) of world = R camera + X₀ by least squares, (k, m, 3)."""
    mc, mw = camera.mean(axis=1), world.mean(axis=1)
    h = np.swapaxes(camera - mc[:, None], 1, 2) @ (world - mw[:, None])
    r = np.swapaxes(nearest_rotation(h), 1, 2)
    return r, mw - np.einsum("kij,kj->ki", r, mc)


def direction_misses(r: Array, x0: Array, x: Array, d: Array) -> Array:
    """Return how far directions to points miss rays d, (k, n); infinite for opposite ones.

    The miss is the chord between both unit vectors, for small misses the angle in radians.
    """
    p = np.einsum("kij,kni->knj", r, x[None] - x0[:, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        u = p / np.sqrt(np.einsum("kni,kni->kn", p, p))[..., None]
        miss = np.sqrt(np.einsum("kni,kni->kn", u - d, u - d))
    return np.where(miss < np.sqrt(2.0), miss, np.inf)  # not NaN


def _refine(r: Array, x0: Array, x: Array, d: Array, iterations: int = 10) -> tuple[Array, Array]:
    """Refine a pose r (3, 3), x0 (3,) by Gauss-Newton on rays; large misses get low weights."""
    for _ in range(iterations):
        p = (x - x0) @ r
        length = np.sqrt(np.einsum("ni,ni->n", p, p))
        u = p / np.where(length > 0, length, np.inf)[:, None]
        same = np.einsum("ni,ni->n", u, d) > 0
        if not same.any():
            break
        v = u - d
        size = np.sqrt(np.einsum("ni,ni->n", v, v))
        cut = max(2.0 * float(np.median(size)), 1e-9)
        w = np.where(same, np.minimum(1.0, cut / np.maximum(size, 1e-15)), 0.0)
        by_p = np.eye(3) - u[:, :, None] * u[:, None]
        by_p /= np.where(length > 0, length, np.inf)[:, None, None]
        cross = np.zeros((len(x), 3, 3))  # ∂p/∂ω = [p]×
        cross[:, 0, 1], cross[:, 0, 2] = -p[:, 2], p[:, 1]
        cross[:, 1, 0], cross[:, 1, 2] = p[:, 2], -p[:, 0]
        cross[:, 2, 0], cross[:, 2, 1] = -p[:, 1], p[:, 0]
        j = np.concatenate([by_p @ cross, -by_p @ r.T], axis=2)
        jw = (j * w[:, None, None]).reshape(-1, 6)
        scale = np.sqrt(np.sum(jw * jw, axis=0)) + 1e-300
        step = np.linalg.lstsq(jw / scale, -(v * w[:, None]).ravel(), rcond=1e-10)[0] / scale
        turn = float(np.linalg.norm(step[:3]))
        step *= min(1.0, 0.5 / max(turn, 1e-300))
        r, x0 = r @ exp_rotation(step[:3]), x0 + step[3:]
        if turn < 1e-10:
            break
    return r, x0


def point_triples(n: int) -> Index:
    """Return triples (m, 3) of n points: all triples of few points, else seeded random ones."""
    every = np.array(
        [
            (i, j, k)
            for i in range(min(n, 9))
            for j in range(i + 1, min(n, 9))
            for k in range(j + 1, min(n, 9))
        ]
    )
    if n <= 8 and len(every) <= MAX_TRIPLES_OF_PHOTO:
        return every
    generator = np.random.default_rng(n)
    drawn = np.sort(generator.integers(0, n, (2 * MAX_TRIPLES_OF_PHOTO, 3)), axis=1)
    distinct = (drawn[:, 0] < drawn[:, 1]) & (drawn[:, 1] < drawn[:, 2])
    return drawn[distinct][:MAX_TRIPLES_OF_PHOTO]


def resect(x: Array, d: Array) -> tuple[Array, Array] | None:
    """Return world_R_camera and projection centre of a photo that sees known points.

    Args:
        x: points, (n, 3), metres, n ≥ 4.
        d: unit vectors of their rays in the axes of the camera, (n, 3).

    Returns:
        The pose that most points support; none: too few points support it.
    """
    rng = np.random.default_rng(len(x))
    if len(x) > 4 * MAX_SCORED_POINTS:
        chosen = np.sort(rng.choice(len(x), 4 * MAX_SCORED_POINTS, replace=False))
        x, d = x[chosen], d[chosen]
    middle = x.mean(axis=0)
    x = x - middle
    triples = point_triples(len(x))
    r, x0 = three_point_poses(x[triples], d[triples])
    if not len(r):
        return None
    scored = (
        np.arange(len(x))
        if len(x) <= MAX_SCORED_POINTS
        else rng.choice(len(x), MAX_SCORED_POINTS, replace=False)
    )
    miss = np.minimum(direction_misses(r, x0, x[scored], d[scored]), 10 * MAX_RAY_MISS_RAD).mean(
        axis=1
    )
    best = np.argsort(miss)[:4].tolist()
    poses: list[tuple[Array, Array]] = []
    missed: list[Array] = []
    for k in best:
        poses.append(_refine(r[k], x0[k], x, d))
        turned, centre = poses[-1]
        missed.append(
            np.minimum(direction_misses(turned[None], centre[None], x, d)[0], 10 * MAX_RAY_MISS_RAD)
        )
        if len(x) >= MIN_POINTS_OF_UNIQUE_POSE and missed[-1].mean() < MAX_RAY_MISS_RAD / 10:
            break
    winner = int(np.argmin([m.mean() for m in missed]))
    support = int(np.count_nonzero(missed[winner] < MAX_RAY_MISS_RAD))
    if support < max(4, len(x) // 2):
        return None
    return poses[winner][0], poses[winner][1] + middle


def resect_photos(progress: SearchState, rays: ImageRays, *, least: int) -> bool:
    """Fill the poses of photos that see ``least`` or more known points.

    Returns:
        Whether any pose was found.
    """
    open_ = ~posed_photos(progress)
    if not open_.any():
        return False
    complete = progress.complete
    rows = np.flatnonzero(open_[rays.photo] & complete[rays.point])
    if not len(rows):
        return False
    rows = rows[np.argsort(rays.photo[rows], kind="stable")]
    photos, first = np.unique(rays.photo[rows], return_index=True)
    found = False
    for photo, own in zip(photos, np.split(rows, first[1:]), strict=True):
        x = progress.horizon.from_plan(progress.plan[rays.point[own]])
        pose = resected_pose(progress.pose[photo], x, rays.direction[own], least)
        if pose is not None:
            progress.pose[photo] = pose
            found = True
    return found


def resected_pose(given: Array, x: Array, d: Array, least: int) -> Array | None:
    """Return the pose (12,) of one photo, given components kept; none: it cannot be found.

    Args:
        given: stored pose, (12,), NaN where unknown. With a given projection centre or attitude
            two rays are enough.
        x: points, (n, 3).
        d: unit vectors of their rays in the axes of the camera, (n, 3).
        least: smallest number of rays of a photo of which nothing is given.
    """
    r, x0 = given[:9].reshape(3, 3), given[9:]
    if np.isfinite(r).all():
        # With known attitude, the centre is nearest to the reversed rays from the points.
        if len(x) < 2:
            return None
        at, strength = nearest_to_rays(x, d @ r.T, np.zeros(len(x), dtype=np.intp), 1)
        if strength[0] < 1e-3:
            return None
        return np.concatenate([given[:9], np.where(np.isnan(x0), at[0], x0)])
    if np.isfinite(x0).all() and len(x) >= 2:
        to = x - x0
        to /= np.linalg.norm(to, axis=1, keepdims=True)
        if np.linalg.norm(np.cross(to[0], to), axis=1).max() > 1e-3:
            return np.concatenate([nearest_rotation(d.T @ to).T.ravel(), x0])
    if len(x) < least:
        return None
    pose = resect(x, d)
    if pose is None:
        return None
    centre = np.where(np.isnan(x0), pose[1], x0)
    return np.concatenate([pose[0].ravel(), centre])


def orient_frames(progress: SearchState, seen: FramePlaces) -> bool:
    """Turn frames whose instrument stands on a known place; return whether any was turned."""
    filled = False
    origins = frame_origins(progress, seen)
    for f, rows in _open_frames(progress, seen):
        given = seen.given[f]
        if not np.isfinite(origins[f]).all() or np.any(given[3:6] != 0.0):
            continue
        y = _directions_to(progress, seen, f, rows, origins[f])
        found = _instrument_rotation(y, seen.sights.value[rows], seen.sights.unit[rows], given)
        if found is not None:
            _fill_frame(progress, f, found, given[3:6], given)
            filled = True
    return filled


def resect_frames(progress: SearchState, seen: FramePlaces) -> bool:
    """Place instruments by resection from known points; return whether any was placed."""
    filled = False
    origins = frame_origins(progress, seen)
    unit = seen.sights.unit
    for f, rows in _open_frames(progress, seen):
        own = rows[np.isfinite(unit[rows]).all(axis=1)]
        given = seen.given[f]
        if len(own) < MIN_SIGHTS_OF_INSTRUMENT or (
            seen.origin[f] >= 0 and np.any(given[3:6] != 0.0)
        ):
            continue
        x = progress.horizon.from_plan(progress.plan[seen.sights.point[own]])
        # In the axes of the horizon, because those of the network may be left-handed.
        middle = x.mean(axis=0)
        nearby = frame_horizon(progress, f, middle)
        pose = resect_instrument((x - middle) @ nearby.T, unit[own])
        if pose is None:
            continue
        turned, centre = pose[0], middle + nearby.T @ pose[1]
        known = np.isfinite(origins[f]).all()
        if not known:  # the instrument stands on its point
            plan = progress.horizon.to_plan(centre[None])
            progress.set_plan(seen.origin[f : f + 1], plan[:, :2])
            progress.set_height(seen.origin[f : f + 1], plan[:, 2])
        at = origins[f] if known else centre
        if not np.isnan(given[:2]).any():
            tilt = exp_rotation(np.array([[given[0], given[1], 0.0]]))[0]
            left = log_rotation((tilt.T @ turned)[None])[0, 2]
            turn = given[2] if np.isfinite(given[2]) else left
            turned = tilt @ exp_rotation(np.array([[0.0, 0.0, turn]]))[0]
        scale = np.exp(-given[6]) if np.isfinite(given[6]) else 1.0
        offset = scale * turned.T @ (frame_horizon(progress, f, at) @ (centre - at))
        offset = np.where(np.isnan(given[3:6]), offset, given[3:6])
        _fill_frame(progress, f, turned, offset, given)
        filled = True
    return filled


def intersect_sights(progress: SearchState, seen: FramePlaces, *, parallax: float) -> bool:
    """Fill points that two known frames or more sight; return whether any was filled.

    Args:
        progress: is filled.
        seen: the sights.
        parallax: smallest strength of an intersection, radians, see `nearest_to_rays`.
    """
    sights = seen.sights
    known: Mask = np.all(np.isfinite(progress.frame), axis=1)
    origins = frame_origins(progress, seen)
    known &= np.isfinite(origins).all(axis=1)
    rows = np.flatnonzero(known[sights.frame] & ~progress.complete[sights.point])
    rows = rows[np.isfinite(sights.unit[rows]).all(axis=1)]
    if not len(rows):
        return False
    points, group = np.unique(sights.point[rows], return_inverse=True)
    stored = progress.frame[sights.frame[rows]]
    rotation, offset, ln_scale, _, level = split_frame(stored)
    at = origins[sights.frame[rows]]
    horizon = horizons(progress.horizon.frame.basis(at, np.zeros((len(at), 2))), level)
    to_object = horizon.transpose(0, 2, 1) @ rotation
    centre = at + np.exp(ln_scale)[:, None] * (to_object @ offset[:, :, None])[:, :, 0]
    direction = (to_object @ sights.unit[rows][:, :, None])[:, :, 0]
    x, strength = nearest_to_rays(centre, direction, group, len(points))
    ahead = np.einsum("ni,ni->n", x[group] - centre, direction) > 0
    good = np.bincount(group, ahead, len(points)) > 0.5 * np.bincount(group)
    good &= (strength >= parallax) & np.isfinite(x).all(axis=1)
    if not good.any():
        return False
    plan = progress.horizon.to_plan(x[good])
    placed = progress.set_plan(points[good], plan[:, :2])
    return progress.set_height(points[good], plan[:, 2]) or placed


def start_frame(progress: SearchState, seen: FramePlaces) -> bool:
    """Give the frame with the most whole sights an arbitrary place, if nothing is known.

    Returns:
        Whether that was done.
    """
    if progress.placed.any() or not len(seen.frame) or np.isfinite(progress.pose).any():
        return False
    whole = np.isfinite(seen.q).all(axis=1) & (seen.point >= 0)
    count = np.bincount(seen.frame[whole], minlength=len(seen.given))
    scaled = ~np.isnan(seen.given[:, 6])
    f = int(np.argmax(np.where(scaled, count, 0)))
    if count[f] < 3 or not scaled[f] or np.isfinite(progress.frame[:, :13]).all(axis=1).any():
        return False
    given = np.nan_to_num(seen.given[f])
    if seen.origin[f] >= 0:
        progress.set_plan(seen.origin[f : f + 1], np.zeros((1, 2)))
        progress.set_height(seen.origin[f : f + 1], np.zeros(1))
    _fill_frame(progress, f, exp_rotation(given[None, :3])[0], given[3:6], given)
    return True


def resect_instrument(x: Array, unit: Array) -> tuple[Array, Array] | None:
    """Return the rotation (3, 3), instrument → object, and the place (3,) of an instrument.

    Args:
        x: points that it sights, (n, 3), n ≥ 4.
        unit: unit vectors to them in its axes, (n, 3).

    Returns:
        The position that most sights support; none: too few of them support it.
    """
    rng = np.random.default_rng(len(x))
    if len(x) > 4 * MAX_SCORED_POINTS:
        chosen = np.sort(rng.choice(len(x), 4 * MAX_SCORED_POINTS, replace=False))
        x, unit = x[chosen], unit[chosen]
    middle = x.mean(axis=0)
    some = point_triples(len(x))
    rotations, centres = three_point_poses((x - middle)[some], unit[some])
    if not len(rotations):
        return None
    to = (x - middle)[None] - centres[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        to /= np.linalg.norm(to, axis=2, keepdims=True)
    miss = np.linalg.norm(to @ rotations - unit, axis=2)
    miss = np.where(
        np.isfinite(miss), np.minimum(miss, 10 * MAX_RAY_MISS_RAD), 10 * MAX_RAY_MISS_RAD
    )
    best = int(np.argmin(miss.mean(axis=1)))
    if np.count_nonzero(miss[best] < MAX_RAY_MISS_RAD) < max(MIN_SIGHTS_OF_INSTRUMENT, len(x) // 2):
        return None
    return rotations[best], centres[best] + middle


def _open_frames(progress: SearchState, seen: FramePlaces) -> list[tuple[int, Index]]:
    """Return the frames that are not known, and their sights to known points."""
    sights = seen.sights
    missing: Mask = np.any(np.isnan(progress.frame), axis=1)
    if not len(sights.frame) or not missing.any():
        return []
    rows = np.flatnonzero(missing[sights.frame] & progress.complete[sights.point])
    if not len(rows):
        return []
    rows = rows[np.argsort(sights.frame[rows], kind="stable")]
    frames, first = np.unique(sights.frame[rows], return_index=True)
    return list(zip(frames.tolist(), np.split(rows, first[1:]), strict=True))


def _directions_to(
    progress: SearchState, seen: FramePlaces, f: int, rows: Index, at: Array
) -> Array:
    """Return unit vectors from ``at`` to the points of sights, in its horizon, (n, 3)."""
    x = progress.horizon.from_plan(progress.plan[seen.sights.point[rows]])
    y = (x - at) @ frame_horizon(progress, f, at).T
    length = np.linalg.norm(y, axis=1, keepdims=True)
    return np.asarray(y / np.where(length > 0, length, np.nan))


def _instrument_rotation(y: Array, value: Array, unit: Array, given: Array) -> Array | None:
    """Return R of an instrument from directions in the horizon; none: they do not fix it.

    Args:
        y: unit vectors from the instrument in its horizon, (n, 3).
        value: directions, zenith angles and distances, (n, 3).
        unit: unit vectors in the axes of the instrument, (n, 3).
        given: given components of the frame, (7,).
    """
    if not np.isnan(given[:2]).any():
        tilt = exp_rotation(np.array([[given[0], given[1], 0.0]]))[0]
        there = y @ tilt
        turn = np.arctan2(there[:, 1], there[:, 0]) - (np.pi / 2 - value[:, 0])
        turn = turn[np.isfinite(turn)]
        if not len(turn):
            return None
        kappa = given[2] if np.isfinite(given[2]) else float(circular_mean(turn))
        return np.asarray(tilt @ exp_rotation(np.array([[0.0, 0.0, kappa]]))[0])
    sound = np.isfinite(unit).all(axis=1) & np.isfinite(y).all(axis=1)
    a, b = unit[sound], y[sound]
    if len(a) < 2 or np.linalg.norm(np.cross(a[0], a), axis=1).max() < MIN_SINE_BETWEEN_SIGHTS:
        return None
    return nearest_rotation(b.T @ a)


def _fill_frame(
    progress: SearchState, f: int, rotation: Array, offset: Array, given: Array
) -> None:
    """Fill rotation, offset and scale of a frame; a scale that sights do not tell is 1."""
    ln_scale = given[6] if np.isfinite(given[6]) else 0.0
    progress.frame[f, :13] = np.concatenate([rotation.ravel(), offset, [ln_scale]])

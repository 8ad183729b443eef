"""Photos by resection from known points.

Three points each give candidate poses (Grunert's quartic, as in Haralick et al. 1994, eqs. 8–10),
without a special case for points in a plane. The best candidate has the smallest misses of all
known points of the photo, on the side of their rays; Gauss-Newton on the unit vectors of the rays
refines it. If the projection centre or the attitude is given, the other follows directly.
"""

from __future__ import annotations

import numpy as np

from ..rotation import exp_rotation
from ..types import Array, Index
from .progress import Progress
from .rays import ImageRays, nearest_to_rays, posed

TRIPLES = 60
"""Largest number of triples of points that are tried for one photo."""
SCORED = 60
"""Largest number of points by which candidates are compared."""
FITS = 0.02
"""Miss of a ray, radians, above which an image point does not support a pose."""
MANY = 8
"""Number of points from which a pose that fits well is unique."""


def three_points(x: Array, d: Array) -> tuple[Array, Array]:
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
    return turn_and_shift(seen, x[triple])


def turn_and_shift(camera: Array, world: Array) -> tuple[Array, Array]:
    """Return R (k, 3, 3) and X₀ (k, 3) of world = R camera + X₀ by least squares, (k, m, 3)."""
    mc, mw = camera.mean(axis=1), world.mean(axis=1)
    h = np.swapaxes(camera - mc[:, None], 1, 2) @ (world - mw[:, None])
    u, _, vt = np.linalg.svd(h)
    v = np.swapaxes(vt, 1, 2)
    sign = np.sign(np.linalg.det(v @ np.swapaxes(u, 1, 2)))
    v[:, :, 2] *= sign[:, None]
    r = v @ np.swapaxes(u, 1, 2)
    return r, mw - np.einsum("kij,kj->ki", r, mc)


def misses(r: Array, x0: Array, x: Array, d: Array) -> Array:
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


def some_triples(n: int) -> Index:
    """Return triples (m, 3) of n points: all triples of few points, else seeded random ones."""
    every = np.array(
        [
            (i, j, k)
            for i in range(min(n, 9))
            for j in range(i + 1, min(n, 9))
            for k in range(j + 1, min(n, 9))
        ]
    )
    if n <= 8 and len(every) <= TRIPLES:
        return every
    generator = np.random.default_rng(n)
    drawn = np.sort(generator.integers(0, n, (2 * TRIPLES, 3)), axis=1)
    distinct = (drawn[:, 0] < drawn[:, 1]) & (drawn[:, 1] < drawn[:, 2])
    return drawn[distinct][:TRIPLES]


def resect(x: Array, d: Array) -> tuple[Array, Array] | None:
    """Return world_R_camera and projection centre of a photo that sees known points.

    Args:
        x: points, (n, 3), metres, n ≥ 4.
        d: unit vectors of their rays in the axes of the camera, (n, 3).

    Returns:
        The pose that most points support; none: too few points support it.
    """
    rng = np.random.default_rng(len(x))
    if len(x) > 4 * SCORED:
        chosen = np.sort(rng.choice(len(x), 4 * SCORED, replace=False))
        x, d = x[chosen], d[chosen]
    middle = x.mean(axis=0)
    x = x - middle
    triples = some_triples(len(x))
    r, x0 = three_points(x[triples], d[triples])
    if not len(r):
        return None
    scored = np.arange(len(x)) if len(x) <= SCORED else rng.choice(len(x), SCORED, replace=False)
    miss = np.minimum(misses(r, x0, x[scored], d[scored]), 10 * FITS).mean(axis=1)
    best = np.argsort(miss)[:4].tolist()
    poses: list[tuple[Array, Array]] = []
    missed: list[Array] = []
    for k in best:
        poses.append(_refine(r[k], x0[k], x, d))
        turned, centre = poses[-1]
        missed.append(np.minimum(misses(turned[None], centre[None], x, d)[0], 10 * FITS))
        if len(x) >= MANY and missed[-1].mean() < FITS / 10:
            break
    winner = int(np.argmin([m.mean() for m in missed]))
    support = int(np.count_nonzero(missed[winner] < FITS))
    if support < max(4, len(x) // 2):
        return None
    return poses[winner][0], poses[winner][1] + middle


def resections(progress: Progress, rays: ImageRays, *, least: int) -> bool:
    """Fill the poses of photos that see ``least`` or more known points.

    Returns:
        Whether any pose was found.
    """
    open_ = ~posed(progress)
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
        pose = pose_from(progress.pose[photo], x, rays.direction[own], least)
        if pose is not None:
            progress.pose[photo] = pose
            found = True
    return found


def pose_from(given: Array, x: Array, d: Array, least: int) -> Array | None:
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
            h = d.T @ to
            u, _, vt = np.linalg.svd(h)
            turned = vt.T @ np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)]) @ u.T
            return np.concatenate([turned.ravel(), x0])
    if len(x) < least:
        return None
    pose = resect(x, d)
    if pose is None:
        return None
    centre = np.where(np.isnan(x0), pose[1], x0)
    return np.concatenate([pose[0].ravel(), centre])

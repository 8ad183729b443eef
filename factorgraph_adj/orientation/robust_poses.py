"""Poses by PoseLib from rays with mismatches: of a pair, of a photo; the principal distance.

The minimal solvers and the sampling are those of PoseLib (extra ``images``). The samples are drawn
from a fixed seed. A first pass with a wide limit finds the spread of the rays that fit; a second
one has the limit that follows from it, so that neither the noise of the image points nor an
uncorrected distortion has to be known.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from ..errors import InputError
from ..rotation import skew
from ..types import Array, Index, Mask

SOLVER_PRINCIPAL_DISTANCE = 1000.0
"""Principal distance of the camera in which tangents are handed over."""
MAX_SAMPLED_RAYS = 800
"""Largest number of rays from which a pose is sampled."""
RAYLEIGH_MEDIAN = 1.1774
"""Median of the length of a vector of two standard normal components."""
NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal variable."""
MAX_SPREAD_RATIO = 5.0
"""Multiple of the spread of rays above which a ray does not fit."""
MIN_POINTS_OF_SHARED_DISTANCE = 15
"""Smallest number of common points of a pair that determine the principal distance."""
POSELIB_MISSING = (
    "photos without orientation are oriented from image points alone with PoseLib: "
    "pip install 'factorgraph_adj[images]'"
)


def poselib_solvers() -> ModuleType:
    """Return PoseLib.

    Raises:
        InputError: it is not installed; the message says what to install.
    """
    try:
        import poselib
    except ImportError:
        raise InputError(POSELIB_MISSING) from None
    return poselib  # type: ignore[no-any-return]


@dataclass(frozen=True, eq=False)
class RelativePose:
    """Second photo of a pair in the axes of the first, with a base of length 1."""

    rotation: Array
    """first_R_second, (3, 3)."""
    base: Array
    """Projection centre of the second photo in the axes of the first, (3,)."""
    fits: Mask
    """Pairs of rays that fit, (n,)."""
    spread: float
    """Standard deviation of the distance of a ray from its epipolar line, a tangent."""


def _pixels(tangent: Array) -> Array:
    return np.ascontiguousarray(tangent * [SOLVER_PRINCIPAL_DISTANCE, -SOLVER_PRINCIPAL_DISTANCE])


def _camera() -> dict[str, object]:
    side = int(4 * SOLVER_PRINCIPAL_DISTANCE)
    return {
        "model": "SIMPLE_PINHOLE",
        "width": side,
        "height": side,
        "params": [SOLVER_PRINCIPAL_DISTANCE, 0.0, 0.0],
    }


def _sample(n: int) -> Index:
    if n <= MAX_SAMPLED_RAYS:
        return np.arange(n)
    return np.sort(np.random.default_rng(n).choice(n, MAX_SAMPLED_RAYS, replace=False))


def epipolar_misses(rotation: Array, base: Array, first: Array, second: Array) -> Array:
    """Return the Sampson distance of pairs of rays from the coplanarity condition, (n,) tangents.

    e = d₁ᵀ [b]× R d₂, v = |e| / √((E d₂)₁² + (E d₂)₂² + (Eᵀ d₁)₁² + (Eᵀ d₁)₂²), FRAMES F17.3.
    """
    e = skew(base[None])[0] @ rotation
    d1 = np.column_stack([first[:, 0], -first[:, 1], np.ones(len(first))])
    d2 = np.column_stack([second[:, 0], -second[:, 1], np.ones(len(second))])
    left, right = d1 @ e, d2 @ e.T
    size = np.sqrt((left[:, :2] ** 2).sum(axis=1) + (right[:, :2] ** 2).sum(axis=1))
    return np.asarray(np.abs(np.einsum("ni,ni->n", left, d2)) / np.maximum(size, 1e-300))


def relative_pose(first: Array, second: Array, *, wide: float, least: float) -> RelativePose | None:
    """Orient a pair of photos from common points, five at a time.

    Args:
        first: tangents of the rays in the first photo, (n, 2).
        second: tangents in the second photo, (n, 2).
        wide: limit of the first pass, a tangent.
        least: smallest limit of the second pass, a tangent.

    Returns:
        The pose; none: fewer than eight pairs of rays fit any.
    """
    poselib, limit, found = poselib_solvers(), wide, None
    chosen = _sample(len(first))
    for _ in range(3):
        if len(chosen) < 8:
            return None
        pose, _ = poselib.estimate_relative_pose(
            _pixels(first[chosen]),
            _pixels(second[chosen]),
            _camera(),
            _camera(),
            {
                "max_epipolar_error": SOLVER_PRINCIPAL_DISTANCE * limit,
                "min_iterations": 200,
                "max_iterations": 5000,
            },
            {"loss_scale": SOLVER_PRINCIPAL_DISTANCE * limit / 2},
        )
        rotation = np.asarray(pose.R).T
        base = -rotation @ np.asarray(pose.t)
        size = float(np.linalg.norm(base))
        if not (np.isfinite(rotation).all() and size > 0):
            return found
        misses = epipolar_misses(rotation, base / size, first, second)
        fits = misses < limit
        if fits.sum() < 8:
            return found
        spread = float(np.median(misses[fits])) / NORMAL_MEDIAN
        found = RelativePose(rotation, base / size, fits, spread)
        tighter = max(MAX_SPREAD_RATIO * spread, least)
        if tighter > 0.7 * limit:
            break
        limit = tighter
    return found


def shared_principal_distance(first: Array, second: Array, *, limit: float) -> float | None:
    """Return the principal distance of two photos of one camera, from six points at a time.

    Args:
        first: image coordinates from the principal point in the first photo, (n, 2), as parts of
            the longer side of the image.
        second: those in the second photo, (n, 2).
        limit: largest distance from the epipolar lines, in the same unit.

    Returns:
        The principal distance in the same unit; none: too few points fit, or none was found.
    """
    chosen = _sample(len(first))
    if len(chosen) < MIN_POINTS_OF_SHARED_DISTANCE:
        return None
    pair, told = poselib_solvers().estimate_shared_focal_relative_pose(
        _pixels(first[chosen]),
        _pixels(second[chosen]),
        np.zeros((2, 1)),
        {
            "max_epipolar_error": SOLVER_PRINCIPAL_DISTANCE * limit,
            "min_iterations": 100,
            "max_iterations": 1000,
        },
        {},
    )
    found = float(pair.camera1.focal()) / SOLVER_PRINCIPAL_DISTANCE
    enough = told["num_inliers"] >= max(MIN_POINTS_OF_SHARED_DISTANCE, len(chosen) // 2)
    return found if enough and np.isfinite(found) and found > 0 else None


def absolute_pose(
    tangent: Array, points: Array, *, limit: float
) -> tuple[Array, Array, Mask] | None:
    """Orient a photo from known points, three at a time.

    Args:
        tangent: tangents of the rays, (n, 2).
        points: their points, (n, 3).
        limit: largest miss of a ray that fits, a tangent.

    Returns:
        world_R_camera (3, 3), the projection centre (3,) and the rays that fit (n,); none: fewer
        than four fit.
    """
    if len(tangent) < 4:
        return None
    chosen = _sample(len(tangent))
    middle = points.mean(axis=0)
    size = float(np.abs(points - middle).max()) or 1.0
    pose, _ = poselib_solvers().estimate_absolute_pose(
        _pixels(tangent[chosen]),
        np.ascontiguousarray((points[chosen] - middle) / size),
        _camera(),
        {
            "max_reproj_error": SOLVER_PRINCIPAL_DISTANCE * limit,
            "min_iterations": 200,
            "max_iterations": 5000,
        },
        {"loss_scale": SOLVER_PRINCIPAL_DISTANCE * limit / 2},
    )
    rotation = np.asarray(pose.R).T
    centre = -rotation @ np.asarray(pose.t) * size + middle
    if not (np.isfinite(rotation).all() and np.isfinite(centre).all()):
        return None
    fits = ray_misses(rotation[None], centre[None], points, tangent) < limit
    return (rotation, centre, fits) if fits.sum() >= 4 else None


def ray_misses(rotation: Array, centre: Array, points: Array, tangent: Array) -> Array:
    """Return the miss of each ray, a tangent, (n,); infinite for points behind the photo.

    Args:
        rotation: world_R_camera of each ray, (n, 3, 3) or (1, 3, 3).
        centre: projection centre of each ray, (n, 3) or (1, 3).
        points: points, (n, 3).
        tangent: measured tangents, (n, 2).
    """
    d = points - centre
    p = [(rotation[:, :, j] * d).sum(axis=1) for j in range(3)]
    with np.errstate(divide="ignore", invalid="ignore"):
        miss = np.hypot(p[0] / p[2] - tangent[:, 0], -p[1] / p[2] - tangent[:, 1])
    return np.where((p[2] > 0) & np.isfinite(miss), miss, np.inf)

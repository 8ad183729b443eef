"""Adjustments on the way: a part of a block by the bundle adjustment of the library.

The block is a free network, or the photos around the new ones are held. The calibration takes part
as weighted unknowns: each parameter that the network leaves free may change what it does at the
edge of the image by a few per cent of the principal distance. Image points get the weights of
Huber's estimator.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import AdjustmentError, DatumError
from ..graph.equations import compile_network
from ..network.entities import Camera
from ..network.network import Network
from ..solve.minimum import adjust_from
from ..solve.start import Start
from ..types import Array, Index, Mask
from .growth import RULES, Growth

PRIOR = 0.03
"""Standard deviation of the effect of a calibration parameter, part of the principal distance."""
HUBER = 2.0
"""Multiple of the spread of misses beyond which weights fall."""
PASSES = 2
"""Number of times that weights are computed."""
ROUGHLY = 0.3
"""Bound on the last step relative to σ: an adjustment on the way need not be exact."""
MOST_ITERATIONS = 12
"""Largest number of iterations of one pass."""
TRIES = 4
"""Largest number of times that points are left out that the image points do not determine."""


def adjust_growth(
    growth: Growth, *, moving: Mask | None = None, calibrate: bool = True, passes: int = PASSES
) -> bool:
    """Adjust poses and points of a part, in place.

    Args:
        growth: the part.
        moving: photos that move, (photos,); the others are held. None: all move.
        calibrate: whether the calibration is improved.
        passes: number of times that weights are computed.

    Returns:
        Whether an adjustment was possible.
    """
    rows = np.flatnonzero(growth.review())
    strong = growth.strengths(rows) >= RULES.parallax / 2 if len(rows) else np.zeros(0, bool)
    rows = rows[strong[growth.views.point[rows]]] if len(rows) else rows
    if moving is not None:
        seen = np.zeros(len(growth.point), dtype=bool)
        seen[growth.views.point[rows[moving[growth.views.photo[rows]]]]] = True
        rows = rows[seen[growth.views.point[rows]]]
    for _ in range(TRIES):
        if len(rows) < RULES.least_rays:
            return False
        try:
            _adjust(growth, rows, moving, calibrate, passes)
            return True
        except DatumError as error:
            lost = {name for kind, name in error.unknowns if kind == "point"}
            lost |= set(error.names)
            number = growth.views.network.point_number
            away = np.zeros(len(growth.point), dtype=bool)
            away[[number[n] for n in lost if n in number]] = True
            if not away.any():
                return False
            rows = rows[~away[growth.views.point[rows]]]
        except AdjustmentError:
            # A point passed behind a photo: what pulled there leaves.
            rows = _without_the_worst(growth, rows)
    return False


def _without_the_worst(growth: Growth, rows: Index) -> Index:
    v = growth.views
    miss = growth.misses(rows)
    bad = np.unique(v.point[rows[miss > np.quantile(miss, 0.9)]])
    keep = np.ones(len(growth.point), dtype=bool)
    keep[bad] = False
    return rows[keep[v.point[rows]]]


def _adjust(growth: Growth, rows: Index, moving: Mask | None, calibrate: bool, passes: int) -> None:
    v = growth.views
    photos, photo = np.unique(v.photo[rows], return_inverse=True)
    points, point = np.unique(v.point[rows], return_inverse=True)
    held = np.zeros(len(photos), dtype=bool) if moving is None else ~moving[photos]
    network = Network("part", datum="given" if held.any() else "free")
    for number, camera in enumerate(v.cameras):
        network.cameras[camera.name] = _camera(growth, number, calibrate and not held.any())
    of_photo = list(v.network.photos.values())
    for number, fixed in zip(photos.tolist(), held.tolist(), strict=True):
        pose = growth.pose[number]
        network.add_photo(
            v.photos[number],
            of_photo[number].camera,
            position=pose[9:],
            rotation=pose[:9].reshape(3, 3),
            fixed=fixed,
        )
    network.add_points([v.points[p] for p in points.tolist()], growth.point[points])
    sigma = np.repeat(v.sigma[rows, None], 2, axis=1)
    network.images.append(photo, point, v.xy[rows], sigma)
    equations = compile_network(network)
    state = equations.unknowns.start()
    start = Start(equations.unknowns, state, state)
    for _ in range(passes):
        weights = _weights(equations.residuals(start.state), equations.blocks)
        solution = adjust_from(
            equations,
            start,
            free=not held.any(),
            weights=weights,
            tolerance=ROUGHLY,
            max_iterations=MOST_ITERATIONS,
            astray=True,
        )
        start = Start(equations.unknowns, solution.state, solution.state)
    unknowns, state = equations.unknowns, start.state
    moved = np.flatnonzero(~held)
    numbers = [unknowns["pose"].number[v.photos[f]] for f in photos[moved].tolist()]
    growth.pose[photos[moved]] = state["pose"][numbers]
    numbers = [unknowns["point"].number[v.points[p]] for p in points.tolist()]
    growth.point[points] = state["point"][numbers]
    if calibrate and not held.any():
        new = list(growth.calibrations)
        for number, camera in enumerate(v.cameras):
            if not camera.per_photo and camera.name in unknowns["calibration"].number:
                own = unknowns["calibration"].number[camera.name]
                new[number] = unknowns.given(state, "calibration", own)
        growth.calibrate(tuple(new))


def _weights(v: Array, blocks: tuple) -> Array:  # type: ignore[type-arg]
    """Return Huber's factors of the weights from whitened residuals, one for each image point."""
    out = np.ones(len(v))
    for block in blocks:
        if block.lens is None:
            continue
        size = np.linalg.norm(v[block.rows].reshape(-1, 2), axis=1)
        spread = max(float(np.median(size)) / 1.1774, 1e-12)
        out[block.rows] = np.repeat(np.minimum(1.0, HUBER * spread / np.maximum(size, 1e-12)), 2)
    return out


def _camera(growth: Growth, number: int, calibrate: bool) -> Camera:
    """Return a camera with the calibration so far; what is free in the network is weighted."""
    camera, values = growth.views.cameras[number], growth.calibrations[number]
    given = tuple(values.tolist())
    if camera.per_photo or not calibrate or all(camera.fixed):
        return replace(
            camera, values=given, fixed=(True,) * len(given), sigma=(np.inf,) * len(given)
        )
    first = np.array(camera.values)
    rows = np.flatnonzero(growth.rays.usable & (growth.views.camera == number))
    t, xy = growth.rays.tangent[rows], growth.views.xy[rows]
    effect = np.zeros(len(given))
    if len(rows):
        _, _, by_k = camera.lens.residual(t[:, 0], t[:, 1], xy, values[None])
        assert by_k is not None
        effect = np.abs(by_k).max(axis=(0, 1))
    prior = PRIOR * first[0] / np.maximum(effect, 1e-300)
    sigma = np.where(camera.fixed, np.inf, np.minimum(prior, camera.sigma))
    usable = np.isfinite(sigma) & (effect > 0)
    return replace(
        camera,
        values=given,
        fixed=tuple((~usable).tolist()),
        sigma=tuple(np.where(usable, sigma, np.inf).tolist()),
    )

"""Scales of the variables of calibrations in a GTSAM graph.

Raw powers of millimetres or pixels give columns whose norms differ by a factor of 10¹⁰, on which
GTSAM's optimisers stop at once and its Cholesky finds no pivots. In a graph a calibration is
therefore the vector of its given values divided by these scales.
"""

from __future__ import annotations

import numpy as np

from ..entities import Camera
from ..errors import AdjustmentError
from ..models.base import DegenerateError
from ..types import Array

FIELD = 0.5
"""Half of the format, relative to the principal distance, where no format is stated."""
POINTS = 9
"""Number of image points along each axis of the format at which partials are compared."""


def calibration_scales(camera: Camera) -> Array:
    """Return the scale s of each calibration parameter K, (k,): given value = s × value in a graph.

    s is the power of two, by which numbers are multiplied without rounding, that is nearest to

        r / max |∂v/∂K|

    over the format with half diagonal r: a change of one moves image points by about r, like a
    rotation of one radian. It depends on the camera's stated values alone, not on what was
    measured, so that a network keeps its scales while it grows.

    Args:
        camera: the camera.
    """
    k = np.array(camera.values, dtype=float)
    named = dict(zip(camera.lens.names, k.tolist(), strict=True))
    c = abs(named.get("c", 1.0)) or 1.0
    corners = camera.corners()
    middle = np.array([named.get("x0", 0.0), named.get("y0", 0.0)])
    if corners is None:
        corners = middle - FIELD * c, middle + FIELD * c
    x, y = (
        a.ravel()
        for a in np.meshgrid(*np.linspace(*corners, POINTS).T)  # every pixel of a coarse raster
    )
    ray = (x - middle[0]) / c, -(y - middle[1]) / c, np.ones(len(x))
    radius = float(np.hypot(x - middle[0], y - middle[1]).max())
    try:
        with np.errstate(all="ignore"):
            by_k = camera.lens.seen(ray, x, y, k[None]).by_k
            largest = [float(np.hypot(*np.broadcast_arrays(*pair)).max()) for pair in by_k]
    except (AdjustmentError, DegenerateError):
        return np.ones(len(k))
    out = np.ones(len(k))
    for j, most in enumerate(largest):
        if np.isfinite(most) and most > 0.0:
            out[j] = 2.0 ** np.round(np.log2(radius / most))
    return out

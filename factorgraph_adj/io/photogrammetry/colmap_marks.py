"""Marks of control points in the images of a COLMAP model: their rays, and where these meet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...approximate.rays import nearest_to_rays
from ...models.inverse import directions
from ...types import Array
from .colmap_cameras import BY_NAME
from .colmap_model import ImageRecord, SparseModel
from .colmap_tables import Mark

PARALLEL = 1e-3
"""Smallest strength of an intersection, see `nearest_to_rays`."""


def rays(model: SparseModel, measured: Sequence[tuple[ImageRecord, Mark]]) -> tuple[Array, Array]:
    """Return projection centres and directions of marks in the model, (n, 3) each; NaN: none."""
    cameras = {c.number: c for c in model.cameras}
    centres, found = [], []
    for image, mark in measured:
        camera = cameras[image.camera]
        known = BY_NAME[camera.model]
        assert known.lens is not None
        values = known.to_lens(camera.parameters)
        k = np.array([[values.get(n, 0.0) for n in known.lens.names]])
        ray = directions(known.lens, np.array([[mark.x, -mark.y]]), k)[0]
        centres.append(image.pose.centre)
        found.append(image.pose.rotation.T @ ray)
    return np.array(centres).reshape(-1, 3), np.array(found).reshape(-1, 3)


def intersection(centres: Array, directions_: Array) -> Array | None:
    """Return where rays meet, (3,); None: there are fewer than two, or they are parallel."""
    if len(centres) < 2:
        return None
    group = np.zeros(len(centres), dtype=np.intp)
    at, strength = nearest_to_rays(centres, directions_, group, 1)
    return at[0] if strength[0] > PARALLEL and np.isfinite(at).all() else None

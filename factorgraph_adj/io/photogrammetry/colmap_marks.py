"""Marks of control points in the images of a COLMAP model: where their rays meet, and axes.

The poses of a model tell whether marks count along its axes: the rays of a point meet then. Rows
that are counted from the lower edge, and columns and rows exchanged, are common mistakes; an
adjustment with them has no sense, and data snooping of them takes long.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from ...approximate.rays import nearest_to_rays
from ...errors import InputError, Problem
from ...models.inverse import directions
from ...types import Array
from .colmap_cameras import BY_NAME
from .colmap_model import CameraRecord, ImageRecord, SparseModel
from .colmap_tables import Mark

Axes = Callable[[Mark, CameraRecord], tuple[float, float]]
"""Column and row, from the upper left corner, of a mark."""


def as_stated(mark: Mark, camera: CameraRecord) -> tuple[float, float]:
    """Return column and row as they are stated."""
    return mark.x, mark.y


OTHERS: Mapping[str, Axes] = MappingProxyType(
    {
        "with y counted upwards from the lower edge": lambda m, c: (m.x, c.size[1] - m.y),
        "with x and y exchanged": lambda m, c: (m.y, m.x),
    }
)
"""Other meanings of the coordinates of marks, by the words of messages."""
APART = 0.02
"""Median angle by which rays miss their point that is not asked about, radians: one degree."""
BETTER = 0.1
"""Largest share of that angle that is left where another meaning is the right one."""
LEAST = 3
"""Smallest number of points with marks in two images that tell the axes."""
PARALLEL = 1e-3
"""Smallest strength of an intersection, see `nearest_to_rays`."""


def rays(
    model: SparseModel, measured: Sequence[tuple[ImageRecord, Mark]], axes: Axes = as_stated
) -> tuple[Array, Array]:
    """Return projection centres and directions of marks in the model, (n, 3) each; NaN: none."""
    cameras = {c.number: c for c in model.cameras}
    centres, found = [], []
    for image, mark in measured:
        camera = cameras[image.camera]
        known = BY_NAME[camera.model]
        assert known.lens is not None
        values = known.to_lens(camera.parameters)
        k = np.array([[values.get(n, 0.0) for n in known.lens.names]])
        x, y = axes(mark, camera)
        ray = directions(known.lens, np.array([[x, -y]]), k)[0]
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


def refuse_other_axes(model: SparseModel, marks: Sequence[Mark]) -> None:
    """Refuse marks whose rays meet only if their coordinates mean something else.

    Args:
        model: the model; its poses are taken as right.
        marks: measured image coordinates of images of the model.

    Raises:
        InputError: the median of the angles between rays and the directions to their point
            exceeds `APART`, and is `BETTER` times that in other axes.
    """
    images = {i.name: i for i in model.images}
    by_point: dict[str, list[tuple[ImageRecord, Mark]]] = {}
    for mark in marks:
        by_point.setdefault(mark.point, []).append((images[mark.photo], mark))
    several = [measured for measured in by_point.values() if len(measured) > 1]
    if len(several) < LEAST:
        return
    stated = _misses(model, several, as_stated)
    if not stated > APART:
        return
    for words, axes in OTHERS.items():
        other = _misses(model, several, axes)
        if other < BETTER * stated:
            what = (
                f"the rays of the marks miss their points by {np.rad2deg(stated):.1f}°, and "
                f"{words} by {np.rad2deg(other):.2g}°; valid: pixels from the upper left corner "
                "of the image, y down"
            )
            raise InputError(Problem(what, marks[0].where.rpartition(":")[0] or marks[0].where))


def _misses(
    model: SparseModel, several: Sequence[Sequence[tuple[ImageRecord, Mark]]], axes: Axes
) -> float:
    """Return the median angle between rays and the directions to where they meet, radians."""
    out: list[float] = []
    for measured in several:
        centres, found = rays(model, measured, axes)
        at = intersection(centres, found)
        if at is None:
            out += [np.pi] * len(measured)
            continue
        to = at - centres
        cosine = np.sum(to * found, axis=1)
        sine = np.linalg.norm(np.cross(to, found), axis=1)
        out += np.arctan2(sine, cosine).tolist()
    return float(np.median(out))

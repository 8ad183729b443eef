"""Reader of Bundler's .out files, which other programs write too.

The first line is ``# Bundle file v0.3``, the second has the numbers of cameras and points. A camera
has five lines: f k1 k2, the rows of the rotation R, and the translation t. A point has three:
coordinates, colour, and its views: their number, then camera, feature, x and y of each.

    P = R X + t,  p = −P/P_z,  (x, y) = f (1 + k1 |p|² + k2 |p|⁴) p

Axes of the camera are x right, y up, looking along −z; pixels count from the centre of the image.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from ...errors import InputError, Problem
from ...models.image import depth
from ...models.lens import NormalisedLens
from ...network.network import Network
from ...rotation import TURN_ABOUT_X
from ...types import Array
from ..text import beginning, read_text
from .reading import (
    BEHIND_CAMERA,
    FEW_RAYS,
    PHOTOS_WITHOUT_POSE,
    RAYS_WITHOUT_PHOTO,
    TIE,
    ImagePoints,
    Reading,
    lines_of,
    rotation_of,
    whole,
)

HEAD = "# Bundle file v0."
"""Beginning of the first line."""
PER_CAMERA, PER_POINT = 5, 3
"""Lines of a camera and of a point."""


def read_bundler(
    path: str | Path,
    *,
    images: str | Path | None = None,
    sigma_px: float = 1.0,
    behind: Literal["leave out", "keep"] = "leave out",
) -> Network:
    """Read a reconstruction of Bundler as a free network.

    Every photo has a camera of its own with unknown c, k1, k2, as in Bundler; image coordinates
    are pixels from the centre of the image, x right, y up. Cameras that were not registered
    (f = 0), their views, colours and numbers of features are not read. Points with fewer than two
    views that are left have nothing to be determined by and are left out. Tie points are named
    ``tie NUMBER``.

    Args:
        path: the file.
        images: a list of the names of the images, one a line (list.txt); None: their numbers.
        sigma_px: standard deviation of image coordinates, pixels; the format has none.
        behind: what to do with views of points behind the camera.

    Raises:
        InputError: the file has problems, each with file and line.
    """
    if not sigma_px > 0:
        raise InputError(f"sigma_px must be greater than zero, not {sigma_px}")
    source = Path(path)
    reading = Reading()
    lines = list(lines_of(read_text(source)))
    if not lines or not lines[0][1].startswith(HEAD):
        raise InputError(
            Problem(f"is no file of Bundler: it must begin with {HEAD!r}3", f"{source.name}:1")
        )
    rows = [(f"{source.name}:{n}", line.split()) for n, line in lines[1:]]
    counts = rows[0][1] if rows else []
    if len(counts) != 2 or not all(c.isascii() and c.isdigit() and len(c) < 10 for c in counts):
        where = rows[0][0] if rows else f"{source.name}:{lines[0][0]}"
        what = "the second line must be two whole numbers, those of cameras and of points"
        raise InputError(Problem(what, where))
    n_cameras, n_points = int(counts[0]), int(counts[1])
    size = 1 + PER_CAMERA * n_cameras + PER_POINT * n_points
    if len(rows) != size:
        what = (
            f"{n_cameras} cameras and {n_points} points take {size + 1} lines, not {len(rows) + 1}"
        )
        raise InputError(Problem(what, rows[-1][0]))
    names = _names(images, n_cameras)
    network = Network(source.name, datum="free")
    poses: dict[int, Array] = {}
    for i in range(n_cameras):
        begin = 1 + PER_CAMERA * i
        pose = _camera(network, names[i], rows[begin : begin + PER_CAMERA], reading)
        if pose is not None:
            poses[i] = pose
    gathered = ImagePoints(reading)
    for j in range(n_points):
        begin = 1 + PER_CAMERA * n_cameras + PER_POINT * j
        part = rows[begin : begin + PER_POINT]
        _point(network, f"{TIE}{j}", part, names, poses, gathered, reading, sigma_px, behind)
    gathered.into(network)
    reading.finish(network)
    return network


def is_bundler(path: Path) -> bool:
    """Tell whether a file is one of Bundler."""
    return beginning(path, 100).lstrip().startswith(HEAD.encode())


def _names(path: str | Path | None, count: int) -> list[str]:
    """Return the names of the photos.

    Raises:
        InputError: the list has another number of them, or one of them twice.
    """
    if path is None:
        return [str(i) for i in range(count)]
    given = Path(path)
    found = [line.split()[0].rsplit("/", 1)[-1] for _, line in lines_of(read_text(given))]
    if len(found) != count or len(set(found)) < count:
        what = f"must have {count} different names, not {len(set(found))}"
        raise InputError(Problem(what, f"{given.name}:1"))
    return found


def _camera(
    network: Network, name: str, rows: list[tuple[str, list[str]]], reading: Reading
) -> Array | None:
    """Add a camera and its photo; return its pose (12,), None if it has none."""
    numbers = [reading.numbers(fields, 3, "a line of a camera", where) for where, fields in rows]
    where = rows[0][0]
    if any(n is None for n in numbers):
        return None
    values = np.array(numbers)
    (c, k1, k2), matrix, t = values[0].tolist(), values[1:4], values[4]
    if c == 0:
        reading.leave_out(PHOTOS_WITHOUT_POSE, name, where)
        return None
    split = rotation_of(matrix)
    if c < 0 or split is None or abs(split[1] - 1) > 1e-3:
        what = "f must not be negative" if c < 0 else "R is no rotation matrix"
        reading.wrong(what, where)
        return None
    turn = split[0]
    centre, rotation = -turn.T @ t, turn.T @ TURN_ABOUT_X
    with reading.at(where):
        free = ("c", "k1", "k2")
        calibration = {"c": c, "k1": k1, "k2": k2}
        network.add_camera(name, NormalisedLens(), calibration, free=free, unit="px")
        network.add_photo(name, name, position=centre.tolist(), rotation=rotation)
        return np.concatenate([rotation.ravel(), centre])
    return None


def _point(
    network: Network,
    name: str,
    rows: list[tuple[str, list[str]]],
    names: list[str],
    poses: dict[int, Array],
    images: ImagePoints,
    reading: Reading,
    sigma: float,
    behind: str,
) -> None:
    """Add a point and gather its views."""
    at = reading.numbers(rows[0][1], 3, "coordinates of a point", rows[0][0])
    reading.numbers(rows[1][1], 3, "colour of a point", rows[1][0])
    where, fields = rows[2]
    count = fields[0] if fields else ""
    if not (count.isascii() and count.isdigit()) or len(fields) != 1 + 4 * int(count[:9]):
        reading.wrong("the views of a point are: number, then camera feature x y of each", where)
        return
    if at is None:
        return
    seen = []
    for begin in range(1, len(fields), 4):
        camera, feature, *xy = fields[begin : begin + 4]
        if whole(feature) is None:
            reading.wrong(f"the number of a feature must be whole, not {feature[:40]!r}", where)
        found = reading.numbers(xy, 2, "view", where)
        if not (camera.isascii() and camera.isdigit()) or int(camera[:9]) >= len(names):
            reading.wrong(f"there is no camera {camera}; valid: 0 to {len(names) - 1}", where)
        elif found is not None and int(camera) in poses:
            seen.append((int(camera), found))
        elif found is not None:
            reading.leave_out(RAYS_WITHOUT_PHOTO, names[int(camera)], where)
    if len({c for c, _ in seen}) < len(seen):
        twice = next(c for i, (c, _) in enumerate(seen) if c in {d for d, _ in seen[:i]})
        reading.wrong(f"point {name!r} is measured twice in photo {names[twice]!r}", where)
        return
    if behind == "leave out" and seen:
        ahead = depth(np.array([poses[c] for c, _ in seen]), np.tile(at, (len(seen), 1))) > 0
        for (c, _), a in zip(seen, ahead.tolist(), strict=True):
            if not a:
                reading.leave_out(BEHIND_CAMERA, f"{names[c]} {name}", where)
        seen = [s for s, a in zip(seen, ahead.tolist(), strict=True) if a]
    if len(seen) < 2:
        reading.leave_out(FEW_RAYS, name, where)
        return
    network.add_point(name, at)
    for camera_number, xy_found in seen:
        images.add(names[camera_number], name, xy_found, (sigma,), where)

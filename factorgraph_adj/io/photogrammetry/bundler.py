"""Readers of Bundler (.out) and Bundle Adjustment in the Large (BAL) as free networks.

P = R X + t,  p = −P/P_z,  (x, y) = f (1 + k1 |p|² + k2 |p|⁴) p

Axes of the camera are x right, y up, viewing direction −z; pixels of Bundler count from the centre
of the image.

Bundler, whose files other programs write too: the first line is ``# Bundle file v0.3``, the second
has the numbers of cameras and points. A camera has five lines: f k1 k2, the rows of the rotation R,
and the translation t. A point has three: coordinates, colour, and its views: their number, then
camera, feature, x and y of each.

BAL (Agarwal, Snavely, Seitz, Szeliski, 2010) is one stream of numbers: the numbers of cameras,
points and observations; ``camera point x y`` for each observation; nine numbers for each camera
(rotation vector, translation, f, k1, k2); three for each point.
"""

from __future__ import annotations

import bz2
import gzip
import re
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from ...errors import InputError, LeftOut, Problem
from ...files import opened, read_bytes, unpacked
from ...models.image import depth
from ...models.lens import NormalisedLens
from ...network.network import Network
from ...rotation import TURN_ABOUT_X, exp_rotation
from ...types import Array, Index, Mask
from ..format_reader import NetworkReader, Reader
from ..source import MAX_LISTED_PROBLEMS, Problems, is_unread
from ..text_files import file_beginning, read_text
from .block_source import (
    PHOTOS_WITHOUT_POSE,
    POINTS_BEHIND_CAMERA,
    POINTS_WITH_FEW_RAYS,
    RAYS_WITHOUT_PHOTO,
    TIE_PREFIX,
    ImagePoints,
    filled_lines,
    rotation_and_scale,
    whole_number,
)
from .ground_control import place_by_positions

BAL_SIGMA_PX = 1.0
"""Standard deviation of an image coordinate, pixels; the cost of the format, ½ vᵀv, implies 1."""
HEAD_NUMBERS, NUMBERS_PER_OBSERVATION, NUMBERS_PER_CAMERA, NUMBERS_PER_POINT = 3, 4, 9, 3
_BAL_BEGINNING = re.compile(
    rb"\s*[1-9]\d*(?:[ \t]+[1-9]\d*){2}\s+\d+\s+\d+"
    rb"(?:\s+[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?){2}[ \t]*(?:\r?\n|$)"
)
"""Numbers of cameras, points and observations on a line, and the first observation."""
UNPACKED_BEGINNING = 1000
"""Number of unpacked bytes by which a packed file is recognised."""
BUNDLER_HEAD = "# Bundle file v0."
"""Beginning of the first line."""
LINES_PER_CAMERA, LINES_PER_POINT = 5, 3
"""Lines of a camera and of a point."""


def read_bal(path: str | Path, *, behind: Literal["leave out", "keep"] = "leave out") -> Network:
    """Read a problem of Bundle Adjustment in the Large as a free network.

    Every photo has a camera of its own with unknown c = f, k1, k2 (`NormalisedLens`); image
    coordinates are pixels from the principal point, x right, y up, σ = 1 px. Therefore ½ vᵀPv
    of an adjustment is the cost that is published for these problems. Photos, cameras and
    points are named by their numbers in the file: "0", "1", …

    Some problems hold points behind the cameras that observe them: the formula is valid for
    these points, but a camera cannot see them. COLMAP and GTSAM silently set the residuals of
    such observations to zero, other programs use them. This reader leaves out these
    observations, and points with fewer than two remaining rays; the network's name states both
    numbers.

    Args:
        path: the file; names ending in .bz2 and .gz are unpacked.
        behind: what to do with observations of points behind the camera.

    Raises:
        InputError: the file is missing, malformed or cut short, a number is not finite, an
            index is out of range, a point is observed twice in a photo, or f ≤ 0; each with
            file and line.
    """
    source = Path(path)
    file = _BalFile(source, _unpack(source))
    table, cameras, points = _split_numbers(file, _bal_numbers(file))
    _check_bal(file, table, cameras, points)
    photogrammetric_R_world = exp_rotation(cameras[:, :3])
    world_R_camera = np.swapaxes(photogrammetric_R_world, 1, 2) @ TURN_ABOUT_X
    centres = -np.einsum("nji,nj->ni", photogrammetric_R_world, cameras[:, 3:6])
    photo, point = table[:, :2].astype(np.intp).T
    name = source.name
    used, present = np.ones(len(table), dtype=bool), np.ones(len(points), dtype=bool)
    if behind == "leave out":
        poses = np.concatenate([world_R_camera.reshape(-1, 9), centres], axis=1)
        used = depth(poses[photo], points[point]) > 0
    if not used.all():
        present = np.bincount(point[used], minlength=len(points)) >= 2
        used &= present[point]
        name += f" without {np.sum(~used)} observations of {np.sum(~present)} points behind cameras"
    network = Network(name, datum="free")
    if not used.all():
        names = tuple(str(i) for i in np.unique(point[~used]).tolist())
        why = "their points are behind the cameras"
        network.left_out.append(LeftOut("observations", why, names, int(np.sum(~used))))
    network.add_points([str(i) for i in np.flatnonzero(present)], points[present])
    for i, (c, k1, k2) in enumerate(cameras[:, 6:].tolist()):
        network.add_camera(
            str(i),
            NormalisedLens(),
            {"c": c, "k1": k1, "k2": k2},
            free=("c", "k1", "k2"),
            unit="px",
        )
        network.add_photo(str(i), str(i), position=centres[i].tolist(), rotation=world_R_camera[i])
    number = np.cumsum(present) - 1
    network.images.append(
        photo[used],
        number[point[used]],
        table[used, 2:],
        np.full((int(used.sum()), 2), BAL_SIGMA_PX),
    )
    return network


@dataclass(frozen=True)
class _BalFile:
    """A file as text, with the line number of each word for messages."""

    source: Path
    text: bytes

    @cached_property
    def lines(self) -> Index:
        """Line of each whitespace-separated word; the line of the last word is repeated."""
        letters = np.frombuffer(self.text, dtype=np.uint8)
        space = np.isin(letters, np.frombuffer(b" \t\n\r\v\f", dtype=np.uint8))
        begins = ~space & np.concatenate([[True], space[:-1]])
        line = 1 + np.cumsum(letters == ord("\n"))[begins]
        return np.append(line, line[-1] if len(line) else 1)

    def where(self, word: int) -> str:
        """Return file:line of a word; an index past the end gives the last word."""
        return f"{self.source}:{self.lines[min(word, len(self.lines) - 1)]}"

    def not_numbers(self) -> Problems:
        """Return the problems of the words that are not numbers."""
        problems = Problems()
        for i, word in enumerate(self.text.split()):
            try:
                # Python accepts 1_000 as a number; this format does not.
                float(word if b"_" not in word else b"")
            except ValueError:
                shown = word.decode("ascii", "backslashreplace")[:30]
                problems.wrong(f"{shown!r} is not a number", self.where(i))
        return problems


def _unpack(source: Path) -> bytes:
    """Return the content of the file."""
    if source.suffix not in (".bz2", ".gz"):
        return read_bytes(source)
    try:
        with opened(source) as stream:
            gz = source.suffix == ".gz"
            inner = gzip.GzipFile(fileobj=stream) if gz else bz2.BZ2File(stream)
            return unpacked(inner, source.stat().st_size, str(source))
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(Problem(f"the file cannot be read: {error}", str(source))) from None


def _bal_numbers(file: _BalFile) -> Array:
    """Return the numbers of the file; InputError lists the words that are not numbers."""
    try:
        with warnings.catch_warnings():
            # numpy 2 gives a DeprecationWarning for text that is not a number.
            warnings.simplefilter("error", DeprecationWarning)
            return np.asarray(np.fromstring(file.text.decode("ascii"), sep=" "), dtype=float)
    except (DeprecationWarning, ValueError):
        file.not_numbers().raise_all()
        raise InputError(Problem("not a text of numbers", str(file.source))) from None


def _split_numbers(file: _BalFile, values: Array) -> tuple[Array, Array, Array]:
    """Cut the numbers into observations (n, 4), cameras (m, 9) and points (p, 3).

    Raises:
        InputError: the file does not begin with three counts, its length does not fit them,
            or numbers are not finite.
    """
    head = values[:HEAD_NUMBERS]
    if len(head) < HEAD_NUMBERS or not np.all(
        (head >= 1) & (head < 2**53) & (head == np.floor(head))
    ):
        shown = " ".join(f"{v:g}" for v in head) or "nothing"
        raise InputError(
            Problem(
                "the file must begin with the numbers of cameras, points and observations, "
                f"whole numbers > 0, not {shown}",
                file.where(0),
            )
        )
    n_cameras, n_points, n = (int(v) for v in head)
    widths = (NUMBERS_PER_OBSERVATION, NUMBERS_PER_CAMERA, NUMBERS_PER_POINT)
    counts = (n, n_cameras, n_points)
    ends = [HEAD_NUMBERS]
    for count, width in zip(counts, widths, strict=True):
        ends.append(ends[-1] + count * width)
    if len(values) != ends[-1]:
        size = (
            f"{n_cameras} cameras, {n_points} points and {n} observations take {ends[-1]} "
            f"numbers, the file has {len(values)}"
        )
        problems = file.not_numbers()
        if len(values) > ends[-1]:
            problems.wrong(f"numbers are left over here: {size}", file.where(ends[-1]))
        else:
            part = next(i for i in range(3) if len(values) < ends[i + 1])
            what = ("observation", "camera", "point")[part]
            at = (len(values) - ends[part]) // widths[part]
            problems.wrong(
                f"the file ends in {what} {at} of {counts[part]}: {size}", file.where(len(values))
            )
        problems.raise_all()
    infinite = np.flatnonzero(~np.isfinite(values))
    problems = Problems()
    for i in infinite[:MAX_LISTED_PROBLEMS].tolist():
        problems.wrong(f"a number must be finite, not {values[i]}", file.where(i))
    problems.count_further(len(infinite[MAX_LISTED_PROBLEMS:]))
    problems.raise_all()
    table, cameras, points = (
        values[a:b].reshape(-1, width) for a, b, width in zip(ends, ends[1:], widths, strict=False)
    )
    return table, cameras, points


def _check_bal(file: _BalFile, table: Array, cameras: Array, points: Array) -> None:
    """Refuse indices out of range, points observed twice in a photo, and f ≤ 0."""
    problems = Problems()

    def refuse(wrong: Mask, word: Callable[[int], int], what: Callable[[int], str]) -> None:
        rows = np.flatnonzero(wrong)
        for i in rows[:MAX_LISTED_PROBLEMS].tolist():
            problems.wrong(what(i), file.where(word(i)))
        problems.count_further(len(rows[MAX_LISTED_PROBLEMS:]))

    def refuse_index(column: int, name: str, size: int) -> None:
        index = table[:, column]
        refuse(
            (index < 0) | (index >= size) | (index != np.floor(index)),
            lambda i: HEAD_NUMBERS + NUMBERS_PER_OBSERVATION * i + column,
            lambda i: f"there is no {name} {index[i]:.15g}; valid: 0 to {size - 1}",
        )

    refuse_index(0, "camera", len(cameras))
    refuse_index(1, "point", len(points))
    if not problems.count:
        code = table[:, 0] * len(points) + table[:, 1]
        order = np.argsort(code, kind="stable")
        again = np.zeros(len(code), dtype=bool)
        again[order[1:]] = code[order[1:]] == code[order[:-1]]
        refuse(
            again,
            lambda i: HEAD_NUMBERS + NUMBERS_PER_OBSERVATION * i,
            lambda i: f"point {table[i, 1]:.0f} is observed twice in photo {table[i, 0]:.0f}",
        )
    refuse(
        ~(cameras[:, 6] > 0),
        lambda i: HEAD_NUMBERS + table.size + NUMBERS_PER_CAMERA * i + 6,
        lambda i: f"f of camera {i} must be positive, not {cameras[i, 6]:g}",
    )
    problems.raise_all()


def read_bundler(
    path: str | Path,
    *,
    images: str | Path | None = None,
    sigma_px: float = 1.0,
    behind: Literal["leave out", "keep"] = "leave out",
    positions: str | Path | None = None,
    sigma_positions: tuple[float, float] | None = None,
    positions_system: str | None = None,
) -> Network:
    """Read a reconstruction of Bundler, as a free network or by positions of its photos.

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
        positions: list of observed positions of photos, which places the model on the Earth:
            geo.txt of ODM, or a table, see `io.photogrammetry.coordinate_lists`; None: the model
            is free.
        sigma_positions: standard deviations of positions for which the file states no σ,
            horizontal and vertical, metres.
        positions_system: reference system of a table of positions that states none.

    Raises:
        InputError: the file has problems, each with file and line.
    """
    if not sigma_px > 0:
        raise InputError(f"sigma_px must be greater than zero, not {sigma_px}")
    source = Path(path)
    problems = Problems()
    lines = list(filled_lines(read_text(source)))
    if not lines or not lines[0][1].startswith(BUNDLER_HEAD):
        raise InputError(
            Problem(
                f"is no file of Bundler: it must begin with {BUNDLER_HEAD!r}3", f"{source.name}:1"
            )
        )
    rows = [(f"{source.name}:{n}", line.split()) for n, line in lines[1:]]
    counts = rows[0][1] if rows else []
    if len(counts) != 2 or not all(c.isascii() and c.isdigit() and len(c) < 10 for c in counts):
        where = rows[0][0] if rows else f"{source.name}:{lines[0][0]}"
        what = "the second line must be two whole numbers, those of cameras and of points"
        raise InputError(Problem(what, where))
    n_cameras, n_points = int(counts[0]), int(counts[1])
    size = 1 + LINES_PER_CAMERA * n_cameras + LINES_PER_POINT * n_points
    if len(rows) != size:
        what = (
            f"{n_cameras} cameras and {n_points} points take {size + 1} lines, not {len(rows) + 1}"
        )
        raise InputError(Problem(what, rows[-1][0]))
    names = _photo_names(images, n_cameras)
    network = Network(source.name, datum="free")
    poses: dict[int, Array] = {}
    for i in range(n_cameras):
        begin = 1 + LINES_PER_CAMERA * i
        pose = _camera(network, names[i], rows[begin : begin + LINES_PER_CAMERA], problems)
        if pose is not None:
            poses[i] = pose
    gathered = ImagePoints(problems)
    for j in range(n_points):
        begin = 1 + LINES_PER_CAMERA * n_cameras + LINES_PER_POINT * j
        part = rows[begin : begin + LINES_PER_POINT]
        _point(
            network, f"{TIE_PREFIX}{j}", part, names, poses, gathered, problems, sigma_px, behind
        )
    gathered.into(network)
    problems.finish(network)
    return place_by_positions(network, positions, sigma=sigma_positions, system=positions_system)


def is_bal(path: Path) -> bool:
    """Return whether a file, perhaps packed, begins as a problem of BAL."""
    beginning = file_beginning(path)
    try:
        if path.suffix == ".bz2":
            beginning = bz2.BZ2Decompressor().decompress(beginning, UNPACKED_BEGINNING)
        elif path.suffix == ".gz":
            beginning = zlib.decompressobj(zlib.MAX_WBITS | 16).decompress(
                beginning, UNPACKED_BEGINNING
            )
    except (OSError, EOFError, zlib.error):
        return False
    return _BAL_BEGINNING.match(beginning) is not None


def is_bundler(path: Path) -> bool:
    """Tell whether a file is one of Bundler."""
    return file_beginning(path, 100).lstrip().startswith(BUNDLER_HEAD.encode())


def _photo_names(path: str | Path | None, count: int) -> list[str]:
    """Return the names of the photos.

    Raises:
        InputError: the list has another number of them, or one of them twice.
    """
    if path is None:
        return [str(i) for i in range(count)]
    given = Path(path)
    found = [line.split()[0].rsplit("/", 1)[-1] for _, line in filled_lines(read_text(given))]
    if len(found) != count or len(set(found)) < count:
        what = f"must have {count} different names, not {len(set(found))}"
        raise InputError(Problem(what, f"{given.name}:1"))
    return found


def _camera(
    network: Network, name: str, rows: list[tuple[str, list[str]]], problems: Problems
) -> Array | None:
    """Add a camera and its photo; return its pose (12,), None if it has none."""
    numbers = [
        problems.field(fields, "a line of a camera", where).numbers(3) for where, fields in rows
    ]
    where = rows[0][0]
    if is_unread(*numbers):
        return None
    values = np.array(numbers)
    (c, k1, k2), matrix, t = values[0].tolist(), values[1:4], values[4]
    if c == 0:
        problems.leave_out(PHOTOS_WITHOUT_POSE, name, where)
        return None
    split = rotation_and_scale(matrix)
    if c < 0 or split is None or abs(split[1] - 1) > 1e-3:
        what = "f must not be negative" if c < 0 else "R is no rotation matrix"
        problems.wrong(what, where)
        return None
    turn = split[0]
    centre, rotation = -turn.T @ t, turn.T @ TURN_ABOUT_X
    with problems.collect(where):
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
    problems: Problems,
    sigma: float,
    behind: str,
) -> None:
    """Add a point and gather its views."""
    at = problems.field(rows[0][1], "coordinates of a point", rows[0][0]).numbers(3)
    problems.field(rows[1][1], "colour of a point", rows[1][0]).numbers(3)
    where, fields = rows[2]
    count = fields[0] if fields else ""
    if not (count.isascii() and count.isdigit()) or len(fields) != 1 + 4 * int(count[:9]):
        problems.wrong("the views of a point are: number, then camera feature x y of each", where)
        return
    if is_unread(at):
        return
    seen = []
    for begin in range(1, len(fields), 4):
        camera, feature, *xy = fields[begin : begin + 4]
        if whole_number(feature) is None:
            problems.wrong(f"the number of a feature must be whole, not {feature[:40]!r}", where)
        found = problems.field(xy, "view", where).numbers(2)
        if not (camera.isascii() and camera.isdigit()) or int(camera[:9]) >= len(names):
            problems.wrong(f"there is no camera {camera}; valid: 0 to {len(names) - 1}", where)
        elif not is_unread(found) and int(camera) in poses:
            seen.append((int(camera), found))
        elif not is_unread(found):
            problems.leave_out(RAYS_WITHOUT_PHOTO, names[int(camera)], where)
    if len({c for c, _ in seen}) < len(seen):
        twice = next(c for i, (c, _) in enumerate(seen) if c in {d for d, _ in seen[:i]})
        problems.wrong(f"point {name!r} is measured twice in photo {names[twice]!r}", where)
        return
    if behind == "leave out" and seen:
        ahead = depth(np.array([poses[c] for c, _ in seen]), np.tile(at, (len(seen), 1))) > 0
        for (c, _), a in zip(seen, ahead.tolist(), strict=True):
            if not a:
                problems.leave_out(POINTS_BEHIND_CAMERA, f"{names[c]} {name}", where)
        seen = [s for s, a in zip(seen, ahead.tolist(), strict=True) if a]
    if len(seen) < 2:
        problems.leave_out(POINTS_WITH_FEW_RAYS, name, where)
        return
    network.add_point(name, at)
    for camera_number, xy_found in seen:
        images.add(names[camera_number], name, xy_found, (sigma,), where)


BAL_READER = Reader(
    "bal",
    (".txt", ".txt.bz2", ".txt.gz"),
    "Bundle Adjustment in the Large",
    NetworkReader(read_bal),
    recognises=is_bal,
)
READER = Reader(
    "bundler",
    (".out",),
    "reconstruction of Bundler",
    NetworkReader(read_bundler),
    recognises=is_bundler,
)

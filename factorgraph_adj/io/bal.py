"""Reader of Bundle Adjustment in the Large problems.

The format (Agarwal, Snavely, Seitz, Szeliski, 2010) is one stream of numbers: the numbers of
cameras, points and observations; ``camera point x y`` for each observation; nine numbers for
each camera (rotation vector, translation, f, k1, k2); three for each point.

    P = R X + t,  p = −P/P_z,  (x, y) = f (1 + k1 |p|² + k2 |p|⁴) p

The camera's axes are those of photogrammetry: x right, y up, viewing direction −z.
"""

from __future__ import annotations

import bz2
import gzip
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from ..errors import InputError, LeftOut, Problem
from ..files import opened, read_bytes, unpacked
from ..models.image import depth
from ..models.lens import NormalisedLens
from ..network.network import Network
from ..rotation import TURN_ABOUT_X, exp_rotation
from ..types import Array, Index, Mask

SIGMA_PX = 1.0
"""Standard deviation of an image coordinate, pixels; the cost of the format, ½ vᵀv, implies 1."""
HEAD, PER_OBSERVATION, PER_CAMERA, PER_POINT = 3, 4, 9, 3
MOST_PROBLEMS = 50
"""Largest number of listed problems of one kind; in a shifted file every number is a problem."""


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
    file = _File(source, _unpack(source))
    table, cameras, points = _split(file, _parse(file))
    _check(file, table, cameras, points)
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
        photo[used], number[point[used]], table[used, 2:], np.full((int(used.sum()), 2), SIGMA_PX)
    )
    return network


@dataclass(frozen=True)
class _File:
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

    def not_numbers(self) -> list[Problem]:
        """Return the problems of the words that are not numbers."""
        problems = []
        for i, word in enumerate(self.text.split()):
            try:
                # Python accepts 1_000 as a number; this format does not.
                float(word if b"_" not in word else b"")
            except ValueError:
                shown = word.decode("ascii", "backslashreplace")[:30]
                problems.append(Problem(f"{shown!r} is not a number", self.where(i)))
        return _first(problems, len(problems))


def _first(problems: list[Problem], count: int) -> list[Problem]:
    """Return the first problems of a kind, and a last one with the number of further ones."""
    shown = problems[:MOST_PROBLEMS]
    if count > len(shown):
        shown.append(Problem(f"and {count - len(shown)} more of this kind", shown[-1].where))
    return shown


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


def _parse(file: _File) -> Array:
    """Return the numbers of the file; InputError lists the words that are not numbers."""
    try:
        with warnings.catch_warnings():
            # numpy 2 gives a DeprecationWarning for text that is not a number.
            warnings.simplefilter("error", DeprecationWarning)
            return np.asarray(np.fromstring(file.text.decode("ascii"), sep=" "), dtype=float)
    except (DeprecationWarning, ValueError):
        problems = file.not_numbers() or [Problem("not a text of numbers", str(file.source))]
        raise InputError(problems) from None


def _split(file: _File, values: Array) -> tuple[Array, Array, Array]:
    """Cut the numbers into observations (n, 4), cameras (m, 9) and points (p, 3).

    Raises:
        InputError: the file does not begin with three counts, its length does not fit them,
            or numbers are not finite.
    """
    head = values[:HEAD]
    if len(head) < HEAD or not np.all((head >= 1) & (head < 2**53) & (head == np.floor(head))):
        shown = " ".join(f"{v:g}" for v in head) or "nothing"
        raise InputError(
            Problem(
                "the file must begin with the numbers of cameras, points and observations, "
                f"whole numbers > 0, not {shown}",
                file.where(0),
            )
        )
    n_cameras, n_points, n = (int(v) for v in head)
    widths = (PER_OBSERVATION, PER_CAMERA, PER_POINT)
    counts = (n, n_cameras, n_points)
    ends = [HEAD]
    for count, width in zip(counts, widths, strict=True):
        ends.append(ends[-1] + count * width)
    if len(values) != ends[-1]:
        size = (
            f"{n_cameras} cameras, {n_points} points and {n} observations take {ends[-1]} "
            f"numbers, the file has {len(values)}"
        )
        problems = file.not_numbers()
        if len(values) > ends[-1]:
            problems.append(Problem(f"numbers are left over here: {size}", file.where(ends[-1])))
        else:
            part = next(i for i in range(3) if len(values) < ends[i + 1])
            what = ("observation", "camera", "point")[part]
            at = (len(values) - ends[part]) // widths[part]
            problems.append(
                Problem(
                    f"the file ends in {what} {at} of {counts[part]}: {size}",
                    file.where(len(values)),
                )
            )
        raise InputError(problems)
    infinite = np.flatnonzero(~np.isfinite(values))
    if len(infinite):
        found = [
            Problem(f"a number must be finite, not {values[i]}", file.where(int(i)))
            for i in infinite[:MOST_PROBLEMS]
        ]
        raise InputError(_first(found, len(infinite)))
    table, cameras, points = (
        values[a:b].reshape(-1, width) for a, b, width in zip(ends, ends[1:], widths, strict=False)
    )
    return table, cameras, points


def _check(file: _File, table: Array, cameras: Array, points: Array) -> None:
    """Refuse indices out of range, points observed twice in a photo, and f ≤ 0."""
    problems: list[Problem] = []

    def refuse(wrong: Mask, word: Callable[[int], int], what: Callable[[int], str]) -> None:
        rows = np.flatnonzero(wrong)
        found = [Problem(what(int(i)), file.where(word(int(i)))) for i in rows[:MOST_PROBLEMS]]
        problems.extend(_first(found, len(rows)))

    def refuse_index(column: int, name: str, size: int) -> None:
        index = table[:, column]
        refuse(
            (index < 0) | (index >= size) | (index != np.floor(index)),
            lambda i: HEAD + PER_OBSERVATION * i + column,
            lambda i: f"there is no {name} {index[i]:.15g}; valid: 0 to {size - 1}",
        )

    refuse_index(0, "camera", len(cameras))
    refuse_index(1, "point", len(points))
    if not problems:
        code = table[:, 0] * len(points) + table[:, 1]
        order = np.argsort(code, kind="stable")
        again = np.zeros(len(code), dtype=bool)
        again[order[1:]] = code[order[1:]] == code[order[:-1]]
        refuse(
            again,
            lambda i: HEAD + PER_OBSERVATION * i,
            lambda i: f"point {table[i, 1]:.0f} is observed twice in photo {table[i, 0]:.0f}",
        )
    refuse(
        ~(cameras[:, 6] > 0),
        lambda i: HEAD + table.size + PER_CAMERA * i + 6,
        lambda i: f"f of camera {i} must be positive, not {cameras[i, 6]:g}",
    )
    if problems:
        raise InputError(problems)

"""Reader of trajectories of TUM, KITTI and EuRoC: poses with times, as start values or observed.

TUM: ``time x y z qx qy qz qw`` in each row, seconds and metres, with blanks between; KITTI: the
twelve numbers of the rows of (R, X), and the times in a file of their own; EuRoC: a table with
commas, ``time x y z qw qx qy qz`` and further columns, nanoseconds. R leads from the axes of the
camera or body to the world, X is its place there. Times are names of poses, decimal numbers of
seconds with all digits of the file, because float64 resolves only 2e-7 s since 1970; numbers are
their differences from the first one.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from ...errors import InputError
from ...models.lens import NoDistortion
from ...network.network import Network
from ...observations import PhotoAttitude, PhotoPosition
from ...rotation import (
    TURN_ABOUT_X,
    nearest_rotation,
    omega_phi_kappa,
    rotation_of_quaternion,
)
from ...types import Array
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader
from ..source import Problems, TextSource, is_unread
from ..text_files import file_beginning
from .g2o import MAX_QUATERNION_ERROR
from .pose_graph import BODY

AxesChoice = Literal["camera", "body"]
"""Axes of the poses: x right, y down, z forward; or others, which become photogrammetric ones."""
MAX_ROTATION_ERROR = 1e-3
"""Largest difference of the rows of a rotation from orthogonal unit vectors."""
SECOND = " (2)"
"""End of the name of a pose with the time of the one before, as recorders write now and then."""
LARGEST_TIME = 1e11
"""Largest time, seconds: 1e11 milliseconds since 1970 were in 1973, so that no time of a computer
in milliseconds or less is taken for seconds."""
CAMERA = "camera"
"""Name of the camera of poses with its axes; that of poses with the axes of a body is `BODY`, so
that a writer finds the axes of the file."""
RECOGNITION_ROWS = 3
"""Number of rows by which a trajectory is recognised."""
_UNIT_OF_HEAD = re.compile(r"#\s*timestamp\s*\[([^\]]*)\]")
EUROC_HEAD = re.compile(rb"#\s*timestamp[^\n]*p_RS_R_x[^\n]*q_RS_w")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


@dataclass(frozen=True)
class TrajectoryRow:
    """What the rows of a format have."""

    name: str
    """Name of the format."""
    values: tuple[str, ...]
    """Names of the numbers of a row, in order."""
    quaternion: tuple[int, ...] = ()
    """Places of qw, qx, qy, qz; empty: the rows of (R, X)."""
    place: tuple[int, int, int] = (1, 2, 3)
    """Places of the coordinates."""
    time_unit: str = "seconds"
    """Unit of times."""
    decimals: int = 0
    """Places by which the decimal point of a time is moved left for seconds; the time is a whole
    number then."""
    further: int = 0
    """Largest number of further columns, which are not read."""


TUM = TrajectoryRow("TUM", ("time", "x", "y", "z", "qx", "qy", "qz", "qw"), quaternion=(7, 4, 5, 6))
EUROC = TrajectoryRow(
    "EuRoC",
    ("time", "x", "y", "z", "qw", "qx", "qy", "qz"),
    quaternion=(4, 5, 6, 7),
    time_unit="nanoseconds",
    decimals=9,
    further=9,
)
KITTI = TrajectoryRow("KITTI", tuple(f"{a}{i}" for a in "xyz" for i in "123t"), place=(3, 7, 11))


def row_of_trajectory(beginning: bytes) -> TrajectoryRow | None:
    """Return the format of the rows at the beginning of a file; None if they are no poses."""
    if EUROC_HEAD.match(beginning.lstrip()):
        return EUROC
    lines = [
        line.split()
        for line in beginning.decode("latin-1").splitlines()[:-1] or [beginning.decode("latin-1")]
        if line.strip() and not line.lstrip().startswith("#")
    ][:RECOGNITION_ROWS]
    if not lines or not all(_NUMBER.fullmatch(w) for words in lines for w in words):
        return None
    for row in (TUM, KITTI):
        if all(len(words) == len(row.values) for words in lines):
            found = [_rotation(row, np.array(words, dtype=float)) for words in lines]
            if all(f is not None for f in found):
                return row
    return None


def is_trajectory(path: Path) -> bool:
    """Return whether a file begins with poses of TUM, KITTI or EuRoC."""
    return row_of_trajectory(file_beginning(path)) is not None


def read_trajectory(
    path: str | Path,
    *,
    times: str | Path | None = None,
    axes: AxesChoice = "camera",
    sigma_m: float | None = None,
    sigma_rad: float | None = None,
) -> Network:
    """Read a trajectory of TUM, KITTI or EuRoC as photos without image points.

    A photo is named by the time of its pose, seconds, with all digits of the file: those of EuRoC,
    nanoseconds, have nine decimals (``1403715524.907143168``). Where there are no times it is named
    by the number of its row. Without standard deviations the poses are start values; with them they
    are observed: a `PhotoPosition` and a `PhotoAttitude`, whose time counts seconds from the first
    pose. The formats have no standard deviations. Velocities and biases of EuRoC are not read.

    Sources: the pages of the TUM RGB-D, KITTI odometry and EuRoC data sets. Tried on the 14
    trajectories of the tests of evo.

    Args:
        path: the file.
        times: file with the time of each row of KITTI, seconds.
        axes: axes of the poses: those of a camera (x right, y down, z forward), as in TUM and
            KITTI, or of a body, which are photogrammetric axes of the photo then, as ω, φ, κ are
            of the file's own rotation. The camera of the photos is named ``camera`` or ``body``
            by them: `write_trajectory` writes the same axes.
        sigma_m: standard deviation of each coordinate, metres.
        sigma_rad: standard deviation of a rotation about each axis of the body, radians.

    Raises:
        InputError: the file has problems, each with file and line: other numbers than those of a
            pose, a quaternion whose length is not 1, rows that are no rotation, a time that does
            not grow, or is beyond 1e11 s: in another unit than the format has.
    """
    if axes not in get_args(AxesChoice):
        raise InputError(f"axes must be one of {', '.join(get_args(AxesChoice))}, not {axes!r}")
    for name, value in (("sigma_m", sigma_m), ("sigma_rad", sigma_rad)):
        if value is not None and not value > 0:
            raise InputError(f"{name} must be greater than zero, not {value}")
    source = TextSource(path)
    row = row_of_trajectory("\n".join(source.lines).encode()) or _by_width(source)
    network = Network(source.path.name)
    camera = CAMERA if axes == "camera" else BODY
    network.add_camera(camera, NoDistortion(), {"c": 1.0})
    stated = None if times is None else _times(Path(times), source.problems)
    turn = np.eye(3) if axes == "camera" else TURN_ABOUT_X
    first: Decimal | None = None
    before, n = Decimal("-Infinity"), 0
    again: list[str] = []
    for line, text in source.filled():
        if text.lstrip().startswith("#"):
            unit = _UNIT_OF_HEAD.match(text.lstrip())
            if row is EUROC and unit is not None and unit[1].strip() != "ns":
                source.wrong(line, f"has times in [{unit[1][:40]}]; valid in EuRoC: ns")
            continue
        n += 1
        words = [w.strip() for w in text.split(",")] if row is EUROC else text.split()
        pose = _pose(source, line, row, words)
        if pose is None:
            continue
        name, time, rotation, place = pose
        if row is KITTI:
            name, time = str(n - 1), Decimal(0)
            if stated is not None:
                if n > len(stated):
                    continue
                name, time = stated[n - 1]
        if time == before and name in network.photos:
            again.append(name)
            name += SECOND
        elif (row is not KITTI or stated is not None) and not time > before:
            source.wrong(line, f"the time {name[:40]} does not grow: it follows {before:f} s")
            continue
        before = time
        first = time if first is None else first
        with source.problems.collect(source.place(line)):
            network.add_photo(name, camera, position=place.tolist(), rotation=rotation @ turn)
            at = source.place(line)
            since = float(time - first)
            if sigma_m is not None:
                network.add(
                    PhotoPosition(
                        name, tuple(place.tolist()), sigma=(sigma_m,) * 3, time=since, source=at
                    )
                )
            if sigma_rad is not None:
                network.add(
                    PhotoAttitude(
                        name,
                        omega_phi_kappa(rotation @ turn),
                        sigma=(sigma_rad,) * 3,
                        about="body",
                        time=since,
                        source=at,
                    )
                )
    if sigma_m is None and sigma_rad is None:
        network.without_observations = (
            f"the poses are start values; {option_text('sigma_m', '0.05')} and "
            f"{option_text('sigma_rad', '0.01')} make observations of them"
        )
        source.problems.remarks.append(network.without_observations)
    if again:
        source.problems.remarks.append(
            f"{len(again)} poses have the time of the one before, and names that end in{SECOND}; "
            f"first {again[0][:40]}"
        )
    if n == 0:
        source.wrong(0, "has no poses")
    if stated is not None and n != len(stated):
        source.wrong(0, f"has {n} poses, but {Path(str(times)).name} has {len(stated)} times")
    source.problems.finish(network)
    return network


def _by_width(source: TextSource) -> TrajectoryRow:
    """Return the format by the number of columns of the first row; its problems then follow."""
    for _, text in source.filled():
        if not text.lstrip().startswith("#"):
            if "," in text:
                return EUROC
            return KITTI if len(text.split()) > 10 else TUM
    return TUM


def _pose(
    source: TextSource, line: int, row: TrajectoryRow, words: list[str]
) -> tuple[str, Decimal, Array, Array] | None:
    """Return name, time in seconds, rotation and place of a row; None after a problem."""
    least = len(row.values)
    if not least <= len(words) <= least + row.further:
        what = f"has {len(words)} numbers; valid in {row.name}: {least}, {', '.join(row.values)}"
        source.wrong(line, what)
        return None
    numbers = [
        source.field(line, w, what).number()
        for w, what in zip(words, row.values, strict=False)
        if what != "time"
    ]
    name, time = words[0], Decimal(0)
    if row.values[0] == "time":
        largest = LARGEST_TIME * 10**row.decimals
        what = f"time in {row.time_unit}"
        numbers.insert(0, source.field(line, name, what).number(largest=largest))
        if is_unread(numbers[0]):
            return None
        time = decimal_time(name)
        if row.decimals:
            if time != time.to_integral_value():
                source.wrong(line, f"{what} must be a whole number, not {name[:40]}")
                return None
            time = time.scaleb(-row.decimals)
            name = f"{time:.{row.decimals}f}"
    if is_unread(*numbers):
        return None
    values = np.array(numbers)
    rotation = _rotation(row, values)
    if rotation is None:
        what = "its quaternion has not the length 1" if row.quaternion else "is no rotation"
        source.wrong(line, f"{what}, see the grammar of {row.name}")
        return None
    return name, time, rotation, values[list(row.place)]


def _rotation(row: TrajectoryRow, values: Array) -> Array | None:
    """Return the rotation of a row, (3, 3); None if it has none."""
    if not np.abs(np.delete(values, [0, *row.place] if row.quaternion else row.place)).max() < 2.0:
        return None
    if row.quaternion:
        q = values[list(row.quaternion)]
        length = float(np.linalg.norm(q))
        near = abs(length - 1.0) <= MAX_QUATERNION_ERROR
        return rotation_of_quaternion(q / length) if near else None
    matrix = values.reshape(3, 4)[:, :3]
    if not np.abs(matrix @ matrix.T - np.eye(3)).max() <= MAX_ROTATION_ERROR:
        return None
    return nearest_rotation(matrix) if np.linalg.det(matrix) > 0 else None


def decimal_time(text: str) -> Decimal:
    """Return a number of a file with all its digits, whose exponent may be that of Fortran."""
    return Decimal(text.strip().lower().replace("d", "e"))


def _times(path: Path, problems: Problems) -> list[tuple[str, Decimal]]:
    """Return the times of a file, one a line: text and seconds."""
    source, texts = TextSource(path, problems), list[str]()
    for line, text in source.filled():
        source.field(line, text, "time in seconds").number(largest=LARGEST_TIME)
        texts.append(text.strip())
    source.raise_all()
    return [(text, decimal_time(text)) for text in texts]


READER = Reader(
    "trajectory",
    (".tum",),
    "trajectory of TUM, KITTI or EuRoC",
    NetworkReader(read_trajectory),
    recognises=is_trajectory,
)

"""Text files of COLMAP, read and written: cameras, images, points3D, rigs, frames (.txt).

Lines that start with # are comments. An image has two lines, of which the second is empty where
nothing was measured; its name is the rest of its line and may contain blanks.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...control_characters import has_control_characters, why_refused
from ...errors import InputError, Problem
from ...types import Array, Index
from ..numbers import parse_quantity
from ..source import Problems
from ..text_files import read_text
from .colmap_model import (
    SENSOR_TYPES,
    CameraRecord,
    FrameRecord,
    ImageRecord,
    PointRecord,
    Pose,
    RigRecord,
    Sensor,
    SparseModel,
)

T = TypeVar("T")
QUOTE_SIZE = 30
"""Number of characters of a wrong word that a message quotes."""


class _Words:
    """The words of a line, taken one after another; what is wrong is an error with its line."""

    def __init__(self, line: str, where: str) -> None:
        self.words = line.split()
        self.where = where
        self.at = 0

    def word(self, what: str) -> str:
        if self.at == len(self.words):
            raise _refusal(f"{what} is missing", self.where)
        self.at += 1
        return self.words[self.at - 1]

    def whole(self, what: str, *, least: int = 0, largest: int = 2**63 - 1) -> int:
        word = self.word(what)
        digits = word[1:] if word[:1] in "+-" else word
        if not (digits.isascii() and digits.isdigit() and len(digits) < 20):
            raise _refusal(f"{what} must be a whole number, not {word[:QUOTE_SIZE]!r}", self.where)
        value = int(word)
        if not least <= value <= largest:
            raise _refusal(f"{what} must be {least} to {largest}, not {value}", self.where)
        return value

    def number(self, what: str) -> float:
        word = self.word(what)
        try:
            return _number(word)
        except ValueError as error:
            raise _refusal(f"{what}: {error}", self.where) from None

    def pose(self) -> Pose:
        w, x, y, z, tx, ty, tz = (
            self.number(n) for n in ("QW", "QX", "QY", "QZ", "TX", "TY", "TZ")
        )
        return Pose((w, x, y, z), (tx, ty, tz))

    def sensor(self) -> Sensor:
        kind = self.word("the type of a sensor")
        if kind not in SENSOR_TYPES:
            what = f"unknown type of sensor {kind[:QUOTE_SIZE]!r}; valid: {', '.join(SENSOR_TYPES)}"
            raise _refusal(what, self.where)
        return kind, self.whole("the number of a sensor")

    def end(self) -> None:
        if self.at < len(self.words):
            left = self.words[self.at][:QUOTE_SIZE]
            raise _refusal(f"nothing may follow here, but {left!r} does", self.where)


def _number(word: str) -> float:
    """Return a number; what is not finite is refused by `check_model`, with all that it finds."""
    return float(word) if word.lower().lstrip("+-") in ("nan", "inf") else parse_quantity(word)


def _refusal(what: str, where: str) -> InputError:
    return InputError(Problem(what, where))


def _lines(path: Path, found: Problems) -> list[tuple[int, str]]:
    """Return the lines that are no comments, with their numbers; blank lines stay."""
    try:
        text = read_text(path)
    except InputError as error:
        found.extend(error.problems)
        return []
    lines = text.split("\n")
    if lines and not lines[-1]:
        lines.pop()
    return [(i, line) for i, line in enumerate(lines, 1) if not line.lstrip().startswith("#")]


def _rows(path: Path, found: Problems) -> Iterator[_Words]:
    """Iterate over the lines of a table that has one line for each row."""
    for number, line in _lines(path, found):
        if line.strip():
            yield _Words(line, f"{path.name}:{number}")


def read_text_model(folder: Path) -> SparseModel:
    """Read the text files of a folder.

    Raises:
        InputError: what is no row of these files, with file and line.
    """
    found = Problems()
    cameras = _read_rows(folder / "cameras.txt", found, _camera)
    images = _images(folder / "images.txt", found)
    points = _read_rows(folder / "points3D.txt", found, _point)
    rigs = _read_rows(folder / "rigs.txt", found, _rig) if (folder / "rigs.txt").exists() else []
    frames = (
        _read_rows(folder / "frames.txt", found, _frame) if (folder / "frames.txt").exists() else []
    )
    found.raise_all()
    return SparseModel(tuple(cameras), tuple(images), tuple(points), tuple(rigs), tuple(frames))


def _read_rows(path: Path, found: Problems, row: Callable[[_Words], T]) -> list[T]:
    out = []
    for words in _rows(path, found):
        try:
            out.append(row(words))
        except InputError as error:
            found.extend(error.problems)
    return out


def _camera(words: _Words) -> CameraRecord:
    number = words.whole("CAMERA_ID", largest=2**32 - 1)
    model = words.word("MODEL")
    size = words.whole("WIDTH", largest=2**31), words.whole("HEIGHT", largest=2**31)
    parameters = []
    while words.at < len(words.words):
        parameters.append(words.number("a parameter"))
    return CameraRecord(number, model, size, tuple(parameters), words.where)


def _images(path: Path, found: Problems) -> list[ImageRecord]:
    """Read images.txt: pairs of lines."""
    out = []
    lines = iter(_lines(path, found))
    for number, line in lines:
        if not line.strip():
            continue  # between images; the second line of an image is taken below
        where = f"{path.name}:{number}"
        below, measured = next(lines, (number + 1, ""))
        try:
            words = _Words(line, where)
            image = words.whole("IMAGE_ID", largest=2**32 - 1)
            pose = words.pose()
            camera = words.whole("CAMERA_ID", largest=2**32 - 1)
            first = line.split(None, 9)
            if len(first) < 10:
                raise _refusal("NAME is missing", where)
            name = first[9].rstrip()
            if has_control_characters(name):
                raise _refusal(why_refused(name), where)
            xy, points = _measurements(measured, f"{path.name}:{below}")
            out.append(ImageRecord(image, pose, camera, name, xy, points, where))
        except InputError as error:
            found.extend(error.problems)
    return out


def _measurements(line: str, where: str) -> tuple[Array, Index]:
    """Return coordinates (n, 2) and points (n,) of the second line of an image."""
    words = line.split()
    if len(words) % 3:
        what = (
            f"the second line of an image has X Y POINT3D_ID of each measurement, "
            f"not {len(words)} words"
        )
        raise _refusal(what, where)
    try:
        if not line.isascii() or "_" in line:
            raise ValueError
        xy = np.empty((len(words) // 3, 2))
        xy[:, 0] = list(map(float, words[0::3]))
        xy[:, 1] = list(map(float, words[1::3]))
        numbers = list(map(int, words[2::3]))
    except ValueError:
        bad = next((w for i, w in enumerate(words) if not _is_number_word(w, i % 3 == 2)), "?")
        raise _refusal(f"{bad[:QUOTE_SIZE]!r} is not a number of X Y POINT3D_ID", where) from None
    if numbers and not (min(numbers) >= -1 and max(numbers) < 2**63 - 1):
        raise _refusal("POINT3D_ID must be −1, or a number from 0", where)
    return xy, np.array(numbers, dtype=np.int64)


def _is_number_word(word: str, whole: bool) -> bool:
    try:
        _number(word)
        if whole:
            int(word)
    except ValueError:
        return False
    return True


def _point(words: _Words) -> PointRecord:
    number = words.whole("POINT3D_ID", largest=2**63 - 2)
    x, y, z = (words.number(n) for n in "XYZ")
    red, green, blue = (words.whole(n, largest=255) for n in "RGB")
    error = words.number("ERROR")
    track = []
    while words.at < len(words.words):
        image = words.whole("IMAGE_ID", largest=2**32 - 1)
        track.append((image, words.whole("POINT2D_IDX", largest=2**32 - 1)))
    return PointRecord(number, (x, y, z), (red, green, blue), error, tuple(track), words.where)


def _rig(words: _Words) -> RigRecord:
    number = words.whole("RIG_ID", largest=2**32 - 1)
    n = words.whole("NUM_SENSORS", largest=10_000)
    reference = words.sensor() if n else None
    others: list[tuple[Sensor, Pose | None]] = []
    for _ in range(n - 1):
        sensor = words.sensor()
        has = words.whole("HAS_POSE", largest=1)
        others.append((sensor, words.pose() if has else None))
    words.end()
    return RigRecord(number, reference, tuple(others), words.where)


def _frame(words: _Words) -> FrameRecord:
    number = words.whole("FRAME_ID", largest=2**32 - 1)
    rig = words.whole("RIG_ID", largest=2**32 - 1)
    pose = words.pose()
    n = words.whole("NUM_DATA_IDS", largest=1_000_000)
    data = []
    for _ in range(n):
        sensor = words.sensor()
        data.append((sensor, words.whole("DATA_ID")))
    words.end()
    return FrameRecord(number, rig, pose, tuple(data), words.where)


def text_files(model: SparseModel) -> dict[str, str]:
    """Return the five text files of a model by name."""
    return {
        "cameras.txt": _joined(
            "Camera list with one line of data per camera:\n"
            "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]",
            ([c.number, c.model, *c.size, *c.parameters] for c in model.cameras),
        ),
        "images.txt": _joined(
            "Image list with two lines of data per image:\n"
            "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
            "#   POINTS2D[] as (X, Y, POINT3D_ID)",
            itertools.chain.from_iterable(
                (
                    [i.number, *i.pose.turn, *i.pose.shift, i.camera, i.name],
                    [
                        value
                        for (x, y), p in zip(i.xy.tolist(), i.points.tolist(), strict=True)
                        for value in (x, y, p)
                    ],
                )
                for i in model.images
            ),
        ),
        "points3D.txt": _joined(
            "3D point list with one line of data per point:\n"
            "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)",
            (
                [p.number, *p.xyz, *p.colour, p.error, *itertools.chain.from_iterable(p.track)]
                for p in model.points
            ),
        ),
        "rigs.txt": _joined(
            "Rig calib list with one line of data per calib:\n"
            "#   RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as "
            "(SENSOR_TYPE, SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])",
            (_rig_line(r) for r in model.rigs),
        ),
        "frames.txt": _joined(
            "Frame list with one line of data per frame:\n"
            "#   FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], NUM_DATA_IDS, "
            "DATA_IDS[] as (SENSOR_TYPE, SENSOR_ID, DATA_ID)",
            (
                [f.number, f.rig, *f.pose.turn, *f.pose.shift, len(f.data)]
                + [value for sensor, number in f.data for value in (*sensor, number)]
                for f in model.frames
            ),
        ),
    }


def _rig_line(rig: RigRecord) -> list[object]:
    out: list[object] = [rig.number, 0 if rig.reference is None else 1 + len(rig.others)]
    out += rig.reference or ()
    for sensor, pose in rig.others:
        out += [*sensor, int(pose is not None)]
        out += [] if pose is None else [*pose.turn, *pose.shift]
    return out


def _joined(head: str, rows: Iterator[Sequence[object]]) -> str:
    """Return lines of words under a comment; numbers have all digits."""
    lines = (" ".join(map(str, row)) for row in rows)
    return f"# {head}\n" + "".join(f"{line}\n" for line in lines)

"""Binary files of COLMAP, read and written: cameras, images, points3D, rigs, frames (.bin).

Numbers are little-endian. A file begins with the number of its rows, 8 bytes; a count that the
rest of the file cannot hold is refused before anything is read.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...control_characters import has_control_characters, why_refused
from ...errors import InputError, Problem
from ...files import read_bytes
from .colmap_cameras import CAMERA_MODEL_BY_NAME, CAMERA_MODEL_BY_NUMBER
from .colmap_model import (
    NO_POINT,
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
NO_POINT_ID = 2**64 - 1
"""POINT3D_ID of a measurement that belongs to no point."""
_MEASURED = np.dtype([("x", "<f8"), ("y", "<f8"), ("point", "<u8")])


class _Bytes:
    """The bytes of a file, taken one after another."""

    def __init__(self, path: Path) -> None:
        self.data = read_bytes(path)
        self.name = path.name
        self.at = 0

    @property
    def where(self) -> str:
        return f"{self.name}, byte {self.at}"

    def wrong(self, what: str) -> InputError:
        return InputError(Problem(what, self.where))

    def take(self, form: str) -> tuple[int | float, ...]:
        size = struct.calcsize("<" + form)
        if self.at + size > len(self.data):
            raise self.wrong(f"the file is cut off: it has {len(self.data)} bytes")
        out = struct.unpack_from("<" + form, self.data, self.at)
        self.at += size
        return out

    def whole(self, form: str) -> int:
        return int(self.take(form)[0])

    def count(self, form: str, each: int, what: str) -> int:
        """Return a number of things of ``each`` bytes at least."""
        before = self.where
        n = self.whole(form)
        if n * each > len(self.data) - self.at:
            left = len(self.data) - self.at
            raise InputError(Problem(f"{n} {what} do not fit into the {left} bytes left", before))
        return n

    def pose(self) -> Pose:
        w, x, y, z, tx, ty, tz = self.take("7d")
        return Pose((w, x, y, z), (tx, ty, tz))

    def sensor(self) -> Sensor:
        kind = self.whole("i")
        if not 0 <= kind < len(SENSOR_TYPES):
            names = ", ".join(f"{i} {s}" for i, s in enumerate(SENSOR_TYPES))
            raise self.wrong(f"unknown type of sensor {kind}; valid: {names}")
        return SENSOR_TYPES[kind], self.whole("I")

    def name_of_image(self) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise self.wrong("the name of an image has no end")
        try:
            name = self.data[self.at : end].decode("utf-8")
        except UnicodeDecodeError:
            raise self.wrong("the name of an image is not UTF-8") from None
        if has_control_characters(name):
            raise self.wrong(why_refused(name))
        self.at = end + 1
        return name


def read_binary_model(folder: Path) -> SparseModel:
    """Read the binary files of a folder.

    Raises:
        InputError: a file is cut off, has bytes left over, or a number that cannot be; with file
            and byte. A file is read up to its first problem, as nothing is sure behind it.
    """
    problems: list[Problem] = []

    def table(name: str, least: int, row: Callable[[_Bytes], T], needed: bool) -> tuple[T, ...]:
        path = folder / name
        if not needed and not path.exists():
            return ()
        try:
            data = _Bytes(path)
            n = data.count("Q", least, "rows")
            out = tuple(row(data) for _ in range(n))
            if data.at < len(data.data):
                raise data.wrong(f"{len(data.data) - data.at} bytes are left over")
        except InputError as error:
            problems.extend(error.problems)
            return ()
        return out

    cameras = table("cameras.bin", 24, _camera, True)
    images = table("images.bin", 73, _image, True)
    points = table("points3D.bin", 51, _point, True)
    rigs = table("rigs.bin", 8, _rig, False)
    frames = table("frames.bin", 68, _frame, False)
    if problems:
        raise InputError(problems)
    return SparseModel(cameras, images, points, rigs, frames)


def _camera(data: _Bytes) -> CameraRecord:
    where = data.where
    number, kind, width, height = (int(v) for v in data.take("IiQQ"))
    model = CAMERA_MODEL_BY_NUMBER.get(kind)
    if model is None:
        known = ", ".join(f"{m.number} {m.name}" for m in CAMERA_MODEL_BY_NUMBER.values())
        raise InputError(Problem(f"unknown camera model {kind}; valid: {known}", where))
    parameters = data.take(f"{len(model.parameters)}d")
    return CameraRecord(number, model.name, (width, height), tuple(parameters), where)


def _image(data: _Bytes) -> ImageRecord:
    where = data.where
    number = data.whole("I")
    pose = data.pose()
    camera = data.whole("I")
    name = data.name_of_image()
    n = data.count("Q", _MEASURED.itemsize, "measurements")
    measured = np.frombuffer(data.data, _MEASURED, n, data.at)
    points = measured["point"].copy()
    if ((points >= 2**63 - 1) & (points != NO_POINT_ID)).any():
        raise data.wrong("a POINT3D_ID is larger than 2⁶³ − 2")
    data.at += n * _MEASURED.itemsize
    xy = np.stack([measured["x"], measured["y"]], axis=1).astype(float)
    return ImageRecord(number, pose, camera, name, xy, points.view(np.int64), where)


def _point(data: _Bytes) -> PointRecord:
    where = data.where
    number, x, y, z, red, green, blue, error = data.take("Q3d3Bd")
    if number >= 2**63 - 1:
        raise InputError(Problem(f"POINT3D_ID {number} is larger than 2⁶³ − 2", where))
    n = data.count("Q", 8, "measurements")
    track: tuple[int, ...] = data.take(f"{2 * n}I")  # type: ignore[assignment]
    pairs = tuple(zip(track[0::2], track[1::2], strict=True))
    colour = int(red), int(green), int(blue)
    return PointRecord(int(number), (x, y, z), colour, error, pairs, where)


def _rig(data: _Bytes) -> RigRecord:
    where = data.where
    number = data.whole("I")
    n = data.count("I", 8, "sensors")
    reference = data.sensor() if n else None
    others: list[tuple[Sensor, Pose | None]] = []
    for _ in range(n - 1):
        sensor = data.sensor()
        others.append((sensor, data.pose() if data.whole("B") else None))
    return RigRecord(number, reference, tuple(others), where)


def _frame(data: _Bytes) -> FrameRecord:
    where = data.where
    number, rig = data.whole("I"), data.whole("I")
    pose = data.pose()
    n = data.count("I", 16, "data")
    pairs = []
    for _ in range(n):
        sensor = data.sensor()
        pairs.append((sensor, data.whole("Q")))
    return FrameRecord(number, rig, pose, tuple(pairs), where)


def binary_files(model: SparseModel) -> dict[str, bytes]:
    """Return the five binary files of a model by name."""
    cameras = b"".join(
        struct.pack(
            f"<IiQQ{len(c.parameters)}d",
            c.number,
            CAMERA_MODEL_BY_NAME[c.model].number,
            *c.size,
            *c.parameters,
        )
        for c in model.cameras
    )
    points = b"".join(
        struct.pack(
            f"<Q3d3BdQ{2 * len(p.track)}I",
            p.number,
            *p.xyz,
            *p.colour,
            p.error,
            len(p.track),
            *(value for pair in p.track for value in pair),
        )
        for p in model.points
    )
    frames = b"".join(
        struct.pack("<II7dI", f.number, f.rig, *f.pose.turn, *f.pose.shift, len(f.data))
        + b"".join(_sensor(s) + struct.pack("<Q", number) for s, number in f.data)
        for f in model.frames
    )
    tables = {
        "cameras.bin": (len(model.cameras), cameras),
        "images.bin": (len(model.images), b"".join(map(_image_bytes, model.images))),
        "points3D.bin": (len(model.points), points),
        "rigs.bin": (len(model.rigs), b"".join(map(_rig_bytes, model.rigs))),
        "frames.bin": (len(model.frames), frames),
    }
    return {name: struct.pack("<Q", n) + rows for name, (n, rows) in tables.items()}


def _image_bytes(image: ImageRecord) -> bytes:
    measured = np.empty(len(image.points), _MEASURED)
    measured["x"], measured["y"] = image.xy[:, 0], image.xy[:, 1]
    measured["point"] = np.where(image.points == NO_POINT, -1, image.points).view(np.uint64)
    head = struct.pack("<I7dI", image.number, *image.pose.turn, *image.pose.shift, image.camera)
    name = image.name.encode("utf-8") + b"\0"
    return head + name + struct.pack("<Q", len(measured)) + measured.tobytes()


def _sensor(sensor: Sensor) -> bytes:
    return struct.pack("<iI", SENSOR_TYPES.index(sensor[0]), sensor[1])


def _rig_bytes(rig: RigRecord) -> bytes:
    out = struct.pack("<II", rig.number, 0 if rig.reference is None else 1 + len(rig.others))
    if rig.reference is not None:
        out += _sensor(rig.reference)
    for sensor, pose in rig.others:
        out += _sensor(sensor) + struct.pack("<B", pose is not None)
        out += b"" if pose is None else struct.pack("<7d", *pose.turn, *pose.shift)
    return out

"""A sparse model of COLMAP: records of cameras, images, poses, points and rigs; checks of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ...errors import known
from ...rotation import rotation_of_quaternion
from ...types import Array, Index
from ..numbers import MAX_NUMBER
from ..source import Problems
from .colmap_cameras import CAMERA_MODEL_BY_NAME, READABLE_NAMES

NO_POINT = -1
"""Number of the point of an image measurement that belongs to none."""
SENSOR_TYPES = ("CAMERA", "IMU")
"""Types of sensors, by their numbers in binary files."""
Sensor = tuple[str, int]
"""Type and number of a sensor: ("CAMERA", 1)."""


@dataclass(frozen=True)
class CameraRecord:
    """A row of cameras."""

    number: int
    """CAMERA_ID."""
    model: str
    """Name of the camera model."""
    size: tuple[int, int]
    """Width and height, pixels."""
    parameters: tuple[float, ...]
    """Parameters in the order of the model."""
    where: str
    """File and line, or byte."""


@dataclass(frozen=True)
class Pose:
    """A rigid motion sensor_from_world (or sensor_from_rig): p = R(q) X + t."""

    turn: tuple[float, float, float, float]
    """Quaternion w, x, y, z."""
    shift: tuple[float, float, float]
    """Vector t."""

    @property
    def rotation(self) -> Array:
        """R of the quaternion, which need not have the length 1, (3, 3)."""
        return rotation_of_quaternion(np.array(self.turn) / np.linalg.norm(self.turn))

    @property
    def centre(self) -> Array:
        """Place of the sensor, −Rᵀ t, (3,)."""
        return np.asarray(-self.rotation.T @ self.shift)

    @classmethod
    def of(cls, world_R_camera: Array, centre: Array) -> Pose:
        """Return the motion of a rotation (3, 3) and a projection centre (3,)."""
        r = world_R_camera.T
        w, x, y, z = _quaternion(r)
        tx, ty, tz = (-r @ centre).tolist()
        return cls((w, x, y, z), (tx, ty, tz))

    def wrong(self) -> str:
        """Return what is wrong with it; empty if nothing is."""
        if not np.isfinite([*self.turn, *self.shift]).all():
            return "quaternion and translation must be finite numbers"
        if not 1e-6 < np.abs(self.turn).max() < 1e6:
            return "the quaternion has the length zero, or a strange one; valid: about 1"
        if np.abs(self.shift).max() > MAX_NUMBER:
            return f"the translation is larger than {MAX_NUMBER:g}"
        return ""


def _quaternion(r: Array) -> list[float]:
    """Return the quaternion (w, x, y, z), w ≥ 0, of a rotation matrix; stable at half turns too.

    The eigenvector of the largest eigenvalue of Bar-Itzhack's matrix, by the largest of 4w² … 4z².
    """
    t = np.array(
        [1 + r[0, 0] + r[1, 1] + r[2, 2], *(1 + 2 * r[i, i] - np.trace(r) for i in range(3))]
    )
    k = int(np.argmax(t))
    a = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    q = np.empty(4)
    q[k] = t[k]
    if k == 0:
        q[1:] = a
    else:
        i = k - 1
        q[0] = a[i]
        for j in range(3):
            if j != i:
                q[1 + j] = r[i, j] + r[j, i]
    q /= np.linalg.norm(q)
    return (q if q[0] >= 0 else -q).tolist()


@dataclass(frozen=True)
class ImageRecord:
    """A row of images, with its measurements."""

    number: int
    """IMAGE_ID."""
    pose: Pose
    """Camera from world."""
    camera: int
    """CAMERA_ID."""
    name: str
    """Name of the image."""
    xy: Array
    """Measured coordinates, pixels from the corner, y down, (n, 2)."""
    points: Index
    """POINT3D_ID of each; −1: none, (n,)."""
    where: str
    """File and line, or byte."""


@dataclass(frozen=True)
class PointRecord:
    """A row of points3D."""

    number: int
    """POINT3D_ID."""
    xyz: tuple[float, float, float]
    """Coordinates."""
    colour: tuple[int, int, int]
    """Red, green, blue, 0 … 255."""
    error: float
    """Mean reprojection error as COLMAP knew it, pixels."""
    track: tuple[tuple[int, int], ...]
    """IMAGE_ID and number of the measurement there, of every measurement."""
    where: str
    """File and line, or byte."""


@dataclass(frozen=True)
class RigRecord:
    """A row of rigs."""

    number: int
    """RIG_ID."""
    reference: Sensor | None
    """The sensor whose axes are those of the rig."""
    others: tuple[tuple[Sensor, Pose | None], ...]
    """The other sensors, with sensor_from_rig where it is known."""
    where: str
    """File and line, or byte."""


@dataclass(frozen=True)
class FrameRecord:
    """A row of frames: what the sensors of a rig measured at one moment."""

    number: int
    """FRAME_ID."""
    rig: int
    """RIG_ID."""
    pose: Pose
    """Rig from world."""
    data: tuple[tuple[Sensor, int], ...]
    """Sensor and number of its data; for a camera IMAGE_ID."""
    where: str
    """File and line, or byte."""


@dataclass(frozen=True)
class SparseModel:
    """A sparse model."""

    cameras: tuple[CameraRecord, ...]
    """Cameras."""
    images: tuple[ImageRecord, ...]
    """Images."""
    points: tuple[PointRecord, ...]
    """Points."""
    rigs: tuple[RigRecord, ...] = ()
    """Rigs; models before COLMAP 3.12 have none."""
    frames: tuple[FrameRecord, ...] = ()
    """Frames; the same."""


def check_model(model: SparseModel) -> None:
    """Refuse a model that contradicts itself.

    Raises:
        InputError: numbers or names that are used twice, references to nothing, unknown camera
            models, numbers that are not finite or not possible, tracks that do not fit the
            measurements; all with file and line.
    """
    found = Problems()
    _duplicates(model, found)
    for camera in model.cameras:
        for what in camera_problems(camera):
            found.wrong(what, camera.where)
    cameras = {c.number for c in model.cameras}
    points = {p.number for p in model.points}
    for image in model.images:
        for what in _image_problems(image, cameras, points):
            found.wrong(what, image.where)
    for point in model.points:
        if not (np.isfinite(point.xyz).all() and np.abs(point.xyz).max() <= MAX_NUMBER):
            found.wrong(
                f"coordinates must be finite and below {MAX_NUMBER:g}, not {point.xyz}", point.where
            )
    _tracks(model, found)
    _rigs(model, found, cameras)
    found.raise_all()


def camera_problems(camera: CameraRecord) -> Iterator[str]:
    """Yield what is wrong with a camera."""
    model = CAMERA_MODEL_BY_NAME.get(camera.model)
    if model is None or model.lens is None:
        why = "unknown camera model" if model is None else "no lens model here is the camera model"
        yield f"{why} {camera.model!r}; valid: {known(READABLE_NAMES, meant=camera.model, most=20)}"
        return
    if len(camera.parameters) != len(model.parameters):
        yield (
            f"{camera.model} has the parameters {', '.join(model.parameters)}, "
            f"not {len(camera.parameters)} numbers"
        )
        return
    if not (np.isfinite(camera.parameters).all() and np.abs(camera.parameters).max() <= MAX_NUMBER):
        yield f"parameters must be finite and below {MAX_NUMBER:g}"
        return
    given = dict(zip(model.parameters, camera.parameters, strict=True))
    for name in ("f", "fx", "fy", "w", "h"):
        if name in given and not given[name] > 0:
            yield f"{name} must be greater than zero, not {given[name]:g}"
    if "w" in given and given["w"] != 2.0 * given["h"]:
        yield (
            f"the panorama has {given['w']:g} × {given['h']:g} pixels; valid: twice as wide as high"
        )
    if min(camera.size) <= 0:
        yield f"width and height must be greater than zero, not {camera.size}"


def _image_problems(image: ImageRecord, cameras: set[int], points: set[int]) -> Iterator[str]:
    if wrong := image.pose.wrong():
        yield wrong
    if image.camera not in cameras:
        yield f"unknown CAMERA_ID {image.camera}; cameras: {known(sorted(cameras))}"
    if not image.name:
        yield "the image has no name"
    used = image.points != NO_POINT
    xy = image.xy[used]
    if not (np.isfinite(xy).all() and (np.abs(xy) <= MAX_NUMBER).all()):
        yield f"coordinates of measurements must be finite and below {MAX_NUMBER:g}"
    absent = sorted(set(image.points[used].tolist()) - points)
    if absent:
        yield f"measurements of points that points3D lacks: {known(absent)}"


def _duplicates(model: SparseModel, found: Problems) -> None:
    """Note numbers and names that are used twice."""
    tables: tuple[tuple[str, Iterable[tuple[object, str]]], ...] = (
        ("CAMERA_ID", ((c.number, c.where) for c in model.cameras)),
        ("IMAGE_ID", ((i.number, i.where) for i in model.images)),
        ("image name", ((i.name, i.where) for i in model.images)),
        ("POINT3D_ID", ((p.number, p.where) for p in model.points)),
        ("RIG_ID", ((r.number, r.where) for r in model.rigs)),
        ("FRAME_ID", ((f.number, f.where) for f in model.frames)),
    )
    for what, rows in tables:
        first: dict[object, str] = {}
        for key, where in rows:
            if key in first:
                found.wrong(f"{what} {key!r} stands at {first[key]} already", where)
            first.setdefault(key, where)


def _tracks(model: SparseModel, found: Problems) -> None:
    """Note tracks of points that do not fit the measurements of the images."""
    images = {i.number: i for i in model.images}
    count = dict.fromkeys((p.number for p in model.points), 0)
    for image in model.images:
        for number in image.points[image.points != NO_POINT].tolist():
            if number in count:
                count[number] += 1
    for point in model.points:
        for number, measured in point.track:
            image_ = images.get(number)
            fits = (
                image_ is not None
                and 0 <= measured < len(image_.points)
                and int(image_.points[measured]) == point.number
            )
            if not fits:
                what = (
                    f"the track of point {point.number} names measurement {measured} of image "
                    f"{number}, which is not a measurement of this point"
                )
                found.wrong(what, point.where)
                break
        else:
            if len(set(point.track)) != len(point.track) or len(point.track) != count[point.number]:
                what = (
                    f"the track of point {point.number} has {len(point.track)} measurements, the "
                    f"images have {count[point.number]} of it"
                )
                found.wrong(what, point.where)


def _rigs(model: SparseModel, found: Problems, cameras: set[int]) -> None:
    """Note rigs and frames that do not fit the cameras and images."""
    rigs: Mapping[int, RigRecord] = {r.number: r for r in model.rigs}
    images = {i.number: i for i in model.images}
    sensors: dict[int, set[Sensor]] = {}
    for rig in model.rigs:
        if rig.reference is None:
            found.wrong("the rig has no sensors", rig.where)
            continue
        every = [rig.reference, *(s for s, _ in rig.others)]
        sensors[rig.number] = set(every)
        if len(set(every)) < len(every):
            found.wrong("a sensor stands twice in the rig", rig.where)
        for kind, number in every:
            if kind == "CAMERA" and number not in cameras:
                found.wrong(f"unknown CAMERA_ID {number} in the rig", rig.where)
        for _, pose in rig.others:
            if pose is not None and (wrong := pose.wrong()):
                found.wrong(wrong, rig.where)
    of_image: dict[int, str] = {}
    for frame in model.frames:
        if wrong := frame.pose.wrong():
            found.wrong(wrong, frame.where)
        if frame.rig not in rigs:
            found.wrong(f"unknown RIG_ID {frame.rig}", frame.where)
            continue
        for sensor, number in frame.data:
            if sensor not in sensors.get(frame.rig, set()):
                what = f"{sensor[0]} {sensor[1]} is no sensor of rig {frame.rig}"
                found.wrong(what, frame.where)
            elif sensor[0] == "CAMERA" and number in images:
                if images[number].camera != sensor[1]:
                    what = f"image {number} is of camera {images[number].camera}, not {sensor[1]}"
                    found.wrong(what, frame.where)
                if number in of_image:
                    what = f"image {number} belongs to the frame at {of_image[number]} already"
                    found.wrong(what, frame.where)
                of_image.setdefault(number, frame.where)

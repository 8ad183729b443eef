"""Reader of transforms.json of instant-ngp, nerfstudio and NeRF: cameras and poses of photos.

``transform_matrix`` leads from the axes of the camera, x right, y up, z backwards, to the world:
these are photogrammetric axes. Cameras are those of OpenCV in pixels from the upper left corner;
``camera_angle_x`` is the angle of the whole width, f = w/2 / tan(angle/2). nerfstudio turns the
world by ``applied_transform`` and multiplies it by ``applied_scale``, which the reader undoes.

Rolling shutters are stated in two ways. instant-ngp: ``rolling_shutter`` [A, B, C, D], by which a
pixel u, v (0 to 1) has the time A + B u + C v between the poses ``transform_matrix_start`` and
``…_end``; here the readout takes 1 s, and the motion is that of the whole readout. The start is
``transform_matrix`` where the frame has no start of its own, the end is the start where it has no
end; without ``rolling_shutter`` the time of all pixels is zero. Spectacular AI's branch of
nerfstudio: ``rolling_shutter_time`` T in seconds, ``camera_linear_velocity`` and
``camera_angular_velocity`` in the axes of ``transform_matrix``, a row y is read at T (y/h − 1/2).

Sources: nerfstudio's data conventions, instant-ngp's ``scripts/colmap2nerf.py`` and
``src/nerf_loader.cu``; Spectacular AI's 3dgs-deblur, and ``forward.cu`` of its gsplat.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...models.lens import Lens
from ...models.normalised_lens import AffineNormalisedLens
from ...models.ray_lens import FisheyeLens
from ...models.rolling_shutter import UNKNOWN_READOUT, Towards
from ...network.network import Network
from ...rotation import TURN_ABOUT_X, exp_rotation, log_rotation
from ...types import Array
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader
from ..json_files import JsonNode, parse_json
from ..photogrammetry.block_source import add_pixel_camera, rotation_and_scale
from ..source import LeftOutReason, Problems
from ..text_files import file_beginning, read_text

CAMERA_MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "OPENCV", "OPENCV_FISHEYE")
"""Camera models that are read; without a name it is OPENCV."""
INTRINSIC_KEYS = (
    *("camera_model", "fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2"),
    *("camera_angle_x", "camera_angle_y", "rolling_shutter", "rolling_shutter_time"),
)
"""Keys of a camera, of the document or of a frame."""
VELOCITIES = ("camera_linear_velocity", "camera_angular_velocity")
"""Keys of the motion of a photo."""
MATRIX, START, END = "transform_matrix", "transform_matrix_start", "transform_matrix_end"
"""Keys of the pose of a photo, and of the poses between which it moves."""
MATRIX_BESIDE_START = LeftOutReason(
    f"{MATRIX} beside {START}", f"instant-ngp takes {START} in its place"
)
VELOCITIES_WITHOUT_TIME = LeftOutReason(
    "velocities of photos", "the file has no readout time: their photos stand still"
)


def is_transforms_json(path: Path) -> bool:
    """Return whether a JSON file has poses of frames as instant-ngp and nerfstudio write them."""
    beginning = file_beginning(path)
    pose = any(f'"{key}"'.encode() in beginning for key in (MATRIX, START))
    keys = (b'"frames"', b'"file_path"')
    return beginning.lstrip().startswith(b"{") and pose and all(key in beginning for key in keys)


def read_transforms_json(
    path: str | Path, *, size: tuple[float, float] | None = None, free: bool = False
) -> Network:
    """Read photos with their poses and cameras from a transforms.json.

    The file has no points and no observations: the poses are start values, or known orientations.
    Photos are named by ``file_path``. Frames with intrinsics of their own have a camera of their
    own. Motions of a rolling shutter are start values, too. Not read: sharpness, masks, depth
    files, ``aabb_scale``, ``scale``, ``offset``, ``ply_file_path``, ``exposure_time``. Tried on
    instant-ngp's fox and nerfstudio's test data, which have no motions.

    Args:
        path: the file.
        size: width and height of the images, pixels, where the file has none.
        free: whether the parameters of the cameras are unknown.

    Raises:
        InputError: the file has problems, each with file and line: other camera models
            (EQUIRECTANGULAR), times of pixels that depend on u and v or on motion blur, rolling
            shutters stated in both ways, matrices that are no rotation and shift, sizes and focal
            lengths that are missing.
    """
    if size is not None and (len(size) != 2 or not all(v > 0 for v in size)):
        raise InputError(f"size must be two numbers > 0, not {size}")
    source = Path(path)
    problems = Problems()
    root = parse_json(read_text(source), source.name)
    network = Network(source.parent.name or source.stem, datum="free")
    undo, scale = _applied(root)
    shared: dict[str, JsonNode] = {
        k: node for k in INTRINSIC_KEYS if (node := root.get(k)) is not None
    }
    made = False
    for frame in root.need("frames").list():
        with problems.collect(frame.where):
            name = frame.need("file_path").text()
            own = {k: node for k in INTRINSIC_KEYS if (node := frame.get(k)) is not None}
            camera = name if own else "camera"
            if own or not made:
                _camera(network, camera, frame if own else root, {**shared, **own}, size, free)
                made = made or not own
            moving = _moving_pose(frame, {**shared, **own}, problems)
            rotation, place = undo[:, :3] @ moving.rotation, undo[:, :3] @ (moving.place / scale)
            network.add_photo(
                name,
                camera,
                position=(place + undo[:, 3]).tolist(),
                rotation=rotation @ TURN_ABOUT_X,
            )
            velocity, turn = undo[:, :3] @ (moving.velocity / scale), TURN_ABOUT_X.T @ moving.turn
            if velocity.any() or turn.any():
                network.set_unknown("photo_motion", name, [*velocity.tolist(), *turn.tolist()])
    network.without_observations = "the file has poses alone, which are start values"
    problems.remarks.append("the file has no observations: its poses are start values")
    problems.finish(network)
    return network


def _applied(root: JsonNode) -> tuple[Array, float]:
    """Return the motion (3, 4) that undoes the applied one, and the applied scale."""
    undo, scale = np.hstack([np.eye(3), np.zeros((3, 1))]), 1.0
    node = root.get("applied_transform")
    if node is not None:
        rotation, place = _pose(node)
        undo = np.hstack([rotation.T, -(rotation.T @ place)[:, None]])
    node = root.get("applied_scale")
    if node is not None:
        scale = node.number(above=0.0)
    return undo, scale


def _pose(node: JsonNode) -> tuple[Array, Array]:
    """Return rotation and place of a matrix of three or four rows.

    Raises:
        InputError: it is no rotation and shift.
    """
    rows = np.array([row.numbers(4) for row in node.list()])
    if len(rows) not in (3, 4) or (len(rows) == 4 and rows[3].tolist() != [0, 0, 0, 1]):
        raise node.fail(f"{node.title} must have three rows of four numbers, or a fourth: 0 0 0 1")
    found = rotation_and_scale(rows[:3, :3])
    if found is None or abs(found[1] - 1.0) > 1e-3:
        raise node.fail(f"{node.title} is no rotation and shift")
    return found[0], rows[:3, 3]


@dataclass(frozen=True)
class _MovingPose:
    """Pose of the middle row of a photo, and its motion during the readout."""

    rotation: Array
    """Rotation (3, 3) from the axes of the camera, y up, to those of the file's world."""
    place: Array
    """Projection centre (3,), world of the file."""
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    """Velocity (3,), world of the file."""
    turn: Array = field(default_factory=lambda: np.zeros(3))
    """Turn about the axes of the camera, y up, (3,) radians per second."""


def _moving_pose(frame: JsonNode, given: Mapping[str, JsonNode], problems: Problems) -> _MovingPose:
    """Return pose and motion of a frame.

    Raises:
        InputError: it has no pose, or both the poses of instant-ngp and the readout time of
            Spectacular AI.
    """
    readout = _readout(given)
    stated = [frame.get(key) for key in VELOCITIES]
    start, end = frame.get(START), frame.get(END)
    timed = "rolling_shutter_time" in given
    if timed and (start is not None or end is not None):
        what = f"has {START} or {END} of instant-ngp beside rolling_shutter_time of Spectacular AI"
        raise frame.fail(f"{frame.title} {what}; valid: one of them")
    if timed and readout is not None:
        rotation, place = _pose(frame.need(MATRIX))
        v, w = (np.zeros(3) if n is None else np.array(n.numbers(3)) for n in stated)
        return _MovingPose(rotation, place, rotation @ v, w)
    name = frame.need("file_path").text()
    if any(n is not None for n in stated):
        problems.leave_out(VELOCITIES_WITHOUT_TIME, name, frame.where)
    if start is not None and frame.get(MATRIX) is not None:
        problems.leave_out(MATRIX_BESIDE_START, name, frame.where)
    r0, c0 = _pose(frame.need(MATRIX) if start is None else start)
    if end is None:
        return _MovingPose(r0, c0)
    r1, c1 = _pose(end)
    first, b, c, _ = _times(given["rolling_shutter"]) if "rolling_shutter" in given else (0.0,) * 4
    rate = b + c  # one of them is zero
    turn, middle = log_rotation((r0.T @ r1)[None])[0], first + rate / 2
    turned = r0 @ exp_rotation(middle * turn[None])[0]
    return _MovingPose(turned, c0 + middle * (c1 - c0), rate * (c1 - c0), rate * turn)


def _readout(given: Mapping[str, JsonNode]) -> tuple[float, Towards] | None:
    """Return the readout time of a camera and the side to which it proceeds; None without one.

    Raises:
        InputError: times of pixels that no rolling shutter has.
    """
    node = given.get("rolling_shutter")
    times = None if node is None else _times(node)
    if "rolling_shutter_time" in given:
        if node is not None:
            raise node.fail("rolling_shutter beside rolling_shutter_time; valid: one of them")
        seconds = given["rolling_shutter_time"].number(least=0.0)
        return (seconds, "down") if seconds else None
    if times is None:
        return None
    _, b, c, _ = times
    return (UNKNOWN_READOUT, "right" if b else "down") if b or c else None


def _times(node: JsonNode) -> tuple[float, ...]:
    """Return A, B, C, D of the times A + B u + C v + D · motion blur of pixels; D may be absent.

    Raises:
        InputError: times of pixels that no rolling shutter has.
    """
    found = list(node.list())
    a, b, c, d = (*node.numbers(3), 0.0) if len(found) == 3 else node.numbers(4)
    if d or (b and c):
        what = "has times of pixels that depend on u and v, or on the motion blur"
        raise node.fail(f"{node.title} {what}; valid: [A, B, 0, 0] or [A, 0, C, 0]")
    return a, b, c, d


def _camera(
    network: Network,
    name: str,
    owner: JsonNode,
    given: Mapping[str, JsonNode],
    size: tuple[float, float] | None,
    free: bool,
) -> None:
    """Add a camera.

    Raises:
        InputError: what is missing or wrong.
    """
    model = given["camera_model"].text() if "camera_model" in given else "OPENCV"
    if model not in CAMERA_MODELS:
        what = f"camera model {model!r} is not read; valid: {', '.join(CAMERA_MODELS)}"
        raise given["camera_model"].fail(what)

    def number(key: str, default: float = 0.0, **limits: Any) -> float:
        return given[key].number(**limits) if key in given else default

    w, h = (number(k, size[i] if size else math.nan, above=0.0) for i, k in enumerate("wh"))
    if math.isnan(w) or math.isnan(h):
        wanted = option_text("size", ("1920", "1080"))
        raise owner.fail(f"the file has no size of the images, w and h: state {wanted}")
    fx = number("fl_x", math.nan, above=0.0)
    if math.isnan(fx):
        if "camera_angle_x" not in given:
            raise owner.fail("there is neither fl_x nor camera_angle_x")
        fx = _focal_length(given["camera_angle_x"], w)
    fy = number("fl_y", math.nan, above=0.0)
    if math.isnan(fy):
        own_angle = "fl_x" not in given and "camera_angle_y" in given
        fy = _focal_length(given["camera_angle_y"], h) if own_angle else fx
    values = {"c": fy, "x0": number("cx", w / 2.0), "y0": -number("cy", h / 2.0)}
    distortion = {k: number(k) for k in ("k1", "k2", "k3", "k4")}
    unknown: tuple[str, ...] = ("c", "x0", "y0", "k1", "k2")
    lens: Lens
    if model == "OPENCV_FISHEYE":
        lens, values = FisheyeLens(), {**values, **distortion, "b1": fx / fy - 1.0}
        unknown = (*unknown, "k3", "k4", "b1")
    elif model == "OPENCV":
        lens = AffineNormalisedLens()
        values |= {**distortion, "p1": number("p2"), "p2": -number("p1"), "b1": fx - fy}
        unknown = (*unknown, "p1", "p2", "b1")
    else:
        lens, values = AffineNormalisedLens(), {**values, "b1": fx - fy}
        unknown = ("c", "x0", "y0", *(("b1",) if model == "PINHOLE" else ()))
    add_pixel_camera(
        network,
        name,
        lens,
        values,
        size=(w, h),
        free=unknown if free else (),
        readout=_readout(given),
    )


def _focal_length(angle: JsonNode, extent: float) -> float:
    """Return the focal length in pixels of the angle of an extent in pixels."""
    value = angle.number(above=0.0)
    if not value < math.pi:
        raise angle.fail(f"{angle.title} must be less than π, not {value:g}")
    return 0.5 * extent / math.tan(0.5 * value)


READER = Reader(
    "transforms",
    (".json",),
    "transforms.json of instant-ngp or nerfstudio",
    NetworkReader(read_transforms_json),
    recognises=is_transforms_json,
)

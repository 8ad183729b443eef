"""Reader of Meshroom and AliceVision (.sfm as JSON): views, intrinsics, poses, structure.

    camera = rotation (X − center),  x right, y down, z ahead
    image = (fx d_x(p), fy d_y(p)) + (width, height)/2 + principalPoint,  p = (x/z, y/z)

Numbers are texts. Matrices are written column by column. What a focal length is depends on the
version:

| version | fx | fy |
| --- | --- | --- |
| to 1.1 | pxFocalLength | fx |
| 1.2.0, 1.2.1 | pxFocalLength[0] | pxFocalLength[1] |
| 1.2.2 to 1.2.4 | focalLength · width/sensorWidth | fx / pixelRatio |
| 1.2.5 to 1.2.10 | the same | fx · pixelRatio |
| from 1.2.11 | the same / pixelRatio | focalLength · width/sensorWidth |

Before 1.2.1 principalPoint counts from the upper left corner. Source: AliceVision's
``sfmDataIO/jsonIO.cpp`` and ``camera/``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal, TypeAlias

import numpy as np

from ...errors import InputError
from ...models.lens import Lens
from ...models.normalised_lens import AffineNormalisedLens
from ...models.ray_lens import FisheyeLens
from ...network.network import Network
from ...types import Array
from ..format_reader import NetworkReader, Reader
from ..json_files import JsonNode, parse_json
from ..source import LeftOutReason, Problems, is_unread
from ..text_files import file_beginning, read_text
from .block_source import (
    PHOTOS_WITHOUT_POSE,
    RAYS_WITHOUT_PHOTO,
    TIE_PREFIX,
    ImagePoints,
    add_pixel_camera,
    rotation_and_scale,
)
from .ground_control import place_by_positions

Version: TypeAlias = tuple[int, ...]
"""Numbers of a version."""
RAYS_WITHOUT_PLACE = LeftOutReason("image points", "the file has no coordinates of them")

DISTORTION_TYPES: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "radialk1": ("k1",),
    "radialk3": ("k1", "k2", "k3"),
    "brown": ("k1", "k2", "k3", "t1", "t2"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
"""Parameters of each distortion that is read, in order."""
OLD_TYPES = {
    "pinhole": "none",
    "radial1": "radialk1",
    "radial3": "radialk3",
    "brown": "brown",
    "fisheye4": "fisheye",
}
"""Distortions by the type of an intrinsic before version 1.2.8."""


def is_meshroom(path: Path) -> bool:
    """Return whether a JSON file has views as AliceVision writes them."""
    beginning = file_beginning(path)
    return beginning.lstrip().startswith(b"{") and all(
        key in beginning for key in (b'"version"', b'"views"', b'"viewId"')
    )


def read_meshroom(
    path: str | Path,
    *,
    sigma_px: float = 1.0,
    calibration: Literal["optimised", "held"] = "optimised",
    positions: str | Path | None = None,
    sigma_positions: tuple[float, float] | None = None,
    positions_system: str | None = None,
) -> Network:
    """Read a reconstruction of Meshroom, as a free network or by positions of its photos.

    Photos have the names of their files, or of their views where these are not unique; cameras have
    the numbers of their intrinsics, tie points are named ``tie NUMBER``. Views without a pose and
    points that fewer than two photos see are left out. Locked intrinsics and poses are held. The
    format has no standard deviations. Not read: metadata, features, scales, colours, ancestors.
    Tried on the three files of AliceVision's tests, of which none has image points.

    Args:
        path: the file.
        sigma_px: standard deviation of image coordinates, pixels.
        calibration: whether the parameters of intrinsics that are not locked are unknown.
        positions: list of observed positions of photos, which places the model on the Earth:
            geo.txt of ODM, or a table, see `io.photogrammetry.coordinate_lists`; None: the model
            is free.
        sigma_positions: standard deviations of positions for which the file states no σ,
            horizontal and vertical, metres.
        positions_system: reference system of a table of positions that states none.

    Raises:
        InputError: the file has problems, each with file and line: rigs, other intrinsics and
            distortions (equidistant, fisheye1, radialk3pt, undistortions of 3DEqualizer), matrices
            that are no rotation, numbers that are none.
    """
    if not sigma_px > 0:
        raise InputError(f"sigma_px must be greater than zero, not {sigma_px}")
    source = Path(path)
    problems = Problems()
    root = parse_json(read_text(source), source.name)
    if root.get("rigs") is not None and list(root.need("rigs").list()):
        raise root.need("rigs").fail("rigs are not read")
    version = tuple(n.field(problems).integer() or 0 for n in root.need("version").list())
    network = Network(source.stem, datum="free")
    for node in _list(root, "intrinsics"):
        with problems.collect(node.where):
            _camera(network, node, version, problems, calibration == "optimised")
    photos = _photos(network, root, problems)
    images = ImagePoints(problems)
    for node in _list(root, "structure"):
        with problems.collect(node.where):
            _landmark(network, node, photos, images, sigma_px)
    seen = images.seen()
    images.leave_out(network, [n for n in network.points if seen.get(n, 0) < 2])
    images.into(network)
    problems.finish(network)
    return place_by_positions(network, positions, sigma=sigma_positions, system=positions_system)


def _list(root: JsonNode, key: str) -> list[JsonNode]:
    """Return the members of an array, which an empty text stands for, too."""
    node = root.get(key)
    return [] if node is None or node.value == "" else list(node.list())


def _text(node: JsonNode, key: str) -> str:
    return str(node.need(key).value)


def _numbers(node: JsonNode, key: str, size: int) -> tuple[float, ...]:
    """Return numbers of an array of texts.

    Raises:
        InputError: it is no array of that size, or an element is no number.
    """
    found = node.need(key)
    own = Problems()
    values = tuple(n.field(own).number() for n in _list(node, key))
    if own.count:
        raise InputError(own.problems)
    if len(values) != size:
        raise found.fail(f"{found.title} needs {size} numbers, not {len(values)}")
    return values


def _number(node: JsonNode, key: str, problems: Problems, **limits: Any) -> float:
    """Return a number that may be a text; NaN after a problem."""
    return node.need(key).field(problems).number(**limits)


def _locked(node: JsonNode, problems: Problems) -> bool:
    found = node.get("locked")
    return found is not None and found.field(problems).flag()


def _camera(
    network: Network, node: JsonNode, version: Version, problems: Problems, free: bool
) -> None:
    """Add a camera.

    Raises:
        InputError: its type or distortion is not read, or values are missing.
    """
    kind = _text(node, "type").lower()
    if version < (1, 2, 8):
        name = OLD_TYPES.get(kind, "")
        distortion, valid = name, OLD_TYPES
    else:
        distortion = _text(node, "distortionType") if kind == "pinhole" else ""
        valid = dict.fromkeys(DISTORTION_TYPES, "")
        if kind == "pinhole" and _text(node, "undistortionType") != "none":
            raise node.need("undistortionType").fail("undistortions of 3DEqualizer are not read")
    names = DISTORTION_TYPES.get(distortion)
    if names is None:
        what = f"{kind} {distortion}".strip()
        raise node.need("type").fail(f"intrinsic {what} is not read; valid: {', '.join(valid)}")
    w, h = (_number(node, k, problems, above=0.0) for k in ("width", "height"))
    fx, fy = _focal_lengths(node, version, w, problems)
    x, y = _numbers(node, "principalPoint", 2)
    if version >= (1, 2, 1):
        x, y = x + 0.5 * w, y + 0.5 * h
    given = dict(zip(names, _numbers(node, "distortionParams", len(names)), strict=True))
    if is_unread(w, h, fx, fy):
        return
    values = {"c": fy, "x0": x, "y0": -y}
    lens: Lens
    if distortion == "fisheye":
        lens, values = FisheyeLens(), {**values, **given, "b1": fx / fy - 1.0}
    else:
        lens = AffineNormalisedLens()
        values |= {k: v for k, v in given.items() if k.startswith("k")}
        values |= {"p1": given.get("t2", 0.0), "p2": -given.get("t1", 0.0), "b1": fx - fy}
    unknown = ["c", "x0", "y0", *(k for k in given if k.startswith("k"))]
    unknown += ["p1", "p2"] if distortion == "brown" else []
    held = not free or _locked(node, problems)
    add_pixel_camera(
        network, _text(node, "intrinsicId"), lens, values, size=(w, h), free=() if held else unknown
    )


def _focal_lengths(
    node: JsonNode, version: Version, width: float, problems: Problems
) -> tuple[float, float]:
    """Return fx and fy in pixels; NaN after a problem."""
    if version < (1, 2, 0):
        found = _number(node, "pxFocalLength", problems, above=0.0)
        return found, found
    if version < (1, 2, 2):
        fx, fy = _numbers(node, "pxFocalLength", 2)
        if not (fx > 0 and fy > 0):
            raise node.need("pxFocalLength").fail("focal lengths must be greater than zero")
        return fx, fy
    sensor = _number(node, "sensorWidth", problems, above=0.0)
    ratio = _number(node, "pixelRatio", problems, above=0.0)
    f = _number(node, "focalLength", problems, above=0.0) * width / sensor
    if math.isnan(f) or math.isnan(ratio):
        return math.nan, math.nan
    if version < (1, 2, 5):
        return f, f / ratio
    return (f, f * ratio) if version < (1, 2, 11) else (f / ratio, f)


@dataclass(frozen=True)
class _PhotoPose:
    """Pose of views."""

    rotation: Array
    centre: tuple[float, ...]
    locked: bool


def _photos(network: Network, root: JsonNode, problems: Problems) -> dict[str, str]:
    """Add the photos with a pose; return their names by the number of the view."""
    poses: dict[str, _PhotoPose] = {}
    for node in _list(root, "poses"):
        with problems.collect(node.where):
            number, pose = _text(node, "poseId"), node.need("pose")
            transform = pose.need("transform")
            rows = np.array(_numbers(transform, "rotation", 9)).reshape(3, 3).T
            found = rotation_and_scale(rows)
            if found is None or abs(found[1] - 1.0) > 1e-4:
                raise transform.need("rotation").fail("is no rotation matrix")
            if number in poses:
                raise node.fail(f"pose {number} stands twice")
            centre = _numbers(transform, "center", 3)
            poses[number] = _PhotoPose(found[0], centre, _locked(pose, problems))
    views = _list(root, "views")
    files = [PurePosixPath(_text(v, "path").replace("\\", "/")).name for v in views]
    names: dict[str, str] = {}
    for view, file in zip(views, files, strict=True):
        with problems.collect(view.where):
            number = _text(view, "viewId")
            name = file if file and files.count(file) == 1 else f"view {number}"
            posed = poses.get(_text(view, "poseId")) if view.get("poseId") is not None else None
            if posed is None:
                problems.leave_out(PHOTOS_WITHOUT_POSE, name, view.where)
                continue
            camera = _text(view, "intrinsicId")
            if camera not in network.cameras:
                if problems.count:
                    continue  # the camera may have a problem of its own
                raise view.fail(f"view {number} has unknown intrinsics {camera}")
            if number in names:
                raise view.fail(f"view {number} stands twice")
            network.add_photo(
                name,
                camera,
                position=posed.centre,
                rotation=posed.rotation.T,
                fixed=posed.locked,
            )
            names[number] = name
    return names


def _landmark(
    network: Network, node: JsonNode, photos: dict[str, str], images: ImagePoints, sigma: float
) -> None:
    """Add a point with its image points."""
    problems = images.problems
    name = TIE_PREFIX + _text(node, "landmarkId")
    network.add_point(name, _numbers(node, "X", 3))
    for seen in _list(node, "observations"):
        view = _text(seen, "observationId")
        if view not in photos:
            problems.leave_out(RAYS_WITHOUT_PHOTO, f"view {view}", seen.where)
        elif seen.get("x") is None:
            problems.leave_out(RAYS_WITHOUT_PLACE, name, seen.where)
        else:
            x, y = _numbers(seen, "x", 2)
            images.add(photos[view], name, (x, -y), (sigma,), seen.where)


READER = Reader(
    "meshroom",
    (".sfm", ".json"),
    "reconstruction of Meshroom",
    NetworkReader(read_meshroom),
    recognises=is_meshroom,
)

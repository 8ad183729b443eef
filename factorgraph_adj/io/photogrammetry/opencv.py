"""Calibrations of OpenCV: reader with views of the board, and writer; flags, coefficients.

OpenCV counts pixels from the centre of the first one, y down; here the upper left corner of the
image is the origin, so that half a pixel is added. Its distortion coefficients are

    k1, k2, p1, p2 [, k3 [, k4, k5, k6 [, s1, s2, s3, s4 [, τx, τy]]]]

Flags of a calibration state which parameters were fixed; their values are those of
``cv::CALIB_…``. Up to OpenCV 4 ``cv::fisheye::CALIB_…`` had values of its own; since OpenCV 5 the
fisheye model has those of the other one, and flags of its own above 2²².
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np

from ...entities import Camera
from ...errors import InputError, Problem, known, taking
from ...models.lens import Lens, NormalisedLens
from ...models.normalised_lens import AffineNormalisedLens, RationalLens
from ...models.ray_lens import FisheyeLens
from ...network.network import Network
from ...rotation import exp_rotation
from ...types import Array
from ..file_transaction import write_files
from ..format_limits import calibration_values, pixel_format
from ..format_reader import NetworkReader, Reader
from ..source import Problems, is_unread
from ..text_files import file_beginning
from .block_source import ImagePoints, add_pixel_camera
from .opencv_storage import StorageValue, read_storage

FIX_ASPECT_RATIO = 2
RATIONAL_MODEL = 1 << 14
FISHEYE_FIX_SKEW_4 = 8
FISHEYE_FIX_SKEW_5 = 1 << 25
FIRST_FLAG_OF_OPENCV_5 = 1 << 22
"""Smallest flag that the fisheye calibration of OpenCV 5 has and that of OpenCV 4 has not."""

OPENCV_PARAMETERS = ("c", "b1", "x0", "y0", "k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
PINHOLE_FLAGS: Mapping[int, tuple[str, ...]] = MappingProxyType(
    {
        FIX_ASPECT_RATIO: ("b1",),
        4: ("x0", "y0"),
        8: ("p1", "p2"),
        16: ("c", "b1"),
        32: ("k1",),
        64: ("k2",),
        128: ("k3",),
        256: OPENCV_PARAMETERS,
        1 << 11: ("k4",),
        1 << 12: ("k5",),
        1 << 13: ("k6",),
        1 << 21: ("p1", "p2"),
    }
)
"""What each flag holds, by its value: the principal point, tangential distortion, focal lengths."""
FISHEYE_FLAGS_OPENCV_4: Mapping[int, tuple[str, ...]] = MappingProxyType(
    {
        16: ("k1",),
        32: ("k2",),
        64: ("k3",),
        128: ("k4",),
        256: OPENCV_PARAMETERS,
        512: ("x0", "y0"),
        2048: ("c", "b1"),
    }
)
"""The same of ``cv::fisheye::calibrate`` up to OpenCV 4."""
PINHOLE_COEFFICIENTS = (
    "k1",
    "k2",
    "p1",
    "p2",
    "k3",
    "k4",
    "k5",
    "k6",
    "s1",
    "s2",
    "s3",
    "s4",
    "tx",
    "ty",
)
FISHEYE_COEFFICIENTS = ("k1", "k2", "k3", "k4")
OPENCV_ELEMENT_NAMES = {
    "camera_matrix": ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K"),
    "distortion": (
        *("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D"),
    ),
    "width": ("image_width", "image_Width", "width"),
    "height": ("image_height", "image_Height", "height"),
    "extrinsics": ("extrinsic_parameters", "Extrinsic_Parameters"),
    "image_points": ("image_points", "Image_points"),
    "grid_points": ("grid_points",),
    "flags": ("flags",),
    "fisheye": ("fisheye_model",),
}
"""Names that OpenCV's programs give to what is read."""


def fixed_parameters(flags: int, *, fisheye: bool) -> frozenset[str]:
    """Return the parameters that a calibration with these flags has not estimated.

    Args:
        flags: sum of the flags.
        fisheye: whether it is a calibration of the fisheye model.
    """
    table = FISHEYE_FLAGS_OPENCV_4 if fisheye and flags < FIRST_FLAG_OF_OPENCV_5 else PINHOLE_FLAGS
    out = {name for bit, names in table.items() if flags & bit for name in names}
    if not fisheye and not flags & RATIONAL_MODEL:
        out |= {"k4", "k5", "k6"}
    return frozenset(out)


def estimates_skew(flags: int) -> bool:
    """Return whether a calibration of the fisheye model with these flags estimates the skew."""
    fixed = FISHEYE_FIX_SKEW_4 if flags < FIRST_FLAG_OF_OPENCV_5 else FISHEYE_FIX_SKEW_5
    return not flags & (fixed | 256)


def read_opencv(
    path: str | Path,
    *,
    model: Literal["pinhole", "fisheye"] | None = None,
    sigma_px: float = 1.0,
    calibration: Literal["as calibrated", "held"] | Sequence[str] = "as calibrated",
    image_width: float | None = None,
    image_height: float | None = None,
) -> Network:
    """Read a calibration of OpenCV, YAML or XML, with its views where the file has them.

    The camera has fx, fy, the principal point and the distortion; its parameters are held where
    the file has the calibration alone. A file of the calibration program that has the views, the
    measured corners and the points of the board (extrinsic_parameters, image_points, grid_points)
    gives a network of photos, held board points, and an unknown calibration: fx, fy, cx, cy, and
    the coefficients that the file has, without those that its ``flags`` have held. YAML needs
    PyYAML (the extra ``opencv``). Names, dates and reprojection errors of the program are not
    read.

    Args:
        path: the file.
        model: which of OpenCV's two models the coefficients belong to; None: ``fisheye_model`` of
            the file states it, and ``pinhole`` if it has none.
        sigma_px: standard deviation of the measured corners, pixels; the file has none.
        calibration: unknown parameters of a file with views: as in OpenCV's calibration, none, or
            names of the lens model, such as ``["c", "k1"]``.
        image_width: width of the image where the file does not have it, pixels.
        image_height: height of the image where the file does not have it, pixels.

    Raises:
        InputError: the file has problems, each with file and line.
    """
    source = Path(path)
    if not isinstance(sigma_px, int | float) or not sigma_px > 0:
        raise InputError(f"sigma_px must be greater than zero, pixels, not {sigma_px!r}")
    if model not in (None, "pinhole", "fisheye"):
        raise InputError(f"unknown model {model!r}; valid: 'pinhole', 'fisheye'")
    choices = ("as calibrated", "held")
    if isinstance(calibration, str) and calibration not in choices:
        what = f"calibration {calibration!r}; valid: {', '.join(map(repr, choices))}, or names"
        raise InputError(f"unknown {what} such as ['c', 'k1']")
    problems = Problems()
    stored, last = read_storage(source)
    found = _values_by_name(stored)
    network = Network(source.stem)
    views = _views(found, problems)
    size = [image_width, image_height]
    for i, name in enumerate(("width", "height")):
        if size[i] is None and name in found:
            width = found[name].field(problems, name).number(above=0.0)
            size[i] = None if is_unread(width) else width
    camera = _camera(found, problems, _model(model, found, problems), f"{source.name}:{last}")
    if camera is not None:
        lens, values, estimated = camera
        sides = None if size[0] is None or size[1] is None else (size[0], size[1])
        named = {"as calibrated": estimated, "held": []}
        chosen = named[calibration] if isinstance(calibration, str) else list(calibration)
        free = chosen if views is not None else ()
        with problems.collect(found["camera_matrix"].where):
            add_pixel_camera(network, "camera", lens, values, size=sides, free=free)
    if views is not None and not problems.count:
        _add_views(network, views, problems, sigma_px)
    problems.finish(network)
    return network


def is_opencv(path: Path) -> bool:
    """Tell whether a file is one of OpenCV's FileStorage."""
    head = file_beginning(path)
    return b"<opencv_storage" in head or b"opencv-matrix" in head


def _values_by_name(values: Mapping[str, StorageValue]) -> dict[str, StorageValue]:
    """Return what is read by our names."""
    return {
        ours: values[theirs]
        for ours, names in OPENCV_ELEMENT_NAMES.items()
        for theirs in names
        if theirs in values
    }


def _model(given: str | None, found: Mapping[str, StorageValue], problems: Problems) -> str:
    """Return pinhole or fisheye: what is asked for, or what the file says."""
    if given is None and "fisheye" in found:
        return "fisheye" if found["fisheye"].field(problems, "fisheye_model").flag() else "pinhole"
    return given or "pinhole"


def _flags(found: Mapping[str, StorageValue], problems: Problems) -> int | None:
    """Return the flags of the calibration; None where the file has none, or after a problem."""
    if "flags" not in found:
        return None
    return found["flags"].field(problems, "flags").integer(largest=(1 << 31) - 1)


def _camera(
    found: Mapping[str, StorageValue], problems: Problems, model: str, end: str
) -> tuple[Lens, dict[str, float], list[str]] | None:
    """Return lens, values and what a calibration estimates; None after a problem."""
    if "camera_matrix" not in found:
        problems.wrong("has no camera_matrix", end)
        return None
    given = found["camera_matrix"]
    matrix = given.matrix(problems, "camera_matrix")
    if matrix is None:
        return None
    if matrix.shape != (3, 3, 1):
        problems.wrong(
            f"camera_matrix must be 3 × 3, not {matrix.shape[0]} × {matrix.shape[1]}", given.where
        )
        return None
    m = matrix[:, :, 0]
    if not (m[0, 0] > 0 and m[1, 1] > 0) or m[1, 0] or np.any(m[2] != (0, 0, 1)):
        problems.wrong("camera_matrix must be [fx s cx; 0 fy cy; 0 0 1]", given.where)
        return None
    names = FISHEYE_COEFFICIENTS if model == "fisheye" else PINHOLE_COEFFICIENTS
    k = dict.fromkeys(names, 0.0)
    stated: list[str] = []
    if "distortion" in found:
        vector = found["distortion"].matrix(problems, "distortion_coefficients")
        if vector is None:
            return None
        valid = (4,) if model == "fisheye" else (4, 5, 8, 12, 14)
        if vector.size not in valid:
            what = f"has {vector.size} distortion coefficients; valid: {', '.join(map(str, valid))}"
            problems.wrong(what, found["distortion"].where)
            return None
        stated = list(names[: vector.size])
        k |= dict(zip(stated, vector.ravel().tolist(), strict=True))
        lost = [n for n in ("s1", "s2", "s3", "s4", "tx", "ty") if k.get(n)]
        if lost:
            what = f"{', '.join(lost)} (thin prism, tilt) are not zero; no lens model has them here"
            problems.wrong(what, found["distortion"].where)
            return None
    flags = _flags(found, problems)
    held = (
        frozenset[str]() if flags is None else fixed_parameters(flags, fisheye=model == "fisheye")
    )
    fy = float(m[1, 1])
    values = {"c": fy, "x0": float(m[0, 2]) + 0.5, "y0": -float(m[1, 2]) - 0.5}
    relative = {"b1": float(m[0, 0]) / fy - 1.0, "b2": 0.0 - float(m[0, 1]) / fy}
    estimated = ["c", "x0", "y0", "b1", *(n for n in stated if n in ("k1", "k2", "p1", "p2", "k3"))]
    if model == "fisheye":
        estimated = ["c", "x0", "y0", "b1", *FISHEYE_COEFFICIENTS]
        estimated += ["b2"] if flags is not None and estimates_skew(flags) else []
        lens: Lens = FisheyeLens()
        return lens, values | relative | k, [n for n in estimated if n not in held]
    values |= {"k1": k["k1"], "k2": k["k2"], "k3": k["k3"], "p1": k["p2"], "p2": 0.0 - k["p1"]}
    quotient = {n: k[n] for n in ("k4", "k5", "k6")}
    # A given ratio fx/fy other than 1 needs the relative b1 where c is unknown.
    ratio = "b1" in held and "c" not in held and relative["b1"] != 0.0
    if any(quotient.values()) or ratio:
        estimated += quotient if any(quotient.values()) else {}
        return RationalLens(), values | relative | quotient, [n for n in estimated if n not in held]
    absolute = {"b1": float(m[0, 0]) - fy, "b2": 0.0 - float(m[0, 1])}
    return AffineNormalisedLens(), values | absolute, [n for n in estimated if n not in held]


@dataclass(frozen=True)
class _Views:
    """Poses of the board and measured corners."""

    vectors: Array
    """Rotation vectors and translations camera ← board, (views, 6)."""
    corners: Array
    """Column and row of each corner, (views, corners, 2)."""
    board: Array
    """Points of the board, (corners, 3)."""
    where: str
    """File and line."""


def _views(found: Mapping[str, StorageValue], problems: Problems) -> _Views | None:
    """Return the views of a calibration; None if the file does not have them all."""
    needed = ("extrinsics", "image_points", "grid_points")
    if not all(n in found for n in needed):
        return None
    parts = [found[n].matrix(problems, n) for n in needed]
    a, b, c = parts
    if a is None or b is None or c is None:
        return None
    board = c.reshape(-1, 3) if c.size % 3 == 0 else None
    where = found["image_points"].where
    if board is None or a.shape[1] != 6 or b.shape != (len(a), len(board), 2):
        what = (
            f"views do not fit: extrinsic_parameters {a.shape[:2]}, image_points {b.shape}, "
            f"grid_points {c.shape}"
        )
        problems.wrong(what, where)
        return None
    return _Views(a[:, :, 0], b, board, where)


def _add_views(network: Network, views: _Views, problems: Problems, sigma: float) -> None:
    """Add board points, photos and corners."""
    names = [f"corner {i}" for i in range(len(views.board))]
    for name, at in zip(names, views.board.tolist(), strict=True):
        network.add_point(name, at, fixed="xyz")
    rotations = exp_rotation(views.vectors[:, :3])
    images = ImagePoints(problems)
    for i, (r, t) in enumerate(zip(rotations, views.vectors[:, 3:], strict=True)):
        photo = f"view {i}"
        with problems.collect(views.where):
            network.add_photo(photo, "camera", position=(-r.T @ t).tolist(), rotation=r.T)
        for name, (x, y) in zip(names, views.corners[i].tolist(), strict=True):
            images.add(photo, name, (x + 0.5, -y - 0.5), (sigma,), views.where)
    images.into(network)


# -- writing --------------------------------------------------------------------------------------


@taking(Network)
def write_opencv(network: Network, path: str | Path, *, camera: str | None = None) -> None:
    """Write the calibration of a camera as YAML, or as XML for a name that ends in .xml.

    The file has image_width, image_height, camera_matrix and distortion_coefficients; photos,
    points, observations and the readout time of the camera are no part of it.

    Args:
        network: the network; that of an adjustment is `Solution.as_network`.
        path: the file.
        camera: name of the camera; None: the only one.

    Raises:
        InputError: the camera is not in pixels from the upper left corner, or OpenCV has no such
            lens; no file has changed.
    """
    target = Path(path)
    names = list(network.cameras)
    if camera is None and len(names) != 1:
        raise InputError(f"the network has {len(names)} cameras; choose one: {known(names)}")
    name = names[0] if camera is None else camera
    if name not in network.cameras:
        raise InputError(f"unknown camera {name!r}; known: {known(names, meant=name)}")
    chosen = network.cameras[name]
    size = pixel_format(chosen)
    where = f"camera {name!r}"
    if size is None:
        what = "OpenCV needs pixels of a known format, from the upper left corner of the image"
        raise InputError(Problem(what, where))
    matrix, vector = _opencv_parameters(chosen, where)
    parts = {"camera_matrix": matrix, "distortion_coefficients": vector[:, None]}
    width, height = (f"{side:.12g}" for side in size)
    if target.suffix.lower() == ".xml":
        lines = ['<?xml version="1.0"?>', "<opencv_storage>"]
        lines += [f"<image_width>{width}</image_width>", f"<image_height>{height}</image_height>"]
        for key, value in parts.items():
            rows, cols = value.shape
            numbers = " ".join(map(repr, value.ravel().tolist()))
            lines += [
                f'<{key} type_id="opencv-matrix">',
                f"  <rows>{rows}</rows>",
                f"  <cols>{cols}</cols>",
                "  <dt>d</dt>",
                f"  <data>{numbers}</data></{key}>",
            ]
        lines.append("</opencv_storage>")
    else:
        lines = ["%YAML:1.0", "---", f"image_width: {width}", f"image_height: {height}"]
        for key, value in parts.items():
            rows, cols = value.shape
            numbers = ", ".join(map(repr, value.ravel().tolist()))
            lines += [f"{key}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {cols}"]
            lines += ["   dt: d", f"   data: [ {numbers} ]"]
    write_files(target.parent, {target.name: "\n".join(lines) + "\n"})


def _opencv_parameters(camera: Camera, where: str) -> tuple[Array, Array]:
    """Return camera matrix (3, 3) and distortion coefficients of a camera.

    Raises:
        InputError: OpenCV has no such lens.
    """
    lens, k = camera.lens, calibration_values(camera)
    fy = k["c"]
    relative = type(lens) in (RationalLens, FisheyeLens)
    b1, b2 = k.get("b1", 0.0), k.get("b2", 0.0)
    fx, shear = (fy * (1 + b1), fy * b2) if relative else (fy + b1, b2)
    matrix = np.array(
        [[fx, 0.0 - shear, k["x0"] - 0.5], [0.0, fy, -k["y0"] - 0.5], [0.0, 0.0, 1.0]]
    )
    if type(lens) is FisheyeLens and not any(k[n] for n in ("p1", "p2", "s1", "s2")):
        return matrix, np.array([k[n] for n in FISHEYE_COEFFICIENTS])
    radial = [k.get(n, 0.0) for n in ("k1", "k2", "k3")]
    plain = [radial[0], radial[1], 0.0 - k.get("p2", 0.0), k.get("p1", 0.0), radial[2]]
    if type(lens) is RationalLens:
        return matrix, np.array([*plain, k["k4"], k["k5"], k["k6"]])
    fits = type(lens) in (Lens, NormalisedLens, AffineNormalisedLens)
    if not fits or k.get("k4", 0.0):
        valid = f"{NormalisedLens.kind}, {RationalLens.kind}, {FisheyeLens.kind}"
        what = f"OpenCV has no lens model {lens.kind!r} with these parameters; valid: {valid}"
        raise InputError(Problem(what, where))
    return matrix, np.array(plain)


READER = Reader(
    "opencv",
    (".yml", ".yaml", ".xml"),
    "calibration of OpenCV",
    NetworkReader(read_opencv),
    recognises=is_opencv,
)

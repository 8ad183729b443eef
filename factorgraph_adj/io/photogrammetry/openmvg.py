"""Reader of OpenMVG (sfm_data.json): views, intrinsics, poses, priors, structure, control points.

With (x, y, z) of a point in the camera, x right, y down, z ahead, p = (x/z, y/z) and r = |p|:

    camera = rotation (X − center)
    image = focal_length · d(p) + principal_point

| polymorphic_name | d(p) | lens here |
| --- | --- | --- |
| pinhole | p | `NormalisedLens` |
| pinhole_radial_k1, _k3 | p (1 + k1 r² + k2 r⁴ + k3 r⁶) | the same |
| pinhole_brown_t2 | the same + t2 (r² + 2x²) + 2 t1 x y; t1 (r² + 2y²) + 2 t2 x y | the same |
| fisheye | p θ/r (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸), θ = atan r | `FisheyeLens` |

Source: OpenMVG 2 (GitHub: openMVG/openMVG), src/openMVG/cameras/Camera_Pinhole*.hpp and *_io.hpp,
geometry/pose3.hpp, sfm/*_io.hpp, sfm/sfm_data_BA_ceres.cpp. cereal writes the name of a type and
the content of a shared pointer at their first use only, with the highest bit of the number set.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ...errors import InputError
from ...models.lens import Lens, NormalisedLens
from ...models.ray_lens import FisheyeLens
from ...network.network import Network
from ...observations import ControlPoint, PhotoPosition
from ...types import Array
from ..format_reader import NetworkReader, Reader
from ..json_files import JsonNode, parse_json
from ..source import Problems
from ..text_files import file_beginning, read_text
from .block_source import (
    MARKS_WITHOUT_PHOTO,
    PHOTOS_WITHOUT_POSE,
    RAYS_WITHOUT_PHOTO,
    TIE_PREFIX,
    ImagePoints,
    add_pixel_camera,
    rotation_and_scale,
)

OPENMVG_VERSIONS = ("0.1", "0.2", "0.3")
"""Versions of sfm_data that are read."""
CONTROL_PREFIX = "control "
"""Beginning of the names of control points; their number in the file follows."""
VIEW_TYPES = ("", "view_priors")
"""Types of views; without a name it is a plain view."""
FIRST_USE_BIT = 0x80000000
"""Bit of the number of a type or pointer that is written for the first time."""
DECLARED_TYPE_NUMBER = 0x40000000
"""Number of the type of an object that is of the declared type itself."""
UNDEFINED_INDEX = 0xFFFFFFFF
"""Number of a pose or intrinsic that a view does not have."""


@dataclass(frozen=True)
class IntrinsicDistortion:
    """Distortion of one type of intrinsics."""

    member: str | None
    """Name of the array of its parameters; None: it has none."""
    parameters: tuple[str, ...]
    """Names of the parameters here, in the order of the array."""
    signs: tuple[float, ...]
    """Factors on the parameters of the file."""
    lens: type[Lens] = NormalisedLens
    """The lens model."""


INTRINSIC_TYPES = {
    "pinhole": IntrinsicDistortion(None, (), ()),
    "pinhole_radial_k1": IntrinsicDistortion("disto_k1", ("k1",), (1.0,)),
    "pinhole_radial_k3": IntrinsicDistortion("disto_k3", ("k1", "k2", "k3"), (1.0,) * 3),
    "pinhole_brown_t2": IntrinsicDistortion(
        "disto_t2", ("k1", "k2", "k3", "p2", "p1"), (1.0, 1.0, 1.0, -1.0, 1.0)
    ),
    "fisheye": IntrinsicDistortion("fisheye", ("k1", "k2", "k3", "k4"), (1.0,) * 4, FisheyeLens),
}
"""Types of intrinsics that are read, by polymorphic_name."""


def read_openmvg(
    path: str | Path,
    *,
    sigma_px: float = 1.0,
    sigma_control_px: float = 1.0,
    sigma_control: tuple[float, float, float] = (0.01, 0.01, 0.01),
    control: Literal["observe", "check", "leave out"] = "observe",
    positions: Literal["leave out", "observe"] = "leave out",
    calibration: Literal["optimised", "held"] = "optimised",
) -> Network:
    """Read a reconstruction of OpenMVG as JSON (openMVG_main_ConvertSfM_DataFormat makes it).

    Image coordinates are pixels as in the file, columns to the right and rows down; the file does
    not say whether the first pixel begins or is centred at 0. Views without a pose, and what was
    measured in them, are left out. Photos have the names of their files, tie points ``tie NUMBER``,
    control points ``control NUMBER``. A network without control and positions is free. OpenMVG has
    no standard deviations: those of image points and of control are options. Not read: root_path,
    id_feat, colours, rotations of view_priors.

    Args:
        path: sfm_data.json.
        sigma_px: σ of image coordinates of tie points, pixels.
        sigma_control_px: σ of image coordinates of control points, pixels.
        sigma_control: σ of the coordinates of control points, X, Y, Z.
        control: whether coordinates of control points are observed, compared only, or left out
            with their measurements.
        positions: whether prior positions of views are observed, with σ = 1 / center_weight.
        calibration: whether focal length, principal point and distortion are unknown.

    Raises:
        InputError: the file has problems, each with its line: other versions and types of
            intrinsics (spherical), views that share a pose, repeated names and measurements,
            control points in another frame than the reconstruction.
    """
    source = Path(path)
    for name, value in (("sigma_px", sigma_px), ("sigma_control_px", sigma_control_px)):
        if not value > 0:
            raise InputError(f"{name} must be greater than zero, not {value}")
    if len(sigma_control) != 3 or not all(s > 0 for s in sigma_control):
        raise InputError(f"sigma_control must be three numbers > 0, not {sigma_control}")
    root = parse_json(read_text(source), source.name)
    version = root.need("sfm_data_version")
    if version.text() not in OPENMVG_VERSIONS:
        raise version.fail(f"version {version.text()!r}; valid: {', '.join(OPENMVG_VERSIONS)}")
    problems = Problems()
    network = Network(source.parent.name or source.stem)
    _cameras(network, root, problems, calibration == "optimised")
    photos = _photos(network, root, problems, positions == "observe")
    images = ImagePoints(problems)
    structure = root.get("structure")
    if structure is not None:
        for key, landmark in _entries(structure):
            with problems.collect(landmark.where):
                _landmark(network, TIE_PREFIX + str(key), landmark, photos, images, sigma_px)
    marked = root.get("control_points")
    if marked is not None and control != "leave out":
        for key, landmark in _entries(marked):
            name = CONTROL_PREFIX + str(key)
            with problems.collect(landmark.where):
                xyz = _landmark(network, name, landmark, photos, images, sigma_control_px,
                                check=control == "check")  # fmt: skip
                if control == "observe":
                    observed = ControlPoint(name, xyz, sigma=sigma_control, source=landmark.where)
                    network.add(observed)
    _without_rays(network, images)
    images.into(network)
    problems.finish(network)
    if not network.observations:
        network.datum = "free"
    return network


def is_openmvg(path: Path) -> bool:
    """Tell whether a JSON file is a reconstruction of OpenMVG."""
    return b'"sfm_data_version"' in file_beginning(path)


def _entries(node: JsonNode) -> Iterator[tuple[int, JsonNode]]:
    """Iterate over a map of cereal: an array of objects with key and value."""
    for entry in node.list():
        yield entry.need("key").integer(), entry.need("value")


class _Pointers:
    """Contents and names of types that are written at their first use."""

    def __init__(self) -> None:
        self.contents: dict[int, JsonNode] = {}
        self.types: dict[int, str] = {}

    def content(self, node: JsonNode) -> tuple[str, JsonNode]:
        """Return name of type and content of a shared pointer to a polymorphic object."""
        name = ""
        kind = node.get("polymorphic_id")
        if kind is not None and (number := kind.integer()) != DECLARED_TYPE_NUMBER:
            if number & FIRST_USE_BIT:
                self.types[number & ~FIRST_USE_BIT] = node.need("polymorphic_name").text()
            known = self.types.get(number & ~FIRST_USE_BIT)
            if known is None:
                raise kind.fail(f"type {number} has no name before it is used")
            name = known
        pointer = node.need("ptr_wrapper")
        number = pointer.need("id").integer()
        if number & FIRST_USE_BIT or pointer.get("data") is not None:
            self.contents[number & ~FIRST_USE_BIT] = pointer.need("data")
        found = self.contents.get(number & ~FIRST_USE_BIT)
        if found is None:
            raise pointer.fail(f"object {number} has no content before it is used")
        return name, found


def _cameras(network: Network, root: JsonNode, problems: Problems, free: bool) -> None:
    pointers = _Pointers()
    for key, value in _entries(root.need("intrinsics")):
        with problems.collect(value.where):
            name, data = pointers.content(value)
            kind = INTRINSIC_TYPES.get(name)
            if kind is None:
                valid = ", ".join(INTRINSIC_TYPES)
                raise value.fail(f"intrinsics of type {name!r} cannot be read; valid: {valid}")
            size = tuple(data.need(n).number(above=0.0) for n in ("width", "height"))
            x0, row = data.need("principal_point").numbers(2)
            values = {"c": data.need("focal_length").number(above=0.0), "x0": x0, "y0": -row}
            if kind.member is not None:
                given = data.need(kind.member).numbers(len(kind.parameters))
                rows = zip(kind.parameters, kind.signs, given, strict=True)
                values |= {n: sign * v for n, sign, v in rows}
            lens = kind.lens()
            estimated = {"c", "x0", "y0", *kind.parameters}
            add_pixel_camera(
                network,
                str(key),
                lens,
                values,
                size=(size[0], size[1]),
                free=tuple(n for n in lens.names if n in estimated) if free else (),
            )


def _poses(root: JsonNode, problems: Problems) -> dict[int, tuple[Array, tuple[float, ...]]]:
    """Return rotation camera ← world and projection centre by number of pose."""
    out: dict[int, tuple[Array, tuple[float, ...]]] = {}
    for key, value in _entries(root.need("extrinsics")):
        with problems.collect(value.where):
            rows = [row.numbers(3) for row in value.need("rotation").list()]
            found = rotation_and_scale(np.array(rows)) if len(rows) == 3 else None
            if found is None or abs(found[1] - 1.0) > 1e-4:
                raise value.need("rotation").fail("is no rotation matrix")
            if key in out:
                raise value.fail(f"pose {key} stands twice")
            out[key] = found[0], value.need("center").numbers(3)
    return out


def _photos(network: Network, root: JsonNode, problems: Problems, observe: bool) -> dict[int, str]:
    """Add the photos with a pose; return their names by number of view."""
    pointers = _Pointers()
    poses = _poses(root, problems)
    names: dict[int, str] = {}
    used: dict[int, str] = {}
    for key, value in _entries(root.need("views")):
        with problems.collect(value.where):
            kind, view = pointers.content(value)
            if kind not in VIEW_TYPES:
                raise value.fail(f"a view of type {kind!r} cannot be read; valid: {VIEW_TYPES[1]}")
            pose = view.need("id_pose").integer()
            folder = view.get("local_path")
            name = view.need("filename").text()
            if pose not in poses:
                problems.leave_out(PHOTOS_WITHOUT_POSE, name, view.where)
                continue
            if folder is not None and folder.text().strip("./"):
                name = f"{folder.text().rstrip('/')}/{name}"
            if pose in used:
                raise view.fail(f"view {name!r} shares pose {pose} with {used[pose]!r}")
            used[pose] = name
            camera = view.need("id_intrinsic").integer()
            if str(camera) not in network.cameras:
                if problems.count:
                    continue  # the camera may have a problem of its own
                raise view.fail(f"view {name!r} has unknown intrinsics {camera}")
            rotation, centre = poses[pose]
            network.add_photo(name, str(camera), position=centre, rotation=rotation.T)
            names[key] = name
            prior = view.get("use_pose_center_prior")
            if observe and prior is not None and prior.truth():
                weights = view.need("center_weight").numbers(3)
                if not all(w > 0 for w in weights):
                    raise view.need("center_weight").fail("must be three numbers > 0")
                at = view.need("center").numbers(3)
                sigma = tuple(1.0 / w for w in weights)
                network.add(PhotoPosition(name, at, sigma=sigma, source=view.where))
    return names


def _landmark(
    network: Network,
    name: str,
    node: JsonNode,
    photos: dict[int, str],
    images: ImagePoints,
    sigma: float,
    *,
    check: bool = False,
) -> tuple[float, ...]:
    """Add a point with its measurements; return its coordinates."""
    xyz = node.need("X").numbers(3)
    network.add_point(name, xyz, check=xyz if check else None)
    for key, seen in _entries(node.need("observations")):
        x, y = seen.need("x").numbers(2)
        if key in photos:
            images.add(photos[key], name, (x, -y), (sigma,), seen.where)
        else:
            problems = images.problems
            why = RAYS_WITHOUT_PHOTO if name.startswith(TIE_PREFIX) else MARKS_WITHOUT_PHOTO
            problems.leave_out(why, f"view {key}", seen.where)
    return xyz


def _without_rays(network: Network, images: ImagePoints) -> None:
    """Leave out tie points that fewer than two photos see."""
    seen = images.seen()
    few = [n for n in network.points if n.startswith(TIE_PREFIX) and seen.get(n, 0) < 2]
    images.leave_out(network, few)


READER = Reader(
    "openmvg",
    (".json",),
    "reconstruction of OpenMVG",
    NetworkReader(read_openmvg),
    recognises=is_openmvg,
)

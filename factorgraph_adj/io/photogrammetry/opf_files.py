"""Files of an OPF project as read: items, JSON resources, tie point clouds in glTF.

Tie points are a glTF point cloud with matches in photos. Coordinates are single-precision
numbers; the matrix of a node turns them into the axes of glTF, whose y points up: (x, y, z) of the
processing system is (x, −z, y) of glTF's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlparse

import numpy as np
import numpy.typing as npt

from ...errors import InputError, Problem
from ...files import inside, read_bytes
from ...types import Array
from ..json_files import JsonNode, parse_json
from ..text_files import read_text

JSON_FORMAT = "application/opf-{}+json"
"""Format of a resource by the name of what it holds."""
GLTF_FORMAT = "model/gltf+json"
EXTENSION_PREFIX = "application/ext-"
"""Beginning of the formats of vendors, which are not read."""
BUFFER_FORMAT = "application/gltf-buffer+bin"
"""Format of the tables of a glTF file, which names them itself."""
OPF_VERSION = "1"
"""Version of the format that is read, without what follows the point."""
READ_ITEMS = (
    *("camera_list", "input_cameras", "projected_input_cameras", "input_control_points"),
    *("projected_control_points", "constraints", "scene_reference_frame", "calibration"),
)
"""Items that are read; others are products, or belong to vendors (ext_…)."""
UNREAD_ITEMS = ("point_cloud",)
"""Items of products, which are not read."""
COMPONENT_TYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""Types of numbers by glTF's code."""
ELEMENT_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
PROCESSING_R_GLTF = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Axes of the processing system from those of glTF."""
MATCHES_EXTENSION = "OPF_mesh_primitive_matches"


@dataclass(frozen=True)
class OpfProject:
    """A project: its JSON resources by what they hold, and the glTF files of its calibration."""

    path: Path
    """The file of the project."""
    root: JsonNode
    """Its root."""
    resources: dict[str, JsonNode]
    """Roots of JSON resources by what they hold: ``calibrated-cameras`` …"""
    clouds: tuple[Path, ...]
    """glTF files of tie points."""

    def need(self, name: str) -> JsonNode:
        """Return a resource.

        Raises:
            InputError: the project has none.
        """
        if name not in self.resources:
            raise self.root.need("items").fail(f"the project has no {name}")
        return self.resources[name]

    def list(self, name: str, key: str) -> Iterator[JsonNode]:
        """Iterate over the elements of a list of a resource; nothing where either is absent."""
        found = self.resources.get(name)
        inner = None if found is None else found.get(key)
        return iter(()) if inner is None else inner.list()


def open_project(path: Path) -> OpfProject:
    """Open a project.

    Raises:
        InputError: a file is missing, is not JSON, or is none of the format.
    """
    root = _document(path, "project")
    resources: dict[str, JsonNode] = {}
    clouds: list[Path] = []
    for item in root.need("items").list():
        kind = item.need("type").text()
        if kind not in READ_ITEMS:
            if kind not in UNREAD_ITEMS and not kind.startswith("ext_"):
                valid = ", ".join((*READ_ITEMS, *UNREAD_ITEMS, "ext_…"))
                what = f"unknown type {kind[:40]!r} of an item; valid: {valid}"
                raise item.need("type").fail(what)
            continue
        for resource in item.need("resources").list():
            form = resource.need("format").text()
            name = form.removeprefix("application/opf-").removesuffix("+json")
            if form == GLTF_FORMAT and kind == "calibration":
                clouds.append(_resource_path(path.parent, resource.need("uri")))
            elif form == JSON_FORMAT.format(name):
                if name in resources:
                    raise resource.fail(f"the project has {name} twice; valid: one calibration")
                resources[name] = _document(_resource_path(path.parent, resource.need("uri")), name)
            elif form not in (GLTF_FORMAT, BUFFER_FORMAT) and not form.startswith(EXTENSION_PREFIX):
                valid = f"{JSON_FORMAT.format('…')}, {GLTF_FORMAT}"
                what = f"format {form!r} of {kind} is not read; valid: {valid}"
                raise resource.need("format").fail(what)
    return OpfProject(path, root, resources, tuple(clouds))


def _resource_path(folder: Path, node: JsonNode) -> Path:
    """Return the path of a resource by its relative address."""
    address = urlparse(node.text())
    if address.scheme or address.netloc:
        raise node.fail(f"address {node.text()!r} must be a path relative to the project")
    found = inside(folder, unquote(address.path), node.where)
    if not found.is_file():
        raise node.fail(f"there is no file {node.text()!r} beside the project")
    return found


def _document(path: Path, name: str) -> JsonNode:
    root = parse_json(read_text(path), path.name)
    form = root.need("format").text()
    if form != JSON_FORMAT.format(name):
        raise root.fail(f"has format {form!r}; valid: {JSON_FORMAT.format(name)}")
    version = root.need("version").text()
    if version.split(".")[0] != OPF_VERSION:
        raise root.need("version").fail(f"version {version} cannot be read; valid: {OPF_VERSION}.x")
    return root


def image_file_name(uri: str) -> str:
    """Return the name of an image by its address, with its page: ``a.tif#page=1``."""
    address = urlparse(uri.replace("\\", "/"))
    name = unquote(address.path).rsplit("/", 1)[-1]
    return f"{name}#{address.fragment}" if address.fragment else name


@dataclass(frozen=True)
class TieCloud:
    """Tie points and their image points."""

    points: Array
    """Coordinates in the processing system, (n, 3) metres."""
    point: npt.NDArray[np.int64]
    """Number of the point of each image point, (m,)."""
    camera: list[int]
    """Id of the camera of each image point, (m,)."""
    pixel: Array
    """Column and row of each image point, (m, 2)."""
    name: str
    """Name of the file."""


def read_tie_cloud(path: Path) -> list[TieCloud]:
    """Read the nodes of a point cloud that have image points.

    Raises:
        InputError: the file is none of the format, or a buffer is missing or too short.
    """
    root = parse_json(read_text(path), path.name)
    nodes, meshes = list(root.need("nodes").list()), list(root.need("meshes").list())
    out = []
    for node in nodes:
        index = node.need("mesh").integer()
        if not 0 <= index < len(meshes):
            raise node.fail(f"there is no mesh {index}")
        primitives = list(meshes[index].need("primitives").list())
        if len(primitives) != 1:
            raise meshes[index].fail("a mesh must have one primitive")
        extensions = primitives[0].get("extensions")
        matches = None if extensions is None else extensions.get(MATCHES_EXTENSION)
        images = None if matches is None else matches.get("imagePoints")
        if matches is None or images is None:
            continue
        reader = _Accessors(root, path)
        position = reader.read(primitives[0].need("attributes").need("POSITION"), 3)
        points = _processing_coordinates(node, np.asarray(position, dtype=float))
        ranges = reader.read(matches.need("pointIndexRanges"), 2).astype(np.uint64)
        camera = reader.read(matches.need("cameraIds"), 1)[:, 0].astype(np.int64)
        pixel = np.asarray(reader.read(images.need("pixelCoordinates"), 2), dtype=float)
        uids = [_camera_id(n) for n in matches.need("cameraUids").list()]
        packed = ranges[:, 0] | (ranges[:, 1] << np.uint64(32))
        first = (packed & np.uint64(2**40 - 1)).astype(np.int64)
        count = (packed >> np.uint64(40)).astype(np.int64)
        if len(ranges) != len(points) or len(pixel) != len(camera):
            raise matches.fail("points, ranges, cameras and pixels differ in number")
        if (first + count > len(camera)).any() or (camera >= len(uids)).any():
            raise matches.fail("an index points behind the end of the matches or the cameras")
        point = np.repeat(np.arange(len(points)), count)
        row = np.repeat(first - np.cumsum(count) + count, count) + np.arange(count.sum())
        out.append(
            TieCloud(points, point, [uids[i] for i in camera[row].tolist()], pixel[row], path.name)
        )
    return out


def _camera_id(node: JsonNode) -> int:
    """Return the id of a camera: a number, or hexadecimal digits before version 1.0."""
    if isinstance(node.value, str):
        try:
            return int(node.value, 16)
        except ValueError:
            raise node.fail(f"{node.value!r} is no id of a camera") from None
    return node.integer()


def _processing_coordinates(node: JsonNode, points: Array) -> Array:
    """Return coordinates in the processing system by the matrix of a node."""
    given = node.get("matrix")
    matrix = np.eye(4) if given is None else np.array(given.numbers(16)).reshape(4, 4).T
    if np.abs(points).max(initial=0.0) > 1e12 or not np.isfinite(points).all():
        raise node.fail("coordinates must be finite")
    return np.asarray((points @ matrix[:3, :3].T + matrix[:3, 3]) @ PROCESSING_R_GLTF.T)


class _Accessors:
    """The arrays of a glTF file by their numbers."""

    def __init__(self, root: JsonNode, path: Path) -> None:
        self.path = path
        self.accessors = list(root.need("accessors").list())
        self.views = list(root.need("bufferViews").list())
        self.buffers = list(root.need("buffers").list())

    def read(self, number: JsonNode, width: int) -> npt.NDArray[np.generic]:
        """Return an array (n, width).

        Raises:
            InputError: the array does not exist, has another width, or its file is too short.
        """
        accessor = self._of(self.accessors, number, "accessor")
        kind = accessor.need("componentType").integer()
        wide = accessor.need("type").text()
        if kind not in COMPONENT_TYPES or ELEMENT_WIDTHS.get(wide) != width:
            raise accessor.fail(f"has type {wide} of {kind} where {width} numbers are expected")
        view = self._of(self.views, accessor.need("bufferView"), "bufferView")
        buffer = self._of(self.buffers, view.need("buffer"), "buffer")
        name = buffer.need("uri").text()
        file = inside(self.path.parent, name, buffer.where)
        offset = view.get("byteOffset")
        begin = 0 if offset is None else offset.integer()
        count = accessor.need("count").integer()
        dtype = np.dtype(COMPONENT_TYPES[kind])
        try:
            content = read_bytes(file)
        except InputError as error:
            found = (Problem(f"file {name} {p.what}", buffer.where) for p in error.problems)
            raise InputError(found) from None
        size = count * width * dtype.itemsize
        if begin < 0 or count < 0 or begin + size > len(content):
            what = f"{name} is cut: {size} bytes from byte {begin}, but it has {len(content)}"
            raise InputError(Problem(what, accessor.where))
        return np.frombuffer(content, dtype, count * width, begin).reshape(-1, width)

    def _of(self, every: list[JsonNode], number: JsonNode, what: str) -> JsonNode:
        index = number.integer()
        if not 0 <= index < len(every):
            raise number.fail(f"there is no {what} {index}")
        return every[index]

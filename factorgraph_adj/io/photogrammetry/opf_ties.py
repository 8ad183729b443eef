"""Tie points of the Open Photogrammetry Format: a glTF point cloud with matches in photos.

Coordinates are single-precision numbers; the matrix of a node turns them into the axes of glTF,
whose y points up: (x, y, z) of the processing system is (x, −z, y) of glTF's.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...errors import InputError, Problem
from ...files import inside, read_bytes
from ...types import Array
from ..json_tree import Node, parse_json
from ..text import read_text

TYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""Types of numbers by glTF's code."""
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
FROM_GLTF = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Axes of the processing system from those of glTF."""
MATCHES = "OPF_mesh_primitive_matches"


@dataclass(frozen=True)
class Cloud:
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


def read_cloud(path: Path) -> list[Cloud]:
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
        matches = None if extensions is None else extensions.get(MATCHES)
        images = None if matches is None else matches.get("imagePoints")
        if matches is None or images is None:
            continue
        reader = _Accessors(root, path)
        position = reader.read(primitives[0].need("attributes").need("POSITION"), 3)
        points = _placed(node, np.asarray(position, dtype=float))
        ranges = reader.read(matches.need("pointIndexRanges"), 2).astype(np.uint64)
        camera = reader.read(matches.need("cameraIds"), 1)[:, 0].astype(np.int64)
        pixel = np.asarray(reader.read(images.need("pixelCoordinates"), 2), dtype=float)
        uids = [_uid(n) for n in matches.need("cameraUids").list()]
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
            Cloud(points, point, [uids[i] for i in camera[row].tolist()], pixel[row], path.name)
        )
    return out


def _uid(node: Node) -> int:
    """Return the id of a camera: a number, or hexadecimal digits before version 1.0."""
    if isinstance(node.value, str):
        try:
            return int(node.value, 16)
        except ValueError:
            raise node.fail(f"{node.value!r} is no id of a camera") from None
    return node.integer()


def _placed(node: Node, points: Array) -> Array:
    """Return coordinates in the processing system by the matrix of a node."""
    given = node.get("matrix")
    matrix = np.eye(4) if given is None else np.array(given.numbers(16)).reshape(4, 4).T
    if np.abs(points).max(initial=0.0) > 1e12 or not np.isfinite(points).all():
        raise node.fail("coordinates must be finite")
    return np.asarray((points @ matrix[:3, :3].T + matrix[:3, 3]) @ FROM_GLTF.T)


class _Accessors:
    """The arrays of a glTF file by their numbers."""

    def __init__(self, root: Node, path: Path) -> None:
        self.path = path
        self.accessors = list(root.need("accessors").list())
        self.views = list(root.need("bufferViews").list())
        self.buffers = list(root.need("buffers").list())

    def read(self, number: Node, width: int) -> npt.NDArray[np.generic]:
        """Return an array (n, width).

        Raises:
            InputError: the array does not exist, has another width, or its file is too short.
        """
        accessor = self._of(self.accessors, number, "accessor")
        kind = accessor.need("componentType").integer()
        wide = accessor.need("type").text()
        if kind not in TYPES or WIDTHS.get(wide) != width:
            raise accessor.fail(f"has type {wide} of {kind} where {width} numbers are expected")
        view = self._of(self.views, accessor.need("bufferView"), "bufferView")
        buffer = self._of(self.buffers, view.need("buffer"), "buffer")
        name = buffer.need("uri").text()
        file = inside(self.path.parent, name, buffer.where)
        offset = view.get("byteOffset")
        begin = 0 if offset is None else offset.integer()
        count = accessor.need("count").integer()
        dtype = np.dtype(TYPES[kind])
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

    def _of(self, every: list[Node], number: Node, what: str) -> Node:
        index = number.integer()
        if not 0 <= index < len(every):
            raise number.fail(f"there is no {what} {index}")
        return every[index]

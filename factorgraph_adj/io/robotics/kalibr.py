"""Reader of Kalibr: chains of cameras, perhaps with an inertial unit, and calibration targets.

A chain has ``cam0``, ``cam1``, …; T_cn_cnm1 takes points of the camera before to this one,
T_cam_imu those of the inertial unit; OpenVINS writes its inverse, T_imu_cam. Kalibr counts pixels
from the centre of the first one, y down, so that half a pixel is added here.

| camera_model | intrinsics | distortion_model | lens here |
| --- | --- | --- | --- |
| pinhole | fu fv pu pv | none, radtan: k1 k2 p1 p2 of OpenCV | `RationalLens` |
| pinhole | the same | equidistant: k1 to k4 of OpenCV's fisheye | `FisheyeLens` |
| pinhole | the same | fov: w | `FovLens` |
| eucm | alpha beta fu fv pu pv | none | `UnifiedLens` |
| omni | xi fu fv pu pv | none | the same, α = ξ/(1 + ξ), β = 1, f/(1 + ξ) |

Source: Kalibr's wiki (yaml-formats), ``kalibr_common/ConfigReader.py``, the grids and
``RollingShutter.hpp`` of ``aslam_cameras``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...errors import InputError
from ...models.lens import NoDistortion
from ...models.rolling_shutter import Towards
from ...network.network import Network
from ...rotation import TURN_ABOUT_X, log_rotation
from ...types import Array
from ..format_reader import NetworkReader, Reader, begins_with
from ..photogrammetry.block_source import add_pixel_camera, rotation_and_scale
from ..photogrammetry.colmap_cameras import CAMERA_MODEL_BY_NAME
from ..photogrammetry.opencv_storage import yaml_mapping
from ..source import Field, Problems, is_unread
from ..text_files import read_text
from .trajectory import CAMERA

INERTIAL_UNIT = "imu"
"""Name of the inertial unit, which carries the cameras."""
MOUNT_NAMES = ("rx", "ry", "rz", "x", "y", "z")
FOCAL_LENGTHS = ("fx", "fy", "cx", "cy")
_INTRINSICS = {
    "pinhole": FOCAL_LENGTHS,
    "eucm": ("alpha", "beta", *FOCAL_LENGTHS),
    "omni": ("xi", *FOCAL_LENGTHS),
}
"""Names of the intrinsics of each camera model, in order."""
_DISTORTIONS: Mapping[tuple[str, str], tuple[str, tuple[str, ...]]] = {
    ("pinhole", "none"): ("PINHOLE", ()),
    ("pinhole", "radtan"): ("OPENCV", ("k1", "k2", "p1", "p2")),
    ("pinhole", "equidistant"): ("OPENCV_FISHEYE", ("k1", "k2", "k3", "k4")),
    ("pinhole", "fov"): ("FOV", ("omega",)),
    ("eucm", "none"): ("EUCM", ()),
    ("omni", "none"): ("EUCM", ()),
}
"""Camera model of COLMAP with the same formula, and names of its distortion, by the names of
camera model and distortion model."""
FURTHER_KEYS = (
    "line_delay",
    "cam_overlaps",
    "rostopic",
    "timeshift_cam_imu",
    "T_cn_cnm1",
    "T_cam_imu",
    "T_imu_cam",
)


@dataclass(frozen=True)
class _Value:
    """A value of YAML with its line."""

    node: Any
    title: str
    file: str
    problems: Problems

    @property
    def where(self) -> str:
        return f"{self.file}:{self.node.start_mark.line + 1}"

    def fail(self, what: str) -> InputError:
        """Return an error about the value."""
        problems = Problems()
        problems.wrong(f"{self.title} {what}", self.where)
        return InputError(problems.problems)

    def members(self) -> dict[str, _Value]:
        """Return the values of a mapping by name."""
        if self.node.id != "mapping":
            raise self.fail("must have names and values")
        out: dict[str, _Value] = {}
        for key, node in self.node.value:
            name = str(key.value)
            if name in out:
                raise self.fail(f"has {name!r} twice")
            out[name] = _Value(node, f"{self.title} {name}".strip(), self.file, self.problems)
        return out

    def field(self) -> Field:
        """Return a scalar as a field."""
        value = self.node.value if self.node.id == "scalar" else None
        return self.problems.field(value, self.title, self.where)

    def numbers(self, size: int) -> tuple[float, ...]:
        """Return the numbers of a list; all NaN after a problem."""
        nodes = self.node.value if self.node.id == "sequence" else []
        words = [str(n.value) if n.id == "scalar" else "-" for n in nodes]
        return self.problems.field(words, self.title, self.where).numbers(size)

    def motion(self) -> Array | None:
        """Return a matrix (4, 4) of a rotation and a shift; None after a problem."""
        nodes = self.node.value if self.node.id == "sequence" else []
        if len(nodes) != 4:
            self.problems.wrong(f"{self.title} must be four lists of four numbers", self.where)
            return None
        rows = [_Value(n, self.title, self.file, self.problems).numbers(4) for n in nodes]
        if any(is_unread(row) for row in rows):
            return None
        matrix = np.array(rows)
        found = rotation_and_scale(matrix[:3, :3])
        if found is None or abs(found[1] - 1.0) > 1e-3 or matrix[3].tolist() != [0, 0, 0, 1]:
            self.problems.wrong(f"{self.title} is no rotation and shift", self.where)
            return None
        matrix[:3, :3] = found[0]
        return matrix


def read_kalibr(path: str | Path, *, calibration: Literal["held", "free"] = "held") -> Network:
    """Read a chain of cameras, or a target, of Kalibr.

    A chain becomes cameras and one exposure of the rig: photos with the names of the cameras on the
    inertial unit ``imu`` (or on ``cam0``), which stands in the origin, with held mounts. Axes of
    the carrier are those of its photo x right, y down, z ahead as the file has them. Points of a
    target are held and named by their numbers, row by row from the lower left. ``line_delay``, the
    seconds from a row to the one below, gives a camera its readout time. Not read: topics,
    overlaps, shifts of time. Kalibr's files have no standard deviations. Tried on the ten chains of
    OpenVINS, which have no delays of lines.

    Args:
        path: camchain.yaml, camchain-imucam.yaml, or the file of a target.
        calibration: whether the parameters of the cameras are unknown.

    Raises:
        InputError: the file has problems, each with file and line: camera models and distortions
            without a lens here (ds, omni with a distortion), matrices that are no motion, values
            that are missing; or PyYAML is missing.
    """
    if calibration not in ("held", "free"):
        raise InputError(f"calibration must be held or free, not {calibration!r}")
    source = Path(path)
    problems = Problems()
    root = _Value(yaml_mapping(read_text(source), source.name), "", source.name, problems)
    network = Network(source.stem, datum="given")
    members = root.members()
    if "target_type" in members:
        _target(network, members, problems)
    else:
        _chain(network, members, problems, calibration == "free")
    problems.finish(network)
    return network


@dataclass
class _Chain:
    """Motions of the cameras of a chain, from the carrier to each."""

    inertial: dict[str, Array] = field(default_factory=dict)
    """camera ← inertial unit."""
    before: dict[str, Array] = field(default_factory=dict)
    """camera ← camera before."""

    def from_carrier(self, names: list[str]) -> tuple[str, dict[str, Array]]:
        """Return the carrier, and camera ← carrier of each camera that has a place."""
        if names and all(n in self.inertial for n in names):
            return INERTIAL_UNIT, self.inertial
        out: dict[str, Array] = {names[0]: np.eye(4)} if names else {}
        for last, name in pairwise(names):
            if name in self.before and last in out:
                out[name] = self.before[name] @ out[last]
            elif name in self.inertial and names[0] in self.inertial:
                out[name] = self.inertial[name] @ np.linalg.inv(self.inertial[names[0]])
        return (names[0] if names else ""), out


def _chain(network: Network, members: dict[str, _Value], problems: Problems, free: bool) -> None:
    """Add the cameras of a chain and one exposure of it."""
    chain, names = _Chain(), list[str]()
    for name, value in members.items():
        with problems.collect(value.where):
            if not (name.startswith("cam") and name[3:].isdigit()):
                raise value.fail("is unknown; valid: cam0, cam1, …")
            keys = value.members()
            _camera(network, name, value, keys, free)
            names.append(name)
            for key, table in (("T_cam_imu", chain.inertial), ("T_cn_cnm1", chain.before)):
                motion = keys[key].motion() if key in keys else None
                if motion is not None:
                    table[name] = motion
            motion = keys["T_imu_cam"].motion() if "T_imu_cam" in keys else None
            if motion is not None:
                chain.inertial[name] = np.asarray(np.linalg.inv(motion))
    if problems.count:
        return
    carrier, from_carrier = chain.from_carrier(names)
    if len(names) > 1 or carrier == INERTIAL_UNIT:
        lost = [name for name in names if name not in from_carrier]
        for name in lost:
            what = f"{name} has no place in the rig; valid: T_cn_cnm1, T_cam_imu or T_imu_cam"
            problems.wrong(what, members[name].where)
        if lost:
            return
    if carrier == INERTIAL_UNIT:
        network.add_camera(CAMERA, NoDistortion(), {"c": 1.0})
        network.add_photo(carrier, CAMERA, position=(0, 0, 0), rotation=np.eye(3), fixed=True)
    else:
        network.add_photo(carrier, carrier, position=(0, 0, 0), rotation=np.eye(3), fixed=True)
    for name in (n for n in names if n != carrier):
        turn = from_carrier[name][:3, :3].T
        place = -turn @ from_carrier[name][:3, 3]
        b = log_rotation((TURN_ABOUT_X @ turn @ TURN_ABOUT_X)[None])[0]
        values = [*b.tolist(), *(TURN_ABOUT_X @ place).tolist()]
        network.set_mount(name, free=(), values=dict(zip(MOUNT_NAMES, values, strict=True)))
        network.add_photo(
            name, name, position=place.tolist(), rotation=turn, carrier=carrier, mount=name
        )


def _camera(
    network: Network, name: str, value: _Value, keys: dict[str, _Value], free: bool
) -> None:
    """Add a camera."""
    needed = ("camera_model", "intrinsics", "resolution")
    for key in needed:
        if key not in keys:
            raise value.fail(f"has no {key}")
    for key, entry in keys.items():
        if key not in (*needed, "distortion_model", "distortion_coeffs", *FURTHER_KEYS):
            valid = ", ".join((*needed, "distortion_model", "distortion_coeffs", *FURTHER_KEYS))
            raise entry.fail(f"is unknown; valid: {valid}")
    names = keys["camera_model"].field().choice(_INTRINSICS)
    if names is None:
        return
    model = str(keys["camera_model"].node.value)
    distortion = "none"
    if "distortion_model" in keys:
        distortion = keys["distortion_model"].field().name()
    found = _DISTORTIONS.get((model, distortion))
    if found is None:
        valid = ", ".join(d for m, d in _DISTORTIONS if m == model)
        raise keys["distortion_model"].fail(f"{distortion!r} of {model} is unknown; valid: {valid}")
    given = dict(zip(names, keys["intrinsics"].numbers(len(names)), strict=True))
    coefficients = keys.get("distortion_coeffs")
    if found[1] and coefficients is None:
        raise value.fail("has no distortion_coeffs")
    if not found[1] and coefficients is not None and coefficients.node.value:
        raise coefficients.fail("stand without a distortion_model")
    if found[1] and coefficients is not None:
        numbers = coefficients.numbers(len(found[1]))
        given |= dict(zip(found[1], numbers, strict=True))
    size = keys["resolution"].numbers(2)
    if is_unread(*given.values(), *size):
        return
    if not (given["fx"] > 0 and given["fy"] > 0 and min(size) > 0):
        raise value.fail("has a focal length or a resolution that is not greater than zero")
    if "xi" in given:
        xi = given.pop("xi")
        given |= {"alpha": xi / (1.0 + xi), "beta": 1.0}
        given |= {"fx": given["fx"] / (1.0 + xi), "fy": given["fy"] / (1.0 + xi)}
    given |= {"cx": given["cx"] + 0.5, "cy": given["cy"] + 0.5}
    known = CAMERA_MODEL_BY_NAME[found[0]]
    assert known.lens is not None  # of every model of the table
    values = known.to_lens([given[p] for p in known.parameters])
    unknown = (*known.unknowns, "x0", "y0") if free else ()
    add_pixel_camera(
        network,
        name,
        known.lens,
        values,
        size=(size[0], size[1]),
        free=unknown,
        readout=_readout(keys, size[1]),
    )


def _readout(keys: Mapping[str, _Value], rows: float) -> tuple[float, Towards] | None:
    """Return the readout time of a camera and its side; None if all rows are exposed at once."""
    if "line_delay" not in keys:
        return None
    delay = keys["line_delay"].field().number()
    if is_unread(delay) or delay == 0.0:
        return None
    return abs(delay) * rows, "down" if delay > 0 else "up"


# -- targets --------------------------------------------------------------------------------------

TARGETS: Mapping[str, tuple[str, ...]] = {
    "aprilgrid": ("tagCols", "tagRows", "tagSize", "tagSpacing"),
    "checkerboard": ("targetCols", "targetRows", "rowSpacingMeters", "colSpacingMeters"),
    "circlegrid": ("targetCols", "targetRows", "spacingMeters", "asymmetricGrid"),
}
"""Keys of each target: numbers of columns and rows, sizes in metres; tagSpacing is the ratio of a
gap to the size of a tag."""
MAX_TARGET_SIDE = 1000
"""Largest number of rows or columns of a target."""


def _target(network: Network, members: dict[str, _Value], problems: Problems) -> None:
    """Add the points of a target."""
    kind = members.pop("target_type")
    keys = kind.field().choice(TARGETS)
    if keys is None:
        return
    for name, value in members.items():
        if name not in keys:
            problems.wrong(f"{name} is unknown; valid: {', '.join(keys)}", value.where)
    missing = [k for k in keys if k not in members]
    if missing:
        problems.wrong(f"the target has no {', '.join(missing)}", kind.where)
        return
    columns, rows = (members[k].field().integer(least=1, largest=MAX_TARGET_SIDE) for k in keys[:2])
    sizes = [
        members[k].field().number(above=0.0) if k != "asymmetricGrid" else members[k].field().flag()
        for k in keys[2:]
    ]
    if columns is None or rows is None or is_unread(*sizes) or problems.count:
        return
    shape = str(kind.node.value)
    if shape == "aprilgrid":
        size, spacing = sizes
        step = (1.0 + spacing) * size
        x = [step * (i // 2) + size * (i % 2) for i in range(2 * columns)]
        y = [step * (i // 2) + size * (i % 2) for i in range(2 * rows)]
        places = [(a, b) for b in y for a in x]
    elif shape == "checkerboard":
        places = [(sizes[1] * c, sizes[0] * r) for r in range(rows) for c in range(columns)]
    else:
        apart, asymmetric = sizes
        places = [
            ((2 * c + r % 2) * apart if asymmetric else c * apart, r * apart)
            for r in range(rows)
            for c in range(columns)
        ]
    for i, (a, b) in enumerate(places):
        network.add_point(str(i), (a, b, 0.0), fixed="xyz")


READER = Reader(
    "kalibr",
    (".yaml", ".yml"),
    "chain of cameras or target of Kalibr",
    NetworkReader(read_kalibr),
    recognises=begins_with(
        rb"(?:\s*(?:#[^\n]*|%YAML[^\n]*|---[ \t]*\r?)\n)*\s*"
        rb"(?:cam\d+:\s*(?:#[^\n]*)?\n(?:[ \t-][^\n]*\n|\s*\n)*?[ \t]+camera_model:"
        rb"|target_type:\s*['\"]?(?:aprilgrid|checkerboard|circlegrid))"
    ),
)

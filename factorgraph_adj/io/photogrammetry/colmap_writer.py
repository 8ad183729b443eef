"""Writer of sparse models of COLMAP from a network or an adjusted one, with its rigs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from ...entities import Camera, Photo
from ...errors import InputError, Problem, known, taking
from ...models.base import DegenerateError
from ...network.network import Network
from ...observations.relative_poses import RelativeRotation
from ...rotation import TURN_ABOUT_X, exp_rotation, log_rotation
from ...solve.solution import Solution
from ...types import Array
from ..file_transaction import write_files
from ..format_limits import motions_of_photos
from .colmap_binary_files import binary_files
from .colmap_cameras import CameraModel, candidate_models, normalised_lens, smallest_model
from .colmap_model import (
    CameraRecord,
    FrameRecord,
    ImageRecord,
    PointRecord,
    Pose,
    RigRecord,
    Sensor,
    SparseModel,
)
from .colmap_text_files import text_files

MAX_MOUNT_TURN_RAD, MAX_MOUNT_SHIFT = 1e-6, 1e-5
"""Largest turn (radians) and shift (parts of the distances in the rig, or metres) of a member from
its mount; a member that is further off is no part of a rigid rig."""
POINT_COLOUR = (128, 128, 128)
"""Colour of the points, which a network does not have."""
WRITTEN_TABLES = ("cameras", "images", "points3D", "rigs", "frames")
"""Files of a model, without suffix."""
_NUMBER = re.compile("0|[1-9][0-9]{0,17}")


@dataclass
class Rigs:
    """Rigs of a network."""

    mounts: dict[int, dict[int, str]] = field(default_factory=dict)
    """Mount of each other camera, by reference camera and camera."""
    members: dict[str, dict[str, str]] = field(default_factory=dict)
    """Mount of each member, by carrier and member."""

    @property
    def stand_ins(self) -> set[str]:
        """Photos that carry others."""
        return set(self.members)


def network_rigs(network: Network, cameras: Mapping[str, int]) -> Rigs:
    """Return the rigs that COLMAP can express; empty: there are none.

    COLMAP has one mount for each camera, and a camera belongs to one rig. A network with other
    rigs, or with members that are off their mounts, has none here: its photos are alone.

    Args:
        network: photos with poses.
        cameras: number of the camera of each photo.
    """
    out = Rigs()
    reference: dict[int, int] = {}
    for o in network.observations.values():
        if not isinstance(o, RelativeRotation) or o.mount is None:
            continue
        if (
            max(map(abs, o.value)) > MAX_MOUNT_TURN_RAD
        ):  # an observed rotation, not a tie of a member
            continue
        carrier, member = o.photos()
        first, second = cameras[carrier], cameras[member]
        known = out.mounts.setdefault(first, {})
        off = (
            first == second
            or known.get(second, o.mount) != o.mount
            or reference.get(second, first) != first
            or reference.get(first, first) != first
            or not _on_mount(network, carrier, member, o.mount)
        )
        if off:
            return Rigs()
        reference[first] = reference[second] = first
        known[second] = o.mount
        out.members.setdefault(carrier, {})[member] = o.mount
    carried = {m for members in out.members.values() for m in members}
    return Rigs() if carried & set(out.members) else out


def mount_pose(network: Network, mount: str, scale: float = 1.0) -> Pose:
    """Return sensor_from_rig of a mount."""
    values = np.array(network.mounts[mount].values)
    b = exp_rotation(values[None, :3])[0]
    return Pose.of(TURN_ABOUT_X @ b @ TURN_ABOUT_X, scale * TURN_ABOUT_X @ values[3:6])


def _on_mount(network: Network, carrier: str, member: str, mount: str) -> bool:
    """Return whether a member is where its mount puts it."""
    (r_a, x_a), (r_b, x_b) = (_pose(network.photos[n]) for n in (carrier, member))
    pose = mount_pose(network, mount)
    turn = log_rotation((pose.rotation @ r_a.T @ r_b)[None])[0]
    shift = x_b - x_a - r_a @ pose.centre
    distance = max(1.0, float(np.linalg.norm(pose.centre)))
    return bool(
        np.linalg.norm(turn) <= MAX_MOUNT_TURN_RAD
        and np.linalg.norm(shift) <= MAX_MOUNT_SHIFT * distance
    )


def _pose(photo: Photo) -> tuple[Array, Array]:
    assert photo.rotation is not None
    assert photo.position is not None
    return photo.rotation, np.array(photo.position)


def rig_records(
    network: Network,
    rigs: Rigs,
    images: Mapping[str, int],
    cameras: Mapping[str, int],
    poses: Mapping[str, Pose],
) -> tuple[tuple[RigRecord, ...], tuple[FrameRecord, ...]]:
    """Return rigs and frames of all images; an image alone has a rig of one camera.

    Args:
        network: the network.
        rigs: its rigs.
        images: number of each image.
        cameras: number of the camera of each photo.
        poses: camera from world of each photo.
    """
    carried = {m: c for c, members in rigs.members.items() for m in members}
    of_camera: dict[int, int] = {}
    records: list[RigRecord] = []
    for number in sorted(set(cameras.values())):
        if any(number in others for others in rigs.mounts.values()):
            continue
        others = rigs.mounts.get(number, {})
        records.append(
            RigRecord(
                len(records) + 1,
                ("CAMERA", number),
                tuple((("CAMERA", c), mount_pose(network, m)) for c, m in sorted(others.items())),
                "",
            )
        )
        for camera in (number, *others):
            of_camera[camera] = len(records)
    frames: list[FrameRecord] = []
    for name in poses:
        if name in carried:
            continue
        own = [n for n in (name, *rigs.members.get(name, ())) if n in images]
        if not own:
            continue
        data: list[tuple[Sensor, int]] = [(("CAMERA", cameras[n]), images[n]) for n in own]
        frames.append(
            FrameRecord(len(frames) + 1, of_camera[cameras[name]], poses[name], tuple(data), "")
        )
    return tuple(records), tuple(frames)


@taking(Network | Solution)
def write_colmap(
    network: Network | Solution,
    path: str | Path,
    *,
    files: Literal["binary", "text"] = "binary",
    shift: Sequence[float] = (0.0, 0.0, 0.0),
) -> None:
    """Write photos, calibration, points and image points as a sparse model of COLMAP.

    Names that are numbers remain the numbers of cameras and points; others get the numbers after
    the largest. Images are numbered from 1, in the order of the photos. The camera model is the
    smallest one that has all parameters that are not zero or not held. Rigs with one mount for
    each camera are written as rigs; photos of other rigs are alone.

    Photos without image points, as a transforms.json has them, are a model of known poses, which
    COLMAP takes for triangulation (``point_triangulator``).

    Standard deviations, observations of other kinds, and points without image points have no place
    in the format: they are left out, as is all that a network knows of held and weighted unknowns,
    and the readout times of its cameras.

    Args:
        network: the network with its given poses and coordinates, or a solution.
        path: the folder; it is created.
        files: whether the five files are binary or text.
        shift: coordinates that become the origin of the model, metres. Programs for dense matching
            compute with single precision, which a grid coordinate of 5 000 km overtaxes.

    Raises:
        InputError: no photos; cameras whose image unit is not the pixel, without a stated
            format, or with a lens that COLMAP does not have; photos without a pose, or with a
            motion during the readout; points without coordinates; a folder with files of the other
            kind, which COLMAP would read instead. The message lists everything, and nothing is
            written.
    """
    folder = Path(path)
    calibrations: Mapping[str, Array] = {}
    if isinstance(network, Solution):
        solution, network = network, network.as_network()
        calibrations = {
            f: solution.state["calibration"][solution.number("calibration", f)]
            for f, photo in network.photos.items()
            if network.cameras[photo.camera].per_photo
        }
    if files not in ("binary", "text"):
        raise InputError(f"unknown files {files!r}; valid: binary, text")
    origin = np.asarray(shift, dtype=float)
    if origin.shape != (3,) or not np.isfinite(origin).all():
        raise InputError(f"shift must be three numbers, metres, not {shift!r}")
    problems = _inexpressible(network, folder, ".txt" if files == "binary" else ".bin")
    if problems:
        raise InputError(problems)
    model = _model(network, calibrations, origin)
    write_files(folder, binary_files(model) if files == "binary" else text_files(model))


def _inexpressible(network: Network, folder: Path, other: str) -> list[Problem]:
    """Return what the format cannot express, except of lenses."""
    problems = motions_of_photos(network, "COLMAP")
    _, point, _, _ = network.images.columns()
    if not network.photos:
        problems.append(Problem("the network has no photos", "colmap"))
    others = [f"{n}{other}" for n in WRITTEN_TABLES]
    there = [n for n in others if (folder / n).exists()]
    if there:
        what = (
            f"the folder has {known(there)}: COLMAP reads binary files where there are both, so "
            "that one of the two models would be hidden; choose another folder"
        )
        problems.append(Problem(what, str(folder)))
    for name, f in network.photos.items():
        if f.rotation is None or f.position is None or not np.isfinite(f.position).all():
            problems.append(Problem("has no pose: write the solution", f"photo {name!r}"))
        if any(c in name for c in "\0\n\r") or name != name.strip():
            what = "a name with line breaks, or blanks at its ends, cannot be written"
            problems.append(Problem(what, f"photo {name!r}"))
    names = list(network.points)
    for i in np.unique(point).tolist():
        if not np.isfinite(network.points[names[i]].coordinates).all():
            what = "has no coordinates: write the solution (adjust --export colmap:FOLDER)"
            problems.append(Problem(what, f"point {names[i]!r}"))
    used = {network.photos[f].camera for f in network.photos}
    for name in used:
        camera = network.cameras[name]
        where = f"camera {name!r}"
        if camera.unit != "px":
            what = f"image coordinates are {camera.unit}, not pixels: convert them"
            problems.append(Problem(what, where))
        if camera.format is None or any(s != round(s) for s in camera.format):
            what = f"needs a format in whole pixels, width and height, not {camera.format}"
            problems.append(Problem(what, where))
        if not candidate_models(normalised_lens(camera.lens, _values(camera, camera.values))[0]):
            what = f"COLMAP has no camera model of the lens model {camera.lens.kind!r}"
            problems.append(Problem(what, where))
    return problems


def _values(camera: Camera, values: Iterable[float]) -> dict[str, float]:
    return dict(zip(camera.lens.names, values, strict=False))


def _numbers(names: Iterable[str], least: int) -> dict[str, int]:
    """Return a number for each name: itself where it is one, others after the largest."""
    every = list(names)
    out = {n: int(n) for n in every if _NUMBER.fullmatch(n) and int(n) >= least}
    largest = max(out.values(), default=least - 1)
    rest = [n for n in every if n not in out]
    out |= {n: largest + 1 + i for i, n in enumerate(rest)}
    return {n: out[n] for n in every}


@dataclass(frozen=True)
class _Camera:
    """A camera as it is written."""

    record: CameraRecord
    from_corner: Array
    """What is added to image coordinates with y up to count from the upper left corner, (2,)."""


def _camera(camera: Camera, number: int, given: Iterable[float]) -> _Camera | Problem:
    """Return a camera, or what is wrong with its parameters."""
    values = _values(camera, given)
    assert camera.format is not None
    width, height = (round(s) for s in camera.format)
    corner = camera.corners()
    assert corner is not None
    left, top = corner[0][0], corner[1][1]
    kind, normal = normalised_lens(camera.lens, values)
    free = {n for n, f in zip(camera.lens.names, camera.fixed, strict=True) if not f}
    used = {n for n in normal if n not in ("c", "x0", "y0") and (n in free or normal[n] != 0.0)}
    if kind.kind == "eucm" and "beta" not in used:
        used.add("beta")
    model: CameraModel | None = smallest_model(kind, used)
    if model is None:
        what = f"COLMAP has no camera model with {', '.join(sorted(used))} of {camera.lens.kind!r}"
        return Problem(what, f"camera {camera.name!r}")
    normal |= {"x0": values["x0"] - left, "y0": values["y0"] - top}
    if model.name == "EQUIRECTANGULAR":
        round_ = width / (2.0 * np.pi)
        off = max(
            abs(normal["c"] - round_) / round_,
            abs(normal["x0"] / width - 0.5),
            abs(normal["y0"] / height + 0.5),
            abs(width / height - 2.0),
        )
        if off > 1e-9:
            what = "COLMAP's panorama has the whole sphere: c = width/2π, and its middle as x0, y0"
            return Problem(what, f"camera {camera.name!r}")
    parameters = tuple(model.from_lens(normal, (width, height)))
    record = CameraRecord(number, model.name, (width, height), parameters, "")
    return _Camera(record, np.array([-left, -top]))


def _model(network: Network, calibrations: Mapping[str, Array], shift: Array) -> SparseModel:
    """Return the model.

    Raises:
        InputError: parameters of cameras that no camera model has.
    """
    photo, point, xy, _ = network.images.columns()
    problems: list[Problem] = []
    of_photo, cameras = _cameras(network, calibrations, problems)
    if problems:
        raise InputError(problems)
    number_of = {f: cameras[c].record.number for f, c in of_photo.items()}
    rigs = network_rigs(network, number_of)
    seen = set(np.unique(photo).tolist())
    images_: list[ImageRecord] = []
    poses: dict[str, Pose] = {}
    numbers: dict[str, int] = {}
    used = np.unique(point)
    names = list(network.points)
    point_number = _numbers([names[i] for i in used.tolist()], 0)
    track: dict[int, list[tuple[int, int]]] = {int(i): [] for i in used}
    off = np.full(len(photo), np.nan)
    order = np.argsort(photo, kind="stable")
    first = np.searchsorted(photo[order], np.arange(len(network.photos) + 1))
    places = np.array([p.coordinates for p in network.points.values()]).reshape(-1, 3)
    id_of = np.zeros(len(names), dtype=np.int64)
    id_of[used] = [point_number[names[i]] for i in used.tolist()]
    for i, (name, f) in enumerate(network.photos.items()):
        assert f.rotation is not None
        assert f.position is not None
        poses[name] = Pose.of(f.rotation, np.array(f.position) - shift)
        if i not in seen and name in rigs.stand_ins:
            continue
        rows = order[first[i] : first[i + 1]]
        number = numbers[name] = len(numbers) + 1
        camera = cameras[of_photo[name]]
        measured = (xy[rows] + camera.from_corner) * [1.0, -1.0]
        images_.append(
            ImageRecord(
                number, poses[name], camera.record.number, name, measured, id_of[point[rows]], ""
            )
        )
        for k, p in enumerate(point[rows].tolist()):
            track[p].append((number, k))
        off[rows] = _reprojection_errors(network, calibrations, name, xy[rows], places[point[rows]])
    error = np.bincount(point, np.nan_to_num(off), len(names)) / np.maximum(
        np.bincount(point, np.isfinite(off), len(names)), 1
    )
    points = []
    for i in used.tolist():
        x, y, z = (np.array(network.points[names[i]].coordinates) - shift).tolist()
        points.append(
            PointRecord(
                int(id_of[i]), (x, y, z), POINT_COLOUR, float(error[i]), tuple(track[i]), ""
            )
        )
    rig_rows, frames = rig_records(network, rigs, numbers, number_of, poses)
    records = tuple(c.record for c in cameras.values())
    return SparseModel(records, tuple(images_), tuple(points), rig_rows, frames)


def _cameras(
    network: Network, calibrations: Mapping[str, Array], problems: list[Problem]
) -> tuple[dict[str, str], dict[str, _Camera]]:
    """Return the key of the camera of each photo, and the cameras by key.

    A camera with a calibration for each photo becomes one camera for each photo.
    """
    of_photo, given = {}, {}
    for name, f in network.photos.items():
        camera = network.cameras[f.camera]
        key = f"{f.camera} {name}" if camera.per_photo else f.camera
        of_photo[name] = key
        given[key] = (camera, calibrations.get(name, np.array(camera.values)))
    numbers = _numbers(given, 1)
    out: dict[str, _Camera] = {}
    for key, (camera, values) in given.items():
        made = _camera(camera, numbers[key], values.tolist())
        if isinstance(made, Problem):
            problems.append(made)
        else:
            out[key] = made
    return of_photo, out


def _reprojection_errors(
    network: Network, calibrations: Mapping[str, Array], photo: str, xy: Array, x: Array
) -> Array:
    """Return the reprojection errors (n,) of image points xy (n, 2) of points x (n, 3), pixels.

    They are NaN where they are undefined.
    """
    f = network.photos[photo]
    camera = network.cameras[f.camera]
    assert f.rotation is not None
    p = (x - np.array(f.position)) @ f.rotation
    k = calibrations.get(photo, np.array(camera.values))[None, : len(camera.lens.names)]
    ray = p[:, 0], p[:, 1], p[:, 2]
    try:
        v = camera.lens.seen(ray, xy[:, 0], xy[:, 1], k, jacobians=False).v
    except DegenerateError:
        return np.full(len(xy), np.nan)
    return np.asarray(np.hypot(*v))

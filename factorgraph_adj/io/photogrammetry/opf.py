"""Reader of OPF of Pix4D and others: cameras, positions, control, constraints, tie points.

The frame of the network is the processing system of the project: the coordinates of its base
system, scaled, swapped where the base system is left-handed, and shifted. A projected base system
is taken as Cartesian, as the format does: without curvature and scale of the projection.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ...errors import InputError
from ...models.lens import NormalisedLens
from ...models.rolling_shutter import Towards
from ...network.network import Network
from ...observations import ControlPoint, PhotoPosition, PointDirection, SlopeDistance
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader, beginning_has
from ..json_files import JsonNode
from ..source import LeftOutReason, Problems
from .block_source import (
    MARKS_WITHOUT_PHOTO,
    PHOTOS_WITHOUT_POSE,
    POINTS_WITH_FEW_RAYS,
    RAYS_WITHOUT_PHOTO,
    TIE_PREFIX,
    ImagePoints,
    add_pixel_camera,
)
from .opf_files import OpfProject, image_file_name, open_project, read_tie_cloud
from .rolling_shutters import RollingShutter, ShutterMotions, ShutterOptions

TIES_AS_CHECK_POINTS = LeftOutReason(
    "manual tie points", "they are check points without given coordinates"
)
POSE_WITHOUT_CAPTURE = LeftOutReason("poses", "no capture has their camera")
POSITION_WITHOUT_PHOTO = LeftOutReason("positions of captures", "they have no calibrated camera")

UNSAID = "rolling_shutter='refuse' asks for photos that stand still"
"""Why motions are refused: on request alone, since the format says what they are."""
OPF_PARAMETERS = ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2")
"""Parameters of a perspective camera, all of which a calibration estimates."""


def read_opf(
    path: str | Path,
    *,
    calibration: Literal["optimised", "held"] = "optimised",
    positions: Literal["observe", "leave out"] = "observe",
    tie_points: bool = True,
    sigma_px: float = 1.0,
    sigma_mark_px: float = 1.0,
    rigs: Literal["refuse", "apart"] = "refuse",
    rolling_shutter: RollingShutter = "half readout",
    readout: float | None = None,
    readout_towards: Towards = "down",
    sigma_shift: float = 1.0,
    sigma_turn: float | None = None,
) -> Network:
    """Read a project of the Open Photogrammetry Format.

    Calibrated cameras give poses and interior orientations; without them, input cameras give
    interior orientations and approximate positions. Ground control points with their standard
    deviations, check points, manual tie points, marks with their accuracies, positions of
    captures, scale and orientation constraints, and the tie points of the sparse point cloud are
    read. Manual tie points that are check points take no part and are left out. Attitudes of
    captures, dense clouds, and items of vendors (ext_…) are not read.

    ``rolling_shutter`` of a calibrated camera is Δc of the paper to which the format refers
    (Vautherin et al. 2016): c(t) = c₀ + λ Δc with λ from −1 to 1, in the axes of the processing
    system. These axes and this range are those of the equations as openMVG's branch with a model of
    rolling shutters repeats them. That λ is −1 in the first row and 1 in the last one is taken: no
    public file with values was found that would show it.

    Args:
        path: project.opf, or its folder.
        calibration: whether the interior orientation is unknown; the format does not say it.
        positions: whether the positions of captures are observed.
        tie_points: whether the tie points of the sparse point cloud are read.
        sigma_px: standard deviation of their image coordinates, pixels; the format has none.
        sigma_mark_px: standard deviation of a mark of accuracy 1, pixels.
        rigs: "apart" reads cameras of one capture as photos that nothing ties together.
        rolling_shutter: what becomes of motions during the readout, see `RollingShutter`;
            "estimate" gives all photos of sensors with a rolling shutter an unknown motion (of all
            sensors where the file names none).
        readout: readout time of the whole sensor, seconds; None: unknown, motions are those of the
            whole readout (1 s).
        readout_towards: side of the image to which the readout proceeds.
        sigma_shift: standard deviation of the shift during the readout about that of the file, or
            about zero, metres.
        sigma_turn: standard deviation of the turn during the readout, radians; 0: held; None: 0.01
            with "estimate", otherwise held, as the format has no turns.

    Raises:
        InputError: a file is missing or has problems, each with file and line.
    """
    source = Path(path)
    if source.is_dir():
        found = sorted(source.glob("*.opf"))
        if len(found) != 1:
            raise InputError(f"{source} has {len(found)} files .opf; name one of them")
        source = found[0]
    for name, value in (("sigma_px", sigma_px), ("sigma_mark_px", sigma_mark_px)):
        if not value > 0:
            raise InputError(f"{name} must be greater than zero, not {value}")
    options = ShutterOptions(rolling_shutter, readout, readout_towards, sigma_shift, sigma_turn)
    project = open_project(source)
    problems = Problems()
    names = project.root.get("name")
    network = Network(source.stem if names is None else names.text())
    motions = ShutterMotions(options, network, problems, UNSAID)
    photos = _Cameras(
        project, network, problems, calibration == "optimised", rigs == "apart", motions
    )
    photos.add()
    if positions == "observe":
        _positions(project, network, problems, photos.names)
    images = ImagePoints(problems)
    _control(project, network, problems, images, photos.names, sigma_mark_px)
    _constraints(project, network, problems)
    if tie_points:
        _ties(project, network, problems, images, photos.names, sigma_px)
    images.into(network)
    motions.finish()
    problems.finish(network)
    kinds = {o.kind for o in network.observations.values()}
    if not kinds & {ControlPoint.kind, PhotoPosition.kind}:
        network.datum = "free"
    return network


@dataclass
class _Cameras:
    """The cameras of a project while they are read; OPF's cameras are photos here."""

    project: OpfProject
    network: Network
    problems: Problems
    free: bool
    apart: bool
    motions: ShutterMotions

    def add(self) -> None:
        """Add sensors as cameras and cameras as photos; ``names`` has the photos by id."""
        self.names: dict[int, str] = {}
        self.sensors: dict[int, str] = {}
        listed = {
            n.need("id").integer(): image_file_name(n.need("uri").text())
            for n in self.project.list("camera-list", "cameras")
        }
        inputs = {n.need("id").integer(): n for n in self.project.list("input-cameras", "sensors")}
        done = {
            n.need("id").integer(): n for n in self.project.list("calibrated-cameras", "sensors")
        }
        self.project.need("input-cameras")
        for ident, node in inputs.items():
            with self.problems.collect(node.where):
                self._sensor(ident, node, done.get(ident, node))
        poses = {
            n.need("id").integer(): n for n in self.project.list("calibrated-cameras", "cameras")
        }
        taken = set()
        for capture in self.project.list("input-cameras", "captures"):
            with self.problems.collect(capture.where):
                every = list(capture.need("cameras").list())
                used = [c for c in every if not poses or c.need("id").integer() in poses]
                for camera in every:
                    ident = camera.need("id").integer()
                    taken.add(ident)
                    if poses and ident not in poses:
                        name = listed.get(ident, f"camera {ident}")
                        self.problems.leave_out(PHOTOS_WITHOUT_POSE, name, camera.where)
                if len(used) > 1 and not self.apart:
                    only = option_text("rigs", "apart")
                    what = f"a capture of several cameras (a rig) is read with {only} only"
                    raise capture.fail(what)
                for camera in used:
                    self._photo(camera, poses, listed)
        for ident, node in poses.items():
            if ident not in taken:
                self.problems.leave_out(POSE_WITHOUT_CAPTURE, f"camera {ident}", node.where)

    def _sensor(self, ident: int, given: JsonNode, node: JsonNode) -> None:
        size = given.need("image_size_px").numbers(2)
        internals = node.need("internals")
        kind = internals.need("type")
        if kind.text() != "perspective":
            raise kind.fail(f"a {kind.text()} camera cannot be read; valid: perspective")
        column, row = internals.need("principal_point_px").numbers(2)
        k1, k2, k3 = internals.need("radial_distortion").numbers(3)
        t1, t2 = internals.need("tangential_distortion").numbers(2)
        focal = internals.need("focal_length_px").number(above=0.0)
        values = {"c": focal, "x0": column, "y0": -row, "k1": k1, "k2": k2, "k3": k3}
        values |= {"p1": t2, "p2": -t1}
        label = given.get("name")
        name = f"sensor {ident}" if label is None else label.text()
        name = name if name not in self.network.cameras else f"{name} ({ident})"
        self.sensors[ident] = name
        shutter = given.get("shutter_type")
        if shutter is not None and shutter.text() == "rolling":
            self.motions.read_by_row.append(name)
        free = OPF_PARAMETERS if self.free else ()
        sides = (size[0], size[1])
        add_pixel_camera(self.network, name, NormalisedLens(), values, size=sides, free=free)

    def _photo(
        self, camera: JsonNode, poses: Mapping[int, JsonNode], listed: Mapping[int, str]
    ) -> None:
        ident = camera.need("id").integer()
        sensor = camera.need("sensor_id")
        if sensor.integer() not in self.sensors:
            if not self.problems.count:
                raise sensor.fail(f"unknown sensor {sensor.integer()}")
            return
        name = listed.get(ident, f"camera {ident}")
        name = name if name not in self.network.photos else f"{name} ({ident})"
        pose = poses.get(ident)
        position, angles, shift = None, None, None
        if pose is not None:
            shutter = pose.get("rolling_shutter")
            shift = None if shutter is None else np.array(shutter.numbers(3))
            position = pose.need("position").numbers(3)
            angles = np.deg2rad(pose.need("orientation_deg").numbers(3)).tolist()
        self.network.add_photo(
            name, self.sensors[sensor.integer()], position=position, omega_phi_kappa=angles
        )
        self.names[ident] = name
        if shift is not None and shift.any():
            self.motions.add(name, camera.where if pose is None else pose.where, shift, np.zeros(3))


def _positions(
    project: OpfProject, network: Network, problems: Problems, photos: Mapping[int, str]
) -> None:
    """Observe the projection centres of reference cameras by the positions of captures."""
    reference = {
        n.need("id").integer(): n.need("reference_camera_id").integer()
        for n in project.list("input-cameras", "captures")
    }
    for capture in project.list("projected-input-cameras", "captures"):
        with problems.collect(capture.where):
            place = capture.get("geolocation")
            photo = photos.get(reference.get(capture.need("id").integer(), -1))
            if photo is None and place is not None:
                capture_name = f"capture {capture.need('id').integer()}"
                problems.leave_out(POSITION_WITHOUT_PHOTO, capture_name, capture.where)
            if place is None or photo is None:
                continue
            if "gps-bias" in project.resources:
                what = "positions have a bias (gps_bias) that cannot be read"
                raise capture.fail(f"{what}: read with {option_text('positions', 'leave out')}")
            value, sigma = place.need("position").numbers(3), place.need("sigmas").numbers(3)
            network.add(PhotoPosition(photo, value, sigma=sigma, source=place.where))


def _to_processing(
    project: OpfProject, place: JsonNode
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return coordinates and standard deviations of a geolocation in the processing system.

    Raises:
        InputError: its system is not the base system of the scene.
    """
    frame = project.need("scene-reference-frame")
    base, own = frame.need("crs").need("definition"), place.need("crs").need("definition")
    if "".join(base.text().split()) != "".join(own.text().split()):
        what = "coordinates in another system than that of the scene need projected_control_points"
        raise own.fail(what)
    how = frame.need("base_to_canonical")
    scale = np.array(how.need("scale").numbers(3))
    xyz = scale * place.need("coordinates").numbers(3)
    sigma = np.abs(scale) * place.need("sigmas").numbers(3)
    if how.need("swap_xy").truth():
        xyz, sigma = xyz[[1, 0, 2]], sigma[[1, 0, 2]]
    xyz = xyz + how.need("shift").numbers(3)
    return tuple(xyz.tolist()), tuple(sigma.tolist())


def _control(
    project: OpfProject,
    network: Network,
    problems: Problems,
    images: ImagePoints,
    photos: Mapping[int, str],
    sigma_px: float,
) -> None:
    """Add control points, check points and manual tie points, and gather their marks."""
    projected = {
        n.need("id").text(): n for n in project.list("projected-control-points", "projected_gcps")
    }
    found = {
        n.need("id").text(): n.need("coordinates").numbers(3)
        for n in project.list("calibrated-control-points", "points")
    }
    stated = {
        n.need("id").text()
        for key in ("gcps", "mtps")
        for n in project.list("input-control-points", key)
    }
    for name, node in projected.items():
        if name not in stated:
            what = f"point {name[:40]!r} is none of the input control points"
            problems.wrong(what, node.need("id").where)
    for node in project.list("input-control-points", "gcps"):
        with problems.collect(node.where):
            name = node.need("id").text()
            if name in projected:
                own = projected[name]
                at, sigma = own.need("coordinates").numbers(3), own.need("sigmas").numbers(3)
            else:
                at, sigma = _to_processing(project, node.need("geolocation"))
            if node.need("is_checkpoint").truth():
                network.add_point(name, found.get(name), check=at)
            else:
                network.add_point(name, at)
                network.add(ControlPoint(name, at, sigma=sigma, source=node.where))
            _marks(node, name, problems, images, photos, sigma_px)
    for node in project.list("input-control-points", "mtps"):
        with problems.collect(node.where):
            name = node.need("id").text()
            if node.need("is_checkpoint").truth():
                problems.leave_out(TIES_AS_CHECK_POINTS, name, node.where)
                continue
            network.add_point(name, found.get(name))
            _marks(node, name, problems, images, photos, sigma_px)


def _marks(
    node: JsonNode,
    name: str,
    problems: Problems,
    images: ImagePoints,
    photos: Mapping[int, str],
    sigma_px: float,
) -> None:
    for mark in node.need("marks").list():
        with problems.collect(mark.where):
            photo = photos.get(mark.need("camera_id").integer())
            column, row = mark.need("position_px").numbers(2)
            sigma = sigma_px * mark.need("accuracy").number(above=0.0)
            if photo is None:  # a camera that is not calibrated has no photo
                camera = f"camera {mark.need('camera_id').integer()}"
                problems.leave_out(MARKS_WITHOUT_PHOTO, camera, mark.where)
                continue
            images.add(photo, name, (column, -row), (sigma,), mark.where)


def _constraints(project: OpfProject, network: Network, problems: Problems) -> None:
    """Add scale constraints as distances and orientation constraints as directions."""
    for node in project.list("constraints", "scale_constraints"):
        with problems.collect(node.where):
            network.add(
                SlopeDistance(
                    node.need("id_from").text(),
                    node.need("id_to").text(),
                    node.need("distance").number(above=0.0),
                    sigma=node.need("sigma").number(above=0.0),
                    id=_unused_id(node, network),
                    source=node.where,
                )
            )
    for node in project.list("constraints", "orientation_constraints"):
        with problems.collect(node.where):
            ux, uy, uz = node.need("unit_vector").numbers(3)
            network.add(
                PointDirection(
                    node.need("id_from").text(),
                    node.need("id_to").text(),
                    ux,
                    uy,
                    uz,
                    sigma=float(np.deg2rad(node.need("sigma_deg").number(above=0.0))),
                    id=_unused_id(node, network),
                    source=node.where,
                )
            )


def _unused_id(node: JsonNode, network: Network) -> str | None:
    name = node.need("id").text()
    return None if name in network.observations else name


def _ties(
    project: OpfProject,
    network: Network,
    problems: Problems,
    images: ImagePoints,
    photos: Mapping[int, str],
    sigma_px: float,
) -> None:
    """Add the tie points that two photos see at least, and gather their image points."""
    begin = 0
    for path in project.clouds:
        with problems.collect(path.name):
            for cloud in read_tie_cloud(path):
                known = np.array([c in photos for c in cloud.camera], dtype=bool)
                count = np.bincount(cloud.point[known], minlength=len(cloud.points))
                used = count >= 2
                for i in np.flatnonzero(~used).tolist():
                    problems.leave_out(POINTS_WITH_FEW_RAYS, f"{TIE_PREFIX}{begin + i}", cloud.name)
                for i in np.flatnonzero(~known).tolist():
                    problems.leave_out(RAYS_WITHOUT_PHOTO, f"camera {cloud.camera[i]}", cloud.name)
                names = [f"{TIE_PREFIX}{begin + i}" for i in np.flatnonzero(used).tolist()]
                network.add_points(names, cloud.points[used])
                kept = np.flatnonzero(known & used[cloud.point])
                for i in kept.tolist():
                    column, row = cloud.pixel[i]
                    name = f"{TIE_PREFIX}{begin + int(cloud.point[i])}"
                    photo = photos[cloud.camera[i]]
                    images.add(photo, name, (column, -row), (sigma_px,), cloud.name)
                begin += len(cloud.points)


READER = Reader(
    "opf",
    (".opf",),
    "Open Photogrammetry Format",
    NetworkReader(read_opf),
    recognises=beginning_has(b"application/opf-project+json"),
)

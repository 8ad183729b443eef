"""Reader of OpenSfM and ODM: cameras, photos, GPS positions, points, tracks, frame, control."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from ...errors import InputError, Problem
from ...frames import Frame, LocalFrame, TopocentricFrame
from ...models.rolling_shutter import Towards
from ...network.network import Network
from ...observations import ControlPoint, PhotoPosition
from ...rotation import exp_rotation
from ...types import Array
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader
from ..json_files import JsonNode, parse_json
from ..source import LeftOutReason, Problems, is_unread
from ..text_files import file_beginning, read_text
from .block_source import (
    MARKS_WITHOUT_PHOTO,
    RAYS_WITHOUT_PHOTO,
    RAYS_WITHOUT_POINT,
    TIE_PREFIX,
    ImagePoints,
    add_pixel_camera,
    filled_lines,
)
from .coordinate_lists import ListedSystem, list_system, read_positions
from .ground_control import add_ground, listed_priors
from .opensfm_elements import (
    GroundControlList,
    SfmCamera,
    read_gcp_list,
    read_opensfm_camera,
)
from .rolling_shutters import ShutterMotions, ShutterOptions

TRACKS_HEAD = "OPENSFM_TRACKS_VERSION_v"
"""Beginning of the first line of tracks.csv."""
GROUND_CONTROL_FILES = ("gcp_list.txt", "ground_control_points.json")
"""Files of ground control beside a reconstruction."""
CORRECTED_FILE = "rs_done.txt"
"""File that ODM leaves where it has corrected image points for a rolling shutter."""
CORRECTED = (
    f"image points of tracks.csv are corrected by ODM for a rolling shutter ({CORRECTED_FILE}): "
    "they are those of photos that stand still"
)
OTHER_RECONSTRUCTION = LeftOutReason(
    "reconstructions", f"one is read at a time: {option_text('reconstruction', 'NUMBER')} chooses"
)
MARKS_ELSEWHERE = LeftOutReason("marks of known points", "another reconstruction has their photos")


def read_opensfm(
    path: str | Path,
    *,
    reconstruction: int | None = None,
    tracks: str | Path | None = None,
    gcp: str | Path | None = None,
    sigma_px: float = 1.0,
    sigma_gcp_px: float = 1.0,
    sigma_gcp: tuple[float, float] = (0.01, 0.1),
    gps: Literal["leave out", "observe"] = "leave out",
    calibration: Literal["optimised", "held"] = "optimised",
    positions: str | Path | None = None,
    sigma_positions: tuple[float, float] | None = None,
    positions_system: str | None = None,
    rolling_shutter: Literal["leave out", "estimate"] = "leave out",
    readout: float | None = None,
    readout_towards: Towards = "down",
    sigma_shift: float = 1.0,
    sigma_turn: float | None = None,
) -> Network:
    """Read a reconstruction of OpenSfM or ODM with its tracks and ground control.

    Beside reconstruction.json lie tracks.csv, reference_lla.json (the origin of the topocentric
    frame) and gcp_list.txt or ground_control_points.json; the latter two are read where they exist.
    Without tracks.csv no tie point has image coordinates: a reconstruction with points is refused
    then. Image coordinates are pixels from the upper left corner. Tracks without a reconstructed
    point, and photos that are not in the reconstruction, are left out. Tracks are named
    ``tie NUMBER``.

    Ground control is in WGS84 (longitude, latitude, height), WGS84 UTM 32N, EPSG:… or +proj=…
    (the latter three need pyproj); heights are ellipsoidal. Points whose name begins with CHK-
    are check points. A reconstruction without ground control and positions is a free network.

    OpenSfM has no standard deviations of its own in these files. Those of ground control are its
    defaults (gcp_horizontal_sd, gcp_vertical_sd); those of image points are options. Colours,
    meshes, sizes of features, compass and capture times are not read.

    ODM may correct image points for a rolling shutter (``--rolling-shutter``), with the readout
    time and the speeds that it puts into ``exif/PHOTO.exif``: it moves the image points of
    tracks.csv and leaves ``rs_done.txt``. Such image points are those of photos that stand still,
    and a remark says so; others may get motions with ``rolling_shutter="estimate"``.

    Args:
        path: reconstruction.json, or the folder that has it.
        reconstruction: number of the reconstruction from 0; None: the one with most photos.
        tracks: tracks.csv; None: that beside the reconstruction.
        gcp: gcp_list.txt or ground_control_points.json; None: that beside the reconstruction.
        sigma_px: standard deviation of image coordinates of tie points, pixels.
        sigma_gcp_px: standard deviation of image coordinates of ground control, pixels.
        sigma_gcp: standard deviations of ground control, horizontal and vertical, metres.
        gps: whether the GPS positions of photos are observed, with their gps_dop as σ in metres
            in plan and twice that in height.
        calibration: whether the parameters that OpenSfM estimates are unknown.
        positions: list of observed positions of photos, in place of ``gps``: geo.txt of ODM, or a
            table, see `io.photogrammetry.coordinate_lists`.
        sigma_positions: standard deviations of positions for which the file states no σ,
            horizontal and vertical, metres.
        positions_system: reference system of a table of positions that states none.
        rolling_shutter: "estimate" gives the photos of all cameras an unknown motion during the
            readout, zero at the start.
        readout: readout time of the whole sensor, seconds; None: that which ODM put into the exif
            files of the photos, otherwise unknown: motions are those of the whole readout (1 s).
        readout_towards: side of the image to which the readout proceeds.
        sigma_shift: standard deviation of the shift during the readout, metres.
        sigma_turn: standard deviation of the turn during the readout, radians; 0: held; None: 0.01.

    Raises:
        InputError: a file is missing or has problems, each with file and line.
    """
    source = Path(path)
    source = source / "reconstruction.json" if source.is_dir() else source
    for name, value in (("sigma_px", sigma_px), ("sigma_gcp_px", sigma_gcp_px)):
        if not value > 0:
            raise InputError(f"{name} must be greater than zero, not {value}")
    options = ShutterOptions(rolling_shutter, readout, readout_towards, sigma_shift, sigma_turn)
    problems = Problems()
    every = parse_json(read_text(source), source.name)
    root = _chosen_reconstruction(every, reconstruction)
    elsewhere: set[str] = set()
    for number, other in enumerate(every.list() if isinstance(every.value, list) else ()):
        if other.value is not root.value:
            problems.leave_out(OTHER_RECONSTRUCTION, str(number), other.where)
            elsewhere |= set(other.need("shots").members())
    frame = _frame(root, source.parent)
    network = Network(source.parent.name or source.stem, frame=frame)
    if (source.parent / CORRECTED_FILE).exists():
        _refuse_second_correction(options)
        problems.remarks.append(CORRECTED)
    elif options.models_motions and readout is None:
        options = replace(options, readout=_exif_readout(root, source.parent))
    motions = ShutterMotions(options, network, problems)
    cameras = _cameras(network, root, problems, calibration == "optimised")
    _shots(network, root, problems, cameras, gps == "observe")
    _points(network, root, problems)
    images = ImagePoints(problems)
    beside = source.parent / "tracks.csv"
    if tracks is None and network.points and not beside.exists():
        what = (
            f"the image coordinates of its {len(network.points)} tie points are in {beside.name}, "
            "which does not lie beside it; give that file there, or "
            f"{option_text('tracks', 'PATH')}"
        )
        problems.wrong(what, source.name)
    elif tracks is not None or beside.exists():
        _tracks(Path(tracks) if tracks else beside, network, images, problems, cameras, sigma_px)
    for name in GROUND_CONTROL_FILES if gcp is None else (str(gcp),):
        listed = Path(name) if gcp is not None else source.parent / name
        if gcp is not None or listed.exists():
            ground = read_gcp_list(listed, problems)
            _control(network, ground, images, problems, cameras, sigma_gcp_px, sigma_gcp, elsewhere)
            break
    if positions is not None:
        if gps == "observe":
            raise InputError("positions and gps=observe exclude each other")
        stated = read_positions(Path(positions), problems, system=positions_system)
        if isinstance(network.frame, TopocentricFrame):
            found = listed_priors(stated, network.frame, network.photos, problems, sigma_positions)
            problems.remarks += stated.listed.remark(network.frame)
            centres = np.array([network.photos[p.photo].position for p in found]).reshape(-1, 3)
            to = np.array([p.xyz for p in found]).reshape(-1, 3)
            if what := stated.listed.problem_of_order(network.frame, centres, to):
                problems.wrong(what, stated.listed.where)
            network.add(
                *(PhotoPosition(p.photo, p.xyz, sigma=p.sigma, source=p.where) for p in found)
            )
        else:
            what = "positions need reference_lla.json, the origin of the reconstruction"
            problems.wrong(what, Path(positions).name)
    _without_rays(network, images)
    images.into(network)
    motions.finish()
    problems.finish(network)
    if not network.observations:
        network.datum = "free"
    return network


def is_opensfm(path: Path) -> bool:
    """Tell whether a JSON file is a reconstruction of OpenSfM."""
    head = file_beginning(path)
    return b'"shots"' in head or (b'"cameras"' in head and b'"projection_type"' in head)


def _chosen_reconstruction(root: JsonNode, number: int | None) -> JsonNode:
    """Return a reconstruction of a file, which may be a list of them."""
    if isinstance(root.value, dict):
        return root
    every = list(root.list())
    if not every:
        raise root.fail("has no reconstruction")
    if number is not None:
        if not 0 <= number < len(every):
            raise root.fail(f"has no reconstruction {number}; valid: 0 to {len(every) - 1}")
        return every[number]
    return max(every, key=lambda node: len(node.need("shots").members()))


def _frame(root: JsonNode, folder: Path) -> Frame:
    """Return the topocentric frame about reference_lla, a local one without it."""
    node = root.get("reference_lla")
    beside = folder / "reference_lla.json"
    if node is None and beside.exists():
        node = parse_json(read_text(beside), beside.name)
    if node is None:
        return LocalFrame()
    latitude, longitude = node.need("latitude").number(), node.need("longitude").number()
    if not (abs(latitude) <= 90 and abs(longitude) <= 360):
        raise node.fail(f"latitude {latitude:g}°, longitude {longitude:g}° are none")
    height = node.need("altitude").number()
    return TopocentricFrame(np.deg2rad(latitude), np.deg2rad(longitude), height, "WGS84")


def _refuse_second_correction(options: ShutterOptions) -> None:
    """Refuse motions of photos whose image points are corrected for them.

    Raises:
        InputError: motions are asked for.
    """
    if options.models_motions:
        what = "image points of tracks.csv are corrected for the rolling shutter, a motion would "
        what += "correct them twice; valid: rolling_shutter='leave out'"
        raise InputError(Problem(what, CORRECTED_FILE))


def _exif_readout(root: JsonNode, folder: Path) -> float | None:
    """Return the readout time that ODM put into the exif files of the photos, seconds.

    Raises:
        InputError: photos have different readout times.
    """
    found: dict[float, str] = {}
    for shot in root.need("shots").members():
        path = folder / "exif" / f"{shot}.exif"
        if path.exists():
            node = parse_json(read_text(path), path.name).get("rolling_shutter")
            if node is not None:
                found.setdefault(node.number(above=0.0), node.where)
    if len(found) > 1:
        times = ", ".join(f"{ms:g} ms ({where})" for ms, where in found.items())
        raise InputError(f"photos have different readout times: {times}; state readout=…")
    return next((ms / 1000.0 for ms in found), None)


def _cameras(
    network: Network, root: JsonNode, problems: Problems, free: bool
) -> dict[str, SfmCamera]:
    out: dict[str, SfmCamera] = {}
    for name, node in root.need("cameras").items():
        with problems.collect(node.where):
            camera = read_opensfm_camera(node)
            out[name] = camera
            add_pixel_camera(
                network,
                name,
                camera.lens,
                camera.values,
                size=camera.size,
                free=camera.estimated if free else (),
            )
    return out


def _shots(
    network: Network,
    root: JsonNode,
    problems: Problems,
    cameras: Mapping[str, SfmCamera],
    gps: bool,
) -> None:
    """Add the photos; p_camera = R(rotation) p_world + translation."""
    rigs = root.get("rig_instances")
    poses = {} if rigs is None else _rig_poses(root, rigs, problems)
    for name, node in root.need("shots").items():
        with problems.collect(node.where):
            camera = node.need("camera").text()
            if camera not in cameras and camera in root.need("cameras").members():
                continue  # it has a problem of its own
            if node.get("rotation") is not None or name not in poses:
                rotation = _matrix(node.need("rotation"))
                translation = np.array(node.need("translation").numbers(3))
            else:
                rotation, translation = poses[name]
            centre = -rotation.T @ translation
            network.add_photo(name, camera, position=centre.tolist(), rotation=rotation.T)
            at = node.get("gps_position")
            if gps and at is not None:
                dop = node.need("gps_dop").number(above=0.0)
                value = at.numbers(3)
                sigma = (dop, dop, 2 * dop)
                network.add(PhotoPosition(name, value, sigma=sigma, source=node.where))


def _matrix(node: JsonNode) -> Array:
    """Return the rotation (3, 3) of a rotation vector."""
    vector = np.array(node.numbers(3))
    if not np.linalg.norm(vector) < 1e6:
        raise node.fail("a rotation vector must be an angle in radians")
    return np.asarray(exp_rotation(vector[None])[0])


def _rig_poses(
    root: JsonNode, rigs: JsonNode, problems: Problems
) -> dict[str, tuple[Array, Array]]:
    """Return the poses of shots in rig instances: rig camera after instance."""
    cameras: dict[str, tuple[Array, Array]] = {}
    listed = root.get("rig_cameras")
    for name, node in () if listed is None else listed.items():
        with problems.collect(node.where):
            translation = np.array(node.need("translation").numbers(3))
            cameras[name] = _matrix(node.need("rotation")), translation
    out: dict[str, tuple[Array, Array]] = {}
    for _, node in rigs.items():
        with problems.collect(node.where):
            r, t = _matrix(node.need("rotation")), np.array(node.need("translation").numbers(3))
            for shot, of in node.need("rig_camera_ids").items():
                inner = cameras.get(of.text())
                if inner is None:
                    raise of.fail(f"unknown rig camera {of.text()!r}")
                out[shot] = inner[0] @ r, inner[0] @ t + inner[1]
    return out


def _points(network: Network, root: JsonNode, problems: Problems) -> None:
    for name, node in root.need("points").items():
        try:
            network.add_point(TIE_PREFIX + name, node.need("coordinates").numbers(3))
        except InputError as error:
            problems.extend([p.at(node.where) for p in error.problems])


def _tracks(
    path: Path,
    network: Network,
    images: ImagePoints,
    problems: Problems,
    cameras: Mapping[str, SfmCamera],
    sigma: float,
) -> None:
    """Gather the image points of tracks that have a point; columns image, track, feature, x, y."""
    for number, line in filled_lines(read_text(path)):
        where = f"{path.name}:{number}"
        if number == 1 and line.startswith(TRACKS_HEAD):
            if line.strip().removeprefix(TRACKS_HEAD) not in ("0", "1", "2"):
                problems.wrong(
                    f"version {line.strip()!r} of tracks; valid: {TRACKS_HEAD}0 to 2", where
                )
                return
            continue
        fields = line.split("\t")
        if len(fields) < 5:
            what = "a row has image, track, feature, x, y … separated by tabulators"
            problems.wrong(f"{what}, not {len(fields)} fields", where)
            continue
        photo, track = fields[0], TIE_PREFIX + fields[1]
        if photo not in network.photos:
            problems.leave_out(RAYS_WITHOUT_PHOTO, photo, where)
            continue
        if track not in network.points:
            problems.leave_out(RAYS_WITHOUT_POINT, track, where)
            continue
        xy = problems.field(fields[3:5], "x, y", where).numbers(2)
        if not is_unread(xy):
            camera = cameras[network.photos[photo].camera]
            images.add(photo, track, camera.pixel(*xy), (sigma,), where)


def _without_rays(network: Network, images: ImagePoints) -> None:
    """Take points out that fewer than two photos see; they have nothing to be determined by."""
    seen = images.seen()
    few = [
        n
        for n, p in network.points.items()
        if seen.get(n, 0) < 2 and p.check is None and not any(p.fixed)
    ]
    control = {o.point for o in network.observations.values() if isinstance(o, ControlPoint)}
    images.leave_out(network, set(few) - control)


def _control(
    network: Network,
    ground: GroundControlList,
    images: ImagePoints,
    problems: Problems,
    cameras: Mapping[str, SfmCamera],
    sigma_px: float,
    sigma: tuple[float, float],
    elsewhere: Set[str],
) -> None:
    """Add control and check points with their measurements in photos of the reconstruction.

    ``elsewhere``: photos of the other reconstructions of the file.
    """
    frame = network.frame
    if not isinstance(frame, TopocentricFrame):
        what = "ground control needs reference_lla.json, the origin of the reconstruction"
        problems.wrong(what, ground.where)
        return
    try:
        listed = ListedSystem(list_system(ground.system), ground.order, ground.where.split(":")[0])
    except InputError as error:
        problems.extend([p.at(ground.where) for p in error.problems])
        return
    problems.remarks += listed.remark(frame)
    for point in ground.points:
        with problems.collect(point.where):
            add_ground(network, frame, listed, point, sigma)
            for photo, x, y, normalised, where in point.marks:
                if photo not in network.photos:
                    why = MARKS_ELSEWHERE if photo in elsewhere else MARKS_WITHOUT_PHOTO
                    problems.leave_out(why, photo, where)
                    continue
                camera = cameras[network.photos[photo].camera]
                xy = camera.pixel(x, y) if normalised else (x + 0.5, -y - 0.5)
                images.add(photo, point.name, xy, (sigma_px,), where)


READER = Reader(
    "opensfm",
    (".json",),
    "reconstruction of OpenSfM or ODM",
    NetworkReader(read_opensfm),
    recognises=is_opensfm,
)

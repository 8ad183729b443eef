"""Reader of Metashape and PhotoScan (.psz, .psx, .xml): cameras, markers, tie points, scale bars.

An exported file has the cameras and markers of a chunk. This module adds markers, tie points and
scale bars.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from ...crs.reference_system import Heights
from ...errors import InputError, Problem
from ...models.rolling_shutter import Towards
from ...network.network import Network
from ...observations import ControlPoint, PhotoPosition, SlopeDistance
from ...types import Array
from ..format_reader import NetworkReader, Reader
from ..source import LeftOutReason, Problems, is_unread
from ..text_files import file_beginning
from .block_source import POINTS_WITH_FEW_RAYS, TIE_PREFIX, ImagePoints, all_in_range
from .metashape_cameras import CalibrationUnknowns, add_cameras, add_sensors
from .metashape_files import ElementPlace, open_chunk, read_ply_vertices
from .metashape_reference import (
    ChunkContext,
    check_flags,
    chunk_cameras,
    is_disabled,
    listed_elements,
)
from .rolling_shutters import RollingShutter, ShutterMotions, ShutterOptions

UNSAID = "Metashape does not state of which part of the readout the motion is"
"""Why motions are refused without an option."""
LOCATION_WITHOUT_PHOTO = LeftOutReason(
    "locations of markers", "their cameras are switched off or not aligned"
)
LOCATION_NOT_VALID = LeftOutReason("locations of markers", "the file says that they are not valid")
FILES_WITHOUT_PHOTO = LeftOutReason(
    "files of projections", "their cameras are switched off or not aligned"
)
SCALE_BAR_NOT_USED = LeftOutReason("scale bars", "they are switched off, or have no length")

IntegerArray = npt.NDArray[np.int64]


def add_markers(context: ChunkContext, network: Network) -> dict[str, str]:
    """Add control and check points; return the names of all markers by their ids."""
    chunk, problems = context.source.chunk, context.problems
    out: dict[str, str] = {}
    labels: set[str] = set()
    for marker in listed_elements(chunk.element, "markers", "marker"):
        ident, where = marker.attributes.get("id", ""), chunk.where(marker)
        label = marker.attributes.get("label", "") or f"marker {ident}"
        if ident in out or label in labels:
            problems.wrong(f"marker {label!r} is defined twice", where)
            continue
        out[ident] = label
        labels.add(label)
        element = marker.first("reference")
        if element is None or "x" not in element.attributes:
            continue
        found = context.given(element, "markers", where)
        if found is None:
            continue
        at, covariance = found
        with problems.collect(where):
            if is_disabled(element):
                network.add_point(label, check=at)
                continue
            network.add_point(label, at)
            network.add(marker_control_point(label, at, covariance, where))
    return out


def marker_control_point(
    name: str, at: tuple[float, float, float], covariance: Array, source: str
) -> ControlPoint:
    """Return a control point, with standard deviations where its covariance has no correlation."""
    variance = np.diag(covariance)
    if (covariance - np.diag(variance)).any():
        return ControlPoint(name, at, covariance=covariance, source=source)
    return ControlPoint(name, at, sigma=tuple(np.sqrt(variance).tolist()), source=source)


def gather_locations(
    context: ChunkContext,
    images: ImagePoints,
    cameras: Mapping[str, str],
    markers: Mapping[str, str],
) -> None:
    """Gather the locations of markers in the photos that are read."""
    frame, problems = context.source.frame, context.problems
    if frame is None:
        return
    sigma = (context.accuracy["projections"],)
    known = _camera_ids(context)
    for marker in listed_elements(frame.element, "markers", "marker"):
        ident = marker.attributes.get("marker_id", "")
        if ident not in markers:
            problems.wrong(f"unknown marker {ident!r}", frame.where(marker))
            continue
        for location in marker.all("location"):
            camera = location.attributes.get("camera_id", "")
            if camera not in known:
                problems.wrong(f"location in the unknown camera {camera!r}", frame.where(location))
            photo = cameras.get(camera)
            where = frame.where(location)
            if photo is None or location.attributes.get("valid") in ("false", "0"):
                why = LOCATION_WITHOUT_PHOTO if photo is None else LOCATION_NOT_VALID
                problems.leave_out(why, f"{markers[ident]} in camera {camera}", where)
                continue
            texts = [location.attributes.get(a) for a in "xy"]
            xy = problems.field(texts, "location", where).numbers(2)
            if not is_unread(xy):
                images.add(photo, markers[ident], (xy[0], -xy[1]), sigma, where)


def add_ties(
    context: ChunkContext,
    network: Network,
    ties: ElementPlace,
    images: ImagePoints,
    cameras: Mapping[str, str],
) -> None:
    """Add the tie points that two photos see at least, and gather their projections.

    Raises:
        InputError: a file is missing or damaged.
    """
    element = ties.element.first("points")
    if element is None:
        return
    content, file = ties.read(element)
    table = _ply_columns(read_ply_vertices(content, file), ("id", "x", "y", "z"), file)
    number = table["id"].astype(np.int64)
    xyz = np.stack([table[a].astype(float) for a in "xyz"], 1)
    if not all_in_range(xyz):
        raise InputError(Problem("coordinates must be finite", file))
    if len(np.unique(number)) < len(number):
        raise InputError(Problem("a tie point has coordinates twice", file))
    placed = context.placed(_component(context))
    xyz = np.full_like(xyz, np.nan) if placed is None else placed.points(xyz)
    known = _camera_ids(context)
    for strange in ties.element.all("projections"):
        if (camera := strange.attributes.get("camera_id", "")) not in known:
            what = f"projections in the unknown camera {camera!r}"
            raise InputError(Problem(what, ties.where(strange)))
    projected = list(_projections(ties, cameras))
    seen = np.concatenate([np.unique(names) for _, names, _, _ in projected] or [number[:0]])
    values, counts = np.unique(seen, return_counts=True)
    used = np.isin(number, values[counts >= 2])
    for n in number[~used].tolist():
        context.problems.leave_out(POINTS_WITH_FEW_RAYS, f"{TIE_PREFIX}{n}", file)
    for element in ties.element.all("projections"):
        if (camera := element.attributes.get("camera_id", "")) not in cameras:
            context.problems.leave_out(FILES_WITHOUT_PHOTO, f"camera {camera}", ties.where(element))
    network.add_points([f"{TIE_PREFIX}{n}" for n in number[used].tolist()], xyz[used])
    sigma = (context.accuracy["tiepoints"],)
    for photo, names, xy, where in projected:
        kept = np.isin(names, number[used])
        for n, (x, y) in zip(names[kept].tolist(), xy[kept].tolist(), strict=True):
            images.add(photo, f"{TIE_PREFIX}{n}", (x, -y), sigma, where)


def _camera_ids(context: ChunkContext) -> set[str]:
    """Return the ids of all cameras of the chunk, also of those that are not read."""
    return {c.attributes.get("id", "") for c in chunk_cameras(context.source.chunk.element)}


def _component(context: ChunkContext) -> str | None:
    """Return the id of the component whose transformation holds for tie points."""
    components = context.source.chunk.element.first("components")
    if components is None:
        return None
    first = components.first("component")
    alone = None if first is None else first.attributes.get("id")
    return components.attributes.get("active_id", alone)


def _projections(
    ties: ElementPlace, cameras: Mapping[str, str]
) -> Iterator[tuple[str, IntegerArray, Array, str]]:
    """Yield photo, numbers of tie points, coordinates (n, 2) and file of each photo."""
    for element in ties.element.all("projections"):
        photo = cameras.get(element.attributes.get("camera_id", ""))
        if photo is None:
            continue
        content, file = ties.read(element)
        table = _ply_columns(read_ply_vertices(content, file), ("x", "y", "id"), file)
        xy = np.stack([table["x"].astype(float), table["y"].astype(float)], 1)
        if not all_in_range(xy):
            raise InputError(Problem("image coordinates must be finite", file))
        yield photo, table["id"].astype(np.int64), xy, file


def _ply_columns(
    table: Mapping[str, npt.NDArray[np.generic]], names: Sequence[str], file: str
) -> dict[str, npt.NDArray[np.generic]]:
    """Return columns of a PLY table.

    Raises:
        InputError: one is missing, or holds numbers that are none.
    """
    absent = [n for n in names if n not in table]
    if absent:
        what = f"has no property {', '.join(absent)}; it has {', '.join(table)}"
        raise InputError(Problem(what, file))
    out = {n: table[n] for n in names}
    if not all_in_range(np.asarray(out["id"], dtype=float)):
        raise InputError(Problem("numbers of tie points must be finite", file))
    return out


def add_scale_bars(context: ChunkContext, network: Network, markers: Mapping[str, str]) -> None:
    """Add the enabled scale bars between markers."""
    chunk, problems = context.source.chunk, context.problems
    for bar in listed_elements(chunk.element, "scalebars", "scalebar"):
        element, where = bar.first("reference"), chunk.where(bar)
        if element is None or is_disabled(element) or "distance" not in element.attributes:
            name = bar.attributes.get("label", "") or bar.attributes.get("id", "")
            problems.leave_out(SCALE_BAR_NOT_USED, name, where)
            continue
        said = element.attributes
        value = problems.field(said["distance"], "distance", where).number(above=0.0)
        sigma = context.accuracy["scalebars"]
        text = said.get("accuracy", said.get("sd"))
        if text is not None and "scalebars" not in context.overridden:
            sigma = problems.field(text, "accuracy", where).number(above=0.0)
        ends = [bar.attributes.get(k, "") for k in ("start_marker_id", "end_marker_id")]
        names = [markers[e] for e in ends if e in markers]
        if len(names) < 2:
            problems.wrong("a scale bar must join two markers, by start_marker_id …", where)
        elif not is_unread(value, sigma):
            with problems.collect(where):
                bar_length = SlopeDistance(names[0], names[1], value, sigma=sigma, source=where)
                network.add(bar_length)


def read_metashape(
    path: str | Path,
    *,
    chunk: str | int | None = None,
    calibration: CalibrationUnknowns = "optimised",
    unaligned: Literal["leave out", "keep"] = "leave out",
    tie_points: bool = True,
    accuracy: Mapping[str, float] | None = None,
    crs: Literal["stated", "local"] = "stated",
    geoid: str | float | None = None,
    heights: Heights | None = None,
    rolling_shutter: RollingShutter = "refuse",
    readout: float | None = None,
    readout_towards: Towards = "down",
    sigma_shift: float = 1.0,
    sigma_turn: float | None = None,
) -> Network:
    """Read a chunk of Metashape or PhotoScan.

    Image coordinates are pixels from the upper left corner. Markers with an enabled reference
    are control points with the standard deviations that the chunk states; those with a disabled
    one are check points. Enabled reference positions of cameras are observed projection centres,
    scale bars are slope distances. A chunk without any reference is a free network. Tie points
    are named ``tie NUMBER``; projections of tie points that have no coordinates are left out, as
    Metashape leaves them out, and so are disabled cameras and scale bars. Attitudes of cameras,
    masks, depth maps, clouds, models, and settings of displays are not read.

    A geographic, geocentric or projected reference (the latter needs pyproj) gives a topocentric
    frame about the middle of what is given. Standard deviations are those of east, north and up,
    in a projected system of grid east and grid north. Heights of a projected system alone are
    ellipsoidal, as in Metashape; those of a compound system need its geoid.

    Motions of cameras during the readout of a rolling shutter are a rotation and a location.
    Agisoft states their axes, those of the camera, but neither sign nor part of the readout; so
    ``rolling_shutter`` says what becomes of them. No public project has values.

    Args:
        path: a .psz or .psx project, or an exported .xml of cameras or markers.
        chunk: label or number of the chunk; None: the only one, or the active one.
        calibration: which parameters are unknown: those that Metashape optimised (its list, and
            none of a fixed sensor), none, or some by Metashape's names: f, cx, cy, b1, b2, k1 …
        unaligned: whether enabled cameras without a pose are kept; the adjustment finds it.
        tie_points: whether tie points are read.
        accuracy: standard deviations in place of those of the chunk: ``tiepoints`` and
            ``projections`` (markers in photos), pixels; ``markers``, ``cameras`` and
            ``scalebars``, metres. Defaults where the chunk states none are those of Metashape:
            1 px, 0.1 px, 5 mm, 10 m, 1 mm.
        crs: "local" takes the coordinates as local ones in metres, whatever the chunk states;
            poses and tie points then have no approximate values.
        geoid: geoid of a compound system, a file or a constant, see `fga.ReferenceSystem`; None:
            that of PROJ.
        heights: "ellipsoidal" where the heights of a compound system are that.
        rolling_shutter: what becomes of motions during the readout, see `RollingShutter`;
            "estimate" gives all photos of sensors with a rolling shutter an unknown motion (of all
            sensors where the file names none).
        readout: readout time of the whole sensor, seconds; None: unknown, motions are those of the
            whole readout (1 s).
        readout_towards: side of the image to which the readout proceeds.
        sigma_shift: standard deviation of the shift during the readout about that of the file, or
            about zero, metres.
        sigma_turn: standard deviation of the turn during the readout, radians; 0: held; None: 0.01,
            but held with "half readout" and "whole readout" if no camera of the file turns.

    Raises:
        InputError: the file has problems, each with file and line.
    """
    options = ShutterOptions(rolling_shutter, readout, readout_towards, sigma_shift, sigma_turn)
    problems = Problems()
    source = open_chunk(Path(path), chunk)
    context = ChunkContext(source, problems, dict(accuracy or {}), crs == "local", geoid, heights)
    for place in (source.chunk, source.frame):
        if place is not None:
            check_flags(place, problems)
    label = source.chunk.element.attributes.get("label", "")
    network = Network(label or Path(path).stem, frame=context.reference.frame)
    motions = ShutterMotions(options, network, problems, UNSAID)
    sensors = add_sensors(context, network, calibration, motions)
    cameras = add_cameras(context, network, sensors, motions, unaligned=unaligned == "keep")
    markers = add_markers(context, network)
    images = ImagePoints(problems)
    gather_locations(context, images, cameras, markers)
    if tie_points and source.ties is not None:
        with problems.collect(source.ties.file):
            add_ties(context, network, source.ties, images, cameras)
    seen = images.seen()
    for marker in markers.values():
        if marker not in network.points and marker in seen:
            network.add_point(marker)
    images.into(network)
    add_scale_bars(context, network, markers)
    if not (network.photos or network.points or problems.count):
        problems.wrong("the chunk has no aligned camera and no marker", source.chunk.file)
    motions.finish()
    problems.finish(network)
    kinds = {o.kind for o in network.observations.values()}
    if not kinds & {ControlPoint.kind, PhotoPosition.kind}:
        network.datum = "free"
    return network


def is_metashape_xml(path: Path) -> bool:
    """Tell whether an XML file is an export of Metashape."""
    head = file_beginning(path)
    return head.lstrip().startswith(b"<") and b"<document" in head and b"<chunk" in head


READER = Reader(
    "metashape",
    (".psz", ".psx"),
    "Metashape or PhotoScan project",
    NetworkReader(read_metashape),
)
XML_READER = Reader(
    "metashape-xml",
    (".xml",),
    "cameras or markers of Metashape",
    NetworkReader(read_metashape),
    recognises=is_metashape_xml,
)

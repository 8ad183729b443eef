"""Reader of Metashape and PhotoScan: projects (.psz, .psx), exported cameras and markers (.xml)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from ...crs.system import Heights
from ...network.network import Network
from ...observations import ControlPoint, PhotoPosition
from ..text import beginning
from .metashape_cameras import Choice, add_cameras, add_sensors
from .metashape_context import Context, check_flags
from .metashape_points import add_markers, add_scale_bars, add_ties, gather_locations
from .metashape_source import open_chunk
from .reading import ImagePoints, Reading


def read_metashape(
    path: str | Path,
    *,
    chunk: str | int | None = None,
    calibration: Choice = "optimised",
    unaligned: Literal["leave out", "keep"] = "leave out",
    tie_points: bool = True,
    accuracy: Mapping[str, float] | None = None,
    crs: Literal["stated", "local"] = "stated",
    geoid: str | float | None = None,
    heights: Heights | None = None,
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

    Raises:
        InputError: the file has problems, each with file and line.
    """
    reading = Reading()
    source = open_chunk(Path(path), chunk)
    context = Context(source, reading, dict(accuracy or {}), crs == "local", geoid, heights)
    for place in (source.chunk, source.frame):
        if place is not None:
            check_flags(place, reading)
    label = source.chunk.element.attributes.get("label", "")
    network = Network(label or Path(path).stem, frame=context.reference.frame)
    sensors = add_sensors(context, network, calibration)
    cameras = add_cameras(context, network, sensors, unaligned=unaligned == "keep")
    markers = add_markers(context, network)
    images = ImagePoints(reading)
    gather_locations(context, images, cameras, markers)
    if tie_points and source.ties is not None:
        with reading.at(source.ties.file):
            add_ties(context, network, source.ties, images, cameras)
    seen = images.seen()
    for marker in markers.values():
        if marker not in network.points and marker in seen:
            network.add_point(marker)
    images.into(network)
    add_scale_bars(context, network, markers)
    if not (network.photos or network.points or reading.problems):
        reading.wrong("the chunk has no aligned camera and no marker", source.chunk.file)
    reading.finish(network)
    kinds = {o.kind for o in network.observations.values()}
    if not kinds & {ControlPoint.kind, PhotoPosition.kind}:
        network.datum = "free"
    return network


def is_metashape_xml(path: Path) -> bool:
    """Tell whether an XML file is an export of Metashape."""
    head = beginning(path)
    return b"<document" in head and b"<chunk" in head

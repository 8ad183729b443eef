"""Reader of DynaML, the XML of DynAdjust: geodetic stations and measurements.

Format: ICSM, DynAdjust User's Guide, DynaML.xsd 1.0.2 (2020).

Stations and measurements may be in two files or in one.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from ...network.network import Network
from ..format_reader import NetworkReader, Reader, beginning_has
from ..source import Field, Problems
from ..xml_files import Element
from ..xml_source import XmlSource
from .dynadjust_measurements import GNSS_TYPES, network_of
from .dynadjust_records import (
    DirectionRecord,
    MeasurementRecord,
    MemberRecord,
    RecordFile,
    StationRecord,
)

DYNAML_CHILDREN: dict[str, tuple[str, ...]] = {
    "DnaXmlFormat": ("DnaStation", "DnaMeasurement"),
    "DnaStation": ("Name", "Constraints", "Type", "StationCoord", "Description"),
    "StationCoord": ("Name", "XAxis", "YAxis", "Height", "HemisphereZone"),
    "DnaMeasurement": (
        *("Type", "Ignore", "ReferenceFrame", "Epoch", "First", "Second", "Third", "Value"),
        *("StdDev", "InstHeight", "TargHeight", "Total", "Directions", "Vscale", "GPSBaseline"),
        *("Hscale", "Lscale", "Pscale", "Clusterpoint", "Coords", "Source", "MeasurementID"),
        "ClusterID",
    ),
    "Directions": ("Ignore", "Target", "Value", "StdDev", "MeasurementID"),
    "GPSBaseline": (
        *("X", "Y", "Z", "MeasurementID", "SigmaXX", "SigmaXY", "SigmaXZ", "SigmaYY", "SigmaYZ"),
        *("SigmaZZ", "GPSCovariance"),
    ),
    "Clusterpoint": (
        *("X", "Y", "Z", "MeasurementID", "SigmaXX", "SigmaXY", "SigmaXZ", "SigmaYY", "SigmaYZ"),
        *("SigmaZZ", "PointCovariance"),
    ),
}
"""Children of the elements of the format."""
NO_STATIONS_MESSAGE = (
    "has no <DnaStation>: read the file of the stations (…stn.xml), which takes the measurements "
    "(…msr.xml) beside it or as a second argument"
)
MEMBER_TAGS = {
    False: ("GPSBaseline", "GPSCovariance"),
    True: ("Clusterpoint", "PointCovariance"),
}
"""Elements of a member and of its covariance with another one: of vectors, of positions."""


def read_dynaml(
    stations: str | Path,
    measurements: str | Path | None = None,
    *,
    reference_frames: Literal["transform", "by GDA94", "as is"] = "transform",
    heights: Literal["refuse", "ellipsoidal"] = "refuse",
    geoid: str | float | None = None,
    driver: bool = False,
    ellipsoid: str = "GRS80",
) -> Network:
    """Read stations and measurements of DynAdjust (DynaML).

    The frame is geocentric. Stations are LLH, LLh, XYZ or UTM; the heights of LLH and UTM are above
    the geoid. Those with the constraints ``CCC`` are held, those with ``FFF`` are free. Letters
    follow the coordinates: ``CFF`` is the latitude, of UTM the easting, of XYZ X. One or two of
    latitude, longitude, height are held by observed components with a standard deviation of 1 µm.
    Measurements are read as follows; angles are degrees, minutes and seconds as ddd.mmssss,
    standard deviations of angles seconds of arc.

    | type | observation |
    | --- | --- |
    | G, X | `GnssVector`; the vectors of X with a joint covariance |
    | Y | `GnssPosition`, in XYZ, or LLH or LLh with a covariance in rad² and m² |
    | A | `HorizontalAngle` |
    | D | `Direction`: a set, whose first direction is that to <Second> |
    | B, K | `GeodeticAzimuth`, `Azimuth` (astronomic) |
    | C, E | `EllipsoidDistance`: chord and arc of the ellipsoid |
    | M | `EllipsoidDistance` at sea level |
    | S | `SlopeDistance` |
    | V, Z | `ZenithAngle`, `VerticalAngle` |
    | I, J | `AstronomicLatitude`, `AstronomicLongitude` |
    | P, Q | one component of a `ControlPoint`: latitude, longitude |
    | H, R | `EllipsoidHeight`: above the geoid, above the ellipsoid |
    | L | `EllipsoidHeightDifference` above the geoid |

    Covariances are multiplied by ``Vscale``, and by ``Pscale``, ``Lscale``, ``Hscale`` in north,
    east and up at the (first) station. Measurements with ``Ignore`` set leave the network, as in
    DynAdjust. ``Description``, ``PartSource``, ``MeasurementID`` and ``ClusterID`` have no effect.

    Tried on the networks of DynAdjust (gnss, urban, sa-gnss, and those in which all is ignored).

    Args:
        stations: station file, or a combined file with both.
        measurements: measurement file. None: a combined file, or the file whose name has ``msr``
            in the place of ``stn`` beside the station file.
        reference_frames: "transform": vectors and points of another reference frame are brought
            into that of the station file at their epoch (ITRF2000 to ITRF2020, GDA94, GDA2020).
            "by GDA94": the same, ITRF2008 by way of GDA94, as DynAdjust 1.0.3 does: 0.2 mm in
            55 km from the other way. "as is": the numbers of the file.
        heights: what to do without a geoid with H, L, M, positions in LLH and constrained heights
            of stations, which refer to it. "ellipsoidal": undulations are zero.
        geoid: a grid (.gsb, .gtx, .tif), a table of points (.csv), or the undulation in metres. It
            reduces heights above the geoid, and where it has deflections of the vertical, those of
            stations are held at them: A, D, I, J, K, V, Z refer to plumb lines.
        driver: whether records have stations alone, as files for DynAdjust's simulator do. All
            values are zero: the network is a plan, with the standard deviations of the simulator.
        ellipsoid: name of the ellipsoid.

    Raises:
        InputError: every problem of the files, each with its line.
    """
    first = Path(stations)
    problems = Problems()
    files = [dynaml_records(first, problems)]
    second = _measurement_file(first, files[0]) if measurements is None else Path(measurements)
    if second is not None:
        files.append(dynaml_records(second, problems))
    return network_of(
        files,
        first.stem,
        problems,
        reference_frames=reference_frames,
        heights=heights,
        geoid=geoid,
        driver=driver,
        ellipsoid=ellipsoid,
        no_stations=NO_STATIONS_MESSAGE,
    )


def _measurement_file(path: Path, file: RecordFile) -> Path | None:
    """Return the measurement file of a station file; None for a combined file."""
    if not file.measurements and path.stem.endswith("stn"):
        other = path.with_name(path.stem.removesuffix("stn") + "msr" + path.suffix)
        if other.is_file():
            return other
    return None


def dynaml_records(path: Path, problems: Problems) -> RecordFile:
    """Return the records of a file of DynaML.

    Raises:
        InputError: the file cannot be read, or is no DynaML.
    """
    file = XmlSource(path, "DnaXmlFormat", problems)
    file.refuse_children(file.root, DYNAML_CHILDREN)
    head = file.root.attributes
    frame, epoch = head.get("referenceframe", ""), head.get("epoch", "")
    stations = tuple(_station_record(file, e) for e in file.root.all("DnaStation"))
    measurements = tuple(
        _measurement_record(file, e, frame, epoch) for e in file.root.all("DnaMeasurement")
    )
    return RecordFile(file, frame, stations, measurements)


def _station_record(file: XmlSource, element: Element) -> StationRecord:
    at = file.child(element, "StationCoord") or Element("StationCoord", element.line)
    name = file.inside(element, "Name")
    own = file.inside(at, "Name")
    if not own.is_absent and own.value != name.value:
        what = f"coordinates of {str(own.value)[:40]!r} in the station {str(name.value)[:40]!r}"
        file.wrong(at.line, what)
    return StationRecord(
        file,
        element.line,
        name,
        file.inside(element, "Constraints"),
        file.inside(element, "Type"),
        (file.inside(at, "XAxis"), file.inside(at, "YAxis"), file.inside(at, "Height")),
        file.inside(at, "HemisphereZone"),
    )


def _measurement_record(
    file: XmlSource, element: Element, frame: str, epoch: str
) -> MeasurementRecord:
    def inside(tag: str, default: str = "") -> Field:
        found = file.inside(element, tag)
        if found.is_absent and default:
            return file.field(element.line, default, f"<{tag}>")
        return found

    kind = inside("Type").name()
    members = tuple(_members(file, element, kind)) if kind in GNSS_TYPES else ()
    directions = [
        DirectionRecord(
            row.line,
            file.inside(row, "Ignore").name("") == "*",
            file.inside(row, tag),
            file.inside(row, "Value"),
            file.inside(row, "StdDev"),
        )
        for row, tag in ((element, "Second"), *((e, "Target") for e in element.all("Directions")))
        if kind == "D"
    ]
    return MeasurementRecord(
        file,
        element.line,
        kind,
        inside("Ignore").name("") == "*",
        (inside("First"), inside("Second"), inside("Third")),
        inside("Value"),
        inside("StdDev"),
        (inside("InstHeight"), inside("TargHeight")),
        inside("ReferenceFrame", frame),
        inside("Epoch", epoch),
        (inside("Vscale"), inside("Pscale"), inside("Lscale"), inside("Hscale")),
        inside("Coords"),
        inside("Total"),
        members,
        tuple(directions),
    )


def _members(file: XmlSource, element: Element, kind: str) -> Iterator[MemberRecord]:
    """Yield the members of a cluster; a problem where their stations are not as many."""
    tag, cross = MEMBER_TAGS[kind == "Y"]
    nodes = list(element.all(tag))
    firsts, seconds = (list(element.all(t)) for t in ("First", "Second"))
    wanted = [firsts] if kind == "Y" else [firsts, seconds]
    if not nodes or any(len(names) != len(nodes) for names in wanted):
        counts = f"{len(firsts)} <First>, {len(seconds)} <Second>, {len(nodes)} measured"
        if file.inside(element, "Ignore").name("") != "*":
            what = f"type {kind} needs as many stations as vectors: {counts}"
            file.wrong(element.line, what)
        return
    for i, node in enumerate(nodes):
        xx, xy, xz, yy, yz, zz = (
            file.inside(node, f"Sigma{ab}") for ab in ("XX", "XY", "XZ", "YY", "YZ", "ZZ")
        )
        yield MemberRecord(
            node.line,
            file.inside(firsts[i]),
            file.inside(seconds[i] if kind != "Y" else firsts[i]),
            (file.inside(node, "X"), file.inside(node, "Y"), file.inside(node, "Z")),
            (xx, xy, xz, yy, yz, zz),
            tuple(
                tuple(file.inside(c, f"m{row}{column}") for row in "123" for column in "123")
                for c in node.all(cross)
            ),
        )


READER = Reader(
    "dynaml",
    (".xml",),
    "DynaML of DynAdjust",
    NetworkReader(read_dynaml),
    recognises=beginning_has(b"<DnaXmlFormat"),
)

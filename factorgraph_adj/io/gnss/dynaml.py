"""Reader of DynaML, the XML files of DynAdjust: stations and measurements.

Format: ICSM, DynAdjust User's Guide, DynaML.xsd 1.0.2 (2020).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np

from ...errors import known
from ...frames import GeocentricFrame
from ...network.network import Network
from ...observations import ControlPoint
from ...types import Array
from ..collected import raise_all
from ..left_out import all_left_out
from ..xml_source import XmlSource
from ..xml_tree import Element
from .dynaml_measurements import DynamlMeasurements, degrees_of
from .reference_frames import FRAMES

CHILDREN: dict[str, tuple[str, ...]] = {
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
STATION_TYPES = ("LLH", "LLh", "XYZ")
CONSTRAINED = 1e-6
"""Standard deviation of constrained components of a station that is free in others, metres:
DynAdjust's own default."""
NO_STATIONS = (
    "has no <DnaStation>: read the file of the stations (…stn.xml), which takes the measurements "
    "(…msr.xml) beside it or as a second argument"
)


def read_dynaml(
    stations: str | Path,
    measurements: str | Path | None = None,
    *,
    reference_frames: Literal["transform", "by GDA94", "as is"] = "transform",
    heights: Literal["refuse", "ellipsoidal"] = "refuse",
    ellipsoid: str = "GRS80",
) -> Network:
    """Read stations and measurements of DynAdjust (DynaML).

    The frame is geocentric. Stations with the constraints ``CCC`` are held, those with ``FFF`` are
    free; ``CCF`` (latitude, longitude, height) is held by observed components with a standard
    deviation of 1 µm. Measurements are read as follows; angles are degrees, minutes and seconds as
    ddd.mmssss, standard deviations of angles seconds of arc.

    | type | observation |
    | --- | --- |
    | G, X | `GnssVector`; the vectors of X with a joint covariance |
    | Y | `GnssPosition`, in XYZ or in latitude, longitude, height |
    | A | `HorizontalAngle` |
    | D | `Direction`: a set, whose first direction is that to <Second> |
    | B, K | `Azimuth` |
    | S | `SlopeDistance` |
    | V, Z | `ZenithAngle`, `VerticalAngle` |
    | I, J | `AstronomicLatitude`, `AstronomicLongitude` |
    | P, Q, R | one component of a `ControlPoint`: latitude, longitude, ellipsoidal height |
    | L, H | only with ``heights="ellipsoidal"``: `HeightDifference` and height |

    Covariances are multiplied by ``Vscale``, and by ``Pscale``, ``Lscale``, ``Hscale`` in north,
    east and up at the (first) station. Measurements with ``Ignore`` set leave the network, as in
    DynAdjust; C, E and M (chords and arcs along the ellipsoid and sea level) are refused.
    ``Description``, ``Source``, ``MeasurementID`` and ``ClusterID`` have no effect.

    Args:
        stations: station file, or a combined file with both.
        measurements: measurement file. None: a combined file, or the file whose name has ``msr``
            in the place of ``stn`` beside the station file.
        reference_frames: "transform": vectors and points of another reference frame are brought
            into that of the station file at their epoch (ITRF2000 to ITRF2020, GDA94, GDA2020).
            "by GDA94": the same, ITRF2008 by way of GDA94, as DynAdjust 1.0.3 does: 0.2 mm in
            55 km from the other way. "as is": the numbers of the file.
        heights: orthometric heights and height differences need a geoid, which the file lacks.
            "ellipsoidal": take them as ellipsoidal, undulations being zero.
        ellipsoid: name of the ellipsoid.

    Raises:
        InputError: every problem of the files, each with its line.
    """
    first = Path(stations)
    files = [XmlSource(first, "DnaXmlFormat")]
    second = _beside(first, files[0]) if measurements is None else Path(measurements)
    if second is not None:
        files.append(XmlSource(second, "DnaXmlFormat"))
    network = Network(first.stem, frame=GeocentricFrame(ellipsoid))
    frame = files[0].root.attributes.get("referenceframe", "GDA2020").upper()
    transform = reference_frames != "as is"
    if transform and frame not in FRAMES:
        other = f"reference frame {frame!r} is not known; known: {known(FRAMES)}"
        used = {e.text.strip().upper() for f in files for e in f.root.walk()
                if e.tag == "ReferenceFrame" and e.text.strip()}  # fmt: skip
        if used - {frame}:
            files[0].add(
                files[0].root.line, f"{other}; reference_frames='as is' takes numbers as is"
            )
    reader = DynamlMeasurements(
        network, frame if transform else "", heights, by_gda94=reference_frames == "by GDA94"
    )
    for file in files:
        file.refuse_children(file.root, CHILDREN)
        for element in file.root.all("DnaStation"):
            _station(file, network, element)
    if not any(True for file in files for _ in file.root.all("DnaStation")):
        files[0].add(0, NO_STATIONS)
    else:  # without stations every measurement would name an unknown one
        for file in files:
            for element in file.root.all("DnaMeasurement"):
                reader.read(file, element)
    raise_all(files)
    network.left_out += all_left_out(file.left for file in files)
    return network


def _beside(path: Path, file: XmlSource) -> Path | None:
    """Return the measurement file of a station file; None for a combined file."""
    if next(file.root.all("DnaMeasurement"), None) is not None:
        return None
    if path.stem.endswith("stn"):
        other = path.with_name(path.stem.removesuffix("stn") + "msr" + path.suffix)
        if other.is_file():
            return other
    return None


def _station(file: XmlSource, network: Network, element: Element) -> None:
    before = len(file.problems)
    name = file.text(element, "Name")
    constraints = file.text(element, "Constraints", "FFF").upper()
    kind = file.text(element, "Type", "LLH")
    at = file.child(element, "StationCoord")
    if len(constraints) != 3 or set(constraints) - {"C", "F"}:
        what = f"constraints must be three of C and F, such as CCF, not {constraints!r}"
        file.add(element.line, what)
    if kind not in STATION_TYPES:
        what = f"type {kind!r} of a station is not read; valid: {', '.join(STATION_TYPES)}"
        file.add(element.line, f"{what} (DynAdjust's dnaimport exports LLH)")
    own = "" if at is None else file.text(at, "Name", name)
    if at is not None and own != name:
        file.add(at.line, f"coordinates of {own[:40]!r} in the station {name[:40]!r}")
    if at is None or len(file.problems) > before:
        return
    xyz = place_of(file, at, kind, network)
    if len(file.problems) > before:
        return
    held = "xyz" if constraints == "CCC" else ""
    file.attempt(element.line, network.add_point, name, xyz.tolist(), fixed=held)
    axes = "".join(a for a, c in zip("neu", constraints, strict=True) if c == "C")
    if not axes or held or len(file.problems) > before:
        return
    made = file.attempt(
        element.line,
        ControlPoint,
        name,
        tuple(xyz.tolist()),
        axes=axes,
        sigma=(CONSTRAINED,) * len(axes),
        source=file.place(element.line),
    )
    if made is not None:
        file.attempt(element.line, network.add, made)


def place_of(file: XmlSource, at: Element, kind: str, network: Network) -> Array:
    """Return geocentric coordinates (3,) of a station."""
    if kind == "XYZ":
        return np.array([file.value(at, t) for t in ("XAxis", "YAxis", "Height")])
    latitude, longitude = (degrees_of(file, at, tag) for tag in ("XAxis", "YAxis"))
    height = file.value(at, "Height")
    if not abs(latitude) <= math.pi / 2:
        file.add(at.line, "the latitude must be from -90 to 90 degrees")
    frame = network.frame
    assert isinstance(frame, GeocentricFrame)
    angles = (np.array([latitude]), np.array([longitude]), np.array([height]))
    return np.asarray(frame.ellipsoid.to_cartesian(*angles)[0])

"""Reader of surveys in LandXML 1.2 and Leica's HeXML; writer of points in LandXML.

HeXML is LandXML with further elements.

Schema: LandXML.org, LandXML-1.2, ``<Survey>``; Leica Geosystems, HeXML 1.x.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Literal
from xml.sax.saxutils import quoteattr

from ...crs.reference_system import ReferenceSystem
from ...errors import InputError, Problem, known, taking
from ...frames import LocalFrame
from ...network.network import Network
from ...observations import Azimuth, HorizontalDistance
from ...units import ANGLE, FOOT, GON, US_SURVEY_FOOT
from ..file_transaction import write_files
from ..format_limits import grid_points
from ..format_reader import NetworkReader, Reader
from ..numbers import PACKED_DEGREES, write_quantity
from ..source import DERIVED_OBSERVATIONS, ROWS_SWITCHED_OFF, LeftOutReason
from ..xml_files import Element, begins_with_element, element_at
from ..xml_source import XmlSource
from .accuracies import DEFAULT_ACCURACIES, Accuracies
from .field_book import FieldBook
from .field_records import Scales, read_angle

LINEAR_UNITS = {
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "meter": 1.0,
    "kilometer": 1e3,
    "foot": FOOT,
    "ussurveyfoot": US_SURVEY_FOOT,
    "inch": 0.0254,
    "mile": 1609.344,
}
"""Metres of ``linearUnit``."""
ANGULAR_UNITS: dict[str, float | str] = {
    "radians": 1.0,
    "grads": GON,
    "decimal degrees": ANGLE["deg"],
    "decimal dd.mm.ss": PACKED_DEGREES,
}
"""Radians of ``angularUnit``, or the name of the unit."""
DIRECT_FACES = {"true": 1, "1": 1, "false": 2, "0": 2}
"""Face by ``directFace``."""
OBSERVATION_ELEMENTS = ("RawObservation", "ReducedObservation")
COMPUTED_TYPES = ("computed", "derived", "calculated")
"""Values of azimuthType and distanceType, in small letters, that state no measurement."""
COMPUTED = LeftOutReason("azimuths and distances", "they are computed, not measured")
ARCS = LeftOutReason("arcs", "azimuths and distances between two points alone are read")
OTHER_DISTANCES = ("MSLDistance", "spheroidDistance", "vertDistance")
OTHERS = LeftOutReason(
    "reduced values", "azimuths and horizontal distances at the ground alone are read"
)
SETUP_ELEMENTS = ("InstrumentSetup",)
UNREAD_SURVEY_ELEMENTS = {
    "GPSVector": "GPS vectors are geocentric: use a reader of GNSS vectors",
    "LaserSetup": "scans are not read",
}
LANDXML_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2" version="1.2">
  <Units>
    <Metric linearUnit="meter" areaUnit="squareMeter" volumeUnit="cubicMeter" \
temperatureUnit="celsius" pressureUnit="milliBars" angularUnit="grads" directionUnit="grads"/>
  </Units>
{coordinate_system}  <Application name="factorgraph_adj"/>
  <CgPoints>
"""
LANDXML_TAIL = """  </CgPoints>
</LandXML>
"""


def read_landxml(
    path: str | Path,
    *,
    order: Literal["NE", "EN"] = "NE",
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read the survey of a LandXML or HeXML file.

    Read are ``<Units>``, ``<CgPoint>`` (north first), ``<InstrumentSetup>`` with station, height
    and point, and each ``<RawObservation>`` with horizAngle, zenithAngle, slopeDistance or
    horizDistance, targetHeight, directFace and its ``<TargetPoint>``, within its set-up or in an
    ``<ObservationGroup>`` that names one. A target is named by ``name``, ``pntRef`` or ``desc``.
    Coordinates are approximate ones, held where ``fixed`` names the point; distances are corrected
    already. The circle reading of a ``<Backsight>`` counts as a direction where no raw observation
    of its set-up has the same target. What is marked ``status="deleted"`` is left out.

    A file without raw observations, such as a plan of a cadastre (ePlan), is read from its
    ``<ReducedObservation>``: azimuth and horizDistance between the points of two set-ups
    (targetSetupID), or to a ``<TargetPoint>``, in the units directionUnit and linearUnit; a remark
    of the network says so. Azimuths refer to the meridian of the file; those that the file calls
    computed are left out, and so are arcs, other distances and reduced observations beside raw
    ones. Their accuracies are those of directions and distances in ``accuracies``: the file may
    state them as classes.

    Features, the elements that HeXML adds (``<HexagonLandXML>``: codes, classes and qualities of
    the same points and observations), and everything outside ``<Survey>`` and ``<CgPoints>``, such
    as surfaces and alignments, are not read; GPS vectors are refused.

    Args:
        path: the file.
        order: order of coordinates: NE, north first, as the schema says; some programs write EN.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    if order not in ("NE", "EN"):
        raise InputError(Problem(f"must be NE or EN, not {order!r}", "order"))
    source = XmlSource(path, "LandXML")
    reader = _Reader(source, FieldBook(source, accuracies, fixed), order == "EN")
    reader.read(source.root)
    return reader.book.network()


class _Reader:
    def __init__(self, source: XmlSource, book: FieldBook, east_first: bool) -> None:
        self.source = source
        self.book = book
        self.east_first = east_first
        self.scales = Scales()
        self.setups: dict[str, Element] = {}
        self.backsights: dict[str, list[Element]] = {}
        self.current: str | None = None
        self.directions = Scales()
        """Unit of azimuths."""
        self.points: set[str] = set()
        """Names of the elements <CgPoint>."""

    def read(self, root: Element) -> None:
        """Read units, points, set-ups and observations."""
        self._units(root)
        extension = element_at(root, "HexagonLandXML")
        inside = set() if extension is None else {id(e) for e in extension.walk()}
        elements = [e for e in root.walk() if id(e) not in inside]
        for e in elements:
            if e.tag in ("CgPoint", *SETUP_ELEMENTS) and _deleted(e):
                name = e.attributes.get("name") or e.attributes.get("stationName", "")
                self.source.leave_out(e.line, ROWS_SWITCHED_OFF, name)
                continue
            if e.tag == "CgPoint":
                self._cg_point(e)
            elif e.tag in UNREAD_SURVEY_ELEMENTS:
                self.source.wrong(e.line, f"<{e.tag}> is not read: {UNREAD_SURVEY_ELEMENTS[e.tag]}")
            elif e.tag in SETUP_ELEMENTS:
                self._setup(e)
        surveys = [e for e in elements if e.tag == "Survey"]
        found = [(o, setup) for survey in surveys for o, setup in self._observations(survey)]
        raw = [(o, setup) for o, setup in found if o.tag == "RawObservation"]
        for o, setup in raw:
            self._observation(o, setup)
        reduced = [(o, setup) for o, setup in found if o.tag != "RawObservation"]
        for o, setup in reduced:
            if raw:
                self.source.leave_out(o.line, DERIVED_OBSERVATIONS, _reduced_name(o, setup))
            else:
                self._reduced(o, setup)
        if reduced and not raw:
            what = "the file has no raw observations: azimuths and horizontal distances of its "
            self.source.problems.remarks.append(f"{what}{len(reduced)} reduced ones are read")

    # -- units --------------------------------------------------------------------------------

    def _units(self, root: Element) -> None:
        units = element_at(root, "Units")
        children = [] if units is None else units.children
        if not children:
            self.source.wrong(root.line, "has no <Units> with <Metric> or <Imperial>")
            return
        given = children[0].attributes
        linear = given.get("linearUnit", "").lower()
        angular = given.get("angularUnit", "radians").lower()
        line = children[0].line
        angle = self.source.field(line, angular, "angularUnit").choice(ANGULAR_UNITS)
        length = self.source.field(line, linear, "linearUnit").choice(LINEAR_UNITS, default=1.0)
        self.scales = Scales(length or 1.0, angle or 1.0)
        word = given.get("directionUnit", angular).lower()
        direction = self.source.field(line, word, "directionUnit").choice(ANGULAR_UNITS)
        self.directions = Scales(angle=direction or 1.0)

    def _angle(self, e: Element, name: str) -> float | None:
        field = self.source.attribute(e, name)
        return None if field.is_absent else read_angle(field, self.scales)

    def _length(self, e: Element, name: str) -> float | None:
        return self.source.attribute(e, name).number_or_none(scale=self.scales.length)

    # -- points ---------------------------------------------------------------------------------

    def _cg_point(self, e: Element) -> None:
        name = e.attributes.get("name") or e.attributes.get("oID", "")
        if not name and (e.attributes.get("pntRef") or not e.text.strip()):
            return
        name = self.source.field(e.line, name, "name of a <CgPoint>").name()
        self.points.add(name)
        self._coordinates(e, name)

    def _coordinates(self, e: Element, name: str) -> None:
        """Note a point with the coordinates in the text of an element, north first."""
        words = e.text.split()
        if not words or not name:
            return
        if len(words) not in (2, 3):
            what = f"<{e.tag}> needs north, east and elevation, not {len(words)} numbers"
            self.source.wrong(e.line, what)
            return
        fields = [self.source.field(e.line, w, "coordinate") for w in words]
        a, b, *up = (f.number(scale=self.scales.length) for f in fields)
        east, north = (a, b) if self.east_first else (b, a)
        self.book.point(e.line, name, east, north, *up, agree=False)

    def _setup(self, e: Element) -> None:
        ident = e.attributes.get("id", "")
        if ident in self.setups:
            self.source.wrong(
                e.line, f"id {ident!r} of two set-ups; first in line {self.setups[ident].line}"
            )
            return
        name = self.source.attribute(e, "stationName").name()
        self.setups[ident] = e
        point = element_at(e, "InstrumentPoint")
        if point is not None and name:
            self._coordinates(point, name)

    # -- observations ---------------------------------------------------------------------------

    def _observations(self, survey: Element) -> Iterator[tuple[Element, str]]:
        """Iterate over raw observations with their set-ups; keep backsights."""
        for e in survey.children:
            group = e.attributes.get("setupID", "")
            if e.tag == "InstrumentSetup":
                group = e.attributes.get("id", "")
            gone = _deleted(e)
            for o in e.walk():
                observed = o.tag in ("Backsight", *OBSERVATION_ELEMENTS)
                if observed and (gone or _deleted(o)):
                    setup = o.attributes.get("setupID") or group
                    station = self.setups.get(setup)
                    at = setup if station is None else station.attributes.get("stationName", "")
                    why = ROWS_SWITCHED_OFF
                    self.source.leave_out(o.line, why, f"{at} {self._target(o)}".strip())
                    continue
                if o.tag == "ReducedArcObservation":
                    self.source.leave_out(o.line, ARCS, _reduced_name(o, group))
                elif o.tag in OBSERVATION_ELEMENTS:
                    yield o, o.attributes.get("setupID") or group
                elif o.tag == "Backsight":
                    setup = o.attributes.get("setupID") or group
                    self.backsights.setdefault(setup, []).append(o)

    def _target(self, o: Element) -> str:
        """Return the name of the target of an observation or a backsight; '' where it has none."""
        for target in (e for e in o.children if e.tag in ("TargetPoint", "BacksightPoint")):
            for key in ("name", "pntRef", "desc"):
                if target.attributes.get(key):
                    return target.attributes[key].strip()
        return ""

    def _observation(self, o: Element, setup: str) -> None:
        number = self._length
        at = self.setups.get(setup)
        if at is None:
            what = f"the observation needs setupID; {setup!r} is none of {known(self.setups)}"
            self.source.wrong(o.line, what)
            return
        if self.current != setup:
            self.current = setup
            height = number(at, "instrumentHeight")
            station = self.source.attribute(at, "stationName").name()
            self.book.begin(at.line, station, height or 0.0)
            for e in self.backsights.pop(setup, []):
                name = self._target(e)
                if name:
                    self.book.backsight(e.line, name, self._angle(e, "circle"))
        target = element_at(o, "TargetPoint")
        name = self.source.field(o.line, self._target(o), "name of the <TargetPoint>").name()
        if target is not None:
            self._coordinates(target, name)
        word = o.attributes.get("directFace", "").lower()
        face = self.source.field(o.line, word, "directFace").choice(DIRECT_FACES, default=None)
        self.book.sight(
            o.line,
            name,
            direction=self._angle(o, "horizAngle"),
            zenith=(zenith := self._angle(o, "zenithAngle")),
            distance=number(o, "slopeDistance"),
            horizontal=number(o, "horizDistance"),
            target_height=number(o, "targetHeight") or 0.0,
            # Where the face follows from the zenith reading, writers do not agree on directFace.
            face=None if zenith is not None else face,
        )

    def _reduced(self, o: Element, setup: str) -> None:
        """Read azimuth and horizontal distance between two points."""
        ends = [self._point_of(o, "setupID", setup)]
        if name := self._target(o):
            ends.append(name)
        else:
            ends.append(self._point_of(o, "targetSetupID", o.attributes.get("targetSetupID", "")))
        azimuth = self.source.attribute(o, "azimuth")
        values = {
            "azimuth": None if azimuth.is_absent else read_angle(azimuth, self.directions),
            "distance": self._length(o, "horizDistance"),
        }
        if any(o.attributes.get(name) for name in OTHER_DISTANCES):
            self.source.leave_out(o.line, OTHERS, _reduced_name(o, setup))
        for name, kind in (("azimuth", Azimuth), ("distance", HorizontalDistance)):
            value = values[name]
            if value is None or not all(ends) or math.isnan(value):
                continue
            if o.attributes.get(f"{name}Type", "").lower() in COMPUTED_TYPES:
                self.source.leave_out(o.line, COMPUTED, _reduced_name(o, setup))
                continue
            a = self.book.accuracies
            sigma = a.direction(None) if kind is Azimuth else a.distance(None)
            place = self.source.place(o.line)
            found = self.source.attempt(
                o.line, kind, ends[0], ends[1], value, sigma=sigma, source=place
            )
            self.book.others += [] if found is None else [found]
        for name in ends:
            self.book.point(o.line, name)

    def _point_of(self, o: Element, attribute: str, setup: str) -> str:
        """Return the name of the point of a set-up: of its <CgPoint>, or of the station."""
        at = self.setups.get(setup)
        if at is None:
            what = f"the reduced observation needs {attribute}; {setup!r} is none of "
            self.source.wrong(o.line, what + known(self.setups))
            return ""
        point = element_at(at, "InstrumentPoint")
        name = "" if point is None else point.attributes.get("pntRef", "").strip()
        return name if name in self.points else at.attributes.get("stationName", "").strip()


def _reduced_name(o: Element, setup: str) -> str:
    """Return the name of a reduced observation for messages: its own, or its set-ups."""
    ends = f"{o.attributes.get('setupID') or setup} {o.attributes.get('targetSetupID', '')}"
    return o.attributes.get("name") or ends.strip()


def _deleted(e: Element) -> bool:
    return e.attributes.get("status", "").lower() == "deleted"


def is_landxml(path: Path) -> bool:
    """Return whether an XML file is LandXML or HeXML."""
    return begins_with_element(path, b"LandXML")


@taking(Network)
def write_landxml(network: Network, path: str | Path, *, points_only: bool = False) -> None:
    """Write the points of a network as ``<CgPoint>`` of LandXML 1.2, north first, metres.

    Held points have the code ``control``. A network on the Earth with a reference system is written
    in its grid, whose name and EPSG code the file states.

    Args:
        network: the network; that of an adjustment is `Solution.as_network`.
        path: the file.
        points_only: whether observations, photos and standard deviations may be left out, which
            the writer does not write; otherwise a network that has any is refused.

    Raises:
        InputError: all that the file cannot hold: a geocentric or topocentric frame without the
            reference system of a grid, left-handed or other axes
            than en and ne, points without east and north, names that XML cannot hold, and what
            ``points_only`` is about. Nothing is written then.
    """
    frame, problems = network.frame, []
    grid = grid_points(network)
    if grid is None and (not isinstance(frame, LocalFrame) or frame.axes not in ("en", "ne")):
        what = "LandXML takes a local frame with axes en or ne, or the reference system of a grid"
        problems.append(Problem(what, network.name))
    count = len(network.observations) + network.n_image_points + len(network.photos)
    if count and not points_only:
        what = (
            f"{count} observations and photos are not written as LandXML: give points_only=true "
            "(on the command line --with points_only=true)"
        )
        problems.append(Problem(what, network.name))
    east, north = (0, 1) if getattr(frame, "axes", "en") == "en" else (1, 0)
    lines = []
    for p in network.points.values():
        at = p.coordinates if grid is None else tuple(grid.coordinates[p.name].tolist())
        known = [k for k in (north, east, 2) if not math.isnan(at[k])]
        if north not in known or east not in known:
            problems.append(
                Problem("has no east and north: write the adjusted network", f"point {p.name!r}")
            )
            continue
        if not p.name.isprintable():
            problems.append(Problem("has a name that XML cannot hold", f"point {p.name!r}"))
        held = ' code="control"' if any(p.fixed) else ""
        text = " ".join(write_quantity(at[k]) for k in known)
        lines.append(f"    <CgPoint name={quoteattr(p.name)}{held}>{text}</CgPoint>\n")
    if problems:
        raise InputError(problems)
    target = Path(path)
    head = LANDXML_HEAD.replace(
        "{coordinate_system}", "" if grid is None else _system_element(grid.system)
    )
    write_files(target.parent, {target.name: head + "".join(lines) + LANDXML_TAIL})


def _system_element(system: ReferenceSystem) -> str:
    """Return the element of a reference system."""
    code = "" if system.epsg is None else f' epsgCode="{system.epsg}"'
    name, vertical = quoteattr(system.name), quoteattr(system.vertical)
    return f"  <CoordinateSystem name={name}{code} verticalDatum={vertical}/>\n"


READER = Reader(
    "landxml",
    (".xml", ".hexml"),
    "survey in LandXML or HeXML",
    NetworkReader(read_landxml),
    recognises=is_landxml,
)

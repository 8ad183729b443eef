"""Reader of Trimble's JobXML (``.jxl``): points, set-ups and sights of total stations.

Elements: Trimble, JobXML schema 5.x. Angles are degrees, lengths metres, whatever the units that
the job displays.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from ...errors import known
from ...network.network import Network
from ...units import ANGLE
from ..format_reader import NetworkReader, Reader
from ..source import NOTES, ROWS_SWITCHED_OFF, LeftOutReason
from ..xml_files import Element, begins_with_element, element_at, text_at
from ..xml_source import XmlSource
from .accuracies import DEFAULT_ACCURACIES, Accuracies, StatedSigmas
from .field_book import FieldBook

DEG = ANGLE["deg"]
JOBXML_FACES = {"Face1": 1, "Face2": 2, "FaceNull": None}
STANDARD_ERRORS = (
    ("HorizontalCircleStandardError", DEG),
    ("VerticalCircleStandardError", DEG),
    ("EDMDistanceStandardError", 1.0),
)
"""Elements of a circle with standard errors, and their units."""
GNSS_ELEMENTS = ("ECEFDeltas", "ECEF", "WGS84")
"""Elements of a point that was measured with GNSS."""
GNSS_POINTS = LeftOutReason("points of GNSS", "sights of total stations alone are read")
WITHOUT_NAME = LeftOutReason("records of points", "they have no name (<Name>)")
WITHOUT_STATION = LeftOutReason("sights", "the file has no record of their station (StationRecord)")


def read_jobxml(
    path: str | Path,
    *,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of Trimble Access, JobXML.

    Read are ``StationRecord`` (name, height of the instrument), ``TargetRecord`` (height, prism
    constant), ``AtmosphereRecord`` (ppm, where it is to be applied) and the circles of each
    ``PointRecord`` that is not deleted. A raw distance D becomes D (1 + ppm) + prism constant.
    Coordinates of a ``PointRecord`` (``Grid``) and of points of ``Reductions`` (with or without
    ``Grid``) are approximate ones, held
    where ``fixed`` names the point. Standard errors of the file count (of a set their root mean
    square) unless ``accuracies`` states others. Refraction and curvature that the instrument has
    applied do not concern raw readings.

    Left out and counted are points without a name, and sights that name no station or whose file
    has no record of any; where it has some, a sight that names another is an error.

    Means of several rounds (``MTA``, ``Method`` MeanTurnedAngle), GNSS records, notes, units and
    all other records are not read: they hold no readings of circles.

    Args:
        path: the file.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = XmlSource(path, "JOBFile")
    reader = _Reader(source, FieldBook(source, accuracies, fixed))
    reader.read(source.root)
    return reader.book.network()


class _Reader:
    def __init__(self, source: XmlSource, book: FieldBook) -> None:
        self.source = source
        self.book = book
        self.records: dict[str, dict[str, Element]] = {}
        self.at: str | None = None

    def read(self, root: Element) -> None:
        """Read the field book and the reductions."""
        book = element_at(root, "FieldBook")
        for record in () if book is None else book.children:
            ident = record.attributes.get("ID", "")
            self.records.setdefault(record.tag, {})[ident] = record
        for record in () if book is None else book.children:
            if record.tag == "NoteRecord":
                self._notes(record)
            if record.tag != "PointRecord":
                continue
            if text_at(record, "Deleted").lower() == "true":
                name = text_at(record, "Name")
                self.source.leave_out(record.line, ROWS_SWITCHED_OFF, name)
                continue
            self._point(record)
        reductions = element_at(root, "Reductions")
        for point in () if reductions is None else reductions.children:
            if point.tag in ("Point", "PointRecord"):
                grid = ("Grid",) if element_at(point, "Grid") is not None else ()
                self._coordinates(point, text_at(point, "Name"), *grid)
                if not text_at(point, *grid, "North") and text_at(point, "Latitude"):
                    self.source.leave_out(point.line, GNSS_POINTS, text_at(point, "Name"))

    def _notes(self, record: Element) -> None:
        """Leave out the notes of a record, each with its text."""
        for note in (element_at(record, "Notes") or record).children:
            if note.tag == "Note" and note.text.strip():
                self.source.leave_out(note.line, NOTES, note.text.strip())

    def _record(self, of: Element, tag: str, reference: str) -> Element | None:
        """Return the record that another one refers to; a missing one is a problem."""
        ident = text_at(of, reference)
        if not ident:
            return None
        found = self.records.get(tag, {}).get(ident)
        if found is None:
            names = known(self.records.get(tag, {}), meant=ident)
            self.source.wrong(of.line, f"there is no {tag} {ident!r}; known: {names}")
        return found

    def _coordinates(self, record: Element, name: str, *tags: str) -> None:
        fields = [self.source.inside(record, *tags, a) for a in ("East", "North", "Elevation")]
        values = [f.number(default=math.nan) for f in fields]
        if name and not all(f.is_absent for f in fields):
            self.book.point(record.line, name, *values, agree=False)

    def _point(self, record: Element) -> None:
        inside = self.source.inside
        if inside(record, "Name").is_absent:
            self.source.leave_out(record.line, WITHOUT_NAME, record.attributes.get("ID", ""))
            return
        name = inside(record, "Name").name()
        self._coordinates(record, name, "Grid")
        circle = element_at(record, "Circle")
        if circle is None and any(element_at(record, tag) is not None for tag in GNSS_ELEMENTS):
            self.source.leave_out(record.line, GNSS_POINTS, name)
        if circle is None or not name:
            return
        if not text_at(record, "StationID") or "StationRecord" not in self.records:
            self.source.leave_out(record.line, WITHOUT_STATION, name)
            return
        station = self._record(record, "StationRecord", "StationID")
        if station is None:
            return
        ident = text_at(record, "StationID")
        if ident != self.at:
            self.at = ident
            at = inside(station, "StationName").name()
            height = inside(station, "TheodoliteHeight").number(default=0.0)
            self.book.begin(station.line, at, height)
        target = self._record(record, "TargetRecord", "TargetID")
        height = constant = 0.0
        if target is not None:
            height = inside(target, "TargetHeight").number(default=0.0)
            constant = inside(target, "PrismConstant").number(default=0.0)
        distance = inside(circle, "EDMDistance").number_or_none()
        if distance:
            distance = distance * (1.0 + self._ppm(station)) + constant
        errors = [inside(circle, e).number(scale=s, default=0.0) for e, s in STANDARD_ERRORS]
        self.book.sight(
            record.line,
            name,
            direction=inside(circle, "HorizontalCircle").number_or_none(scale=DEG),
            zenith=inside(circle, "VerticalCircle").number_or_none(scale=DEG),
            distance=distance,
            target_height=height,
            face=inside(circle, "Face").choice(JOBXML_FACES, default=None),
            stated=StatedSigmas(*(e if e > 0 else None for e in errors)),
        )

    def _ppm(self, station: Element) -> float:
        """Return the correction of distances by the atmosphere, as a ratio."""
        air = self._record(station, "AtmosphereRecord", "AtmosphereID")
        if air is None or text_at(air, "ApplyPPMToRawDistances").lower() != "true":
            return 0.0
        return 1e-6 * self.source.inside(air, "PPM").number(default=0.0)


def is_jobxml(path: Path) -> bool:
    """Return whether an XML file is JobXML."""
    return begins_with_element(path, b"JOBFile")


READER = Reader(
    "jobxml",
    (".jxl", ".xml"),
    "Trimble JobXML",
    NetworkReader(read_jobxml),
    recognises=is_jobxml,
)

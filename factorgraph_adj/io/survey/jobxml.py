"""Reader of Trimble's JobXML (``.jxl``), the field book of Trimble Access.

Elements: Trimble, JobXML schema 5.x. Angles are degrees, lengths metres, whatever the units that
the job displays.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from ...errors import InputError, Problem, known
from ...network.network import Network
from ..file_problems import ROWS_SWITCHED_OFF, LeftOutReason
from ..xml_files import (
    Element,
    begins_with_element,
    element_at,
    nan_for_none,
    number_at,
    root_with_tag,
    text_at,
)
from .field_book import DEFAULT_ACCURACIES, Accuracies, FieldBook, StatedSigmas

DEG = math.pi / 180.0
JOBXML_FACES = {"Face1": 1, "Face2": 2, "FaceNull": None, "": None}


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
    Coordinates of a ``PointRecord`` (``Grid``) and of ``Reductions`` are approximate ones, held
    where ``fixed`` names the point. Standard errors of the file count (of a set their root mean
    square) unless ``accuracies`` states others. Refraction and curvature that the instrument has
    applied do not concern raw readings.

    Means of several rounds (``MTA``, ``Method`` MeanTurnedAngle), GNSS records, notes, units and
    all other records are not read: they hold no readings of circles.

    Args:
        path: the file.
        fixed: names of points that are held at the coordinates of the file; none: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = Path(path)
    root = root_with_tag(source, "JOBFile")
    if root is None:
        raise InputError(Problem("is no JobXML: its root must be <JOBFile>", f"{source.name}:1"))
    reader = _Reader(FieldBook(source, accuracies, fixed))
    reader.read(root)
    return reader.book.network()


GNSS_ELEMENTS = ("ECEFDeltas", "ECEF", "WGS84")
"""Elements of a point that was measured with GNSS."""
GNSS_POINTS = LeftOutReason("points of GNSS", "sights of total stations alone are read")


class _Reader:
    def __init__(self, book: FieldBook) -> None:
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
            if record.tag != "PointRecord":
                continue
            if text_at(record, "Deleted").lower() == "true":
                name = text_at(record, "Name")
                self.book.notes.leave_out(record.line, ROWS_SWITCHED_OFF, name)
                continue
            self._point(record)
        reductions = element_at(root, "Reductions")
        for point in () if reductions is None else reductions.all("Point"):
            self._coordinates(point, text_at(point, "Name"), "Grid")

    def _record(self, of: Element, tag: str, reference: str) -> Element | None:
        """Return the record that another one refers to; a missing one is a problem."""
        ident = text_at(of, reference)
        if not ident:
            return None
        found = self.records.get(tag, {}).get(ident)
        if found is None:
            names = known(self.records.get(tag, {}), meant=ident)
            self.book.notes.add(of.line, f"there is no {tag} {ident!r}; known: {names}")
        return found

    def _coordinates(self, record: Element, name: str, tag: str) -> None:
        values = [
            number_at(self.book.notes, record, tag, axis) for axis in ("East", "North", "Elevation")
        ]
        if name and any(v is not None for v in values):
            self.book.point(record.line, name, *map(nan_for_none, values), agree=False)

    def _point(self, record: Element) -> None:
        notes = self.book.notes
        name = notes.name(record.line, text_at(record, "Name"), "<Name> of a point")
        self._coordinates(record, name, "Grid")
        circle = element_at(record, "Circle")
        if circle is None and any(element_at(record, tag) is not None for tag in GNSS_ELEMENTS):
            notes.leave_out(record.line, GNSS_POINTS, name)
        if circle is None or not name:
            return
        station = self._record(record, "StationRecord", "StationID")
        if station is None:
            if not text_at(record, "StationID"):
                notes.add(record.line, f"the sight to {name!r} has no <StationID>")
            return
        ident = text_at(record, "StationID")
        if ident != self.at:
            self.at = ident
            at = notes.name(station.line, text_at(station, "StationName"), "<StationName>")
            height = number_at(notes, station, "TheodoliteHeight")
            self.book.begin(station.line, at, height or 0.0)
        target = self._record(record, "TargetRecord", "TargetID")
        height = constant = None
        if target is not None:
            height = number_at(notes, target, "TargetHeight")
            constant = number_at(notes, target, "PrismConstant")
        face = text_at(circle, "Face")
        if face not in JOBXML_FACES:
            notes.add(
                circle.line,
                f"<Face> must be one of {known(filter(None, JOBXML_FACES))}, not {face!r}",
            )
        distance = number_at(notes, circle, "EDMDistance")
        if distance:
            distance = distance * (1.0 + self._ppm(station)) + (constant or 0.0)
        errors = [
            number_at(notes, circle, f"{part}StandardError", scale=scale)
            for part, scale in (
                ("HorizontalCircle", DEG),
                ("VerticalCircle", DEG),
                ("EDMDistance", 1.0),
            )
        ]
        self.book.sight(
            record.line,
            name,
            direction=number_at(notes, circle, "HorizontalCircle", scale=DEG),
            zenith=number_at(notes, circle, "VerticalCircle", scale=DEG),
            distance=distance or None,
            target_height=height or 0.0,
            face=JOBXML_FACES.get(face),
            stated=StatedSigmas(*(e if e is not None and e > 0 else None for e in errors)),
        )

    def _ppm(self, station: Element) -> float:
        """Return the correction of distances by the atmosphere, as a ratio."""
        air = self._record(station, "AtmosphereRecord", "AtmosphereID")
        if air is None or text_at(air, "ApplyPPMToRawDistances").lower() != "true":
            return 0.0
        return 1e-6 * (number_at(self.book.notes, air, "PPM") or 0.0)


def is_jobxml(path: Path) -> bool:
    """Return whether an XML file is JobXML."""
    return begins_with_element(path, b"JOBFile")

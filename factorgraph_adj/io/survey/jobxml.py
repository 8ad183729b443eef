"""Reader of Trimble's JobXML (``.jxl``), the field book of Trimble Access.

Elements: Trimble, JobXML schema 5.x. Angles are degrees, lengths metres, whatever the units that
the job displays.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from ...errors import InputError, Problem, known
from ...field.faces import Faces
from ...network.network import Network
from ..xml_tree import Element
from .accuracies import DIRECTION_MGON, DISTANCE_MM, PPM, REFRACTION, ZENITH_MGON, Accuracies
from .book import FieldBook, Stated
from .xml_book import begins_with, first, known_or_nan, number_of, root_of, text_of

DEG = math.pi / 180.0
FACES = {"Face1": 1, "Face2": 2, "FaceNull": None, "": None}
NO_SIGHT = ("KeyedIn", "Coordinates", "Control")


def read_jobxml(
    path: str | Path,
    *,
    fixed: str | Iterable[str] = (),
    sigma_direction_mgon: float | None = None,
    sigma_zenith_mgon: float | None = None,
    sigma_distance_mm: float | None = None,
    ppm: float = PPM,
    centring_mm: float | None = None,
    faces: Faces = "means",
    refraction: float | None = REFRACTION,
) -> Network:
    """Read a field book of Trimble Access, JobXML.

    Read are ``StationRecord`` (name, height of the instrument), ``TargetRecord`` (height, prism
    constant), ``AtmosphereRecord`` (ppm, where it is to be applied) and the circles of each
    ``PointRecord`` that is not deleted. A raw distance D becomes D (1 + ppm) + prism constant.
    Coordinates of a ``PointRecord`` (``Grid``) and of ``Reductions`` are approximate ones, held
    where ``fixed`` names the point. Standard errors of the file count (of a set their root mean
    square) unless the options state others. Refraction and curvature that the instrument has
    applied do not concern raw readings.

    Means of several rounds (``MTA``, ``Method`` MeanTurnedAngle), GNSS records, notes, units and
    all other records are not read: they hold no readings of circles.

    Args:
        path: the file.
        fixed: names of points that are held at the coordinates of the file; none: a free network.
        sigma_direction_mgon: σ of a horizontal reading in one face, mgon; None: that of the file,
            or 1.
        sigma_zenith_mgon: σ of a zenith reading in one face, mgon; None: that of the file, or 1.
        sigma_distance_mm: constant part of σ of a distance, mm; None: that of the file, which then
            has no part that grows, or 2.
        ppm: part of σ of a distance that grows with it, mm/km.
        centring_mm: σ of the centring of instrument and target, mm; None: 1, for both faces 0.
        faces: means of two faces, or both readings with index and collimation errors as unknowns.
        refraction: coefficient k, with the curvature of the Earth; None: neither.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    accuracies = Accuracies(
        DIRECTION_MGON if sigma_direction_mgon is None else sigma_direction_mgon,
        ZENITH_MGON if sigma_zenith_mgon is None else sigma_zenith_mgon,
        DISTANCE_MM if sigma_distance_mm is None else sigma_distance_mm,
        ppm,
        centring_mm,
        faces=faces,
        refraction=refraction,
        fixed=fixed,
    )
    source = Path(path)
    root = root_of(source, "JOBFile")
    if root is None:
        raise InputError(Problem("is no JobXML: its root must be <JOBFile>", f"{source.name}:1"))
    reader = _Reader(
        FieldBook(source, accuracies),
        (sigma_direction_mgon is None, sigma_zenith_mgon is None, sigma_distance_mm is None),
    )
    reader.read(root)
    return reader.book.network()


class _Reader:
    def __init__(self, book: FieldBook, stated: tuple[bool, bool, bool]) -> None:
        self.book = book
        self.use_stated = stated
        self.records: dict[str, dict[str, Element]] = {}
        self.at: str | None = None

    def read(self, root: Element) -> None:
        """Read the field book and the reductions."""
        book = first(root, "FieldBook")
        for record in () if book is None else book.children:
            ident = record.attributes.get("ID", "")
            self.records.setdefault(record.tag, {})[ident] = record
        for record in () if book is None else book.children:
            if record.tag == "PointRecord" and text_of(record, "Deleted").lower() != "true":
                self._point(record)
        reductions = first(root, "Reductions")
        for point in () if reductions is None else reductions.all("Point"):
            self._coordinates(point, text_of(point, "Name"), "Grid")

    def _record(self, of: Element, tag: str, reference: str) -> Element | None:
        """Return the record that another one refers to; a missing one is a problem."""
        ident = text_of(of, reference)
        if not ident:
            return None
        found = self.records.get(tag, {}).get(ident)
        if found is None:
            names = known(self.records.get(tag, {}), meant=ident)
            self.book.notes.add(of.line, f"there is no {tag} {ident!r}; known: {names}")
        return found

    def _coordinates(self, record: Element, name: str, tag: str) -> None:
        values = [
            number_of(self.book.notes, record, tag, axis) for axis in ("East", "North", "Elevation")
        ]
        if name and any(v is not None for v in values):
            self.book.point(record.line, name, *map(known_or_nan, values), agree=False)

    def _point(self, record: Element) -> None:
        notes = self.book.notes
        name = notes.name(record.line, text_of(record, "Name"), "<Name> of a point")
        self._coordinates(record, name, "Grid")
        circle = first(record, "Circle")
        if circle is None or not name:
            return
        station = self._record(record, "StationRecord", "StationID")
        if station is None:
            if not text_of(record, "StationID"):
                notes.add(record.line, f"the sight to {name!r} has no <StationID>")
            return
        ident = text_of(record, "StationID")
        if ident != self.at:
            self.at = ident
            at = notes.name(station.line, text_of(station, "StationName"), "<StationName>")
            height = number_of(notes, station, "TheodoliteHeight")
            self.book.begin(station.line, at, height or 0.0)
        target = self._record(record, "TargetRecord", "TargetID")
        height = constant = None
        if target is not None:
            height = number_of(notes, target, "TargetHeight")
            constant = number_of(notes, target, "PrismConstant")
        face = text_of(circle, "Face")
        if face not in FACES:
            notes.add(
                circle.line, f"<Face> must be one of {known(filter(None, FACES))}, not {face!r}"
            )
        distance = number_of(notes, circle, "EDMDistance")
        if distance:
            distance = distance * (1.0 + self._ppm(station)) + (constant or 0.0)
        errors = [
            number_of(notes, circle, f"{part}StandardError", scale=scale) if use else None
            for part, scale, use in zip(
                ("HorizontalCircle", "VerticalCircle", "EDMDistance"),
                (DEG, DEG, 1.0),
                self.use_stated,
                strict=True,
            )
        ]
        self.book.sight(
            record.line,
            name,
            direction=number_of(notes, circle, "HorizontalCircle", scale=DEG),
            zenith=number_of(notes, circle, "VerticalCircle", scale=DEG),
            distance=distance or None,
            target_height=height or 0.0,
            face=FACES.get(face),
            stated=Stated(*(e if e is not None and e > 0 else None for e in errors)),
        )

    def _ppm(self, station: Element) -> float:
        """Return the correction of distances by the atmosphere, as a ratio."""
        air = self._record(station, "AtmosphereRecord", "AtmosphereID")
        if air is None or text_of(air, "ApplyPPMToRawDistances").lower() != "true":
            return 0.0
        return 1e-6 * (number_of(self.book.notes, air, "PPM") or 0.0)


def recognises_jobxml(path: Path) -> bool:
    """Return whether an XML file is JobXML."""
    return begins_with(path, b"JOBFile")

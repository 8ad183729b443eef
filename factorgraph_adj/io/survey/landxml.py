"""Reader of surveys in LandXML 1.2, and of Leica's HeXML, which is LandXML with more.

Schema: LandXML.org, LandXML-1.2, ``<Survey>``; Leica Geosystems, HeXML 1.x.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Literal

from ...errors import InputError, Problem, known
from ...network.network import Network
from ...units import GON
from ..left_out import ROWS_SWITCHED_OFF
from ..xml_tree import Element
from .accuracies import USUAL, Accuracies
from .book import FieldBook
from .xml_book import attribute, begins_with, first, root_of

LENGTHS = {
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "meter": 1.0,
    "kilometer": 1e3,
    "foot": 0.3048,
    "ussurveyfoot": 1200.0 / 3937.0,
    "inch": 0.0254,
    "mile": 1609.344,
}
"""Metres of ``linearUnit``."""
ANGLES = {"radians": 1.0, "grads": GON, "decimal degrees": math.pi / 180.0}
"""Radians of ``angularUnit``; ``decimal dd.mm.ss`` is packed."""
PACKED = "decimal dd.mm.ss"
OBSERVED = ("RawObservation", "ReducedObservation")
STATIONS = ("InstrumentSetup",)
NOT_READ = {
    "GPSVector": "GPS vectors are geocentric: use a reader of GNSS vectors",
    "LaserSetup": "scans are not read",
}


def read_landxml(
    path: str | Path,
    *,
    order: Literal["NE", "EN"] = "NE",
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = USUAL,
) -> Network:
    """Read the survey of a LandXML or HeXML file.

    Read are ``<Units>``, ``<CgPoint>`` (north first), ``<InstrumentSetup>`` with station, height
    and point, and each ``<RawObservation>`` with horizAngle, zenithAngle, slopeDistance or
    horizDistance, targetHeight, directFace and its ``<TargetPoint>``, within its set-up or in an
    ``<ObservationGroup>`` that names one. A target is named by ``name``, ``pntRef`` or ``desc``.
    Coordinates are approximate ones, held where ``fixed`` names the point; distances are corrected
    already. The circle reading of a ``<Backsight>`` counts as a direction where no raw observation
    of its set-up has the same target. What is marked ``status="deleted"`` is left out.

    Features, the elements that HeXML adds (``<HexagonLandXML>``: codes, classes and qualities of
    the same points and observations), and everything outside ``<Survey>`` and ``<CgPoints>``, such
    as surfaces and alignments, are not read; reduced observations and GPS vectors are refused.

    Args:
        path: the file.
        order: order of coordinates: NE, north first, as the schema says; some programs write EN.
        fixed: names of points that are held at the coordinates of the file; none: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    if order not in ("NE", "EN"):
        raise InputError(Problem(f"must be NE or EN, not {order!r}", "order"))
    source = Path(path)
    root = root_of(source, "LandXML")
    if root is None:
        raise InputError(Problem("is no LandXML: its root must be <LandXML>", f"{source.name}:1"))
    reader = _Reader(FieldBook(source, accuracies, fixed), order == "EN")
    reader.read(root)
    return reader.book.network()


class _Reader:
    def __init__(self, book: FieldBook, east_first: bool) -> None:
        self.book = book
        self.east_first = east_first
        self.length, self.angle = 1.0, "radians"
        self.setups: dict[str, Element] = {}
        self.backsights: dict[str, list[Element]] = {}
        self.raw: set[tuple[str, str]] = set()
        self.current: str | None = None

    def read(self, root: Element) -> None:
        """Read units, points, set-ups and observations."""
        self._units(root)
        extension = first(root, "HexagonLandXML")
        inside = set() if extension is None else {id(e) for e in extension.walk()}
        elements = [e for e in root.walk() if id(e) not in inside]
        for e in elements:
            if e.tag in ("CgPoint", *STATIONS) and _deleted(e):
                name = e.attributes.get("name") or e.attributes.get("stationName", "")
                self.book.notes.leave_out(e.line, ROWS_SWITCHED_OFF, name)
                continue
            if e.tag == "CgPoint":
                self._cg_point(e)
            elif e.tag in NOT_READ:
                self.book.notes.add(e.line, f"<{e.tag}> is not read: {NOT_READ[e.tag]}")
            elif e.tag in STATIONS:
                self._setup(e)
        surveys = [e for e in elements if e.tag == "Survey"]
        found = [(o, setup) for survey in surveys for o, setup in self._observations(survey)]
        self.raw = {(setup, self._target(o)) for o, setup in found}
        for o, setup in found:
            self._observation(o, setup)

    # -- units --------------------------------------------------------------------------------

    def _units(self, root: Element) -> None:
        units = first(root, "Units")
        children = [] if units is None else units.children
        if not children:
            self.book.notes.add(root.line, "has no <Units> with <Metric> or <Imperial>")
            return
        given = children[0].attributes
        linear = given.get("linearUnit", "meter").lower()
        self.angle = given.get("angularUnit", "radians").lower()
        if linear not in LENGTHS:
            what = f"linearUnit {linear!r}; valid: {known(LENGTHS, meant=linear)}"
            self.book.notes.add(children[0].line, what)
        if self.angle not in (*ANGLES, PACKED):
            what = (
                f"angularUnit {self.angle!r}; valid: {known([*ANGLES, PACKED], meant=self.angle)}"
            )
            self.book.notes.add(children[0].line, what)
        self.length = LENGTHS.get(linear, 1.0)

    def _angle(self, e: Element, name: str) -> float | None:
        if self.angle != PACKED:
            return attribute(self.book.notes, e, name, ANGLES.get(self.angle, 1.0))
        text = e.attributes.get(name, "")
        if not text:
            return None
        match = re.fullmatch(r"(\d+)(?:\.(\d*))?", text, re.ASCII)
        digits = (match[2] or "").ljust(4, "0") if match else ""
        if match is None or len(text) > 40 or int(digits[:2]) >= 60 or int(digits[2:4]) >= 60:
            what = f"{name} must be packed as dd.mmss, not {text[:40]!r}"
            self.book.notes.add(e.line, what)
            return math.nan
        seconds = float(f"{digits[2:4]}.{digits[4:] or 0}")
        return math.radians(int(match[1]) % 1000 + int(digits[:2]) / 60 + seconds / 3600)

    # -- points ---------------------------------------------------------------------------------

    def _cg_point(self, e: Element) -> None:
        name = e.attributes.get("name") or e.attributes.get("oID", "")
        if not name and (e.attributes.get("pntRef") or not e.text.strip()):
            return
        self._coordinates(e, self.book.notes.name(e.line, name, "name of a <CgPoint>"))

    def _coordinates(self, e: Element, name: str) -> None:
        """Note a point with the coordinates in the text of an element, north first."""
        words = e.text.split()
        if not words or not name:
            return
        if len(words) not in (2, 3):
            what = f"<{e.tag}> needs north, east and elevation, not {len(words)} numbers"
            self.book.notes.add(e.line, what)
            return
        a, b, *up = (self.book.notes.finite(e.line, w, "coordinate", self.length) for w in words)
        east, north = (a, b) if self.east_first else (b, a)
        self.book.point(e.line, name, east, north, *up, agree=False)

    def _setup(self, e: Element) -> None:
        ident = e.attributes.get("id", "")
        if ident in self.setups:
            self.book.notes.add(
                e.line, f"id {ident!r} of two set-ups; first in line {self.setups[ident].line}"
            )
            return
        name = self.book.notes.name(e.line, e.attributes.get("stationName", ""), "stationName")
        self.setups[ident] = e
        point = first(e, "InstrumentPoint")
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
                observed = o.tag in ("RawObservation", "Backsight", "ReducedObservation")
                if observed and (gone or _deleted(o)):
                    setup = o.attributes.get("setupID") or group
                    station = self.setups.get(setup)
                    at = setup if station is None else station.attributes.get("stationName", "")
                    why = ROWS_SWITCHED_OFF
                    self.book.notes.leave_out(o.line, why, f"{at} {self._target(o)}".strip())
                    continue
                if o.tag == "ReducedObservation":
                    self.book.notes.add(
                        o.line, "<ReducedObservation> is not read: give the raw one"
                    )
                elif o.tag == "RawObservation":
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

    def _backsight(self, e: Element, setup: str) -> None:
        """Note the circle reading of a backsight that no raw observation repeats."""
        name = self._target(e)
        if name and (setup, name) not in self.raw and e.attributes.get("circle"):
            self.book.sight(e.line, name, direction=self._angle(e, "circle"), face=1)

    def _observation(self, o: Element, setup: str) -> None:
        notes = self.book.notes
        at = self.setups.get(setup)
        if at is None:
            what = f"the observation needs setupID; {setup!r} is none of {known(self.setups)}"
            notes.add(o.line, what)
            return
        if self.current != setup:
            self.current = setup
            height = attribute(notes, at, "instrumentHeight", self.length)
            station = at.attributes.get("stationName", "").strip()
            if not station:
                return
            self.book.begin(at.line, station, height or 0.0)
            for e in self.backsights.pop(setup, []):
                self._backsight(e, setup)
        target = first(o, "TargetPoint")
        name = notes.name(o.line, self._target(o), "name of the <TargetPoint>")
        if target is not None:
            self._coordinates(target, name)
        face = o.attributes.get("directFace", "").lower()
        if face not in ("", "true", "false", "1", "0"):
            notes.add(o.line, f"directFace must be true or false, not {face!r}")
        self.book.sight(
            o.line,
            name,
            direction=self._angle(o, "horizAngle"),
            zenith=(zenith := self._angle(o, "zenithAngle")),
            distance=attribute(notes, o, "slopeDistance", self.length) or None,
            horizontal=attribute(notes, o, "horizDistance", self.length) or None,
            target_height=attribute(notes, o, "targetHeight", self.length) or 0.0,
            # Where the zenith reading tells the face, writers do not agree on directFace.
            face=None if zenith is not None or not face else 1 if face in ("true", "1") else 2,
        )


def _deleted(e: Element) -> bool:
    return e.attributes.get("status", "").lower() == "deleted"


def recognises_landxml(path: Path) -> bool:
    """Return whether an XML file is LandXML or HeXML."""
    return begins_with(path, b"LandXML")

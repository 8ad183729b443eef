"""Reader of Sokkia's field books: SDR33 and SDR2x.

Records of fixed width: Sokkia Technology, "Interfacing with the SOKKIA SDR Electronic Field Book",
1999, chapter 3. A record has a type of two digits, a derivation code of two characters, and fields:
names of 16 characters and numbers of 16 (SDR33), or of 4 and 10 (SDR2x).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path

from ...errors import known
from ...network.network import Network
from ...units import GON
from ..file_problems import DERIVED_OBSERVATIONS, ROWS_SWITCHED_OFF
from ..text_files import read_text
from .field_book import DEFAULT_ACCURACIES, Accuracies, FieldBook

FEET_US, FEET = 1200.0 / 3937.0, 0.3048
SDR_ANGLES = {"1": math.radians(1.0), "2": GON, "4": math.pi / 3200}
SDR_LENGTHS = {"1": 1.0, "2": FEET, "3": FEET_US}
UNREAD_RECORDS = {
    "05": "atmosphere, which is in the distances",
    "06": "scale factor, which raw distances do not have",
    "07": "backsight; its readings stand in records 09",
    "10": "job",
    "11": "reduced observation, derived from 09",
    "13": "note",
}
"""Records that are not read, and why none is needed."""
SDR_HEADER_PATTERN = re.compile(r"00..(SDR\s?\S+).*?([0-9]{6})\s*", re.ASCII)


def read_sdr33(
    path: str | Path,
    *,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of Sokkia, SDR33 or SDR2x.

    Read are stations (02), heights of targets (03), coordinates (08), observations (09 F1, F2, MD)
    and the units of the header; the instrument (01) tells whether vertical readings begin at the
    zenith. Coordinates of points are approximate ones, held where ``fixed`` names them; of several
    the first ones count. Prism constant and atmosphere are in the distances. Not needed and not
    read: atmosphere, scale, backsight, job, reduced and corrected observations (05, 06, 07, 10, 11,
    09 MC), notes (13) and deleted records, which begin with DD; 04 with corrections other than 0,
    sets (12) and all other records are refused.

    Args:
        path: the file.
        fixed: names of points that are held at the coordinates of the file; none: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = Path(path)
    reader = _Reader(FieldBook(source, accuracies, fixed))
    for number, line in enumerate(read_text(source).split("\n"), start=1):
        reader.read(number, line.lstrip("\x02\x03").rstrip("\x03\x1a\x00"))
    return reader.book.network()


class _Reader:
    def __init__(self, book: FieldBook) -> None:
        self.book = book
        self.name, self.real = 16, 16
        self.angle, self.length = GON, 1.0
        self.east_first = False
        self.header = False
        self.zenith = True
        self.target_height = 0.0

    def read(self, line: int, text: str) -> None:
        """Read a record."""
        code, notes = text[:2], self.book.notes
        if not text.strip() or re.fullmatch(r"\d{1,6}\s*", text):
            return  # a check sum stands alone at the end
        if code == "DD":
            notes.leave_out(line, ROWS_SWITCHED_OFF, text[:40].strip())
            return
        if code == "00":
            self._header(line, text)
        elif not self.header:
            notes.add(line, "a record before the header, which begins with 00NMSDR33 or 00NMSDR2")
            self.header = True
        elif code == "01":
            self._instrument(line, text)
        elif code == "02":
            self._station(line, text)
        elif code == "03":
            (height,) = self._fields(line, text, "r")
            self.target_height = self._number(line, height, "target height", self.length) or 0.0
        elif code == "04":
            self._collimation(line, text)
        elif code == "08":
            name, a, b, up = self._fields(line, text, "nrrr")
            self._coordinates(line, name, a, b, up)
        elif code == "09":
            self._observation(line, text)
        elif code == "13" and text[2:4] == "DU":
            notes.add(line, "unit of length in a note (13DU) is not read: correct the header")
        elif code == "12":
            notes.add(
                line,
                "sets (12) are not read: take the record out, and its observations if "
                "the set is marked bad",
            )
        elif code == "11":
            notes.leave_out(line, DERIVED_OBSERVATIONS, "11")
        elif code not in UNREAD_RECORDS:
            valid = known(["00", "01", "02", "03", "04", "08", "09", *UNREAD_RECORDS], most=20)
            notes.add(line, f"record {text[:4]!r} is not known; valid: {valid}")

    def _fields(self, line: int, text: str, form: str) -> list[str]:
        """Return fields after the derivation code: names (n) and numbers (r)."""
        out, at = [], 4
        for f in form:
            size = self.name if f == "n" else self.real
            out.append(text[at : at + size].strip())
            at += size
        if form[0] == "n" and not out[0]:
            self.book.notes.add(line, f"record {text[:4]} names no point")
        return out

    def _number(self, line: int, text: str, what: str, scale: float) -> float | None:
        """Return a number; None for an empty field, which was not measured."""
        return self.book.notes.finite(line, text, what, scale) if text else None

    def _header(self, line: int, text: str) -> None:
        notes, match = self.book.notes, SDR_HEADER_PATTERN.fullmatch(text)
        self.header = True
        if match is None or not match[1].replace(" ", "").startswith(("SDR33", "SDR2")):
            what = "the header must be 00, a code, SDR33 or SDR2x and six options, such as "
            notes.add(line, f"{what}00NMSDR33 V04-04.02     01-Jan-04 16:26 211111")
            return
        if match[1].replace(" ", "").startswith("SDR2"):
            self.name, self.real = 4, 10
        angle, length, _, _, order, sense = list(match[2])
        if angle not in SDR_ANGLES:
            notes.add(line, f"option 1, angles, is {angle}; valid: 1 degrees, 2 gon, 4 mil")
        if length not in SDR_LENGTHS:
            notes.add(line, f"option 2, distances, is {length}; valid: 1 metres, 2 feet, 3 US feet")
        if order not in "123":
            notes.add(
                line, f"option 5, coordinates, is {order}; valid: 1 north first, 2 east first"
            )
        if sense != "1":
            notes.add(line, f"option 6, angles, is {sense}; valid: 1, clockwise")
        self.angle, self.length = SDR_ANGLES.get(angle, GON), SDR_LENGTHS.get(length, 1.0)
        self.east_first = order in "23"

    def _instrument(self, line: int, text: str) -> None:
        option = text[50:51]
        if option not in ("1", "2", " ", ""):
            what = f"vertical angles of the instrument are {option!r}; valid: 1 zenith, 2 horizon"
            self.book.notes.add(line, what)
        self.zenith = option != "2"

    def _station(self, line: int, text: str) -> None:
        name, a, b, up, height = self._fields(line, text, "nrrrr")
        self._coordinates(line, name, a, b, up)
        value = self._number(line, height, "height of the instrument", self.length)
        self.book.begin(line, name, value or 0.0)

    def _coordinates(self, line: int, name: str, a: str, b: str, up: str) -> None:
        values = [self._number(line, t, "coordinate", self.length) for t in (a, b, up)]
        first, second, height = (math.nan if v is None else v for v in values)
        east, north = (first, second) if self.east_first else (second, first)
        checked = self.book.notes.name(line, name, "the point") if name else ""
        self.book.point(line, checked, east, north, height, agree=False)

    def _collimation(self, line: int, text: str) -> None:
        for field in self._fields(line, text, "rr"):
            if self._number(line, field, "collimation", 1.0):
                what = "corrections of collimation other than 0 are not applied: read both faces"
                self.book.notes.add(line, what)

    def _observation(self, line: int, text: str) -> None:
        notes, book = self.book.notes, self.book
        code = text[2:4]
        if code == "MC":
            notes.leave_out(line, DERIVED_OBSERVATIONS, "MC")
            return
        if code not in ("F1", "F2", "MD"):
            notes.add(line, f"observation 09{code}; valid: F1, F2, MD and MC, which is derived")
            return
        station, target, slope, vertical, horizontal = self._fields(line, text, "nnrrr")
        if book.current is None or book.current.station != station:
            at = "before any station" if book.current is None else f"at {book.current.station!r}"
            notes.add(line, f"observation from {station!r} {at}: record 02 is missing")
            return
        zenith = self._number(line, vertical, "vertical reading", self.angle)
        if zenith is not None and not self.zenith:
            zenith = (math.pi / 2 - zenith) % (2 * math.pi)
        book.sight(
            line,
            notes.name(line, target, "the target"),
            direction=self._number(line, horizontal, "horizontal reading", self.angle),
            zenith=zenith,
            distance=self._number(line, slope, "slope distance", self.length) or None,
            target_height=self.target_height,
            face={"F1": 1, "F2": 2}.get(code),
        )

"""Reader of field books of Geodimeter and of Trimble 3600, 5600 and S6: JOB and ARE files.

A line is a label, ``=`` and its value: ``7=92.4486``. The labels: list of codes of GeoEasy
(``geo_easy.eng``, ``geodimet.tcl``), and Total Open Station (``trimble_are.py``).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...network.network import Network
from ...units import ANGLE, FOOT, GON
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader
from ..numbers import PACKED_DEGREES
from ..source import DERIVED_OBSERVATIONS, TextSource
from ..text_files import file_beginning
from .accuracies import DEFAULT_ACCURACIES, Accuracies
from .field_book import FieldBook
from .field_records import RecordField, Scales, read_angle, read_length

GEODIMETER_LENGTHS = {"m": 1.0, "ft": FOOT}
GEODIMETER_ANGLES: dict[str, float | str] = {
    "gon": GON,
    "deg": ANGLE["deg"],
    "dms": PACKED_DEGREES,
}
UNITS_OF_LABEL_23 = re.compile(r"[0-9]{2}(?P<length>[0-9])(?P<angle>[0-9])", re.ASCII)
"""Label 23: two digits that are not needed, unit of lengths, unit of angles."""
KNOWN_UNITS = {("length", "1"): "m", ("angle", "2"): "dms"}
"""Units by digit of label 23, as far as sources state them."""
READ_LABELS = {
    f.key: f
    for f in (
        RecordField("height", "height of the instrument (3)", read_length, "3"),
        RecordField("target_height", "signal height (6)", read_length, "6"),
        RecordField("direction", "horizontal angle (7)", read_angle, "7"),
        RecordField("zenith", "vertical angle (8)", read_angle, "8"),
        RecordField("distance", "slope distance (9)", read_length, "9"),
        RecordField("difference", "height difference (10)", read_length, "10"),
        RecordField("horizontal", "horizontal distance (11)", read_length, "11"),
        RecordField("direction_2", "horizontal angle in face II (17)", read_angle, "17"),
        RecordField("zenith_2", "vertical angle in face II (18)", read_angle, "18"),
        RecordField("circle", "circle of the reference object (21)", read_angle, "21"),
        RecordField("direction_1", "horizontal angle in face I (24)", read_angle, "24"),
        RecordField("zenith_1", "vertical angle in face I (25)", read_angle, "25"),
        RecordField("north", "northing (37)", read_length, "37"),
        RecordField("east", "easting (38)", read_length, "38"),
        RecordField("up", "elevation (39)", read_length, "39"),
        RecordField("vertical", "vertical distance (49)", read_length, "49"),
    )
}
"""Labels that are read."""
BEGINNINGS = {"2": "station", "5": "point", "62": "reference object"}
"""Labels that begin a block."""
UNREAD_LABELS = {
    *("0", "1", "4", "15", "20", "22", "30", "46", "78", "110", "111"),
    *(str(n) for n in (*range(50, 62), 74)),
}
"""Labels that are not needed: information, codes, area, constant and ppm of distances, which are in
them, compensator, standard deviations, job, date, hour, persons, instrument, atmosphere."""
ANGLE_LABELS = {key for key, of in READ_LABELS.items() if of.read is read_angle}
DECIMALS = re.compile(r"(?P<whole>[0-9]{1,3})(?:\.(?P<decimals>[0-9]*))?", re.ASCII)
MIN_PACKED_READINGS = 20
"""Number of readings by which decimals are minutes and seconds."""
LINE = re.compile(r"\s*(?P<label>[0-9]{1,3})\s*=(?P<text>.*)", re.ASCII)


def read_geodimeter(
    path: str | Path,
    *,
    coordinates: str | Path | None = None,
    angle_unit: str | None = None,
    length_unit: str | None = None,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of Geodimeter or Trimble, a JOB or ARE file.

    A set-up begins with label 2, a target with 5, a reference object with 62; heights of the
    instrument (3) belong to the last station, signal heights (6) hold for the targets that follow
    in the set-up. Read are directions (7, or 24 and 17 in the faces I and II), zenith readings (8,
    or 25 and 18), slope distances (9), horizontal distances (11) where there is none, the circle
    reading of the reference object (21), and coordinates (37, 38, 39), which are approximate ones:
    the first ones of a point count, held where ``fixed`` names it. 7 and 8 beside 24 and 25 are
    means, 10 and 49 are derived, and not used.

    The coordinates of a survey in a JOB file may stand in an ARE file of the same name beside it,
    which is read, too, as a remark of the network says.

    Label 23 states the units: metres (third digit 1) and degrees D.MMSS (fourth digit 2). Other
    digits need ``angle_unit``, and so do files without it, unless their readings show the unit, see
    `angle_unit_of_readings`, which a remark of the network says; lengths are metres unless
    ``length_unit`` says otherwise, which a remark states.

    Tried on two surveys of GeoEasy (DT, ullo) and on one of Total Open Station with the coordinates
    of each target, which come out to 1 mm. Not read: GDT files of a Geodat 124, which have several
    labels in a line.

    Args:
        path: the file.
        coordinates: file of coordinates; default: the ARE file beside a JOB file, if there is one.
        angle_unit: unit of angles of a file that does not state it: gon, deg or dms (D.MMSS).
        length_unit: unit of lengths of a file that does not state it: m or ft.
        fixed: names of points that are held at the coordinates of the files; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the files, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    book = FieldBook(source, accuracies, fixed)
    units = LabelUnits(source, length_unit, angle_unit)
    reader = _Reader(book)
    for block in _blocks(source, units):
        reader.read(block)
    beside = _file_beside(source, coordinates, has_readings=reader.has_readings)
    if beside is not None:
        other = TextSource(beside, source.problems, code_page="cp1252")
        # The book gives places in its own file: problems of coordinates have the other's.
        units.source = reader.source = other
        n = sum(reader.take_coordinates(block) for block in _blocks(other, units))
        points = "1 point is" if n == 1 else f"{n} points are"
        source.problems.remarks.append(f"coordinates of {points} read from {other.path.name}")
    units.add_remark()
    return book.network()


def _file_beside(
    source: TextSource, stated: str | Path | None, *, has_readings: bool
) -> Path | None:
    """Return the file of coordinates: the stated one, or the ARE file beside a JOB file."""
    path = source.path
    if stated is not None:
        return Path(stated)
    if path.suffix.lower() == ".are":
        job = [s for s in (".job", ".JOB") if path.with_suffix(s).is_file()]
        if job and not has_readings:
            what = f"{path.name} has coordinates alone; the readings are in "
            source.problems.remarks.append(f"{what}{path.with_suffix(job[0]).name}")
        return None
    return next((f for s in (".are", ".ARE") if (f := path.with_suffix(s)).is_file()), None)


# -- lines ----------------------------------------------------------------------------------------


class LabelUnits:
    """Units of a file, which label 23 states, or options."""

    def __init__(self, source: TextSource, length: str | None, angle: str | None) -> None:
        """Take the units that options state."""
        self.source = source
        self.units = {"length": length, "angle": angle}
        self.stated: set[str] = set()
        """Units that label 23 has stated."""
        self.asked: set[str] = set()
        self.has_lengths = False
        self.name = source.path.name
        for sort, valid in (("length", GEODIMETER_LENGTHS), ("angle", GEODIMETER_ANGLES)):
            if self.units[sort] is not None:
                source.field(1, str(self.units[sort]), f"{sort}_unit").choice({**valid})

    def take(self, line: int, text: str) -> None:
        """Take label 23."""
        found = UNITS_OF_LABEL_23.fullmatch(text.strip())
        if found is None:
            self.source.wrong(line, f"units (23) must be four digits, such as 2112, not {text!r}")
            return
        for sort in ("length", "angle"):
            unit, digit = KNOWN_UNITS.get((sort, found[sort])), found[sort]
            option = self.units[sort]
            if unit is None and option is None:
                place = "third" if sort == "length" else "fourth"
                what = f"the unit of {sort}s is not known by the {place} digit {digit} of label 23"
                self.source.wrong(line, f"{what}: give {self._option(sort)}")
            elif unit is not None and option not in (None, unit):
                what = f"label 23 states the unit {unit}, the option {sort}_unit {option}"
                self.source.wrong(line, what)
            self.units[sort] = unit or option
            self.stated.add(sort)

    @staticmethod
    def _option(sort: str) -> str:
        example, other = ("gon", "dms or deg") if sort == "angle" else ("ft", "m")
        return f"{option_text(f'{sort}_unit', example)}, or {other}"

    def value(self, line: int, of: RecordField, text: str) -> float | None:
        """Return the value of a label, SI units; NaN after a problem."""
        cell = self.source.field(line, text, of.what)
        if cell.is_absent:
            cell.number()
            return None
        if of.read is read_length:
            self.has_lengths = True
            unit = GEODIMETER_LENGTHS.get(self.units["length"] or "m", 1.0)
            return read_length(cell, Scales(length=unit))
        name = self.units["angle"]
        if name is None and "angle" not in self.stated:
            name = self._take_angle_unit_of_readings()
        if name is None and "angle" not in self.stated:
            if not self.asked:
                what = "the file states no unit of angles (label 23): give "
                self.source.wrong(line, what + self._option("angle"))
                self.asked.add("angle")
            return None
        return read_angle(cell, Scales(angle=GEODIMETER_ANGLES.get(name or "", GON)))

    def _take_angle_unit_of_readings(self) -> str | None:
        """Take the unit of angles that the readings of the book show, and say why; once."""
        if self.asked:
            return None
        unit, why = angle_unit_of_readings(self.source)
        if unit:
            self.units["angle"] = unit
            what = f"{self.name} states no unit of angles: they are read as {unit}, as {why}; "
            say = f"{option_text('angle_unit', 'UNIT')} says another"
            self.source.problems.remarks.append(what + say)
        return unit or None

    def add_remark(self) -> None:
        """Say that lengths without a unit were read as metres."""
        if self.has_lengths and "length" not in self.stated and self.units["length"] is None:
            what = f"{self.name} states no unit: lengths are read as metres; "
            say = f"{option_text('length_unit', 'ft')} says feet"
            self.source.problems.remarks.append(what + say)


def angle_unit_of_readings(source: TextSource) -> tuple[str, str]:
    """Return the unit of angles that the readings of a book show, and why; '' twice: none.

    A reading beyond 360 is in gon. Readings in both faces differ by half a circle, 180° or 200 gon;
    degrees whose decimals are minutes and seconds below 60 without an exception are D.MMSS: of
    decimal degrees, 36 % of the readings have such decimals, and of 20 readings all by a chance of
    10⁻⁹.
    """
    values: list[str] = []
    halves: list[float] = []
    first: float | None = None
    for _, text in source.filled():
        found = LINE.fullmatch(text)
        label = "" if found is None else found["label"].lstrip("0")
        if found is None or label not in ANGLE_LABELS:
            first = None if label in BEGINNINGS else first
            continue
        value = DECIMALS.fullmatch(found["text"].strip())
        if value is None:
            continue
        values.append((value["decimals"] or "").ljust(4, "0"))
        number = int(value["whole"])
        if number >= 360:
            return "gon", f"{found['text'].strip()} is beyond 360"
        if label in ("7", "17", "24"):
            halves += [] if first is None else [abs(number - first)]
            first = number
    turned = {half: [abs(d - half) <= 1 for d in halves] for half in (180, 200)}
    if halves and all(turned[200]):
        return "gon", "readings in two faces differ by 200"
    if not halves or not all(turned[180]):
        return "", ""
    if any(d[:2] >= "60" or d[2:4] >= "60" for d in values):
        return "deg", "readings in two faces differ by 180, and decimals are no minutes and seconds"
    if len(values) >= MIN_PACKED_READINGS:
        return "dms", "readings in two faces differ by 180, and decimals are minutes and seconds"
    return "", ""


@dataclass
class LabelBlock:
    """A station, a target or a reference object with the labels behind it."""

    line: int
    label: str
    name: str
    values: dict[str, Any] = field(default_factory=dict)
    """Values by the names of `READ_LABELS`."""
    lines: dict[str, int] = field(default_factory=dict)


def _blocks(source: TextSource, units: LabelUnits) -> Iterator[LabelBlock]:
    """Yield the blocks of a file; labels before the first one are no values."""
    block: LabelBlock | None = None
    for line, text in source.filled():
        found = LINE.fullmatch(text)
        if found is None:
            what = f"{text.strip()[:40]!r} must be a label, '=' and its value, such as 5=101"
            source.wrong(line, what)
            continue
        label, value = found["label"].lstrip("0") or "0", found["text"].strip()
        if label in BEGINNINGS:
            if block is not None:
                yield block
            block = LabelBlock(line, label, source.field(line, value, BEGINNINGS[label]).name())
        elif label == "23":
            units.take(line, value)
        elif label in READ_LABELS:
            of = READ_LABELS[label]
            if block is None:
                source.wrong(line, f"{of.what} before any station or point")
            elif of.name in block.values:
                source.wrong(line, f"{of.what} stands twice for {block.name!r}")
            else:
                block.values[of.name] = units.value(line, of, value)
                block.lines[of.name] = line
        elif label not in UNREAD_LABELS:
            valid = {*BEGINNINGS, *READ_LABELS, *UNREAD_LABELS, "23"}
            source.field(line, label, "label").word(sorted(valid, key=int))
    if block is not None:
        yield block


# -- blocks ---------------------------------------------------------------------------------------


class _Reader:
    """State of the field book between its blocks."""

    def __init__(self, book: FieldBook) -> None:
        self.book = book
        self.source = book.source
        self.target_height: float | None = None
        self.has_readings = False

    def take_coordinates(self, block: LabelBlock) -> bool:
        """Note the coordinates of a block; return whether it has any."""
        given = [block.values.get(axis) for axis in ("east", "north", "up")]
        if given == [None, None, None]:
            return False
        self.book.point(block.line, block.name, *given, agree=False)
        return True

    def read(self, block: LabelBlock) -> None:
        """Note a block."""
        self.take_coordinates(block)
        of = block.values
        if block.label == "2":
            self.book.begin(block.line, block.name, of.get("height"))
            self.target_height = None
        elif of.get("height") is not None:
            self.book.set_height(block.lines["height"], of["height"])
        self.target_height = of.get("target_height", self.target_height)
        if of.get("circle") is not None and block.label != "2":
            self.book.backsight(block.lines["circle"], block.name, of["circle"])
        self._sights(block)

    def _sights(self, block: LabelBlock) -> None:
        """Note the readings of a target in both faces."""
        of = block.values
        for mean, reading in (("direction", "direction_1"), ("zenith", "zenith_1")):
            if of.get(mean) is not None and of.get(reading) is not None:
                self.source.leave_out(block.lines[mean], DERIVED_OBSERVATIONS, block.name)
                del of[mean]
        for name in ("difference", "vertical"):
            if of.get(name) is not None:
                self.source.leave_out(block.lines[name], DERIVED_OBSERVATIONS, block.name)
        first: dict[str, Any] = {
            "direction": of.get("direction_1", of.get("direction")),
            "zenith": of.get("zenith_1", of.get("zenith")),
            "distance": of.get("distance") or None,
            "horizontal": of.get("horizontal") or None,
        }
        second: dict[str, Any] = {"direction": of.get("direction_2"), "zenith": of.get("zenith_2")}
        stated = None if second["direction"] is None and second["zenith"] is None else 1
        faces: tuple[tuple[int | None, dict[str, Any]], ...] = ((stated, first), (2, second))
        for face, values in faces:
            if any(v is not None for v in values.values()):
                self.has_readings = True
                self.book.sight(
                    block.line, block.name, **values, target_height=self.target_height, face=face
                )


def _is_geodimeter(path: Path) -> bool:
    """Return whether the first lines are labels with values, with a station or a point."""
    lines = file_beginning(path).decode("latin-1").replace("\r", "\n").split("\n")[:-1]
    found = [LINE.fullmatch(line) for line in lines if line.strip()][:40]
    labels = [m["label"].lstrip("0") for m in found if m is not None]
    begun = any(b in labels for b in BEGINNINGS)
    return len(labels) == len(found) > 1 and begun and bool({*labels} & {*READ_LABELS})


READER = Reader(
    "geodimeter",
    (".job", ".are"),
    "Geodimeter or Trimble JOB, ARE",
    NetworkReader(read_geodimeter),
    recognises=_is_geodimeter,
)

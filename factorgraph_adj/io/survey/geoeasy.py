"""Reader of GeoEasy: field book `.geo`, coordinates `.coo` and parameters `.par` beside it.

A line is a list of Tcl whose elements are pairs of code and value, in any order; the codes are
those of Geodimeter. Grammar: GeoEasy's reader (src/loadgeo.tcl), its table of codes
(src/i18n/geo_easy.eng) and the files of its tutorial.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from ...errors import InputError
from ...network.network import Network
from ...observations import HeightDifference
from ...units import ANGLE, LENGTH
from ..field_books.accuracies import DEFAULT_ACCURACIES, Accuracies
from ..field_books.field_book import FieldBook
from ..field_books.field_records import (
    RecordField,
    Scales,
    read_length,
    read_name,
    read_number,
    read_record,
)
from ..field_books.plane_readings import NOT_IN_PLAN, plane_readings
from ..format_reader import NetworkReader, Reader
from ..source import (
    DERIVED_OBSERVATIONS,
    ROWS_SWITCHED_OFF,
    Field,
    Problems,
    TextSource,
)
from ..text_files import file_beginning

GEOEASY_CODE_PAGE = "cp1250"
DMS_PATTERN = re.compile(r"-?\d+(-\d+){1,2}(\.\d*)?")


def read_geoeasy_angle(field: Field, scales: Scales) -> float:
    """Return an angle: radians, or degrees, minutes and seconds with hyphens."""
    is_dms = isinstance(field.value, str) and DMS_PATTERN.fullmatch(field.value) is not None
    return field.number("dms" if is_dms else "")


STATION_FIELDS = (
    RecordField("station", "station (2)", read_name, "2"),
    RecordField("height", "height of the instrument (3)", read_length, "3"),
)
SIGHT_FIELDS = (
    RecordField("target", "target (5)", read_name, "5"),
    RecordField("target_height", "target height (6)", read_length, "6"),
    RecordField("direction", "direction (7)", read_geoeasy_angle, "7"),
    RecordField("reference", "direction to a reference (21)", read_geoeasy_angle, "21"),
    RecordField("zenith", "zenith angle (8)", read_geoeasy_angle, "8"),
    RecordField("distance", "slope distance (9)", read_length, "9"),
    RecordField("horizontal", "horizontal distance (11)", read_length, "11"),
    RecordField("difference", "height difference (10)", read_length, "10"),
    RecordField("levelled", "levelled height difference (120)", read_length, "120"),
    RecordField("offset", "constant of the slope distance (20)", read_length, "20"),
)
COORDINATE_FIELDS = (
    RecordField("point", "point (5)", read_name, "5"),
    RecordField("station", "point (2)", read_name, "2"),
    *(
        RecordField(f"{axis}{which}", f"{what} ({code})", read_length, str(code))
        for which, first in (("", 37), ("_preliminary", 137))
        for code, axis, what in (
            (first, "north", "northing"),
            (first + 1, "east", "easting"),
            (first + 2, "up", "height"),
        )
    ),
)
PARAMETER_FIELDS = tuple(
    RecordField(name, f"{what} ({code})", read_number, code)
    for name, what, code in (
        ("direction", "σ of a direction, ″", "114"),
        ("distance", "σ of a distance, mm", "115"),
        ("ppm", "σ of a distance, ppm", "116"),
        ("levelling", "σ of a levelled kilometre, mm", "118"),
    )
)
READINGS_SWITCHED_OFF = ("-7", "-8", "-9", "-10", "-11", "-21", "-120")
"""Codes of readings that are not used."""
UNREAD_RANGES = ((0, 1), (4, 4), (12, 13), (15, 19), (22, 30), (43, 83), (100, 103), (110, 112),
                 (117, 117), (140, 140), (237, 239))  # fmt: skip
UNREAD_CODES = tuple(str(code) for a, b in UNREAD_RANGES for code in range(a, b + 1))
"""Codes of remarks, date, weather, figures, circle readings of which 7 and 8 are the means,
orientations, number of repetitions, order, standard deviations of results."""
_ELEMENT = re.compile(r'\{|"((?:[^"\\]|\\.)*)"(?=\s|$)|((?:[^\s{}"\\]|\\.)(?:[^\s\\]|\\.)*)')
_RECOGNISED = re.compile(
    rb"\s*(?:\{-?\d{1,3} (?:\{[^{}\n]*\}|[^{}\n]*)\}[ \t]*)*"
    rb"\{[25] (?:\{[^{}\n]*\}|[^{}\n]+)\}[ \t]*"
    rb"(?:\{-?\d{1,3} (?:\{[^{}\n]*\}|[^{}\n]*)\}[ \t]*)*(?:\r?\n|$)"
)
"""A line of pairs of code and value, of which one names a point."""


def tcl_list(text: str) -> list[str] | None:
    """Return the elements of a list of Tcl; None if the text is none.

    >>> tcl_list("{5 {Kis Janos}} {7 0.5}")
    ['5 {Kis Janos}', '7 0.5']
    """
    out: list[str] = []
    at = 0
    while True:
        while at < len(text) and text[at].isspace():
            at += 1
        if at == len(text):
            return out
        match = _ELEMENT.match(text, at)
        if match is None:
            return None
        if match[0] != "{":
            out.append(re.sub(r"\\(.)", r"\1", match[1] if match[1] is not None else match[2]))
            at = match.end()
            continue
        depth, end = 1, at + 1
        while end < len(text) and depth:
            depth += {"{": 1, "}": -1}.get(text[end], 0)
            end += 1
        if depth or (end < len(text) and not text[end].isspace()):
            return None
        out.append(text[at + 1 : end - 1])
        at = end


def read_geoeasy(
    path: str | Path,
    *,
    fixed: str | Iterable[str] = (),
    dimension: Literal[2, 3] = 3,
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of GeoEasy with its coordinates, or coordinates alone.

    Read are stations (2, 3), targets (5, 6), directions (7, 21), zenith angles (8), slope and
    horizontal distances (9, 11; a slope distance counts before a horizontal one) and levelled
    height differences (120, of which 11 is the length of the line), in radians or degrees with
    hyphens, and metres; from `.coo` eastings, northings and heights (38, 37, 39) and preliminary
    ones (138, 137, 139), all approximate, held where ``fixed`` names them; from `.par` the standard
    deviations (114, 115, 116, 118; the last for each kilometre of a line, as GeoEasy has it), which
    count where `accuracies` states none. A `.geo` is read
    with the `.coo` and `.par` beside it; a `.coo` is a list of points. Left out and counted are
    readings that are not used (−7 to −120) and height differences (10) beside zenith angles. Not
    read: remarks, codes of points, date, weather, figures, orientations, numbers of repetitions,
    standard deviations of coordinates; refused: height differences (10) without zenith angles,
    constants of slope distances (20) other than 0, unknown codes.

    Tried on the files of GeoEasy's tutorial.

    Args:
        path: the file, `.geo` or `.coo`.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        dimension: 2: a plane network, whose slope distances are reduced by their zenith angles.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the files, each with its line.
    """
    if dimension not in (2, 3):
        raise InputError(f"dimension must be 2 (plane) or 3, not {dimension!r}")
    source = TextSource(path, code_page=GEOEASY_CODE_PAGE)
    beside = source.path.suffix.lower() != ".coo"
    mm_per_km = None
    if beside:
        accuracies, mm_per_km = _stated_accuracies(source.path, accuracies, source.problems)
    book = FieldBook(source, accuracies, fixed)
    if beside and not any(True for _ in source.filled()):
        what = "is empty: it has no stations and sights"
        source.wrong(0, f"{what}; coordinates alone are read from its .coo")
    if beside:
        for line, pairs in _records(source):
            _field_record(book, line, pairs, mm_per_km, in_plan=dimension == 2)
    coordinates = _beside(source.path, ".coo", source.problems) if beside else source
    if coordinates is not None:
        book.source = coordinates
        for line, pairs in _records(coordinates):
            _coordinates(book, line, pairs)
        book.source = source
    return book.network()


def _beside(path: Path, suffix: str, problems: Problems) -> TextSource | None:
    """Return a file with the same stem and another suffix; None where there is none."""
    for found in (path.with_suffix(suffix), path.with_suffix(suffix.upper())):
        if found.is_file():
            return TextSource(found, problems, code_page=GEOEASY_CODE_PAGE)
    return None


def _records(source: TextSource) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the values of each line by their codes."""
    for line, text in source.filled():
        elements = tcl_list(text)
        pairs = [tcl_list(e) for e in elements] if elements is not None else [None]
        if any(p is None or not 1 <= len(p) <= 2 for p in pairs):
            what = "must be pairs of a code and a value in braces, such as {5 P1} {7 0.5}"
            source.wrong(line, what)
            continue
        out: dict[str, str] = {}
        for pair in pairs:
            code, value = ((pair or [""]) + [""])[:2]
            if code in out:
                source.wrong(line, f"code {code[:20]!r} stands twice")
            out[code] = value
        yield line, out


def _stated_accuracies(
    path: Path, given: Accuracies, problems: Problems
) -> tuple[Accuracies, float | None]:
    """Return accuracies with the standard deviations of `.par`, and σ of levelling, mm for a km.

    The latter grows with the length of a line, not with its root (src/xmlgeo.tcl, GetHdW); None:
    the file states none, or the user states another.
    """
    source = _beside(path, ".par", problems)
    if source is None:
        return given, None
    stated: dict[str, Any] = {}
    for line, pairs in _records(source):
        stated |= read_record(PARAMETER_FIELDS, pairs, source, line, unread=UNREAD_CODES)
    problems.raise_all()
    if stated.get("direction") is not None:
        mgon = stated["direction"] * ANGLE["arcsec"] / ANGLE["mgon"]
        for name in ("sigma_direction_mgon", "sigma_zenith_mgon"):
            if getattr(given, name) is None:
                given = replace(given, **{name: mgon})
    if stated.get("distance") is not None and given.sigma_distance_mm is None:
        ppm = stated["ppm"] if stated.get("ppm") is not None else given.ppm
        given = replace(given, sigma_distance_mm=stated["distance"], ppm=ppm)
    usual = given.sigma_levelling_mm == DEFAULT_ACCURACIES.sigma_levelling_mm
    return given, stated.get("levelling") if usual else None


def _field_record(
    book: FieldBook,
    line: int,
    pairs: Mapping[str, str],
    mm_per_km: float | None,
    *,
    in_plan: bool,
) -> None:
    """Note a station or a sight."""
    source = book.source
    if ("2" in pairs) == ("5" in pairs):
        source.wrong(line, "needs a station (code 2) or a target (code 5), and not both")
        return
    for code in READINGS_SWITCHED_OFF:
        if code in pairs:
            source.leave_out(line, ROWS_SWITCHED_OFF, pairs.get("5", pairs.get("2", "")))
    unread = (*UNREAD_CODES, *READINGS_SWITCHED_OFF)
    if "2" in pairs:
        found = read_record(STATION_FIELDS, pairs, source, line, unread=unread)
        book.begin(line, found["station"], found["height"])
        return
    found = read_record(SIGHT_FIELDS, pairs, source, line, unread=unread)
    if found["offset"]:
        source.wrong(line, "a constant of the slope distance (20) is not applied: correct it")
    if found["levelled"] is not None:
        if in_plan:
            source.leave_out(line, NOT_IN_PLAN, found["target"])
        else:
            _levelled(book, line, found, mm_per_km)
        return
    if found["direction"] is not None and found["reference"] is not None:
        source.wrong(line, "has a direction (7) and a direction to a reference (21): one is valid")
    if found["difference"] is not None:
        if found["zenith"] is None:
            what = "a height difference (10) without a zenith angle (8) is not read"
            source.wrong(line, f"{what}; a levelled one has the code 120")
        else:
            source.leave_out(line, DERIVED_OBSERVATIONS, found["target"])
    direction = found["direction"] if found["direction"] is not None else found["reference"]
    lengths = {name: found[name] for name in ("zenith", "distance", "horizontal")}
    if in_plan and (direction is not None or any(v is not None for v in lengths.values())):
        lengths = {"horizontal": plane_readings(source, line, found["target"], **lengths)}
        if direction is lengths["horizontal"] is None:
            return
    book.sight(
        line,
        found["target"],
        direction=direction,
        **lengths,
        target_height=found["target_height"],
    )


def _levelled(
    book: FieldBook, line: int, found: Mapping[str, Any], mm_per_km: float | None
) -> None:
    """Note a levelled height difference, whose horizontal distance is the length of its line."""
    other = [n for n in ("direction", "reference", "zenith", "distance") if found[n] is not None]
    if book.current is None:
        book.source.wrong(line, "a levelled height difference before any station (code 2)")
        return
    if other:
        what = f"a levelled height difference (120) with {', '.join(other)}: needs lines of its own"
        book.source.wrong(line, what)
        return
    length, before = found["horizontal"] or 0.0, len(book.others)
    book.levelled(line, book.current.station, found["target"], found["levelled"], length)
    if mm_per_km is not None and length > 0:
        sigma = mm_per_km * LENGTH["mm"] * length / LENGTH["km"]
        noted = book.others[before:]
        book.others[before:] = [
            replace(o, sigma=sigma) for o in noted if isinstance(o, HeightDifference)
        ]


def _coordinates(book: FieldBook, line: int, pairs: Mapping[str, str]) -> None:
    """Note the coordinates of a point; preliminary ones count where there are no others."""
    found = read_record(COORDINATE_FIELDS, pairs, book.source, line, unread=UNREAD_CODES)
    names = [n for n in (found["point"], found["station"]) if n is not None]
    if len(names) != 1:
        book.source.wrong(line, "needs the name of a point, code 5 (or 2)")
        return
    place = []
    for axis in ("east", "north", "up"):
        final, preliminary = found[axis], found[f"{axis}_preliminary"]
        place.append(final if final is not None else preliminary)
    if all(v is not None and math.isnan(v) for v in place):
        return  # what is no number has been noted
    book.point(line, names[0], *place)


def is_geoeasy(path: Path) -> bool:
    """Return whether the first line of a file is a list of codes of GeoEasy."""
    beginning = file_beginning(path)
    if not beginning.strip():  # a field book without lines beside its coordinates
        return path.suffix.lower() == ".geo" and path.with_suffix(".coo").is_file()
    return _RECOGNISED.match(beginning) is not None


READER = Reader(
    "geoeasy",
    (".geo", ".coo"),
    "GeoEasy",
    NetworkReader(read_geoeasy),
    recognises=is_geoeasy,
)

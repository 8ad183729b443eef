"""Signatures of files that no reader takes: what a file looks like, and what to do with it.

A file that no reader recognises is described by its content: as one of the kinds in `SIGNATURES`,
which programs and instruments of the field write; or as an XML or JSON file by its elements; or as
a table by its separator and header; or by its first line. The message never lists every format.
"""

from __future__ import annotations

import csv
import re
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from .text_files import MAX_RECOGNITION_BYTES, decoded, file_beginning

SHOWN_CHARACTERS = 50
"""Number of characters of a line that a message shows."""
SHOWN_NAMES = 6
"""Number of names of columns, keys or files that a message shows."""
TABLE_LINES = 20
"""Number of lines by which a table is recognised."""
TABLE_SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars"}
MAPPING_ADVICE = (
    "if it has points or readings, `factorgraph-adj guess-columns FILE > mapping.toml` proposes a "
    "mapping of its columns to be corrected; read it by --from columns --set mapping=mapping.toml"
)
FORMATS_ADVICE = "`factorgraph-adj formats` lists what is read; --from and format= name one"
FIRST_ELEMENT = re.compile(
    r"(?:<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^>]*>|\s)*<([\w:.-]+)", flags=re.DOTALL
)
ZIP_BEGINNING = b"PK\x03\x04"


@dataclass(frozen=True)
class Signature:
    """Kind of file that is known and not read."""

    what: str
    """The kind, in words that follow 'looks like'."""
    advice: str
    """What to do with such a file."""
    pattern: str
    """Regular expression of the beginning of its content, ISO 8859-1, lines by MULTILINE."""
    suffixes: tuple[str, ...] = ()
    """Suffixes, one of which such a file also has; empty: the content alone tells it."""

    def fits(self, suffix: str, beginning: str) -> bool:
        """Return whether a file may be of the kind.

        Args:
            suffix: its suffix, in small letters.
            beginning: its first bytes as ISO 8859-1.
        """
        if self.suffixes and suffix not in self.suffixes:
            return False
        return re.search(self.pattern, beginning, flags=re.MULTILINE) is not None


A_PHOTO = "give the file in which a program measured its points, such as a COLMAP model"
A_DRAWING = "it has no observations; export the points as a table, or give the field book"
A_CLOUD = "point clouds have no observations; give the block, or a table of targets"
A_DOCUMENT = "give the file that it was printed from"
RAW_GNSS = "process the vectors and give them as SINEX, GVX or DynaML"
BINARY_BOOK = "export the job as JobXML, LandXML or text and read that"
A_RESULT = "it is a result; give the input of the program, which has the observations"
A_PROGRAM = (
    "save its observations and points as tables, and read them with a mapping of their columns, "
    "which `factorgraph-adj guess-columns FILE` proposes"
)
SIGNATURES: tuple[Signature, ...] = (
    Signature("a photo in JPEG", A_PHOTO, r"\A\xff\xd8\xff"),
    Signature("a picture in PNG", A_PHOTO, r"\A\x89PNG"),
    Signature("a picture in TIFF, or a GeoTIFF", A_PHOTO, r"\A(II\*\x00|MM\x00\*|II\+\x00)"),
    Signature("a PDF document", A_DOCUMENT, r"\A%PDF-"),
    Signature("a page of HTML", A_DOCUMENT, r"\A\s*(<!doctype html|<!DOCTYPE html|<html|<HTML)"),
    Signature("a document of RTF", "save it as plain text", r"\A\{\\rtf"),
    Signature(
        "an old Excel or Word file", "save it as .xlsx or .csv", r"\A\xd0\xcf\x11\xe0\xa1\xb1\x1a"
    ),
    Signature("a drawing in DWG", A_DRAWING, r"\AAC10\d\d"),
    Signature("a drawing in DXF", A_DRAWING, r"\A\s*(999[^\n]*\n.*\n\s*)*0\s*\r?\nSECTION\s*\r?\n"),
    Signature("a point cloud in LAS or LAZ", A_CLOUD, r"\ALASF"),
    Signature("a point cloud in E57", A_CLOUD, r"\AASTM-E57"),
    Signature("a mesh or cloud in PLY", A_CLOUD, r"\Aply\r?\nformat "),
    Signature("a scan of Leica (PTX)", A_CLOUD, r"\A\d+\r?\n\d+\r?\n\S+ \S+ \S+\r?\n", (".ptx",)),
    Signature("a shapefile", A_DRAWING, r"\A\x00\x00\x27\x0a"),
    Signature(
        "a database of SQLite, such as a GeoPackage or the database of COLMAP",
        "of COLMAP, give the folder of the sparse model and database= as an option",
        r"\ASQLite format 3\x00",
    ),
    Signature(
        "a part of a COLMAP model, whose other files are missing",
        "give the folder with cameras, images and points3D",
        r"\A# (Camera|Image|3D point|Rig calib|Frame) list with (one|two) lines? of data per ",
    ),
    Signature("layers in KML", A_DRAWING, r"<kml\b"),
    Signature("tracks in GPX", "positions without accuracies are not adjusted", r"<gpx\b"),
    Signature("observations in RINEX", RAW_GNSS, r"\A.{60}RINEX VERSION / TYPE"),
    Signature("observations in Compact RINEX", RAW_GNSS, r"\A.{60}CRINEX VERS"),
    Signature("orbits in SP3", RAW_GNSS, r"\A#[a-d][PV]\d{4} "),
    Signature("a log of NMEA sentences", RAW_GNSS, r"\A\$G[PNLA][A-Z]{3},"),
    Signature("a log of u-blox", RAW_GNSS, r"\A\xb5b"),
    Signature("positions of RTKLIB", RAW_GNSS, r"\A% program\s*:"),
    Signature("a script of Python", "run it with python", r"", (".py",)),
    Signature("an array of NumPy", "fill a network in Python: fga.Network", r"\A\x93NUMPY"),
    Signature("data of MATLAB", "export them as tables", r"\AMATLAB 5\.0 MAT-file"),
    Signature("a recording of ROS", "export poses as TUM, or images as a block", r"\A#ROSBAG"),
    Signature("coordinates or observations of MOVE3", A_PROGRAM, r"\AMOVE3 V[\d.]+ \w+ file"),
    Signature(
        "a network of Columbus",
        A_PROGRAM,
        r"^[ \t]*(_UNITS; *[MUIC] *; *(D|DD|G)\s*$|_STA_COORD; |\$UNITS\s*$)",
    ),
    Signature("a listing of STAR*NET", A_RESULT, r"MicroSurvey STAR\*NET|STAR\*NET-?\w* Version"),
    Signature("a listing of SNAP", A_RESULT, r"SNAP version |Survey Network Adjustment Program"),
    Signature("results of GNU Gama", A_RESULT, r"<gama-(local|g3)-adjustment"),
    Signature("an adjustment report of DynAdjust", A_RESULT, r"^DYNADJUST .*OUTPUT FILE"),
    Signature("a report of Metashape or Pix4D in HTML", A_DOCUMENT, r"<title>.*[Rr]eport"),
    Signature(
        "a binary job of Leica (DBX)", BINARY_BOOK, r"", (".x01", ".x02", ".x03", ".x04", ".xcf")
    ),
    Signature("a binary job of Trimble Access", BINARY_BOOK, r"\A[^<]*[\x00-\x08]", (".job",)),
    Signature(
        "a field book of Trimble Survey Controller (DC)",
        "the layouts of its readings are not public; export JobXML (.jxl) or M5 and read that",
        r"\A00..SC V ?\d",
    ),
    Signature("a raw log of Trimble GNSS", RAW_GNSS, r"", (".t01", ".t02", ".t04")),
    Signature("a job of Topcon Magnet", BINARY_BOOK, r"", (".mjf", ".tsj", ".tsv7")),
    Signature("a project of Trimble Business Center", BINARY_BOOK, r"", (".vce",)),
    Signature("a project of Leica Infinity", BINARY_BOOK, r"", (".iprj",)),
)
"""Kinds of files that are known and not read, in the order of the search."""


def looks_like(path: Path) -> tuple[str, str] | None:
    """Return a kind of `SIGNATURES` that a file looks like, and what to do; None: it is of none."""
    content = file_beginning(path).decode("latin-1")
    for signature in SIGNATURES:
        if signature.fits(path.suffix.lower(), content):
            return signature.what, signature.advice
    names = _packed_names(path)
    if "[Content_Types].xml" in names and any(name.startswith("word/") for name in names):
        return "a document of Word", "save it as plain text"
    is_workbook = any(name.startswith("xl/") for name in names)
    if "[Content_Types].xml" in names and is_workbook and path.suffix.lower() != ".xlsx":
        return "a workbook of Excel", "give it the suffix .xlsx, or save a sheet as .csv"
    return None


def description(path: Path) -> str:
    """Return what a file of no known kind is, and what to do."""
    if names := _packed_names(path):
        return f"a zip file with {_shown(names)}; unpack it, and give a file or folder of it"
    content = file_beginning(path)
    if len(content) == MAX_RECOGNITION_BYTES:  # a character, or a line, is cut in two
        content = content[: content.rfind(b"\n") + 1] or content
    if not content:
        return "an empty file"
    if b"\0" in content[:4096] and not content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return f"binary; {FORMATS_ADVICE}"
    try:
        text = decoded(content, path.name, "cp1252")[0]
    except InputError:
        text = content.decode("latin-1")
    lines = [line.rstrip("\r") for line in text.splitlines() if line.strip()]
    if not lines:
        return "a file of blanks"
    if found := FIRST_ELEMENT.match(text):
        return f"XML with the element <{found[1]}>, which no reader knows; {FORMATS_ADVICE}"
    if re.match(r"\s*[{\[]", text) and (keys := _json_keys(text)):
        return f"JSON with the keys {keys}, which no reader knows; {FORMATS_ADVICE}"
    if table := _table(lines):
        return f"{table}; {MAPPING_ADVICE}"
    first = lines[0][:SHOWN_CHARACTERS]
    return f"text that begins with {first!r}; {FORMATS_ADVICE}"


def _json_keys(text: str) -> str:
    """Return the first keys of JSON at its beginning, quoted."""
    keys = dict.fromkeys(re.findall(r'"([^"\\]{1,40})"\s*:', text))
    return _shown([f'"{key}"' for key in keys])


def _table(lines: Sequence[str]) -> str:
    """Return the description of a table with a separator or blanks; '' for other text."""
    lines = lines[:TABLE_LINES]
    for separator, words in TABLE_SEPARATORS.items():
        rows = list(csv.reader(lines, delimiter=separator))
        counts = [len(row) for row in rows]
        if len(rows) >= 2 and min(counts) >= 2 and len(set(counts[1:])) == 1:
            cells = [cell.strip() for cell in rows[0]]
            return f"a table of {max(counts)} columns with {words}, {_header(cells)}"
    rows = [line.split() for line in lines]
    numeric = [row for row in rows if sum(_is_number(cell) for cell in row) >= 2]
    even = len(rows) >= 2 and len({len(row) for row in rows[1:]}) == 1
    if even and len(numeric) >= len(rows) - 1:
        return f"a table of {len(rows[-1])} columns with blanks, {_header(rows[0])}"
    return ""


def _header(cells: Sequence[str]) -> str:
    if any(_is_number(cell) for cell in cells):
        return "without a header"
    return f"with the header {_shown(cells)}"


def _shown(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN_NAMES} more" if len(names) > SHOWN_NAMES else ""
    return ", ".join(name[: SHOWN_CHARACTERS // 2] for name in names[:SHOWN_NAMES]) + more


def _is_number(text: str) -> bool:
    return re.fullmatch(r"[+-]?\d+([.,]\d*)?", text.strip()) is not None


def _packed_names(path: Path) -> list[str]:
    """Return the names of what a zip file holds; [] for other files, and damaged ones."""
    if not file_beginning(path).startswith(ZIP_BEGINNING):
        return []
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return []

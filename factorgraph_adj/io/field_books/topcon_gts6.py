"""Reader of the string GTS-6 of Topcon's total stations: GTS-210, 220, 229 and collectors FC.

A field book is one string of records that begin with ``_``; downloads cut it into blocks of 128
characters with a number and a check sum. The grammar: ``TopCon210`` of GeoEasy (``topcon.tcl``) and
``topcon_gts.py`` of Total Open Station. The two disagree on the height of a target, which stands
behind its readings: both real files end with one and begin without. Topcon's interface manual is
not public.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path

from ...network.network import Network
from ...units import FOOT, GON
from ..format_reader import NetworkReader, Reader
from ..numbers import PACKED_DEGREES
from ..source import LeftOutReason, TextSource
from ..text_files import file_beginning
from .accuracies import DEFAULT_ACCURACIES, Accuracies
from .field_book import FieldBook

SIGHTS_TO_ITSELF = LeftOutReason(
    "sights of a station to itself", "the name of the target or of the station is wrong"
)
BLOCK_CHARACTERS = 128
"""Number of characters of a block."""
BLOCK = re.compile(r"\x02(.*?)([0-9])([0-9]{3})\x03?\s*", re.ASCII)
"""A block: characters, number, and check sum: exclusive or of all of them."""
STATION = re.compile(r"_?'(?P<name>[^_']*)_\([^_']*_\)(?P<height>[^_']*)")
TARGET = re.compile(r"_\+(?P<name>[^_']*)_ ")
READINGS = re.compile(
    r"(?:\?\+(?P<distance>\d{8})(?P<length>[mf])|<)(?P<zenith>\d{7})\+(?P<direction>\d{7})"
    r"(?P<angle>[dg])(?:\+(?P<horizontal>\d{8})t)?[0-9*+-]*",
    re.ASCII,
)
"""Readings with a slope distance and the horizontal one, or of angles alone."""
HEIGHT = re.compile(r"_\*[^_']*_,(?P<height>[^_']*)")
"""Code and height of the target before."""
END_OF_BOOK = re.compile(r"[_\s\x04]*")
LENGTH_OF_UNIT = {"m": 1e-3, "f": 1e-3 * FOOT}
"""Metres in the last digit of a distance."""
MAX_REDUCTION = 5e-5
"""Largest share of a distance by which curvature and refraction change its horizontal distance: 5
cm for 1 km, more than steep sights of 2 km have."""
ROUNDING_M = 2e-3
"""Largest difference that rounding of slope and horizontal distance leaves, metres."""


def read_topcon_gts6(
    path: str | Path,
    *,
    station: str | None = None,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of Topcon in the string GTS-6.

    Read are stations with heights of the instrument, targets with slope distance, zenith reading
    and direction, or with angles alone, and heights of targets, which stand behind them. Units are
    those of each reading: metres or feet (international ones), gon or degrees, minutes and seconds.
    A horizontal distance must be that of the slope distance and the zenith reading to 2 mm. A
    station without a name is that of ``station``; a remark says which name it has without it. A
    distance of 0 was not measured. A sight of a station to itself, whose name is wrong, is left
    out, and counted. Not read: codes, tilt sensor, ppm and strength of the signal.
    Coordinates (records W and x, y, z) are refused: no public file or description has them.

    Check sums of blocks, where a file has them, must be right.

    Tried on a file in degrees with four stations, of GeoEasy, and on one in gon with check sums, of
    Total Open Station.

    Args:
        path: the file.
        station: name of the station that the file does not name.
        fixed: names of points that are held; the format has no coordinates.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    book = FieldBook(source, accuracies, fixed, station=station, may_lack_station=True)
    _Reader(book, BookString(source)).read()
    return book.network()


class BookString:
    """The string of a book, whose characters know their lines."""

    def __init__(self, source: TextSource) -> None:
        """Join the blocks, or the lines, of a file; wrong check sums are noted."""
        self.text = ""
        self._starts: list[tuple[int, int]] = []
        in_blocks = any(text.startswith("\x02") for text in source.lines)
        for line, text in source.filled():
            if text.startswith("\x02"):
                text = _checked_block(source, line, text)
            elif not text.strip("\x04 "):
                continue
            elif in_blocks:
                source.wrong(line, f"{text[:40]!r} is no block: blocks begin with STX")
                continue
            self._starts.append((len(self.text), line))
            self.text += text

    def line(self, at: int) -> int:
        """Return the line of a character."""
        return next((line for start, line in reversed(self._starts) if start <= at), 1)


def _checked_block(source: TextSource, line: int, text: str) -> str:
    """Return the characters of a block."""
    found = BLOCK.fullmatch(text)
    if found is None or len(found[1]) != BLOCK_CHARACTERS:
        what = f"a block must have {BLOCK_CHARACTERS} characters between STX and four digits"
        source.wrong(line, what)
        return text[1:]
    computed = 0
    for character in found[1] + found[2]:
        computed ^= ord(character)
    if computed != int(found[3]):
        what = f"the check sum of the block is {found[3]}; its characters have {computed:03d}"
        source.wrong(line, what)
    return found[1]


class _Reader:
    """State of the string between its records."""

    def __init__(self, book: FieldBook, string: BookString) -> None:
        self.book, self.string = book, string
        self.source = book.source

    def read(self) -> None:
        """Read all records; behind one that is wrong the next target or station follows."""
        text, at = self.string.text, 0
        while at < len(text):
            if END_OF_BOOK.fullmatch(text, at):
                break
            station, target = STATION.match(text, at), TARGET.match(text, at)
            if station is not None:
                self._station(at, station)
                at = station.end()
            elif target is not None and (readings := READINGS.match(text, target.end())):
                at = self._sight(at, target["name"].strip(), readings)
            else:
                line = self.string.line(at)
                shown = text[at : at + 40]
                self.source.wrong(line, f"{shown!r} begins neither a station nor a target")
                following = re.compile(r"_\+|_?'").search(text, at + 2)
                at = len(text) if following is None else following.start()
        if not text:
            self.source.wrong(1, "holds no record")

    def _station(self, at: int, of: re.Match[str]) -> None:
        line = self.string.line(at)
        height = self.source.field(line, of["height"], "height of the instrument").number()
        name = of["name"].strip()
        if name:
            self.book.begin(line, name, height)
        else:
            self.book.current = None
            self.book.set_height(line, height)

    def _sight(self, at: int, name: str, of: re.Match[str]) -> int:
        """Note a target; return where its record ends."""
        line, end = self.string.line(at), of.end()
        behind = HEIGHT.match(self.string.text, end)
        height = math.nan
        if behind is None:
            self.source.wrong(
                line, f"target {name!r}: code and height (_*CODE_,HEIGHT) are missing"
            )
        else:
            cell = self.source.field(self.string.line(end), behind["height"], "target height")
            height, end = cell.number(), behind.end()
        if not name:
            self.source.wrong(line, "a target has no name")
        zenith, direction = (self._angle(line, of, key) for key in ("zenith", "direction"))
        distance = None
        if of["distance"] is not None:
            distance = int(of["distance"]) * LENGTH_OF_UNIT[of["length"]]
        self._check(line, name, of, distance, zenith)
        if self.book.current is not None and name == self.book.current.station:
            self.source.leave_out(line, SIGHTS_TO_ITSELF, name)
            return end
        self.book.sight(
            line,
            name,
            direction=direction,
            zenith=zenith,
            distance=distance,
            target_height=height,
        )
        return end

    def _angle(self, line: int, of: re.Match[str], key: str) -> float:
        """Return an angle of seven digits: DDDMMSS, or gon with four decimals."""
        digits = of[key]
        what = "zenith reading" if key == "zenith" else "direction"
        cell = self.source.field(line, f"{digits[:3]}.{digits[3:]}", what)
        return cell.number(PACKED_DEGREES) if of["angle"] == "d" else cell.number(scale=GON)

    def _check(
        self, line: int, name: str, of: re.Match[str], distance: float | None, zenith: float
    ) -> None:
        """Note a horizontal distance that is not that of the readings."""
        if not distance or of["horizontal"] is None or math.isnan(zenith):
            return
        stated = int(of["horizontal"]) * LENGTH_OF_UNIT[of["length"]]
        computed = distance * abs(math.sin(zenith))
        if abs(stated - computed) > ROUNDING_M + MAX_REDUCTION * distance:
            what = f"target {name!r}: the horizontal distance {stated:.3f} m differs from that of "
            what += f"slope distance and zenith reading, {computed:.3f} m"
            self.source.wrong(line, what)


def _is_gts6(path: Path) -> bool:
    """Return whether a file begins with a station in its string, alone or in a block."""
    text = file_beginning(path, 4096).decode("latin-1").lstrip("\r\n ").lstrip("\x02")
    station = STATION.match(text)
    return station is not None and text.startswith("_+", station.end())


READER = Reader(
    "topcon_gts6",
    (".210", ".gt6"),
    "Topcon GTS-6 string",
    NetworkReader(read_topcon_gts6),
    recognises=_is_gts6,
)

"""Reader of field books of Leica instruments: GSI-8 and GSI-16.

Word indices: Leica Geosystems, GSI ONLINE for TPS and DNA, "Word Indexes".
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from ...errors import known
from ...network.network import Network
from ..text import read_text
from .accuracies import USUAL, Accuracies
from .book import FieldBook
from .gsi_levels import Levelling
from .gsi_words import Block, blocks

OBSERVED = ("21", "22", "31", "32")
ALLOWED = {
    *(f"{i}" for i in range(11, 20)),
    *("21", "22", "31", "32", "33", "87", "88"),
    *(f"{i}" for i in range(41, 50)),
    *(f"{i}" for i in range(51, 60)),
    *(f"{i}" for i in range(70, 80)),
    *(f"{i}" for i in range(81, 87)),
}
"""Word indices that the reader knows."""


def read_gsi(
    path: str | Path,
    *,
    station: str | None = None,
    station_code: str | int | None = None,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = USUAL,
) -> Network:
    """Read a field book of a Leica total station or level, GSI-8 or GSI-16.

    A set-up begins where a block has the point (word 11) with coordinates of the station (84, 85,
    86) or height of the instrument (88) and no reading of a circle; or where a code block (41) has
    ``station_code``, station in word 42 and height of the instrument, mm, in word 43; without
    either, ``station`` names the only one. Sights are blocks with 21, 22, 31 (slope distance) and
    87 (height of the target); a distance of 0 was not measured. 32 (horizontal distance) counts
    without 31. Corrections of the distance (51, 58, 59) are in it already, 33 and the coordinates
    81-83 of a sighted point follow from the readings; the latter serve as approximate coordinates.
    Zeros that fill a name from the left are not part of it. Face 2 is told by a zenith reading
    beyond 200 gon; a direction without one counts as of face 1. Readings in two faces are reduced
    by `factorgraph_adj.reduce_faces`; a target that is read again begins another round, a set of
    directions of its own.

    Of levels, 331 and 335 are readings of the backsight, 332 and 336 of the foresight, 333
    intermediate ones, 32 distances of the staff; a code block with ``?`` begins a line and says the
    method.

    Harmless and not read: instrument, date and time (12-19), other codes (41-49), remarks (70-79),
    differences and sums that the level has computed (83 of turning points, 390, 571-574).

    Args:
        path: the file.
        station: name of the only station of a file that names none.
        station_code: code of the blocks that begin a set-up.
        fixed: names of points that are held at the coordinates of the file; none: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = Path(path)
    book = FieldBook(source, accuracies, fixed)
    reader = _Reader(book, None if station_code is None else str(station_code))
    if station is not None:
        book.begin(1, str(station), math.nan)
    for block in blocks(read_text(source), book.notes):
        reader.read(block)
    reader.levelling.end()
    reader.ask_for_stations()
    return book.network()


class _Reader:
    def __init__(self, book: FieldBook, code: str | None) -> None:
        self.book = book
        self.code = code
        self.levelling = Levelling(book)
        self.codes: list[str] = []
        self.without_station: list[int] = []

    def read(self, block: Block) -> None:
        """Read a block."""
        if block.is_code:
            self._code(block)
            return
        if block.words[0].index != "11":
            what = f"a block must begin with word 11 or 41, not {block.words[0].index}"
            self.book.notes.add(block.line, what)
            return
        name = self.book.notes.name(block.line, block.words[0].text, "word 11, the point,")
        if self.levelling.takes(block, name):
            return
        for w in block.words:
            if w.index not in ALLOWED:
                what = f"word {w.index} is not known; valid: {known(sorted(ALLOWED), most=60)}"
                self.book.notes.add(w.line, what)
        if any(block.first(i) for i in OBSERVED):
            self._sight(block, name)
        else:
            self._station_or_point(block, name)

    def _code(self, block: Block) -> None:
        if "?" in block.words[0].info + block.words[0].data:
            self.levelling.begin(block.words[0])
            return
        code = block.words[0].text
        self.codes.append(code)
        if self.code is None or code != self.code:
            return
        name, height = block.first("42"), block.first("43")
        if name is None or height is None:
            what = (
                f"code {code} begins a set-up: it needs words 42, the station, and 43, its height"
            )
            self.book.notes.add(block.line, what)
            return
        digits = height.data[1:].strip()
        value = self.book.notes.finite(block.line, digits, "word 43, the height in mm,", 1e-3)
        station = self.book.notes.name(block.line, name.text, "word 42, the station,")
        self.book.begin(block.line, station, value if height.data[0] == "+" else -value)

    def _station_or_point(self, block: Block, name: str) -> None:
        def of(*indices: str) -> list[float]:
            words = [block.first(i) for i in indices]
            return [math.nan if w is None else w.number(self.book.notes) for w in words]

        station = of("84", "85", "86")
        (height,) = of("88")
        if block.first("88") or any(block.first(i) for i in ("84", "85", "86")):
            self.book.point(block.line, name, *station, agree=False)
            self.book.begin(block.line, name, 0.0 if math.isnan(height) else height)
        else:
            self.book.point(block.line, name, *of("81", "82", "83"))

    def _sight(self, block: Block, name: str) -> None:
        notes, book = self.book.notes, self.book
        if book.current is None:
            self.without_station.append(block.line)
            return

        def number(index: str) -> float | None:
            word = block.first(index)
            return None if word is None else word.number(notes)

        height = number("88")
        if height is not None and book.current.height != height:
            if math.isnan(book.current.height):
                book.current.height = height
            else:
                what = (
                    f"height of the instrument {height:.3f} m differs from that of the set-up, "
                    f"{book.current.height:.3f} m: a new set-up needs a block of its station"
                )
                notes.add(block.line, what)
                return
        if math.isnan(book.current.height):
            book.current.height = 0.0
        zenith = number("22")
        coordinates = [number(i) for i in ("81", "82", "83")]
        if None not in coordinates:
            book.point(block.line, name, *coordinates, agree=False)  # type: ignore[arg-type]
        book.sight(
            block.line,
            name,
            direction=number("21"),
            zenith=zenith,
            distance=number("31") or None,
            horizontal=number("32") or None,
            target_height=number("87") or 0.0,
        )

    def ask_for_stations(self) -> None:
        """Note that readings have no station, and how to name it."""
        if not self.without_station:
            return
        first, n = self.without_station[0], len(self.without_station)
        what = f"{n} sights from here have no station: no block before has words 84-86 or 88"
        if self.codes:
            codes = known(dict.fromkeys(self.codes))
            what += (
                f"; state station_code if words 42 and 43 of a code name station and height of the "
                f"instrument (codes of the file: {codes}), or station, the only one"
            )
        else:
            what += "; state station, the name of the only one"
        self.book.notes.add(first, what)

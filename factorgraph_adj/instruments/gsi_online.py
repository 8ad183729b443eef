"""GSI online: blocks of GSI-8 and GSI-16 that a Leica total station sends while it measures.

The words are those of files, see `factorgraph_adj.io.field_books.gsi`, and one definition reads
both: a block with point (11) and 21, 22, 31 or 32 is a sight, with 84-86 or 88 and no reading a
station; words 87 and 88 are heights of target and instrument; 51 says which atmospheric correction
(ppm) is in the distance. Words 18 (year, seconds, milliseconds) and 19 (month, day,
hour, minute) together are the time of the instrument, and the four characters behind 11 the number
of the block, where the instrument counts its blocks. Blocks of levels are refused.

Grammar: Leica Geosystems, GSI ONLINE for TPS and DNA; TPS1100 user manual, "Data format"; words 18,
19 and 51 as the documentation of Total Open Station has them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

from ..errors import InputError
from ..io.field_books.gsi import leave_out_remarks, read_block, read_code
from ..io.field_books.gsi_level import STAFF_WORDS
from ..io.field_books.gsi_words import GsiBlock, blocks_of_line, read_text
from .grammars import GrammarRecord
from .reading_book import ReadingBook
from .readings import Reading, ReceivedLine, Sight

_APPLIED = re.compile(r"([+-]\d{3,12})([+-]\d{3,12})")
"""Atmospheric correction, ppm, and prism constant, mm, of word 51."""


class GsiOnline:
    """Parser of GSI online."""

    def __init__(self, *, station_code: str | None = None) -> None:
        """Take the options of [[instrument]].

        Args:
            station_code: code of the blocks 41 that begin a set-up: station in word 42, height of
                the instrument, mm, in word 43.
        """
        self.station_code = station_code

    def read(self, line: ReceivedLine) -> Sequence[Reading]:
        """Return the readings of a line."""
        book = ReadingBook(line)
        source = book.source
        for block in blocks_of_line(source, 0, line.decoded(), whole=True):
            stamped = _stamp(block)
            index, word = block.words[0]
            number = word[:4].strip(".")
            identity = f"{number} {'' if stamped is None else stamped}".strip()
            book.of_line = {"stamped": stamped, "identity": identity}
            begin = len(book.found)
            leave_out_remarks(source, block)
            if index == "41":
                read_code(book, block, self.station_code)
                continue
            if index != "11":
                source.wrong(0, f"a block must begin with word 11 or 41, not {index}")
                continue
            if any(i in STAFF_WORDS for i, _ in block.words):
                source.wrong(0, "readings of a staff: this grammar is that of total stations")
                continue
            name = read_text(source.field(0, word, "word 11, the point,"))
            read_block(book, block, name)
            ppm = _applied_ppm(block, book)
            book.found[begin:] = [
                replace(r, applied_ppm=ppm) if isinstance(r, Sight) else r
                for r in book.found[begin:]
            ]
        return book.made()


def _stamp(block: GsiBlock) -> float | None:
    """Return the time of words 18 and 19, seconds since 1970; None: they are not both there."""
    year, month = block.first("18"), block.first("19")
    if year is None or month is None:
        return None
    first, second = (w[5:].strip()[-8:] for w in (year, month))
    if not (first.isdigit() and second.isdigit() and len(first) == len(second) == 8):
        raise InputError(f"words 18 and 19 must be YYSSmmm0 and MMDDhhmm, not {first} {second}")
    try:
        month_, day, hour, minute = (int(second[i : i + 2]) for i in (0, 2, 4, 6))
        year_, seconds, micro = int(first[:2]), int(first[2:4]), 1000 * int(first[4:7])
        at = datetime(2000 + year_, month_, day, hour, minute, seconds, micro, tzinfo=UTC)
    except ValueError as error:
        raise InputError(f"words 18 and 19, {first} {second}, are no time: {error}") from None
    return at.timestamp()


def _applied_ppm(block: GsiBlock, book: ReadingBook) -> float | None:
    """Return the atmospheric correction that is in the distance, ppm; None: not stated."""
    word = block.first("51")
    if word is None:
        return None
    match = _APPLIED.fullmatch(word[4:])
    if match is None:
        book.source.wrong(0, f"word 51 must be ppm and mm, such as +0012-034, not {word[4:]}")
        return None
    return float(match[1])


GRAMMAR = GrammarRecord(
    "gsi-online", "GSI-8 and GSI-16 of Leica total stations, as they send them", GsiOnline
)

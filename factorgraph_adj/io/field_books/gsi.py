"""Reader of field books of Leica, GSI-8 and GSI-16: total stations and levelled lines.

`gsi_words` reads words and blocks, `gsi_level` levelled lines.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from ...errors import known
from ...network.network import Network
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader
from ..source import NOTES, Source, TextSource
from .accuracies import DEFAULT_ACCURACIES, Accuracies
from .field_book import FieldBook
from .field_records import NEEDED, RecordField, read_record
from .gsi_level import GsiLevel
from .gsi_words import (
    VALUES_MISSING,
    GsiBlock,
    gsi_blocks,
    is_gsi,
    is_missing,
    leave_out_words,
    read_gsi_angle,
    read_gsi_length,
    read_millimetres,
    read_text,
    text_of,
)

MAY_BE_MISSING = ("21", "22", "31", "32", *(str(i) for i in range(81, 87)))
"""Words that may have dashes for a value; without a height of instrument or target there is no
sight."""
REMARKS = tuple(str(i) for i in range(70, 80))
"""Words of remarks, which are 0 where there is none."""
WORDS_WITHOUT_OBSERVATION = ("25", "33")
"""Difference of the circle to its orientation and difference of heights, which are derived."""
KNOWN_WORDS = tuple(
    str(i)
    for i in (
        *range(11, 20),
        *(21, 22, 25, 31, 32, 33),
        *range(41, 60),
        *range(70, 80),
        *range(81, 89),
        *(531, 538, 560, 561, 562, *range(590, 600), 913, 914),
    )
)
"""Word indices that a block of a total station may have."""


# -- blocks of total stations ---------------------------------------------------------------------


def _lengths(**indices: str) -> tuple[RecordField, ...]:
    return tuple(RecordField(name, f"word {i}", read_gsi_length, i) for name, i in indices.items())


POINT_FIELDS = _lengths(east="81", north="82", up="83")
STATION_FIELDS = _lengths(east="84", north="85", up="86", height="88")
SIGHT_FIELDS = (
    RecordField("direction", "word 21", read_gsi_angle, "21"),
    RecordField("zenith", "word 22", read_gsi_angle, "22"),
    *_lengths(distance="31", horizontal="32"),
    *_lengths(target_height="87", height="88", east="81", north="82", up="83"),
)
CODE_FIELDS = (
    RecordField("station", "word 42, the station,", read_text, "42", NEEDED),
    RecordField("height", "word 43, the height in mm,", read_millimetres, "43", NEEDED),
)
"""Fields of the code that begins a set-up."""
BLOCKS = (
    (("21", "22", "31", "32"), SIGHT_FIELDS),
    (("84", "85", "86", "88"), STATION_FIELDS),
    ((), POINT_FIELDS),
)
"""Fields of a block that has any of some words; the first that fits counts."""


def read_gsi(
    path: str | Path,
    *,
    station: str | None = None,
    station_code: str | int | None = None,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of a Leica total station or level, GSI-8 or GSI-16.

    A set-up begins where a block has the point (word 11) with coordinates of the station (84, 85,
    86) or height of the instrument (88) and no reading of a circle; or where a code block (41) has
    ``station_code``, station in word 42 and height of the instrument, mm, in word 43. ``station``
    names the station of sights before any. Without it the coordinates beside their readings (81,
    82, 83) give the station, and a remark says how well they fit; where the file has no station
    at all, the sights are one set-up unless readings of a target contradict it, see
    `factorgraph_adj.io.field_books.unnamed_station`.

    Sights are blocks with 21, 22, 31 (slope distance) and 87 (height of the target); a distance of
    0 was not measured. 32 (horizontal distance) counts without 31. Corrections of the distance (51,
    58, 59) are in it already. The coordinates of a sighted point serve as approximate ones; where
    those of a point differ, the first count, and a remark names the others. Zeros that fill a name
    from the left are not part of it. An angle in degrees, minutes and seconds may have 60 seconds.
    Face 2 follows from a zenith reading beyond 200 gon; a direction without one counts as of face
    1. Readings in two faces are reduced by `factorgraph_adj.reduce_faces`; a target that is read
    again begins another round, a set of directions of its own.

    Of levels, 331 and 335 are readings of the backsight, 332 and 336 of the foresight, 333 and 334
    intermediate ones, 32 distances of the staff; a code block with ``?`` begins a line and says the
    method. Corrections for the curvature of the Earth are taken as the file has them. Points
    without a number, or with 0, are turning points with names of their own, such as ``0_1``. A
    height (83) counts where it was typed or begins a line.

    Harmless and not read: instrument, date and time (12-19, 56, 59), other codes (41-49). Left
    out and counted: remarks (70-79); what holds no observation, such as the difference of the
    circle to its orientation (25), differences of heights (33), numbers and sums of the level (390,
    571-574, computed heights), readings of the staff that belong to no line (330), check the
    instrument or were repeated; values of dashes, which were not measured.

    Tried on the GSI files of Total Open Station and GeoEasy and on the blocks of levels of Leica's
    manual.

    Args:
        path: the file.
        station: name of the station of sights before any station.
        station_code: code of the blocks that begin a set-up.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    book = FieldBook(source, accuracies, fixed, station=station, may_lack_station=True)
    levelling, codes = GsiLevel(book), dict[str, bool]()
    for block in gsi_blocks(source):
        line, (index, word) = block.line, block.words[0]
        leave_out_remarks(source, block)
        if index == "41" and "?" in word:
            levelling.begin(line, word)
        elif index == "41":
            codes[text_of(word)] = True
            read_code(book, block, station_code)
        elif index != "11":
            source.wrong(line, f"a block must begin with word 11 or 41, not {index}")
        else:
            name = read_text(source.field(line, word, "word 11, the point,"))
            if not levelling.takes(block, name):
                read_block(book, block, name)
    levelling.end()
    hint = ": no block before has words 84-86 or 88"
    if codes:
        code = option_text("station_code", next(iter(codes)))
        hint += f"; give {code} if words 42 and 43 of this code name station and height of the "
        hint += f"instrument (codes of the file: {known(codes)})"
    return book.network(hint=hint)


def leave_out_remarks(source: Source, block: GsiBlock) -> None:
    """Count the remarks of a block."""
    for index, word in block.words:
        if index in REMARKS and not is_missing(word) and text_of(word) != "0":
            source.leave_out(block.line, NOTES, text_of(word))


def read_code(book: FieldBook, block: GsiBlock, station_code: str | int | None) -> None:
    """Begin a set-up where the code of a block says so."""
    if text_of(block.words[0][1]) == str(station_code):
        words = dict(reversed(block.words))
        of = read_record(CODE_FIELDS, words, book.source, block.line, unread=KNOWN_WORDS)
        book.begin(block.line, **of)


def read_block(book: FieldBook, block: GsiBlock, name: str) -> None:
    """Note the sight, the station or the point of a block."""
    source, line, words = book.source, block.line, dict[str, str]()
    for index, word in reversed(block.words):
        if index in MAY_BE_MISSING and is_missing(word):
            source.leave_out(line, VALUES_MISSING, f"{text_of(block.words[0][1])} {index}")
        else:
            words[index] = word
    leave_out_words(source, line, [i for i, _ in block.words if i in WORDS_WITHOUT_OBSERVATION])
    fields = next(f for need, f in BLOCKS if not need or any(block.first(i) for i in need))
    of = read_record(fields, words, source, line, unread=KNOWN_WORDS)
    coordinates, height = [of.pop(axis) for axis in ("east", "north", "up")], of.pop("height", None)
    if fields is not SIGHT_FIELDS:
        book.point(line, name, *coordinates, agree=False)
    if fields is STATION_FIELDS:
        book.begin(line, name, height)
    elif fields is SIGHT_FIELDS:
        if height is not None:
            book.set_height(line, height)
        e, n, u = (math.nan if v is None else v for v in coordinates)
        book.sight(line, name, **of, coordinates=(e, n, u))


READER = Reader(
    "gsi",
    (".gsi",),
    "Leica GSI-8 or GSI-16",
    NetworkReader(read_gsi),
    recognises=is_gsi,
)

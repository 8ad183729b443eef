"""Levelled lines as digital levels of Leica send them: blocks of GSI with readings of staffs.

The words and their rules are those of files, see `factorgraph_adj.io.field_books.gsi_level`: a code
block ``41 ?`` begins a line and says its method, 331 and 335 are backsights, 332 and 336
foresights, 333 and 334 intermediate sights; a reading that comes again at once replaces the one
before. A set-up is observed as a height difference when its results come (573, 574), or with the
first reading of the next set-up, or with the next line.

Turning points without a number (0) are no points of the network: the height differences over them
are added up from named point to named point, with the sum of their lengths; a set-up without
lengths of sights counts as 60 m of line. σ is ``sigma_levelling_mm`` for one kilometre. Typed and
computed heights (83) and single readings (330) are not used. A line that ends with a backsight
alone is told, and the next line begins.

Instruments: DNA, LS and Sprinter with format GSI. Not read: DiNi of Trimble and levels of Topcon
and Sokkia on line, whose protocols are not public; their files are.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

from ..errors import InputError
from ..io.field_books.accuracies import DEFAULT_SETUP_M, Accuracies
from ..io.field_books.gsi_level import TURNING_POINT, GsiLevel
from ..io.field_books.gsi_words import blocks_of_line, read_text
from .grammars import GrammarRecord
from .reading_book import ReadingBook
from .readings import Observed, Reading, ReceivedLine

RESULTS = ("573", "574")
"""Words of the results of a set-up: balance and sum of the lengths."""
Chain = dict[str, tuple[str, float, float]]
"""Named point, height difference and length (m) from which turning points were levelled."""


class LevelBook(ReadingBook):
    """The height differences that a line completes, between named points."""

    def __init__(self, line: ReceivedLine, accuracies: Accuracies, chain: Chain) -> None:
        """Start for a line.

        Args:
            line: the line.
            accuracies: σ of one kilometre.
            chain: turning points of the levelled line, which later lines go on from.
        """
        super().__init__(line)
        self.accuracies, self.chain = accuracies, chain

    def levelled(self, line: int, back: str, fore: str, value: float, length: float) -> None:
        """Note a height difference; that to a turning point is kept for the next one."""
        turning = fore.startswith(f"{TURNING_POINT}_")
        if turning or back in self.chain:
            length = length or DEFAULT_SETUP_M
        if back in self.chain:
            back, before, far = self.chain[back]
            value, length = before + value, far + length
        if turning:
            self.chain[fore] = (back, value, length)
        else:
            super().levelled(line, back, fore, value, length)

    def made(self) -> list[Reading]:
        """Return the height differences; raises as `ReadingBook.made`."""
        super().made()
        return [Observed(observations=(o,)) for o in self.others]


class GsiLevelOnline:
    """Parser of the blocks of a digital level."""

    def __init__(self, *, sigma_levelling_mm: float = 1.0) -> None:
        """Take the options of [[instrument]].

        Args:
            sigma_levelling_mm: σ of one kilometre of levelled line, mm.
        """
        self.accuracies = Accuracies(sigma_levelling_mm=sigma_levelling_mm)
        self._level: GsiLevel | None = None
        self._chain: Chain = {}

    def read(self, line: ReceivedLine) -> Sequence[Reading]:
        """Return the height differences that a line completes.

        Raises:
            InputError: the line is no block of a level, or its readings do not fit the line.
        """
        chain = dict(self._chain)
        book = LevelBook(line, self.accuracies, chain)
        level = self._level_of(book)
        begins = False
        for block in blocks_of_line(book.source, 0, line.decoded(), whole=True):
            index, word = block.words[0]
            if index == "41" and "?" in word:
                level.begin(0, word)
                # What the line before lacks is told, and does not hinder this one.
                begins = True
                chain.clear()
            elif index == "41":
                continue  # a code, which has no observation
            elif index != "11":
                book.source.wrong(0, f"a block must begin with word 11 or 41, not {index}")
            else:
                name = read_text(book.source.field(0, word, "word 11, the point,"))
                if not level.takes(block, name):
                    book.source.wrong(0, "no reading of a staff: this grammar is that of levels")
                elif any(i in RESULTS for i, _ in block.words):
                    level.line.note_complete()
        try:
            found = book.made()
        except InputError:
            if begins:
                self._level, self._chain = level, chain
            raise
        self._level, self._chain = level, chain
        return found

    def _level_of(self, book: LevelBook) -> GsiLevel:
        """Return a copy of the present state that notes in a book."""
        level = GsiLevel(book) if self._level is None else copy.deepcopy(self._level)
        level.book = level.line.book = book
        level.source = level.line.source = book.source
        return level


GRAMMAR = GrammarRecord(
    "gsi-level", "GSI of Leica's digital levels, as they send it", GsiLevelOnline
)

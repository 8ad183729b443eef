"""Sources: fields of files that check their values, all problems by place, rows left out.

A `Field` is one value of a file with its place: its methods return a number, a name, a choice or a
flag, or note what is wrong and return a value that `is_unread` knows, so that a reader continues
and one error lists all problems of its files. `Source` is a file, which gives places to lines;
`Problems` collects those of all files that a reader opens, and the rows that it leaves out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar, cast

from ..control_characters import has_control_characters, why_refused
from ..errors import InputError, LeftOut, Problem, known, similar
from ..files import read_bytes
from ..network.network import Network
from ..start.image_axes import marks_of_known_points, problems_of_marks
from .numbers import MAX_NUMBER, checked_number
from .text_files import decoded, last_line_number, with_newlines

MAX_LISTED_PROBLEMS = 50
"""Number of problems that one error lists; it counts the others."""
MAX_KEPT_PROBLEMS = 10_000
"""Number of problems that are kept: in a file of another format every line is one."""
MIN_SIGMA = 1e-12
"""Smallest standard deviation, in SI: weights of smaller ones overflow."""
MAX_LISTED_CHOICES = 40
"""Number of words that a message lists as valid."""
TRUE_WORDS = ("yes", "true", "1", "on")
FALSE_WORDS = ("no", "false", "0", "off", "")

CODE_PAGE_NAMES = {"cp1252": "Windows-1252"}
"""Names of code pages in sentences."""
END_OF_TEXT = re.compile("[\0\x1a]")
"""End of the text of a file in DOS, which zeros may follow."""

T = TypeVar("T")
_PLACE = re.compile(r"(?P<file>.*?)(?::(?P<line>\d+))?(?::|$)")
_REQUIRED: Any = object()
"""Default of a field that has none: it must not be absent."""


@dataclass(frozen=True)
class LeftOutReason:
    """Why rows of a sort are left out."""

    what: str
    """The rows, in words."""
    why: str
    """Why they are left out."""
    doubtful: bool = False
    """Whether they were expected to be used: marks of known points, positions of photos."""
    kept: Callable[[Network], int] = marks_of_known_points
    """Number of rows of the sort that a network has; it counts for doubtful ones."""


ROWS_SWITCHED_OFF = LeftOutReason("points and observations", "they are switched off in the file")
DERIVED_OBSERVATIONS = LeftOutReason(
    "reduced observations", "they are derived: raw readings alone are read"
)
NOTES = LeftOutReason("notes", "they are text of the surveyor or the program, and no reading")
"""Records and fields of field books that hold a remark: those that the reader takes a setting, a
height or a reading from are read."""


class Problems:
    """Problems of all files that a reader opens, and the rows that it leaves out.

    A place is ``file:line``, and may be followed by the entity concerned: ``a.dat:7: point 'A'``.
    """

    def __init__(self) -> None:
        """Start without problems."""
        self.problems: list[Problem] = []
        self.left_out: dict[LeftOutReason, list[tuple[str, str]]] = {}
        """Name and place of each row that is left out, by the reason."""
        self.remarks: list[str] = []
        """Sentences on how files were read, which the network keeps."""
        self.files: list[str] = []
        """Names of the files in the order in which they were opened, which orders problems."""
        self._seen: set[Problem] = set()
        self._not_kept = 0

    @property
    def count(self) -> int:
        """Number of problems so far: a reader that compares it knows whether a part has any."""
        return len(self.problems) + self._not_kept

    def wrong(self, what: str, where: str) -> None:
        """Add a problem; the same one of a place counts once."""
        self.extend([Problem(what, where)])

    def extend(self, problems: Collection[Problem]) -> None:
        """Add problems that have their places."""
        for problem in problems:
            if problem in self._seen:
                continue
            if len(self.problems) < MAX_KEPT_PROBLEMS:
                self._seen.add(problem)
                self.problems.append(problem)
            else:
                self._not_kept += 1

    def count_further(self, number: int) -> None:
        """Count problems that are like those that were added, of which there are too many."""
        self._not_kept += number

    def collect(self, where: str) -> AbstractContextManager[None, bool]:
        """Add the problems of an InputError inside; ``where`` precedes their own places.

        Problems that name a line of the same file already keep it alone.
        """
        # Types then know that what follows the block is reached after an error, too.
        return cast("AbstractContextManager[None, bool]", self._collecting(where))

    @contextmanager
    def _collecting(self, where: str) -> Iterator[None]:
        file = _PLACE.match(where)["file"]  # type: ignore[index]
        try:
            yield
        except InputError as error:
            self.extend(
                [p if p.where.startswith(f"{file}:") else p.at(where) for p in error.problems]
            )

    def attempt(
        self, where: str, make: Callable[..., T], *arguments: Any, **options: Any
    ) -> T | None:
        """Return what a function makes; None after an InputError, whose problems are added."""
        with self.collect(where):
            return make(*arguments, **options)
        return None

    def field(self, value: object, what: str, where: str | Callable[[], str]) -> Field:
        """Return a field.

        Args:
            value: text of the file, or value of JSON or TOML; None or blank: it is absent.
            what: its name in messages.
            where: file and line, or what returns them if a problem needs them.
        """
        return Field(value, what, where, self)

    def leave_out(self, why: LeftOutReason, name: str, where: str = "") -> None:
        """Count and name a row that is left out; ``name``: of its photo, points or itself."""
        self.left_out.setdefault(why, []).append((name, where))

    def counts_left_out(self) -> list[str]:
        """Return how many rows are left out for each reason, in words."""
        return [f"{w.what}: {len(r)} left out, as {w.why}" for w, r in self.left_out.items()]

    def ordered(self) -> list[Problem]:
        """Return the problems in the order of files and lines."""
        rank = {name: i for i, name in enumerate(self.files)}

        def order(problem: Problem) -> tuple[int, int]:
            place = _PLACE.match(problem.where)
            assert place is not None  # every text matches
            return rank.setdefault(place["file"], len(rank)), int(place["line"] or 0)

        return sorted(self.problems, key=order)

    def raise_all(self) -> None:
        """Raise all problems, file by file in the order of lines.

        Raises:
            InputError: there is any; it lists `MAX_LISTED_PROBLEMS` and counts the others.
        """
        if not self.problems:
            return
        listed = self.ordered()[:MAX_LISTED_PROBLEMS]
        rest = self.count - len(listed)
        if rest:
            listed.append(Problem(f"and {rest} further problems", listed[-1].where.split(":")[0]))
        raise InputError(listed)

    def finish(self, network: Network | None = None) -> None:
        """Raise all problems, and say in the network how it was read and what was left out.

        Args:
            network: the network that was read; its marks of known points are judged as a whole.

        Raises:
            InputError: there is any problem.
        """
        if network is not None:
            network.left_out += self._left_out(network)
            network.remarks += self.remarks
            if not self.problems:
                self.extend(problems_of_marks(network))
        self.raise_all()

    def _left_out(self, network: Network) -> Iterator[LeftOut]:
        """Yield a record for each reason; that a doubtful one left all rows is a problem."""
        for why, rows in self.left_out.items():
            names = tuple(dict.fromkeys(name for name, _ in rows))
            where = next((where for _, where in rows if where), "")
            left = LeftOut(why.what, why.why, names, len(rows), where=where, doubtful=why.doubtful)
            if why.doubtful:
                kept = why.kept(network)
                left = replace(left, of=kept + len(rows), hint=_similar_photo(names[0], network))
                if not kept:
                    self.wrong(str(left), where)
            yield left


def _similar_photo(name: str, network: Network) -> str:
    """Return which photo may be meant: one with the name but for folder and suffix, or alike."""
    stem = PurePosixPath(name).stem.casefold()
    same = [photo for photo in network.photos if PurePosixPath(photo).stem.casefold() == stem]
    return f"; did you mean {same[0]!r}?" if same else similar(name, network.photos)


def is_unread(*values: object) -> bool:
    """Return whether any of some values is what a field returns after a problem.

    That is NaN for a number, '' for a name, None for a choice, and a tuple with a NaN.
    """
    return any(
        v is None
        or v == ""
        or (isinstance(v, float) and math.isnan(v))
        or (isinstance(v, tuple) and is_unread(*v))
        for v in values
    )


class Field:
    """A value of a file with its name and place; its methods note what is wrong with it."""

    __slots__ = ("_where", "problems", "value", "what")

    def __init__(
        self, value: object, what: str, where: str | Callable[[], str], problems: Problems
    ) -> None:
        """Take a value, see `Problems.field`."""
        self.value = value.strip() if isinstance(value, str) else value
        self.what = what
        self._where = where
        self.problems = problems

    @property
    def where(self) -> str:
        """Name of the file and line."""
        return self._where if isinstance(self._where, str) else self._where()

    @property
    def is_absent(self) -> bool:
        """Whether the file has no value, or a blank one."""
        return self.value is None or self.value == ""

    def wrong(self, what: str) -> None:
        """Add a problem of the field; ``what`` follows its name: 'must be …, not …'."""
        self.problems.wrong(f"{self.what} {what}", self.where)

    def number(
        self,
        unit: str = "",
        *,
        scale: float = 1.0,
        least: float = -math.inf,
        above: float = -math.inf,
        largest: float = MAX_NUMBER,
        default: float = _REQUIRED,
    ) -> float:
        """Return a finite number in SI; NaN after a problem.

        Args:
            unit: see `numbers.parse_quantity`; '' for SI.
            scale: factor to SI, of a unit without a name.
            least: smallest valid result, in SI.
            above: number that a valid result is greater than.
            largest: largest valid absolute value.
            default: what is returned for an absent field; none: it must not be absent.
        """
        if self.is_absent and default is not _REQUIRED:
            return default
        limits = {"scale": scale, "least": least, "above": above, "largest": largest}
        try:
            return checked_number(self.value, self.what, unit, **limits)
        except ValueError as error:
            self.problems.wrong(str(error), self.where)
            return math.nan

    def number_or_none(self, unit: str = "", *, scale: float = 1.0) -> float | None:
        """Return a number, see `number`; None for an absent field."""
        return None if self.is_absent else self.number(unit, scale=scale)

    def sigma(self, unit: str = "", *, scale: float = 1.0, default: float = _REQUIRED) -> float:
        """Return a standard deviation, at least `MIN_SIGMA`; NaN after a problem."""
        return self.number(unit, scale=scale, above=0.0, least=MIN_SIGMA, default=default)

    def numbers(self, size: int, **options: Any) -> tuple[float, ...]:
        """Return ``size`` numbers of a text with blanks between, or of a list.

        Args:
            size: how many there must be.
            options: see `number`.

        Returns:
            The numbers; all NaN after a problem.
        """
        given = self.value
        parts = given.split() if isinstance(given, str) else given or ()
        if not isinstance(parts, list | tuple):
            parts = (parts,)
        if len(parts) != size:
            self.wrong(f"needs {size} numbers, not {len(parts)}")
            return (math.nan,) * size
        out = tuple(
            Field(part, self.what, self._where, self.problems).number(**options) for part in parts
        )
        return (math.nan,) * size if is_unread(out) else out

    def integer(
        self, *, least: int = 0, largest: int = 2**63 - 1, default: int | None = _REQUIRED
    ) -> int | None:
        """Return a whole number; None after a problem."""
        if self.is_absent and default is not _REQUIRED:
            return default
        text = "" if isinstance(self.value, bool) else str(self.value)
        # Programs write 6 as 6. or 6.0; int() of thousands of digits takes long, or fails.
        whole = re.fullmatch(r"([+-]?[0-9]{1,19})(?:\.0*)?", text)
        if whole is not None and least <= (found := int(whole[1])) <= largest:
            return found
        size = f" ≥ {least}" if largest >= 2**63 - 1 else f" from {least} to {largest}"
        self._must_be(f"a whole number{size}")
        return None

    def name(self, default: str = _REQUIRED) -> str:
        """Return a name, without blanks at its ends; '' after a problem."""
        if self.is_absent and default is not _REQUIRED:
            return default
        text = str(self.value) if isinstance(self.value, str | int) else ""
        if text and not isinstance(self.value, bool) and not has_control_characters(text):
            return text
        if text and isinstance(self.value, str):
            self.wrong(f"must be a name: {why_refused(text)}")
        else:
            self._must_be("a name")
        return ""

    def word(self, valid: Collection[str], default: str = _REQUIRED) -> str:
        """Return one of several words; after a problem the default, or '' without one."""
        return self.choice({w: w for w in valid}, default) or (
            "" if default is _REQUIRED else default
        )

    def choice(self, table: Mapping[str, T], default: T = _REQUIRED) -> T | None:
        """Return the value of a word in a table; None after a problem."""
        if self.is_absent and default is not _REQUIRED:
            return default
        word = str(self.value if self.value is not None else "")
        if word in table:
            return table[word]
        valid = known(table, meant=word, most=MAX_LISTED_CHOICES)
        shown = "is missing" if self.is_absent else f"{word[:40]!r} is unknown"
        self.wrong(f"{shown}; valid: {valid}")
        return None

    def flag(self, default: bool = _REQUIRED) -> bool:
        """Return whether a word or a value of JSON says yes; False after a problem."""
        if self.is_absent and default is not _REQUIRED:
            return default
        text = str(self.value).lower()
        if text not in (*TRUE_WORDS, *FALSE_WORDS):
            self._must_be("yes or no")
        return text in TRUE_WORDS

    def _must_be(self, valid: str) -> None:
        """Add the problem that the value is none of a sort."""
        text = str(self.value)
        shown = "is missing" if self.is_absent else f"must be {valid}, not {text[:40]!r}"
        self.wrong(f"{shown}; valid: {valid}" if self.is_absent else shown)


class Source:
    """A file, or several whose lines are numbered on: gives places to lines, and takes problems."""

    def __init__(self, path: str | Path, problems: Problems | None = None) -> None:
        """Open a file without reading it.

        Args:
            path: the file.
            problems: collection of the reader; default: one of this file.
        """
        self.path = Path(path)
        self.problems = Problems() if problems is None else problems
        self.problems.files.append(self.path.name)
        self.last = 0
        """Last line, at which a problem of the whole file is reported; 0: none is known."""
        self._parts: list[tuple[int, str, int]] = [(0, self.path.name, 0)]

    def place(self, line: int) -> str:
        """Return file and line; line 0 is that of a problem of the whole file."""
        line = line or self.last
        parts = (p for p in reversed(self._parts) if p[0] < line)
        before, name, skipped = next(parts, self._parts[0])
        return f"{name}:{line - before + skipped}" if line else name

    def continue_with(self, path: Path, lines: int, read: int = 0) -> None:
        """Go on with another file, whose lines are numbered on.

        Args:
            path: the file.
            lines: number of lines of all files before it.
            read: number of its own lines that were read before another file stood between.
        """
        self.problems.files.append(path.name)
        self._parts.append((lines, path.name, read))

    def wrong(self, line: int, what: str) -> None:
        """Add a problem of a line."""
        self.problems.wrong(what, self.place(line))

    def field(self, line: int, value: object, what: str) -> Field:
        """Return a field of a line, see `Problems.field`."""
        return Field(value, what, self.place(line), self.problems)

    def attempt(
        self, line: int, make: Callable[..., T], *arguments: Any, **options: Any
    ) -> T | None:
        """Return what a function makes of a line, see `Problems.attempt`."""
        return self.problems.attempt(self.place(line), make, *arguments, **options)

    def leave_out(self, line: int, why: LeftOutReason, name: str) -> None:
        """Count and name a row that is left out, see `Problems.leave_out`."""
        self.problems.leave_out(why, name, self.place(line))

    def raise_all(self) -> None:
        """Raise all problems, see `Problems.raise_all`."""
        self.problems.raise_all()


class TextSource(Source):
    """A text file: its lines, numbered from 1."""

    def __init__(
        self, path: str | Path, problems: Problems | None = None, *, code_page: str = ""
    ) -> None:
        """Read the file.

        Args:
            path: the file.
            problems: collection of the reader; default: one of this file.
            code_page: encoding of text that is not UTF-8, for formats whose programs write that
                of their system: ``cp1252``.

        Raises:
            InputError: the file cannot be read, or is not text.
        """
        super().__init__(path, problems)
        text, in_page = decoded(read_bytes(self.path), self.path.name, code_page)
        text = with_newlines(text)
        if in_page:
            self._remark_code_page(text, code_page)
        content = text.rstrip("\0\x1a\n ")
        if END_OF_TEXT.search(text, len(content)):
            text = content
        if "\0" in text:
            line = text.count("\n", 0, text.index("\0")) + 1
            raise InputError(Problem("is not text: it has zero bytes", self.place(line)))
        self.lines = text.split("\n")
        self.last = last_line_number(text)

    def numbered(self) -> Iterator[tuple[int, str]]:
        """Yield the lines with their numbers."""
        return enumerate(self.lines, 1)

    def _remark_code_page(self, text: str, code_page: str) -> None:
        """Add the remark that lines were read in a code page."""
        lines = [i for i, line in enumerate(text.split("\n"), 1) if not line.isascii()]
        said = "1 line is" if len(lines) == 1 else f"{len(lines)} lines are"
        name = CODE_PAGE_NAMES.get(code_page, code_page)
        self.problems.remarks.append(
            f"{said} not UTF-8: read as if in {name}; first in {self.place(lines[0])}"
        )

    def filled(self) -> Iterator[tuple[int, str]]:
        """Yield the lines that are not blank, with their numbers."""
        return ((i, line) for i, line in self.numbered() if line.strip())

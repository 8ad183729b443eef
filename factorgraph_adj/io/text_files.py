"""Text files: encodings, first bytes for recognition; TOML with lines of keys for its problems.

Python's reader of TOML keeps no places. A problem of a TOML file names its table, and its text
names the key concerned; `TomlPlaces` finds the line from both.
"""

from __future__ import annotations

import codecs
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import InputError, Problem
from ..files import MAX_KEY_PARTS, MAX_TOML_BYTES, opened, read_bytes

QUOTED_CHARACTERS = 8
"""Number of characters before one of another encoding that a message quotes."""
DECIMAL_COMMA = re.compile(r"[=,\[]\s*([+-]?\d+,\d+)\s*(?=[,}\]#]|$)")
"""A number with a decimal comma in a line that is not TOML."""


_KEY_PART = r"(?:[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_LONG_KEY = re.compile(
    rf"(?<![\w\-\"'.]){_KEY_PART}(?:[ \t]*+\.[ \t]*+{_KEY_PART}){{{MAX_KEY_PARTS}}}"
)
_LONG_NUMBER = re.compile(r"[0-9][0-9_]{4000}")

MAX_RECOGNITION_BYTES = 65_536
"""Largest number of bytes at the beginning of a file by which its format is recognised."""
_HEADER = re.compile(r"\s*\[\[?\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
_BARE = r"(?:[\w-]+|\"[^\"]*\"|'[^']*')"
_KEY = re.compile(rf"\s*({_BARE}(?:\s*\.\s*{_BARE})*)\s*=")
_DOTTED_PART = re.compile(r"\"([^\"]*)\"|'([^']*)'|([\w-]+)")
_TABLE = re.compile(r"\[\[?([^\[\]]+?)\]\]?|^: (\w+)")
_NAMED = re.compile(r"\s'([^']*)'|\s(\d+)\b")
_WORD = re.compile(r"[\w-]+")
_INLINE = re.compile(r"[{,]\s*([\w-]+)\s*=")
"""Keys of a table that is written in one line."""


END_OF_LINE = re.compile(r"(?<!\r)\r++\n")
BYTES_OF_NO_CHARACTER = {0xDC00 + byte: 0xF700 + byte for byte in range(0x80, 0x100)}
"""Private characters (U+F780 to U+F7FF) for bytes that a code page does not have, as Python
escapes them."""


def file_beginning(path: Path, size: int = MAX_RECOGNITION_BYTES) -> bytes:
    """Return the first bytes of a file, by which its format is recognised; b'' if unreadable."""
    try:
        with opened(path) as stream:
            return stream.read(size)
    except (OSError, InputError):
        return b""


def read_text(path: Path, name: str = "") -> str:
    """Return the text of a file in UTF-8, or in UTF-16 with its mark, without the mark.

    Args:
        path: the file.
        name: its name in messages; default: the path for a file that cannot be read, otherwise
            the name of the file.

    Raises:
        InputError: the file cannot be read, or has another encoding.
    """
    found = read_bytes(path, name)
    return with_newlines(decoded(found, name or path.name)[0])


def with_newlines(text: str) -> str:
    """Return a text whose lines end in newlines alone; several CR before LF end one line."""
    return END_OF_LINE.sub("\n", text).replace("\r", "\n")


def decoded(found: bytes, name: str, code_page: str = "") -> tuple[str, bool]:
    """Return the text of bytes, without a mark, and whether it is in the code page.

    Args:
        found: the bytes, in UTF-8, in UTF-16 with its mark, or in the code page.
        name: name of the file in messages.
        code_page: encoding of text that is neither, for formats whose programs write that of
            their system; bytes to which it gives no character become private characters, each
            another one, so that different names stay different.

    Raises:
        InputError: the text has another encoding.
    """
    marked = found.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return found.decode("utf-16" if marked else "utf-8-sig"), False
    except UnicodeDecodeError as error:
        if code_page and not marked:
            text = found.decode(code_page, errors="surrogateescape")
            return text.translate(BYTES_OF_NO_CHARACTER), True
        raise InputError(encoding_problem(error.object, error.start, name)) from None


def last_line_number(text: str) -> int:
    """Return the number of the last line that is not blank, from 1."""
    return text.rstrip().count("\n") + 1


def encoding_problem(found: bytes, at: int, name: str) -> Problem:
    """Return the problem of text in another encoding.

    Args:
        found: the bytes of the file.
        at: index of the first byte that is not UTF-8.
        name: name of the file in messages.
    """
    if found.startswith((b"\xff\xfe", b"\xfe\xff")):
        return Problem("is damaged UTF-16 text: save it as UTF-8", name)
    before = found[:at]
    begun = max(before.rfind(b"\n") + 1, at - QUOTED_CHARACTERS)
    quoted = found[begun : at + 1].decode("latin-1").strip()
    what = (
        f"is not UTF-8 text (byte {at}): the last character of {quoted!r} is in another encoding, "
        "such as Latin-1 (Windows-1252); save the file as UTF-8 (of a spreadsheet: as CSV UTF-8)"
    )
    line = re.sub(rb"\r\n?", b"\n", before).count(b"\n") + 1
    return Problem(what, f"{name}:{line}")


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Return the document of a TOML text.

    Args:
        text: the text.
        name: name of its file in messages.

    Raises:
        InputError: the text is not TOML; the problem has the line.
    """
    if len(text) > MAX_TOML_BYTES:
        what = f"has {len(text)} characters; valid: at most {MAX_TOML_BYTES} for TOML"
        raise InputError(Problem(what, name))
    if found := _LONG_KEY.search(text):
        line = text.count("\n", 0, found.start()) + 1
        what = f"a key has more than {MAX_KEY_PARTS} parts: {found[0][:40]!r} …"
        raise InputError(Problem(what, f"{name}:{line}"))
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        at = re.search(r"line (\d+)", str(error))
        what, where = (
            f"is not TOML: {error}",
            f"{name}:{last_line_number(text)}",
        )  # the end is wrong
        if at is not None:
            where = f"{name}:{at[1]}"
            comma = DECIMAL_COMMA.search(text.split("\n")[int(at[1]) - 1])
            if comma is not None:
                right = comma[1].replace(",", ".")
                what = f"{comma[1]} is not a number: write a decimal point, {right} ({what})"
        raise InputError(Problem(what, where)) from None
    except RecursionError:
        raise InputError(Problem("is nested too deeply", name)) from None
    except ValueError:  # a whole number has thousands of digits
        found = _LONG_NUMBER.search(text)
        line = text.count("\n", 0, found.start() if found else 0) + 1
        what = f"is not TOML: a number has more than {sys.get_int_max_str_digits()} digits"
        raise InputError(Problem(what, f"{name}:{line}")) from None


@dataclass
class _Section:
    """A table of the file: its name, the line of its header and those of its keys."""

    name: str
    line: int
    keys: dict[str, int] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)


class TomlPlaces:
    """The tables and keys of a TOML text, with their lines."""

    def __init__(self, text: str, name: str) -> None:
        """Find tables and keys.

        Args:
            text: the text.
            name: name of its file in messages.
        """
        self.name = name
        self.sections = [_Section("", 1)]
        for number, line in enumerate(text.split("\n"), 1):
            header, key = _HEADER.match(line), _KEY.match(line)
            if header is not None:
                self.sections.append(_Section(_plain_name(header[1]), number))
            elif key is not None:
                here, name = self.sections[-1], _plain_name(key[1])
                here.texts.setdefault(name, line[key.end() :])
                for part in (name, *_INLINE.findall(line, key.end())):
                    here.keys.setdefault(part, number)

    def placed(self, problem: Problem) -> Problem:
        """Return a problem of the file with its line; problems that have one stay as they are."""
        where = problem.where
        if where.startswith("["):  # a table without its file
            where = f"{self.name}: {where}"
        if where != self.name and not where.startswith(f"{self.name}: "):
            return problem
        rest = where[len(self.name) :]
        line = self._line(rest, problem.what)
        return Problem(problem.what, f"{self.name}:{line}{rest}")

    def in_order(self, problems: Iterable[Problem]) -> list[Problem]:
        """Return problems of the file with their lines, in the order of the lines."""
        found = [self.placed(p) for p in problems]
        at = re.compile(rf"{re.escape(self.name)}:(\d+)")
        lines = [int(m[1]) if (m := at.match(p.where)) else 0 for p in found]
        return [p for _, p in sorted(zip(lines, found, strict=True), key=lambda pair: pair[0])]

    @contextmanager
    def placing(self) -> Iterator[None]:
        """Give the problems of an InputError inside their lines."""
        try:
            yield
        except InputError as error:
            raise InputError(map(self.placed, error.noted)) from None

    def _line(self, rest: str, what: str) -> int:
        """Return the line of the key that a message is about, or of its table."""
        own = _NAMED.sub(" ", _TABLE.sub(" ", rest))
        words = list(dict.fromkeys(_WORD.findall(f"{what.split(';')[0]} {own}")))
        sections = self._sections(rest)
        for word in words:
            for section in sections:
                if word in section.keys:
                    return section.keys[word]
        inside = [s for s in sections[1:] if s.name.split(".")[-1] in own.split()]
        if inside:
            return inside[0].line
        if sections and sections[0].name:
            return sections[0].line
        by_header = [s for s in self.sections if s.name and s.name.split(".")[-1] in words]
        return by_header[0].line if by_header else 1

    @staticmethod
    def _named(fitting: list[_Section], named: re.Match[str]) -> list[_Section]:
        """Return the one of some tables of a kind that has a number or a name."""
        if named[2] is not None:
            return fitting[int(named[2]) - 1 : int(named[2])]
        texts = [s.texts.get("name", "") for s in fitting]
        exact = [s for s, t in zip(fitting, texts, strict=True) if _is_text(t, named[1])]
        return (exact or [s for s, t in zip(fitting, texts, strict=True) if named[1] in t])[:1]

    def _sections(self, rest: str) -> list[_Section]:
        """Return the tables that a place names, the one with the name that it states first."""
        found = _TABLE.search(rest)
        if found is None:
            return self.sections[:1]
        title = _plain_name(found[1] or found[2])
        fitting = [s for s in self.sections if s.name == title]
        inside = [s for s in self.sections if s.name.startswith(f"{title}.")]
        named = _NAMED.match(rest, found.end())
        if named is not None:
            own = self._named(fitting, named)
            if not own:
                return fitting
            begun = own[0].line
            end = next((s.line for s in fitting if s.line > begun), self.sections[-1].line + 1)
            return own + [s for s in inside if begun < s.line < end]
        return fitting + inside or self.sections[:1]


def _is_text(toml: str, name: str) -> bool:
    """Return whether a value of TOML, with what follows it in its line, is a text."""
    return toml.strip().startswith((f'"{name}"', f"'{name}'"))


def read_toml(path: Path) -> tuple[dict[str, Any], TomlPlaces]:
    """Return the document of a TOML file, and the places of its keys.

    Raises:
        InputError: the file cannot be read, or is not TOML.
    """
    text = read_text(path)
    return parse_toml(text, path.name), TomlPlaces(text, path.name)


def _plain_name(name: str) -> str:
    """Return a dotted name without quotation marks and blanks."""
    return ".".join(a or b or c for a, b, c in _DOTTED_PART.findall(name))

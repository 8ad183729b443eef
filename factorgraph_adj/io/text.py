"""Text of files that people write: UTF-8 and TOML, with the line of what is wrong."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path
from typing import Any

from ..errors import InputError, Problem
from ..files import MAX_KEY_PARTS, MAX_TOML_BYTES, opened, read_bytes

QUOTED = 8
"""Number of characters before one of another encoding that a message quotes."""
DECIMAL_COMMA = re.compile(r"[=,\[]\s*([+-]?\d+,\d+)\s*(?=[,}\]#]|$)")
"""A number with a decimal comma in a line that is not TOML."""


_PART = r"(?:[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_LONG_KEY = re.compile(rf"(?<![\w\-\"'.]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MAX_KEY_PARTS}}}")
_LONG_NUMBER = re.compile(r"[0-9][0-9_]{4000}")

MOST_LOOKED_AT = 65_536
"""Largest number of bytes at the beginning of a file by which its format is recognised."""


def beginning(path: Path, size: int = MOST_LOOKED_AT) -> bytes:
    """Return the first bytes of a file, by which its format is recognised; b'' if unreadable."""
    try:
        with opened(path) as stream:
            return stream.read(size)
    except (OSError, InputError):
        return b""


def read_text(path: Path, name: str = "") -> str:
    """Return the text of a UTF-8 file, without a byte order mark.

    Args:
        path: the file.
        name: its name in messages; default: the path for a file that cannot be read, otherwise
            the name of the file.

    Raises:
        InputError: the file cannot be read, or is not UTF-8.
    """
    found = read_bytes(path, name)
    name = name or path.name
    try:
        text = found.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(not_utf_8(error.object, error.start, name)) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def last_line(text: str) -> int:
    """Return the number of the last line that is not blank, from 1."""
    return text.rstrip().count("\n") + 1


def not_utf_8(found: bytes, at: int, name: str) -> Problem:
    """Return the problem of text in another encoding.

    Args:
        found: the bytes of the file.
        at: index of the first byte that is not UTF-8.
        name: name of the file in messages.
    """
    if found.startswith((b"\xff\xfe", b"\xfe\xff")):
        return Problem("is UTF-16 text: save it as UTF-8", name)
    before = found[:at]
    begun = max(before.rfind(b"\n") + 1, at - QUOTED)
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
        what, where = f"is not TOML: {error}", f"{name}:{last_line(text)}"  # the end is wrong
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

"""Records of survey-file lines as tables of fields by order, key or width, read in SI units.

A format whose lines have fields in an order, in columns, or by keys is a table of its records. Each
field has a name for the reader, a name in messages and a function that reads it: `read_name`,
`read_number`, `read_length`, `read_angle`, `read_choice`. `read_record` returns the values of a
line by the reader's names::

    POINT = (
        RecordField("name", "point", read_name),
        RecordField("east", "easting", read_length),
    )
    read_record(POINT, line.split(), source, number, Scales(length=0.3048))
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..source import Field, Source

NEEDED: Any = object()
"""Default of a field that must not be absent."""


@dataclass(frozen=True)
class Scales:
    """SI units in one unit of a file."""

    length: float = 1.0
    """Metres."""
    angle: float | str = 1.0
    """Radians, or the name of a unit such as `PACKED_DEGREES`."""


SI = Scales()
"""Metres and radians."""


def read_name(field: Field, scales: Scales = SI) -> str:
    """Return the name in a field; '' after a problem."""
    return field.name()


def read_number(field: Field, scales: Scales = SI) -> float:
    """Return the number in a field; NaN after a problem."""
    return field.number()


def read_length(field: Field, scales: Scales = SI) -> float:
    """Return the length in a field, metres; NaN after a problem."""
    return field.number(scale=scales.length)


def read_angle(field: Field, scales: Scales = SI) -> float:
    """Return the angle in a field, radians; NaN after a problem."""
    unit = scales.angle
    return field.number(unit) if isinstance(unit, str) else field.number(scale=unit)


def read_choice(table: Mapping[str, Any]) -> Callable[[Field, Scales], Any]:
    """Return a function that reads a word and returns its value in a table; None after a problem.

    >>> face = RecordField("face", "face", read_choice({"F1": 1, "F2": 2}))
    """

    def read(field: Field, scales: Scales = SI) -> Any:
        return field.choice(table)

    return read


@dataclass(frozen=True)
class RecordField:
    """A field of a record."""

    name: str
    """Name by which the reader takes its value."""
    what: str
    """Name in messages."""
    read: Callable[[Field, Scales], Any]
    """Function that reads it."""
    key: str = ""
    """Key of its word, where fields have keys; otherwise they are in the order of the record."""
    default: Any = None
    """Value of an absent field; `NEEDED`: it must not be absent."""


def read_record(
    fields: Sequence[RecordField],
    given: Sequence[object] | Mapping[str, object],
    source: Source,
    line: int,
    scales: Scales = SI,
    *,
    unread: Collection[str] = (),
) -> dict[str, Any]:
    """Return the values of a record by their names; what is wrong with them is noted.

    A field more than the record has, and a key that none of its fields has, is wrong.

    Args:
        fields: the fields of the record.
        given: texts of the fields in their order, or by key.
        source: the file.
        line: number of the line.
        scales: units of the file.
        unread: keys that the format has too, and that the reader passes over knowingly.
    """
    if isinstance(given, Mapping):
        valid = dict.fromkeys(sorted({*unread, *(f.key for f in fields)}), True)
        for key in given:
            source.field(line, key, "word").choice(valid)
    elif len(given) > len(fields):
        names = ", ".join(f.what for f in fields)
        source.wrong(line, f"has {len(given)} fields; valid: at most {len(fields)}, {names}")
    out = {}
    for i, f in enumerate(fields):
        if isinstance(given, Mapping):
            value = given.get(f.key)
        else:
            value = given[i] if i < len(given) else None
        field = source.field(line, value, f.what)
        absent = field.is_absent and f.default is not NEEDED
        out[f.name] = f.default if absent else f.read(field, scales)
    return out


def by_key(words: Iterable[str], source: Source, line: int, sign: str = "=") -> dict[str, str]:
    """Return the texts of words such as ``HZ=12.5`` by key.

    Args:
        words: the words.
        source: the file; a word without the sign, and the second one of a key, are noted.
        line: number of the line.
        sign: what stands between key and text.
    """
    out: dict[str, str] = {}
    for word in words:
        key, found, text = word.partition(sign)
        if not found:
            source.wrong(line, f"word {word[:40]!r} must be a key and a text with {sign!r} between")
        elif key in out:
            source.wrong(line, f"word {key[:40]!r} stands twice")
        else:
            out[key] = text
    return out


def in_columns(text: str, widths: Sequence[int], begin: int = 0) -> list[str]:
    """Return the texts of fields of fixed widths.

    Args:
        text: the line.
        widths: number of characters of each field.
        begin: number of characters before the first.
    """
    out = []
    for width in widths:
        out.append(text[begin : begin + width])
        begin += width
    return out
